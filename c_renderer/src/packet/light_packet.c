#include "light_packet.h"

/* Below this height, in the lane's unit of length, 1 / |w|^8 comes near float's end. */
#define LEAST_HEIGHT ((real)1e-4f)

/* The light's axes, unit vectors, and the parallelogram in them. */
typedef struct {
    Vec3 e1, e2, normal;
    real ux, vx, vy;
} Frame;

static Frame light_frame(const FlatLight *flat)
{
    const Vec3 n = flat->normal;
    const real ux = sqrt(vec3_dot(flat->edge_u, flat->edge_u));
    const Vec3 e1 = vec3_scale(flat->edge_u, 1 / ux);
    const Vec3 e2 = {n.y * e1.z - n.z * e1.y, n.z * e1.x - n.x * e1.z, n.x * e1.y - n.y * e1.x};
    return (Frame){e1, e2, n, ux, vec3_dot(flat->edge_v, e1), vec3_dot(flat->edge_v, e2)};
}

/* How the lanes' points lie to the light, but for what LightPacket says. */
typedef struct {
    real unit[LANES];   /* of length, inverse [m^-1] */
    real height[LANES]; /* above the light's plane, in it */
    int lit[LANES];     /* lanes that may get light */
} Standing;

/* SEEN_STRANGE: some lane stands too near to the light's plane. */
static Seen see_light(const FlatLight *flat, const Frame *frame, const HitPacket *restrict hits,
                      LightPacket *restrict light, Standing *restrict standing)
{
    const Vec3 e1 = frame->e1, e2 = frame->e2, n = frame->normal, corner = flat->corner;
    const real area = flat->area, size = frame->ux + fabs(frame->vx) + frame->vy;
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
        real unit = 1 / (fabs(cx) + fabs(cy) + fabs(h) + size);
        real ux = frame->ux * unit, vx = frame->vx * unit, vy = frame->vy * unit;
        cx *= unit;
        cy *= unit;
        h *= unit;
        real nx = normal_x * e1.x + normal_y * e1.y + normal_z * e1.z;
        real ny = normal_x * e2.x + normal_y * e2.y + normal_z * e2.z;
        real nz = normal_x * n.x + normal_y * n.y + normal_z * n.z;
        /* n . w is linear in s and t: its extremes are at the corners */
        real along_u = nx * ux, along_v = nx * vx + ny * vy;
        real middle = nx * cx + ny * cy + nz * h + 0.5f * (along_u + along_v);
        real spread = 0.5f * (fabs(along_u) + fabs(along_v));
        low[i] = middle - spread;
        high[i] = middle + spread;
        standing->unit[i] = unit;
        standing->height[i] = h;
        light->ux[i] = ux;
        light->vx[i] = vx;
        light->vy[i] = vy;
        light->cx[i] = cx;
        light->cy[i] = cy;
        light->h_squared[i] = h * h;
        light->nx[i] = nx;
        light->ny[i] = ny;
        light->nh[i] = nz * h;
        light->scale[i] = area * (unit * unit) * h;
    }
    enum { LIT = 1, CROSSES_HORIZON = 2, TOO_LOW = 4 };
    int flags[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        int lit = (hits->object[i] >= 0) & (standing->height[i] > 0) & (high[i] > 0);
        int crosses = lit & (low[i] <= 0), too_low = lit & (standing->height[i] < LEAST_HEIGHT);
        standing->lit[i] = lit;
        flags[i] = lit * LIT | crosses * CROSSES_HORIZON | too_low * TOO_LOW;
    }
    const int *lit = standing->lit;
    SIMD for (int i = 0; i < LANES; i++)
    {
        light->h_squared[i] = lit[i] ? light->h_squared[i] : 1; /* any finite sum will do */
        light->scale[i] = lit[i] ? light->scale[i] : 0;
    }
    const int any = any_lane(flags);
    light->crosses_horizon = any & CROSSES_HORIZON;
    return any & TOO_LOW ? SEEN_STRANGE : any & LIT ? SEEN_SAMPLED : SEEN_NOT;
}

