/* What sixteen points see of a quad light, in double precision: outline.h for packets, as far as
 * vectors can tell it. */
#ifndef PENUMBRA_OUTLINE_PACKET_H
#define PENUMBRA_OUTLINE_PACKET_H

#include <stdint.h>
#include <string.h>

#include "exact/outline.h"
#include "packet.h"

/* No vector lies across two cache lines: a request that the compiler is right without. */
#if defined(__GNUC__)
#define ALIGNED __attribute__((aligned(64)))
#else
#define ALIGNED
#endif

enum { MAX_CAPS = 4 }; /* spheres before one light; with more, lane by lane */

/* Conditions are kept as 1.0 and 0.0, so that all lanes are of one width. What is divided is
 * chosen before the division: gcc would not vectorise a division that may not be needed. */
typedef double Lanes[LANES] ALIGNED;

/* Whether a condition holds in some lane: by the bits of 1.0, since a sum of doubles would be taken
 * one after the other. */
static inline bool any(const Lanes condition)
{
    uint64_t bits[LANES], all = 0;
    memcpy(bits, condition, sizeof bits);
    _Pragma("omp simd reduction(| : all)") for (int i = 0; i < LANES; i++) all |= bits[i];
    return all;
}

/* x along edge_u, z along the light's normal, which points away from all that it shines on. */
typedef struct {
    Vec3d x, y, z;     /* unit, in world coordinates */
    double ux, vx, vy; /* edge_u = (ux, 0, 0), edge_v = (vx, vy, 0); ux, vy > 0 [m] */
} QuadFrame;

/* The light as sixteen points see it, in its own frame. */
typedef struct {
    QuadFrame frame;
    Lanes x, y, h;    /* the corner, from the point */
    Lanes nx, ny, nz; /* the surface's normal */
    Lanes lit;        /* may see some of it */
    Lanes cut;        /* ... but not what is below the horizon */
    Lanes hard;       /* left to irradiance.c */
    bool is_near;     /* in some lane an edge may subtend more than atan(1/2) */
} ViewPacket;

/* A sphere before the light. It hides the directions w with f(w) = (C.w)^2 - t^2 |w|^2 > 0 and
 * C.w > 0, where t^2 = |C|^2 - r^2. */
typedef struct {
    double radius_squared;
    Lanes x, y, z;         /* C */
    Lanes tangent_squared; /* t^2 */
    Lanes corner[4];       /* f at the light's corners */
    Lanes amid;            /* whether C points into the light */
    Lanes own;             /* the point is on this sphere */
    Lanes here;            /* lanes in which it may hide some of the light, but not all */
} CapPacket;

/* The spheres that hide some of the light, and how many they are; they do not overlap, except in
 * lanes that are hard. */
int light_view_packet(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                      ViewPacket *view, CapPacket caps[MAX_CAPS]);

#endif
