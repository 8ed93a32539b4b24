#include "irradiance_packet.h"

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "irradiance.h"
#include "light_view.h"

/* Requests that the compiler is right without. NEAR_AND_FAR: written once and compiled for both,
 * as in kernel.c. ALIGNED: no vector lies across two cache lines. */
#if defined(__GNUC__)
#define NEAR_AND_FAR inline __attribute__((always_inline))
#define ALIGNED __attribute__((aligned(64)))
#else
#define NEAR_AND_FAR inline
#define ALIGNED
#endif

enum { MAX_CAPS = 4 }; /* spheres before one light; with more, lane by lane */

static const double PI = 3.14159265358979323846;

/* Conditions are kept as 1.0 and 0.0, so that all lanes are of one width. What is divided is
 * chosen before the division: gcc would not vectorise a division that may not be needed. */
typedef double Lanes[LANES] ALIGNED;

/* The light as sixteen points see it, in its own frame (light_view.h). */
typedef struct {
    QuadFrame frame;
    Lanes x, y, h;    /* the corner, from the point */
    Lanes nx, ny, nz; /* the surface's normal */
    Lanes lit;        /* may see some of it */
    Lanes cut;        /* ... but not what is below the horizon */
    Lanes hard;       /* left to irradiance.c */
    bool is_near;     /* in some lane an edge may subtend more than atan(1/2) */
} ViewPacket;

/* A sphere before the light. It hides the directions w with f(w) = (C.w)^2 - t^2 |w|^2 > 0 and
 * C.w > 0, where t^2 = |C|^2 - r^2. */
typedef struct {
    double radius_squared;
    Lanes x, y, z;         /* C */
    Lanes tangent_squared; /* t^2 */
    Lanes corner[4];       /* f at the light's corners */
    Lanes amid;            /* whether C points into the light */
    Lanes own;             /* the point is on this sphere */
    Lanes here;            /* lanes in which it may hide some of the light, but not all */
} CapPacket;

/* Whether a condition holds in some lane: by the bits of 1.0, since a sum of doubles would be taken
 * one after the other. */
static bool any(const Lanes condition)
{
    uint64_t bits[LANES], all = 0;
    memcpy(bits, condition, sizeof bits);
    for (int i = 0; i < LANES; i++)
        all |= bits[i];
    return all;
}

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

/* ---- the light and the horizon ---- */

