#include "adaptive.h"

#include <string.h>

#define CONFIDENCE 2.0 /* standard errors of a 95% interval: Student's t at 63 degrees, 1.998 */

enum { COMPANIONS = 4 };

/* Of lights that the sample loop does not know: sphere lights take far fewer samples so. */
static const Spread UNKNOWN_SPREAD = SPREAD_SOLID_ANGLE;

/* Numbers that the image does not use: added to a light's dimension; as a pixel sample. */
enum { PILOT_DIMENSION = 1 << 20, PILOT_SAMPLE = 1, UNHIDDEN_SAMPLE = 2 };

/* Mean and variance of one sample. */
typedef struct {
    double mean, variance;
} OneSample;

/* From the sums of n samples and of their squares, with two visible and two hidden samples of that
 * value added where something may hide some: of n that all saw the light, the next may not (Agresti
 * and Coull's "plus four", The American Statistician 52(2), 1998). The variance of lanes that only
 * look lit or hidden so far is then never 0. */
static OneSample with_companions(double sum, double squares, double n, double companion)
{
    n += companion > 0 ? COMPANIONS : 0;
    const double mean = (sum + 2 * companion) / n;
    const double scatter = (squares + 2 * companion * companion) / n - mean * mean;
    return (OneSample){mean, fmax(scatter, 0)};
}

/* A flat light's samples, f_r L_e = 1. */
typedef struct {
    OneSample one[LANES];
    double estimate[LANES]; /* the plain mean */
    double count[LANES];    /* samples with companions */
} SampleMoments;

static int may_be_hidden(const LightPacket *light, int lane)
{
    for (int k = 0; k < light->nb_occluders; k++)
        if (light->sphere_x[k][lane] != 0 || light->sphere_y[k][lane] != 0 ||
            light->sphere_h[k][lane] != 0)
            return 1;
    return 0;
}

static void sample_moments(const LightPacket *light, LightType type, int count, RngStream first,
                           uint32_t dimension, SampleMoments *moments)
{
    const PointSet points = {.sampler = SAMPLER_INDEPENDENT, .count = count};
    const PointSet few = {.sampler = SAMPLER_INDEPENDENT, .count = ADAPTIVE_PILOT};
    double sum[LANES] = {0}, squares[LANES] = {0}, all[LANES] = {0}, unused[LANES] = {0};
    packet_sum(light, type, NULL, &points, first, dimension, sum, squares);
    if (light->nb_occluders) {
        LightPacket unhidden = *light;
        unhidden.nb_occluders = 0;
        packet_sum(&unhidden, type, NULL, &few, first, dimension + PILOT_DIMENSION, all, unused);
    }
    for (int i = 0; i < LANES; i++) {
        double companion = 0;
        if (may_be_hidden(light, i))
            companion = all[i] / few.count;
        else if (light->crosses_horizon && sum[i] > 0)
            companion = squares[i] / sum[i]; /* what a sample above the horizon brings */
        const double scale = (double)light->scale[i];
        const OneSample one = with_companions(sum[i], squares[i], count, companion);
        moments->one[i] = (OneSample){scale * one.mean, scale * scale * one.variance};
        moments->estimate[i] = scale * sum[i] / count;
        moments->count[i] = count + (companion > 0 ? COMPANIONS : 0);
    }
}

static double grey(const HitPacket *hits, int lane, Rgb radiance)
{
    return ((double)hits->brdf.r[lane] * (double)radiance.r +
            (double)hits->brdf.g[lane] * (double)radiance.g +
            (double)hits->brdf.b[lane] * (double)radiance.b) /
           3;
}

/* The textbook's estimate of one channel, and the value that a visible sample brings. */
static OneSample channel_with_companions(double mean, double variance, double n, double companion)
{
    const double scatter = variance * n * (n - 1);
    return with_companions(mean * n, scatter + n * mean * mean, n, companion);
}

/* Grey, of a light that the sample loop does not know, from a pilot by the textbook. */
static OneSample textbook_pilot(const Scene *scene, int light, const Hit *hit, RngStream stream)
{
    const PointSet points = {.sampler = SAMPLER_INDEPENDENT, .count = ADAPTIVE_PILOT};
    const Scene open = {.nb_lights = scene->nb_lights, .lights = scene->lights};
    stream.pixel_sample = PILOT_SAMPLE;
    const Estimate pilot = light_estimate(scene, light, hit, &points, UNKNOWN_SPREAD, stream);
    stream.pixel_sample = UNHIDDEN_SAMPLE;
    const Rgb visible = light_estimate(&open, light, hit, &points, UNKNOWN_SPREAD, stream).radiance;
    const double mean[3] = {pilot.radiance.r, pilot.radiance.g, pilot.radiance.b};
    const double variance[3] = {pilot.variance.r, pilot.variance.g, pilot.variance.b};
    const double companion[3] = {visible.r, visible.g, visible.b};
    double sum = 0, deviation = 0; /* the channels of one light vary together */
    for (int c = 0; c < 3; c++) {
        const OneSample one =
            channel_with_companions(mean[c], variance[c], points.count, companion[c]);
        sum += one.mean;
        deviation += sqrt(one.variance);
    }
    return (OneSample){sum / 3, deviation / 3 * (deviation / 3)};
}

