#include "kernel.h"

#include <stdbool.h>
#include <string.h>

#include "estimator.h"

/* The sample loop is written once and compiled for each combination of its constant arguments;
 * the compiler is asked to do so, and is right without. */
#if defined(__GNUC__)
#define FOR_EACH_COMBINATION inline __attribute__((always_inline))
#else
#define FOR_EACH_COMBINATION inline
#endif

enum {
    MAX_OCCLUDERS = 4, /* spheres that the sample loop tests; packets with more go to estimator.c */
    CHUNK = 256        /* samples that are summed in float before they join a double */
};

/* A quad light as sixteen points see it.
 *
 * In the light's frame (e1 along u, e2, normal) the sample (s, t) lies from the point at
 *     w = (wx, wy, h),   wx = cx + s ux + t vx,   wy = cy + t vy,
 * with one height h for all samples. With w not normalised, eq. 5 of docs/estimator.md is
 *     f_r L_e A h (n . w) / |w|^4
 * and needs no square root. A sphere about C (from the point) with radius r hides the direction
 * w if w . C' > 0 and (w . C')^2 > |w|^2, where C' = C / sqrt(|C|^2 - r^2): eq. 6. */
typedef struct {
    real ux, vx, vy;
    real cx[LANES], cy[LANES], h_squared[LANES];
    real nx[LANES], ny[LANES], nh[LANES]; /* n . w = nx wx + ny wy + nh */
    int nb_occluders;
    real sphere_x[MAX_OCCLUDERS][LANES], sphere_y[MAX_OCCLUDERS][LANES];
    real sphere_h[MAX_OCCLUDERS][LANES]; /* w . C', likewise */
    real scale[LANES];                   /* A h; 0 in lanes without light */
    bool crosses_horizon;                /* in some lane n . w changes sign: clamp it */
} LightPacket;

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
    const LightPacket l = *light;
    const real ux = l.ux, vx = l.vx, vy = l.vy;
    uint32_t shift_x[LANES], shift_y[LANES];
    memcpy(shift_x, points->shift_x, sizeof shift_x);
    memcpy(shift_y, points->shift_y, sizeof shift_y);
    real sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    for (int j = 0; j < count; j++) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            /* table points are in [1, 2): see_light has moved the corner back by u + v */
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

/* ---- what lies between the points and the light ---- */

typedef enum {
    SEEN_NOT,     /* no lane gets any light, surely */
    SEEN_SAMPLED, /* the sample loop's case */
    SEEN_STRANGE  /* a case that the sample loop does not know: estimator.c does */
} Seen;

static int count_lanes(const int flags[LANES])
{
    int count = 0;
    for (int i = 0; i < LANES; i++)
        count += flags[i];
    return count;
}

/* The light's frame and the points in it; lit: lanes that may get light. */
static void see_quad(const QuadLight *quad, Vec3 e1, Vec3 e2, const HitPacket *restrict hits,
                     LightPacket *restrict light, real height[LANES], int lit[LANES])
{
    const Vec3 n = quad->normal, corner = quad->corner;
    const real ux = light->ux, vx = light->vx, vy = light->vy, area = quad->area;
    real low[LANES], high[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = corner.x - hits->point.x[i], dy = corner.y - hits->point.y[i],
             dz = corner.z - hits->point.z[i];
        real normal_x = hits->normal.x[i], normal_y = hits->normal.y[i],
             normal_z = hits->normal.z[i];
        real cx = dx * e1.x + dy * e1.y + dz * e1.z;
        real cy = dx * e2.x + dy * e2.y + dz * e2.z;
        real h = dx * n.x + dy * n.y + dz * n.z;
        real nx = normal_x * e1.x + normal_y * e1.y + normal_z * e1.z;
        real ny = normal_x * e2.x + normal_y * e2.y + normal_z * e2.z;
        real nz = normal_x * n.x + normal_y * n.y + normal_z * n.z;
        /* n . w is linear in s and t: its extremes are at the corners */
        real along_u = nx * ux, along_v = nx * vx + ny * vy;
        real middle = nx * cx + ny * cy + nz * h + 0.5f * (along_u + along_v);
        real spread = 0.5f * (fabs(along_u) + fabs(along_v));
        low[i] = middle - spread;
        high[i] = middle + spread;
        height[i] = h;
        light->cx[i] = cx;
        light->cy[i] = cy;
        light->h_squared[i] = h * h;
        light->nx[i] = nx;
        light->ny[i] = ny;
        light->nh[i] = nz * h;
        light->scale[i] = area * h;
    }
    int clamp[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        lit[i] = (hits->object[i] >= 0) & (height[i] > 0) & (high[i] > 0);
        clamp[i] = lit[i] & (low[i] <= 0);
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        light->h_squared[i] = lit[i] ? light->h_squared[i] : 1; /* any finite sum will do */
        light->scale[i] = lit[i] ? light->scale[i] : 0;
    }
    light->crosses_horizon = count_lanes(clamp) > 0;
}

