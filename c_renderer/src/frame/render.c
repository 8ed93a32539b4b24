#include "render.h"

#include <omp.h>
#include <string.h>

#include "core/estimator.h"
#include "packet/adaptive.h"

const char *const RENDER_SAMPLER_NAMES[3] = {"independent", "jittered", "sobol"};
const char *const RENDER_ESTIMATOR_NAMES[4] = {"area", "textbook", "solid-angle", "exact"};

/* The image being made, and what it is made from. */
typedef struct {
    const Scene *scene;
    const RenderSettings *settings;
    const PointSet *points;
    ImagePlane plane;
    const Target *target;       /* NULL: as many samples as there are points */
    float *radiance, *variance; /* three planes each; variance NULL: not wanted */
} Job;

static size_t plane_size(const RenderSettings *settings)
{
    return (size_t)settings->width * (size_t)settings->height;
}

static RngStream pixel_stream(const Job *job, int x, int y)
{
    uint32_t pixel = (uint32_t)y * (uint32_t)job->settings->width + (uint32_t)x;
    return (RngStream){job->settings->seed, pixel, 0};
}

/* A float image's largest number stands for all above it. */
static inline float stored(real value)
{
    return value > FLT_MAX ? FLT_MAX : (float)value;
}

/* ---- as it is taught: one pixel after the other ---- */

static Estimate ray_radiance(const Job *job, real x, real y, RngStream stream)
{
    const Scene *scene = job->scene;
    Ray ray = camera_ray(&scene->camera, x, y, job->settings->width, job->settings->height);
    Hit hit = scene_hit(scene, ray);
    if (hit.object == SCENE_NOTHING)
        return (Estimate){.radiance = scene->background};
    return direct_lighting(scene, &hit, job->points, SPREAD_AREA, stream);
}

static Estimate pixel_radiance(const Job *job, int x, int y)
{
    RngStream stream = pixel_stream(job, x, y);
    if (job->settings->samples_per_pixel == 1)
        return ray_radiance(job, (real)x + 0.5f, (real)y + 0.5f, stream);

    Moments moments = {0};
    for (int s = 0; s < job->settings->samples_per_pixel; s++) {
        stream.pixel_sample = (uint32_t)s;
        Uniform2 place = rng_uniform2(stream, 0, 0);
        Estimate estimate = ray_radiance(job, (real)x + place.x, (real)y + place.y, stream);
        moments_add(&moments, estimate.radiance);
    }
    return moments_estimate(&moments);
}

static void render_row(const Job *job, int y)
{
    const size_t plane = plane_size(job->settings);
    for (int x = 0; x < job->settings->width; x++) {
        Estimate estimate = pixel_radiance(job, x, y);
        size_t pixel = (size_t)y * (size_t)job->settings->width + (size_t)x;
        job->radiance[pixel] = stored(estimate.radiance.r);
        job->radiance[plane + pixel] = stored(estimate.radiance.g);
        job->radiance[2 * plane + pixel] = stored(estimate.radiance.b);
        if (!job->variance)
            continue;
        job->variance[pixel] = stored(estimate.variance.r);
        job->variance[plane + pixel] = stored(estimate.variance.g);
        job->variance[2 * plane + pixel] = stored(estimate.variance.b);
    }
}

/* ---- the same, sixteen pixels at a time, several times ---- */

/* Neighbouring packets of one row. */
typedef struct {
    int nb_packets;
    int x0, y0;      /* the first pixel */
    RngStream first; /* its */
    EstimatePacket estimate[MAX_PACKETS];
    AdaptivePacket spent[MAX_PACKETS];
} Stretch;

static void choose_places(const Job *job, const Stretch *stretch, int p, real x[LANES],
                          real y[LANES])
{
    const int x0 = stretch->x0 + p * LANES, y0 = stretch->y0;
    SIMD for (int i = 0; i < LANES; i++)
    {
        x[i] = (real)(x0 + i) + 0.5f;
        y[i] = (real)y0 + 0.5f;
    }
    if (job->settings->samples_per_pixel == 1)
        return;
    const RngStream first = stretch->first;
    SIMD for (int i = 0; i < LANES; i++)
    {
        uint32_t pixel = first.pixel + (uint32_t)(p * LANES + i);
        RngBlock counter = {{pixel, 0, first.pixel_sample, 0}};
        RngBlock place = rng_threefry4x32(counter, rng_key(first.seed));
        x[i] = (real)(x0 + i) + rng_to_uniform(place.word[0]);
        y[i] = (real)y0 + rng_to_uniform(place.word[1]);
    }
}

