#include "outline_packet.h"

/* ---- the light, its horizon, and planes ---- */

static QuadFrame quad_frame(const QuadLight *light)
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

static Vec3d quad_frame_direction(const QuadFrame *frame, Vec3d world)
{
    return (Vec3d){vec3d_dot(world, frame->x), vec3d_dot(world, frame->y),
                   vec3d_dot(world, frame->z)};
}

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
    /* arcs are known to eps, and not to eps times a small light's size: 1e-9 of it, at worst */
    const double least_size = 1e-6, size_squared = f.ux * f.ux + f.vx * f.vx + f.vy * f.vy;
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
        strange = size_squared > least_size * (low + x0 * x0) ? strange : 1;
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

/* ---- the whole ---- */

int light_view_packet(const Scene *scene, const QuadLight *light, const HitPacket *hits,
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
