#include "render.h"

#include <omp.h>
#include <string.h>

#include "adaptive.h"
#include "estimator.h"

const char *const RENDER_SAMPLER_NAMES[3] = {"independent", "jittered", "sobol"};
const char *const RENDER_ESTIMATOR_NAMES[5] = {"area", "textbook", "solid-angle", "hybrid",
                                               "exact"};

/* The image being made, and what it is made from. */
typedef struct {
    const Scene *scene;
    const RenderSettings *settings;
    const PointSet *points;
    const Target *target;       /* NULL: as many samples as there are points */
    float *radiance, *variance; /* three planes each */
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

/* ---- as it is taught: one pixel after the other ---- */

static Estimate ray_radiance(const Job *job, real x, real y, RngStream stream)
{
    const Scene *scene = job->scene;
    Ray ray = camera_ray(&scene->camera, x, y, job->settings->width, job->settings->height);
    Hit hit = scene_hit(scene, ray);
    if (hit.object == SCENE_NOTHING)
        return (Estimate){.radiance = scene->background};
    Spread spread =
        job->settings->estimator == ESTIMATOR_SOLID_ANGLE ? SPREAD_SOLID_ANGLE : SPREAD_AREA;
    return direct_lighting(scene, &hit, job->points, spread, stream);
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
        job->radiance[pixel] = (float)estimate.radiance.r;
        job->radiance[plane + pixel] = (float)estimate.radiance.g;
        job->radiance[2 * plane + pixel] = (float)estimate.radiance.b;
        job->variance[pixel] = (float)estimate.variance.r;
        job->variance[plane + pixel] = (float)estimate.variance.g;
        job->variance[2 * plane + pixel] = (float)estimate.variance.b;
    }
}

/* ---- the same, sixteen pixels at a time ---- */

static void packet_radiance(const Job *job, const real x[LANES], const real y[LANES],
                            RngStream first, EstimatePacket *result, AdaptivePacket *spent)
{
    const Rgb background = job->scene->background;
    HitPacket hits;
    packet_hit(job->scene, x, y, job->settings->width, job->settings->height, &hits);
    if (job->target)
        adaptive_direct_lighting(job->scene, &hits, job->target, first, result, spent);
    else if (job->settings->estimator == ESTIMATOR_EXACT)
        kernel_exact_lighting(job->scene, &hits, result);
    else
        kernel_direct_lighting(job->scene, &hits, job->points,
                               job->settings->estimator == ESTIMATOR_HYBRID, first, result);
    if (hits.nb_hits == LANES)
        return;
    SIMD for (int i = 0; i < LANES; i++)
    {
        int empty = hits.object[i] == SCENE_NOTHING;
        result->radiance.r[i] = empty ? background.r : result->radiance.r[i];
        result->radiance.g[i] = empty ? background.g : result->radiance.g[i];
        result->radiance.b[i] = empty ? background.b : result->radiance.b[i];
    }
}

/* moments_add and moments_estimate for one colour channel of all lanes. */
static void channel_moments(const real value[LANES], double sum[LANES],
                            double sum_of_squares[LANES])
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        sum[i] += (double)value[i];
        sum_of_squares[i] += (double)value[i] * (double)value[i];
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

static void packet_pixels(const Job *job, int x0, int y0, EstimatePacket *result,
                          AdaptivePacket *spent)
{
    RngStream first = pixel_stream(job, x0, y0);
    real x[LANES], y[LANES];
    if (job->settings->samples_per_pixel == 1) {
        for (int i = 0; i < LANES; i++) {
            x[i] = (real)(x0 + i) + 0.5f;
            y[i] = (real)y0 + 0.5f;
        }
        packet_radiance(job, x, y, first, result, spent);
        return;
    }

    double sum[3][LANES] = {{0}}, sum_of_squares[3][LANES] = {{0}};
    for (int s = 0; s < job->settings->samples_per_pixel; s++) {
        first.pixel_sample = (uint32_t)s;
        SIMD for (int i = 0; i < LANES; i++)
        {
            RngBlock counter = {{first.pixel + (uint32_t)i, 0, first.pixel_sample, 0}};
            RngBlock place = rng_philox4x32(counter, first.seed);
            x[i] = (real)(x0 + i) + rng_to_uniform(place.word[0]);
            y[i] = (real)y0 + rng_to_uniform(place.word[1]);
        }
        packet_radiance(job, x, y, first, result, spent);
        channel_moments(result->radiance.r, sum[0], sum_of_squares[0]);
        channel_moments(result->radiance.g, sum[1], sum_of_squares[1]);
        channel_moments(result->radiance.b, sum[2], sum_of_squares[2]);
    }
    const int n = job->settings->samples_per_pixel;
    channel_estimate(sum[0], sum_of_squares[0], n, result->radiance.r, result->variance.r);
    channel_estimate(sum[1], sum_of_squares[1], n, result->radiance.g, result->variance.g);
    channel_estimate(sum[2], sum_of_squares[2], n, result->radiance.b, result->variance.b);
}

