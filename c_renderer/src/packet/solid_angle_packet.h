/* spherical_rectangle.h for the sixteen points of a packet. */
#ifndef PENUMBRA_SOLID_ANGLE_PACKET_H
#define PENUMBRA_SOLID_ANGLE_PACKET_H

#include "light_packet.h"

typedef struct {
    double x0[LANES], x1[LANES], y0[LANES], y1[LANES], z0[LANES];
    double b0[LANES], b1[LANES], k[LANES], solid_angle[LANES];
    double c[LANES];                                    /* 1 - b0^2 */
    double inverse_width[LANES], inverse_height[LANES]; /* 1 / (x1 - x0), 1 / (y1 - y0) */
    real scale[LANES]; /* the solid angle [sr]; 0 in lanes without light */
} SphericalRectanglePacket;

typedef enum { RECTANGLE_IN_NO_LANE, RECTANGLE_IN_SOME_LANES, RECTANGLE_IN_ALL_LANES } InLanes;

/* In which of the lanes that get light spherical_rectangle_create knows the quad; the packet is
 * for use where it does in all. */
InLanes spherical_rectangle_packet_create(SphericalRectanglePacket *rectangle,
                                          const QuadLight *quad, const HitPacket *hits,
                                          const LightPacket *light);

/* Turns random numbers x and y of each lane into the place corner + x edge_u + y edge_v, such that
 * directions to it are spread evenly over the solid angle. */
void spherical_rectangle_packet_place(const SphericalRectanglePacket *rectangle, real x[LANES],
                                      real y[LANES]);

#endif
