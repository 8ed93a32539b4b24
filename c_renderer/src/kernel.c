#include "kernel.h"

#include <stdbool.h>
#include <string.h>

#include "estimator.h"
#include "irradiance_packet.h"

/* The sample loop is written once and compiled for each combination of its constant arguments;
 * the compiler is asked to do so, and is right without. */
#if defined(__GNUC__)
#define FOR_EACH_COMBINATION inline __attribute__((always_inline))
#else
#define FOR_EACH_COMBINATION inline
#endif

enum { CHUNK = 256 /* samples that are summed in float before they join a double; even */ };

/* Where the samples lie: the same table for all lanes, shifted digitally, or lane by lane. */
typedef struct {
    const uint32_t *table_x, *table_y;
    uint32_t shift_x[LANES], shift_y[LANES];
    real x[CHUNK][LANES], y[CHUNK][LANES];
} PointPacket;

typedef struct {
    real sum[LANES], sum_of_squares[LANES];
} SumPacket;

/* ---- the sample loop ---- */

/* Sums (n . w) / |w|^4 over the visible ones of `count` samples. */
static FOR_EACH_COMBINATION void sum_samples(const LightPacket *restrict light,
                                             const PointPacket *restrict points, int count,
                                             SumPacket *restrict result, bool table, bool clamp,
                                             int nb_occluders)
{
    LightPacket l = *light;
    const real ux = l.ux, vx = l.vx, vy = l.vy;
    uint32_t shift_x[LANES], shift_y[LANES];
    memcpy(shift_x, points->shift_x, sizeof shift_x);
    memcpy(shift_y, points->shift_y, sizeof shift_y);
    if (table) /* its points are in [1, 2): move the corner back by u + v */
        SIMD for (int i = 0; i < LANES; i++)
        {
            l.cx[i] -= ux + vx;
            l.cy[i] -= vy;
        }
    real sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    for (int j = 0; j < count; j++) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            real s =
                table ? (real)sobol_to_one_two(points->table_x[j] ^ shift_x[i]) : points->x[j][i];
            real t =
                table ? (real)sobol_to_one_two(points->table_y[j] ^ shift_y[i]) : points->y[j][i];
            real wx = l.cx[i] + s * ux + t * vx;
            real wy = l.cy[i] + t * vy;
            real distance_squared = wx * wx + (wy * wy + l.h_squared[i]);
            real n_w = l.nx[i] * wx + (l.ny[i] * wy + l.nh[i]);
            if (clamp)
                n_w = n_w > 0 ? n_w : 0;
            real inverse = 1 / distance_squared;
            real value = n_w * (inverse * inverse);
            for (int k = 0; k < nb_occluders; k++) {
                real along = l.sphere_x[k][i] * wx + (l.sphere_y[k][i] * wy + l.sphere_h[k][i]);
                value = along * fabs(along) > distance_squared ? 0 : value;
            }
            sum[i] += value;
            if (!table)
                sum_of_squares[i] += value * value;
        }
    }
    memcpy(result->sum, sum, sizeof sum);
    memcpy(result->sum_of_squares, sum_of_squares, sizeof sum_of_squares);
}

static void sum_chunk(const LightPacket *light, const PointPacket *points, int count,
                      SumPacket *result)
{
    const bool table = points->table_x, clamp = light->crosses_horizon;
#define OCCLUDERS(N)                                                                               \
    case N:                                                                                        \
        if (table && clamp)                                                                        \
            sum_samples(light, points, count, result, true, true, N);                              \
        else if (table)                                                                            \
            sum_samples(light, points, count, result, true, false, N);                             \
        else if (clamp)                                                                            \
            sum_samples(light, points, count, result, false, true, N);                             \
        else                                                                                       \
            sum_samples(light, points, count, result, false, false, N);                            \
        break;
    switch (light->nb_occluders) {
        OCCLUDERS(0)
        OCCLUDERS(1)
        OCCLUDERS(2)
        OCCLUDERS(3)
        OCCLUDERS(4)
    }
#undef OCCLUDERS
}

/* ---- all samples of one light ---- */

/* Philox for all lanes; the counter's words but the pixel are theirs alike. */
static void random_lanes(RngStream first, uint32_t block, uint32_t dimension,
                         uint32_t word[4][LANES])
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        RngBlock counter = {{first.pixel + (uint32_t)i, block, first.pixel_sample, dimension}};
        RngBlock random = rng_philox4x32(counter, first.seed);
        word[0][i] = random.word[0];
        word[1][i] = random.word[1];
        word[2][i] = random.word[2];
        word[3][i] = random.word[3];
    }
}

/* point_set_get for all lanes and samples first_sample .. first_sample + count - 1. */
static void random_points(const PointSet *set, RngStream first, int first_sample, int count,
                          uint32_t dimension, PointPacket *points)
{
    uint32_t word[4][LANES];
    for (int j = 0; j < count; j++) {
        const uint32_t index = (uint32_t)(first_sample + j);
        if (index % 2 == 0)
            random_lanes(first, index / 2, dimension, word);
        const uint32_t *x = word[index % 2 * 2], *y = word[index % 2 * 2 + 1];
        SIMD for (int i = 0; i < LANES; i++)
        {
            points->x[j][i] = rng_to_uniform(x[i]);
            points->y[j][i] = rng_to_uniform(y[i]);
        }
        if (set->sampler == SAMPLER_JITTERED) {
            const uint32_t column = index % (uint32_t)set->columns;
            const uint32_t row = index / (uint32_t)set->columns;
            SIMD for (int i = 0; i < LANES; i++)
            {
                points->x[j][i] = jitter(column, points->x[j][i], set->columns);
                points->y[j][i] = jitter(row, points->y[j][i], set->rows);
            }
        }
    }
}

