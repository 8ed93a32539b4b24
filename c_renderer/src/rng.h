/* Counter-based random numbers: a pure function of what they are drawn for.
 *
 * No state and no order: the same seed gives the same image on any number of threads, and
 * other seeds, pixels, samples or dimensions give numbers independent of these.
 * Threefry4x32-13: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3",
 * SC 2011; with 12 rounds or more it passes TestU01's BigCrush.
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

/* The seed as Threefry's key. */
static inline RngBlock rng_key(uint64_t seed)
{
    return (RngBlock){{(uint32_t)seed, (uint32_t)(seed >> 32), 0, 0}};
}

/* Thirteen rounds of adding, rotating and xor on a 128-bit counter. Inline, so that a loop over
 * pixels can work on many counters at once. */
inline RngBlock rng_threefry4x32(RngBlock counter, RngBlock key)
{
    static const int ROTATION[8][2] = {{10, 26}, {11, 21}, {13, 27}, {23, 5},
                                       {6, 20},  {17, 11}, {25, 10}, {18, 20}};
    const uint32_t k[5] = {key.word[0], key.word[1], key.word[2], key.word[3],
                           UINT32_C(0x1BD11BDA) ^ key.word[0] ^ key.word[1] ^ key.word[2] ^
                               key.word[3]};
    uint32_t x0 = counter.word[0] + k[0], x1 = counter.word[1] + k[1];
    uint32_t x2 = counter.word[2] + k[2], x3 = counter.word[3] + k[3];
    for (uint32_t round = 0; round < 13; round++) {
        if (round && round % 4 == 0) {
            const uint32_t s = round / 4;
            x0 += k[s % 5];
            x1 += k[(s + 1) % 5];
            x2 += k[(s + 2) % 5];
            x3 += k[(s + 3) % 5] + s;
        }
        const int left = ROTATION[round % 8][0], right = ROTATION[round % 8][1];
        uint32_t y1 = round % 2 ? x3 : x1, y3 = round % 2 ? x1 : x3;
        x0 += y1;
        x2 += y3;
        y1 = (y1 << left | y1 >> (32 - left)) ^ x0;
        y3 = (y3 << right | y3 >> (32 - right)) ^ x2;
        x1 = round % 2 ? y3 : y1;
        x3 = round % 2 ? y1 : y3;
    }
    return (RngBlock){{x0, x1, x2, x3}};
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
