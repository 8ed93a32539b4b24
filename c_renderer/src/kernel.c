#include "kernel.h"

#include <string.h>

#if defined(__GNUC__)
#define ALWAYS_INLINE inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE inline
#endif
#define SIMD _Pragma("omp simd simdlen(16)")

enum {
    MAX_OCCLUDERS = 4, /* spheres that one block tests for each sample; more: the textbook */
    CHUNK = 256        /* samples summed in float before they join a double */
};

/* ---- camera rays ---- */

HitBlock kernel_hit(const Scene *scene, Vec3 origin, const Vec3Block *directions)
{
    HitBlock hits;
    real nearest[LANES];
    Vec3Block center = {{0}, {0}, {0}}; /* of the sphere hit so far */
    SIMD for (int i = 0; i < LANES; i++)
    {
        nearest[i] = scene->ray_max_distance;
        hits.object[i] = SCENE_NOTHING;
        hits.brdf.x[i] = hits.brdf.y[i] = hits.brdf.z[i] = 0;
        hits.normal.x[i] = hits.normal.y[i] = hits.normal.z[i] = 0;
    }
    for (int s = 0; s < scene->nb_spheres; s++) {
        const Sphere sphere = scene->spheres[s];
        const Vec3 to_origin = vec3_sub(origin, sphere.center);
        const real radius_squared = sphere.radius * sphere.radius;
        const real outside = vec3_dot(to_origin, to_origin) - radius_squared;
        SIMD for (int i = 0; i < LANES; i++)
        {
            real dx = directions->x[i], dy = directions->y[i], dz = directions->z[i];
            real along = to_origin.x * dx + to_origin.y * dy + to_origin.z * dz;
            real px = to_origin.x - dx * along, py = to_origin.y - dy * along,
                 pz = to_origin.z - dz * along;
            real discriminant = radius_squared - (px * px + py * py + pz * pz);
            real half_chord = sqrtf(discriminant > 0 ? discriminant : 0);
            /* shape.c's sphere_hit: outside / (half_chord - along), or the far wall */
            real near_root = outside / (half_chord - along);
            real far_root = half_chord - along;
            real distance = outside < 0 ? far_root : near_root;
            int hit = (discriminant >= 0) & ((outside < 0) | (along < 0)) & (distance > 0) &
                      (distance < nearest[i]);
            nearest[i] = hit ? distance : nearest[i];
            hits.object[i] = hit ? s : hits.object[i];
            center.x[i] = hit ? sphere.center.x : center.x[i];
            center.y[i] = hit ? sphere.center.y : center.y[i];
            center.z[i] = hit ? sphere.center.z : center.z[i];
            hits.brdf.x[i] = hit ? sphere.brdf.r : hits.brdf.x[i];
            hits.brdf.y[i] = hit ? sphere.brdf.g : hits.brdf.y[i];
            hits.brdf.z[i] = hit ? sphere.brdf.b : hits.brdf.z[i];
        }
    }
    for (int p = 0; p < scene->nb_planes; p++) {
        const Plane plane = scene->planes[p];
        const int object = scene->nb_spheres + p;
        const real height = vec3_dot(plane.normal, vec3_sub(plane.point, origin));
        SIMD for (int i = 0; i < LANES; i++)
        {
            real approach = plane.normal.x * directions->x[i] +
                            plane.normal.y * directions->y[i] +
                            plane.normal.z * directions->z[i];
            real distance = height / approach; /* parallel: inf or NaN, no hit */
            int hit = (distance > 0) & (distance < nearest[i]);
            nearest[i] = hit ? distance : nearest[i];
            hits.object[i] = hit ? object : hits.object[i];
            hits.normal.x[i] = hit ? plane.normal.x : hits.normal.x[i];
            hits.normal.y[i] = hit ? plane.normal.y : hits.normal.y[i];
            hits.normal.z[i] = hit ? plane.normal.z : hits.normal.z[i];
            hits.brdf.x[i] = hit ? plane.brdf.r : hits.brdf.x[i];
            hits.brdf.y[i] = hit ? plane.brdf.g : hits.brdf.y[i];
            hits.brdf.z[i] = hit ? plane.brdf.b : hits.brdf.z[i];
        }
    }
    const int nb_spheres = scene->nb_spheres;
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = directions->x[i], dy = directions->y[i], dz = directions->z[i];
        real x = origin.x + dx * nearest[i], y = origin.y + dy * nearest[i],
             z = origin.z + dz * nearest[i];
        int on_sphere = (hits.object[i] >= 0) & (hits.object[i] < nb_spheres);
        real rx = x - center.x[i], ry = y - center.y[i], rz = z - center.z[i];
        real length_squared = rx * rx + ry * ry + rz * rz;
        real scale = 1 / sqrtf(on_sphere ? length_squared : 1);
        real nx = on_sphere ? rx * scale : hits.normal.x[i];
        real ny = on_sphere ? ry * scale : hits.normal.y[i];
        real nz = on_sphere ? rz * scale : hits.normal.z[i];
        real flip = nx * dx + ny * dy + nz * dz > 0 ? -1.0f : 1.0f;
        hits.point.x[i] = x;
        hits.point.y[i] = y;
        hits.point.z[i] = z;
        hits.normal.x[i] = nx * flip;
        hits.normal.y[i] = ny * flip;
        hits.normal.z[i] = nz * flip;
    }
    return hits;
}

