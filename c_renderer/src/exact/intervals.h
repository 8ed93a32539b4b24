/* Parts of a circle: sets of intervals of its angle, within [-pi, pi]. */
#ifndef PENUMBRA_INTERVALS_H
#define PENUMBRA_INTERVALS_H

enum { MAX_INTERVALS = 2304 };

typedef struct {
    double start, end; /* [rad] */
} Interval;

/* Sorted by start; they may overlap. What is more than fits is left out. */
typedef struct {
    int count;
    Interval interval[MAX_INTERVALS];
} Intervals;

/* Nothing if start >= end. */
void intervals_add(Intervals *set, double start, double end);

/* The angles within `half` of the middle, wherever that is; all of them if half >= pi. */
void intervals_add_around(Intervals *set, double middle, double half);

/* What the intervals leave free of [low, high], in their place; disjoint. */
void intervals_invert(Intervals *set, double low, double high);

/* Adds all of `more`. */
void intervals_unite(Intervals *set, const Intervals *more);

/* What is in both, in the place of `set`. */
void intervals_intersect(Intervals *set, const Intervals *other);

#endif
