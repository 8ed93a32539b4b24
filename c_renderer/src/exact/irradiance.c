#include "irradiance.h"

#include <stddef.h>

#include "core/estimator.h"
#include "outline.h"

/* Rounding error per radian of boundary and doubt: measured, docs/exact.md. */
static const double ROUNDING = 16 * DBL_EPSILON;

/* 1/2 n . integral of (r - r0) x dr along pieces of the boundary, their length [rad], and that times each
 * circle's doubt. */
typedef struct {
    double integral, length, doubt;
} Boundary;

static Boundary boundary_sum(Boundary a, Boundary b)
{
    return (Boundary){a.integral + b.integral, a.length + b.length, a.doubt + b.doubt};
}

/* What is not gone of a circle, from low to high. */
static Boundary remaining_arcs(const LightView *view, const Circle *circle, Intervals *gone,
                               double low, double high)
{
    const Vec3d pivot = vec3d_cross(view->normal, view->middle);
    Boundary sum = {0, 0, 0};
    intervals_invert(gone, low, high);
    for (int k = 0; k < gone->count; k++) {
        sum.integral += arc_integral(circle, gone->interval[k], view->normal, pivot);
        sum.length += arc_length(circle, gone->interval[k]);
    }
    sum.doubt = circle->doubt * sum.length;
    return sum;
}

/* Lambert: 1/2 sum theta_k (gamma_k . n). */
static Boundary polygon_boundary(const LightView *view)
{
    const Polygon *polygon = &view->polygon;
    Boundary sum = {0, 0, 0};
    for (int k = 0; k < polygon->nb_sides; k++) {
        const double angle = polygon_angle(polygon, k);
        sum.integral += 0.5 * angle * vec3d_dot(polygon->pole[k], view->normal);
        sum.length += angle;
        sum.doubt += angle * polygon_doubt(polygon, k);
    }
    return sum;
}

/* The light's own outline: without what hides it, or but for that. */
static Boundary outline_boundary(const LightView *view, bool hidden)
{
    Boundary sum = {0, 0, 0};
    for (int k = 0; k < view->nb_bounds; k++) {
        const Bound *bound = &view->bound[k];
        Intervals gone;
        gone.count = 0;
        if (hidden)
            light_view_gone(view, &bound->circle, NULL, &gone);
        else
            light_view_outside(view, &bound->circle, &gone);
        sum =
            boundary_sum(sum, remaining_arcs(view, &bound->circle, &gone, bound->low, bound->high));
    }
    return sum;
}

/* The outlines of what hides the light, walked the other way. */
static Boundary hiders_boundary(const LightView *view)
{
    Boundary sum = {0, 0, 0};
    for (int k = 0; k < view->nb_hiders; k++) {
        const Hider *hider = &view->hider[k];
        const Circle *circles[2] = {hider->has_silhouette ? &hider->silhouette : NULL,
                                    hider->cuts ? &hider->ring : NULL};
        for (int i = 0; i < 2; i++) {
            if (!circles[i])
                continue;
            Intervals gone;
            gone.count = 0;
            light_view_gone(view, circles[i], hider, &gone);
            Boundary arcs = remaining_arcs(view, circles[i], &gone, -PI, PI);
            arcs.integral = hider->shows_inside ? arcs.integral : -arcs.integral;
            sum = boundary_sum(sum, arcs);
        }
    }
    return sum;
}

double irradiance_light(const Scene *scene, const Light *light, const Hit *hit, double *error_bound)
{
    LightView view;
    light_view(scene, light, hit, &view);
    double value = 0, error = 0;
    if (view.is_lit) {
        const Boundary outline =
            view.is_polygon ? polygon_boundary(&view) : outline_boundary(&view, false);
        const double whole = value = fmax(outline.integral, 0);
        error = ROUNDING * outline.doubt;
        if (view.nb_hiders && whole > 0) {
            const Boundary arcs = hiders_boundary(&view);
            const Boundary left = boundary_sum(outline_boundary(&view, true), arcs);
            error += 2 * ROUNDING * arcs.doubt;
            const bool dark = left.length <= VIEW_TOUCH * outline.length;
            value = dark || left.integral <= error ? 0 : fmin(left.integral, whole);
        }
        error = view.complete ? error : whole;
    }
    if (error_bound)
        *error_bound = error;
    return value;
}

Rgb exact_light(const Scene *scene, int light, const Hit *hit)
{
    const Light *from = &scene->lights[light];
    if (light_is_surface(from)) {
        const double irradiance = irradiance_light(scene, from, hit, NULL);
        return rgb_scale(rgb_mul(hit->brdf, light_radiance(from)), (real)irradiance);
    }
    LightSampler sampler;
    light_sampler_create(&sampler, from, hit->point, SPREAD_AREA);
    return shadow_ray_radiance(scene, hit, light_sampler_draw(&sampler, (Uniform2){0, 0}));
}

Rgb exact_lighting(const Scene *scene, const Hit *hit)
{
    Rgb sum = {0, 0, 0};
    for (int light = 0; light < scene->nb_lights; light++)
        sum = rgb_finite(rgb_add(sum, exact_light(scene, light, hit)));
    return sum;
}
