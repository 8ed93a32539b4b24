#include "spherical_rectangle.h"

#define MIN_SOLID_ANGLE 1e-7  /* [sr]; the four angles' sum is right to 1e-15 or so */
#define MAX_COSINE_OF_UV 1e-6 /* of the quad's edges: float rounding of a right angle */
static const double TWO_PI = 6.283185307179586;

/* The angle of two unit vectors' opposites, a and -b, well-conditioned everywhere. */
static double angle_between_planes(const double a[3], const double b[3])
{
    double cx = a[1] * b[2] - a[2] * b[1], cy = a[2] * b[0] - a[0] * b[2],
           cz = a[0] * b[1] - a[1] * b[0];
    return atan2(sqrt(cx * cx + cy * cy + cz * cz), -(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
}

static void set_unit(double v[3], double x, double y, double z)
{
    double length = sqrt(x * x + y * y + z * z);
    v[0] = x / length;
    v[1] = y / length;
    v[2] = z / length;
}

bool spherical_rectangle_create(SphericalRectangle *rectangle, const QuadLight *light, Vec3 point)
{
    SphericalRectangle r = {.z = light->normal};
    double u_length = sqrt((double)vec3_dot(light->edge_u, light->edge_u));
    double v_length = sqrt((double)vec3_dot(light->edge_v, light->edge_v));
    r.x = vec3_scale(light->edge_u, (real)(1 / u_length));
    r.y = vec3_scale(light->edge_v, (real)(1 / v_length));
    if (fabs(vec3_dot(r.x, r.y)) > (real)MAX_COSINE_OF_UV)
        return false;

    Vec3 corner = vec3_sub(light->corner, point);
    r.x0 = (double)vec3_dot(corner, r.x);
    r.y0 = (double)vec3_dot(corner, r.y);
    r.z0 = (double)vec3_dot(corner, r.z);
    r.x1 = r.x0 + u_length;
    r.y1 = r.y0 + v_length;
    if (r.z0 == 0)
        return false;
    if (r.z0 > 0) {
        r.z0 = -r.z0;
        r.z = vec3_scale(r.z, -1);
    }

    /* normals of the four planes through the point and a side */
    double n0[3], n1[3], n2[3], n3[3];
    set_unit(n0, 0, r.z0, -r.y0);
    set_unit(n1, -r.z0, 0, r.x1);
    set_unit(n2, 0, -r.z0, r.y1);
    set_unit(n3, r.z0, 0, -r.x0);
    double g0 = angle_between_planes(n0, n1), g1 = angle_between_planes(n1, n2);
    double g2 = angle_between_planes(n2, n3), g3 = angle_between_planes(n3, n0);
    r.b0 = n0[2];
    r.b1 = n2[2];
    r.k = TWO_PI - g2 - g3;
    r.solid_angle = g0 + g1 - r.k;
    *rectangle = r;
    return r.solid_angle >= MIN_SOLID_ANGLE;
}

static double clamp(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* Where the direction to (u, v) meets the rectangle, seen from the point. */
static Vec3 sample_place(const SphericalRectangle *rectangle, Uniform2 random)
{
    const SphericalRectangle *r = rectangle;

    /* cosine of the longitude that has the share u of the solid angle on its one side */
    double angle = (double)random.x * r->solid_angle + r->k;
    double f = (cos(angle) * r->b0 - r->b1) / sin(angle);
    double cu = clamp(copysign(1.0, f) / sqrt(f * f + r->b0 * r->b0), -1, 1);
    double sine = sqrt(fmax(1 - cu * cu, 0.0));
    double x = sine > 0 ? clamp(-(cu * r->z0) / sine, r->x0, r->x1) : cu > 0 ? r->x1 : r->x0;

    /* height on the sphere, even in v */
    double d_squared = x * x + r->z0 * r->z0;
    double h0 = r->y0 / sqrt(d_squared + r->y0 * r->y0);
    double h1 = r->y1 / sqrt(d_squared + r->y1 * r->y1);
    double h = h0 + (double)random.y * (h1 - h0);
    double rest = 1 - h * h;
    double y = rest > 0 ? clamp(h * sqrt(d_squared / rest), r->y0, r->y1) : h > 0 ? r->y1 : r->y0;

    Vec3 place = vec3_scale(r->x, (real)x);
    place = vec3_along(place, r->y, (real)y);
    return vec3_along(place, r->z, (real)r->z0);
}

LightSample spherical_rectangle_light_sample(const SphericalRectangle *rectangle,
                                             const QuadLight *light, Uniform2 random)
{
    Vec3 to_light = sample_place(rectangle, random);
    LightSample sample = {.distance = sqrt(vec3_dot(to_light, to_light))};
    sample.direction = vec3_scale(to_light, 1 / sample.distance);
    sample.pdf_solid_angle = (real)(1 / rectangle->solid_angle);
    sample.radiance = rgb_scale(light->radiance, (real)rectangle->solid_angle);
    return sample;
}
