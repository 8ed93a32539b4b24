/* What one point sees of a light, in double precision: the light's outline above the horizon and
 * the planes, and what may hide some of it. Nothing is integrated yet. */
#ifndef PENUMBRA_OUTLINE_H
#define PENUMBRA_OUTLINE_H

#include <float.h>

#include "circle.h"
#include "core/scene.h"

/* Lengths relative to the distances that they are differences of, and angles [rad], below which
 * rounding decides: a light that lies in a plane is not behind it, a light that stands on the
 * surface's plane is not below its horizon, a sliver that thin hides or shows nothing. */
#define VIEW_TOUCH (16 * DBL_EPSILON)

enum { OUTLINE_SIDES = 32, VIEW_HIDERS = 256 };

/* A convex polygon in the light's plane, counterclockwise about the light's normal, which points
 * away from what it shines on. */
typedef struct {
    int nb_sides;
    Vec3d corner; /* one of the light's, from the point [m] */
    /* Where each side begins, from that corner [m]: two places near to each other are then as far
     * apart as they should be, however far away they are. */
    Vec3d place[OUTLINE_SIDES];
    /* Unit normals, pointing inwards, of the planes through the point and each side. Kept through
     * clipping, since a short side's ends do not tell its direction. */
    Vec3d pole[OUTLINE_SIDES];
} Polygon;

/* The place after place k. */
static inline Vec3d polygon_next(const Polygon *polygon, int k)
{
    return polygon->place[k + 1 < polygon->nb_sides ? k + 1 : 0];
}

/* A piece of the light's outline. */
typedef struct {
    Circle circle;
    double low, high; /* of its angle [rad] */
} Bound;

/* What may hide some of the light: a ball, or a plane or ball that cuts the light itself. */
typedef struct {
    /* A ball's cone hides what is in it, */
    bool has_silhouette;
    Circle silhouette;
    /* and, if the light is cut, only places of the light in this half-space; */
    HalfSpace behind;
    bool cuts;
    /* places inside the ring are hidden besides; outside of it, if the point is in the ball. */
    bool shows_inside;
    Circle ring;
    HalfSpace cut_off; /* the same, of a sphere light, as a half-space */
    /* Silhouette and ring are seen before the light only in these half-spaces: of directions, of
     * places. */
    HalfSpace silhouette_front, ring_front;
} Hider;

/* All from the point. */
typedef struct {
    Vec3d normal; /* of the surface, as long as the Hit's */
    Vec3d middle; /* a direction amid the light; unit */
    bool is_flat;
    Vec3d axis;      /* of a flat light: its normal, unit; */
    double height;   /* how far its plane is away [m] */
    Vec3d center;    /* of a sphere light */
    double radius;   /* [m] */
    double power;    /* ball_power of it */
    bool is_lit;     /* false: nothing is to be seen, and what follows is not set */
    bool is_polygon; /* the outline is the polygon; else the bounds, which cross each other */
    Polygon polygon;
    int nb_bounds;
    Bound bound[OUTLINE_SIDES];
    int nb_hiders;
    Hider hider[VIEW_HIDERS];
    bool complete; /* false: there are more planes or balls than fit; these are left out */
} LightView;

/* Of a surface light. */
void light_view(const Scene *scene, const Light *light, const Hit *hit, LightView *view);

/* The angle that side k subtends [rad]. */
double polygon_angle(const Polygon *polygon, int k);

/* Of side k: see Circle. */
double polygon_doubt(const Polygon *polygon, int k);

/* What of a circle is not seen as a bound of the light: outside of another bound, or hidden. `hider`
 * is that whose silhouette or ring it is, or NULL. */
void light_view_gone(const LightView *view, const Circle *circle, const Hider *hider,
                     Intervals *gone);

/* What of a circle is outside of the light's other bounds. */
void light_view_outside(const LightView *view, const Circle *circle, Intervals *gone);

#endif