static void see_quad(const QuadLight *light, const HitPacket *restrict hits,
                     ViewPacket *restrict view)
{
    view->frame = quad_frame(light);
    const QuadFrame f = view->frame;
    const Vec3d corner = vec3d_from(light->corner);
    const double along_x = 0.5 * (f.ux + f.vx), along_y = 0.5 * f.vy; /* to the middle */
    /* An edge l at distance D subtends at most 2 asin(l / 2 D), which is below atan(1/2) for
     * D > 2.18 l; and D > |middle| - half the diagonal. (a + b)^2 <= 2 (a^2 + b^2). */
    const double half_diagonal_squared =
        along_x * along_x + along_y * along_y + (f.ux * f.vx < 0 ? -f.ux * f.vx : 0);
    const double longest_squared = fmax(f.ux * f.ux, f.vx * f.vx + f.vy * f.vy);
    const double far_squared = 2 * (half_diagonal_squared + 2.18 * 2.18 * longest_squared);
    Lanes hit, near;
    SIMD for (int i = 0; i < LANES; i++) hit[i] = hits->object[i] >= 0 ? 1.0 : 0.0;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double dx = corner.x - (double)hits->point.x[i], dy = corner.y - (double)hits->point.y[i],
               dz = corner.z - (double)hits->point.z[i];
        double normal_x = (double)hits->normal.x[i], normal_y = (double)hits->normal.y[i],
               normal_z = (double)hits->normal.z[i];
        double x = dx * f.x.x + dy * f.x.y + dz * f.x.z;
        double y = dx * f.y.x + dy * f.y.y + dz * f.y.z;
        double h = dx * f.z.x + dy * f.z.y + dz * f.z.z;
        double nx = normal_x * f.x.x + normal_y * f.x.y + normal_z * f.x.z;
        double ny = normal_x * f.y.x + normal_y * f.y.y + normal_z * f.y.z;
        double nz = normal_x * f.z.x + normal_y * f.z.y + normal_z * f.z.z;
        double mx = x + along_x, my = y + along_y;
        double distance_squared = mx * mx + my * my + h * h;
        /* n . w is linear on the light: its extremes are at the corners */
        double middle = nx * mx + ny * my + nz * h;
        double spread = fabs(nx * (0.5 * f.ux)) + fabs(nx * (0.5 * f.vx) + ny * (0.5 * f.vy));
        double lit = h > VIEW_TOUCH * (fabs(mx) + fabs(my)) ? hit[i] : 0;
        lit = middle + spread > 0 ? lit : 0;
        view->cut[i] = middle < spread ? lit : 0;
        view->lit[i] = lit;
        near[i] = distance_squared < far_squared ? lit : 0;
        view->hard[i] = 0;
        view->x[i] = x;
        view->y[i] = y;
        view->h[i] = h;
        view->nx[i] = nx;
        view->ny[i] = ny;
        view->nz[i] = nz;
    }
    view->is_near = any(near);
}

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
        down_x[i] = up_x[i] = view->x[i];
        down_y[i] = up_y[i] = view->y[i];
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
            down_x[i] = crosses > 0 ? x + t1 * ex : down_x[i];
            down_y[i] = crosses > 0 ? y + t1 * ey : down_y[i];
            up_x[i] = crosses < 0 ? x + t0 * ex : up_x[i];
            up_y[i] = crosses < 0 ? y + t0 * ey : up_y[i];
        }
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        double h = view->h[i], ex = up_x[i] - down_x[i], ey = up_y[i] - down_y[i];
        double turn = down_x[i] * ey - down_y[i] * ex;
        double cross_squared = h * h * (ex * ex + ey * ey) + turn * turn;
        double dot = down_x[i] * up_x[i] + down_y[i] * up_y[i] + h * h;
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

/* ---- which spheres matter ---- */

/* Where the sphere is, and the lanes (here) in which it may hide some of the light: it does not
 * if it is wholly behind the light or beyond one of the planes through the point and a side. */
static void see_center(const Sphere *sphere, int object, const QuadLight *light,
                       const HitPacket *restrict hits, const ViewPacket *restrict view,
                       CapPacket *restrict cap)
{
    const QuadFrame f = view->frame;
    const Vec3d from_corner =
        quad_frame_direction(&f, vec3d_sub(vec3d_from(sphere->center), vec3d_from(light->corner)));
    const double r = (double)sphere->radius, rr = r * r, ux = f.ux, vx = f.vx, vy = f.vy;
    const double vv = vx * vx + vy * vy;
    Lanes other;
    SIMD for (int i = 0; i < LANES; i++) other[i] = hits->object[i] == object ? 0.0 : 1.0;
    cap->radius_squared = rr;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double h = view->h[i], x0 = view->x[i], y0 = view->y[i];
        double cx = x0 + from_corner.x, cy = y0 + from_corner.y, cz = h + from_corner.z;
        double x1 = x0 + ux, y1 = y0 + vy, h2 = h * h;
        double right = x1 * vy - y0 * vx, left = x0 * vy - y0 * vx;
        /* (w x e) . C at each side, and how far below 0 it may be: r |w x e| */
        double level = h * (vx * cy - vy * cx);
        double in0 = h * cy - y0 * cz, in2 = y1 * cz - h * cy;
        double in1 = level + right * cz, in3 = -level - left * cz;
        double beyond0 = in0 < 0 ? in0 * in0 - rr * (h2 + y0 * y0) : -1;
        double beyond1 = in1 < 0 ? in1 * in1 - rr * (h2 * vv + right * right) : -1;
        double beyond2 = in2 < 0 ? in2 * in2 - rr * (h2 + y1 * y1) : -1;
        double beyond3 = in3 < 0 ? in3 * in3 - rr * (h2 * vv + left * left) : -1;
        double apart = cz - h - r;
        apart = beyond0 > apart ? beyond0 : apart;
        apart = beyond1 > apart ? beyond1 : apart;
        apart = beyond2 > apart ? beyond2 : apart;
        apart = beyond3 > apart ? beyond3 : apart;
        double amid = in0 < in2 ? in0 : in2;
        amid = in1 < amid ? in1 : amid;
        amid = in3 < amid ? in3 : amid;
        /* from outside, the horizon hides one's own sphere */
        double inwards = view->nx[i] * cx + view->ny[i] * cy + view->nz[i] * cz;
        double here = inwards > 0 ? 1.0 : other[i];
        here = apart < 0 ? here : 0;
        cap->here[i] = here * view->lit[i] * (1 - view->hard[i]);
        cap->own[i] = 1 - other[i];
        cap->amid[i] = amid > 0 ? 1.0 : 0.0;
        cap->x[i] = cx;
        cap->y[i] = cy;
        cap->z[i] = cz;
    }
}

