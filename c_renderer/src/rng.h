/* Counter-based random numbers: a pure function of what they are drawn for.
 *
 * No state and no order: the same seed gives the same image on any number of threads, and
 * other seeds, pixels, samples or dimensions give numbers independent of these.
 * Philox4x32-10: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3",
 * SC 2011; it passes TestU01's BigCrush.
 */
#ifndef PENUMBRA_RNG_H
#define PENUMBRA_RNG_H

#include <stdint.h>

#include "vec3.h"

/* Two uniform numbers in [0, 1). */
typedef struct {
    real x, y;
} Uniform2;

/* Everything drawn for one sample of one pixel. */
typedef struct {
    uint64_t seed;
    uint32_t pixel;        /* y * width + x */
    uint32_t pixel_sample; /* 0 .. samples_per_pixel - 1 */
} RngStream;

typedef struct {
    uint32_t word[4];
} RngBlock;

/* Ten rounds on a 128-bit counter, keyed by the seed. */
RngBlock rng_philox4x32(RngBlock counter, uint64_t seed);

/* The lab's randomFloat(), twice. dimension: what the numbers decide (0 = the place in the
 * pixel, 1 + k = the point on light k); sample: 0 .. nb_light_samples - 1. */
Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension);

#endif
