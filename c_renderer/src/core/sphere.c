#include "sphere.h"

/* On the unit sphere, at a height of 1 - t over the plane across the axis z, t in [0, 2]: equal
 * steps of t are equal areas (Archimedes). */
static Vec3 unit_sphere_place(Vec3 x, Vec3 y, Vec3 z, real t, real turn)
{
    const real across = sqrt(t * (2 - t)), angle = (real)(2 * PI) * turn;
    Vec3 place = vec3_scale(x, across * cos(angle));
    place = vec3_along(place, y, across * sin(angle));
    return vec3_along(place, z, 1 - t);
}

LightSample sphere_sample(const SphereLight *light, Vec3 point, Uniform2 random)
{
    const Vec3 x = {1, 0, 0}, y = {0, 1, 0}, z = {0, 0, 1};
    const Vec3 outwards = unit_sphere_place(x, y, z, 2 * random.x, random.y);
    const Vec3 center = vec3_sub(light->center, point);
    return light_sample_of_place(vec3_along(center, outwards, light->radius),
                                 vec3_scale(outwards, -1), light->area, light->radiance);
}

real sphere_distance(const SphereLight *light, Vec3 point)
{
    return fabs(vec3_length(vec3_sub(light->center, point)) - light->radius);
}

real sphere_highest(const SphereLight *light, Vec3 direction)
{
    return vec3_dot(direction, light->center) + light->radius * vec3_length(direction);
}

bool sphere_cone_create(SphereCone *cone, const SphereLight *light, Vec3 point)
{
    const Vec3 center = vec3_sub(light->center, point);
    const real distance = vec3_length(center);
    if (distance <= light->radius)
        return false;
    const real sine = light->radius / distance;
    const real cosine = sqrt((distance - light->radius) * (distance + light->radius)) / distance;
    cone->axis = vec3_scale(center, 1 / distance);
    cone->x = vec3_across(cone->axis);
    cone->y = vec3_cross(cone->axis, cone->x);
    cone->distance = distance;
    cone->radius = light->radius;
    cone->height = sine * sine / (1 + cosine);
    cone->solid_angle = (real)(2 * PI) * cone->height;
    return cone->solid_angle > 0;
}

Vec3 sphere_cone_place(const SphereCone *cone, Uniform2 random)
{
    const real t = random.x * cone->height;
    const Vec3 direction = unit_sphere_place(cone->x, cone->y, cone->axis, t, random.y);
    /* the nearer of the two places where the ray meets the sphere: their product over the farther */
    const real d = cone->distance, r = cone->radius;
    const real middle = d * (1 - t), beside = d * sqrt(t * (2 - t));
    const real half_chord = sqrt(real_positive((r - beside) * (r + beside)));
    return vec3_scale(direction, (d - r) * (d + r) / (middle + half_chord));
}
