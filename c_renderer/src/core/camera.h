/* The pinhole camera: image positions to rays. */
#ifndef PENUMBRA_CAMERA_H
#define PENUMBRA_CAMERA_H

#include "shape.h"

/* right = up x forward (the lab's left-handed picture); the three are orthonormal. */
typedef struct {
    Vec3 position; /* [m] */
    Vec3 forward, right, up;
    real tan_half_fov_y;
} Camera;

/* The ray through (x, y) [pixels from the top left corner; a pixel's centre is at + 0.5]. */
Ray camera_ray(const Camera *camera, real x, real y, int width, int height);

#endif
