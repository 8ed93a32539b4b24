#include "estimator_packet.h"

#include <stdbool.h>
#include <string.h>

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

/* The sample at (s, t) from lane i's point: |w|^2, and n . w or 0 where it is hidden. */
typedef struct {
    real distance_squared, n_w;
} Term;

static FOR_EACH_COMBINATION Term look(const LightPacket *restrict l, const real cx[LANES],
                                      const real cy[LANES], int i, real s, real t, bool clamp,
                                      int nb_occluders)
{
    real wx = cx[i] + s * l->ux[i] + t * l->vx[i];
    real wy = cy[i] + t * l->vy[i];
    real distance_squared = wx * wx + (wy * wy + l->h_squared[i]);
    real n_w = l->nx[i] * wx + (l->ny[i] * wy + l->nh[i]);
    if (clamp)
        n_w = n_w > 0 ? n_w : 0;
    for (int k = 0; k < nb_occluders; k++) {
        real along = l->sphere_x[k][i] * wx + (l->sphere_y[k][i] * wy + l->sphere_h[k][i]);
        n_w = along * fabs(along) > distance_squared ? 0 : n_w;
    }
    return (Term){distance_squared, n_w};
}

/* Sums (n . w) / |w|^4 over the visible ones of `count` samples.
 *
 * Two samples share a division, which processors do slowly: with a = |w_1|^2 and b = |w_2|^2,
 * 1/a = b / (ab) and 1/b = a / (ab). Without squares to sum, the division is made one turn later,
 * so that nothing has to wait for what it divides by. */
static FOR_EACH_COMBINATION void sum_samples(const LightPacket *restrict l,
                                             const PointPacket *restrict points, int count,
                                             SumPacket *restrict result, bool table, bool clamp,
                                             int nb_occluders)
{
    real cx[LANES], cy[LANES];
    uint32_t shift_x[LANES] = {0}, shift_y[LANES] = {0};
    SIMD for (int i = 0; i < LANES; i++)
    {
        /* the table's points are in [1, 2): move the corner back by u + v */
        cx[i] = table ? l->cx[i] - (l->ux[i] + l->vx[i]) : l->cx[i];
        cy[i] = table ? l->cy[i] - l->vy[i] : l->cy[i];
    }
    if (table) {
        memcpy(shift_x, points->shift_x, sizeof shift_x);
        memcpy(shift_y, points->shift_y, sizeof shift_y);
    }
#define X(j) (table ? (real)sobol_in_one_two(points->table_x[j], shift_x[i]) : points->x[j][i])
#define Y(j) (table ? (real)sobol_in_one_two(points->table_y[j], shift_y[i]) : points->y[j][i])
    real sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    real product[LANES], numerator[LANES] = {0}; /* of the turn before: ab, and value (ab)^2 */
    SIMD for (int i = 0; i < LANES; i++) product[i] = 1;
    for (int j = 0; j + 1 < count; j += 2) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            Term first = look(l, cx, cy, i, X(j), Y(j), clamp, nb_occluders);
            Term second = look(l, cx, cy, i, X(j + 1), Y(j + 1), clamp, nb_occluders);
            real a = first.distance_squared, b = second.distance_squared;
            if (table) {
                real inverse = 1 / product[i];
                sum[i] += numerator[i] * (inverse * inverse);
                numerator[i] = first.n_w * (b * b) + second.n_w * (a * a);
                product[i] = a * b;
            } else {
                real inverse = 1 / (a * b);
                real inverse_a = b * inverse, inverse_b = a * inverse;
                real value_a = first.n_w * (inverse_a * inverse_a);
                real value_b = second.n_w * (inverse_b * inverse_b);
                sum[i] += value_a + value_b;
                sum_of_squares[i] += value_a * value_a + value_b * value_b;
            }
        }
    }
    if (table) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            real inverse = 1 / product[i];
            sum[i] += numerator[i] * (inverse * inverse);
        }
    }
    if (count % 2) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            Term last = look(l, cx, cy, i, X(count - 1), Y(count - 1), clamp, nb_occluders);
            real inverse = 1 / last.distance_squared;
            real value = last.n_w * (inverse * inverse);
            sum[i] += value;
            if (!table)
                sum_of_squares[i] += value * value;
        }
    }
#undef X
#undef Y
    memcpy(result->sum, sum, sizeof sum);
    memcpy(result->sum_of_squares, sum_of_squares, sizeof sum_of_squares);
}

