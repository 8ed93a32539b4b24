/* Every pixel of the image, on all threads. */
#ifndef PENUMBRA_RENDER_H
#define PENUMBRA_RENDER_H

#include <stdbool.h>
#include <stdint.h>

#include "core/sampling.h"
#include "core/scene.h"

typedef enum {
    ESTIMATOR_AREA,     /* the lab's: uniform points on the light; sixteen pixels at a time */
    ESTIMATOR_TEXTBOOK, /* the same, one pixel at a time, as it is taught */
    ESTIMATOR_SOLID_ANGLE, /* points spread evenly over the solid angle, where a light has such (light.h) */
    ESTIMATOR_EXACT /* no samples: the closed form */
} Estimator;

typedef struct {
    int width, height;     /* [pixels] */
    int nb_light_samples;  /* shadow rays for each surface light, >= 1 */
    int samples_per_pixel; /* 1: the pixel's centre; more: uniform random places in it */
    uint64_t seed;
    int threads; /* >= 1 */
    Sampler sampler;
    Estimator estimator;
} RenderSettings;

/* What the command line and the image's header call them, in the enums' order. */
extern const char *const RENDER_SAMPLER_NAMES[3];
extern const char *const RENDER_ESTIMATOR_NAMES[4];

/* Called now and then from one of the threads; may be NULL. */
typedef void RenderProgress(int rows_done, int rows, void *user);

/* Fills radiance and variance (of each pixel's mean): each three planes R, G, B of
 * width * height floats, rows from the top. The same settings but threads give the same bits.
 * False: out of memory. */
bool render(const Scene *scene, const RenderSettings *settings, float *radiance, float *variance,
            RenderProgress *progress, void *user);

/* The same for the rows first, first + step, ... alone: the others' floats stay as they are.
 * variance NULL: not wanted. */
bool render_rows(const Scene *scene, const RenderSettings *settings, int first, int step,
                 float *radiance, float *variance, RenderProgress *progress, void *user);

/* What a render to a target error took. */
typedef struct {
    double light_samples; /* for each light, over all pixels, pilots included */
    double pixels_above;  /* pixels whose stated error stayed above the target */
} RenderSpent;

/* render with ESTIMATOR_AREA, one ray through each pixel's centre and independent points, their
 * number chosen for every sixteen pixels so that the relative error stays below target_error at
 * 95%, up to settings->nb_light_samples. variance is the stated one: error^2 / 2^2. */
RenderSpent render_to_target(const Scene *scene, const RenderSettings *settings,
                             double target_error, float *radiance, float *variance,
                             RenderProgress *progress, void *user);

/* Whether the samples tell a variance: a single one has no scatter, and samples that avoid each
 * other scatter more than their mean does. Several pixel samples are independent in any case. */
bool render_knows_variance(const Scene *scene, const RenderSettings *settings);

#endif
