#include "quad.h"

#define MIN_SOLID_ANGLE 1e-7  /* [sr]; the four angles' sum is right to 1e-15 or so */
#define MAX_COSINE_OF_UV 1e-6 /* of the quad's edges: float rounding of a right angle */

real quad_distance(const QuadLight *light, Vec3 point)
{
    const Vec3 corner = light->corner, u = light->edge_u, v = light->edge_v;
    Place foot = flat_foot(light, point);
    if (foot.s >= 0 && foot.s <= 1 && foot.t >= 0 && foot.t <= 1)
        return fabs(flat_height(light, point));
    return fmin(fmin(edge_distance(corner, u, point), edge_distance(corner, v, point)),
                fmin(edge_distance(vec3_add(corner, v), u, point),
                     edge_distance(vec3_add(corner, u), v, point)));
}

real quad_highest(const QuadLight *light, Vec3 direction)
{
    return vec3_dot(direction, light->corner) + real_positive(vec3_dot(direction, light->edge_u)) +
           real_positive(vec3_dot(direction, light->edge_v));
}

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
    SphericalRectangle r;
    double u_length = sqrt((double)vec3_dot(light->edge_u, light->edge_u));
    double v_length = sqrt((double)vec3_dot(light->edge_v, light->edge_v));
    Vec3 x = vec3_scale(light->edge_u, (real)(1 / u_length));
    Vec3 y = vec3_scale(light->edge_v, (real)(1 / v_length));
    if (fabs(vec3_dot(x, y)) > (real)MAX_COSINE_OF_UV)
        return false;

    Vec3 corner = vec3_sub(light->corner, point);
    r.x0 = (double)vec3_dot(corner, x);
    r.y0 = (double)vec3_dot(corner, y);
    r.z0 = -fabs((double)vec3_dot(corner, light->normal));
    r.x1 = r.x0 + u_length;
    r.y1 = r.y0 + v_length;
    if (r.z0 == 0)
        return false;

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
    r.c = r.z0 * r.z0 / (r.z0 * r.z0 + r.y0 * r.y0);
    r.k = 2 * PI - g2 - g3;
    r.solid_angle = g0 + g1 - r.k;
    r.per_x = 1 / (r.x1 - r.x0);
    r.per_y = 1 / (r.y1 - r.y0);
    *rectangle = r;
    return r.solid_angle >= MIN_SOLID_ANGLE;
}
