/* Which pixels have too few light samples for the light that they see from close by. */
#ifndef PENUMBRA_TRUST_H
#define PENUMBRA_TRUST_H

#include "render.h"

/* At distance d from a light of area A most of its irradiance comes from about pi d^2 of it, the
 * spot before the point. With fewer than this many samples expected there, N pi d^2 / A, the
 * estimate has a standard error above (3 * 16)^-1/2 = 14%, and its stated variance is that of the
 * samples that happened to come: docs/stability.md. */
enum { TRUST_SPOT_SAMPLES = 16 };

/* Pixels, by their centres, whose estimate may be wrong by much and not show it, with that many
 * samples for each light. Samples spread over the solid angle, and the closed form, are not
 * concerned. */
int trust_untrusted_pixels(const Scene *scene, const RenderSettings *settings, int light_samples);

#endif