/* Sums (n . w) / |w| over the visible ones of `count` samples. */
static FOR_EACH_COMBINATION void sum_cosines(const LightPacket *restrict l,
                                             const PointPacket *restrict points, int count,
                                             SumPacket *restrict result, bool clamp,
                                             int nb_occluders)
{
    real sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    for (int j = 0; j < count; j++) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            Term term =
                look(l, l->cx, l->cy, i, points->x[j][i], points->y[j][i], clamp, nb_occluders);
            real value = term.n_w / sqrt(term.distance_squared);
            sum[i] += value;
            sum_of_squares[i] += value * value;
        }
    }
    memcpy(result->sum, sum, sizeof sum);
    memcpy(result->sum_of_squares, sum_of_squares, sizeof sum_of_squares);
}

static void sum_chunk(const LightPacket *light, const PointPacket *points, int count, Spread spread,
                      SumPacket *result)
{
    const bool table = points->table_x, clamp = light->crosses_horizon;
    const bool directions = spread == SPREAD_SOLID_ANGLE;
#define OCCLUDERS(N)                                                                               \
    case N:                                                                                        \
        if (directions && clamp)                                                                   \
            sum_cosines(light, points, count, result, true, N);                                    \
        else if (directions)                                                                       \
            sum_cosines(light, points, count, result, false, N);                                   \
        else if (table && clamp)                                                                   \
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

/* Threefry for all lanes; the counter's words but the pixel are theirs alike. */
static void random_lanes(RngStream first, uint32_t block, uint32_t dimension,
                         uint32_t word[4][LANES])
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        RngBlock counter = {{first.pixel + (uint32_t)i, block, first.pixel_sample, dimension}};
        RngBlock random = rng_threefry4x32(counter, rng_key(first.seed));
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

/* The table's points, lane by lane. */
static void table_points(const PointSet *set, int first_sample, int count, PointPacket *points)
{
    for (int j = 0; j < count; j++) {
        const uint32_t x = set->table[0][first_sample + j], y = set->table[1][first_sample + j];
        SIMD for (int i = 0; i < LANES; i++)
        {
            points->x[j][i] = sobol_in_one_two(x, points->shift_x[i]) - 1;
            points->y[j][i] = sobol_in_one_two(y, points->shift_y[i]) - 1;
        }
    }
}

void packet_sum(const LightPacket *light, LightType type, const SphericalRectanglePacket *rectangle,
                const PointSet *set, RngStream first, uint32_t dimension, double sum[LANES],
                double sum_of_squares[LANES])
{
    PointPacket points;
    SumPacket chunk;
    const bool sobol = set->sampler == SAMPLER_SOBOL,
               as_it_is = !rectangle && area_packet_is_square(type), table = sobol && as_it_is;
    const Spread spread = rectangle ? SPREAD_SOLID_ANGLE : SPREAD_AREA;
    if (sobol) {
        uint32_t word[4][LANES];
        random_lanes(first, SOBOL_SHIFT_BLOCK, dimension, word);
        SIMD for (int i = 0; i < LANES; i++)
        {
            points.shift_x[i] = sobol_shift(word[0][i]);
            points.shift_y[i] = sobol_shift(word[1][i]);
        }
    }
    for (int first_sample = 0; first_sample < set->count; first_sample += CHUNK) {
        int count = set->count - first_sample < CHUNK ? set->count - first_sample : CHUNK;
        points.table_x = table ? set->table[0] + first_sample : NULL;
        points.table_y = table ? set->table[1] + first_sample : NULL;
        if (!sobol)
            random_points(set, first, first_sample, count, dimension, &points);
        else if (!table)
            table_points(set, first_sample, count, &points);
        for (int j = 0; j < count && !as_it_is; j++) {
            if (rectangle)
                spherical_rectangle_packet_place(rectangle, points.x[j], points.y[j]);
            else
                area_packet_place(type, points.x[j], points.y[j]);
        }
        sum_chunk(light, &points, count, spread, &chunk);
        SIMD for (int i = 0; i < LANES; i++)
        {
            sum[i] += (double)chunk.sum[i];
            if (!table)
                sum_of_squares[i] += (double)chunk.sum_of_squares[i];
        }
    }
}

void packet_add(Rgb radiance, const HitPacket *restrict hits, const real mean[LANES],
                const real variance[LANES], EstimatePacket *restrict result)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        result->radiance.r[i] += hits->brdf.r[i] * radiance.r * mean[i];
        result->radiance.g[i] += hits->brdf.g[i] * radiance.g * mean[i];
        result->radiance.b[i] += hits->brdf.b[i] * radiance.b * mean[i];
    }
    if (!variance)
        return;
    SIMD for (int i = 0; i < LANES; i++)
    {
        /* r^2 alone may be Inf, and the variance 0 */
        real r = hits->brdf.r[i] * radiance.r, g = hits->brdf.g[i] * radiance.g,
             b = hits->brdf.b[i] * radiance.b;
        result->variance.r[i] += r * (r * variance[i]);
        result->variance.g[i] += g * (g * variance[i]);
        result->variance.b[i] += b * (b * variance[i]);
    }
}

