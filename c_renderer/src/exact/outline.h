/* What one point sees of a quad light, in double precision: the light's outline, and the spheres
 * before it. Nothing is integrated yet. */
#ifndef PENUMBRA_OUTLINE_H
#define PENUMBRA_OUTLINE_H

#include "core/scene.h"
#include "vec3d.h"

/* Lengths relative to the distances that they are differences of, and angles [rad], below which
 * rounding decides: a light that lies in a plane is not behind it, a light that stands on the
 * surface's plane is not below its horizon, a sliver that thin hides or shows nothing. */
#define VIEW_TOUCH 1e-12

enum { OUTLINE_CORNERS = 32, VIEW_BALLS = 256 };

/* x along edge_u, z along the light's normal, which points away from all that it shines on. */
typedef struct {
    Vec3d x, y, z;     /* unit, in world coordinates */
    double ux, vx, vy; /* edge_u = (ux, 0, 0), edge_v = (vx, vy, 0); ux, vy > 0 [m] */
} QuadFrame;

QuadFrame quad_frame(const QuadLight *light);
Vec3d quad_frame_direction(const QuadFrame *frame, Vec3d world);

/* A convex polygon in the light's plane, counterclockwise about the light's normal. */
typedef struct {
    int nb_corners;
    Vec3d corner[OUTLINE_CORNERS]; /* from the point [m]; all have the same z > 0 */
    /* Unit normals, pointing inwards, of the planes through the point and the edge that begins at
     * each corner. Kept through clipping, since a short edge's ends do not tell its direction. */
    Vec3d side[OUTLINE_CORNERS];
} Outline;

/* The corner after corner k. */
static inline Vec3d outline_next(const Outline *outline, int k)
{
    return outline->corner[k + 1 < outline->nb_corners ? k + 1 : 0];
}

typedef enum {
    BALL_CONE,  /* hides all of the light that lies in the circular cone around it */
    BALL_CUTS,  /* reaches behind the light: hides what is in it or behind it */
    BALL_WITHIN /* the point is inside: hides all that is not */
} BallKind;

typedef struct {
    Vec3d center; /* from the point [m] */
    double radius;
    BallKind kind;
} Ball;

/* All in the light's frame, from the point. */
typedef struct {
    Vec3d normal;    /* of the surface, as long as the Hit's */
    Outline outline; /* what the horizon and the planes leave; no corners: nothing to be seen */
    int nb_balls;
    Ball ball[VIEW_BALLS]; /* those that may hide some of the outline, but not surely all */
    bool closed_form;      /* all of them are BALL_CONE */
    bool complete;         /* false: there are more planes or balls than fit; these are left out */
} LightView;

void light_view(const Scene *scene, const QuadLight *light, const Hit *hit, LightView *view);

#endif
