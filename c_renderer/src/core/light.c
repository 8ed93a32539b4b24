#include "light.h"

bool light_is_surface(const Light *light)
{
    switch (light->type) {
    case LIGHT_POINT:
        return false;
    case LIGHT_QUAD:
    case LIGHT_DISK:
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        break;
    }
    return true;
}

bool light_is_flat(const Light *light, FlatLight *flat)
{
    switch (light->type) {
    case LIGHT_POINT:
    case LIGHT_SPHERE:
        break;
    case LIGHT_QUAD:
        *flat = light->shape.quad;
        return true;
    case LIGHT_DISK:
        *flat = disk_square(&light->shape.disk);
        return true;
    case LIGHT_TRIANGLE:
        *flat = light->shape.triangle;
        return true;
    }
    return false;
}

Rgb light_radiance(const Light *light)
{
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return light->shape.quad.radiance;
    case LIGHT_DISK:
        return light->shape.disk.radiance;
    case LIGHT_TRIANGLE:
        return light->shape.triangle.radiance;
    case LIGHT_SPHERE:
        return light->shape.sphere.radiance;
    }
    return light->shape.point.radiant_intensity;
}

real light_area(const Light *light)
{
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return light->shape.quad.area;
    case LIGHT_DISK:
        return light->shape.disk.area;
    case LIGHT_TRIANGLE:
        return light->shape.triangle.area;
    case LIGHT_SPHERE:
        return light->shape.sphere.area;
    }
    return 0;
}

bool light_shines_on(const Light *light, Vec3 point)
{
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return flat_height(&light->shape.quad, point) > 0;
    case LIGHT_DISK:
        return vec3_dot(light->shape.disk.normal, vec3_sub(light->shape.disk.center, point)) > 0;
    case LIGHT_TRIANGLE:
        return flat_height(&light->shape.triangle, point) > 0;
    case LIGHT_SPHERE:
        return vec3_length(vec3_sub(light->shape.sphere.center, point)) >
               light->shape.sphere.radius;
    }
    return true;
}

real light_distance(const Light *light, Vec3 point)
{
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return quad_distance(&light->shape.quad, point);
    case LIGHT_DISK:
        return disk_distance(&light->shape.disk, point);
    case LIGHT_TRIANGLE:
        return triangle_distance(&light->shape.triangle, point);
    case LIGHT_SPHERE:
        return sphere_distance(&light->shape.sphere, point);
    }
    return vec3_length(vec3_sub(light->shape.point.position, point));
}

real light_highest(const Light *light, Vec3 direction)
{
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return quad_highest(&light->shape.quad, direction);
    case LIGHT_DISK:
        return disk_highest(&light->shape.disk, direction);
    case LIGHT_TRIANGLE:
        return triangle_highest(&light->shape.triangle, direction);
    case LIGHT_SPHERE:
        return sphere_highest(&light->shape.sphere, direction);
    }
    return vec3_dot(direction, light->shape.point.position);
}

/* Whether the light's directions can be sampled from there; then sampler->seen is set. */
static bool sees_directions(LightSampler *sampler)
{
    const Light *light = sampler->light;
    const Vec3 point = sampler->point;
    switch (light->type) {
    case LIGHT_POINT:
    case LIGHT_DISK:
        break;
    case LIGHT_QUAD:
        return flat_height(&light->shape.quad, point) > 0 &&
               spherical_rectangle_create(&sampler->seen.rectangle, &light->shape.quad, point);
    case LIGHT_TRIANGLE:
        return spherical_triangle_create(&sampler->seen.triangle, &light->shape.triangle, point);
    case LIGHT_SPHERE:
        return sphere_cone_create(&sampler->seen.cone, &light->shape.sphere, point);
    }
    return false;
}

void light_sampler_create(LightSampler *sampler, const Light *light, Vec3 point, Spread spread)
{
    sampler->light = light;
    sampler->point = point;
    sampler->spread = SPREAD_AREA;
    light_is_flat(light, &sampler->flat);
    if (spread == SPREAD_SOLID_ANGLE && sees_directions(sampler))
        sampler->spread = SPREAD_SOLID_ANGLE;
}

static LightSample point_light_sample(const PointLight *light, Vec3 point)
{
    LightSample sample = {.pdf_solid_angle = 1};
    Vec3 to_light = vec3_sub(light->position, point);
    real distance_squared = vec3_dot(to_light, to_light); /* [m^2] */
    if (distance_squared > 0) {
        sample.distance = sqrt(distance_squared);
        sample.direction = vec3_scale(to_light, 1 / sample.distance);
        real falloff = real_finite(1 / distance_squared);
        sample.radiance = rgb_finite(rgb_scale(light->radiant_intensity, falloff));
    }
    return sample;
}

/* Step (a) of the handout, a uniform random position on the light, and the others. */
static LightSample flat_sample(const LightSampler *sampler, Place place)
{
    const FlatLight *flat = &sampler->flat;
    return light_sample_of_place(flat_from_point(flat, sampler->point, place), flat->normal,
                                 flat->area, flat->radiance);
}

static LightSample sample_by_area(const LightSampler *sampler, Uniform2 random)
{
    const Light *light = sampler->light;
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        return flat_sample(sampler, quad_place(random));
    case LIGHT_DISK:
        return flat_sample(sampler, disk_place(random));
    case LIGHT_TRIANGLE:
        return flat_sample(sampler, triangle_place(random));
    case LIGHT_SPHERE:
        return sphere_sample(&light->shape.sphere, sampler->point, random);
    }
    return point_light_sample(&light->shape.point, sampler->point);
}

static LightSample sample_directions(const LightSampler *sampler, Uniform2 random)
{
    const SphericalRectangle *rectangle = &sampler->seen.rectangle;
    const SphericalTriangle *triangle = &sampler->seen.triangle;
    const SphereCone *cone = &sampler->seen.cone;
    const Rgb radiance = light_radiance(sampler->light);
    switch (sampler->light->type) {
    case LIGHT_POINT:
    case LIGHT_DISK:
        break;
    case LIGHT_QUAD: {
        const Place place = spherical_rectangle_place(*rectangle, random);
        const Vec3 to_light = flat_from_point(&sampler->flat, sampler->point, place);
        return light_sample_of_direction(to_light, (real)rectangle->solid_angle, radiance);
    }
    case LIGHT_TRIANGLE:
        return light_sample_of_direction(spherical_triangle_place(triangle, random),
                                         triangle->solid_angle, radiance);
    case LIGHT_SPHERE:
        return light_sample_of_direction(sphere_cone_place(cone, random), cone->solid_angle,
                                         radiance);
    }
    return (LightSample){0};
}

LightSample light_sampler_draw(const LightSampler *sampler, Uniform2 random)
{
    return sampler->spread == SPREAD_SOLID_ANGLE ? sample_directions(sampler, random)
                                                 : sample_by_area(sampler, random);
}
