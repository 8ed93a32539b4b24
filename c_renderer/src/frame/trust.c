#include "trust.h"

#include "core/light.h"

/* Nearer than this, a spot gets too few samples: N pi d^2 / A = TRUST_SPOT_SAMPLES. */
static double least_distance(const Light *light, double samples)
{
    return sqrt(TRUST_SPOT_SAMPLES * (double)light_area(light) / (PI * samples));
}

/* Heights of the light's lowest and highest point along a direction [m]. */
static void extent(const Light *light, Vec3 direction, double *low, double *high)
{
    *high = (double)light_highest(light, direction);
    *low = -(double)light_highest(light, vec3_scale(direction, -1));
}

/* The farthest that a place of the light may be from the point [m]. */
static double farthest(const Light *light, Vec3 point)
{
    const Vec3 axis[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    double squared = 0;
    for (int k = 0; k < 3; k++) {
        double low, high;
        extent(light, axis[k], &low, &high);
        const double at = (double)vec3_dot(axis[k], point), reach = fmax(high - at, at - low);
        squared += reach * reach;
    }
    return sqrt(squared);
}

/* Whether any surface comes so near: most scenes need no look at their pixels. */
static bool any_surface_within(const Scene *scene, const Light *light, double distance)
{
    for (int i = 0; i < scene->nb_spheres; i++) {
        const Sphere *sphere = &scene->spheres[i];
        const double radius = (double)sphere->radius;
        if ((double)light_distance(light, sphere->center) - radius <= distance &&
            farthest(light, sphere->center) >= radius - distance)
            return true;
    }
    for (int i = 0; i < scene->nb_planes; i++) {
        const Plane *plane = &scene->planes[i];
        const double height = (double)vec3_dot(plane->normal, plane->point);
        double low, high;
        extent(light, plane->normal, &low, &high);
        if (low - height <= distance && high - height >= -distance)
            return true;
    }
    return false;
}

static bool may_have_spots(const Light *light)
{
    const Rgb radiance = light_radiance(light);
    return light_is_surface(light) && (radiance.r > 0 || radiance.g > 0 || radiance.b > 0);
}

/* Samples that are spread over the solid angle have no spot, however near the light is. */
static bool has_spot(Estimator estimator, const Light *light, const Hit *hit)
{
    LightSampler sampler;
    if (estimator != ESTIMATOR_SOLID_ANGLE)
        return true;
    light_sampler_create(&sampler, light, hit->point, SPREAD_SOLID_ANGLE);
    return sampler.spread == SPREAD_AREA;
}

static bool is_untrusted(const Scene *scene, Estimator estimator, const Hit *hit, double samples)
{
    for (int i = 0; i < scene->nb_lights; i++) {
        const Light *light = &scene->lights[i];
        if (may_have_spots(light) && light_shines_on(light, hit->point) &&
            (double)light_distance(light, hit->point) < least_distance(light, samples) &&
            has_spot(estimator, light, hit))
            return true;
    }
    return false;
}

int trust_untrusted_pixels(const Scene *scene, const RenderSettings *settings, int light_samples)
{
    const int width = settings->width, height = settings->height;
    const double samples = (double)light_samples * settings->samples_per_pixel;
    bool any = false;
    for (int i = 0; i < scene->nb_lights && settings->estimator != ESTIMATOR_EXACT; i++) {
        const Light *light = &scene->lights[i];
        any |= may_have_spots(light) &&
               any_surface_within(scene, light, least_distance(light, samples));
    }
    if (!any)
        return 0;
    int untrusted = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(settings->threads)                       \
    reduction(+ : untrusted)
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const Ray ray =
                camera_ray(&scene->camera, (real)x + (real)0.5, (real)y + (real)0.5, width, height);
            const Hit hit = scene_hit(scene, ray);
            untrusted += hit.object != SCENE_NOTHING &&
                         is_untrusted(scene, settings->estimator, &hit, samples);
        }
    return untrusted;
}
