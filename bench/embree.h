/* render by Embree: one ray through each pixel's centre, independent samples, quad lights. */
#ifndef PENUMBRA_EMBREE_H
#define PENUMBRA_EMBREE_H

#include "render.h"

extern const char *const EMBREE_VERSION;

/* Leaves variance alone. All calls of a process must be with the same scene. */
bool embree_render(const Scene *scene, const RenderSettings *settings, float *radiance,
                   float *variance, RenderProgress *progress, void *user);

#endif
