/* Light shapes, and one random sample of the light that arrives from them. */
#ifndef PENUMBRA_LIGHT_H
#define PENUMBRA_LIGHT_H

#include <stdbool.h>

#include "rng.h"
#include "vec3.h"

typedef enum { LIGHT_POINT, LIGHT_QUAD, LIGHT_DISK, LIGHT_TRIANGLE, LIGHT_SPHERE } LightType;

typedef struct {
    Vec3 position;         /* [m] */
    Rgb radiant_intensity; /* [W sr^-1] */
} PointLight;

/* The parallelogram corner + s * edge_u + t * edge_v, s and t in [0, 1). It emits on the side
 * that -normal faces, and only there. */
typedef struct {
    Vec3 corner;         /* [m] */
    Vec3 edge_u, edge_v; /* [m] */
    Vec3 normal;         /* normalize(u x v) */
    real area;           /* |u x v| [m^2] */
    Rgb radiance;        /* [W m^-2 sr^-1] */
} QuadLight;

/* It emits on the side that -normal faces, and only there. */
typedef struct {
    Vec3 center; /* [m] */
    Vec3 normal; /* unit */
    real radius; /* [m] */
    real area;   /* pi radius^2 [m^2] */
    Rgb radiance;
} DiskLight;

/* The half corner + s * edge_u + t * edge_v, s + t <= 1, of a parallelogram, one-sided like it. */
typedef struct {
    Vec3 corner;         /* [m] */
    Vec3 edge_u, edge_v; /* [m] */
    Vec3 normal;         /* normalize(u x v) */
    real area;           /* |u x v| / 2 [m^2] */
    Rgb radiance;
} TriangleLight;

/* It emits outwards, all around. */
typedef struct {
    Vec3 center; /* [m] */
    real radius; /* [m] */
    real area;   /* 4 pi radius^2 [m^2] */
    Rgb radiance;
} SphereLight;

typedef struct {
    LightType type;
    union {
        PointLight point;
        QuadLight quad;
        DiskLight disk;
        TriangleLight triangle;
        SphereLight sphere;
    } shape;
} Light;

/* The lab's LightSample. Its pdf is the density of the direction, per solid angle; a point
 * light has one direction, with pdf 1 by convention. */
typedef struct {
    Vec3 direction;       /* unit, from the surface to the light */
    real distance;        /* [m] */
    Rgb radiance;         /* emitted radiance / pdf_solid_angle: already divided, step (d) */
    real pdf_solid_angle; /* [sr^-1]; 0 where the light's dark side is seen */
} LightSample;

/* The lab's isSurface(): whether sampling it needs more than one shadow ray. */
bool light_is_surface(const Light *light);

/* The light that arrives at point from a random place on the light: zero radiance from the
 * back of a quad or from a point in its plane. Visibility is not its business. */
LightSample light_sample(const Light *light, Vec3 point, Uniform2 random);

#endif
