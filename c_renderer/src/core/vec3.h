/* Points, directions and linear RGB colours, by value. */
#ifndef PENUMBRA_VEC3_H
#define PENUMBRA_VEC3_H

#include <float.h>
#include <tgmath.h>

/* The renderer's precision, chosen when it is compiled: float64 is the yardstick of float32's
 * rounding. <tgmath.h> picks sqrtf or sqrt to match. */
#ifdef PENUMBRA_FLOAT64
typedef double real;
#define REAL_NAME "float64"
#define REAL_MAX DBL_MAX
#else
typedef float real;
#define REAL_NAME "float32"
#define REAL_MAX FLT_MAX
#endif

#define PI 3.14159265358979323846

typedef struct {
    real x, y, z;
} Vec3;

typedef struct {
    real r, g, b;
} Rgb;

static inline Vec3 vec3_add(Vec3 a, Vec3 b)
{
    return (Vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline Vec3 vec3_sub(Vec3 a, Vec3 b)
{
    return (Vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline Vec3 vec3_scale(Vec3 a, real k)
{
    return (Vec3){a.x * k, a.y * k, a.z * k};
}

/* origin + t * direction */
static inline Vec3 vec3_along(Vec3 origin, Vec3 direction, real t)
{
    return vec3_add(origin, vec3_scale(direction, t));
}

static inline real vec3_dot(Vec3 a, Vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline Vec3 vec3_cross(Vec3 a, Vec3 b)
{
    return (Vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline real vec3_length(Vec3 a)
{
    return sqrt(vec3_dot(a, a));
}

/* A unit vector across another one: Duff et al., "Building an orthonormal basis, revisited", JCGT
 * 6(1), 2017. */
static inline Vec3 vec3_across(Vec3 unit)
{
    real sign = unit.z < 0 ? (real)-1 : (real)1, a = -1 / (sign + unit.z);
    return (Vec3){1 + sign * unit.x * unit.x * a, sign * unit.x * unit.y * a, -sign * unit.x};
}

/* The zero vector stays zero: beside the square of a scene's lengths, 1e-9 m and more, FLT_MIN is
 * lost. */
static inline Vec3 vec3_normalize(Vec3 a)
{
    return vec3_scale(a, 1 / sqrt(vec3_dot(a, a) + FLT_MIN));
}

static inline real real_positive(real a)
{
    return a > 0 ? a : 0;
}

/* What is too large for a number is the largest one: Inf times 0, a black surface's, would be NaN.
 * A NaN stays one. */
static inline real real_finite(real a)
{
    return a > REAL_MAX ? REAL_MAX : a;
}

static inline Rgb rgb_finite(Rgb a)
{
    return (Rgb){real_finite(a.r), real_finite(a.g), real_finite(a.b)};
}

static inline Rgb rgb_add(Rgb a, Rgb b)
{
    return (Rgb){a.r + b.r, a.g + b.g, a.b + b.b};
}

static inline Rgb rgb_mul(Rgb a, Rgb b)
{
    return (Rgb){a.r * b.r, a.g * b.g, a.b * b.b};
}

static inline Rgb rgb_scale(Rgb a, real k)
{
    return (Rgb){a.r * k, a.g * k, a.b * k};
}

#endif
