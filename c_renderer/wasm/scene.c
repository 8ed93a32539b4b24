#include "scene.h"

#include <stddef.h>
#include <stdlib.h>

#include "exact/vec3d.h"
#include "packet/packet.h"

#define MAX_ITEMS 1000              /* of each kind, as in a scene file */
#define MIN_LENGTH 1e-9             /* [m] */
#define DEGREE 0.017453292519943295 /* pi / 180 */

/* Three numbers in a row. */
#define TRIPLE(v) double v##_x, double v##_y, double v##_z
#define VEC3D(v) ((Vec3d){v##_x, v##_y, v##_z})
#define VEC3(v) ((Vec3){(real)v##_x, (real)v##_y, (real)v##_z})
#define RGB(v) ((Rgb){(real)v##_x, (real)v##_y, (real)v##_z})
#define TIMES(v, k) ((Rgb){(real)(v##_x * k), (real)(v##_y * k), (real)(v##_z * k)})

static Sphere spheres[MAX_ITEMS];
static Plane planes[MAX_ITEMS];
static Light lights[MAX_ITEMS];
Scene scene = {.spheres = spheres, .planes = planes, .lights = lights};

/* What every function here returns: NULL, or why the page's numbers make no scene. */
typedef const char *Refusal;
static const char TOO_MANY[] = "more than 1000 items", NO_DIRECTION[] = "has no direction";

static Vec3 to_vec3(Vec3d v)
{
    return (Vec3){(real)v.x, (real)v.y, (real)v.z};
}

static Vec3d divided(Vec3d v, double by)
{
    return (Vec3d){v.x / by, v.y / by, v.z / by};
}

/* False: it is too short to have a direction. */
static bool unit(Vec3d v, Vec3d *direction)
{
    const double length = vec3d_length(v);
    *direction = divided(v, length);
    return length >= MIN_LENGTH;
}

/* Empty but for its camera. */
Refusal FOR_PAGE(scene_begin)(TRIPLE(position), TRIPLE(look_at), TRIPLE(up), double fov_y_deg,
                              TRIPLE(background), double ray_max_distance)
{
    Vec3d forward, upwards, right;
    if (!unit(vec3d_sub(VEC3D(look_at), VEC3D(position)), &forward) || !unit(VEC3D(up), &upwards))
        return NO_DIRECTION;
    if (!unit(vec3d_cross(upwards, forward), &right))
        return "up is parallel to the view direction";
    scene.camera =
        (Camera){VEC3(position), to_vec3(forward), to_vec3(right),
                 to_vec3(vec3d_cross(forward, right)), (real)tan(fov_y_deg * DEGREE / 2)};
    scene.background = RGB(background);
    scene.ray_max_distance = (real)ray_max_distance;
    scene.nb_spheres = scene.nb_planes = scene.nb_lights = 0;
    return NULL;
}

Refusal FOR_PAGE(scene_sphere)(TRIPLE(center), double radius, TRIPLE(color))
{
    if (scene.nb_spheres == MAX_ITEMS)
        return TOO_MANY;
    spheres[scene.nb_spheres++] = (Sphere){VEC3(center), (real)radius, RGB(color)};
    return NULL;
}

Refusal FOR_PAGE(scene_plane)(TRIPLE(point), TRIPLE(normal), TRIPLE(color))
{
    Vec3d direction;
    if (scene.nb_planes == MAX_ITEMS)
        return TOO_MANY;
    if (!unit(VEC3D(normal), &direction))
        return NO_DIRECTION;
    planes[scene.nb_planes++] = (Plane){VEC3(point), to_vec3(direction), RGB(color)};
    return NULL;
}

static Refusal add_light(Light light)
{
    if (scene.nb_lights == MAX_ITEMS)
        return TOO_MANY;
    lights[scene.nb_lights++] = light;
    return NULL;
}

