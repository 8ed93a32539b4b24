/* The estimator for 16 pixels side by side: the same mathematics as estimator.c, arranged so that
 * the compiler's vectors hold pixels. tests/test_kernel.py holds the two together. */
#ifndef PENUMBRA_KERNEL_H
#define PENUMBRA_KERNEL_H

#include "estimator.h"
#include "sampling.h"

enum { LANES = 16 };

typedef struct {
    real x[LANES], y[LANES], z[LANES];
} Vec3Block;

/* The nearest surfaces along 16 rays: scene_hit, lane by lane. */
typedef struct {
    int object[LANES]; /* SCENE_NOTHING: nothing else is set */
    Vec3Block point;   /* [m] */
    Vec3Block normal;  /* unit, turned towards the ray's origin */
    Vec3Block brdf;    /* r, g, b in x, y, z [sr^-1] */
} HitBlock;

HitBlock kernel_hit(const Scene *scene, Vec3 origin, const Vec3Block *directions);

/* direct_lighting for each lane, with stream[lane]; nothing for lanes without a hit. */
void kernel_direct_lighting(const Scene *scene, const HitBlock *hits, const PointSet *points,
                            const RngStream stream[LANES], Estimate result[LANES]);

#endif
