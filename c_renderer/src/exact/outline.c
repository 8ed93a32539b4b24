#include "outline.h"

/* ---- half-spaces: the horizon and planes ---- */

/* What plane k leaves to be seen; k = -1: the horizon. False where it hides nothing: it is the
 * surface's own, or the point is in it. */
static bool half_space_left(const Scene *scene, const Hit *hit, int k, HalfSpace *left)
{
    if (k < 0) {
        *left = (HalfSpace){vec3d_unit(vec3d_from(hit->normal)), 0};
        return true;
    }
    if (hit->object == scene->nb_spheres + k)
        return false;
    const Plane *plane = &scene->planes[k];
    const Vec3d normal = vec3d_from(plane->normal);
    const double height =
        vec3d_dot(normal, vec3d_sub(vec3d_from(hit->point), vec3d_from(plane->point)));
    *left = (HalfSpace){vec3d_scale(normal, height > 0 ? 1 : -1), fabs(height)};
    return height != 0;
}

/* Above 0, below 0, or 0 for a place that touches the plane. */
static double touched(double height, double reach)
{
    return fabs(height) <= VIEW_TOUCH * reach ? 0 : height;
}

/* ---- polygons ---- */

static Vec3d side_pole(const Polygon *polygon, int k)
{
    const Vec3d edge = vec3d_sub(polygon_next(polygon, k), polygon->place[k]);
    return vec3d_unit(vec3d_cross(vec3d_add(polygon->corner, polygon->place[k]), edge));
}

double polygon_angle(const Polygon *polygon, int k)
{
    const Vec3d edge = vec3d_sub(polygon_next(polygon, k), polygon->place[k]);
    const Vec3d start = vec3d_add(polygon->corner, polygon->place[k]);
    const double sine = vec3d_dot(polygon->pole[k], vec3d_cross(start, edge));
    const double cosine = vec3d_dot(start, start) + vec3d_dot(start, edge);
    return atan2(fmax(sine, 0), cosine);
}

double polygon_doubt(const Polygon *polygon, int k)
{
    const Vec3d edge = vec3d_sub(polygon_next(polygon, k), polygon->place[k]);
    const Vec3d start = vec3d_add(polygon->corner, polygon->place[k]);
    const double beside = vec3d_length(vec3d_cross(start, edge));
    return fmax(vec3d_length(start) * vec3d_length(edge) / beside, 1);
}

/* What a half-space leaves of the polygon (Sutherland-Hodgman). False: no room, left as it was. */
static bool polygon_clip(Polygon *polygon, HalfSpace half_space, Vec3d axis)
{
    double height[OUTLINE_SIDES], lowest = 0;
    const double at_corner = half_space_height(half_space, polygon->corner);
    const double reach = vec3d_length(polygon->corner) + half_space.offset;
    for (int k = 0; k < polygon->nb_sides; k++) {
        height[k] = touched(at_corner + vec3d_dot(half_space.normal, polygon->place[k]), reach);
        lowest = fmin(lowest, height[k]);
    }
    if (lowest == 0)
        return true;
    if (polygon->nb_sides == OUTLINE_SIDES)
        return false;
    Polygon left = {.corner = polygon->corner};
    for (int k = 0; k < polygon->nb_sides; k++) {
        const double next_height = height[k + 1 < polygon->nb_sides ? k + 1 : 0];
        const bool inside = height[k] >= 0, next_inside = next_height >= 0;
        if (inside) {
            left.place[left.nb_sides] = polygon->place[k];
            left.pole[left.nb_sides++] = polygon->pole[k];
        }
        if (inside == next_inside)
            continue;
        const Vec3d edge = vec3d_sub(polygon_next(polygon, k), polygon->place[k]);
        const double share = height[k] / (height[k] - next_height);
        const Vec3d crossing = vec3d_along(polygon->place[k], edge, share);
        const Vec3d cut =
            vec3d_cross(vec3d_add(polygon->corner, crossing), vec3d_cross(half_space.normal, axis));
        const Vec3d cut_pole = half_space.offset > 0 ? vec3d_unit(cut) : half_space.normal;
        left.place[left.nb_sides] = crossing;
        left.pole[left.nb_sides++] = inside ? cut_pole : polygon->pole[k];
    }
    *polygon = left;
    return true;
}

