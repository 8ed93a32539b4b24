/* Sixteen pixels side by side: their rays, and the surfaces that these meet.
 *
 * The arrays are what the compiler's vectors are made of: every SIMD loop runs over the lanes.
 * Loops hold no branch and no float condition that feeds both a ?: and an integer (gcc 12 would
 * not vectorise them). */
#ifndef PENUMBRA_PACKET_H
#define PENUMBRA_PACKET_H

#include "core/scene.h"

enum { LANES = 16 };

#define SIMD _Pragma("omp simd simdlen(16)")

/* The bits that are set in some lane. */
static inline int any_lane(const int bits[LANES])
{
    int any = 0;
    _Pragma("omp simd simdlen(16) reduction(| : any)") for (int i = 0; i < LANES; i++) any |=
        bits[i];
    return any;
}

typedef struct {
    real x[LANES], y[LANES], z[LANES];
} Vec3Packet;

typedef struct {
    real r[LANES], g[LANES], b[LANES];
} RgbPacket;

/* scene_hit's answer, lane by lane. */
typedef struct {
    bool any_hit, all_hit; /* whether some, or all, lanes see an object */
    bool one_object;       /* whether all lanes see the same, or nothing */
    int object[LANES];     /* SCENE_NOTHING: nothing else is set */
    Vec3Packet point;      /* [m] */
    Vec3Packet normal;     /* unit, turned towards the ray's origin */
    RgbPacket brdf;        /* [sr^-1] */
} HitPacket;

/* An image's pixels before the camera: the direction through the position (x, y) [pixels] is
 * corner + x right + y down, at a distance of 1 along the camera's axis. */
typedef struct {
    Vec3 origin;
    Vec3 corner, right, down;
} ImagePlane;

ImagePlane image_plane(const Camera *camera, int width, int height);

/* What the rays through the positions (x[lane], y[lane]) hit. */
void packet_hit(const Scene *scene, const ImagePlane *plane, const real x[LANES],
                const real y[LANES], HitPacket *hits);

/* One lane by itself. */
Hit packet_lane(const HitPacket *hits, int lane);

#endif
