#include "solid_angle_packet.h"

#include "core/spherical_rectangle.h"

static const double PI = 3.14159265358979323846;

static void set_lane(SphericalRectanglePacket *packet, int lane, const SphericalRectangle *r)
{
    packet->x0[lane] = r->x0, packet->x1[lane] = r->x1;
    packet->y0[lane] = r->y0, packet->y1[lane] = r->y1;
    packet->z0[lane] = r->z0;
    packet->inverse_width[lane] = 1 / (r->x1 - r->x0);
    packet->inverse_height[lane] = 1 / (r->y1 - r->y0);
    packet->b0[lane] = r->b0, packet->b1[lane] = r->b1;
    packet->c[lane] = r->z0 * r->z0 / (r->z0 * r->z0 + r->y0 * r->y0);
    packet->k[lane] = r->k;
    packet->solid_angle[lane] = r->solid_angle;
}

InLanes spherical_rectangle_packet_create(SphericalRectanglePacket *rectangle,
                                          const QuadLight *quad, const HitPacket *hits,
                                          const LightPacket *light)
{
    int nb_lit = 0, nb_known = 0;
    SphericalRectangle known = {.solid_angle = 0}, found;
    for (int i = 0; i < LANES; i++) {
        if (light->scale[i] <= 0)
            continue;
        nb_lit++;
        const Vec3 point = {hits->point.x[i], hits->point.y[i], hits->point.z[i]};
        if (!spherical_rectangle_create(&found, quad, point))
            continue;
        nb_known++;
        known = found;
        set_lane(rectangle, i, &known);
    }
    if (!nb_known || nb_known < nb_lit)
        return nb_known ? RECTANGLE_IN_SOME_LANES : RECTANGLE_IN_NO_LANE;
    for (int i = 0; i < LANES; i++) {
        if (light->scale[i] <= 0)
            set_lane(rectangle, i, &known); /* any will do, with a scale of 0 */
        rectangle->scale[i] = light->scale[i] > 0 ? (real)rectangle->solid_angle[i] : 0;
    }
    return RECTANGLE_IN_ALL_LANES;
}

/* sin(x) / x and cos(x) for y = x^2, |x| <= pi / 2, within 2e-17 and 6e-17 but for rounding: by
 * interpolation at Chebyshev's points. */
static inline double sine_ratio(double y)
{
    double p = 2.7215749422983443e-15;
    p = p * y - 7.643026557971632e-13;
    p = p * y + 1.605894087848656e-10;
    p = p * y - 2.505210689056952e-08;
    p = p * y + 2.7557319211229606e-06;
    p = p * y - 0.00019841269841208676;
    p = p * y + 0.008333333333333186;
    p = p * y - 0.16666666666666666;
    return p * y + 1;
}

static inline double cosine(double y)
{
    double p = 4.608977003001797e-14;
    p = p * y - 1.1462901901757276e-11;
    p = p * y + 2.0876561839933163e-09;
    p = p * y - 2.755731639102575e-07;
    p = p * y + 2.4801587277414926e-05;
    p = p * y - 0.001388888888877299;
    p = p * y + 0.04166666666666388;
    p = p * y - 0.4999999999999997;
    return p * y + 1;
}

static inline double clamp(double value, double low, double high)
{
    value = value > low ? value : low;
    return value < high ? value : high;
}

void spherical_rectangle_packet_place(const SphericalRectanglePacket *rectangle, real x[LANES],
                                      real y[LANES])
{
    const SphericalRectanglePacket *restrict r = rectangle;
    const double least = 1e-300; /* instead of 0 under a square root: the clamp does the rest */
    SIMD for (int i = 0; i < LANES; i++)
    {
        /* half of the angle's distance from pi, since the angle is in [0, 2 pi] */
        double half = 0.5 * ((double)x[i] * r->solid_angle[i] + (r->k[i] - PI));
        double s = half * sine_ratio(half * half), c = cosine(half * half);
        double sin_angle = -2 * s * c, cos_angle = 2 * s * s - 1;

        /* sample_place's f is p / sin(angle); its x, without dividing by the sine, is */
        double x0 = r->x0[i], x1 = r->x1[i], z0 = r->z0[i];
        double p = cos_angle * r->b0[i] - r->b1[i];
        double under = p * p - r->c[i] * (sin_angle * sin_angle);
        under = under > least ? under : least;
        double place_x = -z0 * (p < 0 ? -sin_angle : sin_angle) / sqrt(under);
        place_x = clamp(place_x, x0, x1);

        /* its h0, h1 and h, times both lengths */
        double y0 = r->y0[i], y1 = r->y1[i];
        double d_squared = place_x * place_x + z0 * z0;
        double squared0 = d_squared + y0 * y0, squared1 = d_squared + y1 * y1;
        double h0 = y0 * sqrt(squared1), h1 = y1 * sqrt(squared0);
        double h = h0 + (double)y[i] * (h1 - h0);
        double rest = squared0 * squared1 - h * h;
        rest = rest > least ? rest : least;
        double place_y = clamp(h * sqrt(d_squared / rest), y0, y1);

        x[i] = (real)((place_x - x0) * r->inverse_width[i]);
        y[i] = (real)((place_y - y0) * r->inverse_height[i]);
    }
}
