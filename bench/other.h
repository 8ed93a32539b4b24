/* A renderer that loop.c times in Penumbra's place: bench/scalar.c or bench/embree.c. */
#ifndef PENUMBRA_OTHER_H
#define PENUMBRA_OTHER_H

#include "frame/render.h"

extern const char *const OTHER_VERSION;

/* As render, of quad lights, one ray through each pixel's centre, with independent samples; leaves
 * variance alone. All calls of a process must be with the same scene. */
bool other_render(const Scene *scene, const RenderSettings *settings, float *radiance,
                  float *variance, RenderProgress *progress, void *user);

#endif
