#include "place_packet.h"

static void set_lane(SphericalRectanglePacket *packet, int lane, const SphericalRectangle *r)
{
    packet->x0[lane] = r->x0, packet->x1[lane] = r->x1;
    packet->y0[lane] = r->y0, packet->y1[lane] = r->y1;
    packet->z0[lane] = r->z0;
    packet->per_x[lane] = r->per_x, packet->per_y[lane] = r->per_y;
    packet->b0[lane] = r->b0, packet->b1[lane] = r->b1;
    packet->c[lane] = r->c;
    packet->k[lane] = r->k;
    packet->solid_angle[lane] = r->solid_angle;
}

static InLanes rectangles_of_quad(SphericalRectanglePacket *rectangle, const QuadLight *quad,
                                  const HitPacket *hits, const LightPacket *light)
{
    int nb_lit = 0, nb_known = 0;
    SphericalRectangle known = {.solid_angle = 0}, found;
    for (int i = 0; i < LANES; i++) {
        if (light->scale[i] <= 0)
            continue;
        nb_lit++;
        const Vec3 point = {hits->point.x[i], hits->point.y[i], hits->point.z[i]};
        if (!spherical_rectangle_create(&found, quad, point))
            continue;
        nb_known++;
        known = found;
        set_lane(rectangle, i, &known);
    }
    if (!nb_known || nb_known < nb_lit)
        return nb_known ? RECTANGLE_IN_SOME_LANES : RECTANGLE_IN_NO_LANE;
    for (int i = 0; i < LANES; i++) {
        if (light->scale[i] <= 0)
            set_lane(rectangle, i, &known); /* any will do, with a scale of 0 */
        rectangle->scale[i] = light->scale[i] > 0 ? (real)rectangle->solid_angle[i] : 0;
    }
    return RECTANGLE_IN_ALL_LANES;
}

InLanes solid_angle_packet_create(SphericalRectanglePacket *rectangle, const Light *light,
                                  const HitPacket *hits, const LightPacket *packet)
{
    switch (light->type) {
    case LIGHT_POINT:
    case LIGHT_DISK:
        break;
    case LIGHT_QUAD:
        return rectangles_of_quad(rectangle, &light->shape.quad, hits, packet);
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        return RECTANGLE_IN_SOME_LANES;
    }
    return RECTANGLE_IN_NO_LANE;
}

void spherical_rectangle_packet_place(const SphericalRectanglePacket *rectangle, real x[LANES],
                                      real y[LANES])
{
    const SphericalRectanglePacket *restrict p = rectangle;
    SIMD for (int i = 0; i < LANES; i++)
    {
        const SphericalRectangle r = {p->x0[i], p->x1[i],          p->y0[i],    p->y1[i],
                                      p->z0[i], p->b0[i],          p->b1[i],    p->k[i],
                                      p->c[i],  p->solid_angle[i], p->per_x[i], p->per_y[i]};
        const Place place = spherical_rectangle_place(r, (Uniform2){x[i], y[i]});
        x[i] = place.s;
        y[i] = place.t;
    }
}

bool area_packet_is_square(LightType type)
{
    switch (type) {
    case LIGHT_QUAD:
        return true;
    case LIGHT_POINT:
    case LIGHT_DISK:
    case LIGHT_TRIANGLE:
    case LIGHT_SPHERE:
        break;
    }
    return false;
}

void area_packet_place(LightType type, real x[LANES], real y[LANES])
{
    switch (type) {
    case LIGHT_POINT:
    case LIGHT_SPHERE:
    case LIGHT_QUAD: /* quad_place: as they are */
        break;
    case LIGHT_DISK:
        SIMD for (int i = 0; i < LANES; i++)
        {
            const Place place = disk_place((Uniform2){x[i], y[i]});
            x[i] = place.s;
            y[i] = place.t;
        }
        break;
    case LIGHT_TRIANGLE:
        SIMD for (int i = 0; i < LANES; i++)
        {
            const Place place = triangle_place((Uniform2){x[i], y[i]});
            x[i] = place.s;
            y[i] = place.t;
        }
        break;
    }
}