static void store_lanes(float *plane, size_t pixel, int count, const real value[LANES])
{
    for (int i = 0; i < count; i++)
        plane[pixel + (size_t)i] = (float)value[i];
}

static RenderSpent render_row_in_packets(const Job *job, int y)
{
    RenderSpent row = {0, 0};
    const int width = job->settings->width;
    const size_t plane = plane_size(job->settings);
    for (int x = 0; x < width; x += LANES) {
        EstimatePacket packet;
        AdaptivePacket spent;
        packet_pixels(job, x, y, &packet, &spent);
        size_t pixel = (size_t)y * (size_t)width + (size_t)x;
        int count = width - x < LANES ? width - x : LANES;
        store_lanes(job->radiance, pixel, count, packet.radiance.r);
        store_lanes(job->radiance + plane, pixel, count, packet.radiance.g);
        store_lanes(job->radiance + 2 * plane, pixel, count, packet.radiance.b);
        store_lanes(job->variance, pixel, count, packet.variance.r);
        store_lanes(job->variance + plane, pixel, count, packet.variance.g);
        store_lanes(job->variance + 2 * plane, pixel, count, packet.variance.b);
        for (int i = 0; i < count && job->target; i++) {
            row.light_samples += spent.light_samples[i];
            row.pixels_above += !spent.reached[i];
        }
    }
    return row;
}

/* ---- all rows, on all threads ---- */

static RenderSpent render_one_row(const Job *job, int y)
{
    switch (job->settings->estimator) {
    case ESTIMATOR_TEXTBOOK:
    case ESTIMATOR_SOLID_ANGLE:
        render_row(job, y);
        return (RenderSpent){0, 0};
    case ESTIMATOR_AREA:
    case ESTIMATOR_HYBRID:
    case ESTIMATOR_EXACT:
        break;
    }
    return render_row_in_packets(job, y);
}

static RenderSpent render_rows(const Job *job, RenderProgress *progress, void *user)
{
    const int height = job->settings->height;
    double light_samples = 0, pixels_above = 0; /* whole numbers: any order gives one sum */
    int rows_done = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(job->settings->threads)                  \
    reduction(+ : light_samples, pixels_above)
    for (int y = 0; y < height; y++) {
        RenderSpent row = render_one_row(job, y);
        light_samples += row.light_samples;
        pixels_above += row.pixels_above;
        int done;
#pragma omp atomic capture
        done = ++rows_done;
        if (progress && omp_get_thread_num() == 0)
            progress(done, height, user);
    }
    return (RenderSpent){light_samples, pixels_above};
}

bool render(const Scene *scene, const RenderSettings *settings, float *radiance, float *variance,
            RenderProgress *progress, void *user)
{
    PointSet points;
    if (!point_set_create(&points, settings->sampler, settings->nb_light_samples, settings->seed))
        return false;
    const Job job = {scene, settings, &points, NULL, radiance, variance};
    render_rows(&job, progress, user);
    point_set_free(&points);
    return true;
}

RenderSpent render_to_target(const Scene *scene, const RenderSettings *settings,
                             double target_error, float *radiance, float *variance,
                             RenderProgress *progress, void *user)
{
    const Target target = {target_error, settings->nb_light_samples};
    const Job job = {scene, settings, NULL, &target, radiance, variance};
    return render_rows(&job, progress, user);
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
