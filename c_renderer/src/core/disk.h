/* A disk light, sampled by area. */
#ifndef PENUMBRA_DISK_H
#define PENUMBRA_DISK_H

#include "flat.h"

/* It emits on the side that -normal faces, and only there. */
typedef struct {
    Vec3 center;  /* [m] */
    Vec3 normal;  /* unit */
    real radius;  /* [m] */
    real area;    /* pi radius^2 [m^2] */
    Rgb radiance; /* [W m^-2 sr^-1] */
} DiskLight;

/* The square around it. */
FlatLight disk_square(const DiskLight *light);

/* Uniform over the area, neighbours stay neighbours: Shirley and Chiu, "A low distortion map between
 * disk and square", Journal of Graphics Tools 2(3), 1997. At fewer than some 2,000 well-spread
 * points its error is half that of polar coordinates, whose slope is the steeper. Sine and cosine
 * are for angles up to pi / 4, by their series, so that many lanes can have them. */
static ALWAYS_INLINE Place disk_place(Uniform2 random)
{
    const real x = 2 * random.x - 1, y = 2 * random.y - 1;
    const int steep = x * x < y * y;
    const real r = steep ? y : x, across = steep ? x : y;
    const real angle = (real)(PI / 4) * across / (r * r > 0 ? r : 1), a = angle * angle;
    const real sine =
        angle *
        (1 + a * (-1 / (real)6 +
                  a * (1 / (real)120 + a * (-1 / (real)5040 +
                                            a * (1 / (real)362880 + a * (-1 / (real)39916800 +
                                                                         a / (real)6227020800))))));
    const real cosine =
        1 +
        a * (-1 / (real)2 +
             a * (1 / (real)24 + a * (-1 / (real)720 +
                                      a * (1 / (real)40320 + a * (-1 / (real)3628800 +
                                                                  a * (1 / (real)479001600 -
                                                                       a / (real)87178291200))))));
    const real place_x = r * (steep ? sine : cosine), place_y = r * (steep ? cosine : sine);
    return (Place){(1 + place_x) / 2, (1 + place_y) / 2};
}

/* Distance from a point to the nearest place of it [m]. */
real disk_distance(const DiskLight *light, Vec3 point);

/* The largest component of a place of it along a direction: its highest point [m]. */
real disk_highest(const DiskLight *light, Vec3 direction);

#endif
