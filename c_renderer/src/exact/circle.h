/* Circles in space, as a point at the origin sees them: all that can bound a light is one. Which part
 * of a circle is inside of another, and what an arc adds to Stokes' integral: docs/exact.md. */
#ifndef PENUMBRA_CIRCLE_H
#define PENUMBRA_CIRCLE_H

#include <stdbool.h>

#include "intervals.h"
#include "vec3d.h"

typedef enum {
    CIRCLE_GREAT, /* in a plane through the point: an edge, the horizon */
    CIRCLE_CAP,   /* a ball's silhouette, on the unit sphere */
    CIRCLE_RIM    /* any other: a disk's outline, where a ball or plane meets a light */
} CircleKind;

/* X(phi) = center + radius (cos(phi) u + sin(phi) v). (axis, u, v) are orthonormal and right-handed;
 * the inside is on the left of one who walks on it with the axis upwards. */
typedef struct {
    CircleKind kind;
    int rank; /* of two that are the same, the one of the lesser rank is inside */
    Vec3d center, axis, u, v;
    double radius; /* great circle and cap: the sine of the half-angle */
    /* What rounding of the distances it is worked out from amounts to, as seen, in eps: 1, or more
     * where it passes much closer to the point than they are. */
    double doubt;
    /* Of a cap: */
    double cosine, angle;
    double tangent; /* from the point to the ball [m] */
} Circle;

/* normal . X + offset >= 0. */
typedef struct {
    Vec3d normal;
    double offset;
} HalfSpace;

static inline double half_space_height(HalfSpace half_space, Vec3d place)
{
    return vec3d_dot(half_space.normal, place) + half_space.offset;
}

/* The great circle about the unit vector `pole`; phi is 0 at `towards`. Its doubt is 1. */
Circle circle_great(Vec3d pole, Vec3d towards);

/* Of a ball that does not hold the point. */
Circle circle_cap(Vec3d center, double radius);

/* Counterclockwise about the unit vector `axis`; phi is 0 at the nearest place. */
Circle circle_rim(Vec3d center, Vec3d axis, double radius);

/* |center|^2 - radius^2 with all digits [m^2]: the square of the tangent's length from the point to
 * the ball; below 0 inside. */
double ball_power(Vec3d center, double radius);

Vec3d circle_at(const Circle *circle, double angle);

/* The angle of a place that is on the circle. */
double circle_angle(const Circle *circle, Vec3d place);

enum { MAX_ANGLES = 64 };

/* What is more than fits is left out. */
typedef struct {
    int count;
    double angle[MAX_ANGLES];
} Angles;

void angles_add(Angles *angles, double angle);
void angles_sort(Angles *angles);

/* Each of these adds a part of the circle to `in`: what is in the half-space, */
void circle_in_half_space(const Circle *circle, HalfSpace half_space, Intervals *in);
/* or inside the other one. Two rims have to be in one plane, which does not hold the point, and a
 * great circle meets a rim that is wholly before the point. */
void circle_inside(const Circle *circle, const Circle *other, Intervals *in);

/* Adds the angles on a circle, no rim, at which it crosses the rim, as seen. */
void circle_crossings(const Circle *circle, const Circle *rim, Angles *angles);

/* Of an arc: 1/2 n . integral of (r - r0) x dr, r = X / |X|; and a length that is not less than
 * the one that is seen [rad]. pivot = n x r0: round a closed curve any r0 will do, but the pieces'
 * ends agree to rounding only; with r0 amid the light that costs rounding times the light's size,
 * not times 1. */
double arc_integral(const Circle *circle, Interval arc, Vec3d normal, Vec3d pivot);
double arc_length(const Circle *circle, Interval arc);

#endif