/* ---- one quad light, seen from 16 points ----
 *
 * In the light's frame (e1 along u, e2, normal) the sample (s, t) lies at
 *     w = (wx, wy, h),   wx = cx + s ux + t vx,   wy = cy + t vy
 * from the point, with h the same for all samples. With w not normalised, eq. 5 is
 *     f_r L_e A h (n . w) / |w|^4
 * and needs no square root. A sphere about C with radius r hides w if (w . C')^2 > |w|^2 and
 * w . C' > 0, where C' = C / sqrt(|C|^2 - r^2). */
typedef struct {
    real cx[LANES], cy[LANES], h_squared[LANES];
    real nx[LANES], ny[LANES], nh[LANES]; /* n . w = nx wx + ny wy + nh */
    real sphere_x[MAX_OCCLUDERS][LANES], sphere_y[MAX_OCCLUDERS][LANES];
    real sphere_h[MAX_OCCLUDERS][LANES]; /* w . C', likewise */
    uint32_t shift_x[LANES], shift_y[LANES];
    real scale[LANES];  /* A h, 0 in lanes that get no light */
    real ux, vx, vy;
    int nb_occluders;
    bool below_horizon; /* of some lane's light: its cosine needs the clamp */
} LightBlock;

typedef enum { POINTS_TABLE, POINTS_LANES } PointSource;

/* Points of one chunk: for all lanes alike (table, before the shift) or lane by lane. */
typedef struct {
    const uint32_t *table_x, *table_y;
    const real (*lane_x)[LANES], (*lane_y)[LANES];
} Points;

/* The sum, and the sum of squares, of (n . w) / |w|^4 over the visible samples of a chunk.
 * Everything but block, points and count is a constant at each call: one loop each. */