/* A parallelogram, or its half up to the diagonal. */
static void see_polygon(const Scene *scene, const FlatLight *light, int nb_sides, const Hit *hit,
                        LightView *view)
{
    const Vec3d u = vec3d_from(light->edge_u), v = vec3d_from(light->edge_v);
    Polygon *polygon = &view->polygon;
    polygon->corner = vec3d_sub(vec3d_from(light->corner), vec3d_from(hit->point));
    polygon->nb_sides = nb_sides;
    polygon->place[0] = (Vec3d){0, 0, 0};
    polygon->place[1] = u;
    polygon->place[2] = nb_sides == 4 ? vec3d_add(u, v) : v;
    polygon->place[3] = v;
    view->is_flat = view->is_polygon = true;
    view->axis = vec3d_unit(vec3d_cross(u, v));
    view->height = vec3d_dot(view->axis, polygon->corner);
    /* the light shines on one side, and not on its own plane */
    const double reach = vec3d_length(polygon->corner) + vec3d_length(u) + vec3d_length(v);
    view->is_lit = view->height > VIEW_TOUCH * reach;
    for (int k = 0; k < nb_sides; k++)
        polygon->pole[k] = side_pole(polygon, k);
    for (int k = -1; k < scene->nb_planes && view->is_lit; k++) {
        HalfSpace left;
        if (half_space_left(scene, hit, k, &left))
            view->complete &= polygon_clip(polygon, left, view->axis);
        view->is_lit = polygon->nb_sides > 0;
    }
    Vec3d middle = {0, 0, 0};
    for (int k = 0; k < polygon->nb_sides; k++)
        middle = vec3d_add(middle, vec3d_unit(vec3d_add(polygon->corner, polygon->place[k])));
    view->middle = vec3d_unit(middle);
}

static void bound_polygon(LightView *view)
{
    const Polygon *polygon = &view->polygon;
    view->nb_bounds = polygon->nb_sides;
    for (int k = 0; k < polygon->nb_sides; k++) {
        const Vec3d first = vec3d_add(polygon->corner, polygon->place[k]);
        const Vec3d last = vec3d_add(polygon->corner, polygon_next(polygon, k));
        const Vec3d middle = vec3d_add(vec3d_unit(first), vec3d_unit(last));
        const double half = 0.5 * polygon_angle(polygon, k);
        view->bound[k] = (Bound){circle_great(polygon->pole[k], middle), -half, half};
    }
}

/* ---- round lights ---- */

static void add_bound(LightView *view, Circle circle)
{
    circle.rank = VIEW_HIDERS + view->nb_bounds; /* what hides comes first */
    if (view->nb_bounds < OUTLINE_SIDES)
        view->bound[view->nb_bounds++] = (Bound){circle, -PI, PI};
    else
        view->complete = false;
}

static void see_disk(const Scene *scene, const DiskLight *light, const Hit *hit, LightView *view)
{
    const Vec3d center = vec3d_sub(vec3d_from(light->center), vec3d_from(hit->point));
    const double radius = (double)light->radius, distance = vec3d_length(center);
    view->is_flat = true;
    view->axis = vec3d_unit(vec3d_from(light->normal));
    view->height = vec3d_dot(view->axis, center);
    view->middle = vec3d_scale(center, 1 / distance);
    view->is_lit = view->height > VIEW_TOUCH * (distance + radius);
    if (!view->is_lit)
        return;
    add_bound(view, circle_rim(center, view->axis, radius));
    for (int k = -1; k < scene->nb_planes; k++) {
        HalfSpace left;
        if (!half_space_left(scene, hit, k, &left))
            continue;
        const Vec3d beside = vec3d_reject(left.normal, view->axis); /* uphill in the disk */
        const double slope = vec3d_length(beside), reach = distance + radius + left.offset;
        const double height = half_space_height(left, center);
        if (touched(height - slope * radius, reach) >= 0)
            continue;
        view->is_lit &= touched(height + slope * radius, reach) > 0;
        const Vec3d cut = vec3d_along(center, beside, -height / (slope * slope));
        const Vec3d along = vec3d_cross(left.normal, view->axis);
        const Vec3d pole = vec3d_cross(cut, along);
        Circle side = circle_great(left.offset > 0 ? vec3d_unit(pole) : left.normal, cut);
        if (left.offset > 0)
            side.doubt = fmax(reach * slope / vec3d_length(pole), 1);
        add_bound(view, side);
    }
}

