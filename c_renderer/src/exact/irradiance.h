/* The noise-free answer: how much of the lights a surface gets, without samples. docs/exact.md
 * derives it; compare/exact/irradiance.py is the same, written independently of this program. */
#ifndef PENUMBRA_IRRADIANCE_H
#define PENUMBRA_IRRADIANCE_H

#include "core/scene.h"

/* The projected solid angle [sr] of what the hit sees of a quad light:
 *     integral over the light of V cos_surface cos_light / d^2 dA,
 * which is its irradiance over the light's radiance. In closed form; where a sphere cuts the
 * light, or holds the point, by adaptive quadrature.
 * error_bound [sr]: on the absolute error, given the scene's numbers and the hit's as they are;
 * may be NULL. */
double irradiance_quad(const Scene *scene, const QuadLight *light, const Hit *hit,
                       double *error_bound);

/* direct_lighting's limit for infinitely many samples: the sum over all lights [W m^-2 sr^-1]. */
Rgb exact_lighting(const Scene *scene, const Hit *hit);

/* One light's part. */
Rgb exact_light(const Scene *scene, int light, const Hit *hit);

#endif
