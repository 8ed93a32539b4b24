#include "irradiance_packet.h"

#include "exact/irradiance.h"
#include "outline_packet.h"

/* Written once and compiled for edges near and far, as in estimator_packet.c: a request. */
#if defined(__GNUC__)
#define NEAR_AND_FAR inline __attribute__((always_inline))
#else
#define NEAR_AND_FAR inline
#endif

/* ---- angles ---- */

/* atan(sqrt(y)) / sqrt(y) for 0 <= y <= 1/4, within 2e-13, and in proportion to y less: by
 * Chebyshev interpolation of (this - 1) / y. */
static inline double atan_ratio_far(double y)
{
    double p = -0.020627414552978362;
    p = p * y + 0.046504637696111091;
    p = p * y - 0.063843709467919678;
    p = p * y + 0.0765299342011988;
    p = p * y - 0.090876230965894157;
    p = p * y + 0.11110954858950716;
    p = p * y - 0.14285710532059256;
    p = p * y + 0.19999999965057622;
    p = p * y - 0.33333333333279485;
    return p * y + 1;
}

/* The same for 0 <= y <= 1, within 5e-14. */
static inline double atan_ratio_near(double y)
{
    double p = 0.00010057727553740323;
    p = p * y - 0.00091411954167215251;
    p = p * y + 0.003912875889690956;
    p = p * y - 0.010605869455534812;
    p = p * y + 0.020788117608210379;
    p = p * y - 0.032189752965822655;
    p = p * y + 0.042405734979650254;
    p = p * y - 0.050782384057352787;
    p = p * y + 0.058331422558094757;
    p = p * y - 0.066571164514589222;
    p = p * y + 0.076910067295831147;
    p = p * y - 0.090907913395081052;
    p = p * y + 0.11111104602822058;
    p = p * y - 0.1428571409522137;
    p = p * y + 0.19999999997779171;
    p = p * y - 0.33333333333329004;
    return p * y + 1;
}

/* theta / sin(theta) / (|a| |b|) for directions a and b, given |a x b|^2 and a . b: Lambert's
 * theta_k gamma_k is this times a x b. tan(theta / 2) = |a x b| / (|a| |b| + a . b). */
static inline double angle_ratio_near(double cross_squared, double dot)
{
    double inverse = 1 / (sqrt(cross_squared + dot * dot) + fabs(dot));
    double acute = 2 * inverse * atan_ratio_near(cross_squared * (inverse * inverse));
    double turned = (dot < 0 ? PI : 0.0) / (dot < 0 ? sqrt(cross_squared) : 1);
    return dot < 0 ? turned - acute : acute;
}

/* The same without a square root, where tan(theta) < 1/2; given 1 / a . b. */
static inline double angle_ratio_far(double cross_squared, double inverse_dot)
{
    return inverse_dot * atan_ratio_far(cross_squared * (inverse_dot * inverse_dot));
}

/* The angle of x + i y in (-pi, pi]. */
static inline double angle_of(double x, double y)
{
    double tangent = y / (sqrt(x * x + y * y) + fabs(x)); /* of half the angle to the x axis */
    double angle = 2 * tangent * atan_ratio_near(tangent * tangent);
    return x < 0 ? (y < 0 ? -PI : PI) - angle : angle;
}

/* ---- the light above the horizon ---- */

/* Lambert: E = 1/2 sum theta_k (gamma_k . n), corner by corner (x0, y0), (x1, y0), (x2, y1),
 * (x3, y1). With w the edge's first corner and e the edge, gamma_k is along
 * w x e = (-h e_y, h e_x, x e_y - y e_x). */