static ALWAYS_INLINE void sum_samples(const LightBlock *restrict block, Points points, int count,
                               PointSource source, int nb_occluders, bool clamp,
                               bool squares, real *restrict sum, real *restrict sum_of_squares)
{
    real cx[LANES], cy[LANES], h_squared[LANES], nx[LANES], ny[LANES], nh[LANES];
    real sphere_x[MAX_OCCLUDERS][LANES], sphere_y[MAX_OCCLUDERS][LANES];
    real sphere_h[MAX_OCCLUDERS][LANES];
    uint32_t shift_x[LANES], shift_y[LANES];
    real total[LANES] = {0}, total_of_squares[LANES] = {0};
    const real ux = block->ux, vx = block->vx, vy = block->vy;
    memcpy(cx, block->cx, sizeof cx);
    memcpy(cy, block->cy, sizeof cy);
    memcpy(h_squared, block->h_squared, sizeof h_squared);
    memcpy(nx, block->nx, sizeof nx);
    memcpy(ny, block->ny, sizeof ny);
    memcpy(nh, block->nh, sizeof nh);
    memcpy(shift_x, block->shift_x, sizeof shift_x);
    memcpy(shift_y, block->shift_y, sizeof shift_y);
    for (int k = 0; k < nb_occluders; k++) {
        memcpy(sphere_x[k], block->sphere_x[k], sizeof sphere_x[k]);
        memcpy(sphere_y[k], block->sphere_y[k], sizeof sphere_y[k]);
        memcpy(sphere_h[k], block->sphere_h[k], sizeof sphere_h[k]);
    }
    for (int j = 0; j < count; j++) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            real s, t;
            if (source == POINTS_TABLE) { /* in [1, 2); the block's corner makes up for it */
                s = sobol_to_one_two(points.table_x[j] ^ shift_x[i]);
                t = sobol_to_one_two(points.table_y[j] ^ shift_y[i]);
            } else {
                s = points.lane_x[j][i];
                t = points.lane_y[j][i];
            }
            real wx = cx[i] + s * ux + t * vx;
            real wy = cy[i] + t * vy;
            real distance_squared = wx * wx + (wy * wy + h_squared[i]);
            real n_w = nx[i] * wx + (ny[i] * wy + nh[i]);
            if (clamp)
                n_w = n_w > 0 ? n_w : 0;
            real inverse = 1 / distance_squared;
            real value = n_w * (inverse * inverse);
            for (int k = 0; k < nb_occluders; k++) {
                real along = sphere_x[k][i] * wx + (sphere_y[k][i] * wy + sphere_h[k][i]);
                value = along * fabsf(along) > distance_squared ? 0 : value;
            }
            total[i] += value;
            if (squares)
                total_of_squares[i] += value * value;
        }
    }
    memcpy(sum, total, sizeof total);
    memcpy(sum_of_squares, total_of_squares, sizeof total_of_squares);
}

static void sum_chunk(const LightBlock *block, Points points, int count, PointSource source,
                      bool squares, real *sum, real *sum_of_squares)
{
#define CASE(OCCLUDERS)                                                                        \
    case OCCLUDERS:                                                                            \
        if (source == POINTS_TABLE && block->below_horizon)                                    \
            sum_samples(block, points, count, POINTS_TABLE, OCCLUDERS, true, false, sum,       \
                        sum_of_squares);                                                       \
        else if (source == POINTS_TABLE)                                                       \
            sum_samples(block, points, count, POINTS_TABLE, OCCLUDERS, false, false, sum,      \
                        sum_of_squares);                                                       \
        else if (block->below_horizon)                                                         \
            sum_samples(block, points, count, POINTS_LANES, OCCLUDERS, true, true, sum,        \
                        sum_of_squares);                                                       \
        else                                                                                   \
            sum_samples(block, points, count, POINTS_LANES, OCCLUDERS, false, true, sum,       \
                        sum_of_squares);                                                       \
        break;
    (void)squares;
    switch (block->nb_occluders) {
        CASE(0)
        CASE(1)
        CASE(2)
        CASE(3)
        CASE(4)
    }
#undef CASE
}

static int count_lanes(const int flags[LANES])
{
    int count = 0;
    for (int i = 0; i < LANES; i++)
        count += flags[i];
    return count;
}

typedef enum { VIEW_DARK, VIEW_SAMPLED, VIEW_TEXTBOOK } View;

/* What lies between 16 points and a light. DARK: no lane gets any light, surely. TEXTBOOK: a
 * case that the sample loop does not know. */
