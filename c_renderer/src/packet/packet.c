#include "packet.h"

/* Distances are in units of |direction|. */
typedef struct {
    real distance[LANES];
    int object[LANES];
} Nearest;

ImagePlane image_plane(const Camera *camera, int width, int height)
{
    const real half_height = camera->tan_half_fov_y;
    const real half_width = half_height * (real)width / (real)height;
    ImagePlane plane;
    plane.origin = camera->position;
    plane.corner = vec3_along(camera->forward, camera->right, -half_width);
    plane.corner = vec3_along(plane.corner, camera->up, half_height);
    plane.right = vec3_scale(camera->right, 2 * half_width / (real)width);
    plane.down = vec3_scale(camera->up, -2 * half_height / (real)height);
    return plane;
}

/* camera_ray for each lane, its direction not normalised: what rays hit, where and from which side
 * does not depend on their length, and a square root less need be waited for. */
typedef struct {
    Vec3 origin;
    Vec3Packet direction;
    real inverse_square[LANES]; /* 1 / |direction|^2 */
} RayPacket;

static void image_rays(const ImagePlane *plane, const real x[LANES], const real y[LANES],
                       RayPacket *rays)
{
    const Vec3 corner = plane->corner, right = plane->right, down = plane->down;
    rays->origin = plane->origin;
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = corner.x + (x[i] * right.x + y[i] * down.x);
        real dy = corner.y + (x[i] * right.y + y[i] * down.y);
        real dz = corner.z + (x[i] * right.z + y[i] * down.z);
        rays->direction.x[i] = dx;
        rays->direction.y[i] = dy;
        rays->direction.z[i] = dz;
        rays->inverse_square[i] = 1 / (dx * dx + dy * dy + dz * dz);
    }
}

/* Distances that are positive and the least so far; inf and NaN are none. */
static void keep_nearer(const real distance[LANES], int object, Nearest *nearest)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        int hit = (distance[i] > 0) & (distance[i] < nearest->distance[i]);
        nearest->object[i] = hit ? object : nearest->object[i];
    }
    SIMD for (int i = 0; i < LANES; i++) nearest->distance[i] =
        nearest->object[i] == object ? distance[i] : nearest->distance[i];
}

/* sphere_hit, for each lane. All rays have one origin, outside or not. */
static void hit_sphere(const Sphere *sphere, int object, const RayPacket *restrict rays,
                       Nearest *nearest)
{
    const Vec3 to_origin = vec3_sub(rays->origin, sphere->center);
    const real radius_squared = sphere->radius * sphere->radius;
    const real outside = vec3_dot(to_origin, to_origin) - radius_squared;
    const Vec3Packet *direction = &rays->direction;
    real along[LANES], discriminant[LANES], distance[LANES];
    int meets[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real dx = direction->x[i], dy = direction->y[i], dz = direction->z[i];
        along[i] =
            (to_origin.x * dx + to_origin.y * dy + to_origin.z * dz) * rays->inverse_square[i];
        real px = to_origin.x - dx * along[i], py = to_origin.y - dy * along[i],
             pz = to_origin.z - dz * along[i];
        discriminant[i] = radius_squared - (px * px + py * py + pz * pz);
    }
    SIMD for (int i = 0; i < LANES; i++) meets[i] = discriminant[i] >= 0;
    if (!any_lane(meets))
        return;
    if (outside <= 0) {
        SIMD for (int i = 0; i < LANES; i++)
        {
            real half_chord = sqrt(discriminant[i] * rays->inverse_square[i]);
            /* the far wall; its other form is shape.c's, against cancellation */
            real other = -outside * rays->inverse_square[i] / (half_chord + along[i]);
            distance[i] = along[i] > 0 ? other : half_chord - along[i];
        }
    } else {
        SIMD for (int i = 0; i < LANES; i++)
        {
            real half_chord = sqrt(discriminant[i] * rays->inverse_square[i]); /* NaN: a miss */
            distance[i] = outside * rays->inverse_square[i] / (half_chord - along[i]);
        }
    }
    keep_nearer(distance, object, nearest);
}

/* plane_hit, for each lane. */
static void hit_plane(const Plane *plane, int object, const RayPacket *restrict rays,
                      Nearest *nearest)
{
    const Vec3 n = plane->normal;
    const real height = vec3_dot(n, vec3_sub(plane->point, rays->origin));
    const Vec3Packet *direction = &rays->direction;
    real distance[LANES];
    SIMD for (int i = 0; i < LANES; i++) distance[i] =
        height / (n.x * direction->x[i] + n.y * direction->y[i] + n.z * direction->z[i]);
    keep_nearer(distance, object, nearest);
}