static bool same(Vec3d a, Vec3d b)
{
    return a.x == b.x && a.y == b.y && a.z == b.z;
}

/* Once, if it is given twice. */
static void add_hider(LightView *view, const Hider *hider)
{
    for (int k = 0; k < view->nb_hiders; k++) {
        const Circle *cap = &view->hider[k].silhouette, *ring = &view->hider[k].ring;
        if (same(cap->center, hider->silhouette.center) &&
            cap->radius == hider->silhouette.radius && same(ring->center, hider->ring.center) &&
            ring->radius == hider->ring.radius)
            return;
    }
    if (view->nb_hiders == VIEW_HIDERS) {
        view->complete = false;
        return;
    }
    view->hider[view->nb_hiders] = *hider;
    view->hider[view->nb_hiders].silhouette.rank = view->hider[view->nb_hiders].ring.rank =
        view->nb_hiders;
    view->nb_hiders++;
}

/* A ring about a sphere light, which turns so that what it cuts off is inside. */
static Hider ring_hider(const LightView *view, HalfSpace cut_off)
{
    const double length = vec3d_length(cut_off.normal);
    const double depth = half_space_height(cut_off, view->center) / length;
    const Vec3d axis = vec3d_scale(cut_off.normal, -1 / length);
    const double squared = (view->radius - depth) * (view->radius + depth);
    const Vec3d center = vec3d_along(view->center, axis, depth);
    return (Hider){.cuts = true,
                   .cut_off = cut_off,
                   .ring = circle_rim(center, axis, sqrt(fmax(squared, 0))),
                   .ring_front = {vec3d_scale(view->center, -1), view->power}};
}

static void see_sphere_light(const Scene *scene, const SphereLight *light, const Hit *hit,
                             LightView *view)
{
    view->center = vec3d_sub(vec3d_from(light->center), vec3d_from(hit->point));
    view->radius = (double)light->radius;
    view->power = ball_power(view->center, view->radius);
    view->middle = vec3d_unit(view->center);
    view->is_lit = view->power > 0; /* it emits outwards */
    if (!view->is_lit)
        return;
    add_bound(view, circle_cap(view->center, view->radius));
    const double distance = vec3d_length(view->center);
    for (int k = -1; k < scene->nb_planes; k++) {
        HalfSpace left;
        if (!half_space_left(scene, hit, k, &left))
            continue;
        const double height = half_space_height(left, view->center);
        const double reach = distance + view->radius + left.offset;
        const double length = vec3d_length(left.normal); /* 1 but for rounding */
        if (touched(height - length * view->radius, reach) >= 0)
            continue;
        view->is_lit &= touched(height + length * view->radius, reach) > 0;
        if (k < 0) {
            add_bound(view, circle_great(left.normal, view->center));
            continue;
        }
        const HalfSpace cut_off = {vec3d_scale(left.normal, -1), -left.offset};
        const Hider hider = ring_hider(view, cut_off);
        add_hider(view, &hider);
    }
}

/* ---- balls ---- */

typedef struct {
    Vec3d center; /* from the point [m] */
    double radius, power;
    bool is_own; /* the point is on it */
    bool holds_point;
} Ball;

/* Whether the ball's cone may meet the cone about `middle`. */
static bool cones_may_meet(const Ball *ball, Vec3d middle, double cos_spread)
{
    if (cos_spread <= 0)
        return true; /* so wide a light need not be where its corners are */
    const double sin_spread = sqrt(fmax(1 - cos_spread * cos_spread, 0));
    const double distance = vec3d_length(ball->center), sine = fmin(ball->radius / distance, 1);
    const double cosine = sqrt(1 - sine * sine);
    /* angle to the middle <= half-angle + spread; 1e-7 covers the square roots */
    const double reach = cosine * cos_spread - sine * sin_spread - 1e-7;
    return vec3d_dot(ball->center, middle) >= distance * reach;
}

