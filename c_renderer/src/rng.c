#include "rng.h"

RngBlock rng_philox4x32(RngBlock counter, uint64_t seed)
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
