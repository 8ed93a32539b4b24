/* The estimator for sixteen pixels at a time: the same mathematics as estimator.c, arranged so
 * that vectors hold pixels. tests/test_kernel.py holds the two together. */
#ifndef PENUMBRA_KERNEL_H
#define PENUMBRA_KERNEL_H

#include "packet.h"
#include "sampling.h"

typedef struct {
    RgbPacket radiance; /* [W m^-2 sr^-1] */
    RgbPacket variance; /* of that mean, from the scatter of its samples */
} EstimatePacket;

/* direct_lighting for each lane that hits something, 0 for the others. Lane i belongs to pixel
 * first.pixel + i. The variance holds for SAMPLER_INDEPENDENT alone, and is 0 else. */
void kernel_direct_lighting(const Scene *scene, const HitPacket *hits, const PointSet *points,
                            RngStream first, EstimatePacket *result);

#endif