/* How the light lies to the sphere's cone: lanes whose light is all in it are no longer lit, and
 * lanes are hard where the sphere is not wholly between the point and the light. */
static void see_cone(ViewPacket *restrict view, CapPacket *restrict cap)
{
    const QuadFrame f = view->frame;
    const double rr = cap->radius_squared, r = sqrt(rr);
    SIMD for (int i = 0; i < LANES; i++)
    {
        double cx = cap->x[i], cy = cap->y[i], cz = cap->z[i], h = view->h[i];
        double x0 = view->x[i], x1 = x0 + f.ux, x3 = x0 + f.vx, x2 = x1 + f.vx;
        double y0 = view->y[i], y1 = y0 + f.vy;
        double low = h * h + y0 * y0, high = h * h + y1 * y1;
        double dd = cx * cx + cy * cy + cz * cz, tt = dd - rr;
        double ahead0 = cx * x0 + cy * y0 + cz * h, ahead1 = ahead0 + cx * f.ux;
        double ahead3 = cx * x3 + cy * y1 + cz * h, ahead2 = ahead3 + cx * f.ux;
        double f0 = ahead0 * ahead0 - tt * (low + x0 * x0);
        double f1 = ahead1 * ahead1 - tt * (low + x1 * x1);
        double f2 = ahead2 * ahead2 - tt * (high + x2 * x2);
        double f3 = ahead3 * ahead3 - tt * (high + x3 * x3);
        double strange = cz - h + r > 0 ? 1.0 : 0.0;
        /* f loses digits as 1 / sin^2 of the cone's half-angle, t as 1 / cos^2 */
        strange = rr > 1e-7 * dd ? strange : 1;
        strange = tt > 1e-7 * dd ? strange : 1;
        double hard = strange > 0 ? 1.0 : cap->own[i];
        f0 = ahead0 > 0 ? f0 : -1;
        f1 = ahead1 > 0 ? f1 : -1;
        f2 = ahead2 > 0 ? f2 : -1;
        f3 = ahead3 > 0 ? f3 : -1;
        double least = f0 < f1 ? f0 : f1, least2 = f2 < f3 ? f2 : f3;
        least = least < least2 ? least : least2;
        /* four hidden corners hide all between them: the cone is convex */
        double all = least > 0 ? 1 - hard : 0;
        hard = all > 0 ? 0 : (view->cut[i] > 0 ? 1 : hard);
        double here = cap->here[i];
        view->lit[i] -= here * all;
        view->hard[i] += here * hard;
        cap->here[i] = here * (1 - all) * (1 - hard);
        cap->tangent_squared[i] = tt;
        cap->corner[0][i] = f0;
        cap->corner[1][i] = f1;
        cap->corner[2][i] = f2;
        cap->corner[3][i] = f3;
    }
}

