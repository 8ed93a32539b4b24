#include "rng.h"

extern inline RngBlock rng_philox4x32(RngBlock counter, uint64_t seed);

/* The top 24 bits: all that a float holds, so that the result stays below 1. */
static real to_uniform(uint32_t bits)
{
    return (real)(bits >> 8) * 0x1p-24f;
}

Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension)
{
    RngBlock counter = {{stream.pixel, sample, stream.pixel_sample, dimension}};
    RngBlock random = rng_philox4x32(counter, stream.seed);
    return (Uniform2){to_uniform(random.word[0]), to_uniform(random.word[1])};
}