static View light_view(const Scene *scene, const QuadLight *light, const HitBlock *restrict hits,
                       bool in_one_two, LightBlock *restrict block)
{
    const real u_length = sqrtf(vec3_dot(light->edge_u, light->edge_u));
    const Vec3 e1 = vec3_scale(light->edge_u, 1 / u_length);
    const Vec3 n = light->normal;
    const Vec3 e2 = {n.y * e1.z - n.z * e1.y, n.z * e1.x - n.x * e1.z, n.x * e1.y - n.y * e1.x};
    const real ux = u_length, vx = vec3_dot(light->edge_v, e1), vy = vec3_dot(light->edge_v, e2);
    block->ux = ux;
    block->vx = vx;
    block->vy = vy;

    real corner_x[LANES], corner_y[LANES], height[LANES], low[LANES], high[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = light->corner.x - hits->point.x[i], dy = light->corner.y - hits->point.y[i],
             dz = light->corner.z - hits->point.z[i];
        real cx = dx * e1.x + dy * e1.y + dz * e1.z;
        real cy = dx * e2.x + dy * e2.y + dz * e2.z;
        real h = dx * n.x + dy * n.y + dz * n.z;
        real nx = hits->normal.x[i] * e1.x + hits->normal.y[i] * e1.y + hits->normal.z[i] * e1.z;
        real ny = hits->normal.x[i] * e2.x + hits->normal.y[i] * e2.y + hits->normal.z[i] * e2.z;
        real nz = hits->normal.x[i] * n.x + hits->normal.y[i] * n.y + hits->normal.z[i] * n.z;
        /* n . w is linear: its extremes are at the corners */
        real along_u = nx * ux, along_v = nx * vx + ny * vy;
        real middle = nx * cx + ny * cy + nz * h + 0.5f * (along_u + along_v);
        real spread = 0.5f * (fabsf(along_u) + fabsf(along_v));
        low[i] = middle - spread;
        high[i] = middle + spread;
        corner_x[i] = cx;
        corner_y[i] = cy;
        height[i] = h;
        block->nx[i] = nx;
        block->ny[i] = ny;
        block->nh[i] = nz * h;
        block->h_squared[i] = h * h;
        block->scale[i] = light->area * h;
    }
    int lit[LANES], clamped[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        lit[i] = (hits->object[i] >= 0) & (height[i] > 0) & (high[i] > 0);
        clamped[i] = lit[i] & (low[i] <= 0);
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        block->h_squared[i] = lit[i] ? block->h_squared[i] : 1; /* any finite sum will do */
        block->scale[i] = lit[i] ? block->scale[i] : 0;
    }
    const int nb_lit = count_lanes(lit);
    if (!nb_lit)
        return VIEW_DARK;
    block->below_horizon = count_lanes(clamped) > 0;
    block->nb_occluders = 0;

    for (int k = 0; k < scene->nb_spheres; k++) {
        const Sphere sphere = scene->spheres[k];
        const real r = sphere.radius, r_squared = r * r;
        int candidate[LANES], strange[LANES], hidden[LANES];
        real sphere_x[LANES], sphere_y[LANES], sphere_h[LANES];
        SIMD for (int i = 0; i < LANES; i++)
        {
            real dx = sphere.center.x - hits->point.x[i], dy = sphere.center.y - hits->point.y[i],
                 dz = sphere.center.z - hits->point.z[i];
            real x = dx * e1.x + dy * e1.y + dz * e1.z;
            real y = dx * e2.x + dy * e2.y + dz * e2.z;
            real z = dx * n.x + dy * n.y + dz * n.z;
            real distance_squared = x * x + y * y + z * z;
            int own = hits->object[i] == k;
            /* From outside a sphere its own surface is below the horizon. */
            int inwards = dx * hits->normal.x[i] + dy * hits->normal.y[i] +
                              dz * hits->normal.z[i] > 0;
            int outside = distance_squared > r_squared;

            /* The light's four sides, seen from the point, are planes through it: a sphere
             * wholly beyond one of them hides nothing. Rounding is given 1e-4 of its size. */
            real h = height[i], x0 = corner_x[i], y0 = corner_y[i];
            real margin = r * 1.0001f + 1e-5f * (fabsf(x) + fabsf(y) + fabsf(z));
            real below = h * y - y0 * z, above = (y0 + vy) * z - h * y;
            real below_norm = h * h + y0 * y0, above_norm = h * h + (y0 + vy) * (y0 + vy);
            /* side through the corner along v = (vx, vy, 0): normal v x corner */
            real lx = vy * h, ly = -vx * h, lz = vx * y0 - vy * x0;
            real left = lx * x + ly * y + lz * z;
            real rz = lz - vy * ux;
            real right = -(lx * x + ly * y + rz * z);
            real left_norm = lx * lx + ly * ly + lz * lz, right_norm = lx * lx + ly * ly + rz * rz;
            real m2 = margin * margin;
            int apart = ((below < 0) & (below * below > m2 * below_norm)) |
                        ((above < 0) & (above * above > m2 * above_norm)) |
                        ((left < 0) & (left * left > m2 * left_norm)) |
                        ((right < 0) & (right * right > m2 * right_norm)) | (z - margin > h) |
                        (z + margin < 0);
            candidate[i] = lit[i] & (1 - apart) & (1 - (own & (1 - inwards)));
            strange[i] = candidate[i] & ((own & inwards) | (1 - outside) | (z + margin > h));
            int tested = candidate[i] & outside;
            real scale = 1 / sqrtf(tested ? distance_squared - r_squared : 1);
            x = tested ? x * scale : 0;
            y = tested ? y * scale : 0;
            real along_h = tested ? z * scale * h : 0;
            /* wholly hidden: the cone is convex, so four hidden corners hide all */
            real hide = 1;
            for (int c = 0; c < 4; c++) {
                real wx = x0 + (c & 1 ? ux : 0) + (c & 2 ? vx : 0), wy = y0 + (c & 2 ? vy : 0);
                real along = x * wx + y * wy + along_h;
                real slack = along * fabsf(along) - 1.0001f * (wx * wx + wy * wy + h * h);
                hide = slack < hide ? slack : hide;
            }
            hidden[i] = tested & (hide > 0);
            sphere_x[i] = x;
            sphere_y[i] = y;
            sphere_h[i] = along_h;
        }
        if (!count_lanes(candidate))
            continue;
        if (count_lanes(strange) || block->nb_occluders == MAX_OCCLUDERS)
            return VIEW_TEXTBOOK;
        if (count_lanes(hidden) == nb_lit)
            return VIEW_DARK;
        {
            memcpy(block->sphere_x[block->nb_occluders], sphere_x, sizeof sphere_x);
            memcpy(block->sphere_y[block->nb_occluders], sphere_y, sizeof sphere_y);
            memcpy(block->sphere_h[block->nb_occluders], sphere_h, sizeof sphere_h);
            block->nb_occluders++;
        }
    }

    /* A plane hides the light from the points on its other side. */
    for (int p = 0; p < scene->nb_planes; p++) {
        const Plane plane = scene->planes[p];
        const Vec3 a = vec3_sub(light->corner, plane.point);
        const real at_corner = vec3_dot(plane.normal, a);
        const real along_u = vec3_dot(plane.normal, light->edge_u);
        const real along_v = vec3_dot(plane.normal, light->edge_v);
        const real low = at_corner + fminf(along_u, 0) + fminf(along_v, 0);
        const real high = at_corner + fmaxf(along_u, 0) + fmaxf(along_v, 0);
        const int own = scene->nb_spheres + p;
        int crossed[LANES];
        SIMD for (int i = 0; i < LANES; i++)
        {
            real side = plane.normal.x * (hits->point.x[i] - plane.point.x) +
                        plane.normal.y * (hits->point.y[i] - plane.point.y) +
                        plane.normal.z * (hits->point.z[i] - plane.point.z);
            int free_side = ((side > 0) & (low > 0)) | ((side < 0) & (high < 0));
            crossed[i] = lit[i] & (hits->object[i] != own) & (1 - free_side);
        }
        if (count_lanes(crossed))
            return VIEW_TEXTBOOK;
    }

    /* Table points are in [1, 2): move the corner back by u + v. */
    SIMD for (int i = 0; i < LANES; i++)
    {
        block->cx[i] = corner_x[i] - (in_one_two ? ux + vx : 0);
        block->cy[i] = corner_y[i] - (in_one_two ? vy : 0);
    }
    return VIEW_SAMPLED;
}