static bool may_hide(const LightView *view, const Ball *ball)
{
    const Polygon *polygon = &view->polygon;
    double cos_spread = 1;
    if (!view->is_polygon) {
        const Circle *outline = &view->bound[0].circle;
        const double far = view->is_flat ? vec3d_length(outline->center) : 1;
        const double sine = fmin(outline->radius / far, 1);
        cos_spread = sqrt(1 - sine * sine);
        return cones_may_meet(ball, view->middle, cos_spread);
    }
    for (int k = 0; k < polygon->nb_sides; k++)
        if (vec3d_dot(polygon->pole[k], ball->center) <= -ball->radius)
            return false;
    for (int k = 0; k < polygon->nb_sides; k++) {
        const Vec3d corner = vec3d_add(polygon->corner, polygon->place[k]);
        cos_spread = fmin(cos_spread, vec3d_dot(vec3d_unit(corner), view->middle));
    }
    return cones_may_meet(ball, view->middle, cos_spread);
}

/* The least of direction . X on a flat light. */
static double lowest(const LightView *view, Vec3d direction)
{
    if (!view->is_polygon) {
        const Circle *rim = &view->bound[0].circle;
        return vec3d_dot(direction, rim->center) -
               rim->radius * vec3d_length(vec3d_reject(direction, rim->axis));
    }
    double least = INFINITY;
    for (int k = 0; k < view->polygon.nb_sides; k++)
        least = fmin(least, vec3d_dot(direction, view->polygon.place[k]));
    return least + vec3d_dot(direction, view->polygon.corner);
}

/* Whether the light is wholly in a ball whose part of the light's plane is the disk. */
static bool is_in_disk(const LightView *view, Vec3d center, double radius)
{
    if (!view->is_polygon) {
        const Circle *rim = &view->bound[0].circle;
        return vec3d_length(vec3d_sub(rim->center, center)) + rim->radius <= radius;
    }
    const Vec3d from_center = vec3d_sub(view->polygon.corner, center);
    double farthest = 0;
    for (int k = 0; k < view->polygon.nb_sides; k++)
        farthest = fmax(farthest, vec3d_length(vec3d_add(from_center, view->polygon.place[k])));
    return farthest <= radius;
}

/* Before a flat light. Behind the plane of its tangent circle a ball hides its whole cone; before
 * that plane it hides only what is in it. From inside a ball one sees only what is in it as well. */
static void see_ball(LightView *view, const Ball *ball)
{
    const double beyond = vec3d_dot(view->axis, ball->center) - view->height;
    const double squared = (ball->radius - beyond) * (ball->radius + beyond);
    if (ball->holds_point && squared <= 0)
        view->is_lit = false;
    if (ball->holds_point ? squared <= 0 : beyond >= ball->radius || !may_hide(view, ball))
        return;
    Hider hider = {.has_silhouette = !ball->holds_point, .shows_inside = ball->holds_point};
    hider.cuts = ball->holds_point || (squared > 0 && lowest(view, ball->center) < ball->power);
    if (hider.cuts) {
        const Vec3d middle = vec3d_along(ball->center, view->axis, -beyond);
        const bool holds_light = is_in_disk(view, middle, sqrt(squared));
        if (holds_light) {
            view->is_lit &= ball->holds_point;
            return;
        }
        hider.ring = circle_rim(middle, view->axis, sqrt(squared));
        hider.ring_front = ball->holds_point
                               ? (HalfSpace){{0, 0, 0}, 1}
                               : (HalfSpace){vec3d_scale(ball->center, -1), ball->power};
    }
    if (hider.has_silhouette) {
        hider.silhouette = circle_cap(ball->center, ball->radius);
        const Vec3d tangent = vec3d_scale(view->axis, -hider.silhouette.tangent);
        hider.silhouette_front = (HalfSpace){tangent, view->height};
        /* X . C >= t^2, of directions: X . axis = height */
        const Vec3d behind = vec3d_scale(ball->center, view->height);
        hider.behind = (HalfSpace){vec3d_along(behind, view->axis, -ball->power), 0};
    }
    add_hider(view, &hider);
}

/* Before a sphere light. Of two balls that do not meet, the one with the shorter tangent is before
 * the other. If they meet, the light's places in the ball are hidden, and what the ball's cone hides
 * before its surface meets the light's. */
