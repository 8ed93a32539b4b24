/* Every pixel of the image, on all threads. */
#ifndef PENUMBRA_RENDER_H
#define PENUMBRA_RENDER_H

#include <stdbool.h>
#include <stdint.h>

#include "scene.h"

typedef struct {
    int width, height;     /* [pixels] */
    int nb_light_samples;  /* shadow rays for each surface light, >= 1 */
    int samples_per_pixel; /* 1: the pixel's centre; more: uniform random places in it */
    uint64_t seed;
    int threads; /* >= 1 */
} RenderSettings;

/* Called now and then from one of the threads; may be NULL. */
typedef void RenderProgress(int rows_done, int rows, void *user);

/* Fills radiance and variance (of each pixel's mean), both width * height * 3 floats: rows from
 * the top, R, G, B together. The same settings but threads give the same bits. */
void render(const Scene *scene, const RenderSettings *settings, float *radiance,
            float *variance, RenderProgress *progress, void *user);

/* Whether the samples tell a variance: one random sample has no scatter. */
bool render_knows_variance(const Scene *scene, const RenderSettings *settings);

#endif
