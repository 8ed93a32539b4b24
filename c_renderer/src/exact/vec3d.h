/* Points and directions in double precision, by value. */
#ifndef PENUMBRA_VEC3D_H
#define PENUMBRA_VEC3D_H

#include "core/vec3.h"

typedef struct {
    double x, y, z;
} Vec3d;

static inline Vec3d vec3d_from(Vec3 a)
{
    return (Vec3d){(double)a.x, (double)a.y, (double)a.z};
}

static inline Vec3d vec3d_add(Vec3d a, Vec3d b)
{
    return (Vec3d){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline Vec3d vec3d_sub(Vec3d a, Vec3d b)
{
    return (Vec3d){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline Vec3d vec3d_scale(Vec3d a, double k)
{
    return (Vec3d){a.x * k, a.y * k, a.z * k};
}

static inline double vec3d_dot(Vec3d a, Vec3d b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline Vec3d vec3d_cross(Vec3d a, Vec3d b)
{
    return (Vec3d){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double vec3d_length(Vec3d a)
{
    return sqrt(vec3d_dot(a, a));
}

/* The zero vector stays. */
static inline Vec3d vec3d_unit(Vec3d a)
{
    double length = vec3d_length(a);
    return length > 0 ? vec3d_scale(a, 1 / length) : a;
}

/* a + t * b */
static inline Vec3d vec3d_along(Vec3d a, Vec3d b, double t)
{
    return (Vec3d){a.x + t * b.x, a.y + t * b.y, a.z + t * b.z};
}

/* Of the vector, the part across a unit vector. */
static inline Vec3d vec3d_reject(Vec3d a, Vec3d unit)
{
    return vec3d_along(a, unit, -vec3d_dot(a, unit));
}

/* A unit vector across another one: Duff et al., "Building an orthonormal basis, revisited", JCGT
 * 6(1), 2017. */
static inline Vec3d vec3d_across(Vec3d unit)
{
    double sign = unit.z < 0 ? -1 : 1, a = -1 / (sign + unit.z);
    return (Vec3d){1 + sign * unit.x * unit.x * a, sign * unit.x * unit.y * a, -sign * unit.x};
}

#endif