/* Random points of one chunk, lane by lane. */
static void lane_points(const PointSet *set, const RngStream stream[LANES], int first, int count,
                        uint32_t dimension, real x[][LANES], real y[][LANES])
{
    const uint32_t seed_low = (uint32_t)stream[0].seed, seed_high = (uint32_t)(stream[0].seed >> 32);
    const uint32_t pixel_sample = stream[0].pixel_sample;
    uint32_t pixel[LANES];
    for (int i = 0; i < LANES; i++)
        pixel[i] = stream[i].pixel;
    for (int j = 0; j < count; j++) {
        const uint32_t index = (uint32_t)(first + j);
        SIMD for (int i = 0; i < LANES; i++)
        {
            RngBlock random = rng_philox4x32((RngBlock){{pixel[i], index, pixel_sample, dimension}},
                                             (uint64_t)seed_high << 32 | seed_low);
            x[j][i] = (real)(random.word[0] >> 8) * 0x1p-24f;
            y[j][i] = (real)(random.word[1] >> 8) * 0x1p-24f;
        }
        if (set->sampler == SAMPLER_JITTERED) {
            uint32_t columns = (uint32_t)set->columns;
            for (int i = 0; i < LANES; i++) {
                x[j][i] = jitter(index % columns, x[j][i], set->columns);
                y[j][i] = jitter(index / columns, y[j][i], set->rows);
            }
        }
    }
}

