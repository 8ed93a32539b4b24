/* The library of mistakes, for a page's worker. Arrays are what it has put into the module's memory
 * by malloc; names are looked up with mistakes_choice. */
#include "../mistakes/choice.h"

#include <string.h>

#include "scene.h"

int FOR_PAGE(choice)(Module module, const char *name)
{
    return mistakes_choice(module, name);
}

/* Whether what these choices render is saved without a clamp, wrapping around in its 8 bits. */
bool FOR_PAGE(saved_wrapped)(const int choice[NB_MODULES])
{
    return CHOICES[choice[MODULE_OUTPUT]].output.wrap;
}

/* The rows first, first + step, ... of width * height * 3 floats, RGB, which are the caller's until
 * the next call. NULL: out of memory. */
float *FOR_PAGE(mistaken_rows)(const int choice[NB_MODULES], int width, int height,
                               int nb_light_samples, int samples_per_pixel, double seed,
                               double position_x, double position_y, int divisor, int first,
                               int step)
{
    float *radiance = picture_room(width, height);
    MistakenSettings settings = {.factor = 1,
                                 .width = width,
                                 .height = height,
                                 .nb_light_samples = nb_light_samples,
                                 .samples_per_pixel = samples_per_pixel,
                                 .seed = (unsigned long long)seed,
                                 .position_x = position_x,
                                 .position_y = position_y,
                                 .divisor = divisor};
    memcpy(settings.choice, choice, sizeof settings.choice);
    if (radiance)
        mistakes_render_rows(&scene, &settings, first, step, radiance);
    return radiance;
}

void FOR_PAGE(moments)(int light, int n, int before, const double *point, const double *normal,
                       const double *right, const double *down, const int *object, int domain,
                       const int *rays, int nb_rays, const int *weights, int nb_weights, int grid,
                       float *chance, float *first, float *second)
{
    const Receivers receivers = {n, point, normal, right, down, object, before};
    mistakes_moments(&scene, light, &receivers, domain, rays, nb_rays, weights, nb_weights, grid,
                     chance, first, second);
}
