/* What there is to see: surfaces, lights and the camera. */
#ifndef PENUMBRA_SCENE_H
#define PENUMBRA_SCENE_H

#include <stdbool.h>

#include "camera.h"
#include "light.h"
#include "shape.h"

enum { SCENE_NOTHING = -1 };

/* Object ids: spheres from 0, then planes. The arrays belong to the scene. */
typedef struct {
    char name[41];
    char hash[17];     /* FNV-1a of what is seen, in hexadecimal: equal scenes, equal hashes */
    int width, height; /* [pixels]; what the file asks for */
    Camera camera;
    Rgb background;        /* [W m^-2 sr^-1] */
    real ray_max_distance; /* [m]; camera rays end there */
    int nb_spheres, nb_planes, nb_lights;
    Sphere *spheres;
    Plane *planes;
    Light *lights;
} Scene;

/* Where a ray meets a surface. */
typedef struct {
    int object;  /* SCENE_NOTHING for none, and then nothing else is set */
    Vec3 point;  /* [m] */
    Vec3 normal; /* unit, turned towards the ray's origin */
    Rgb brdf;    /* [sr^-1] */
} Hit;

/* The nearest surface within ray_max_distance. */
Hit scene_hit(const Scene *scene, Ray ray);

/* Whether a surface stands between the ray's origin and the light at that distance [m]. The ray
 * leaves object `from`, which it cannot meet where it starts; nothing behind the light counts. */
bool scene_occluded(const Scene *scene, Ray shadow_ray, real distance, int from);

/* Frees the arrays. */
void scene_free(Scene *scene);

#endif