static void clear(EstimatePacket *result)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        result->radiance.r[i] = result->radiance.g[i] = result->radiance.b[i] = 0;
        result->variance.r[i] = result->variance.g[i] = result->variance.b[i] = 0;
    }
}

/* rectangle: how its directions spread over the light's; NULL: spread over its area. */
static void flat_estimate(const LightPacket *light, LightType type,
                          const SphericalRectanglePacket *rectangle, const PointSet *set,
                          RngStream first, uint32_t dimension, real mean[LANES],
                          real variance[LANES])
{
    double sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    packet_sum(light, type, rectangle, set, first, dimension, sum, sum_of_squares);

    const real *scales = rectangle ? rectangle->scale : light->scale;
    const double n = set->count, to_mean = 1 / n;
    SIMD for (int i = 0; i < LANES; i++) mean[i] =
        real_finite((real)((double)scales[i] * (sum[i] * to_mean)));
    if (set->sampler != SAMPLER_INDEPENDENT)
        return;
    const double to_variance = set->count > 1 ? 1 / (n - 1) / n : 0;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double scale = (double)scales[i];
        double scatter = sum_of_squares[i] - sum[i] * (sum[i] * to_mean);
        scatter = scatter > 0 ? scatter : 0;
        variance[i] = real_finite((real)(scale * scale * scatter * to_variance));
    }
}

void packet_textbook(const Scene *scene, int light, const HitPacket *hits, const PointSet *points,
                     Spread spread, RngStream first, EstimatePacket *result)
{
    for (int i = 0; i < LANES; i++) {
        if (hits->object[i] == SCENE_NOTHING)
            continue;
        Hit hit = packet_lane(hits, i);
        RngStream stream = first;
        stream.pixel += (uint32_t)i;
        Estimate estimate = light_estimate(scene, light, &hit, points, spread, stream);
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

/* A flat light that packet sees so, added to result. */
static void add_flat(const Scene *scene, int light, const HitPacket *hits, const PointSet *points,
                     Spread spread, RngStream first, Seen seen, const LightPacket *packet,
                     EstimatePacket *result)
{
    const Light *from = &scene->lights[light];
    SphericalRectanglePacket rectangle;
    InLanes known = RECTANGLE_IN_NO_LANE;
    if (spread == SPREAD_SOLID_ANGLE && seen == SEEN_SAMPLED)
        known = solid_angle_packet_create(&rectangle, from, hits, packet);
    if (seen == SEEN_STRANGE || known == RECTANGLE_IN_SOME_LANES) {
        packet_textbook(scene, light, hits, points, spread, first, result);
        return;
    }
    if (seen == SEEN_NOT)
        return;
    real mean[LANES], variance[LANES];
    flat_estimate(packet, from->type, known == RECTANGLE_IN_ALL_LANES ? &rectangle : NULL, points,
                  first, (uint32_t)light + 1, mean, variance);
    const bool known_variance = points->sampler == SAMPLER_INDEPENDENT;
    packet_add(light_radiance(from), hits, mean, known_variance ? variance : NULL, result);
}

void packet_direct_lighting(const Scene *scene, const HitPacket *hits, int nb_packets,
                            const PointSet *points, Spread spread, RngStream first,
                            EstimatePacket *result)
{
    LightPacket packet[MAX_PACKETS];
    Seen seen[MAX_PACKETS];
    for (int p = 0; p < nb_packets; p++)
        clear(&result[p]);
    for (int l = 0; l < scene->nb_lights; l++) {
        FlatLight flat;
        const bool is_flat = light_is_flat(&scene->lights[l], &flat);
        for (int p = 0; p < nb_packets; p++) {
            seen[p] = hits[p].any_hit ? SEEN_STRANGE : SEEN_NOT;
            if (is_flat && hits[p].any_hit)
                seen[p] = light_packet_see(scene, &flat, &hits[p], &packet[p]);
        }
        for (int p = 0; p < nb_packets; p++) {
            RngStream stream = first;
            stream.pixel += (uint32_t)(p * LANES);
            add_flat(scene, l, &hits[p], points, spread, stream, seen[p], &packet[p], &result[p]);
        }
    }
}

void packet_exact_lighting(const Scene *scene, const HitPacket *hits, EstimatePacket *result)
{
    clear(result);
    if (hits->any_hit)
        exact_lighting_packet(scene, hits, &result->radiance);
}
