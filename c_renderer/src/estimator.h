/* Direct lighting, estimated with shadow rays: the page to read first. */
#ifndef PENUMBRA_ESTIMATOR_H
#define PENUMBRA_ESTIMATOR_H

#include "rng.h"
#include "scene.h"

/* An estimate and how far it may be off. */
typedef struct {
    Rgb radiance; /* [W m^-2 sr^-1] */
    Rgb variance; /* of that mean, from the scatter of its samples; 0 where there is but one */
} Estimate;

/* The lab's DirectLightingIntegrator::Li after the hit is known. Every surface light gets
 * nb_light_samples (>= 1) shadow rays, every other light one. */
Estimate direct_lighting(const Scene *scene, const Hit *hit, int nb_light_samples,
                         RngStream stream);

/* The mean of `count` values and the variance of that mean, from their sums. */
typedef struct {
    double sum[3], sum_of_squares[3];
    int count;
} Moments;

void moments_add(Moments *moments, Rgb value);
Estimate moments_estimate(const Moments *moments);

#endif
