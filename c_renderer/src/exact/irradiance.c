#include "irradiance.h"

#include <float.h>
#include <stddef.h>

#include "core/estimator.h"
#include "outline.h"
#include "quadrature.h"

/* Rounding error per radian of boundary: measured, docs/exact.md. */
static const double ROUNDING = 16 * DBL_EPSILON;

/* The angle that edge k subtends [rad]. */
static double edge_angle(const Outline *outline, int k)
{
    Vec3d w = outline->corner[k], next = outline_next(outline, k);
    double sine = vec3d_dot(outline->side[k], vec3d_cross(w, vec3d_sub(next, w)));
    return atan2(fmax(sine, 0), vec3d_dot(w, next));
}

/* Lambert: 1/2 sum theta_k (gamma_k . n); length: sum theta_k [rad]. */
static double irradiance_of_outline(const Outline *outline, Vec3d normal, double *length)
{
    double sum = 0;
    *length = 0;
    for (int k = 0; k < outline->nb_corners; k++) {
        double angle = edge_angle(outline, k);
        sum += angle * vec3d_dot(outline->side[k], normal);
        *length += angle;
    }
    return fmax(0.5 * sum, 0);
}

/* ---- the closed form behind spheres ---- */

/* The circular cone of directions that a sphere hides. */
typedef struct {
    Vec3d axis, b1, b2; /* orthonormal and right-handed */
    double angle, sine, cosine;
} Cap;

static Cap cap_of_ball(Ball ball)
{
    Cap cap;
    double distance = vec3d_length(ball.center);
    cap.axis = vec3d_scale(ball.center, 1 / distance);
    cap.sine = fmin(ball.radius / distance, 1);
    cap.cosine = sqrt(fmax((distance - ball.radius) * (distance + ball.radius), 0)) / distance;
    cap.angle = atan2(cap.sine, cap.cosine);
    /* Duff et al., "Building an orthonormal basis, revisited", JCGT 6(1), 2017 */
    double sign = cap.axis.z < 0 ? -1 : 1, a = -1 / (sign + cap.axis.z);
    double b = cap.axis.x * cap.axis.y * a;
    cap.b1 = (Vec3d){1 + sign * cap.axis.x * cap.axis.x * a, sign * b, -sign * cap.axis.x};
    cap.b2 = (Vec3d){b, sign + cap.axis.y * cap.axis.y * a, -cap.axis.y};
    return cap;
}

/* The light's outline, the surface's normal, and the cones. */
typedef struct {
    const Outline *outline;
    Vec3d normal;
    Vec3d pivot; /* n x r0, r0 amid the light */
    int nb_caps;
    Cap cap[VIEW_BALLS];
} Shadowed;

typedef struct {
    double start, end;
} Interval;

/* Sorted by start. */
typedef struct {
    int count;
    Interval interval[2 * (OUTLINE_CORNERS + VIEW_BALLS)];
} Intervals;

static void intervals_add(Intervals *set, double start, double end)
{
    if (start >= end)
        return;
    int k = set->count++;
    for (; k > 0 && set->interval[k - 1].start > start; k--)
        set->interval[k] = set->interval[k - 1];
    set->interval[k] = (Interval){start, end};
}

/* What the intervals leave free of [low, high], in the same place. */
static void intervals_invert(Intervals *set, double low, double high)
{
    int count = 0;
    double reached = low;
    for (int k = 0; k <= set->count; k++) {
        Interval next = k < set->count ? set->interval[k] : (Interval){high, high};
        if (next.start > reached) /* count <= k: nothing is overwritten before it is read */
            set->interval[count++] = (Interval){reached, fmin(next.start, high)};
        reached = fmax(reached, next.end);
        if (reached >= high)
            break;
    }
    set->count = count;
}

/* sqrt(sin^2 alpha - (gamma . a)^2), where a cap meets the great circle with pole gamma; else 0.
 * Edges and arcs take their crossings from the same root, and so agree on whether there are any. */
static double crossing_root(const Cap *cap, double across)
{
    return sqrt(fmax((cap->sine - across) * (cap->sine + across), 0));
}

/* A piece of the boundary: 1/2 n . integral of (r - r0) x dr, and its length [rad]. Round a closed
 * curve any r0 will do, but the pieces' ends agree to rounding only: with r0 amid the light that
 * costs rounding times the light's size, not times 1. */
typedef struct {
    double integral, length;
} Boundary;

