#include "packet.h"

/* camera_ray's direction, for each lane */
static void camera_directions(const Camera *camera, const real x[LANES], const real y[LANES],
                              int width, int height, Vec3Packet *direction)
{
    const Camera c = *camera;
    const real half_height = c.tan_half_fov_y;
    const real half_width = half_height * (real)width / (real)height;
    const real pixel_width = 2 / (real)width, pixel_height = 2 / (real)height;
    SIMD for (int i = 0; i < LANES; i++)
    {
        real right = (pixel_width * x[i] - 1) * half_width;
        real up = (1 - pixel_height * y[i]) * half_height;
        real dx = c.forward.x + right * c.right.x + up * c.up.x;
        real dy = c.forward.y + right * c.right.y + up * c.up.y;
        real dz = c.forward.z + right * c.right.z + up * c.up.z;
        real scale = 1 / sqrt(dx * dx + dy * dy + dz * dz);
        direction->x[i] = dx * scale;
        direction->y[i] = dy * scale;
        direction->z[i] = dz * scale;
    }
}

/* sphere_hit and plane_hit, for each lane: the distance where it is below nearest, and then the
 * object. A distance of inf or NaN is none. */
static void hit_sphere(const Sphere *sphere, int object, Vec3 origin, const Vec3Packet *direction,
                       real nearest[LANES], int objects[LANES])
{
    const Vec3 to_origin = vec3_sub(origin, sphere->center);
    const real radius_squared = sphere->radius * sphere->radius;
    const real outside = vec3_dot(to_origin, to_origin) - radius_squared;
    real distance[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = direction->x[i], dy = direction->y[i], dz = direction->z[i];
        real along = to_origin.x * dx + to_origin.y * dy + to_origin.z * dz;
        real px = to_origin.x - dx * along, py = to_origin.y - dy * along,
             pz = to_origin.z - dz * along;
        real discriminant = radius_squared - (px * px + py * py + pz * pz);
        real half_chord = sqrt(discriminant); /* NaN: a miss */
        real far_root = half_chord - along;
        /* From inside or on it, the far wall; its other form is shape.c's, against cancellation. */
        real from_inside = along > 0 ? -outside / (half_chord + along) : far_root;
        distance[i] = outside <= 0 ? from_inside : outside / far_root;
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        int hit = (distance[i] > 0) & (distance[i] < nearest[i]);
        objects[i] = hit ? object : objects[i];
    }
    SIMD for (int i = 0; i < LANES; i++) nearest[i] =
        objects[i] == object ? distance[i] : nearest[i];
}

static void hit_plane(const Plane *plane, int object, Vec3 origin, const Vec3Packet *direction,
                      real nearest[LANES], int objects[LANES])
{
    const Vec3 n = plane->normal;
    const real height = vec3_dot(n, vec3_sub(plane->point, origin));
    real distance[LANES];
    SIMD for (int i = 0; i < LANES; i++) distance[i] =
        height / (n.x * direction->x[i] + n.y * direction->y[i] + n.z * direction->z[i]);
    SIMD for (int i = 0; i < LANES; i++)
    {
        int hit = (distance[i] > 0) & (distance[i] < nearest[i]);
        objects[i] = hit ? object : objects[i];
    }
    SIMD for (int i = 0; i < LANES; i++) nearest[i] =
        objects[i] == object ? distance[i] : nearest[i];
}

/* Normals and colours of the lanes that see this object; most packets see but one or two. */
static void shade_sphere(const Sphere *sphere, int object, HitPacket *hits)
{
    const Sphere s = *sphere;
    SIMD for (int i = 0; i < LANES; i++)
    {
        int here = hits->object[i] == object;
        real nx = hits->point.x[i] - s.center.x, ny = hits->point.y[i] - s.center.y,
             nz = hits->point.z[i] - s.center.z;
        real scale = 1 / sqrt(nx * nx + ny * ny + nz * nz);
        hits->normal.x[i] = here ? nx * scale : hits->normal.x[i];
        hits->normal.y[i] = here ? ny * scale : hits->normal.y[i];
        hits->normal.z[i] = here ? nz * scale : hits->normal.z[i];
        hits->brdf.r[i] = here ? s.brdf.r : hits->brdf.r[i];
        hits->brdf.g[i] = here ? s.brdf.g : hits->brdf.g[i];
        hits->brdf.b[i] = here ? s.brdf.b : hits->brdf.b[i];
    }
}

