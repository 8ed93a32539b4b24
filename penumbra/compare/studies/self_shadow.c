/* Where a shadow ray should start: four ways, judged ray by ray. A study beside the renderer,
 * whose own functions find the hits; compare/studies/self_shadow.py makes the scenes and counts. */
#include <float.h>
#include <stdint.h>
#include <string.h>

#include "core/scene.h"

/* 113 bits: coordinates of 1e7 and radii of 1e-6, squared, leave 60 of them to decide with. */
__extension__ typedef _Float128 wide;

#ifdef PENUMBRA_FLOAT64
typedef int64_t Bits;
#define EPSILON DBL_EPSILON
#else
typedef int32_t Bits;
#define EPSILON FLT_EPSILON
#endif

typedef enum {
    ANSWER_NOT_SENT, /* no hit, or the light is below the horizon or shows its dark side */
    ANSWER_VISIBLE,
    ANSWER_OWN,  /* hidden by the surface that the ray leaves */
    ANSWER_OTHER /* hidden by another */
} Answer;

/* ---- the four starts ---- */

/* (1) a fixed distance [m] along the normal, as in many a student's code */
static Vec3 fixed_start(const Hit *hit)
{
    return vec3_along(hit->point, hit->normal, (real)1e-3);
}

/* (2) 256 units in the last place of each coordinate, or a small fixed distance near 0: Wächter
 * and Binder, "A fast and robust method for avoiding self-intersection", Ray Tracing Gems (2019),
 * chapter 6. Their 1/65536 is 128 float32 epsilons, and in float64 it is taken as such. */
static real integer_offset(real coordinate, real normal)
{
    if (fabs(coordinate) < (real)1 / 32)
        return coordinate + 128 * EPSILON * normal;
    Bits steps = (Bits)(256 * normal), bits;
    memcpy(&bits, &coordinate, sizeof bits);
    bits += coordinate < 0 ? -steps : steps;
    memcpy(&coordinate, &bits, sizeof bits);
    return coordinate;
}

static Vec3 integer_start(const Hit *hit)
{
    return (Vec3){integer_offset(hit->point.x, hit->normal.x),
                  integer_offset(hit->point.y, hit->normal.y),
                  integer_offset(hit->point.z, hit->normal.z)};
}

/* gamma_n = n u / (1 - n u): the relative error of n roundings (Higham, Accuracy and Stability of
 * Numerical Algorithms, 2nd edition, lemma 3.1), u half an epsilon */
static real gamma_of(int n)
{
    real nu = (real)n * EPSILON / 2;
    return nu / (1 - nu);
}

static Vec3 vec3_abs(Vec3 a)
{
    return (Vec3){fabs(a.x), fabs(a.y), fabs(a.z)};
}

static real away(real coordinate, real offset)
{
    real moved = coordinate + offset;
    if (offset == 0)
        return moved;
    return nextafter(moved, offset > 0 ? (real)INFINITY : -(real)INFINITY);
}

/* (3) The smallest distance that rounding cannot undo: Pharr, Jakob, Humphreys, Physically Based
 * Rendering, 4th edition, section 6.8. The hit is pulled back onto its surface, and moved off it
 * by the bound on what is left: one rounding of each coordinate, and the error of the pull and of
 * the shadow test itself (which pbrt puts into the test, as intervals).
 *
 * Plane: n . (p - q) has four roundings, once in the pull and once in the test.
 * Sphere: p = c + (p - c) r / |p - c| has five. The test's discriminant has an error of at most
 * gamma_25 r^2: four roundings in along, one more and four of the direction's length in along *
 * direction, one of the difference, all twice as it is squared, three of the dot product and two of
 * the rest; gamma_13 r of distance. */
