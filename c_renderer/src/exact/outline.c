#include "outline.h"

QuadFrame quad_frame(const QuadLight *light)
{
    Vec3d u = vec3d_from(light->edge_u), v = vec3d_from(light->edge_v);
    QuadFrame frame;
    frame.ux = vec3d_length(u);
    frame.x = vec3d_scale(u, 1 / frame.ux);
    frame.z = vec3d_unit(vec3d_cross(u, v));
    frame.y = vec3d_cross(frame.z, frame.x);
    frame.vx = vec3d_dot(v, frame.x);
    frame.vy = vec3d_dot(v, frame.y);
    return frame;
}

Vec3d quad_frame_direction(const QuadFrame *frame, Vec3d world)
{
    return (Vec3d){vec3d_dot(world, frame->x), vec3d_dot(world, frame->y),
                   vec3d_dot(world, frame->z)};
}

/* ---- the outline ---- */

static Outline quad_outline(const QuadFrame *frame, Vec3d corner)
{
    const Vec3d u = {frame->ux, 0, 0}, v = {frame->vx, frame->vy, 0};
    const Vec3d edge[4] = {u, v, vec3d_scale(u, -1), vec3d_scale(v, -1)};
    const double reach = vec3d_length(corner) + frame->ux + vec3d_length(v);
    Outline outline;
    /* the light shines on one side, and not on its own plane */
    outline.nb_corners = corner.z > VIEW_TOUCH * reach ? 4 : 0;
    for (int k = 0; k < outline.nb_corners; k++) {
        outline.corner[k] = corner;
        outline.side[k] = vec3d_unit(vec3d_cross(corner, edge[k]));
        corner = vec3d_add(corner, edge[k]);
    }
    return outline;
}

/* normal . w + offset >= 0, offset >= 0: what a plane leaves to be seen. */
typedef struct {
    Vec3d normal;
    double offset; /* [m]; 0: the surface's own plane */
} HalfSpace;

/* Above 0, below 0, or 0 for a corner that touches the plane. */
static double corner_height(HalfSpace half_space, Vec3d corner)
{
    double height = vec3d_dot(half_space.normal, corner) + half_space.offset;
    double touch = VIEW_TOUCH * (vec3d_length(corner) + half_space.offset);
    return fabs(height) <= touch ? 0 : height;
}

/* Where the edge from corner k to the next meets the plane. */
static Vec3d outline_crossing(const Outline *outline, int k, double height, double next_height)
{
    Vec3d edge = vec3d_sub(outline_next(outline, k), outline->corner[k]);
    return vec3d_add(outline->corner[k], vec3d_scale(edge, height / (height - next_height)));
}

/* What a half-space leaves of the outline (Sutherland-Hodgman). False: no room, left as it was. */
static bool outline_clip(Outline *outline, HalfSpace half_space)
{
    double height[OUTLINE_CORNERS];
    double lowest = 0;
    for (int k = 0; k < outline->nb_corners; k++) {
        height[k] = corner_height(half_space, outline->corner[k]);
        lowest = fmin(lowest, height[k]);
    }
    if (lowest == 0)
        return true;
    if (outline->nb_corners == OUTLINE_CORNERS)
        return false;
    Outline left;
    left.nb_corners = 0;
    for (int k = 0; k < outline->nb_corners; k++) {
        const double next_height = height[k + 1 < outline->nb_corners ? k + 1 : 0];
        const bool inside = height[k] >= 0, next_inside = next_height >= 0;
        if (inside) {
            left.corner[left.nb_corners] = outline->corner[k];
            left.side[left.nb_corners++] = outline->side[k];
        }
        if (inside == next_inside)
            continue;
        const Vec3d crossing = outline_crossing(outline, k, height[k], next_height);
        const Vec3d along_cut = {half_space.normal.y, -half_space.normal.x, 0};
        const Vec3d cut_side =
            half_space.offset > 0 ? vec3d_cross(crossing, along_cut) : half_space.normal;
        left.corner[left.nb_corners] = crossing;
        left.side[left.nb_corners++] = inside ? vec3d_unit(cut_side) : outline->side[k];
    }
    *outline = left;
    return true;
}

/* From a place in the light's frame to the outline [m]. */
static double outline_distance(const Outline *outline, Vec3d place)
{
    bool over = true;
    double nearest = INFINITY;
    for (int k = 0; k < outline->nb_corners; k++) {
        Vec3d edge = vec3d_sub(outline_next(outline, k), outline->corner[k]);
        Vec3d offset = vec3d_sub(place, outline->corner[k]);
        double squared = vec3d_dot(edge, edge);
        double t = squared > 0 ? vec3d_dot(offset, edge) / squared : 0;
        t = fmin(fmax(t, 0), 1);
        nearest = fmin(nearest, vec3d_length(vec3d_sub(offset, vec3d_scale(edge, t))));
        over &= edge.x * offset.y - edge.y * offset.x >= 0;
    }
    return over ? fabs(place.z - outline->corner[0].z) : nearest;
}

/* ---- the spheres ---- */

typedef enum { HIDES_NONE, HIDES_SOME, HIDES_ALL } Effect;

static bool holds_outline(const Ball *ball, const Outline *outline)
{
    double farthest = 0;
    for (int k = 0; k < outline->nb_corners; k++)
        farthest = fmax(farthest, vec3d_length(vec3d_sub(outline->corner[k], ball->center)));
    return farthest <= ball->radius * (1 + VIEW_TOUCH);
}

