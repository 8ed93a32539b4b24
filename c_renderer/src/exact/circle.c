#include "circle.h"

#include <float.h>
#include <stdlib.h>

/* Of angles and of sines: what rounding makes of 0. */
static const double NOISE = 8 * DBL_EPSILON;

/* ---- the kinds ---- */

/* Adds a^2 to the sum high + low, exactly but for eps^2. */
static void add_square(double a, double sign, double *high, double *low)
{
    const double square = a * a, rest = fma(a, a, -square);
    const double sum = *high + sign * square, part = sum - *high;
    *low += (*high - (sum - part)) + (sign * square - part) + sign * rest;
    *high = sum;
}

double ball_power(Vec3d center, double radius)
{
    double high = 0, low = 0;
    add_square(center.x, 1, &high, &low);
    add_square(center.y, 1, &high, &low);
    add_square(center.z, 1, &high, &low);
    add_square(radius, -1, &high, &low);
    return high + low;
}

Circle circle_great(Vec3d pole, Vec3d towards)
{
    Circle circle = {.kind = CIRCLE_GREAT, .axis = pole, .radius = 1, .doubt = 1};
    circle.u = vec3d_unit(vec3d_reject(towards, pole));
    circle.v = vec3d_cross(pole, circle.u);
    return circle;
}

Circle circle_cap(Vec3d center, double radius)
{
    const double distance = vec3d_length(center);
    Circle cap = {.kind = CIRCLE_CAP, .doubt = 1};
    cap.tangent = sqrt(fmax(ball_power(center, radius), 0));
    cap.axis = vec3d_scale(center, 1 / distance);
    cap.radius = fmin(radius / distance, 1);
    cap.cosine = cap.tangent / distance;
    cap.angle = atan2(cap.radius, cap.cosine);
    cap.center = vec3d_scale(cap.axis, cap.cosine);
    cap.u = vec3d_across(cap.axis);
    cap.v = vec3d_cross(cap.axis, cap.u);
    return cap;
}

Circle circle_rim(Vec3d center, Vec3d axis, double radius)
{
    Circle rim = {.kind = CIRCLE_RIM, .center = center, .axis = axis, .radius = radius};
    const Vec3d beside = vec3d_reject(center, axis);
    const double noise = NOISE * vec3d_length(center);
    rim.u = vec3d_length(beside) > noise
                ? vec3d_unit(vec3d_reject(vec3d_unit(vec3d_scale(beside, -1)), axis))
                : vec3d_across(axis);
    rim.v = vec3d_cross(axis, rim.u);
    const double nearest = vec3d_length(vec3d_along(center, rim.u, radius));
    rim.doubt = fmax((vec3d_length(center) + radius) / nearest, 1);
    return rim;
}

Vec3d circle_at(const Circle *circle, double angle)
{
    const Vec3d x = vec3d_along(circle->center, circle->u, circle->radius * cos(angle));
    return vec3d_along(x, circle->v, circle->radius * sin(angle));
}

double circle_angle(const Circle *circle, Vec3d place)
{
    const Vec3d from_center = vec3d_sub(place, circle->center);
    return atan2(vec3d_dot(circle->v, from_center), vec3d_dot(circle->u, from_center));
}

/* ---- angles ---- */

