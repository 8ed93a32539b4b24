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

inline void rng_mix(uint32_t *x, uint32_t *y, int rotation)
{
    *x += *y;
    *y = (*y << rotation | *y >> (32 - rotation)) ^ *x;
}

/* Thirteen rounds, of two mixes each, on a 128-bit counter. Inline, so that a loop over pixels can
 * work on many counters at once. */
inline RngBlock rng_threefry4x32(RngBlock counter, RngBlock key)
{
    const uint32_t k0 = key.word[0], k1 = key.word[1], k2 = key.word[2], k3 = key.word[3];
    const uint32_t k4 = UINT32_C(0x1BD11BDA) ^ k0 ^ k1 ^ k2 ^ k3;
    uint32_t a = counter.word[0] + k0, b = counter.word[1] + k1;
    uint32_t c = counter.word[2] + k2, d = counter.word[3] + k3;

    rng_mix(&a, &b, 10), rng_mix(&c, &d, 26);
    rng_mix(&a, &d, 11), rng_mix(&c, &b, 21);
    rng_mix(&a, &b, 13), rng_mix(&c, &d, 27);
    rng_mix(&a, &d, 23), rng_mix(&c, &b, 5);
    a += k1, b += k2, c += k3, d += k4 + 1;
    rng_mix(&a, &b, 6), rng_mix(&c, &d, 20);
    rng_mix(&a, &d, 17), rng_mix(&c, &b, 11);
    rng_mix(&a, &b, 25), rng_mix(&c, &d, 10);
    rng_mix(&a, &d, 18), rng_mix(&c, &b, 20);
    a += k2, b += k3, c += k4, d += k0 + 2;
    rng_mix(&a, &b, 10), rng_mix(&c, &d, 26);
    rng_mix(&a, &d, 11), rng_mix(&c, &b, 21);
    rng_mix(&a, &b, 13), rng_mix(&c, &d, 27);
    rng_mix(&a, &d, 23), rng_mix(&c, &b, 5);
    a += k3, b += k4, c += k0, d += k1 + 3;
    rng_mix(&a, &b, 6), rng_mix(&c, &d, 20);
    return (RngBlock){{a, b, c, d}};
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
