/* The lab's quad light: a parallelogram, sampled by area or, where it is a rectangle, by solid
 * angle: Urena, Fajardo, King, "An area-preserving parametrization for spherical rectangles",
 * Computer Graphics Forum 32(4), 2013, worked in double: in float the angles' sum loses the solid
 * angle of small or grazing rectangles (docs/estimator.md). */
#ifndef PENUMBRA_QUAD_H
#define PENUMBRA_QUAD_H

#include <stdbool.h>

#include "flat.h"

/* All of the parallelogram: s and t in [0, 1). */
typedef FlatLight QuadLight;

static inline Place quad_place(Uniform2 random)
{
    return (Place){random.x, random.y};
}

/* Distance from a point to the nearest place of the parallelogram [m]. */
real quad_distance(const QuadLight *light, Vec3 point);

/* The largest component of a place of it along a direction: its highest point [m]. */
real quad_highest(const QuadLight *light, Vec3 direction);

/* A rectangle seen from a point, in its own frame about it: [x0, x1] x [y0, y1] at height z0 < 0. */
typedef struct {
    double x0, x1, y0, y1, z0;
    double b0, b1, k;    /* Urena's */
    double c;            /* 1 - b0^2 */
    double solid_angle;  /* [sr] */
    double per_x, per_y; /* 1 / (x1 - x0), 1 / (y1 - y0) */
} SphericalRectangle;

/* False where the quad is no rectangle, the point is in its plane, or the solid angle is so small
 * (under 1e-7 sr) that it would be rounding: sample such a quad by area, which is then as good. */
bool spherical_rectangle_create(SphericalRectangle *rectangle, const QuadLight *light, Vec3 point);

/* sin(x) / x and cos(x) for y = x^2, |x| <= pi / 2, within 2e-17 and 6e-17 but for rounding: by
 * interpolation at Chebyshev's points. */
static ALWAYS_INLINE double sine_ratio(double y)
{
    double p = 2.7215749422983443e-15;
    p = p * y - 7.643026557971632e-13;
    p = p * y + 1.605894087848656e-10;
    p = p * y - 2.505210689056952e-08;
    p = p * y + 2.7557319211229606e-06;
    p = p * y - 0.00019841269841208676;
    p = p * y + 0.008333333333333186;
    p = p * y - 0.16666666666666666;
    return p * y + 1;
}

static ALWAYS_INLINE double cosine(double y)
{
    double p = 4.608977003001797e-14;
    p = p * y - 1.1462901901757276e-11;
    p = p * y + 2.0876561839933163e-09;
    p = p * y - 2.755731639102575e-07;
    p = p * y + 2.4801587277414926e-05;
    p = p * y - 0.001388888888877299;
    p = p * y + 0.04166666666666388;
    p = p * y - 0.4999999999999997;
    return p * y + 1;
}

static ALWAYS_INLINE double clamped(double value, double low, double high)
{
    value = value > low ? value : low;
    return value < high ? value : high;
}

/* The place such that directions to it are spread evenly over the solid angle. */
static ALWAYS_INLINE Place spherical_rectangle_place(SphericalRectangle r, Uniform2 random)
{
    const double least = 1e-300; /* instead of 0 under a square root: the clamp does the rest */

    /* Urena's angle, which has the share u of the solid angle on its one side, is in [0, 2 pi]:
     * half of its distance from pi */
    double half = 0.5 * ((double)random.x * r.solid_angle + (r.k - PI));
    double sine = half * sine_ratio(half * half), cos_half = cosine(half * half);
    double sin_angle = -2 * sine * cos_half, cos_angle = 2 * sine * sine - 1;

    /* his f is p / sin(angle); his x, without dividing by the sine, is */
    double p = cos_angle * r.b0 - r.b1;
    double under = p * p - r.c * (sin_angle * sin_angle);
    under = under > least ? under : least;
    double x = -r.z0 * (p < 0 ? -sin_angle : sin_angle) / sqrt(under);
    x = clamped(x, r.x0, r.x1);

    /* his h0, h1 and h, the height on the sphere, even in v, times both lengths */
    double d_squared = x * x + r.z0 * r.z0;
    double squared0 = d_squared + r.y0 * r.y0, squared1 = d_squared + r.y1 * r.y1;
    double h0 = r.y0 * sqrt(squared1), h1 = r.y1 * sqrt(squared0);
    double h = h0 + (double)random.y * (h1 - h0);
    double rest = squared0 * squared1 - h * h;
    rest = rest > least ? rest : least;
    double y = clamped(h * sqrt(d_squared / rest), r.y0, r.y1);
    return (Place){(real)((x - r.x0) * r.per_x), (real)((y - r.y0) * r.per_y)};
}

#endif