/* Lanes in which two cones may overlap are hard. */
static void part_cones(ViewPacket *restrict view, CapPacket *restrict one, CapPacket *restrict two)
{
    const double radii = sqrt(one->radius_squared * two->radius_squared);
    Lanes overlap;
    SIMD for (int i = 0; i < LANES; i++)
    {
        double dot = one->x[i] * two->x[i] + one->y[i] * two->y[i] + one->z[i] * two->z[i];
        double both = one->here[i] * two->here[i];
        /* |C1| |C2| times the cosines of the angle between the axes and of the half-angles' sum */
        double apart = sqrt(fabs(one->tangent_squared[i] * two->tangent_squared[i])) - radii;
        overlap[i] = dot > apart ? both : 0;
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        view->hard[i] = overlap[i] > 0 ? 1 : view->hard[i];
        one->here[i] = overlap[i] > 0 ? 0 : one->here[i];
        two->here[i] = overlap[i] > 0 ? 0 : two->here[i];
    }
}

/* Adds the sphere to the caps if it hides some of the light from some lane. */
static void see_sphere(const Sphere *sphere, int object, const QuadLight *light,
                       const HitPacket *hits, ViewPacket *view, CapPacket caps[MAX_CAPS],
                       int *nb_caps)
{
    CapPacket one_too_many;
    CapPacket *cap = *nb_caps < MAX_CAPS ? &caps[*nb_caps] : &one_too_many;
    see_center(sphere, object, light, hits, view, cap);
    if (!any(cap->here))
        return;
    see_cone(view, cap);
    if (!any(cap->here))
        return;
    if (cap == &one_too_many) {
        SIMD for (int i = 0; i < LANES; i++) view->hard[i] += cap->here[i];
        return;
    }
    for (int k = 0; k < *nb_caps; k++)
        part_cones(view, &caps[k], cap);
    ++*nb_caps;
}

/* Lanes are hard whose light a plane may cut; where it hides the light they are no longer lit. */
static void see_plane(const Plane *plane, int object, const QuadLight *light,
                      const HitPacket *restrict hits, ViewPacket *restrict view)
{
    Lanes other;
    SIMD for (int i = 0; i < LANES; i++) other[i] = hits->object[i] == object ? 0.0 : 1.0;
    if (!any(other))
        return;
    const Vec3d n = vec3d_from(plane->normal), u = vec3d_from(light->edge_u);
    const Vec3d from_plane = vec3d_sub(vec3d_from(light->corner), vec3d_from(plane->point));
    const double along_u = vec3d_dot(n, u), along_v = vec3d_dot(n, vec3d_from(light->edge_v));
    const double corner = vec3d_dot(n, from_plane), middle = corner + 0.5 * (along_u + along_v);
    const double spread = 0.5 * (fabs(along_u) + fabs(along_v));
    const double above = middle > spread ? 1 : 0, below = middle < -spread ? 1 : 0;
    const Vec3d normal = quad_frame_direction(&view->frame, n);
    const double reach = fabs(from_plane.x) + fabs(from_plane.y) + fabs(from_plane.z);
    SIMD for (int i = 0; i < LANES; i++)
    {
        double x = view->x[i], y = view->y[i], h = view->h[i]; /* the corner, from the point */
        double side = corner - (normal.x * x + normal.y * y + normal.z * h);
        double touch = VIEW_TOUCH * (reach + fabs(x) + fabs(y) + fabs(h));
        double clear = side > touch ? above : side < -touch ? below : 0;
        double hidden = side > touch ? below : side < -touch ? above : 0;
        double unsure = view->lit[i] * other[i] * (1 - clear) * (1 - hidden);
        view->hard[i] = unsure > 0 ? 1 : view->hard[i];
        view->lit[i] *= 1 - other[i] * hidden;
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

/* The caps and how many they are. */
static int see_light(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                     ViewPacket *view, CapPacket caps[MAX_CAPS])
{
    int nb_caps = 0;
    see_quad(light, hits, view);
    for (int k = 0; k < scene->nb_planes; k++)
        see_plane(&scene->planes[k], scene->nb_spheres + k, light, hits, view);
    for (int k = 0; k < scene->nb_spheres; k++)
        see_sphere(&scene->spheres[k], k, light, hits, view, caps, &nb_caps);
    return nb_caps;
}

static void clear_unlit(const ViewPacket *restrict view, Lanes irradiance)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        double positive = irradiance[i] > 0 ? irradiance[i] : 0;
        irradiance[i] = view->lit[i] > 0 ? positive : 0;
    }
}

