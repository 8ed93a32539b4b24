#include "light.h"

bool light_is_surface(const Light *light)
{
    return light->type != LIGHT_POINT;
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

/* The handout's QuadLight::sample, steps (a) to (d); docs/estimator.md derives them. */
static LightSample quad_light_sample(const QuadLight *light, Vec3 point, Uniform2 random)
{
    LightSample sample = {0};

    /* (a) a uniform random position on the quad */
    Vec3 position = vec3_along(light->corner, light->edge_u, random.x);
    position = vec3_along(position, light->edge_v, random.y);

    /* (b) the direction to it */
    Vec3 to_light = vec3_sub(position, point);
    real distance_squared = vec3_dot(to_light, to_light); /* [m^2] */
    if (distance_squared <= 0)
        return sample;
    sample.distance = sqrt(distance_squared);
    sample.direction = vec3_scale(to_light, 1 / sample.distance);

    /* (c) pdf_area = 1 / area, turned into a density of directions */
    real cos_light = vec3_dot(light->normal, sample.direction);
    if (cos_light <= 0)
        return sample;
    sample.pdf_solid_angle =
        real_finite(distance_squared / (light->area * cos_light)); /* [sr^-1] */

    /* (d) radiance over pdf */
    real inverse_pdf = real_finite(1 / sample.pdf_solid_angle);
    sample.radiance = rgb_finite(rgb_scale(light->radiance, inverse_pdf));
    return sample;
}

LightSample light_sample(const Light *light, Vec3 point, Uniform2 random)
{
    switch (light->type) {
    case LIGHT_POINT:
        return point_light_sample(&light->shape.point, point);
    case LIGHT_QUAD:
        return quad_light_sample(&light->shape.quad, point, random);
    case LIGHT_DISK:
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        break;
    }
    return (LightSample){0};
}
