/* The same image by Intel's Embree: its rays, and the textbook's light samples. loop.c times it. */
#if defined(__has_include) && __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "other.h"

enum { PACKET = 16 };

const char *const OTHER_VERSION = RTC_VERSION_STRING;

static const real START = 1e-4f; /* [m] shadow rays start there, for Embree knows no "not this" */

/* ---- Embree 3 and 4 differ in how they are asked ---- */

static void nearest_hit(RTCScene scene, struct RTCRayHit *ray)
{
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect1(scene, ray, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(scene, &context, ray);
#endif
}

/* tfar of those that are occluded becomes -inf */
static void occluded(RTCScene scene, const int valid[PACKET], struct RTCRay16 *rays)
{
#if RTC_VERSION_MAJOR >= 4
    rtcOccluded16(valid, scene, rays, NULL);
#else
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcOccluded16(valid, scene, &context, rays);
#endif
}

/* ---- the scene: object ids are Embree's geometry ids ---- */

static void add_sphere(RTCDevice device, RTCScene into, const Sphere *sphere)
{
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
    float *v = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4,
                                       4 * sizeof(float), 1);
    v[0] = sphere->center.x;
    v[1] = sphere->center.y;
    v[2] = sphere->center.z;
    v[3] = sphere->radius;
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(into, geometry);
    rtcReleaseGeometry(geometry);
}

/* A square about the point under the camera, beyond the end of every ray. */
static void add_plane(RTCDevice device, RTCScene into, const Plane *plane, const Scene *scene)
{
    Vec3 n = plane->normal, eye = scene->camera.position;
    Vec3 foot = vec3_along(eye, n, vec3_dot(n, vec3_sub(plane->point, eye)));
    Vec3 helper = fabs(n.x) < 0.5f ? (Vec3){1, 0, 0} : (Vec3){0, 1, 0};
    Vec3 a = vec3_normalize(vec3_along(helper, n, -vec3_dot(helper, n)));
    Vec3 b = {n.y * a.z - n.z * a.y, n.z * a.x - n.x * a.z, n.x * a.y - n.y * a.x};
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_QUAD);
    float *v = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                       3 * sizeof(float), 4);
    unsigned *index = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4,
                                              4 * sizeof(unsigned), 1);
    for (unsigned k = 0; k < 4; k++) {
        real half = 2 * scene->ray_max_distance;
        real along_a = k == 0 || k == 3 ? -half : half, along_b = k < 2 ? -half : half;
        Vec3 corner = vec3_along(vec3_along(foot, a, along_a), b, along_b);
        v[3 * k] = corner.x;
        v[3 * k + 1] = corner.y;
        v[3 * k + 2] = corner.z;
        index[k] = k;
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(into, geometry);
    rtcReleaseGeometry(geometry);
}

static RTCScene build(const Scene *scene)
{
    RTCDevice device = rtcNewDevice("threads=1"); /* to build; rays run on our threads */
    RTCScene into = rtcNewScene(device);
    for (int k = 0; k < scene->nb_spheres; k++)
        add_sphere(device, into, &scene->spheres[k]);
    for (int k = 0; k < scene->nb_planes; k++)
        add_plane(device, into, &scene->planes[k], scene);
    rtcCommitScene(into);
    return into;
}

/* ---- one pixel ---- */

static Hit hit(const Scene *scene, RTCScene traced, Ray ray)
{
    struct RTCRayHit query = {.ray = {.org_x = ray.origin.x,
                                      .org_y = ray.origin.y,
                                      .org_z = ray.origin.z,
                                      .dir_x = ray.direction.x,
                                      .dir_y = ray.direction.y,
                                      .dir_z = ray.direction.z,
                                      .tfar = scene->ray_max_distance,
                                      .mask = ~0u},
                              .hit = {.geomID = RTC_INVALID_GEOMETRY_ID}};
    nearest_hit(traced, &query);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID)
        return (Hit){.object = SCENE_NOTHING};
    Hit found = {.object = (int)query.hit.geomID};
    found.point = vec3_along(ray.origin, ray.direction, query.ray.tfar);
    if (found.object < scene->nb_spheres) {
        const Sphere *sphere = &scene->spheres[found.object];
        found.normal = vec3_normalize(vec3_sub(found.point, sphere->center));
        found.brdf = sphere->brdf;
    } else {
        const Plane *plane = &scene->planes[found.object - scene->nb_spheres];
        found.normal = plane->normal;
        found.brdf = plane->brdf;
    }
    if (vec3_dot(found.normal, ray.direction) > 0)
        found.normal = vec3_scale(found.normal, -1);
    return found;
}