static void quad_lighting(const LightBlock *block, const PointSet *set,
                          const RngStream stream[LANES], uint32_t dimension,
                          double sum[LANES], double sum_of_squares[LANES])
{
    real lane_x[CHUNK][LANES], lane_y[CHUNK][LANES];
    real chunk_sum[LANES], chunk_squares[LANES];
    for (int first = 0; first < set->count; first += CHUNK) {
        int count = set->count - first < CHUNK ? set->count - first : CHUNK;
        PointSource source = set->sampler == SAMPLER_SOBOL ? POINTS_TABLE : POINTS_LANES;
        Points points = {0};
        if (source == POINTS_TABLE) {
            points.table_x = set->table[0] + first;
            points.table_y = set->table[1] + first;
        } else {
            lane_points(set, stream, first, count, dimension, lane_x, lane_y);
            points.lane_x = (const real(*)[LANES])lane_x;
            points.lane_y = (const real(*)[LANES])lane_y;
        }
        sum_chunk(block, points, count, source, true, chunk_sum, chunk_squares);
        for (int i = 0; i < LANES; i++) {
            sum[i] += (double)chunk_sum[i];
            sum_of_squares[i] += (double)chunk_squares[i];
        }
    }
}

void kernel_direct_lighting(const Scene *scene, const HitBlock *hits, const PointSet *points,
                            const RngStream stream[LANES], Estimate result[LANES])
{
    const double n = points->count;
    memset(result, 0, LANES * sizeof *result);
    for (int l = 0; l < scene->nb_lights; l++) {
        const Light *light = &scene->lights[l];
        LightBlock block;
        View view = VIEW_TEXTBOOK;
        if (light->type == LIGHT_QUAD)
            view = light_view(scene, &light->shape.quad, hits,
                              points->sampler == SAMPLER_SOBOL, &block);
        if (view == VIEW_DARK)
            continue;
        if (view == VIEW_TEXTBOOK) {
            continue; /* TODO */
        }
        if (points->sampler == SAMPLER_SOBOL)
            for (int i = 0; i < LANES; i++) {
                RngBlock shift = sobol_shift(stream[i], (uint32_t)l + 1);
                block.shift_x[i] = shift.word[0];
                block.shift_y[i] = shift.word[1];
            }
        double sum[LANES] = {0}, squares[LANES] = {0};
        quad_lighting(&block, points, stream, (uint32_t)l + 1, sum, squares);
        const Rgb radiance = light->shape.quad.radiance;
        for (int i = 0; i < LANES; i++) {
            double scale = (double)block.scale[i];
            double mean = scale * sum[i] / n;
            double variance =
                n > 1 ? fmax(scale * scale * squares[i] - n * mean * mean, 0.0) / (n - 1) / n : 0;
            real fr = hits->brdf.x[i] * radiance.r, fg = hits->brdf.y[i] * radiance.g,
                 fb = hits->brdf.z[i] * radiance.b;
            result[i].radiance.r += fr * (real)mean;
            result[i].radiance.g += fg * (real)mean;
            result[i].radiance.b += fb * (real)mean;
            result[i].variance.r += fr * fr * (real)variance;
            result[i].variance.g += fg * fg * (real)variance;
            result[i].variance.b += fb * fb * (real)variance;
        }
    }
}
