/* Point sets in the unit square: where on a light the shadow rays go. */
#ifndef PENUMBRA_SAMPLING_H
#define PENUMBRA_SAMPLING_H

#include <stdbool.h>

#include "rng.h"

typedef enum {
    SAMPLER_INDEPENDENT, /* the lab's: every point on its own */
    SAMPLER_JITTERED,    /* one random point in each cell of a grid */
    SAMPLER_SOBOL        /* Sobol' points, Owen-scrambled, shifted digitally for every pixel */
} Sampler;

/* The points of every pixel and light of one image. */
typedef struct {
    Sampler sampler;
    int count;          /* points for each light and pixel sample, >= 1 */
    int columns, rows;  /* SAMPLER_JITTERED: the grid, columns * rows == count */
    uint32_t *table[2]; /* SAMPLER_SOBOL: coordinates + 1 as float bits, before the shift */
} PointSet;

/* False: out of memory. Otherwise the caller owes a point_set_free. */
bool point_set_create(PointSet *set, Sampler sampler, int count, uint64_t seed);
void point_set_free(PointSet *set);

/* Point 0 <= index < count of a stream and dimension (rng.h), in [0, 1) x [0, 1). One of them at
 * random is uniform, so the mean over all is unbiased; the later samplers spread more evenly. */
Uniform2 point_set_get(const PointSet *set, RngStream stream, uint32_t index, uint32_t dimension);

/* What is done for many pixels at a time (estimator_packet.c) is built from the same pieces. */

/* SAMPLER_SOBOL: words 0 and 1 of this block of a stream and dimension are its digital shift. */
#define SOBOL_SHIFT_BLOCK UINT32_MAX

/* SAMPLER_SOBOL: a coordinate is kept as a float in [1, 2), whose mantissa is its top 23 bits,
 * so that the digital shift is one xor. */
static inline uint32_t sobol_shift(uint32_t bits)
{
    return bits >> 9;
}

static inline float sobol_in_one_two(uint32_t entry, uint32_t shift)
{
    union {
        uint32_t bits;
        float value;
    } number = {entry ^ shift};
    return number.value;
}

/* SAMPLER_JITTERED: column (or row) `cell` of `cells`, at the place u in it. A float in either
 * precision, as the other samplers' points are: both builds draw the same points. */
static inline real jitter(uint32_t cell, real u, int cells)
{
    float x = ((float)cell + (float)u) / (float)cells;
    const float below_one = 0x0.ffffffp0f; /* the sum may round up to the next cell */
    return x < below_one ? x : below_one;
}

#endif