void irradiance_packet(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                       double irradiance[LANES])
{
    ViewPacket view;
    CapPacket caps[MAX_CAPS];
    memset(irradiance, 0, sizeof(Lanes));
    const int nb_caps = hits->nb_hits ? see_light(scene, light, hits, &view, caps) : 0;
    if (!hits->nb_hits || !any(view.lit))
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
    for (int i = 0; i < LANES; i++) {
        const Hit hit = packet_lane(hits, i);
        if (view.hard[i] > 0 && view.lit[i] > 0)
            irradiance[i] = irradiance_quad(scene, light, &hit, NULL);
    }
}

int irradiance_packet_of_plain(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                               double irradiance[LANES], int known[LANES])
{
    ViewPacket view;
    CapPacket caps[MAX_CAPS];
    int nb_unknown = 0;
    memset(irradiance, 0, sizeof(Lanes));
    const int nb_caps = hits->nb_hits ? see_light(scene, light, hits, &view, caps) : 0;
    for (int i = 0; i < LANES; i++)
        known[i] = 1;
    if (!hits->nb_hits || !any(view.lit))
        return 0;
    irradiance_without_spheres(&view, irradiance);
    clear_unlit(&view, irradiance);
    for (int i = 0; i < LANES; i++) {
        double unknown = view.hard[i] + view.cut[i];
        for (int k = 0; k < nb_caps; k++)
            unknown += caps[k].here[i];
        known[i] = !(unknown > 0 && view.lit[i] > 0);
        nb_unknown += !known[i];
    }
    return nb_unknown;
}

void exact_lighting_packet(const Scene *scene, const HitPacket *hits, RgbPacket *radiance)
{
    memset(radiance, 0, sizeof *radiance);
    for (int k = 0; k < scene->nb_lights && hits->nb_hits; k++) {
        const Light *light = &scene->lights[k];
        double irradiance[LANES];
        switch (light->type) {
        case LIGHT_POINT:
            for (int i = 0; i < LANES; i++) {
                const Hit hit = packet_lane(hits, i);
                if (hit.object == SCENE_NOTHING)
                    continue;
                const Rgb lighting = exact_light(scene, k, &hit);
                radiance->r[i] += lighting.r;
                radiance->g[i] += lighting.g;
                radiance->b[i] += lighting.b;
            }
            break;
        case LIGHT_QUAD:
            irradiance_packet(scene, &light->shape.quad, hits, irradiance);
            SIMD for (int i = 0; i < LANES; i++)
            {
                const Rgb emitted = light->shape.quad.radiance;
                radiance->r[i] += hits->brdf.r[i] * emitted.r * (real)irradiance[i];
                radiance->g[i] += hits->brdf.g[i] * emitted.g * (real)irradiance[i];
                radiance->b[i] += hits->brdf.b[i] * emitted.b * (real)irradiance[i];
            }
            break;
        }
    }
}
