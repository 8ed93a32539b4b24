/* As many shadow rays as a stated error takes, pixel by pixel. */
#ifndef PENUMBRA_ADAPTIVE_H
#define PENUMBRA_ADAPTIVE_H

#include "estimator_packet.h"

typedef struct {
    double relative_error; /* of a pixel, (R + G + B) / 3, that 95% of the pixels shall keep */
    int max_light_samples; /* no pixel takes more for a light */
} Target;

typedef struct {
    int light_samples[LANES]; /* taken for each light, pilot included */
    int reached[LANES];       /* 0 where the stated error stayed above the target */
} AdaptivePacket;

/* packet_direct_lighting with independent points, their number chosen for the packet by a pilot of
 * ADAPTIVE_PILOT samples that is then thrown away: the number does not depend on the samples that
 * are averaged, so the mean stays unbiased (Kirk and Arvo, "Unbiased sampling techniques for image
 * synthesis", SIGGRAPH 1991). result->variance is the stated one, error^2 / 2^2. */
enum { ADAPTIVE_PILOT = 64 };
void adaptive_direct_lighting(const Scene *scene, const HitPacket *hits, const Target *target,
                              RngStream first, EstimatePacket *result, AdaptivePacket *spent);

#endif
