/* Surfaces, and where a ray meets them. */
#ifndef PENUMBRA_SHAPE_H
#define PENUMBRA_SHAPE_H

#include <stdbool.h>

#include "vec3.h"

typedef struct {
    Vec3 origin;    /* [m] */
    Vec3 direction; /* unit */
} Ray;

typedef struct {
    Vec3 center; /* [m] */
    real radius; /* [m] */
    Rgb brdf;    /* the lab's flat colour [sr^-1] */
} Sphere;

/* Infinite; both sides reflect. */
typedef struct {
    Vec3 point;  /* [m] */
    Vec3 normal; /* unit */
    Rgb brdf;    /* [sr^-1] */
} Plane;

/* Distance [m] to the first meeting ahead of the origin, 0 where there is none. From inside a
 * sphere that is its far wall. */
real sphere_hit(const Sphere *sphere, Ray ray);
real plane_hit(const Plane *plane, Ray ray);

/* Distance to the far wall for a ray that starts on the sphere itself, 0 for a ray that goes
 * outwards: no start offset is needed. */
real sphere_hit_from_its_surface(const Sphere *sphere, Ray ray);

#endif