static void show_background(Rgb background, const HitPacket *hits, EstimatePacket *estimate)
{
    if (hits->all_hit)
        return;
    SIMD for (int i = 0; i < LANES; i++)
    {
        int empty = hits->object[i] == SCENE_NOTHING;
        estimate->radiance.r[i] = empty ? background.r : estimate->radiance.r[i];
        estimate->radiance.g[i] = empty ? background.g : estimate->radiance.g[i];
        estimate->radiance.b[i] = empty ? background.b : estimate->radiance.b[i];
    }
}

/* One ray through each pixel. */
static void stretch_radiance(const Job *job, Stretch *stretch)
{
    const RenderSettings *settings = job->settings;
    HitPacket hits[MAX_PACKETS];
    for (int p = 0; p < stretch->nb_packets; p++) {
        real x[LANES], y[LANES];
        choose_places(job, stretch, p, x, y);
        packet_hit(job->scene, &job->plane, x, y, &hits[p]);
    }
    const bool by_angle = settings->estimator == ESTIMATOR_SOLID_ANGLE;
    if (!job->target && (by_angle || settings->estimator == ESTIMATOR_AREA))
        packet_direct_lighting(job->scene, hits, stretch->nb_packets, job->points,
                               by_angle ? SPREAD_SOLID_ANGLE : SPREAD_AREA, stretch->first,
                               stretch->estimate);
    for (int p = 0; p < stretch->nb_packets; p++) {
        RngStream first = stretch->first;
        first.pixel += (uint32_t)(p * LANES);
        EstimatePacket *estimate = &stretch->estimate[p];
        if (job->target)
            adaptive_direct_lighting(job->scene, &hits[p], job->target, first, estimate,
                                     &stretch->spent[p]);
        else if (settings->estimator == ESTIMATOR_EXACT)
            packet_exact_lighting(job->scene, &hits[p], estimate);
        show_background(job->scene->background, &hits[p], estimate);
    }
}

/* moments_add and moments_estimate for one colour channel of all lanes. */
static void channel_moments(const real value[LANES], double sum[LANES],
                            double sum_of_squares[LANES])
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        double finite = (double)real_finite(value[i]);
        sum[i] += finite;
        sum_of_squares[i] += finite * finite;
    }
}

static void channel_estimate(const double sum[LANES], const double sum_of_squares[LANES], int n,
                             real mean[LANES], real variance[LANES])
{
    const double count = n;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double average = sum[i] / count;
        double scatter = sum_of_squares[i] - sum[i] * average;
        mean[i] = (real)average;
        variance[i] = (real)((scatter > 0 ? scatter : 0) / (count - 1) / count);
    }
}

typedef struct {
    double sum[3][LANES], sum_of_squares[3][LANES];
} MomentsPacket;

static void stretch_pixels(const Job *job, Stretch *stretch)
{
    const int n = job->settings->samples_per_pixel;
    if (n == 1) {
        stretch_radiance(job, stretch);
        return;
    }
    MomentsPacket moments[MAX_PACKETS] = {0};
    for (int s = 0; s < n; s++) {
        stretch->first.pixel_sample = (uint32_t)s;
        stretch_radiance(job, stretch);
        for (int p = 0; p < stretch->nb_packets; p++) {
            const RgbPacket *radiance = &stretch->estimate[p].radiance;
            channel_moments(radiance->r, moments[p].sum[0], moments[p].sum_of_squares[0]);
            channel_moments(radiance->g, moments[p].sum[1], moments[p].sum_of_squares[1]);
            channel_moments(radiance->b, moments[p].sum[2], moments[p].sum_of_squares[2]);
        }
    }
    for (int p = 0; p < stretch->nb_packets; p++) {
        EstimatePacket *e = &stretch->estimate[p];
        const MomentsPacket *m = &moments[p];
        channel_estimate(m->sum[0], m->sum_of_squares[0], n, e->radiance.r, e->variance.r);
        channel_estimate(m->sum[1], m->sum_of_squares[1], n, e->radiance.g, e->variance.g);
        channel_estimate(m->sum[2], m->sum_of_squares[2], n, e->radiance.b, e->variance.b);
    }
}

static void store_lanes(float *plane, size_t pixel, int count, const real value[LANES])
{
    float *const place = plane + pixel;
    if (count == LANES)
        SIMD for (int i = 0; i < LANES; i++) place[i] = stored(value[i]);
    else
        for (int i = 0; i < count; i++)
            place[i] = stored(value[i]);
}

