#include "light_sample.h"

LightSample light_sample_of_place(Vec3 to_light, Vec3 normal, real area, Rgb radiance)
{
    LightSample sample = {0};

    /* (b) the direction to it */
    real distance_squared = vec3_dot(to_light, to_light); /* [m^2] */
    if (distance_squared <= 0)
        return sample;
    sample.distance = sqrt(distance_squared);
    sample.direction = vec3_scale(to_light, 1 / sample.distance);

    /* (c) pdf_area = 1 / area, turned into a density of directions */
    real cos_light = vec3_dot(normal, sample.direction);
    if (cos_light <= 0)
        return sample;
    sample.pdf_solid_angle = real_finite(distance_squared / (area * cos_light)); /* [sr^-1] */

    /* (d) radiance over pdf */
    real inverse_pdf = real_finite(1 / sample.pdf_solid_angle);
    sample.radiance = rgb_finite(rgb_scale(radiance, inverse_pdf));
    return sample;
}

LightSample light_sample_of_direction(Vec3 to_light, real solid_angle, Rgb radiance)
{
    LightSample sample = {.distance = sqrt(vec3_dot(to_light, to_light))};
    sample.direction = vec3_scale(to_light, 1 / sample.distance);
    sample.pdf_solid_angle = 1 / solid_angle;
    sample.radiance = rgb_scale(radiance, solid_angle);
    return sample;
}