void angles_add(Angles *angles, double angle)
{
    if (angles->count < MAX_ANGLES)
        angles->angle[angles->count++] = angle;
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void angles_sort(Angles *angles)
{
    qsort(angles->angle, (size_t)angles->count, sizeof *angles->angle, by_size);
}

/* ---- half-spaces ---- */

void circle_in_half_space(const Circle *circle, HalfSpace half_space, Intervals *in)
{
    const double along_u = circle->radius * vec3d_dot(half_space.normal, circle->u);
    const double along_v = circle->radius * vec3d_dot(half_space.normal, circle->v);
    const double reach = sqrt(along_u * along_u + along_v * along_v);
    const double level = half_space_height(half_space, circle->center);
    const double root = sqrt(fmax((reach - level) * (reach + level), 0));
    intervals_add_around(in, atan2(along_v, along_u), atan2(root, -level));
}

/* ---- great circles and caps ---- */

/* sqrt(sin^2 alpha - (gamma . a)^2), where a cap meets the great circle with pole gamma; else 0.
 * Edges and arcs take their crossings from the same root, and so agree on whether there are any. */
static double crossing_root(const Circle *cap, double across)
{
    return sqrt(fmax((cap->radius - across) * (cap->radius + across), 0));
}

static void cap_in_great(const Circle *cap, const Circle *great, Intervals *in)
{
    const double across = vec3d_dot(great->axis, cap->axis);
    const double middle = atan2(vec3d_dot(great->axis, cap->v), vec3d_dot(great->axis, cap->u));
    intervals_add_around(in, middle, atan2(crossing_root(cap, across), -cap->cosine * across));
}

static void great_in_cap(const Circle *great, const Circle *cap, Intervals *in)
{
    const double root = crossing_root(cap, vec3d_dot(great->axis, cap->axis));
    if (root > 0)
        intervals_add_around(in, circle_angle(great, cap->axis), atan2(root, cap->cosine));
}

/* Two half-spheres: where their circles cross is found from both in the same way. */
static void great_in_great(const Circle *great, const Circle *other, Intervals *in)
{
    const Vec3d enters = vec3d_cross(other->axis, great->axis);
    if (vec3d_dot(enters, enters) > 0)
        intervals_add_around(in, circle_angle(great, enters) + 0.5 * PI, 0.5 * PI);
    else if (other->rank < great->rank && vec3d_dot(great->axis, other->axis) > 0)
        intervals_add(in, -PI, PI);
}

/* ---- circles of one sphere or one plane ---- */

/* With the sides of a triangle, of which one is `opposite`, the angle before that one: by the
 * half-angle formula it keeps its digits in small triangles, and is 0 or pi where there is no
 * triangle. On the unit sphere lengths are replaced by their sines. */
static double triangle_angle(double opposite, double side, double other, bool on_sphere)
{
    const double s = 0.5 * (opposite + side + other);
    const double length[4] = {s, fmax(s - opposite, 0), fmax(s - side, 0), fmax(s - other, 0)};
    double l[4];
    for (int k = 0; k < 4; k++)
        l[k] = on_sphere ? sin(length[k]) : length[k];
    return 2 * atan2(sqrt(fmax(l[2] * l[3], 0)), sqrt(fmax(l[0] * l[1], 0)));
}

/* Both are caps, or rims in one plane: `own` and `size` are the radii, as angles or lengths, and
 * `towards` is how far apart their centers are. */
static void beside_like(const Circle *circle, const Circle *other, double own, double size,
                        double apart, Vec3d towards, Intervals *in)
{
    bool within = apart + own <= size * (1 + NOISE);
    const bool around = apart + size <= own * (1 + NOISE);
    if (within && around)
        within = other->rank < circle->rank;
    if (within)
        intervals_add(in, -PI, PI);
    if (within || around)
        return;
    const double half = triangle_angle(size, own, apart, circle->kind == CIRCLE_CAP);
    const double middle = atan2(vec3d_dot(towards, circle->v), vec3d_dot(towards, circle->u));
    intervals_add_around(in, middle, half);
}

static void cap_in_cap(const Circle *cap, const Circle *other, Intervals *in)
{
    const Vec3d towards = vec3d_sub(other->axis, cap->axis); /* of near axes with all digits */
    const double sine = vec3d_length(vec3d_cross(cap->axis, towards));
    const double apart = atan2(sine, vec3d_dot(cap->axis, other->axis));
    beside_like(cap, other, cap->angle, other->angle, apart, towards, in);
}

static void rim_in_rim(const Circle *rim, const Circle *other, Intervals *in)
{
    const Vec3d towards = vec3d_sub(other->center, rim->center);
    beside_like(rim, other, rim->radius, other->radius, vec3d_length(towards), towards, in);
}

/* ---- rims ---- */

static void rim_in_great(const Circle *rim, const Circle *great, Intervals *in)
{
    circle_in_half_space(rim, (HalfSpace){great->axis, 0}, in);
}

/* The chord of the rim: its ends are the rim's own places. */
static void great_in_rim(const Circle *great, const Circle *rim, Intervals *in)
{
    Intervals arc;
    arc.count = 0;
    rim_in_great(rim, great, &arc);
    intervals_invert(&arc, -PI, PI); /* the rim's part on the right: it ends where the chord does */
    if (!arc.count)
        return;
    const bool wraps = arc.count > 1;
    double start = arc.interval[0].start, end = arc.interval[wraps ? 1 : 0].end;
    if (wraps) {
        start = arc.interval[1].start;
        end = arc.interval[0].end;
    }
    if (end - start >= 2 * PI)
        return;
    const double first = circle_angle(great, circle_at(rim, start));
    double length = circle_angle(great, circle_at(rim, end)) - first;
    length += length < -PI ? 2 * PI : 0;
    intervals_add_around(in, first + 0.5 * length, 0.5 * length);
}

/* sin(alpha - theta), with theta from the cap's axis to the rim's place: above 0 in the cone. */
static double depth_in_cone(const Circle *rim, const Circle *cap, double angle)
{
    const Vec3d x = circle_at(rim, angle);
    const double across = vec3d_length(vec3d_cross(cap->axis, x));
    return (cap->radius * vec3d_dot(cap->axis, x) - cap->cosine * across) / vec3d_length(x);
}

/* The product of two quadratics in Bernstein's form. */
static void bernstein_product(const double a[3], const double b[3], double product[5])
{
    product[0] = a[0] * b[0];
    product[1] = (a[0] * b[1] + a[1] * b[0]) / 2;
    product[2] = (a[0] * b[2] + 4 * a[1] * b[1] + a[2] * b[0]) / 6;
    product[3] = (a[1] * b[2] + a[2] * b[1]) / 2;
    product[4] = a[2] * b[2];
}

/* Adds turn + 2 atan(t) for the zeros t of a quartic on [low, high], in Bernstein's form there, as
 * far as they can be told from noise: halves the range while the coefficients change sign. */
static void add_zeros(const double b[5], double low, double high, double noise, double turn,
                      Angles *places)
{
    bool above = false, below = false;
    for (int k = 0; k < 5; k++) {
        above |= b[k] > noise;
        below |= b[k] < -noise;
    }
    if (!above || !below)
        return;
    const double middle = 0.5 * (low + high);
    if (high - low < 1e-8) {
        angles_add(places, turn + 2 * atan(middle));
        return;
    }
    double left[5], right[5]; /* de Casteljau */
    for (int k = 0; k < 5; k++)
        right[k] = b[k];
    for (int k = 0; k < 5; k++) {
        left[k] = right[0];
        for (int j = 0; j + k + 1 < 5; j++)
            right[j] = 0.5 * (right[j] + right[j + 1]);
    }
    add_zeros(left, low, middle, noise, turn, places);
    add_zeros(right, middle, high, noise, turn, places);
}

/* Where the rim is nearest to the cap's axis or farthest from it, but for a near-inflection:
 *     g = (a . X)^2 / |X|^2 has an extreme where (a . X') |X|^2 = (a . X) (X . X').
 * On X(phi), with t = tan(phi / 2), each factor but |X|^2 is a quadratic over 1 + t^2; with
 * g = (a . X)^2 - cos^2(alpha) |X|^2, which is 0 in the same places, all are. Between its extremes
 * g crosses 0 once at most. */
static void add_extremes(const Circle *rim, const Circle *cap, Angles *places)
{
    const double radius = rim->radius, cc = cap->cosine * cap->cosine;
    const double a0 = vec3d_dot(cap->axis, rim->center);
    const double x0 = vec3d_dot(rim->center, rim->u), y0 = vec3d_dot(rim->center, rim->v);
    for (int half = 0; half < 2; half++) {
        const double sign = half ? -radius : radius;
        const double a1 = sign * vec3d_dot(cap->axis, rim->u);
        const double a2 = sign * vec3d_dot(cap->axis, rim->v);
        const double x1 = sign * x0, y1 = sign * y0;
        const double ahead[3] = {2 * (a0 - a2), 2 * a1, 2 * (a0 + a2)};
        const double ahead_slope[3] = {2 * a1, 2 * a2, -2 * a1};
        const double square_slope[3] = {2 * cc * x1, 2 * cc * y1, -2 * cc * x1}, one[3] = {2, 0, 2};
        double slope[5], other[5];
        bernstein_product(ahead, ahead_slope, slope);
        bernstein_product(square_slope, one, other);
        const double scale =
            (fabs(a0) + fabs(a1) + fabs(a2)) * (fabs(a1) + fabs(a2)) + cc * (fabs(x1) + fabs(y1));
        for (int k = 0; k < 5; k++)
            slope[k] -= other[k];
        add_zeros(slope, -1, 1, NOISE * scale, half ? PI : 0, places);
    }
}

/* Between two places of which one is in the cone (Illinois' false position). */
static double crossing_angle(const Circle *rim, const Circle *cap, double a, double b)
{
    double fa = depth_in_cone(rim, cap, a), fb = depth_in_cone(rim, cap, b);
    for (int k = 0; k < 100 && fabs(b - a) > DBL_EPSILON && fa != 0 && fb != 0; k++) {
        double c = (a * fb - b * fa) / (fb - fa);
        if (k % 4 == 3) /* never slower than halving by more than that */
            c = 0.5 * (a + b);
        const double fc = depth_in_cone(rim, cap, c);
        if ((fc > 0) == (fb > 0)) {
            b = c;
            fb = fc;
            fa *= 0.5;
        } else {
            a = c;
            fa = fc;
            fb *= 0.5;
        }
    }
    return fabs(fa) < fabs(fb) ? a : b;
}

/* Depths below noise are no crossings: the rim may be the cone's own circle, or touch it. */
static void rim_in_cone(const Circle *rim, const Circle *cap, Intervals *in)
{
    Angles places;
    places.count = 0;
    for (int k = 0; k < 4; k++)
        angles_add(&places, 0.5 * PI * k - PI);
    add_extremes(rim, cap, &places);
    double angle[MAX_ANGLES + 1], depth[MAX_ANGLES + 1];
    int count = 0;
    for (int k = 0; k < places.count; k++)
        places.angle[k] -= places.angle[k] > PI ? 2 * PI : 0;
    angles_sort(&places);
    for (int k = 0; k < places.count; k++) {
        const double f = depth_in_cone(rim, cap, places.angle[k]);
        if (fabs(f) <= NOISE)
            continue;
        angle[count] = places.angle[k];
        depth[count++] = f;
    }
    int crossings = 0;
    for (int k = 0; k < count; k++) {
        const int next = (k + 1) % count;
        if ((depth[k] > 0) == (depth[next] > 0))
            continue;
        crossings++;
        const double far = angle[next] + (next ? 0 : 2 * PI);
        const double cross = crossing_angle(rim, cap, angle[k], far);
        if (depth[k] > 0)
            continue;
        /* it goes in: as far as to the place where it comes out */
        int out = next;
        while (depth[(out + 1) % count] > 0)
            out = (out + 1) % count;
        const int after = (out + 1) % count;
        const double from = angle[out], to = angle[after] + (after > out ? 0 : 2 * PI);
        double end = crossing_angle(rim, cap, from, to);
        end += end < cross ? 2 * PI : 0;
        intervals_add_around(in, 0.5 * (cross + end), 0.5 * (end - cross));
    }
    if (!crossings && (!count || depth[0] > 0))
        intervals_add(in, -PI, PI);
}

void circle_crossings(const Circle *circle, const Circle *rim, Angles *angles)
{
    Intervals in;
    in.count = 0;
    if (circle->kind == CIRCLE_CAP)
        rim_in_cone(rim, circle, &in);
    else
        circle_in_half_space(rim, (HalfSpace){circle->axis, 0}, &in);
    for (int k = 0; k < 2 * in.count; k++) {
        const double end = k % 2 ? in.interval[k / 2].end : in.interval[k / 2].start;
        if (fabs(end) < PI) /* there an interval is cut in two */
            angles_add(angles, circle_angle(circle, circle_at(rim, end)));
    }
}

/* Whether the direction leads into the rim. */
static bool is_in_rim(const Circle *rim, Vec3d direction)
{
    const double ahead = vec3d_dot(rim->axis, direction);
    const double height = vec3d_dot(rim->axis, rim->center);
    const Vec3d place = vec3d_scale(direction, height / ahead);
    return height / ahead > 0 && vec3d_length(vec3d_sub(place, rim->center)) < rim->radius;
}

/* The crossings are the rim's. Of the arcs between them only the longest one is asked where it is,
 * since a short one hardly leaves the rim; then they take turns. */
static void cap_in_rim(const Circle *cap, const Circle *rim, Intervals *in)
{
    Angles cut;
    cut.count = 0;
    circle_crossings(cap, rim, &cut);
    angles_sort(&cut);
    if (!cut.count) { /* the cap is in the rim, or it is not, or the rim is in the cap */
        Intervals all;
        all.count = 0;
        rim_in_cone(rim, cap, &all);
        if (!all.count && is_in_rim(rim, cap->axis))
            intervals_add(in, -PI, PI);
        return;
    }
    const int n = cut.count;
    int longest = n - 1;
    double length = cut.angle[0] + 2 * PI - cut.angle[n - 1];
    for (int k = 0; k + 1 < n; k++) {
        if (cut.angle[k + 1] - cut.angle[k] <= length)
            continue;
        length = cut.angle[k + 1] - cut.angle[k];
        longest = k;
    }
    const double middle = cut.angle[longest] + 0.5 * length;
    const bool inside = is_in_rim(rim, circle_at(cap, middle));
    for (int k = inside ? 0 : 1; k < n; k += 2) {
        const int first = (longest + k) % n, next = (first + 1) % n;
        const double start = cut.angle[first], end = cut.angle[next] + (next ? 0 : 2 * PI);
        intervals_add_around(in, 0.5 * (start + end), 0.5 * (end - start));
    }
}

void circle_inside(const Circle *circle, const Circle *other, Intervals *in)
{
    static void (*const INSIDE[3][3])(const Circle *, const Circle *,
                                      Intervals *) = {{great_in_great, great_in_cap, great_in_rim},
                                                      {cap_in_great, cap_in_cap, cap_in_rim},
                                                      {rim_in_great, rim_in_cone, rim_in_rim}};
    INSIDE[circle->kind][other->kind](circle, other, in);
}

/* ---- arcs ---- */

/* 1/2 n . integral of r x dr on a rim, whose r is not on a circle. With h, p and a of c = h m - p u:
 * all coefficients are bounded, near the rim too. docs/exact.md derives it. */
static double rim_integral(const Circle *rim, Interval arc, Vec3d n)
{
    const double a = rim->radius, h = vec3d_dot(rim->axis, rim->center);
    const double p = fmax(-vec3d_dot(rim->u, rim->center), 0);
    const double near = h * h + (p - a) * (p - a), far = h * h + (p + a) * (p + a);
    const double w = sqrt(near * far), S = h * h + p * p + a * a, T = 2 * a * p;
    const double k = T / (S + w), rest = (near + w) / (S + w); /* 1 - k */
    const double g = (a - p) * (a + p) - h * h, q = g / w;
    const double one_and_q = g >= 0 ? (w + g) / w : 4 * a * a * h * h / (w * (w - g));

    if (arc.end - arc.start >= 2 * PI)
        return 0.5 * PI *
               (vec3d_dot(n, rim->axis) * one_and_q - vec3d_dot(n, rim->u) * (h * a / w) * 2 * k);
    const double d = 0.5 * (arc.end - arc.start), middle = 0.5 * (arc.start + arc.end);
    const double s0 = sin(0.5 * arc.start), s1 = sin(0.5 * arc.end);
    const double x0 = rest + 2 * k * s0 * s0, x1 = rest + 2 * k * s1 * s1;
    const double y0 = k * sin(arc.start), y1 = k * sin(arc.end);
    const double turn = 2 * sin(d) * (rest * cos(d) - 2 * s0 * s1); /* over k */
    const double A = atan2(k * turn, x0 * x1 + y0 * y1);
    const double A_over_k = k > DBL_MIN ? A / k : turn;
    const double D0 = near + 2 * T * s0 * s0, D1 = near + 2 * T * s1 * s1;
    const double rise = 2 * sin(middle) * sin(d), relative = T * rise / D0; /* D1 / D0 - 1 */
    double G = rise / S;
    if (T > DBL_MIN)
        G = (fabs(relative) < 0.5 ? log1p(relative) : log(D1 / D0)) / T;
    return 0.5 * (vec3d_dot(n, rim->axis) * (one_and_q * d + q * A) -
                  vec3d_dot(n, rim->u) * (h * a / w) * ((1 + k * k) * A_over_k + 2 * k * d) -
                  vec3d_dot(n, rim->v) * (h * a) * G);
}

/* From the arc's first place to its last, as directions. */
static Vec3d rim_chord(const Circle *rim, Interval arc)
{
    if (arc.end - arc.start >= 2 * PI)
        return (Vec3d){0, 0, 0};
    const double d = 0.5 * (arc.end - arc.start), middle = 0.5 * (arc.start + arc.end);
    const Vec3d first = circle_at(rim, arc.start), last = circle_at(rim, arc.end);
    const double l0 = vec3d_length(first), l1 = vec3d_length(last);
    const Vec3d across = vec3d_along(vec3d_scale(rim->v, cos(middle)), rim->u, -sin(middle));
    const Vec3d chord = vec3d_scale(across, 2 * rim->radius * sin(d));
    const double longer = vec3d_dot(chord, vec3d_add(first, last)) / (l0 + l1); /* l1 - l0 */
    return vec3d_along(vec3d_scale(chord, 1 / l1), first, -longer / (l0 * l1));
}

double arc_integral(const Circle *circle, Interval arc, Vec3d normal, Vec3d pivot)
{
    if (circle->kind == CIRCLE_RIM)
        return rim_integral(circle, arc, normal) - 0.5 * vec3d_dot(pivot, rim_chord(circle, arc));
    /* 1/2 n . (sin^2(alpha) (phi1 - phi0) a + (center - r0) x (r1 - r0)) */
    const double length = arc.end - arc.start, middle = 0.5 * (arc.start + arc.end);
    const double sine = circle->radius;
    const Vec3d moment = vec3d_sub(vec3d_cross(normal, circle->center), pivot);
    const double chord =
        cos(middle) * vec3d_dot(moment, circle->v) - sin(middle) * vec3d_dot(moment, circle->u);
    return sine *
           (0.5 * sine * vec3d_dot(normal, circle->axis) * length + sin(0.5 * length) * chord);
}

double arc_length(const Circle *circle, Interval arc)
{
    double length = circle->radius * (arc.end - arc.start);
    if (circle->kind != CIRCLE_RIM)
        return length;
    const double h = vec3d_dot(circle->axis, circle->center);
    const double beyond = fmax(-vec3d_dot(circle->u, circle->center), 0) - circle->radius;
    return fmin(length / sqrt(h * h + beyond * beyond), 2 * PI); /* a convex curve's is no more */
}