static NEAR_AND_FAR void sum_edges(const ViewPacket *restrict view, Lanes irradiance, bool is_near)
{
    const QuadFrame f = view->frame;
    const double ux = f.ux, vx = f.vx, vy = f.vy, uu = ux * ux, vv = vx * vx + vy * vy;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double h = view->h[i], nx = view->nx[i], ny = view->ny[i], nz = view->nz[i];
        double x0 = view->x[i], x1 = x0 + ux, x2 = x1 + vx, x3 = x0 + vx;
        double y0 = view->y[i], y1 = y0 + vy, h2 = h * h;
        double turn1 = x1 * vy - y0 * vx, turn3 = x0 * vy - y0 * vx;
        double level = h * (ny * vx - nx * vy), across = h * ny;
        /* (w x e) . n, |w x e|^2 and the product of the edge's ends, around the light */
        double n0 = ux * (across - nz * y0), n2 = -ux * (across - nz * y1);
        double n1 = level + nz * turn1, n3 = -level - nz * turn3;
        double c0 = uu * (h2 + y0 * y0), c2 = uu * (h2 + y1 * y1);
        double c1 = h2 * vv + turn1 * turn1, c3 = h2 * vv + turn3 * turn3;
        double d0 = h2 + y0 * y0 + x0 * x1, d2 = h2 + y1 * y1 + x2 * x3;
        double d1 = h2 + y0 * y1 + x1 * x2, d3 = h2 + y0 * y1 + x3 * x0;
        double sum;
        if (is_near) {
            sum = n0 * angle_ratio_near(c0, d0) + n1 * angle_ratio_near(c1, d1) +
                  n2 * angle_ratio_near(c2, d2) + n3 * angle_ratio_near(c3, d3);
        } else { /* one division, as slow as 30 multiplications, for four */
            double d01 = d0 * d1, d23 = d2 * d3, inverse = 1 / (d01 * d23);
            double i01 = inverse * d23, i23 = inverse * d01;
            sum = n0 * angle_ratio_far(c0, i01 * d1) + n1 * angle_ratio_far(c1, i01 * d0) +
                  n2 * angle_ratio_far(c2, i23 * d3) + n3 * angle_ratio_far(c3, i23 * d2);
        }
        irradiance[i] = 0.5 * sum;
    }
}

/* The same above the horizon, in the lanes that it cuts. Where it cuts an edge, the part above
 * runs from share t0 to t1 of the edge; the horizon itself is the edge from the place where the
 * outline goes down to the place where it comes up, and its gamma is n. */