/* Adds the sphere to the light's occluders if it may hide any of it from some lane.
 *
 * Seen from the point, the light's four sides span planes; a sphere wholly beyond one of them
 * hides nothing. Rounding errors are given room by a slightly larger sphere. */
static Seen see_sphere(const Sphere *sphere, int object, Vec3 e1, Vec3 e2, Vec3 n,
                       const HitPacket *restrict hits, const real height[LANES],
                       const int lit[LANES], LightPacket *restrict light)
{
    const Vec3 center = sphere->center;
    const real r = sphere->radius, r_squared = r * r;
    const real ux = light->ux, vx = light->vx, vy = light->vy;
    real x[LANES], y[LANES], z[LANES], clearance[LANES], behind[LANES], gap[LANES];
    real inwards[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = center.x - hits->point.x[i], dy = center.y - hits->point.y[i],
             dz = center.z - hits->point.z[i];
        real cx = dx * e1.x + dy * e1.y + dz * e1.z;
        real cy = dx * e2.x + dy * e2.y + dz * e2.z;
        real cz = dx * n.x + dy * n.y + dz * n.z;
        real h = height[i], x0 = light->cx[i], y0 = light->cy[i], y1 = y0 + vy;
        real room = r * 1.0001f + 1e-5f * (fabs(cx) + fabs(cy) + fabs(cz));
        real room_squared = room * room;
        /* beyond the sides along u (y = y0, y = y1) and v: distance times the normal's length */
        real below = y0 * cz - h * cy, above = h * cy - y1 * cz;
        real sx = vy * h, sy = -vx * h, sz = vx * y0 - vy * x0, sz1 = sz - vy * ux;
        real left = -(sx * cx + sy * cy + sz * cz), right = sx * cx + sy * cy + sz1 * cz;
        real level = sx * sx + sy * sy;
        real near = room_squared * (h * h + y0 * y0) - below * fabs(below);
        real next = room_squared * (h * h + y1 * y1) - above * fabs(above);
        near = next < near ? next : near;
        next = room_squared * (level + sz * sz) - left * fabs(left);
        near = next < near ? next : near;
        next = room_squared * (level + sz1 * sz1) - right * fabs(right);
        near = next < near ? next : near;
        next = room + cz; /* not behind the point */
        near = next < near ? next : near;
        next = room + h - cz; /* not behind the light */
        near = next < near ? next : near;
        clearance[i] = near; /* negative: the sphere is wholly beyond some side */
        behind[i] = cz + room - h;
        gap[i] = cx * cx + cy * cy + cz * cz - r_squared;
        inwards[i] = dx * hits->normal.x[i] + dy * hits->normal.y[i] + dz * hits->normal.z[i];
        x[i] = cx;
        y[i] = cy;
        z[i] = cz;
    }
    int candidate[LANES], strange[LANES], test[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        int own = hits->object[i] == object;
        int inside = own & (inwards[i] > 0); /* from outside, the horizon hides one's own sphere */
        candidate[i] = lit[i] & (clearance[i] >= 0) & (inside | (1 - own));
        strange[i] = candidate[i] & (inside | (behind[i] > 0) | (gap[i] <= 0));
        test[i] = candidate[i] & (gap[i] > 0);
    }
    if (!count_lanes(candidate))
        return SEEN_SAMPLED;
    if (count_lanes(strange) || light->nb_occluders == MAX_OCCLUDERS)
        return SEEN_STRANGE;

    const int k = light->nb_occluders++;
    real hidden_by[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real scale = 1 / sqrt(gap[i]);
        real h = height[i], x0 = light->cx[i], y0 = light->cy[i];
        real sphere_x = test[i] ? x[i] * scale : 0;
        real sphere_y = test[i] ? y[i] * scale : 0;
        real sphere_h = test[i] ? z[i] * scale * h : 0;
        /* four hidden corners hide all between them: the sphere's cone is convex */
        real least = 1;
        for (int corner = 0; corner < 4; corner++) {
            real wx = x0 + (corner & 1 ? ux : 0) + (corner & 2 ? vx : 0);
            real wy = y0 + (corner & 2 ? vy : 0);
            real along = sphere_x * wx + sphere_y * wy + sphere_h;
            real excess = along * fabs(along) - 1.0001f * (wx * wx + wy * wy + h * h);
            least = excess < least ? excess : least;
        }
        hidden_by[i] = least;
        light->sphere_x[k][i] = sphere_x;
        light->sphere_y[k][i] = sphere_y;
        light->sphere_h[k][i] = sphere_h;
    }
    int shown[LANES];
    SIMD for (int i = 0; i < LANES; i++) shown[i] = lit[i] & (hidden_by[i] <= 0);
    return count_lanes(shown) ? SEEN_SAMPLED : SEEN_NOT;
}

