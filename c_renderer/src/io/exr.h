/* Images with their provenance, written as OpenEXR. */
#ifndef PENUMBRA_EXR_H
#define PENUMBRA_EXR_H

#include <stdbool.h>
#include <stddef.h>

#include "frame/render.h"
#include "output.h"

/* An image and how it came to be. */
typedef struct {
    const Scene *scene;
    const RenderSettings *settings;
    double seconds;           /* of rendering */
    double target_error;      /* 0: none was set */
    const RenderSpent *spent; /* with a target */
    int untrusted_pixels;     /* trust.h */
    const float *radiance;    /* three planes, as render.h says */
    const float *variance;    /* likewise, or NULL */
} ExrImage;

/* Writes 32-bit float scanlines: R, G, B and, unless variance is NULL, variance.R .G .B, with
 * scene, settings, sampler, time and version as header attributes. False: nothing was left
 * behind, and message says why. */
bool exr_write(Output *output, const ExrImage *image, char *message, size_t message_size);

#endif
