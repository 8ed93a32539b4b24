/* The lab's loop as a student writes it who cares for speed: one sample after the other, a small
 * fast random number generator for each row, sums in float, no variance. loop.c times it. */
#include <stddef.h>

#include "other.h"

const char *const OTHER_VERSION = PENUMBRA_VERSION;

/* Marsaglia, "Xorshift RNGs", Journal of Statistical Software 8(14), 2003 */
static real random_real(uint32_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return (real)(*state >> 8) * 0x1p-24f;
}

/* Mean of cos cos' / d^2 over the visible samples. */
static real mean_geometry(const Scene *scene, const QuadLight *light, const Hit *hit, int count,
                          uint32_t *state)
{
    real sum = 0;
    for (int s = 0; s < count; s++) {
        Vec3 position = vec3_along(light->corner, light->edge_u, random_real(state));
        position = vec3_along(position, light->edge_v, random_real(state));
        Vec3 to_light = vec3_sub(position, hit->point);
        real distance_squared = vec3_dot(to_light, to_light), distance = sqrt(distance_squared);
        Ray ray = {hit->point, vec3_scale(to_light, 1 / distance)};
        real cos_surface = vec3_dot(hit->normal, ray.direction);
        real cos_light = vec3_dot(light->normal, ray.direction);
        if (cos_surface > 0 && cos_light > 0 && !scene_occluded(scene, ray, distance, hit->object))
            sum += cos_surface * cos_light / distance_squared;
    }
    return sum / (real)count;
}

static Rgb pixel(const Scene *scene, const RenderSettings *settings, int x, int y, uint32_t *state)
{
    Ray ray = camera_ray(&scene->camera, (real)x + 0.5f, (real)y + 0.5f, settings->width,
                         settings->height);
    Hit hit = scene_hit(scene, ray);
    if (hit.object == SCENE_NOTHING)
        return scene->background;
    Rgb sum = {0, 0, 0};
    for (int k = 0; k < scene->nb_lights; k++) {
        const QuadLight *light = &scene->lights[k].shape.quad;
        real mean = mean_geometry(scene, light, &hit, settings->nb_light_samples, state);
        sum = rgb_add(sum, rgb_scale(light->radiance, light->area * mean));
    }
    return rgb_mul(hit.brdf, sum);
}

bool other_render(const Scene *scene, const RenderSettings *settings, float *radiance,
                  float *variance, RenderProgress *progress, void *user)
{
    (void)variance, (void)progress, (void)user;
    const size_t plane = (size_t)settings->width * (size_t)settings->height;
#pragma omp parallel for schedule(dynamic, 1) num_threads(settings->threads)
    for (int y = 0; y < settings->height; y++) {
        RngStream row = {settings->seed, (uint32_t)y, 0};
        uint32_t state = 1 + (uint32_t)(rng_uniform2(row, 0, 0).x * 0x1p24f);
        for (int x = 0; x < settings->width; x++) {
            Rgb value = pixel(scene, settings, x, y, &state);
            size_t at = (size_t)y * (size_t)settings->width + (size_t)x;
            radiance[at] = value.r;
            radiance[plane + at] = value.g;
            radiance[2 * plane + at] = value.b;
        }
    }
    return true;
}
