#include "rng.h"

extern inline RngBlock rng_philox4x32(RngBlock counter, uint64_t seed);

Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension)
{
    RngBlock counter = {{stream.pixel, sample / 2, stream.pixel_sample, dimension}};
    RngBlock random = rng_philox4x32(counter, stream.seed);
    const uint32_t *half = &random.word[sample % 2 * 2];
    return (Uniform2){rng_to_uniform(half[0]), rng_to_uniform(half[1])};
}
