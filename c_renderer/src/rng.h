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

/* Ten rounds on a 128-bit counter, keyed by the seed. Inline, so that a loop over pixels can
 * work on many counters at once. */
inline RngBlock rng_philox4x32(RngBlock counter, uint64_t seed)
{
    uint32_t c0 = counter.word[0], c1 = counter.word[1];
    uint32_t c2 = counter.word[2], c3 = counter.word[3];
    uint32_t key0 = (uint32_t)seed, key1 = (uint32_t)(seed >> 32);
    for (int round = 0; round < 10; round++) {
        uint64_t product0 = UINT64_C(0xD2511F53) * c0;
        uint64_t product1 = UINT64_C(0xCD9E8D57) * c2;
        c0 = (uint32_t)(product1 >> 32) ^ c1 ^ key0;
        c1 = (uint32_t)product1;
        c2 = (uint32_t)(product0 >> 32) ^ c3 ^ key1;
        c3 = (uint32_t)product0;
        key0 += UINT32_C(0x9E3779B9);
        key1 += UINT32_C(0xBB67AE85);
    }
    return (RngBlock){{c0, c1, c2, c3}};
}

/* The top 24 bits: all that a float holds, so that the result stays below 1, and is the same
 * number in either precision. */
static inline real rng_to_uniform(uint32_t bits)
{
    return (real)(bits >> 8) * 0x1p-24f;
}

/* The lab's randomFloat(), twice. dimension: what the numbers decide (0 = the place in the
 * pixel, 1 + k = the point on light k); sample: 0 .. nb_light_samples - 1. Samples 2k and 2k + 1
 * share a block. */
Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension);

#endif
