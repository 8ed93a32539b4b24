/* One random sample of the light that arrives at a point: what every light shape answers with. */
#ifndef PENUMBRA_LIGHT_SAMPLE_H
#define PENUMBRA_LIGHT_SAMPLE_H

#include "rng.h"
#include "vec3.h"

/* The lab's LightSample. Its pdf is the density of the direction, per solid angle; a point
 * light has one direction, with pdf 1 by convention. */
typedef struct {
    Vec3 direction;       /* unit, from the surface to the light */
    real distance;        /* [m] */
    Rgb radiance;         /* emitted radiance / pdf_solid_angle: already divided, step (d) */
    real pdf_solid_angle; /* [sr^-1]; 0 where the light's dark side is seen */
} LightSample;

/* Steps (b) to (d) of the handout: the sample for a place on a light, to_light away [m], where the
 * light's normal, which points away from what it shines on, is so. The places have the density
 * pdf_area = 1 / area [m^-2]. */
LightSample light_sample_of_place(Vec3 to_light, Vec3 normal, real area, Rgb radiance);

/* The sample of a direction whose density was chosen over the solid angle [sr] that is seen. */
LightSample light_sample_of_direction(Vec3 to_light, real solid_angle, Rgb radiance);

#endif
