/* A rectangle seen from a point, sampled evenly over the directions that it covers.
 *
 * Urena, Fajardo, King, "An area-preserving parametrization for spherical rectangles", Computer
 * Graphics Forum 32(4), 2013. Worked in double: in float the angles' sum loses the solid angle of
 * small or grazing rectangles (docs/estimator.md). */
#ifndef PENUMBRA_SPHERICAL_RECTANGLE_H
#define PENUMBRA_SPHERICAL_RECTANGLE_H

#include <stdbool.h>

#include "light.h"

/* The rectangle in its own frame about the point: [x0, x1] x [y0, y1] at height z0 < 0. */
typedef struct {
    Vec3 x, y, z; /* axes */
    double x0, x1, y0, y1, z0;
    double b0, b1, k;   /* Urena's */
    double solid_angle; /* [sr] */
} SphericalRectangle;

/* False where the quad is no rectangle, the point is in its plane, or the solid angle is so small
 * (under 1e-7 sr) that it would be rounding: sample such a quad by area, which is then as good. */
bool spherical_rectangle_create(SphericalRectangle *rectangle, const QuadLight *light, Vec3 point);

/* light_sample with pdf 1 / solid_angle; the point must be in front of the light. */
LightSample spherical_rectangle_light_sample(const SphericalRectangle *rectangle,
                                             const QuadLight *light, Uniform2 random);

#endif
