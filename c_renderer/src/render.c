#include "render.h"

#include <omp.h>

#include "estimator.h"

static Estimate ray_radiance(const Scene *scene, Ray ray, int nb_light_samples,
                             RngStream stream)
{
    Hit hit = scene_hit(scene, ray);
    if (hit.object == SCENE_NOTHING)
        return (Estimate){.radiance = scene->background};
    return direct_lighting(scene, &hit, nb_light_samples, stream);
}

static Estimate pixel_radiance(const Scene *scene, const RenderSettings *settings, int x,
                               int y)
{
    int width = settings->width, height = settings->height;
    RngStream stream = {settings->seed, (uint32_t)y * (uint32_t)width + (uint32_t)x, 0};

    if (settings->samples_per_pixel == 1) {
        Ray ray = camera_ray(&scene->camera, (real)x + 0.5f, (real)y + 0.5f, width, height);
        return ray_radiance(scene, ray, settings->nb_light_samples, stream);
    }

    Moments moments = {0};
    for (int s = 0; s < settings->samples_per_pixel; s++) {
        stream.pixel_sample = (uint32_t)s;
        Uniform2 place = rng_uniform2(stream, 0, 0);
        Ray ray =
            camera_ray(&scene->camera, (real)x + place.x, (real)y + place.y, width, height);
        Estimate estimate = ray_radiance(scene, ray, settings->nb_light_samples, stream);
        moments_add(&moments, estimate.radiance);
    }
    return moments_estimate(&moments);
}

static void store(float *buffer, long long pixel, Rgb value)
{
    buffer[3 * pixel] = (float)value.r;
    buffer[3 * pixel + 1] = (float)value.g;
    buffer[3 * pixel + 2] = (float)value.b;
}

void render(const Scene *scene, const RenderSettings *settings, float *radiance,
            float *variance, RenderProgress *progress, void *user)
{
    int rows_done = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(settings->threads)
    for (int y = 0; y < settings->height; y++) {
        for (int x = 0; x < settings->width; x++) {
            Estimate estimate = pixel_radiance(scene, settings, x, y);
            long long pixel = (long long)y * settings->width + x;
            store(radiance, pixel, estimate.radiance);
            store(variance, pixel, estimate.variance);
        }
        int done;
#pragma omp atomic capture
        done = ++rows_done;
        if (progress && omp_get_thread_num() == 0)
            progress(done, settings->height, user);
    }
}

bool render_knows_variance(const Scene *scene, const RenderSettings *settings)
{
    if (settings->samples_per_pixel > 1 || settings->nb_light_samples > 1)
        return true;
    for (int i = 0; i < scene->nb_lights; i++)
        if (light_is_surface(&scene->lights[i]))
            return false;
    return true;
}