/* A plane hides the light from points on its other side. Those that it cuts are left alone. */
static Seen see_plane(const Plane *plane, int object, const QuadLight *quad,
                      const HitPacket *restrict hits, const int lit[LANES])
{
    const Vec3 n = plane->normal, p = plane->point;
    const real at_corner = vec3_dot(n, vec3_sub(quad->corner, p));
    const real along_u = vec3_dot(n, quad->edge_u), along_v = vec3_dot(n, quad->edge_v);
    const real middle = at_corner + 0.5f * (along_u + along_v);
    const real spread = 0.5f * (fabs(along_u) + fabs(along_v));
    int other[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real side = n.x * (hits->point.x[i] - p.x) + n.y * (hits->point.y[i] - p.y) +
                    n.z * (hits->point.z[i] - p.z);
        int clear = ((side > 0) & (middle > spread)) | ((side < 0) & (-middle > spread));
        other[i] = lit[i] & (hits->object[i] != object) & (1 - clear);
    }
    return count_lanes(other) ? SEEN_STRANGE : SEEN_SAMPLED;
}

static Seen see_light(const Scene *scene, const QuadLight *quad, const HitPacket *hits,
                      LightPacket *light)
{
    const Vec3 n = quad->normal;
    light->ux = sqrt(vec3_dot(quad->edge_u, quad->edge_u));
    const Vec3 e1 = vec3_scale(quad->edge_u, 1 / light->ux);
    const Vec3 e2 = {n.y * e1.z - n.z * e1.y, n.z * e1.x - n.x * e1.z, n.x * e1.y - n.y * e1.x};
    light->vx = vec3_dot(quad->edge_v, e1);
    light->vy = vec3_dot(quad->edge_v, e2);
    light->nb_occluders = 0;

    real height[LANES];
    int lit[LANES];
    see_quad(quad, e1, e2, hits, light, height, lit);
    if (!count_lanes(lit))
        return SEEN_NOT;
    Seen seen = SEEN_SAMPLED;
    for (int k = 0; k < scene->nb_spheres && seen == SEEN_SAMPLED; k++)
        seen = see_sphere(&scene->spheres[k], k, e1, e2, n, hits, height, lit, light);
    for (int k = 0; k < scene->nb_planes && seen == SEEN_SAMPLED; k++)
        seen = see_plane(&scene->planes[k], scene->nb_spheres + k, quad, hits, lit);
    return seen;
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
        if (index % 2 == 0) /* CHUNK is even */
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

static void sum_light(LightPacket *light, const PointSet *set, RngStream first, uint32_t dimension,
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
            light->cx[i] -= light->ux + light->vx;
            light->cy[i] -= light->vy;
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

static void quad_estimate(LightPacket *light, Rgb radiance, const HitPacket *restrict hits,
                          const PointSet *set, RngStream first, uint32_t dimension,
                          EstimatePacket *restrict result)
{
    double sum[LANES] = {0}, sum_of_squares[LANES] = {0};
    sum_light(light, set, first, dimension, sum, sum_of_squares);

    const double n = set->count;
    const double to_variance =
        set->sampler == SAMPLER_INDEPENDENT && set->count > 1 ? 1 / (n - 1) / n : 0;
    const double to_mean = 1 / n;
    real mean[LANES], variance[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        double average = sum[i] * to_mean, scale = (double)light->scale[i];
        double scatter = sum_of_squares[i] - sum[i] * average;
        scatter = scatter > 0 ? scatter : 0;
        mean[i] = (real)(scale * average);
        variance[i] = (real)(scale * scale * scatter * to_variance);
    }
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

static void textbook_estimate(const Scene *scene, int light, const HitPacket *hits,
                              const PointSet *set, RngStream first, EstimatePacket *result)
{
    for (int i = 0; i < LANES; i++) {
        if (hits->object[i] == SCENE_NOTHING)
            continue;
        Hit hit = packet_lane(hits, i);
        RngStream stream = first;
        stream.pixel += (uint32_t)i;
        Estimate estimate = light_estimate(scene, light, &hit, set, SPREAD_AREA, stream);
        result->radiance.r[i] += estimate.radiance.r;
        result->radiance.g[i] += estimate.radiance.g;
        result->radiance.b[i] += estimate.radiance.b;
        if (set->sampler == SAMPLER_INDEPENDENT) {
            result->variance.r[i] += estimate.variance.r;
            result->variance.g[i] += estimate.variance.g;
            result->variance.b[i] += estimate.variance.b;
        }
    }
}

void kernel_direct_lighting(const Scene *scene, const HitPacket *hits, const PointSet *points,
                            RngStream first, EstimatePacket *result)
{
    memset(result, 0, sizeof *result);
    for (int i = 0; i < scene->nb_lights && hits->nb_hits; i++) {
        const Light *light = &scene->lights[i];
        LightPacket packet;
        Seen seen = SEEN_STRANGE;
        if (light->type == LIGHT_QUAD)
            seen = see_light(scene, &light->shape.quad, hits, &packet);
        if (seen == SEEN_SAMPLED)
            quad_estimate(&packet, light->shape.quad.radiance, hits, points, first, (uint32_t)i + 1,
                          result);
        else if (seen == SEEN_STRANGE)
            textbook_estimate(scene, i, hits, points, first, result);
    }
}