void kernel_sum(const LightPacket *light, const PointSet *set, RngStream first, uint32_t dimension,
                double sum[LANES], double sum_of_squares[LANES])
{
    PointPacket points;
    SumPacket chunk;
    const bool table = set->sampler == SAMPLER_SOBOL;
    if (table) {
        uint32_t word[4][LANES];
        random_lanes(first, SOBOL_SHIFT_BLOCK, dimension, word);
        SIMD for (int i = 0; i < LANES; i++)
        {
            points.shift_x[i] = word[0][i];
            points.shift_y[i] = word[1][i];
        }
    }
    for (int first_sample = 0; first_sample < set->count; first_sample += CHUNK) {
        int count = set->count - first_sample < CHUNK ? set->count - first_sample : CHUNK;
        points.table_x = table ? set->table[0] + first_sample : NULL;
        points.table_y = table ? set->table[1] + first_sample : NULL;
        if (!table)
            random_points(set, first, first_sample, count, dimension, &points);
        sum_chunk(light, &points, count, &chunk);
        SIMD for (int i = 0; i < LANES; i++)
        {
            sum[i] += (double)chunk.sum[i];
            sum_of_squares[i] += (double)chunk.sum_of_squares[i];
        }
    }
}

/* Adds f_r L_e times a mean [sr] and its variance. */
static void add_light(Rgb radiance, const HitPacket *restrict hits, const real mean[LANES],
                      const real variance[LANES], EstimatePacket *restrict result)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        real r = hits->brdf.r[i] * radiance.r, g = hits->brdf.g[i] * radiance.g,
             b = hits->brdf.b[i] * radiance.b;
        result->radiance.r[i] += r * mean[i];
        result->radiance.g[i] += g * mean[i];
        result->radiance.b[i] += b * mean[i];
        result->variance.r[i] += r * r * variance[i];
        result->variance.g[i] += g * g * variance[i];
        result->variance.b[i] += b * b * variance[i];
    }
}

static void quad_estimate(const LightPacket *light, const PointSet *set, RngStream first,
                          uint32_t dimension, real mean[LANES], real variance[LANES])
{
    double sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    kernel_sum(light, set, first, dimension, sum, sum_of_squares);

    const double n = set->count;
    const double to_variance =
        set->sampler == SAMPLER_INDEPENDENT && set->count > 1 ? 1 / (n - 1) / n : 0;
    const double to_mean = 1 / n;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double average = sum[i] * to_mean, scale = (double)light->scale[i];
        double scatter = sum_of_squares[i] - sum[i] * average;
        scatter = scatter > 0 ? scatter : 0;
        mean[i] = (real)(scale * average);
        variance[i] = (real)(scale * scale * scatter * to_variance);
    }
}

/* Puts the closed form over the samples' answer where it is known. */
static void prefer_known(const double irradiance[LANES], const int known[LANES], real mean[LANES],
                         real variance[LANES])
{
    for (int i = 0; i < LANES; i++)
        if (known[i]) {
            mean[i] = (real)irradiance[i];
            variance[i] = 0;
        }
}

void kernel_textbook(const Scene *scene, int light, const HitPacket *hits, const PointSet *points,
                     RngStream first, EstimatePacket *result)
{
    for (int i = 0; i < LANES; i++) {
        if (hits->object[i] == SCENE_NOTHING)
            continue;
        Hit hit = packet_lane(hits, i);
        RngStream stream = first;
        stream.pixel += (uint32_t)i;
        Estimate estimate = light_estimate(scene, light, &hit, points, SPREAD_AREA, stream);
        result->radiance.r[i] += estimate.radiance.r;
        result->radiance.g[i] += estimate.radiance.g;
        result->radiance.b[i] += estimate.radiance.b;
        if (points->sampler == SAMPLER_INDEPENDENT) {
            result->variance.r[i] += estimate.variance.r;
            result->variance.g[i] += estimate.variance.g;
            result->variance.b[i] += estimate.variance.b;
        }
    }
}

void kernel_direct_lighting(const Scene *scene, const HitPacket *hits, const PointSet *points,
                            bool hybrid, RngStream first, EstimatePacket *result)
{
    memset(result, 0, sizeof *result);
    for (int i = 0; i < scene->nb_lights && hits->nb_hits; i++) {
        const Light *light = &scene->lights[i];
        const QuadLight *quad = &light->shape.quad;
        real mean[LANES] = {0}, variance[LANES] = {0};
        double irradiance[LANES];
        int known[LANES] = {0}, nb_unknown = LANES;
        if (light->type == LIGHT_QUAD && hybrid)
            nb_unknown = irradiance_packet_of_plain(scene, quad, hits, irradiance, known);

        LightPacket packet;
        Seen seen = light->type == LIGHT_QUAD ? SEEN_NOT : SEEN_STRANGE;
        if (light->type == LIGHT_QUAD && nb_unknown)
            seen = light_packet_see(scene, quad, hits, &packet);
        if (seen == SEEN_STRANGE) {
            kernel_textbook(scene, i, hits, points, first, result);
            continue;
        }
        if (seen == SEEN_SAMPLED)
            quad_estimate(&packet, points, first, (uint32_t)i + 1, mean, variance);
        if (light->type == LIGHT_QUAD && hybrid)
            prefer_known(irradiance, known, mean, variance);
        add_light(quad->radiance, hits, mean, variance, result);
    }
}

void kernel_exact_lighting(const Scene *scene, const HitPacket *hits, EstimatePacket *result)
{
    memset(result, 0, sizeof *result);
    if (hits->nb_hits)
        exact_lighting_packet(scene, hits, &result->radiance);
}