/* From inside a ball one sees only what is in it as well. */
static Effect effect_from_inside(const Outline *outline, const Ball *ball)
{
    if (holds_outline(ball, outline))
        return HIDES_NONE;
    return outline_distance(outline, ball->center) >= ball->radius ? HIDES_ALL : HIDES_SOME;
}

/* Whether the ball's cone may meet the outline: not if it is beyond one of the sides, nor if it
 * is too far from the middle. */
static bool cone_may_meet(const Outline *outline, const Ball *ball)
{
    Vec3d middle = {0, 0, 0};
    for (int k = 0; k < outline->nb_corners; k++) {
        if (vec3d_dot(outline->side[k], ball->center) <= -ball->radius)
            return false;
        middle = vec3d_add(middle, vec3d_unit(outline->corner[k]));
    }
    middle = vec3d_unit(middle);
    double cos_spread = 1;
    for (int k = 0; k < outline->nb_corners; k++)
        cos_spread = fmin(cos_spread, vec3d_dot(vec3d_unit(outline->corner[k]), middle));
    if (cos_spread <= 0)
        return true; /* so wide a light need not be where its corners are */
    double sin_spread = sqrt(fmax(1 - cos_spread * cos_spread, 0));
    double distance = vec3d_length(ball->center), sine = fmin(ball->radius / distance, 1);
    double cosine = sqrt(1 - sine * sine);
    /* angle to the middle <= half-angle + spread; 1e-7 covers the square roots */
    double reach = cosine * cos_spread - sine * sin_spread - 1e-7;
    return vec3d_dot(ball->center, middle) >= distance * reach;
}

/* Behind the plane of its tangent circle a ball hides its whole cone; before that plane it hides
 * only what is in it. */
static Effect effect_across_light(const Outline *outline, Ball *ball)
{
    double polar = vec3d_dot(ball->center, ball->center) - ball->radius * ball->radius;
    bool behind = true, before = true;
    for (int k = 0; k < outline->nb_corners; k++) {
        double ahead = vec3d_dot(outline->corner[k], ball->center);
        behind &= ahead >= polar;
        before &= ahead <= polar;
    }
    ball->kind = behind ? BALL_CONE : BALL_CUTS;
    if (holds_outline(ball, outline))
        return HIDES_ALL;
    return before && outline_distance(outline, ball->center) >= ball->radius ? HIDES_NONE
                                                                             : HIDES_SOME;
}

static Effect ball_effect(const Outline *outline, Ball *ball, bool own)
{
    if (ball->kind == BALL_WITHIN)
        return effect_from_inside(outline, ball);
    double beyond_light = ball->center.z - outline->corner[0].z;
    double slack = VIEW_TOUCH * ball->radius;
    if (own || beyond_light >= ball->radius - slack || !cone_may_meet(outline, ball))
        return HIDES_NONE; /* from outside, the horizon hides one's own sphere */
    if (beyond_light > slack - ball->radius)
        return effect_across_light(outline, ball);
    return HIDES_SOME;
}

/* ---- the whole ---- */

static void see_planes(const Scene *scene, const QuadFrame *frame, const Hit *hit, LightView *view)
{
    const Vec3d point = vec3d_from(hit->point);
    view->complete &= outline_clip(&view->outline, (HalfSpace){view->normal, 0});
    for (int k = 0; k < scene->nb_planes; k++) {
        const Vec3d normal = vec3d_from(scene->planes[k].normal);
        const Vec3d foot = vec3d_from(scene->planes[k].point);
        const Vec3d offset = vec3d_sub(point, foot);
        const double height = vec3d_dot(normal, offset);
        if (hit->object == scene->nb_spheres + k ||
            fabs(height) <= VIEW_TOUCH * vec3d_length(offset))
            continue; /* the horizon does it */
        const Vec3d towards = vec3d_scale(normal, height > 0 ? 1 : -1);
        const HalfSpace half_space = {quad_frame_direction(frame, towards), fabs(height)};
        view->complete &= outline_clip(&view->outline, half_space);
    }
}

static void see_spheres(const Scene *scene, const QuadFrame *frame, const Hit *hit, LightView *view)
{
    const Vec3d point = vec3d_from(hit->point);
    for (int k = 0; k < scene->nb_spheres && view->outline.nb_corners; k++) {
        const Sphere *sphere = &scene->spheres[k];
        const Vec3d center = vec3d_sub(vec3d_from(sphere->center), point);
        Ball ball = {quad_frame_direction(frame, center), (double)sphere->radius, BALL_CONE};
        const bool own = hit->object == k;
        if (own ? vec3d_dot(view->normal, ball.center) > 0
                : vec3d_length(ball.center) < ball.radius)
            ball.kind = BALL_WITHIN;
        const Effect effect = ball_effect(&view->outline, &ball, own);
        if (effect == HIDES_ALL)
            view->outline.nb_corners = 0;
        if (effect != HIDES_SOME)
            continue;
        view->closed_form &= ball.kind == BALL_CONE;
        if (view->nb_balls < VIEW_BALLS)
            view->ball[view->nb_balls++] = ball;
        else
            view->complete = false;
    }
}

void light_view(const Scene *scene, const QuadLight *light, const Hit *hit, LightView *view)
{
    const QuadFrame frame = quad_frame(light);
    const Vec3d to_corner = vec3d_sub(vec3d_from(light->corner), vec3d_from(hit->point));
    view->normal = quad_frame_direction(&frame, vec3d_from(hit->normal));
    view->outline = quad_outline(&frame, quad_frame_direction(&frame, to_corner));
    view->nb_balls = 0;
    view->closed_form = view->complete = true;
    see_planes(scene, &frame, hit, view);
    see_spheres(scene, &frame, hit, view);
}