static Vec3 bounded_start(const Scene *scene, const Hit *hit)
{
    Vec3 point, size = vec3_abs(hit->normal);
    real bound;
    if (hit->object < scene->nb_spheres) {
        const Sphere *sphere = &scene->spheres[hit->object];
        Vec3 local = vec3_sub(hit->point, sphere->center);
        local = vec3_scale(local, sphere->radius / sqrt(vec3_dot(local, local)));
        point = vec3_add(sphere->center, local);
        bound = gamma_of(5) * vec3_dot(size, vec3_abs(local)) + gamma_of(13) * sphere->radius;
    } else {
        const Plane *plane = &scene->planes[hit->object - scene->nb_spheres];
        Vec3 local = vec3_sub(hit->point, plane->point);
        point = vec3_along(hit->point, plane->normal, -vec3_dot(plane->normal, local));
        bound = 2 * gamma_of(4) * vec3_dot(size, vec3_abs(local));
    }
    bound += gamma_of(1) * vec3_dot(size, vec3_abs(point));
    return (Vec3){away(point.x, bound * hit->normal.x), away(point.y, bound * hit->normal.y),
                  away(point.z, bound * hit->normal.z)};
}

/* ---- their answers ---- */

static Vec3 light_position(const QuadLight *light, Uniform2 random)
{
    return vec3_along(vec3_along(light->corner, light->edge_u, random.x), light->edge_v, random.y);
}

/* Every surface is tested, the ray's own too. The ray aims from where it starts. */
static Answer answer_from(const Scene *scene, Vec3 start, Vec3 target, int own)
{
    Vec3 to_light = vec3_sub(target, start);
    real distance = sqrt(vec3_dot(to_light, to_light));
    Ray ray = {start, vec3_scale(to_light, 1 / distance)};
    Answer answer = ANSWER_VISIBLE;
    for (int i = 0; i < scene->nb_spheres + scene->nb_planes; i++) {
        real t = i < scene->nb_spheres ? sphere_hit(&scene->spheres[i], ray)
                                       : plane_hit(&scene->planes[i - scene->nb_spheres], ray);
        if (t > 0 && t < distance && answer != ANSWER_OWN)
            answer = i == own ? ANSWER_OWN : ANSWER_OTHER;
    }
    return answer;
}

/* (4) the renderer itself: no offset, and the surface that the ray leaves is not tested */
static Answer answer_skipping(const Scene *scene, const Hit *hit, LightSample sample)
{
    Ray ray = {hit->point, sample.direction};
    if (!scene_occluded(scene, ray, sample.distance, hit->object))
        return ANSWER_VISIBLE;
    if (hit->object < scene->nb_spheres) {
        real far_wall = sphere_hit_from_its_surface(&scene->spheres[hit->object], ray);
        if (far_wall > 0 && far_wall < sample.distance)
            return ANSWER_OWN;
    }
    return ANSWER_OTHER;
}

/* ---- the truth ---- */

typedef struct {
    wide x, y, z;
} Wide3;

static Wide3 wide3_from(Vec3 a)
{
    return (Wide3){a.x, a.y, a.z};
}

