/* A triangle light: the half s + t <= 1 of a parallelogram, sampled by area or by solid angle. */
#ifndef PENUMBRA_TRIANGLE_H
#define PENUMBRA_TRIANGLE_H

#include <stdbool.h>

#include "flat.h"

typedef FlatLight TriangleLight;

/* Uniform over the area. Never by folding the square's other half back: that would halve the slope
 * at which well-spread points converge. */
static ALWAYS_INLINE Place triangle_place(Uniform2 random)
{
    real root = sqrt(random.x);
    return (Place){1 - root, random.y * root};
}

/* Distance from a point to the nearest place of it [m]. */
real triangle_distance(const TriangleLight *light, Vec3 point);

/* The largest component of a place of it along a direction: its highest point [m]. */
real triangle_highest(const TriangleLight *light, Vec3 direction);

/* A triangle seen from a point, sampled evenly over the directions that it covers: Arvo,
 * "Stratified sampling of spherical triangles", SIGGRAPH 1995, in the form of Peters, "BRDF
 * importance sampling for polygonal lights", SIGGRAPH 2021, which keeps float's digits down to
 * 1e-10 sr. */
typedef struct {
    Vec3 w0, w1, w2;  /* unit vectors to the corners */
    real g0, g1, g2;  /* tan(solid_angle / 2) = g0 / (g1 + g2) */
    real solid_angle; /* [sr] */
    Vec3 normal;      /* the light's */
    real height;      /* of its plane over the point [m] */
} SphericalTriangle;

/* False where the point is in the triangle's plane or behind it, or the solid angle is so small
 * that it would be rounding: sample such a triangle by area, which is then as good. */
bool spherical_triangle_create(SphericalTriangle *triangle, const TriangleLight *light, Vec3 point);

/* From the point to a place of the triangle [m]. */
Vec3 spherical_triangle_place(const SphericalTriangle *triangle, Uniform2 random);

#endif
