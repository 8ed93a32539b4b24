/* irradiance.h for sixteen pixels at a time: the same answer, in closed form by vectors where that
 * is simple (a quad, no sphere before it, or some that do not overlap), else lane by lane.
 * tests/test_irradiance.py holds the two together. */
#ifndef PENUMBRA_IRRADIANCE_PACKET_H
#define PENUMBRA_IRRADIANCE_PACKET_H

#include "packet.h"

/* irradiance_light [sr] for each lane that hits something, 0 for the others. */
void irradiance_packet(const Scene *scene, const Light *light, const HitPacket *hits,
                       double irradiance[LANES]);

/* exact_lighting [W m^-2 sr^-1] for each lane that hits something, 0 for the others. */
void exact_lighting_packet(const Scene *scene, const HitPacket *hits, RgbPacket *radiance);

#endif
