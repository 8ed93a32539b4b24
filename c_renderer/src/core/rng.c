#include "rng.h"

extern inline void rng_mix(uint32_t *x, uint32_t *y, int rotation);
extern inline RngBlock rng_threefry4x32(RngBlock counter, RngBlock key);

Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension)
{
    RngBlock counter = {{stream.pixel, sample / 2, stream.pixel_sample, dimension}};
    RngBlock random = rng_threefry4x32(counter, rng_key(stream.seed));
    const uint32_t *half = &random.word[sample % 2 * 2];
    return (Uniform2){rng_to_uniform(half[0]), rng_to_uniform(half[1])};
}
