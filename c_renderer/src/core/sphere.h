/* A sphere light, sampled by area or by the cone of directions that it covers. */
#ifndef PENUMBRA_SPHERE_H
#define PENUMBRA_SPHERE_H

#include <stdbool.h>

#include "light_sample.h"

/* It emits outwards, all around: nothing of it is seen from inside. */
typedef struct {
    Vec3 center;  /* [m] */
    real radius;  /* [m] */
    real area;    /* 4 pi radius^2 [m^2] */
    Rgb radiance; /* [W m^-2 sr^-1] */
} SphereLight;

/* A uniform random place on the whole sphere; half of them and more face away from the point. */
LightSample sphere_sample(const SphereLight *light, Vec3 point, Uniform2 random);

/* Distance from a point to the nearest place of it [m]. */
real sphere_distance(const SphereLight *light, Vec3 point);

/* The largest component of a place of it along a direction: its highest point [m]. */
real sphere_highest(const SphereLight *light, Vec3 direction);

/* The directions from a point outside to a sphere: a cone about the axis. */
typedef struct {
    Vec3 axis, x, y;       /* orthonormal */
    real distance, radius; /* of the centre, of the sphere [m] */
    real height;           /* 1 - cos of the half-angle, without cancellation */
    real solid_angle;      /* 2 pi height [sr] */
} SphereCone;

/* False where the point is inside or on the sphere, or so far that rounding hides it. */
bool sphere_cone_create(SphereCone *cone, const SphereLight *light, Vec3 point);

/* From the point to the sphere's near side [m], evenly over the cone's directions. */
Vec3 sphere_cone_place(const SphereCone *cone, Uniform2 random);

#endif
