#include "disk.h"

FlatLight disk_square(const DiskLight *light)
{
    const Vec3 x = vec3_across(light->normal), y = vec3_cross(light->normal, x);
    FlatLight square = {.normal = light->normal, .area = light->area, .radiance = light->radiance};
    square.corner = vec3_along(vec3_along(light->center, x, -light->radius), y, -light->radius);
    square.edge_u = vec3_scale(x, 2 * light->radius);
    square.edge_v = vec3_scale(y, 2 * light->radius);
    return square;
}

/* Of a vector, the part across the unit normal. */
static real length_across(Vec3 vector, Vec3 normal)
{
    return vec3_length(vec3_along(vector, normal, -vec3_dot(vector, normal)));
}

real disk_distance(const DiskLight *light, Vec3 point)
{
    const Vec3 offset = vec3_sub(point, light->center);
    const real height = vec3_dot(offset, light->normal);
    const real beyond = real_positive(length_across(offset, light->normal) - light->radius);
    return sqrt(height * height + beyond * beyond);
}

real disk_highest(const DiskLight *light, Vec3 direction)
{
    return vec3_dot(direction, light->center) +
           light->radius * length_across(direction, light->normal);
}
