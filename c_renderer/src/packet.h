/* Sixteen pixels side by side: their rays, and the surfaces that these meet.
 *
 * The arrays are what the compiler's vectors are made of: every SIMD loop runs over the lanes.
 * Loops hold no branch and no float condition that feeds both a ?: and an integer (gcc 12 would
 * not vectorise them). */
#ifndef PENUMBRA_PACKET_H
#define PENUMBRA_PACKET_H

#include "scene.h"

enum { LANES = 16 };

#define SIMD _Pragma("omp simd simdlen(16)")

typedef struct {
    real x[LANES], y[LANES], z[LANES];
} Vec3Packet;

typedef struct {
    real r[LANES], g[LANES], b[LANES];
} RgbPacket;

/* scene_hit's answer, lane by lane. */
typedef struct {
    int nb_hits;       /* lanes with an object */
    int object[LANES]; /* SCENE_NOTHING: nothing else is set */
    Vec3Packet point;  /* [m] */
    Vec3Packet normal; /* unit, turned towards the ray's origin */
    RgbPacket brdf;    /* [sr^-1] */
} HitPacket;

/* Rays through the image positions (x[lane], y[lane]) [pixels] and what they hit. */
void packet_hit(const Scene *scene, const real x[LANES], const real y[LANES], int width, int height,
                HitPacket *hits);

/* One lane by itself. */
Hit packet_lane(const HitPacket *hits, int lane);

#endif
