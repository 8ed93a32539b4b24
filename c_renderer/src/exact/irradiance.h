/* The noise-free answer: how much of the lights a surface gets, without samples. docs/exact.md
 * derives it; compare/exact/irradiance.py is the same, written independently of this program. */
#ifndef PENUMBRA_IRRADIANCE_H
#define PENUMBRA_IRRADIANCE_H

#include "core/scene.h"

/* The projected solid angle [sr] of what the hit sees of a surface light:
 *     integral over the light's directions of V cos_surface,
 * which is its irradiance over the light's radiance, in closed form.
 * error_bound [sr]: on the absolute error, given the scene's numbers and the hit's as they are;
 * may be NULL. */
double irradiance_light(const Scene *scene, const Light *light, const Hit *hit,
                        double *error_bound);

/* direct_lighting's limit for infinitely many samples: the sum over all lights [W m^-2 sr^-1]. */
Rgb exact_lighting(const Scene *scene, const Hit *hit);

/* One light's part. */
Rgb exact_light(const Scene *scene, int light, const Hit *hit);

#endif