/* Sixteen shadow rays at once: the light that arrives, times the surface's cosine. */
static Rgb packet_light(RTCScene traced, const Light *light, const Hit *from, RngStream stream,
                        int first, int count)
{
    RTC_ALIGN(64) int valid[PACKET] = {0};
    struct RTCRay16 rays;
    Rgb arriving[PACKET], sum = {0, 0, 0};
    for (int i = 0; i < count; i++) {
        Uniform2 place = rng_uniform2(stream, (uint32_t)(first + i), 1);
        LightSample sample = light_sample(light, from->point, place);
        real cosine = vec3_dot(from->normal, sample.direction);
        valid[i] = cosine > 0 && sample.pdf_solid_angle > 0 ? -1 : 0;
        arriving[i] = rgb_scale(sample.radiance, cosine);
        rays.org_x[i] = from->point.x;
        rays.org_y[i] = from->point.y;
        rays.org_z[i] = from->point.z;
        rays.dir_x[i] = sample.direction.x;
        rays.dir_y[i] = sample.direction.y;
        rays.dir_z[i] = sample.direction.z;
        rays.tnear[i] = START;
        rays.tfar[i] = sample.distance;
        rays.time[i] = 0;
        rays.mask[i] = ~0u;
        rays.id[i] = 0;
        rays.flags[i] = 0;
    }
    occluded(traced, valid, &rays);
    for (int i = 0; i < count; i++)
        if (valid[i] && rays.tfar[i] >= 0)
            sum = rgb_add(sum, arriving[i]);
    return sum;
}

static Rgb pixel(const Scene *scene, RTCScene traced, const RenderSettings *settings, int x, int y)
{
    Ray ray = camera_ray(&scene->camera, (real)x + 0.5f, (real)y + 0.5f, settings->width,
                         settings->height);
    Hit from = hit(scene, traced, ray);
    if (from.object == SCENE_NOTHING)
        return scene->background;
    const int n = settings->nb_light_samples;
    RngStream stream = {settings->seed, (uint32_t)(y * settings->width + x), 0};
    Rgb sum = {0, 0, 0};
    for (int k = 0; k < scene->nb_lights; k++)
        for (int first = 0; first < n; first += PACKET) {
            int count = n - first < PACKET ? n - first : PACKET;
            sum =
                rgb_add(sum, packet_light(traced, &scene->lights[k], &from, stream, first, count));
        }
    return rgb_mul(from.brdf, rgb_scale(sum, 1 / (real)n));
}

bool other_render(const Scene *scene, const RenderSettings *settings, float *radiance,
                  float *variance, RenderProgress *progress, void *user)
{
    static RTCScene traced; /* the process has one scene, and building it is not rendering */
    (void)variance, (void)progress, (void)user;
    if (!traced)
        traced = build(scene);
    const size_t plane = (size_t)settings->width * (size_t)settings->height;
#pragma omp parallel for schedule(dynamic, 1) num_threads(settings->threads)
    for (int y = 0; y < settings->height; y++)
        for (int x = 0; x < settings->width; x++) {
            Rgb value = pixel(scene, traced, settings, x, y);
            size_t at = (size_t)y * (size_t)settings->width + (size_t)x;
            radiance[at] = value.r;
            radiance[plane + at] = value.g;
            radiance[2 * plane + at] = value.b;
        }
    return true;
}
