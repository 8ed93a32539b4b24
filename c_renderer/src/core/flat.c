#include "flat.h"

static real clamped_share(real share)
{
    return share < 0 ? 0 : share > 1 ? 1 : share;
}

real edge_distance(Vec3 start, Vec3 edge, Vec3 point)
{
    Vec3 offset = vec3_sub(point, start);
    real share = clamped_share(vec3_dot(offset, edge) / vec3_dot(edge, edge));
    return vec3_length(vec3_sub(offset, vec3_scale(edge, share)));
}

Place flat_foot(const FlatLight *light, Vec3 point)
{
    Vec3 offset = vec3_sub(point, light->corner);
    Vec3 across_u = vec3_cross(light->normal, light->edge_u);
    Vec3 across_v = vec3_cross(light->edge_v, light->normal);
    return (Place){vec3_dot(offset, across_v) / vec3_dot(light->edge_u, across_v),
                   vec3_dot(offset, across_u) / vec3_dot(light->edge_v, across_u)};
}
