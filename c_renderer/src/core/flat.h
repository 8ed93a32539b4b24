/* A flat light in its parallelogram: what quad, triangle and disk lights have in common.
 *
 * A place on it is corner + s * edge_u + t * edge_v; which (s, t) in [0, 1]^2 are the light, and how
 * two random numbers become one of them, is the shape's own: its `place`. */
#ifndef PENUMBRA_FLAT_H
#define PENUMBRA_FLAT_H

#include "light_sample.h"

/* Small functions of plain values, for one point and, in loops over lanes, for many: a request that
 * the compiler is right without. */
#if defined(__GNUC__)
#define ALWAYS_INLINE inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE inline
#endif

/* A place in the parallelogram, as shares of its edges. */
typedef struct {
    real s, t;
} Place;

/* It emits on the side that -normal faces, and only there. */
typedef struct {
    Vec3 corner;         /* [m] */
    Vec3 edge_u, edge_v; /* [m] */
    Vec3 normal;         /* normalize(u x v) */
    real area;           /* of the light, not of its parallelogram [m^2] */
    Rgb radiance;        /* [W m^-2 sr^-1] */
} FlatLight;

/* The place, from the point [m]. */
static inline Vec3 flat_from_point(const FlatLight *light, Vec3 point, Place place)
{
    Vec3 position = vec3_along(light->corner, light->edge_u, place.s);
    position = vec3_along(position, light->edge_v, place.t);
    return vec3_sub(position, point);
}

/* How far the point is before the light's plane [m]; below 0 on the dark side. */
static inline real flat_height(const FlatLight *light, Vec3 point)
{
    return vec3_dot(light->normal, vec3_sub(light->corner, point));
}

/* The shares of the foot of the point's perpendicular on the light's plane. */
Place flat_foot(const FlatLight *light, Vec3 point);

/* Distance from the point to the nearest place of an edge [m]. */
real edge_distance(Vec3 start, Vec3 edge, Vec3 point);

#endif