static NEAR_AND_FAR void sum_edges_above_horizon(const ViewPacket *restrict view, Lanes irradiance,
                                                 bool is_near)
{
    const QuadFrame f = view->frame;
    const double start_x[4] = {0, f.ux, f.ux + f.vx, f.vx}, start_y[4] = {0, 0, f.vy, f.vy};
    const double edge_x[4] = {f.ux, f.vx, -f.ux, -f.vx}, edge_y[4] = {0, f.vy, 0, -f.vy};
    Lanes sum, down_x, down_y, up_x, up_y, heights[4];
    for (int k = 0; k < 4; k++) {
        SIMD for (int i = 0; i < LANES; i++) heights[k][i] =
            view->nx[i] * (view->x[i] + start_x[k]) + view->ny[i] * (view->y[i] + start_y[k]) +
            view->nz[i] * view->h[i];
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        sum[i] = 0;
        /* from the light's corner: small lights' ends are as far apart as they should be */
        down_x[i] = up_x[i] = 0;
        down_y[i] = up_y[i] = 0;
    }
    for (int k = 0; k < 4; k++) {
        const double ex = edge_x[k], ey = edge_y[k], ee = ex * ex + ey * ey;
        const double *first = heights[k], *last = heights[(k + 1) % 4];
        SIMD for (int i = 0; i < LANES; i++)
        {
            double h = view->h[i], nx = view->nx[i], ny = view->ny[i], nz = view->nz[i];
            double x = view->x[i] + start_x[k], y = view->y[i] + start_y[k];
            /* decided at the corners, so that two edges never disagree */
            double height = first[i], end = last[i], rise = end - height;
            double above0 = height < 0 ? 0.0 : 1.0, above1 = end < 0 ? 0.0 : 1.0;
            double crosses = above0 - above1; /* 1: goes down, -1: comes up */
            double crossing = -height / (crosses * crosses > 0 ? rise : 1);
            double t0 = above0 > 0 ? 0 : above1 * crossing;
            double t1 = above1 > 0 ? 1 : above0 * crossing;
            double width = t1 - t0, turn = x * ey - y * ex;
            double facing = width * (h * (ny * ex - nx * ey) + nz * turn);
            double cross_squared = width * width * (h * h * ee + turn * turn);
            double dot = x * x + y * y + h * h + (t0 + t1) * (x * ex + y * ey) + t0 * t1 * ee;
            double ratio = is_near ? angle_ratio_near(cross_squared, dot)
                                   : angle_ratio_far(cross_squared, 1 / dot);
            sum[i] += width > 0 ? facing * ratio : 0;
            down_x[i] = crosses > 0 ? start_x[k] + t1 * ex : down_x[i];
            down_y[i] = crosses > 0 ? start_y[k] + t1 * ey : down_y[i];
            up_x[i] = crosses < 0 ? start_x[k] + t0 * ex : up_x[i];
            up_y[i] = crosses < 0 ? start_y[k] + t0 * ey : up_y[i];
        }
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        double h = view->h[i], ex = up_x[i] - down_x[i], ey = up_y[i] - down_y[i];
        double x = view->x[i] + down_x[i], y = view->y[i] + down_y[i];
        double turn = x * ey - y * ex;
        double cross_squared = h * h * (ex * ex + ey * ey) + turn * turn;
        double dot = x * (x + ex) + y * (y + ey) + h * h;
        double n2 =
            view->nx[i] * view->nx[i] + view->ny[i] * view->ny[i] + view->nz[i] * view->nz[i];
        double theta = sqrt(cross_squared * n2) * angle_ratio_near(cross_squared, dot);
        theta = cross_squared > 0 ? theta : 0;
        double above = 0.5 * (sum[i] + theta);
        irradiance[i] = view->cut[i] > 0 ? above : irradiance[i];
    }
}

/* As if nothing stood before the light; of lanes that are not lit, anything. */
static void irradiance_without_spheres(const ViewPacket *view, Lanes irradiance)
{
    const bool cut = any(view->cut);
    if (view->is_near) {
        sum_edges(view, irradiance, true);
        if (cut)
            sum_edges_above_horizon(view, irradiance, true);
    } else {
        sum_edges(view, irradiance, false);
        if (cut)
            sum_edges_above_horizon(view, irradiance, false);
    }
}

/* ---- behind one sphere ---- */

/* Twice the irradiance of the part of the light in the cone (Stokes), but for the arcs' angle. */
typedef struct {
    Lanes edges; /* sum theta_k (gamma_k . n) over the hidden parts of the edges */
    /* Where the outline comes out of the cone an arc of the cone's circle begins, and it ends at
     * the place where the outline next goes in. With e^(i phi) a place on the circle: the product
     * of those where arcs end over those where they begin, times something positive. */
    Lanes real, imaginary;
    Lanes chord; /* sum of (n x C) . w / (C . w), arcs' ends less their beginnings */
} HiddenPacket;

/* Directions in which the cone's circle is measured: (C, b1, b2) right-handed, |b1| = |b2|. */
typedef struct {
    Lanes b1x, b1y, b1z, b2x, b2y, b2z;
    Lanes mx, my, mz; /* n x C */
} CirclePacket;

static void see_circle(const ViewPacket *restrict view, const CapPacket *restrict cap,
                       CirclePacket *restrict circle)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        double cx = cap->x[i], cy = cap->y[i], cz = cap->z[i];
        double scale = 1 / sqrt(cx * cx + cy * cy + cz * cz);
        double ax = cx * scale, ay = cy * scale, az = cz * scale;
        /* Duff et al., "Building an orthonormal basis, revisited", JCGT 6(1), 2017 */
        double sign = az < 0 ? -1.0 : 1.0, a = -1 / (sign + az), b = ax * ay * a;
        circle->b1x[i] = 1 + sign * ax * ax * a;
        circle->b1y[i] = sign * b;
        circle->b1z[i] = -sign * ax;
        circle->b2x[i] = b;
        circle->b2y[i] = sign + ay * ay * a;
        circle->b2z[i] = -ay;
        circle->mx[i] = view->ny[i] * cz - view->nz[i] * cy;
        circle->my[i] = view->nz[i] * cx - view->nx[i] * cz;
        circle->mz[i] = view->nx[i] * cy - view->ny[i] * cx;
    }
}