/* Adds the sphere to the light's occluders if it may hide any of it from some lane.
 *
 * Seen from the point, the light's four sides span planes; a sphere wholly beyond one of them
 * hides nothing. Rounding errors are given room by a slightly larger sphere. */
static Seen see_sphere(const Sphere *sphere, int object, const Frame *frame,
                       const HitPacket *restrict hits, const Standing *restrict standing,
                       LightPacket *restrict light)
{
    const Vec3 e1 = frame->e1, e2 = frame->e2, n = frame->normal, center = sphere->center;
    const real radius = sphere->radius;
    const real *height = standing->height;
    const int *lit = standing->lit;
    real x[LANES], y[LANES], z[LANES], clearance[LANES], behind[LANES], gap[LANES];
    real inwards[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real unit = standing->unit[i], r = radius * unit;
        real dx = (center.x - hits->point.x[i]) * unit, dy = (center.y - hits->point.y[i]) * unit,
             dz = (center.z - hits->point.z[i]) * unit;
        real ux = light->ux[i], vx = light->vx[i], vy = light->vy[i];
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
        gap[i] = cx * cx + cy * cy + cz * cz - r * r;
        inwards[i] = dx * hits->normal.x[i] + dy * hits->normal.y[i] + dz * hits->normal.z[i];
        x[i] = cx;
        y[i] = cy;
        z[i] = cz;
    }
    enum { CANDIDATE = 1, STRANGE = 2 };
    int flags[LANES], test[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        int own = hits->object[i] == object;
        int inside = own & (inwards[i] > 0); /* from outside, the horizon hides one's own sphere */
        int candidate = lit[i] & (clearance[i] >= 0) & (inside | (1 - own));
        int strange = candidate & (inside | (behind[i] > 0) | (gap[i] <= 0));
        flags[i] = candidate * CANDIDATE | strange * STRANGE;
        test[i] = candidate & (gap[i] > 0);
    }
    const int any = any_lane(flags);
    if (!any)
        return SEEN_SAMPLED;
    if (any & STRANGE || light->nb_occluders == MAX_OCCLUDERS)
        return SEEN_STRANGE;

    const int k = light->nb_occluders++;
    real hidden_by[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real scale = 1 / sqrt(gap[i]);
        real h = height[i], x0 = light->cx[i], y0 = light->cy[i];
        real ux = light->ux[i], vx = light->vx[i], vy = light->vy[i];
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
    return any_lane(shown) ? SEEN_SAMPLED : SEEN_NOT;
}

/* A plane hides the light from points on its other side. Those that it cuts are left alone. */
static Seen see_plane(const Plane *plane, int object, const FlatLight *flat,
                      const HitPacket *restrict hits, const int lit[LANES])
{
    if (hits->one_object && hits->object[0] == object)
        return SEEN_SAMPLED; /* no plane hides anything from its own points */
    const Vec3 n = plane->normal, p = plane->point;
    const real at_corner = vec3_dot(n, vec3_sub(flat->corner, p));
    const real along_u = vec3_dot(n, flat->edge_u), along_v = vec3_dot(n, flat->edge_v);
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
    return any_lane(other) ? SEEN_STRANGE : SEEN_SAMPLED;
}

Seen light_packet_see(const Scene *scene, const FlatLight *flat, const HitPacket *hits,
                      LightPacket *light)
{
    const Frame frame = light_frame(flat);
    Standing standing;
    light->nb_occluders = 0;
    Seen seen = see_light(flat, &frame, hits, light, &standing);
    for (int k = 0; k < scene->nb_spheres && seen == SEEN_SAMPLED; k++)
        seen = see_sphere(&scene->spheres[k], k, &frame, hits, &standing, light);
    for (int k = 0; k < scene->nb_planes && seen == SEEN_SAMPLED; k++)
        seen = see_plane(&scene->planes[k], scene->nb_spheres + k, flat, hits, standing.lit);
    return seen;
}