static void shade_plane(const Plane *plane, int object, HitPacket *hits)
{
    const Plane p = *plane;
    SIMD for (int i = 0; i < LANES; i++)
    {
        int here = hits->object[i] == object;
        hits->normal.x[i] = here ? p.normal.x : hits->normal.x[i];
        hits->normal.y[i] = here ? p.normal.y : hits->normal.y[i];
        hits->normal.z[i] = here ? p.normal.z : hits->normal.z[i];
        hits->brdf.r[i] = here ? p.brdf.r : hits->brdf.r[i];
        hits->brdf.g[i] = here ? p.brdf.g : hits->brdf.g[i];
        hits->brdf.b[i] = here ? p.brdf.b : hits->brdf.b[i];
    }
}

void packet_hit(const Scene *scene, const real x[LANES], const real y[LANES], int width, int height,
                HitPacket *hits)
{
    const Vec3 origin = scene->camera.position;
    Vec3Packet direction;
    real nearest[LANES];
    int object[LANES];
    camera_directions(&scene->camera, x, y, width, height, &direction);
    for (int i = 0; i < LANES; i++) {
        nearest[i] = scene->ray_max_distance;
        object[i] = SCENE_NOTHING;
    }
    for (int s = 0; s < scene->nb_spheres; s++)
        hit_sphere(&scene->spheres[s], s, origin, &direction, nearest, object);
    for (int p = 0; p < scene->nb_planes; p++)
        hit_plane(&scene->planes[p], scene->nb_spheres + p, origin, &direction, nearest, object);

    hits->nb_hits = 0;
    for (int i = 0; i < LANES; i++) {
        hits->object[i] = object[i];
        hits->nb_hits += object[i] != SCENE_NOTHING;
    }
    if (!hits->nb_hits)
        return;
    SIMD for (int i = 0; i < LANES; i++)
    {
        hits->point.x[i] = origin.x + nearest[i] * direction.x[i];
        hits->point.y[i] = origin.y + nearest[i] * direction.y[i];
        hits->point.z[i] = origin.z + nearest[i] * direction.z[i];
        hits->normal.x[i] = hits->normal.y[i] = hits->normal.z[i] = 0;
        hits->brdf.r[i] = hits->brdf.g[i] = hits->brdf.b[i] = 0;
    }
    for (int i = 0, done = SCENE_NOTHING; i < LANES; i++) {
        if (object[i] == SCENE_NOTHING || object[i] == done)
            continue;
        done = object[i];
        if (done < scene->nb_spheres)
            shade_sphere(&scene->spheres[done], done, hits);
        else
            shade_plane(&scene->planes[done - scene->nb_spheres], done, hits);
    }
    SIMD for (int i = 0; i < LANES; i++)
    {
        real away = hits->normal.x[i] * direction.x[i] + hits->normal.y[i] * direction.y[i] +
                    hits->normal.z[i] * direction.z[i];
        real side = away > 0 ? -1.0f : 1.0f;
        hits->normal.x[i] *= side;
        hits->normal.y[i] *= side;
        hits->normal.z[i] *= side;
    }
}

Hit packet_lane(const HitPacket *hits, int lane)
{
    return (Hit){hits->object[lane],
                 {hits->point.x[lane], hits->point.y[lane], hits->point.z[lane]},
                 {hits->normal.x[lane], hits->normal.y[lane], hits->normal.z[lane]},
                 {hits->brdf.r[lane], hits->brdf.g[lane], hits->brdf.b[lane]}};
}