/* What the caps leave of edge k; hidden: the longest part that one of them hides. */
static Boundary edge_outside_caps(const Shadowed *s, int k, double *hidden)
{
    const Vec3d side = s->outline->side[k];
    const Vec3d middle = vec3d_unit(
        vec3d_add(vec3d_unit(s->outline->corner[k]), vec3d_unit(outline_next(s->outline, k))));
    const double half = 0.5 * edge_angle(s->outline, k);
    Intervals shown = {.count = 0};
    *hidden = 0;
    for (int j = 0; j < s->nb_caps; j++) {
        const Cap *cap = &s->cap[j];
        double root = crossing_root(cap, vec3d_dot(side, cap->axis));
        if (root <= 0)
            continue;
        double reach = atan2(root, cap->cosine);
        double center =
            atan2(vec3d_dot(middle, vec3d_cross(cap->axis, side)), vec3d_dot(middle, cap->axis));
        double start = fmin(fmax(center - reach, -half), half);
        double end = fmin(fmax(center + reach, -half), half);
        intervals_add(&shown, start, end);
        *hidden = fmax(*hidden, end - start);
    }
    intervals_invert(&shown, -half, half);

    const double to_normal = vec3d_dot(s->normal, side);
    const double along = vec3d_dot(s->pivot, vec3d_cross(side, middle));
    const double ahead = vec3d_dot(s->pivot, middle);
    Boundary sum = {0, 0};
    for (int i = 0; i < shown.count; i++) {
        double length = shown.interval[i].end - shown.interval[i].start;
        double mean = 0.5 * (shown.interval[i].start + shown.interval[i].end);
        double chord = cos(mean) * along - sin(mean) * ahead;
        sum.integral += 0.5 * length * to_normal - sin(0.5 * length) * chord;
        sum.length += length;
    }
    return sum;
}

/* Adds the angles of a circle from middle - half to middle + half, as parts of [0, 2 pi]. */
static void add_angles(Intervals *set, double middle, double half)
{
    if (half >= PI) {
        intervals_add(set, 0, 2 * PI);
        return;
    }
    double start = middle - half;
    start = start < 0 ? start + 2 * PI : start;
    double end = start + 2 * half;
    intervals_add(set, start, fmin(end, 2 * PI));
    intervals_add(set, 0, end - 2 * PI);
}

/* The part of circle i that cap j covers. Its half-width is an angle of the spherical triangle
 * whose sides are the two caps' half-angles and the angle between their axes; from the half-angle
 * formula it keeps its digits in small triangles, and is 0 or pi where there is no triangle. */
static void add_other_cap(Intervals *covered, const Shadowed *shadowed, int i, int j)
{
    const Cap *cap = &shadowed->cap[i], *other = &shadowed->cap[j];
    double apart =
        atan2(vec3d_length(vec3d_cross(cap->axis, other->axis)), vec3d_dot(cap->axis, other->axis));
    bool within = apart + cap->angle <= other->angle * (1 + VIEW_TOUCH);
    bool around = apart + other->angle <= cap->angle * (1 + VIEW_TOUCH);
    if (within && around) /* of two equal caps the first one counts */
        within = j < i;
    if (within)
        add_angles(covered, 0, PI);
    if (within || around)
        return;
    double s = 0.5 * (apart + cap->angle + other->angle);
    double adjacent = sin(s) * sin(fmax(s - other->angle, 0));
    double opposite = sin(fmax(s - apart, 0)) * sin(fmax(s - cap->angle, 0));
    double half = 2 * atan2(sqrt(opposite), sqrt(adjacent));
    double middle = atan2(vec3d_dot(other->axis, cap->b2), vec3d_dot(other->axis, cap->b1));
    add_angles(covered, middle, half);
}

/* What is left of cap i's circle inside the outline and outside the other caps. With
 * r(phi) = cos(alpha) a + sin(alpha) (cos(phi) b1 + sin(phi) b2). */