static void see_ball_at_sphere(LightView *view, const Ball *ball)
{
    const Vec3d between = vec3d_sub(ball->center, view->center);
    const double apart = vec3d_length(between);
    const bool meets = apart < ball->radius + view->radius;
    const bool holds_light = apart + view->radius <= ball->radius;
    if (holds_light ? !ball->holds_point : ball->holds_point && !meets)
        view->is_lit = false;
    if (holds_light || apart + ball->radius <= view->radius || !view->is_lit)
        return;
    const bool is_before = !ball->holds_point && ball->power < view->power;
    if (!meets && !is_before)
        return;
    if (!ball->holds_point) {
        const double sine = fmin(view->bound[0].circle.radius, 1);
        if (!cones_may_meet(ball, view->middle, sqrt(1 - sine * sine)))
            return;
    }
    Hider hider = {.cuts = false};
    if (meets) { /* |X - C|^2 <= r^2 on the light */
        const double side = ball->holds_point ? -2 : 2;
        hider = ring_hider(view, (HalfSpace){vec3d_scale(between, side),
                                             0.5 * side * (view->power - ball->power)});
    }
    if (is_before) {
        hider.has_silhouette = true;
        hider.silhouette = circle_cap(ball->center, ball->radius);
        const Vec3d tangent = vec3d_scale(view->center, -2 * hider.silhouette.tangent);
        hider.silhouette_front = (HalfSpace){tangent, ball->power + view->power};
        hider.behind = (HalfSpace){ball->center, -ball->power};
        hider.ring_front.offset = 0.5 * (ball->power + view->power);
    }
    add_hider(view, &hider);
}

static void see_spheres(const Scene *scene, const Hit *hit, LightView *view)
{
    const Vec3d point = vec3d_from(hit->point);
    for (int k = 0; k < scene->nb_spheres && view->is_lit; k++) {
        const Sphere *sphere = &scene->spheres[k];
        Ball ball = {vec3d_sub(vec3d_from(sphere->center), point), (double)sphere->radius, 0,
                     hit->object == k, false};
        ball.power = ball_power(ball.center, ball.radius);
        ball.holds_point = ball.is_own ? vec3d_dot(view->normal, ball.center) > 0 : ball.power < 0;
        if (ball.is_own && !ball.holds_point)
            continue; /* from outside, the horizon hides one's own sphere */
        if (view->is_flat)
            see_ball(view, &ball);
        else
            see_ball_at_sphere(view, &ball);
    }
}

/* ---- what of a circle is not seen ---- */

static Intervals *add_outside(const Circle *circle, const Circle *other, Intervals *gone)
{
    Intervals in;
    in.count = 0;
    circle_inside(circle, other, &in);
    intervals_invert(&in, -PI, PI);
    intervals_unite(gone, &in);
    return gone;
}

void light_view_outside(const LightView *view, const Circle *circle, Intervals *gone)
{
    for (int k = 0; k < view->nb_bounds; k++) {
        const Circle *bound = &view->bound[k].circle;
        const bool side_of_polygon = view->is_polygon && circle->kind == CIRCLE_GREAT;
        const bool on_sphere = circle->kind == CIRCLE_RIM && bound->kind == CIRCLE_CAP;
        if (bound != circle && !side_of_polygon && !on_sphere)
            add_outside(circle, bound, gone);
    }
}

/* Both of a hider's silhouette and the places behind it. */
static void add_behind(const Circle *circle, const Hider *hider, Intervals *gone)
{
    Intervals part, behind;
    part.count = behind.count = 0;
    circle_inside(circle, &hider->silhouette, &part);
    if (!part.count)
        return;
    circle_in_half_space(circle, hider->behind, &behind);
    intervals_intersect(&part, &behind);
    intervals_unite(gone, &part);
}

/* Whether the hider hides what is seen of a sphere light in a direction. */
static bool is_hidden(const LightView *view, const Hider *hider, Vec3d direction)
{
    const double ahead = vec3d_dot(direction, view->center);
    const double under = ahead * ahead - view->power;
    if (ahead <= 0 || under < 0)
        return false;
    const Vec3d place = vec3d_scale(direction, view->power / (ahead + sqrt(under)));
    if (half_space_height(hider->cut_off, place) >= 0)
        return true;
    const Circle *cap = &hider->silhouette;
    return hider->has_silhouette && vec3d_length(vec3d_cross(cap->axis, direction)) < cap->radius &&
           vec3d_dot(cap->axis, direction) > 0 && half_space_height(hider->behind, place) > 0;
}

