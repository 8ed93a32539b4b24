#include "shape.h"

/* |o + t d - c|^2 = r^2, with the discriminant taken from the ray's distance to the centre and
 * no difference of near-equal roots: Haines, Guenther, Akenine-Moller, "Precision improvements
 * for ray/sphere intersection", Ray Tracing Gems (2019), chapter 7. */
real sphere_hit(const Sphere *sphere, Ray ray)
{
    Vec3 to_origin = vec3_sub(ray.origin, sphere->center);
    real along = vec3_dot(to_origin, ray.direction);
    Vec3 perpendicular = vec3_sub(to_origin, vec3_scale(ray.direction, along));
    real discriminant = sphere->radius * sphere->radius - vec3_dot(perpendicular, perpendicular);
    if (discriminant < 0)
        return 0;
    real half_chord = sqrt(discriminant);
    real outside = vec3_dot(to_origin, to_origin) - sphere->radius * sphere->radius;
    /* From inside, or from the surface itself (as next to where another surface touches the
     * sphere, as far as rounding can tell): the far wall. */
    if (outside <= 0)
        return along > 0 ? -outside / (half_chord + along) : half_chord - along;
    return along < 0 ? outside / (half_chord - along) : 0;
}

real sphere_hit_from_its_surface(const Sphere *sphere, Ray ray)
{
    /* the roots are 0 and -2 (o - c) . d */
    real far_root = -2 * vec3_dot(vec3_sub(ray.origin, sphere->center), ray.direction);
    return far_root > 0 ? far_root : 0;
}

real plane_hit(const Plane *plane, Ray ray)
{
    real approach = vec3_dot(plane->normal, ray.direction);
    if (approach == 0)
        return 0;
    real distance = vec3_dot(plane->normal, vec3_sub(plane->point, ray.origin)) / approach;
    return distance > 0 ? distance : 0;
}
