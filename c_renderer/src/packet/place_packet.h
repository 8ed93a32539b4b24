/* The samples' places on a light for the sixteen points of a packet. */
#ifndef PENUMBRA_PLACE_PACKET_H
#define PENUMBRA_PLACE_PACKET_H

#include "core/light.h"
#include "light_packet.h"

/* SphericalRectangle, lane by lane (quad.h). */
typedef struct {
    double x0[LANES], x1[LANES], y0[LANES], y1[LANES], z0[LANES];
    double b0[LANES], b1[LANES], k[LANES], c[LANES], solid_angle[LANES];
    double per_x[LANES], per_y[LANES];
    real scale[LANES]; /* the solid angle [sr]; 0 in lanes without light */
} SphericalRectanglePacket;

typedef enum { RECTANGLE_IN_NO_LANE, RECTANGLE_IN_SOME_LANES, RECTANGLE_IN_ALL_LANES } InLanes;

/* In which of the lanes that get light light_sampler would spread the samples over the solid
 * angle; the packet is for use where it does in all, and the light is a quad. Of other lights that
 * have such samples, in some: these are left to estimator.c. */
InLanes solid_angle_packet_create(SphericalRectanglePacket *rectangle, const Light *light,
                                  const HitPacket *hits, const LightPacket *packet);

/* Turns random numbers x and y of each lane into the place corner + x edge_u + y edge_v, such that
 * directions to it are spread evenly over the solid angle. */
void spherical_rectangle_packet_place(const SphericalRectanglePacket *rectangle, real x[LANES],
                                      real y[LANES]);

/* Whether numbers that are even over the square are places that are even over the area of such a
 * flat light: then there is nothing to do. */
bool area_packet_is_square(LightType type);

/* The same, such that places are spread evenly over the area of a flat light. */
void area_packet_place(LightType type, real x[LANES], real y[LANES]);

#endif
