#include "scene.h"

#include <stdlib.h>

Hit scene_hit(const Scene *scene, Ray ray)
{
    Hit hit = {.object = SCENE_NOTHING};
    real nearest = scene->ray_max_distance;
    for (int i = 0; i < scene->nb_spheres; i++) {
        real distance = sphere_hit(&scene->spheres[i], ray);
        if (distance > 0 && distance < nearest) {
            nearest = distance;
            hit.object = i;
        }
    }
    for (int i = 0; i < scene->nb_planes; i++) {
        real distance = plane_hit(&scene->planes[i], ray);
        if (distance > 0 && distance < nearest) {
            nearest = distance;
            hit.object = scene->nb_spheres + i;
        }
    }
    if (hit.object == SCENE_NOTHING)
        return hit;

    hit.point = vec3_along(ray.origin, ray.direction, nearest);
    if (hit.object < scene->nb_spheres) {
        const Sphere *sphere = &scene->spheres[hit.object];
        /* zero, and so dark, where the point was rounded to the centre, from very far away */
        hit.normal = vec3_normalize(vec3_sub(hit.point, sphere->center));
        hit.brdf = sphere->brdf;
    } else {
        const Plane *plane = &scene->planes[hit.object - scene->nb_spheres];
        hit.normal = plane->normal;
        hit.brdf = plane->brdf;
        /* back onto the plane: rounding left it there by an error of the ray's length, and a light
         * that is near, or low over the plane, is seen from wherever the point is */
        real height = vec3_dot(plane->normal, vec3_sub(hit.point, plane->point));
        hit.point = vec3_along(hit.point, plane->normal, -height);
    }
    if (vec3_dot(hit.normal, ray.direction) > 0)
        hit.normal = vec3_scale(hit.normal, -1);
    return hit;
}

bool scene_occluded(const Scene *scene, Ray shadow_ray, real distance, int from)
{
    for (int i = 0; i < scene->nb_spheres; i++) {
        const Sphere *sphere = &scene->spheres[i];
        real t = i == from ? sphere_hit_from_its_surface(sphere, shadow_ray)
                           : sphere_hit(sphere, shadow_ray);
        if (t > 0 && t < distance)
            return true;
    }
    for (int i = 0; i < scene->nb_planes; i++) {
        if (scene->nb_spheres + i == from)
            continue;
        real t = plane_hit(&scene->planes[i], shadow_ray);
        if (t > 0 && t < distance)
            return true;
    }
    return false;
}

void scene_free(Scene *scene)
{
    free(scene->spheres);
    free(scene->planes);
    free(scene->lights);
    *scene = (Scene){0};
}