/* The part of edge k in the cone, from share s0 to s1. On w + s e, f is a s^2 + 2 b s + c; the
 * edge goes in where f rises and comes out where it falls. Whether it does either is decided at
 * the corners, so that two edges never disagree. */
static NEAR_AND_FAR void hide_edge(const ViewPacket *restrict view, const CapPacket *restrict cap,
                                   const CirclePacket *restrict circle, int k,
                                   HiddenPacket *restrict hidden, bool is_near)
{
    const QuadFrame q = view->frame;
    const double start_x[4] = {0, q.ux, q.ux + q.vx, q.vx}, start_y[4] = {0, 0, q.vy, q.vy};
    const double edge_x[4] = {q.ux, q.vx, -q.ux, -q.vx}, edge_y[4] = {0, q.vy, 0, -q.vy};
    const double dx = start_x[k], dy = start_y[k], ex = edge_x[k], ey = edge_y[k];
    const double ee = ex * ex + ey * ey;
    const double *restrict first = cap->corner[k], *restrict last = cap->corner[(k + 1) % 4];
    SIMD for (int i = 0; i < LANES; i++)
    {
        double x = view->x[i] + dx, y = view->y[i] + dy, h = view->h[i];
        double ww = x * x + y * y + h * h, we = x * ex + y * ey;
        double c_w = cap->x[i] * x + cap->y[i] * y + cap->z[i] * h;
        double c_e = cap->x[i] * ex + cap->y[i] * ey;
        double tt = cap->tangent_squared[i];
        double a = c_e * c_e - tt * ee, b = c_w * c_e - tt * we, c = c_w * c_w - tt * ww;
        double discriminant = b * b - a * c;
        double root = sqrt(discriminant > 0 ? discriminant : 0);
        double sum = b < 0 ? b - root : b + root; /* without cancellation */
        double rises = (b < 0 ? -sum : -c) / (b < 0 ? a : sum);
        double falls = (b < 0 ? -c : -sum) / (b < 0 ? sum : a);

        double in0 = first[i] > 0 ? 1.0 : 0.0, in1 = last[i] > 0 ? 1.0 : 0.0;
        double ahead = c_w + 0.5 * (rises + falls) * c_e;
        double in_and_out = (1 - in0) * (1 - in1) * (discriminant > 0 ? 1.0 : 0.0) *
                            (a < 0 ? 1.0 : 0.0) * (rises > 0 ? 1.0 : 0.0) *
                            (falls < 1 ? 1.0 : 0.0) * (ahead > 0 ? 1.0 : 0.0);
        double goes_in = (1 - in0) * in1 + in_and_out, comes_out = in0 * (1 - in1) + in_and_out;
        double s0 = rises > 0 ? (rises < 1 ? rises : 1) : 0;
        double s1 = falls > 0 ? (falls < 1 ? falls : 1) : 0;
        s0 = goes_in > 0 ? s0 : 0;
        s1 = comes_out > 0 ? s1 : 1;
        double hides = in0 + in1 + in_and_out;

        double width = s1 - s0, turn = x * ey - y * ex;
        double facing = h * (view->ny[i] * ex - view->nx[i] * ey) + view->nz[i] * turn;
        double cross_squared = width * width * (h * h * ee + turn * turn);
        double dot = ww + (s0 + s1) * we + s0 * s1 * ee;

        double w1 = circle->b1x[i] * x + circle->b1y[i] * y + circle->b1z[i] * h;
        double w2 = circle->b2x[i] * x + circle->b2y[i] * y + circle->b2z[i] * h;
        double wm = circle->mx[i] * x + circle->my[i] * y + circle->mz[i] * h;
        double e1 = circle->b1x[i] * ex + circle->b1y[i] * ey;
        double e2 = circle->b2x[i] * ex + circle->b2y[i] * ey;
        double em = circle->mx[i] * ex + circle->my[i] * ey;
        double re = goes_in > 0 ? w1 + s0 * e1 : 1, im = goes_in > 0 ? w2 + s0 * e2 : 0;
        double re1 = comes_out > 0 ? w1 + s1 * e1 : 1, im1 = comes_out > 0 ? w2 + s1 * e2 : 0;
        double re2 = re * re1 + im * im1, im2 = im * re1 - re * im1;
        double real = hidden->real[i], imaginary = hidden->imaginary[i];
        hidden->real[i] = real * re2 - imaginary * im2;
        hidden->imaginary[i] = real * im2 + imaginary * re2;
        double in = goes_in > 0 ? wm + s0 * em : 0, ahead0 = goes_in > 0 ? c_w + s0 * c_e : 1;
        double out = comes_out > 0 ? wm + s1 * em : 0, ahead1 = comes_out > 0 ? c_w + s1 * c_e : 1;
        double ahead01 = ahead0 * ahead1, inverse = 1 / (is_near ? ahead01 : ahead01 * dot);
        double ratio = is_near ? angle_ratio_near(cross_squared, dot)
                               : angle_ratio_far(cross_squared, inverse * ahead01);
        double term = width * facing * ratio;
        hidden->edges[i] += hides > 0 ? term : 0;
        /* in / ahead0 - out / ahead1 */
        hidden->chord[i] += (in * ahead1 - out * ahead0) * (is_near ? inverse : inverse * dot);
    }
}

