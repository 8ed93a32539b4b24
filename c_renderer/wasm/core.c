/* The renderer, for a page's worker: some rows of a picture. */
#include <stddef.h>

#include "frame/render.h"
#include "scene.h"

/* Three planes R, G, B of which the rows first, first + step, ... are made; they are the caller's
 * until the next call. NULL: out of memory. */
float *FOR_PAGE(core_rows)(int width, int height, int nb_light_samples, int samples_per_pixel,
                           double seed, Sampler sampler, Estimator estimator, int first, int step)
{
    float *radiance = picture_room(width, height);
    const RenderSettings settings = {width,          height, nb_light_samples, samples_per_pixel,
                                     (uint64_t)seed, 1,      sampler,          estimator};
    if (radiance && render_rows(&scene, &settings, first, step, radiance, NULL, NULL, NULL))
        return radiance;
    return NULL;
}