static Boundary arcs_inside_outline(const Shadowed *s, int i)
{
    const Cap *cap = &s->cap[i];
    Intervals shown = {.count = 0};
    for (int k = 0; k < s->outline->nb_corners; k++) {
        const Vec3d side = s->outline->side[k];
        double across = vec3d_dot(side, cap->axis);
        double half = atan2(crossing_root(cap, across), cap->cosine * across);
        double middle = atan2(-vec3d_dot(side, cap->b2), -vec3d_dot(side, cap->b1));
        add_angles(&shown, middle, half);
    }
    for (int j = 0; j < s->nb_caps; j++)
        if (j != i)
            add_other_cap(&shown, s, i, j);
    intervals_invert(&shown, 0, 2 * PI);

    const double along = vec3d_dot(s->normal, cap->axis);
    const double n1 = vec3d_dot(s->normal, cap->b1), n2 = vec3d_dot(s->normal, cap->b2);
    const double p1 = vec3d_dot(s->pivot, cap->b1), p2 = vec3d_dot(s->pivot, cap->b2);
    Boundary sum = {0, 0};
    for (int k = 0; k < shown.count; k++) {
        double arc = shown.interval[k].end - shown.interval[k].start;
        double mean = 0.5 * (shown.interval[k].start + shown.interval[k].end);
        double cosine = cos(mean), sine = sin(mean);
        double chord = cap->cosine * (cosine * n1 + sine * n2) + cosine * p2 - sine * p1;
        sum.integral += cap->sine * (0.5 * cap->sine * along * arc - sin(0.5 * arc) * chord);
        sum.length += cap->sine * arc;
    }
    return sum;
}

/* The part of the outline outside the caps, `whole` being all of it (Stokes): what they leave of
 * the edges and, turning the other way, what the outline and the other caps leave of each circle. */
static double irradiance_beside_caps(const LightView *view, double whole, double whole_length,
                                     double *error)
{
    Shadowed s;
    s.outline = &view->outline;
    s.normal = view->normal;
    s.nb_caps = view->nb_balls;
    for (int i = 0; i < view->nb_balls; i++)
        s.cap[i] = cap_of_ball(view->ball[i]);
    Vec3d middle = {0, 0, 0};
    for (int k = 0; k < s.outline->nb_corners; k++)
        middle = vec3d_add(middle, vec3d_unit(s.outline->corner[k]));
    s.pivot = vec3d_cross(s.normal, vec3d_unit(middle));

    double sum = 0, length = 0, lost = 0;
    for (int k = 0; k < s.outline->nb_corners; k++) {
        double hidden;
        Boundary edge = edge_outside_caps(&s, k, &hidden);
        sum += edge.integral;
        length += edge.length;
        lost += hidden;
    }
    for (int i = 0; i < s.nb_caps; i++) {
        Boundary arcs = arcs_inside_outline(&s, i);
        sum -= arcs.integral;
        length += arcs.length;
        lost += arcs.length;
    }
    *error += ROUNDING * (length + lost);
    bool dark = length <= VIEW_TOUCH * whole_length;
    return dark || sum <= *error ? 0 : fmin(sum, whole);
}

/* ---- the whole ---- */

double irradiance_quad(const Scene *scene, const QuadLight *light, const Hit *hit,
                       double *error_bound)
{
    LightView view;
    light_view(scene, light, hit, &view);
    double length, whole = irradiance_of_outline(&view.outline, view.normal, &length);
    double value = whole, error = ROUNDING * length;
    if (view.nb_balls && whole > 0)
        value = view.closed_form ? irradiance_beside_caps(&view, whole, length, &error)
                                 : quadrature_irradiance(&view, whole, &error);
    if (error_bound)
        *error_bound = view.complete ? error : whole;
    return value;
}

static Rgb point_light(const Scene *scene, const Light *light, const Hit *hit)
{
    LightSampler sampler;
    light_sampler_create(&sampler, light, hit->point, SPREAD_AREA);
    return shadow_ray_radiance(scene, hit, light_sampler_draw(&sampler, (Uniform2){0, 0}));
}

Rgb exact_light(const Scene *scene, int light, const Hit *hit)
{
    const Light *from = &scene->lights[light];
    switch (from->type) {
    case LIGHT_POINT:
        return point_light(scene, from, hit);
    case LIGHT_QUAD: {
        const QuadLight *quad = &from->shape.quad;
        const double irradiance = irradiance_quad(scene, quad, hit, NULL);
        return rgb_scale(rgb_mul(hit->brdf, quad->radiance), (real)irradiance);
    }
    case LIGHT_DISK:
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        break;
    }
    return (Rgb){0, 0, 0};
}

Rgb exact_lighting(const Scene *scene, const Hit *hit)
{
    Rgb sum = {0, 0, 0};
    for (int light = 0; light < scene->nb_lights; light++)
        sum = rgb_finite(rgb_add(sum, exact_light(scene, light, hit)));
    return sum;
}