/* Takes what the sphere hides from the irradiance. An arc from r0 to r1 that turns by phi adds
 * 1/2 (sin^2(alpha) phi (n . a) + cos(alpha) (n x a) . (r1 - r0)), where a = C / |C| and
 * r = cos(alpha) w / (a . w). */
static NEAR_AND_FAR void hide_cone(const ViewPacket *restrict view, const CapPacket *restrict cap,
                                   Lanes irradiance, bool is_near)
{
    CirclePacket circle;
    HiddenPacket hidden;
    see_circle(view, cap, &circle);
    SIMD for (int i = 0; i < LANES; i++)
    {
        hidden.edges[i] = hidden.imaginary[i] = hidden.chord[i] = 0;
        hidden.real[i] = 1;
    }
    for (int k = 0; k < 4; k++)
        hide_edge(view, cap, &circle, k, &hidden, is_near);
    SIMD for (int i = 0; i < LANES; i++)
    {
        double rr = cap->radius_squared, tt = cap->tangent_squared[i], dd = rr + tt;
        double turn = angle_of(hidden.real[i], hidden.imaginary[i]);
        /* In (0, 2 pi), but where it is 0 or 2 pi to rounding: 2 pi if the circle is all in the
         * light but for a touch. */
        double most = cap->corner[0][i] > cap->corner[1][i] ? cap->corner[0][i] : cap->corner[1][i];
        most = cap->corner[2][i] > most ? cap->corner[2][i] : most;
        most = cap->corner[3][i] > most ? cap->corner[3][i] : most;
        double least_turn = cap->amid[i] > 0 ? (most > 0 ? -1e-9 : 1e-9) : -1e-9;
        turn = turn < least_turn ? turn + 2 * PI : turn;
        double to_normal =
            view->nx[i] * cap->x[i] + view->ny[i] * cap->y[i] + view->nz[i] * cap->z[i];
        double arcs = (rr * turn * to_normal / sqrt(dd) + tt * hidden.chord[i]) / dd;
        double shown = irradiance[i] - 0.5 * (hidden.edges[i] + arcs);
        shown = shown > 0 ? shown : 0;
        irradiance[i] = cap->here[i] > 0 ? shown : irradiance[i];
    }
}

/* ---- the whole ---- */