static void store_packet(const Job *job, size_t pixel, int count, const EstimatePacket *packet)
{
    const size_t plane = plane_size(job->settings);
    store_lanes(job->radiance, pixel, count, packet->radiance.r);
    store_lanes(job->radiance + plane, pixel, count, packet->radiance.g);
    store_lanes(job->radiance + 2 * plane, pixel, count, packet->radiance.b);
    if (!job->variance)
        return;
    store_lanes(job->variance, pixel, count, packet->variance.r);
    store_lanes(job->variance + plane, pixel, count, packet->variance.g);
    store_lanes(job->variance + 2 * plane, pixel, count, packet->variance.b);
}

static RenderSpent render_row_in_packets(const Job *job, int y)
{
    RenderSpent row = {0, 0};
    const int width = job->settings->width;
    Stretch stretch;
    stretch.y0 = y;
    for (int x0 = 0; x0 < width; x0 += MAX_PACKETS * LANES) {
        const int packets = (width - x0 + LANES - 1) / LANES;
        stretch.nb_packets = packets < MAX_PACKETS ? packets : MAX_PACKETS;
        stretch.x0 = x0;
        stretch.first = pixel_stream(job, x0, y);
        stretch_pixels(job, &stretch);
        for (int p = 0; p < stretch.nb_packets; p++) {
            const int x = x0 + p * LANES, count = width - x < LANES ? width - x : LANES;
            store_packet(job, (size_t)y * (size_t)width + (size_t)x, count, &stretch.estimate[p]);
            for (int i = 0; i < count && job->target; i++) {
                row.light_samples += stretch.spent[p].light_samples[i];
                row.pixels_above += !stretch.spent[p].reached[i];
            }
        }
    }
    return row;
}

/* ---- all rows, on all threads ---- */

static RenderSpent render_one_row(const Job *job, int y)
{
    if (job->settings->estimator != ESTIMATOR_TEXTBOOK)
        return render_row_in_packets(job, y);
    render_row(job, y);
    return (RenderSpent){0, 0};
}

static RenderSpent render_job(const Job *job, int first, int step, RenderProgress *progress,
                              void *user)
{
    const int height = job->settings->height, rows = (height - first + step - 1) / step;
    double light_samples = 0, pixels_above = 0; /* whole numbers: any order gives one sum */
    int rows_done = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(job->settings->threads)                  \
    reduction(+ : light_samples, pixels_above)
    for (int y = first; y < height; y += step) {
        RenderSpent row = render_one_row(job, y);
        light_samples += row.light_samples;
        pixels_above += row.pixels_above;
        int done;
#pragma omp atomic capture
        done = ++rows_done;
        if (progress && omp_get_thread_num() == 0)
            progress(done, rows, user);
    }
    return (RenderSpent){light_samples, pixels_above};
}

bool render(const Scene *scene, const RenderSettings *settings, float *radiance, float *variance,
            RenderProgress *progress, void *user)
{
    return render_rows(scene, settings, 0, 1, radiance, variance, progress, user);
}

bool render_rows(const Scene *scene, const RenderSettings *settings, int first, int step,
                 float *radiance, float *variance, RenderProgress *progress, void *user)
{
    PointSet points;
    if (!point_set_create(&points, settings->sampler, settings->nb_light_samples, settings->seed))
        return false;
    const ImagePlane plane = image_plane(&scene->camera, settings->width, settings->height);
    const Job job = {scene, settings, &points, plane, NULL, radiance, variance};
    render_job(&job, first, step, progress, user);
    point_set_free(&points);
    return true;
}

RenderSpent render_to_target(const Scene *scene, const RenderSettings *settings,
                             double target_error, float *radiance, float *variance,
                             RenderProgress *progress, void *user)
{
    const Target target = {target_error, settings->nb_light_samples};
    const ImagePlane plane = image_plane(&scene->camera, settings->width, settings->height);
    const Job job = {scene, settings, NULL, plane, &target, radiance, variance};
    return render_job(&job, 0, 1, progress, user);
}

bool render_knows_variance(const Scene *scene, const RenderSettings *settings)
{
    if (settings->samples_per_pixel > 1 || settings->estimator == ESTIMATOR_EXACT)
        return true;
    if (settings->nb_light_samples > 1 && settings->sampler == SAMPLER_INDEPENDENT)
        return true;
    for (int i = 0; i < scene->nb_lights; i++)
        if (light_is_surface(&scene->lights[i]))
            return false;
    return true;
}
