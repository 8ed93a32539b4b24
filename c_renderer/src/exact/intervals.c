#include "intervals.h"

#include <math.h>

#include "core/vec3.h"

void intervals_add(Intervals *set, double start, double end)
{
    if (!(start < end) || set->count == MAX_INTERVALS)
        return;
    int k = set->count++;
    for (; k > 0 && set->interval[k - 1].start > start; k--)
        set->interval[k] = set->interval[k - 1];
    set->interval[k] = (Interval){start, end};
}

void intervals_add_around(Intervals *set, double middle, double half)
{
    if (half >= PI) {
        intervals_add(set, -PI, PI);
        return;
    }
    const double start = middle - half, end = middle + half;
    intervals_add(set, fmax(start, -PI), fmin(end, PI));
    intervals_add(set, start + 2 * PI, PI);
    intervals_add(set, -PI, end - 2 * PI);
}

void intervals_invert(Intervals *set, double low, double high)
{
    int count = 0;
    double reached = low;
    for (int k = 0; k <= set->count && reached < high; k++) {
        Interval next = k < set->count ? set->interval[k] : (Interval){high, high};
        if (next.start > reached) /* count <= k: nothing is overwritten before it is read */
            set->interval[count++] = (Interval){reached, fmin(next.start, high)};
        reached = fmax(reached, next.end);
    }
    set->count = count;
}

void intervals_unite(Intervals *set, const Intervals *more)
{
    for (int k = 0; k < more->count; k++)
        intervals_add(set, more->interval[k].start, more->interval[k].end);
}

void intervals_intersect(Intervals *set, const Intervals *other)
{
    Intervals outside;
    outside.count = 0;
    intervals_unite(&outside, other);
    intervals_invert(&outside, -PI, PI);
    intervals_invert(set, -PI, PI);
    intervals_unite(set, &outside);
    intervals_invert(set, -PI, PI);
}