static void clear_unlit(const ViewPacket *restrict view, Lanes irradiance)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        double positive = irradiance[i] > 0 ? irradiance[i] : 0;
        irradiance[i] = view->lit[i] > 0 ? positive : 0;
    }
}

/* The closed form of irradiance.c, lane by lane, in those of `lanes`. */
static void irradiance_by_lane(const Scene *scene, const Light *light, const HitPacket *hits,
                               const Lanes lanes, Lanes irradiance)
{
    for (int i = 0; i < LANES; i++) {
        const Hit hit = packet_lane(hits, i);
        if (lanes[i] > 0)
            irradiance[i] = irradiance_light(scene, light, &hit, NULL);
    }
}

static void irradiance_of_quad(const Scene *scene, const Light *light, const HitPacket *hits,
                               Lanes irradiance)
{
    ViewPacket view;
    CapPacket caps[MAX_CAPS];
    memset(irradiance, 0, sizeof(Lanes));
    const int nb_caps =
        hits->any_hit ? light_view_packet(scene, &light->shape.quad, hits, &view, caps) : 0;
    if (!hits->any_hit || !any(view.lit))
        return;
    irradiance_without_spheres(&view, irradiance);
    for (int k = 0; k < nb_caps; k++) {
        if (view.is_near)
            hide_cone(&view, &caps[k], irradiance, true);
        else
            hide_cone(&view, &caps[k], irradiance, false);
    }
    clear_unlit(&view, irradiance);
    if (!any(view.hard))
        return;
    SIMD for (int i = 0; i < LANES; i++) view.hard[i] *= view.lit[i];
    irradiance_by_lane(scene, light, hits, view.hard, irradiance);
}

void irradiance_packet(const Scene *scene, const Light *light, const HitPacket *hits,
                       double irradiance[LANES])
{
    Lanes hit;
    switch (light->type) {
    case LIGHT_QUAD:
        irradiance_of_quad(scene, light, hits, irradiance);
        return;
    case LIGHT_POINT:
    case LIGHT_DISK:
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        break;
    }
    for (int i = 0; i < LANES; i++) {
        irradiance[i] = 0;
        hit[i] = hits->object[i] >= 0 ? 1.0 : 0.0;
    }
    irradiance_by_lane(scene, light, hits, hit, irradiance);
}

/* One direction, and so one shadow ray, each. */
static void add_point_light(const Scene *scene, int light, const HitPacket *hits,
                            RgbPacket *radiance)
{
    for (int i = 0; i < LANES; i++) {
        const Hit hit = packet_lane(hits, i);
        if (hit.object == SCENE_NOTHING)
            continue;
        const Rgb lighting = exact_light(scene, light, &hit);
        radiance->r[i] = real_finite(radiance->r[i] + lighting.r);
        radiance->g[i] = real_finite(radiance->g[i] + lighting.g);
        radiance->b[i] = real_finite(radiance->b[i] + lighting.b);
    }
}

void exact_lighting_packet(const Scene *scene, const HitPacket *hits, RgbPacket *radiance)
{
    memset(radiance, 0, sizeof *radiance);
    for (int k = 0; k < scene->nb_lights && hits->any_hit; k++) {
        const Light *light = &scene->lights[k];
        if (!light_is_surface(light)) {
            add_point_light(scene, k, hits, radiance);
            continue;
        }
        const Rgb emitted = light_radiance(light);
        Lanes irradiance;
        irradiance_packet(scene, light, hits, irradiance);
        SIMD for (int i = 0; i < LANES; i++)
        {
            const real r = hits->brdf.r[i] * emitted.r * (real)irradiance[i];
            radiance->r[i] = real_finite(radiance->r[i] + r);
            const real g = hits->brdf.g[i] * emitted.g * (real)irradiance[i];
            radiance->g[i] = real_finite(radiance->g[i] + g);
            const real b = hits->brdf.b[i] * emitted.b * (real)irradiance[i];
            radiance->b[i] = real_finite(radiance->b[i] + b);
        }
    }
}
