#include "triangle.h"

#define MIN_SOLID_ANGLE ((real)1e-9f) /* [sr] */

real triangle_distance(const TriangleLight *light, Vec3 point)
{
    const Vec3 corner = light->corner, u = light->edge_u, v = light->edge_v;
    Place foot = flat_foot(light, point);
    if (foot.s >= 0 && foot.t >= 0 && foot.s + foot.t <= 1)
        return fabs(flat_height(light, point));
    return fmin(fmin(edge_distance(corner, u, point), edge_distance(corner, v, point)),
                edge_distance(vec3_add(corner, u), vec3_sub(v, u), point));
}

real triangle_highest(const TriangleLight *light, Vec3 direction)
{
    real along_u = vec3_dot(direction, light->edge_u), along_v = vec3_dot(direction, light->edge_v);
    return vec3_dot(direction, light->corner) +
           real_positive(along_u > along_v ? along_u : along_v);
}

bool spherical_triangle_create(SphericalTriangle *triangle, const TriangleLight *light, Vec3 point)
{
    SphericalTriangle t = {.normal = light->normal, .height = flat_height(light, point)};
    if (t.height <= 0)
        return false;
    const Vec3 p0 = vec3_sub(light->corner, point), e1 = light->edge_u, e2 = light->edge_v;
    const Vec3 p1 = vec3_add(p0, e1), p2 = vec3_add(p0, e2);
    const real l0 = vec3_length(p0), l1 = vec3_length(p1), l2 = vec3_length(p2);
    t.w0 = vec3_scale(p0, 1 / l0);
    t.w1 = vec3_scale(p1, 1 / l1);
    t.w2 = vec3_scale(p2, 1 / l2);
    t.g0 = fabs(vec3_dot(t.w0, vec3_cross(e1, e2))) / (l1 * l2);
    t.g1 = vec3_dot(t.w0, t.w2) + vec3_dot(t.w1, t.w2);
    t.g2 = 1 + vec3_dot(t.w0, t.w1);
    t.solid_angle = 2 * atan2(t.g0, t.g1 + t.g2);
    *triangle = t;
    return t.solid_angle >= MIN_SOLID_ANGLE;
}

Vec3 spherical_triangle_place(const SphericalTriangle *triangle, Uniform2 random)
{
    const SphericalTriangle *t = triangle;

    /* the corner w of a triangle with the share u of the solid angle */
    const real half = random.x * t->solid_angle / 2, sine = sin(half), cosine = cos(half);
    Vec3 r = vec3_scale(t->w0, t->g0 * cosine - t->g1 * sine);
    r = vec3_along(r, t->w2, t->g2 * sine);
    const real r_squared = vec3_dot(r, r);
    const real along = r_squared > 0 ? 2 * vec3_dot(t->w0, r) / r_squared : 0;
    const Vec3 w = vec3_sub(vec3_scale(r, along), t->w0);

    /* a place on the arc from w1 to it, even in height */
    const Vec3 d = vec3_sub(w, t->w1);
    const real q = vec3_dot(d, d) / 2, v = random.y;
    const real share = sqrt(v * (2 - v * q) / (2 - q));
    Vec3 direction = vec3_scale(t->w1, 1 + q * (share - v));
    direction = vec3_along(direction, d, share);
    return vec3_scale(direction, t->height / vec3_dot(t->normal, direction));
}
