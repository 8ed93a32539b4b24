/* The estimator for sixteen pixels at a time: the same mathematics as estimator.c, arranged so
 * that vectors hold pixels. tests/test_estimator_packet.py holds the two together. */
#ifndef PENUMBRA_ESTIMATOR_PACKET_H
#define PENUMBRA_ESTIMATOR_PACKET_H

#include <stdbool.h>

#include "core/estimator.h"
#include "light_packet.h"
#include "place_packet.h"

typedef struct {
    RgbPacket radiance; /* [W m^-2 sr^-1] */
    RgbPacket variance; /* of that mean, from the scatter of its samples */
} EstimatePacket;

/* Packets that packet_direct_lighting takes at once, stage by stage: while one of them waits for
 * a square root or a division, the processor goes on with the next. */
enum { MAX_PACKETS = 8 };

/* direct_lighting for each lane of each packet that hits something, 0 for the others. Lane i of
 * packet p belongs to pixel first.pixel + p LANES + i. The variance holds for
 * SAMPLER_INDEPENDENT alone, and is 0 else. */
void packet_direct_lighting(const Scene *scene, const HitPacket *hits, int nb_packets,
                            const PointSet *points, Spread spread, RngStream first,
                            EstimatePacket *result);

/* The limit of infinitely many samples, and variance 0. */
void packet_exact_lighting(const Scene *scene, const HitPacket *hits, EstimatePacket *result);

/* The pieces. Sums of (n . w) / |w|^4 and of their squares over the visible samples of one flat light,
 * added to sum and sum_of_squares; times light->scale they are light samples with f_r L_e = 1.
 * With a rectangle the samples are spread over its solid angle, summed is (n . w) / |w|, and the
 * scale is rectangle->scale. */
void packet_sum(const LightPacket *light, LightType type, const SphericalRectanglePacket *rectangle,
                const PointSet *points, RngStream first, uint32_t dimension, double sum[LANES],
                double sum_of_squares[LANES]);

/* Adds f_r L_e times a light's mean [sr], and likewise its variance, if there is one. */
void packet_add(Rgb radiance, const HitPacket *hits, const real mean[LANES],
                const real variance[LANES], EstimatePacket *result);

/* One light by estimator.c, lane by lane, added to result: what SEEN_STRANGE needs. */
void packet_textbook(const Scene *scene, int light, const HitPacket *hits, const PointSet *points,
                     Spread spread, RngStream first, EstimatePacket *result);

#endif