static Wide3 wide3_sub(Wide3 a, Wide3 b)
{
    return (Wide3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static Wide3 wide3_along(Wide3 a, Wide3 b, wide t)
{
    return (Wide3){a.x + t * b.x, a.y + t * b.y, a.z + t * b.z};
}

static wide wide3_dot(Wide3 a, Wide3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* Newton's method doubles the digits of the double's root each time. */
static wide wide_sqrt(wide a)
{
    if (a <= 0)
        return 0;
    wide root = (wide)sqrt((double)a);
    root = (root + a / root) / 2;
    return (root + a / root) / 2;
}

/* Where origin + t direction meets the sphere; false where it does not. direction is not unit. */
static bool wide_sphere_roots(const Sphere *sphere, Wide3 origin, Wide3 direction, wide root[2])
{
    Wide3 o = wide3_sub(origin, wide3_from(sphere->center));
    wide a = wide3_dot(direction, direction), b = wide3_dot(o, direction);
    wide c = wide3_dot(o, o) - (wide)sphere->radius * sphere->radius;
    wide discriminant = b * b - a * c;
    if (discriminant <= 0)
        return false;
    wide q = b > 0 ? -(b + wide_sqrt(discriminant)) : -(b - wide_sqrt(discriminant));
    wide r0 = q / a, r1 = c / q;
    root[0] = r0 < r1 ? r0 : r1;
    root[1] = r0 < r1 ? r1 : r0;
    return true;
}

static wide wide_plane_root(const Plane *plane, Wide3 origin, Wide3 direction)
{
    Wide3 n = wide3_from(plane->normal);
    wide approach = wide3_dot(n, direction);
    return approach == 0 ? 0 : wide3_dot(n, wide3_sub(wide3_from(plane->point), origin)) / approach;
}

/* The first t > 0 at which the ray meets object i; 0 for none. */
static wide wide_first(const Scene *scene, int i, Wide3 origin, Wide3 direction)
{
    wide root[2];
    if (i >= scene->nb_spheres) {
        root[0] = wide_plane_root(&scene->planes[i - scene->nb_spheres], origin, direction);
        return root[0] > 0 ? root[0] : 0;
    }
    if (!wide_sphere_roots(&scene->spheres[i], origin, direction, root))
        return 0;
    return root[0] > 0 ? root[0] : root[1] > 0 ? root[1] : 0;
}

static Answer answer_of_others(const Scene *scene, Wide3 start, Wide3 to_light, int own)
{
    for (int i = 0; i < scene->nb_spheres + scene->nb_planes; i++) {
        wide t = i == own ? 0 : wide_first(scene, i, start, to_light);
        if (t > 0 && t < 1)
            return ANSWER_OTHER;
    }
    return ANSWER_VISIBLE;
}

/* A ray that leaves the inside of a sphere meets its far wall at -2 (o - c) . w / |w|^2. */
static bool far_wall_hides(const Scene *scene, int own, Wide3 start, Wide3 to_light)
{
    if (own >= scene->nb_spheres)
        return false;
    Wide3 o = wide3_sub(start, wide3_from(scene->spheres[own].center));
    wide t = -2 * wide3_dot(o, to_light) / wide3_dot(to_light, to_light);
    return t > 0 && t < 1;
}

/* What the scene, as its numbers are stored, says of the light's point `target` as seen from where
 * the camera's ray exactly meets it. NOT_SENT where that is on another object than the renderer's
 * hit, or where the light shows its dark side. */
static Answer true_answer(const Scene *scene, Ray camera_ray, int own, const QuadLight *light,
                          Wide3 target)
{
    Wide3 origin = wide3_from(camera_ray.origin), direction = wide3_from(camera_ray.direction);
    wide nearest = 0;
    int object = SCENE_NOTHING;
    for (int i = 0; i < scene->nb_spheres + scene->nb_planes; i++) {
        wide t = wide_first(scene, i, origin, direction);
        if (t > 0 && (object == SCENE_NOTHING || t < nearest)) {
            nearest = t;
            object = i;
        }
    }
    if (object != own)
        return ANSWER_NOT_SENT;

    Wide3 point = wide3_along(origin, direction, nearest), to_light = wide3_sub(target, point);
    Wide3 u = wide3_from(light->edge_u), v = wide3_from(light->edge_v);
    Wide3 side = {u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x};
    if (wide3_dot(side, to_light) <= 0)
        return ANSWER_NOT_SENT;

    Wide3 normal = own < scene->nb_spheres
                       ? wide3_sub(point, wide3_from(scene->spheres[own].center))
                       : wide3_from(scene->planes[own - scene->nb_spheres].normal);
    bool turned = wide3_dot(normal, direction) > 0;
    wide cosine = wide3_dot(normal, to_light);
    if ((turned ? -cosine : cosine) <= 0) /* below the horizon */
        return ANSWER_OWN;
    if (turned && far_wall_hides(scene, own, point, to_light))
        return ANSWER_OWN;
    return answer_of_others(scene, point, to_light, own);
}

/* What no start can mend: the stored hit point is not the true one. The visibility from there,
 * without further error. */
static Answer rounded_answer(const Scene *scene, const Hit *hit, Wide3 target)
{
    Wide3 point = wide3_from(hit->point), to_light = wide3_sub(target, point);
    if (far_wall_hides(scene, hit->object, point, to_light))
        return ANSWER_OWN;
    return answer_of_others(scene, point, to_light, hit->object);
}

/* ---- all of it ---- */

/* Where the ray ended, as (1) and (2) take it: this renderer puts the point back onto its plane. */
static Hit ray_end(const Scene *scene, Ray ray, Hit hit)
{
    if (hit.object >= scene->nb_spheres) {
        real distance = plane_hit(&scene->planes[hit.object - scene->nb_spheres], ray);
        hit.point = vec3_along(ray.origin, ray.direction, distance);
    }
    return hit;
}

enum { ANSWERS = 6 }; /* truth, rounding alone, (1), (2), (3), (4) */

static void judge(const Scene *scene, Ray camera_ray, Uniform2 random, signed char *answers)
{
    memset(answers, ANSWER_NOT_SENT, ANSWERS);
    Hit hit = scene_hit(scene, camera_ray);
    if (hit.object == SCENE_NOTHING)
        return;
    LightSampler sampler;
    light_sampler_create(&sampler, &scene->lights[0], hit.point, SPREAD_AREA);
    LightSample sample = light_sampler_draw(&sampler, random);
    if (sample.pdf_solid_angle <= 0 || vec3_dot(hit.normal, sample.direction) <= 0)
        return;
    const QuadLight *light = &scene->lights[0].shape.quad;
    Wide3 exactly = wide3_along(wide3_from(light->corner), wide3_from(light->edge_u), random.x);
    exactly = wide3_along(exactly, wide3_from(light->edge_v), random.y);
    Answer truth = true_answer(scene, camera_ray, hit.object, light, exactly);
    if (truth == ANSWER_NOT_SENT)
        return;

    const Vec3 target = light_position(light, random);
    const Hit ended = ray_end(scene, camera_ray, hit);
    const Vec3 start[3] = {fixed_start(&ended), integer_start(&ended), bounded_start(scene, &hit)};
    answers[0] = (signed char)truth;
    answers[1] = (signed char)rounded_answer(scene, &hit, exactly);
    for (int i = 0; i < 3; i++)
        answers[2 + i] = (signed char)answer_from(scene, start[i], target, hit.object);
    answers[5] = (signed char)answer_skipping(scene, &hit, sample);
}

/* spheres: center, radius. planes: point, normal. quad: corner, edge_u, edge_v. rays: direction from
 * the camera, place on the light in [0, 1)^2. answers: ANSWERS for each ray. */
void self_shadow(const real *spheres, int nb_spheres, const real *planes, int nb_planes,
                 const real *quad, const real *camera, const real *rays, int nb_rays,
                 signed char *answers)
{
    enum { MOST = 4 };
    Sphere sphere[MOST];
    Plane plane[MOST];
    if (nb_spheres > MOST || nb_planes > MOST)
        return;
    for (int i = 0; i < nb_spheres; i++, spheres += 4)
        sphere[i] = (Sphere){{spheres[0], spheres[1], spheres[2]}, spheres[3], {1, 1, 1}};
    for (int i = 0; i < nb_planes; i++, planes += 6)
        plane[i] = (Plane){
            {planes[0], planes[1], planes[2]}, {planes[3], planes[4], planes[5]}, {1, 1, 1}};
    QuadLight light = {.corner = {quad[0], quad[1], quad[2]},
                       .edge_u = {quad[3], quad[4], quad[5]},
                       .edge_v = {quad[6], quad[7], quad[8]},
                       .radiance = {1, 1, 1}};
    const Vec3 u = light.edge_u, v = light.edge_v;
    const Vec3 across = {u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x};
    light.normal = vec3_normalize(across);
    light.area = sqrt(vec3_dot(across, across));
    Light lights[1] = {{LIGHT_QUAD, {.quad = light}}};
    const Scene scene = {.ray_max_distance = (real)INFINITY,
                         .nb_spheres = nb_spheres,
                         .nb_planes = nb_planes,
                         .nb_lights = 1,
                         .spheres = sphere,
                         .planes = plane,
                         .lights = lights};

#pragma omp parallel for
    for (int i = 0; i < nb_rays; i++) {
        const real *ray = rays + 5 * (size_t)i;
        Ray camera_ray = {{camera[0], camera[1], camera[2]}, {ray[0], ray[1], ray[2]}};
        judge(&scene, camera_ray, (Uniform2){ray[3], ray[4]}, answers + ANSWERS * (size_t)i);
    }
}
