#include "trust.h"

#include "core/spherical_rectangle.h"
#include "exact/vec3d.h"
#include "packet/irradiance_packet.h"

static const double PI = 3.14159265358979323846;

static double distance_to_segment(Vec3d from, Vec3d start, Vec3d edge)
{
    Vec3d offset = vec3d_sub(from, start);
    double t = vec3d_dot(offset, edge) / vec3d_dot(edge, edge);
    t = fmin(fmax(t, 0), 1);
    return vec3d_length(vec3d_sub(offset, vec3d_scale(edge, t)));
}

static double distance_to_quad(const QuadLight *light, Vec3d point)
{
    const Vec3d u = vec3d_from(light->edge_u), v = vec3d_from(light->edge_v);
    const Vec3d corner = vec3d_from(light->corner), n = vec3d_unit(vec3d_cross(u, v));
    const Vec3d offset = vec3d_sub(point, corner);
    /* offset = s u + t v + height n */
    const Vec3d across_u = vec3d_cross(n, u), across_v = vec3d_cross(v, n);
    const double s = vec3d_dot(offset, across_v) / vec3d_dot(u, across_v);
    const double t = vec3d_dot(offset, across_u) / vec3d_dot(v, across_u);
    if (s >= 0 && s <= 1 && t >= 0 && t <= 1)
        return fabs(vec3d_dot(offset, n));
    return fmin(fmin(distance_to_segment(point, corner, u), distance_to_segment(point, corner, v)),
                fmin(distance_to_segment(point, vec3d_add(corner, v), u),
                     distance_to_segment(point, vec3d_add(corner, u), v)));
}

double trust_distance(const QuadLight *light, Vec3 point)
{
    const Vec3d to_corner = vec3d_sub(vec3d_from(light->corner), vec3d_from(point));
    if (vec3d_dot(vec3d_from(light->normal), to_corner) <= 0)
        return INFINITY;
    return distance_to_quad(light, vec3d_from(point));
}

/* Nearer than this, a spot gets too few samples: N pi d^2 / A = TRUST_SPOT_SAMPLES. */
static double least_distance(const QuadLight *light, double samples)
{
    return sqrt(TRUST_SPOT_SAMPLES * (double)light->area / (PI * samples));
}

/* Whether any surface comes so near: most scenes need no look at their pixels. */
static bool any_surface_within(const Scene *scene, const QuadLight *light, double distance)
{
    const Vec3d corner = vec3d_from(light->corner);
    const Vec3d u = vec3d_from(light->edge_u), v = vec3d_from(light->edge_v);
    for (int i = 0; i < scene->nb_spheres; i++) {
        const Sphere *sphere = &scene->spheres[i];
        const double radius = (double)sphere->radius;
        const double to_center = distance_to_quad(light, vec3d_from(sphere->center));
        const double reach = vec3d_length(u) + vec3d_length(v); /* of the light */
        if (to_center - radius <= distance && to_center + reach >= radius - distance)
            return true;
    }
    for (int i = 0; i < scene->nb_planes; i++) {
        const Vec3d n = vec3d_from(scene->planes[i].normal);
        const double height = vec3d_dot(n, vec3d_sub(corner, vec3d_from(scene->planes[i].point)));
        const double along_u = vec3d_dot(n, u), along_v = vec3d_dot(n, v);
        const double low = height + fmin(along_u, 0) + fmin(along_v, 0);
        const double high = height + fmax(along_u, 0) + fmax(along_v, 0);
        if (low <= distance && high >= -distance)
            return true;
    }
    return false;
}

static bool is_black(Rgb radiance)
{
    return radiance.r <= 0 && radiance.g <= 0 && radiance.b <= 0;
}

/* Whether ESTIMATOR_HYBRID takes the light's closed form there. */
static bool is_known(const Scene *scene, const QuadLight *light, const Hit *hit)
{
    HitPacket hits = {.any_hit = true};
    double irradiance[LANES];
    int known[LANES];
    for (int i = 0; i < LANES; i++)
        hits.object[i] = SCENE_NOTHING;
    hits.object[0] = hit->object;
    hits.point.x[0] = hit->point.x, hits.normal.x[0] = hit->normal.x;
    hits.point.y[0] = hit->point.y, hits.normal.y[0] = hit->normal.y;
    hits.point.z[0] = hit->point.z, hits.normal.z[0] = hit->normal.z;
    irradiance_packet_of_plain(scene, light, &hits, irradiance, known);
    return known[0];
}

/* Whether so near a light has no spot: its samples are spread over the solid angle, or none. */
static bool has_no_spot(const Scene *scene, Estimator estimator, const QuadLight *light,
                        const Hit *hit)
{
    SphericalRectangle rectangle;
    if (estimator == ESTIMATOR_SOLID_ANGLE)
        return spherical_rectangle_create(&rectangle, light, hit->point);
    return estimator == ESTIMATOR_HYBRID && is_known(scene, light, hit);
}

static bool is_untrusted(const Scene *scene, Estimator estimator, const Hit *hit, double samples)
{
    for (int i = 0; i < scene->nb_lights; i++) {
        const QuadLight *light = &scene->lights[i].shape.quad;
        if (scene->lights[i].type == LIGHT_QUAD && !is_black(light->radiance) &&
            trust_distance(light, hit->point) < least_distance(light, samples) &&
            !has_no_spot(scene, estimator, light, hit))
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
        const QuadLight *light = &scene->lights[i].shape.quad;
        any |= scene->lights[i].type == LIGHT_QUAD && !is_black(light->radiance) &&
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
