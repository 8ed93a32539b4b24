#include "quadrature.h"

enum {
    MAX_BREAKS = 256,
    SEARCH = 60,      /* steps that find a value of y to rounding */
    MAX_PANELS = 4000 /* of one point: more are noise, not shape */
};

/* Of the whole, for each panel. Where an unknown kink is in it the two rules may agree by accident:
 * an error R times the tolerance is then left in about one case of R. So the tolerance is far
 * below the least error that is promised. */
static const double TOLERANCE = 1e-14, LEAST_ERROR = 1e-9;

/* ---- one line across the light ---- */

typedef struct {
    double low, high; /* empty: INFINITY, -INFINITY */
} Range;

static const Range EMPTY = {INFINITY, -INFINITY};

static bool is_empty(Range r)
{
    return !(r.low < r.high);
}

/* The roots of a t^2 + 2 b t + c, NaN where there are none. */
static void quadratic_roots(double a, double b, double c, double root[2])
{
    double q = -(b + copysign(sqrt(b * b - a * c), b));
    root[0] = q / a;
    root[1] = c / q;
}

/* The part of the line x + t d with start + slope t >= 0. */
static Range clip(Range range, double start, double slope)
{
    if (slope > 0)
        range.low = fmax(range.low, -start / slope);
    else if (slope < 0)
        range.high = fmin(range.high, -start / slope);
    else if (start < 0)
        return EMPTY;
    return range;
}

/* A line x + t d in the light's plane. */
typedef struct {
    Vec3d x, d;
} Line;

/* Where the line is in the ball. */
static Range range_in_ball(Line line, Ball ball)
{
    Vec3d to_center = vec3d_sub(ball.center, line.x);
    double dd = vec3d_dot(line.d, line.d), middle = vec3d_dot(to_center, line.d) / dd;
    Vec3d across = vec3d_sub(to_center, vec3d_scale(line.d, middle));
    double half = sqrt((ball.radius * ball.radius - vec3d_dot(across, across)) / dd);
    return half > 0 ? (Range){middle - half, middle + half} : EMPTY;
}

/* |C x w|^2 <= r^2 |w|^2 on w = x + t d: a t^2 + 2 b t + c >= 0. */
typedef struct {
    double a, b, c;
} ConeSection;

static ConeSection cone_section(Line line, Ball ball)
{
    double r2 = ball.radius * ball.radius;
    Vec3d cross_x = vec3d_cross(ball.center, line.x), cross_d = vec3d_cross(ball.center, line.d);
    return (ConeSection){r2 * vec3d_dot(line.d, line.d) - vec3d_dot(cross_d, cross_d),
                         r2 * vec3d_dot(line.x, line.d) - vec3d_dot(cross_x, cross_d),
                         r2 * vec3d_dot(line.x, line.x) - vec3d_dot(cross_x, cross_x)};
}

/* Where the line is in the ball's cone, behind the plane of the tangent circle. */
static Range range_behind_ball(Line line, Ball ball)
{
    ConeSection s = cone_section(line, ball);
    double ahead = vec3d_dot(ball.center, line.x), ahead_slope = vec3d_dot(ball.center, line.d);
    double polar = vec3d_dot(ball.center, ball.center) - ball.radius * ball.radius;
    Range range = {-INFINITY, INFINITY};
    double root[2];
    quadratic_roots(s.a, s.b, s.c, root);
    double first = fmin(root[0], root[1]), second = fmax(root[0], root[1]);
    if (s.a < 0) /* the line is inside the cone between the roots, if there are any */
        range = s.b * s.b > s.a * s.c ? (Range){first, second} : EMPTY;
    else if (ahead_slope > 0) /* a line steeper than the cone: before or after both */
        range.low = second;
    else
        range.high = first;
    range = clip(range, ahead - polar, ahead_slope);
    return is_empty(range) ? EMPTY : range;
}

/* What the ball hides: one interval, since the points hidden from one point form a convex set. */
static Range hidden_range(Line line, Ball ball)
{
    if (ball.kind == BALL_WITHIN)
        return EMPTY;
    Range in = range_in_ball(line, ball), behind = range_behind_ball(line, ball);
    return (Range){fmin(in.low, behind.low), fmax(in.high, behind.high)};
}

