/* A flat light and what may stand before it, as the sixteen points of a packet see it. */
#ifndef PENUMBRA_LIGHT_PACKET_H
#define PENUMBRA_LIGHT_PACKET_H

#include <stdbool.h>

#include "packet.h"

/* Spheres that the sample loop tests; a packet with more goes to estimator.c. */
enum { MAX_OCCLUDERS = 4 };

/* A flat light, that is its parallelogram (flat.h), as sixteen points see it.
 *
 * In the light's frame (e1 along u, e2, normal) the sample (s, t) lies from the point at
 *     w = (wx, wy, h),   wx = cx + s ux + t vx,   wy = cy + t vy,
 * with one height h for all samples. With w not normalised, eq. 5 of docs/estimator.md is
 *     f_r L_e A h (n . w) / |w|^4
 * and needs no square root. A sphere about C (from the point) with radius r hides the direction
 * w if w . C' > 0 and (w . C')^2 > |w|^2, where C' = C / sqrt(|C|^2 - r^2): eq. 6.
 *
 * All this is homogeneous of degree 0 in lengths. Each lane's unit of length is the distance to
 * the light's far end, so that |w|^2 is at most about 3 and its powers stay far from overflow. */
typedef struct {
    real ux[LANES], vx[LANES], vy[LANES];
    real cx[LANES], cy[LANES], h_squared[LANES];
    real nx[LANES], ny[LANES], nh[LANES]; /* n . w = nx wx + ny wy + nh */
    int nb_occluders;
    real sphere_x[MAX_OCCLUDERS][LANES], sphere_y[MAX_OCCLUDERS][LANES];
    real sphere_h[MAX_OCCLUDERS][LANES]; /* w . C', likewise */
    real scale[LANES];                   /* A h; 0 in lanes without light */
    bool crosses_horizon;                /* in some lane n . w changes sign: clamp it */
} LightPacket;

typedef enum {
    SEEN_NOT,     /* no lane gets any light, surely */
    SEEN_SAMPLED, /* the sample loop's case */
    SEEN_STRANGE  /* a case that the sample loop does not know: estimator.c does */
} Seen;

/* Looks at the light as a whole, before any sample: leaves out what cannot hide any of it. */
Seen light_packet_see(const Scene *scene, const FlatLight *flat, const HitPacket *hits,
                      LightPacket *light);

#endif