/* A quad, or the triangle that is half of it. */
static Refusal add_flat_light(LightType type, double share, Vec3d corner, Vec3d u, Vec3d v,
                              Rgb radiance)
{
    const Vec3d normal = vec3d_cross(u, v);
    const double quad_area = vec3d_length(normal);
    if (!(quad_area > MIN_LENGTH * vec3d_length(u) * vec3d_length(v)))
        return "u and v span no area";
    const FlatLight flat = {
        to_vec3(corner),           to_vec3(u), to_vec3(v), to_vec3(divided(normal, quad_area)),
        (real)(share * quad_area), radiance};
    return add_light((Light){type, {.quad = flat}});
}

Refusal FOR_PAGE(scene_point_light)(TRIPLE(position), TRIPLE(color), double power)
{
    return add_light((Light){LIGHT_POINT, {.point = {VEC3(position), TIMES(color, power)}}});
}

Refusal FOR_PAGE(scene_quad_light)(TRIPLE(position), TRIPLE(u), TRIPLE(v), TRIPLE(color),
                                   double power)
{
    return add_flat_light(LIGHT_QUAD, 1, VEC3D(position), VEC3D(u), VEC3D(v), TIMES(color, power));
}

Refusal FOR_PAGE(scene_triangle_light)(TRIPLE(position), TRIPLE(u), TRIPLE(v), TRIPLE(color),
                                       double power)
{
    return add_flat_light(LIGHT_TRIANGLE, 0.5, VEC3D(position), VEC3D(u), VEC3D(v),
                          TIMES(color, power));
}

Refusal FOR_PAGE(scene_disk_light)(TRIPLE(center), TRIPLE(normal), double radius, TRIPLE(color),
                                   double power)
{
    Vec3d direction;
    if (!unit(VEC3D(normal), &direction))
        return NO_DIRECTION;
    return add_light((Light){LIGHT_DISK,
                             {.disk = {VEC3(center), to_vec3(direction), (real)radius,
                                       (real)(PI * radius * radius), TIMES(color, power)}}});
}

Refusal FOR_PAGE(scene_sphere_light)(TRIPLE(center), double radius, TRIPLE(color), double power)
{
    return add_light((Light){LIGHT_SPHERE,
                             {.sphere = {VEC3(center), (real)radius,
                                         (real)(4 * PI * radius * radius), TIMES(color, power)}}});
}

/* In how many pixels of the rows first, first + step, ... the ray through the centre meets a
 * surface. */
int FOR_PAGE(scene_surface_pixels)(int width, int height, int first, int step)
{
    const ImagePlane plane = image_plane(&scene.camera, width, height);
    int pixels = 0;
    for (int row = first; row < height; row += step)
        for (int column = 0; column < width; column += LANES) {
            real x[LANES], y[LANES];
            HitPacket hits;
            for (int i = 0; i < LANES; i++) {
                x[i] = (real)(column + i) + 0.5f;
                y[i] = (real)row + 0.5f;
            }
            packet_hit(&scene, &plane, x, y, &hits);
            for (int i = 0; i < LANES && column + i < width; i++)
                pixels += hits.object[i] != SCENE_NOTHING;
        }
    return pixels;
}

int FOR_PAGE(scene_lights)(void)
{
    return scene.nb_lights;
}

/* Shadow rays of a point of a surface, at so many for each surface light. */
double FOR_PAGE(scene_shadow_rays)(int nb_light_samples)
{
    double rays = 0;
    for (int i = 0; i < scene.nb_lights; i++)
        rays += light_is_surface(&scene.lights[i]) ? nb_light_samples : 1;
    return rays;
}

float *picture_room(int width, int height)
{
    static float *room;
    static size_t size;
    const size_t needed = 3 * (size_t)width * (size_t)height * sizeof *room;
    if (needed != size) {
        free(room);
        room = malloc(needed);
        size = room ? needed : 0;
    }
    return room;
}