/* The integral of (p + q x) / (x^2 + k^2)^2 from x0 to x1. */
static double antiderivative(double p, double q, double k2, double x0, double x1)
{
    double k = sqrt(k2), width = x1 - x0;
    double d0 = x0 * x0 + k2, d1 = x1 * x1 + k2;
    double angle = atan2(width * k, k2 + x0 * x1);
    double rational = width * (k2 - x0 * x1) / (d0 * d1); /* x1 / d1 - x0 / d0 */
    double linear = width * (x0 + x1) / (d0 * d1);        /* 1 / d0 - 1 / d1 */
    return p * (rational + angle / k) / (2 * k2) + 0.5 * q * linear;
}

/* The first part of the range that is not hidden; empty where there is none. */
static Range first_shown(const LightView *view, Line line, Range range)
{
    Range shown = range;
    bool moved = true;
    while (moved && !is_empty(range)) {
        moved = false;
        shown = range;
        for (int k = 0; k < view->nb_balls; k++) {
            Range hidden = hidden_range(line, view->ball[k]);
            if (hidden.low > range.low) {
                shown.high = fmin(shown.high, hidden.low);
            } else if (hidden.high > range.low) {
                range.low = hidden.high;
                moved = true;
            }
        }
    }
    return moved ? range : shown;
}

/* The integral of cos_surface cos_light / d^2 over the visible part of the line at y. */
static double line_integral(const LightView *view, double y)
{
    const double h = view->outline.corner[0].z;
    const Line line = {{0, y, h}, {1, 0, 0}};
    Range range = {-INFINITY, INFINITY};
    for (int k = 0; k < view->outline.nb_corners; k++) {
        const Vec3d side = view->outline.side[k];
        range = clip(range, vec3d_dot(side, line.x), side.x);
    }
    for (int k = 0; k < view->nb_balls; k++) {
        if (view->ball[k].kind != BALL_WITHIN)
            continue;
        const Range in = range_in_ball(line, view->ball[k]);
        range = (Range){fmax(range.low, in.low), fmin(range.high, in.high)};
    }
    const double p = view->normal.y * y + view->normal.z * h, k2 = y * y + h * h;
    double sum = 0;
    for (;;) {
        Range shown = first_shown(view, line, range);
        if (is_empty(shown))
            return sum * h;
        sum += antiderivative(p, view->normal.x, k2, shown.low, shown.high);
        range.low = shown.high;
    }
}

/* ---- where the line integral is not smooth ---- */

/* Values of y, sorted. More than fit are left to the halving of panels. */
typedef struct {
    double first, last;
    int count;
    double y[MAX_BREAKS];
} Breaks;

static void add_break(Breaks *breaks, double y)
{
    if (!(y > breaks->first && y < breaks->last) || breaks->count == MAX_BREAKS)
        return;
    int k = breaks->count++;
    for (; k > 0 && breaks->y[k - 1] > y; k--)
        breaks->y[k] = breaks->y[k - 1];
    breaks->y[k] = y;
}

static void add_roots(Breaks *breaks, double a, double b, double c)
{
    double root[2];
    quadratic_roots(a, b, c, root);
    add_break(breaks, root[0]);
    add_break(breaks, root[1]);
}

/* Where lines of constant y touch the ball's cone and the ball. */
static void add_tangents(Breaks *breaks, Ball ball, double h)
{
    const Vec3d c = ball.center;
    const double r2 = ball.radius * ball.radius;
    /* the plane through the point and the line, whose normal is (0, -h, y), touches the ball */
    add_roots(breaks, c.z * c.z - r2, -h * c.y * c.z, h * h * (c.y * c.y - r2));
    double half = sqrt(r2 - (h - c.z) * (h - c.z));
    add_break(breaks, c.y - half);
    add_break(breaks, c.y + half);
}

/* Where an edge crosses the ball's outlines. */
static void add_crossings(Breaks *breaks, Vec3d corner, Vec3d next, Ball ball)
{
    const Line edge = {corner, vec3d_sub(next, corner)};
    const ConeSection s = cone_section(edge, ball);
    const Range in = range_in_ball(edge, ball), behind = range_behind_ball(edge, ball);
    double t[6] = {in.low, in.high, behind.low, behind.high};
    quadratic_roots(s.a, s.b, s.c, t + 4);
    for (int k = 0; k < 6; k++)
        add_break(breaks, corner.y + t[k] * edge.d.y);
}

