/* Direct lighting, estimated with shadow rays: the page to read first. */
#ifndef PENUMBRA_ESTIMATOR_H
#define PENUMBRA_ESTIMATOR_H

#include "sampling.h"
#include "scene.h"

/* An estimate and how far it may be off. */
typedef struct {
    Rgb radiance; /* [W m^-2 sr^-1] */
    Rgb variance; /* of that mean, from the scatter of its samples; 0 where there is but one */
} Estimate;

/* What one shadow ray brings: f_r (L_e / p) cos V. */
Rgb shadow_ray_radiance(const Scene *scene, const Hit *hit, LightSample sample);

/* The lab's DirectLightingIntegrator::Li after the hit is known: the sum over all lights. */
Estimate direct_lighting(const Scene *scene, const Hit *hit, const PointSet *points, Spread spread,
                         RngStream stream);

/* One light's part: the mean over points->count shadow rays, or one ray to a point light. */
Estimate light_estimate(const Scene *scene, int light, const Hit *hit, const PointSet *points,
                        Spread spread, RngStream stream);

/* The mean of `count` values and the variance of that mean, from their sums. */
typedef struct {
    double sum[3], sum_of_squares[3];
    int count;
} Moments;

void moments_add(Moments *moments, Rgb value);
Estimate moments_estimate(const Moments *moments);

#endif
