#include "camera.h"

Ray camera_ray(const Camera *camera, real x, real y, int width, int height)
{
    real half_height = camera->tan_half_fov_y;
    real half_width = half_height * (real)width / (real)height;
    real right = (2 * x / (real)width - 1) * half_width;
    real up = (1 - 2 * y / (real)height) * half_height;
    Vec3 direction = vec3_along(camera->forward, camera->right, right);
    direction = vec3_along(direction, camera->up, up);
    return (Ray){camera->position, vec3_normalize(direction)};
}