/* Corners, and where shadows begin, end or cross an edge. Where two shadows' outlines cross is left
 * to the halving of panels. */
static void find_breaks(const LightView *view, Breaks *breaks)
{
    const Outline *outline = &view->outline;
    const double h = outline->corner[0].z;
    breaks->first = breaks->last = outline->corner[0].y;
    for (int k = 1; k < outline->nb_corners; k++) {
        breaks->first = fmin(breaks->first, outline->corner[k].y);
        breaks->last = fmax(breaks->last, outline->corner[k].y);
    }
    breaks->count = 0;
    for (int k = 0; k < outline->nb_corners; k++)
        add_break(breaks, outline->corner[k].y);
    for (int j = 0; j < view->nb_balls; j++) {
        add_tangents(breaks, view->ball[j], h);
        for (int k = 0; k < outline->nb_corners; k++)
            add_crossings(breaks, outline->corner[k], outline_next(outline, k), view->ball[j]);
    }
}

/* ---- all lines ---- */

/* Clenshaw-Curtis on 17 points cos(k pi / 16), and on every other one of them. Unlike Gauss's
 * rules they look at the panel's ends: a kink between an end and a rule's first node shows. */
static const double NODE[9] = {1,
                               0.9807852804032304,
                               0.9238795325112867,
                               0.8314696123025452,
                               0.7071067811865476,
                               0.5555702330196023,
                               0.38268343236508984,
                               0.19509032201612833,
                               0};
static const double FINE[9] = {0.003921568627450983, 0.037368702837205614, 0.07548233154315184,
                               0.10890555258189094,  0.13895646836823308,  0.16317266428170332,
                               0.18147378423649335,  0.19251386461292566,  0.1964101258218905};
static const double COARSE[5] = {0.01587301587301588, 0.14621864921601818, 0.27936507936507937,
                                 0.3617178587204897, 0.39365079365079364};

typedef struct {
    const LightView *view;
    double tolerance; /* [sr] */
    int panels_left;
    double value, error;
} Integral;

/* Part of the piece [first, last] of the range of y: y = mean + half width sin(pi x / 2), x from
 * low to high in [-1, 1]. A shadow that begins like sqrt(y - y0) is smooth in x. */
typedef struct {
    double first, last, low, high;
} Panel;

static double panel_integrand(const LightView *view, Panel panel, double x)
{
    double width = 0.5 * (panel.last - panel.first);
    double y = panel.first + width * (1 + sin(0.5 * PI * x));
    return 0.5 * PI * cos(0.5 * PI * x) * width * line_integral(view, y);
}

static void integrate_panel(Integral *integral, Panel panel)
{
    const double half = 0.5 * (panel.high - panel.low), middle = panel.low + half;
    double fine = 0, coarse = 0;
    for (int k = 0; k < 9; k++) {
        double value = panel_integrand(integral->view, panel, middle + half * NODE[k]);
        if (k < 8)
            value += panel_integrand(integral->view, panel, middle - half * NODE[k]);
        fine += FINE[k] * value;
        coarse += k % 2 ? 0 : COARSE[k / 2] * value;
    }
    double error = half * fabs(fine - coarse);
    if (error > integral->tolerance && half > 1e-12 && integral->panels_left > 1) {
        integral->panels_left -= 2;
        integrate_panel(integral, (Panel){panel.first, panel.last, panel.low, middle});
        integrate_panel(integral, (Panel){panel.first, panel.last, middle, panel.high});
        return;
    }
    integral->value += half * fine;
    integral->error += error;
}

double quadrature_irradiance(const LightView *view, double scale, double *error_bound)
{
    Integral integral = {view, TOLERANCE * scale, MAX_PANELS, 0, 0};
    Breaks breaks;
    find_breaks(view, &breaks);
    double first = breaks.first;
    for (int k = 0; k <= breaks.count; k++) {
        double next = k < breaks.count ? breaks.y[k] : breaks.last;
        if (next > first)
            integrate_panel(&integral, (Panel){first, next, -1, 1});
        first = next;
    }
    *error_bound = fmax(integral.error, LEAST_ERROR * scale);
    return integral.value;
}
