#include "estimator.h"

/* f_r * (L_e / p) * cos * V     docs/estimator.md, eq. 5 */
Rgb shadow_ray_radiance(const Scene *scene, const Hit *hit, LightSample sample)
{
    real cos_surface = vec3_dot(hit->normal, sample.direction);
    if (cos_surface <= 0 || sample.pdf_solid_angle <= 0)
        return (Rgb){0, 0, 0};

    Ray shadow_ray = {hit->point, sample.direction};
    if (scene_occluded(scene, shadow_ray, sample.distance, hit->object))
        return (Rgb){0, 0, 0};

    return rgb_finite(rgb_scale(rgb_mul(hit->brdf, sample.radiance), cos_surface));
}

Estimate light_estimate(const Scene *scene, int light, const Hit *hit, const PointSet *points,
                        Spread spread, RngStream stream)
{
    LightSampler sampler;
    light_sampler_create(&sampler, &scene->lights[light], hit->point, spread);
    const int nb_samples = light_is_surface(sampler.light) ? points->count : 1;

    Moments moments = {0};
    for (int s = 0; s < nb_samples; s++) {
        Uniform2 random = point_set_get(points, stream, (uint32_t)s, (uint32_t)light + 1);
        LightSample sample = light_sampler_draw(&sampler, random);
        moments_add(&moments, shadow_ray_radiance(scene, hit, sample));
    }
    return moments_estimate(&moments);
}

Estimate direct_lighting(const Scene *scene, const Hit *hit, const PointSet *points, Spread spread,
                         RngStream stream)
{
    Estimate total = {0};
    for (int light = 0; light < scene->nb_lights; light++) {
        Estimate mean = light_estimate(scene, light, hit, points, spread, stream);
        total.radiance = rgb_finite(rgb_add(total.radiance, mean.radiance));
        total.variance = rgb_finite(rgb_add(total.variance, mean.variance));
    }
    return total;
}

void moments_add(Moments *moments, Rgb value)
{
    const double channel[3] = {value.r, value.g, value.b};
    for (int c = 0; c < 3; c++) {
        moments->sum[c] += channel[c];
        moments->sum_of_squares[c] += channel[c] * channel[c];
    }
    moments->count++;
}

/* mean = sum / n,   variance of the mean = (sum of squares - n mean^2) / (n - 1) / n */
Estimate moments_estimate(const Moments *moments)
{
    double mean[3], variance[3] = {0, 0, 0};
    double n = moments->count;
    for (int c = 0; c < 3; c++) {
        mean[c] = moments->sum[c] / n;
        if (n > 1) {
            double scatter = moments->sum_of_squares[c] - moments->sum[c] * mean[c];
            variance[c] = fmin(fmax(scatter, 0.0) / (n - 1) / n, (double)REAL_MAX);
        }
    }
    return (Estimate){{(real)mean[0], (real)mean[1], (real)mean[2]},
                      {(real)variance[0], (real)variance[1], (real)variance[2]}};
}
