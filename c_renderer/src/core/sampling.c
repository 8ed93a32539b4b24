#include "sampling.h"

#include <stdlib.h>

/* Bits in the opposite order: the van der Corput sequence, Sobol's first dimension. */
static uint32_t reverse_bits(uint32_t x)
{
    x = (x & UINT32_C(0x55555555)) << 1 | (x >> 1 & UINT32_C(0x55555555));
    x = (x & UINT32_C(0x33333333)) << 2 | (x >> 2 & UINT32_C(0x33333333));
    x = (x & UINT32_C(0x0F0F0F0F)) << 4 | (x >> 4 & UINT32_C(0x0F0F0F0F));
    x = (x & UINT32_C(0x00FF00FF)) << 8 | (x >> 8 & UINT32_C(0x00FF00FF));
    return x << 16 | x >> 16;
}

/* Sobol's second dimension: primitive polynomial x + 1, direction numbers v_k = v_(k-1) ^
 * v_(k-1) >> 1. With the first it is a (0, 2)-sequence: every 2^k consecutive points have one in
 * each of the 2^k boxes of every elementary partition. */
static uint32_t sobol_second(uint32_t index)
{
    uint32_t result = 0;
    for (uint32_t v = UINT32_C(1) << 31; index; index >>= 1, v ^= v >> 1)
        if (index & 1)
            result ^= v;
    return result;
}

/* Owen's nested uniform scramble: every bit is flipped or not depending on all bits above it.
 * On the reversed word "above" is "below", and multiplying by even numbers and adding spread
 * upwards: Laine and Karras (2011), constants by Vegdahl, in Burley, "Practical hash-based Owen
 * scrambling", JCGT 9(4), 2020. */
static uint32_t owen_scramble(uint32_t x, uint32_t seed)
{
    x = reverse_bits(x);
    x ^= x * UINT32_C(0x3D20ADEA);
    x += seed;
    x *= (seed >> 16) | 1;
    x ^= x * UINT32_C(0x05526C56);
    x ^= x * UINT32_C(0x53A22864);
    return reverse_bits(x);
}

/* The bits of 1 + bits 2^-32 as a float, rounded down. */
static uint32_t one_to_two(uint32_t bits)
{
    return UINT32_C(0x3F800000) | bits >> 9;
}

/* The most nearly square grid of exactly `count` cells. */
static void choose_grid(int count, int *columns, int *rows)
{
    *rows = 1;
    for (int r = 1; r <= count / r; r++)
        if (count % r == 0)
            *rows = r;
    *columns = count / *rows;
}

bool point_set_create(PointSet *set, Sampler sampler, int count, uint64_t seed)
{
    *set = (PointSet){.sampler = sampler, .count = count};
    choose_grid(count, &set->columns, &set->rows);
    if (sampler != SAMPLER_SOBOL)
        return true;
    size_t bytes = (size_t)count * sizeof(uint32_t);
    set->table[0] = malloc(bytes);
    set->table[1] = malloc(bytes);
    if (!set->table[0] || !set->table[1]) {
        point_set_free(set);
        return false;
    }
    RngBlock scramble = rng_threefry4x32((RngBlock){{0, 0, 0, UINT32_MAX}}, rng_key(seed));
    for (uint32_t i = 0; i < (uint32_t)count; i++) {
        set->table[0][i] = one_to_two(owen_scramble(reverse_bits(i), scramble.word[0]));
        set->table[1][i] = one_to_two(owen_scramble(sobol_second(i), scramble.word[1]));
    }
    return true;
}

void point_set_free(PointSet *set)
{
    free(set->table[0]);
    free(set->table[1]);
    *set = (PointSet){0};
}

Uniform2 point_set_get(const PointSet *set, RngStream stream, uint32_t index, uint32_t dimension)
{
    switch (set->sampler) {
    case SAMPLER_INDEPENDENT:
        return rng_uniform2(stream, index, dimension);
    case SAMPLER_JITTERED: {
        Uniform2 u = rng_uniform2(stream, index, dimension);
        uint32_t columns = (uint32_t)set->columns;
        return (Uniform2){jitter(index % columns, u.x, set->columns),
                          jitter(index / columns, u.y, set->rows)};
    }
    case SAMPLER_SOBOL: {
        RngBlock counter = {{stream.pixel, SOBOL_SHIFT_BLOCK, stream.pixel_sample, dimension}};
        RngBlock shift = rng_threefry4x32(counter, rng_key(stream.seed));
        return (Uniform2){sobol_in_one_two(set->table[0][index], sobol_shift(shift.word[0])) - 1,
                          sobol_in_one_two(set->table[1][index], sobol_shift(shift.word[1])) - 1};
    }
    }
    return (Uniform2){0, 0};
}