static Seen see_light(const Scene *scene, const Light *light, const HitPacket *hits,
                      LightPacket *packet)
{
    FlatLight flat;
    return light_is_flat(light, &flat) ? light_packet_see(scene, &flat, hits, packet)
                                       : SEEN_STRANGE;
}

/* Samples for each light that the neediest lane of the packet takes. */
static int needed_samples(const Scene *scene, const HitPacket *hits, const Target *target,
                          RngStream first)
{
    double mean[LANES] = {0}, variance[LANES] = {0};
    for (int l = 0; l < scene->nb_lights; l++) {
        const Light *light = &scene->lights[l];
        if (!light_is_surface(light))
            continue; /* one ray tells all */
        LightPacket packet;
        const Seen seen = see_light(scene, light, hits, &packet);
        if (seen == SEEN_NOT)
            continue;
        for (int i = 0; i < LANES && seen == SEEN_STRANGE; i++) {
            const Hit hit = packet_lane(hits, i);
            RngStream stream = first;
            stream.pixel += (uint32_t)i;
            if (hit.object == SCENE_NOTHING)
                continue;
            const OneSample one = textbook_pilot(scene, l, &hit, stream);
            mean[i] += one.mean;
            variance[i] += one.variance;
        }
        if (seen == SEEN_STRANGE)
            continue;
        SampleMoments moments;
        sample_moments(&packet, light->type, ADAPTIVE_PILOT, first,
                       (uint32_t)l + 1 + 2 * PILOT_DIMENSION, &moments);
        for (int i = 0; i < LANES; i++) {
            double weight = grey(hits, i, light_radiance(light));
            mean[i] += weight * moments.one[i].mean;
            variance[i] += weight * weight * moments.one[i].variance;
        }
    }
    double most = 2;
    for (int i = 0; i < LANES; i++) {
        double error = target->relative_error * mean[i] / CONFIDENCE;
        double needed = variance[i] > 0 ? variance[i] / (error * error) : 0;
        most = needed > most ? needed : most;
    }
    double chunks = ceil(fmin(most, target->max_light_samples) / ADAPTIVE_PILOT);
    return (int)fmin(chunks * ADAPTIVE_PILOT, target->max_light_samples);
}

static void add_flat(const LightPacket *packet, const Light *light, const HitPacket *hits,
                     int count, RngStream first, uint32_t dimension, EstimatePacket *result)
{
    SampleMoments moments;
    real mean[LANES], variance[LANES];
    sample_moments(packet, light->type, count, first, dimension, &moments);
    for (int i = 0; i < LANES; i++) {
        mean[i] = real_finite((real)moments.estimate[i]);
        variance[i] = real_finite((real)(moments.one[i].variance / moments.count[i]));
    }
    packet_add(light_radiance(light), hits, mean, variance, result);
}

void adaptive_direct_lighting(const Scene *scene, const HitPacket *hits, const Target *target,
                              RngStream first, EstimatePacket *result, AdaptivePacket *spent)
{
    memset(result, 0, sizeof *result);
    memset(spent, 0, sizeof *spent);
    const int count = hits->any_hit ? needed_samples(scene, hits, target, first) : 0;
    const PointSet points = {.sampler = SAMPLER_INDEPENDENT, .count = count};
    for (int l = 0; l < scene->nb_lights && hits->any_hit; l++) {
        const Light *light = &scene->lights[l];
        LightPacket packet;
        const Seen seen = see_light(scene, light, hits, &packet);
        if (seen == SEEN_SAMPLED)
            add_flat(&packet, light, hits, count, first, (uint32_t)l + 1, result);
        else if (seen == SEEN_STRANGE)
            packet_textbook(scene, l, hits, &points, UNKNOWN_SPREAD, first, result);
    }
    for (int i = 0; i < LANES; i++) {
        int hit = hits->object[i] != SCENE_NOTHING;
        double value = (double)result->radiance.r[i] + (double)result->radiance.g[i] +
                       (double)result->radiance.b[i];
        /* the channels of one light vary together: the errors add up, not their squares */
        double error = sqrt((double)result->variance.r[i]) + sqrt((double)result->variance.g[i]) +
                       sqrt((double)result->variance.b[i]);
        spent->light_samples[i] = hit ? count + ADAPTIVE_PILOT : 0;
        spent->reached[i] = CONFIDENCE * error <= target->relative_error * value;
    }
}
