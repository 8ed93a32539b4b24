/* Any light: which shape it is, and the answers that depend on that. */
#ifndef PENUMBRA_LIGHT_H
#define PENUMBRA_LIGHT_H

#include "disk.h"
#include "quad.h"
#include "sphere.h"
#include "triangle.h"

typedef enum { LIGHT_POINT, LIGHT_QUAD, LIGHT_DISK, LIGHT_TRIANGLE, LIGHT_SPHERE } LightType;

typedef struct {
    Vec3 position;         /* [m] */
    Rgb radiant_intensity; /* [W sr^-1] */
} PointLight;

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

/* The lab's isSurface(): whether sampling it needs more than one shadow ray. */
bool light_is_surface(const Light *light);

/* Whether it is a flat light, and then its parallelogram and area. */
bool light_is_flat(const Light *light, FlatLight *flat);

Rgb light_radiance(const Light *light); /* [W m^-2 sr^-1]; a point light's is its intensity */
real light_area(const Light *light);    /* [m^2]; 0 of a point light */

/* Whether the point is on a side of the light that shines: before a flat light's plane, outside of
 * a sphere. */
bool light_shines_on(const Light *light, Vec3 point);

/* Distance from the point to the light's nearest place [m]. */
real light_distance(const Light *light, Vec3 point);

/* The largest component of a place of the light along a direction: its highest point [m]. */
real light_highest(const Light *light, Vec3 direction);

/* How a surface light's points are spread: evenly over its area (the lab's), or evenly over the
 * directions that it covers: quads that are rectangles, triangles, and spheres. Other lights, and
 * those that are too small or too low for it, are sampled by area. */
typedef enum { SPREAD_AREA, SPREAD_SOLID_ANGLE } Spread;

/* One light seen from one point, made ready for its samples. */
typedef struct {
    const Light *light; /* must outlive it */
    Vec3 point;         /* [m] */
    Spread spread;      /* what the samples will have */
    FlatLight flat;     /* of a flat light */
    union {
        SphericalRectangle rectangle;
        SphericalTriangle triangle;
        SphereCone cone;
    } seen; /* SPREAD_SOLID_ANGLE: by the light's type */
} LightSampler;

void light_sampler_create(LightSampler *sampler, const Light *light, Vec3 point, Spread spread);

/* The light that arrives at the point from one place on the light: zero radiance from the dark
 * side of a light or from a point in its plane. Visibility is not its business. */
LightSample light_sampler_draw(const LightSampler *sampler, Uniform2 random);

#endif
