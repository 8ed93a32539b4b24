/* Images with their provenance, written as OpenEXR. */
#ifndef PENUMBRA_EXR_H
#define PENUMBRA_EXR_H

#include <stdbool.h>
#include <stddef.h>

#include "render.h"

/* Writes 32-bit float scanlines: R, G, B and, unless variance is NULL, variance.R .G .B, with
 * scene, settings, sampler, time and version as header attributes. The file appears under its
 * name only when it is whole. False: nothing was left behind, and message says why. */
bool exr_write(const char *file, const Scene *scene, const RenderSettings *settings, double seconds,
               const float *radiance, const float *variance, char *message, size_t message_size);

#endif