/* On a great circle or a silhouette before a sphere light that is cut: piece by piece between all
 * places where that may change. */
static void add_hidden_pieces(const LightView *view, const Circle *circle, const Hider *hider,
                              Intervals *gone)
{
    Angles cut;
    Intervals in;
    cut.count = in.count = 0;
    circle_inside(circle, &view->bound[0].circle, &in);
    if (hider->has_silhouette)
        circle_inside(circle, &hider->silhouette, &in);
    for (int k = 0; k < in.count; k++) {
        angles_add(&cut, in.interval[k].start);
        angles_add(&cut, in.interval[k].end);
    }
    circle_crossings(circle, &hider->ring, &cut);
    angles_add(&cut, -PI);
    angles_add(&cut, PI);
    angles_sort(&cut);
    for (int k = 0; k + 1 < cut.count; k++) {
        const double start = cut.angle[k], end = cut.angle[k + 1];
        if (is_hidden(view, hider, circle_at(circle, 0.5 * (start + end))))
            intervals_add(gone, start, end);
    }
}

static void add_hidden(const LightView *view, const Circle *circle, const Hider *hider,
                       Intervals *gone)
{
    Intervals in;
    in.count = 0;
    if (!hider->cuts) {
        circle_inside(circle, &hider->silhouette, gone);
    } else if (view->is_flat && hider->shows_inside) {
        add_outside(circle, &hider->ring, gone);
    } else if (view->is_flat) {
        add_behind(circle, hider, gone);
        circle_inside(circle, &hider->ring, &in);
        intervals_unite(gone, &in);
    } else if (circle == &view->bound[0].circle && hider->has_silhouette) {
        circle_inside(circle, &hider->silhouette, gone);
    } else if (circle == &view->bound[0].circle) {
        /* the light's own silhouette is where the tangents end */
        const Vec3d normal = vec3d_scale(hider->cut_off.normal, circle->tangent);
        circle_in_half_space(circle, (HalfSpace){normal, hider->cut_off.offset}, gone);
    } else if (circle->kind == CIRCLE_RIM) {
        circle_in_half_space(circle, hider->cut_off, gone);
        if (hider->has_silhouette)
            add_behind(circle, hider, gone);
    } else {
        add_hidden_pieces(view, circle, hider, gone);
    }
}

void light_view_gone(const LightView *view, const Circle *circle, const Hider *hider,
                     Intervals *gone)
{
    light_view_outside(view, circle, gone);
    for (int k = 0; k < view->nb_hiders; k++)
        if (&view->hider[k] != hider)
            add_hidden(view, circle, &view->hider[k], gone);
    if (!hider || !hider->cuts)
        return;
    Intervals front;
    front.count = 0;
    circle_in_half_space(
        circle, circle == &hider->ring ? hider->ring_front : hider->silhouette_front, &front);
    intervals_invert(&front, -PI, PI);
    intervals_unite(gone, &front);
}

/* ---- the whole ---- */

void light_view(const Scene *scene, const Light *light, const Hit *hit, LightView *view)
{
    view->normal = vec3d_from(hit->normal);
    view->is_flat = view->is_polygon = view->is_lit = false;
    view->nb_bounds = view->nb_hiders = 0;
    view->complete = true;
    if (vec3d_dot(view->normal, view->normal) == 0)
        return;
    switch (light->type) {
    case LIGHT_POINT:
        break;
    case LIGHT_QUAD:
        see_polygon(scene, &light->shape.quad, 4, hit, view);
        break;
    case LIGHT_DISK:
        see_disk(scene, &light->shape.disk, hit, view);
        break;
    case LIGHT_TRIANGLE:
        see_polygon(scene, &light->shape.triangle, 3, hit, view);
        break;
    case LIGHT_SPHERE:
        see_sphere_light(scene, &light->shape.sphere, hit, view);
        break;
    }
    see_spheres(scene, hit, view);
    if (view->is_lit && view->is_polygon && view->nb_hiders)
        bound_polygon(view);
}