/* Normals and colours of the lanes that see this object. */
static void shade_sphere(const Sphere *sphere, int object, HitPacket *hits)
{
    const Sphere s = *sphere;
    SIMD for (int i = 0; i < LANES; i++)
    {
        int here = hits->object[i] == object;
        real nx = hits->point.x[i] - s.center.x, ny = hits->point.y[i] - s.center.y,
             nz = hits->point.z[i] - s.center.z;
        real scale = 1 / sqrt(nx * nx + ny * ny + nz * nz + FLT_MIN); /* vec3_normalize */
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
        real height = p.normal.x * (hits->point.x[i] - p.point.x) +
                      p.normal.y * (hits->point.y[i] - p.point.y) +
                      p.normal.z * (hits->point.z[i] - p.point.z);
        height = here ? height : 0; /* as scene_hit */
        hits->point.x[i] -= height * p.normal.x;
        hits->point.y[i] -= height * p.normal.y;
        hits->point.z[i] -= height * p.normal.z;
        hits->normal.x[i] = here ? p.normal.x : hits->normal.x[i];
        hits->normal.y[i] = here ? p.normal.y : hits->normal.y[i];
        hits->normal.z[i] = here ? p.normal.z : hits->normal.z[i];
        hits->brdf.r[i] = here ? p.brdf.r : hits->brdf.r[i];
        hits->brdf.g[i] = here ? p.brdf.g : hits->brdf.g[i];
        hits->brdf.b[i] = here ? p.brdf.b : hits->brdf.b[i];
    }
}

static void shade(const Scene *scene, int object, HitPacket *hits)
{
    if (object < scene->nb_spheres)
        shade_sphere(&scene->spheres[object], object, hits);
    else
        shade_plane(&scene->planes[object - scene->nb_spheres], object, hits);
}

static void shade_each(const Scene *scene, HitPacket *hits)
{
    SIMD for (int i = 0; i < LANES; i++)
    {
        hits->normal.x[i] = hits->normal.y[i] = hits->normal.z[i] = 0;
        hits->brdf.r[i] = hits->brdf.g[i] = hits->brdf.b[i] = 0;
    }
    for (int i = 0, done = SCENE_NOTHING; i < LANES; i++) {
        if (hits->object[i] == SCENE_NOTHING || hits->object[i] == done)
            continue;
        done = hits->object[i];
        shade(scene, done, hits);
    }
}

void packet_hit(const Scene *scene, const ImagePlane *plane, const real x[LANES],
                const real y[LANES], HitPacket *hits)
{
    RayPacket rays;
    Nearest nearest;
    image_rays(plane, x, y, &rays);
    SIMD for (int i = 0; i < LANES; i++)
    {
        nearest.distance[i] = INFINITY;
        nearest.object[i] = SCENE_NOTHING;
    }
    for (int s = 0; s < scene->nb_spheres; s++)
        hit_sphere(&scene->spheres[s], s, &rays, &nearest);
    for (int p = 0; p < scene->nb_planes; p++)
        hit_plane(&scene->planes[p], scene->nb_spheres + p, &rays, &nearest);

    const real furthest = scene->ray_max_distance * scene->ray_max_distance;
    int missed[LANES], differs[LANES];
    SIMD for (int i = 0; i < LANES; i++)
    {
        real distance = nearest.distance[i];
        int near = distance * distance < furthest * rays.inverse_square[i];
        hits->object[i] = near ? nearest.object[i] : SCENE_NOTHING;
    }
    const int first = hits->object[0];
    SIMD for (int i = 0; i < LANES; i++)
    {
        missed[i] = hits->object[i] == SCENE_NOTHING;
        differs[i] = hits->object[i] ^ first;
    }
    hits->all_hit = !any_lane(missed);
    hits->one_object = !any_lane(differs);
    hits->any_hit = !hits->one_object || first != SCENE_NOTHING;
    if (!hits->any_hit)
        return;
    const Vec3 origin = rays.origin;
    SIMD for (int i = 0; i < LANES; i++)
    {
        real distance = nearest.distance[i];
        hits->point.x[i] = origin.x + distance * rays.direction.x[i];
        hits->point.y[i] = origin.y + distance * rays.direction.y[i];
        hits->point.z[i] = origin.z + distance * rays.direction.z[i];
    }
    if (hits->one_object)
        shade(scene, hits->object[0], hits);
    else
        shade_each(scene, hits);
    SIMD for (int i = 0; i < LANES; i++)
    {
        real away = hits->normal.x[i] * rays.direction.x[i] +
                    hits->normal.y[i] * rays.direction.y[i] +
                    hits->normal.z[i] * rays.direction.z[i];
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
