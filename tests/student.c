/* A student's renderer: spheres and planes under quads, by their areas. Its mistakes are macros:
 *
 *   gcc -O2 -fopenmp -DWEIGHT='cs / (d * d)' -o mine student.c -ljansson -lm
 *   ./mine SCENE.json LIGHT_SAMPLES SEED OUT.pfm
 */
#include <jansson.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef WEIGHT
#define WEIGHT (cs * cl / (d * d))
#endif
#ifndef DRAWN
#define DRAWN n
#endif
#ifndef SHARE
#define SHARE (1.0 / DRAWN)
#endif
#ifndef AREA
#define AREA norm
#endif
#ifndef PLACE
#define PLACE s = uniform(&state), t = uniform(&state)
#endif
#ifndef SEEN
#define SEEN visible(at, to, d)
#endif
#ifndef ADD
#define ADD +=
#endif

typedef struct {
    double x, y, z;
} V;
static V v(double x, double y, double z)
{
    return (V){x, y, z};
}
static V add(V a, V b)
{
    return v(a.x + b.x, a.y + b.y, a.z + b.z);
}
static V sub(V a, V b)
{
    return v(a.x - b.x, a.y - b.y, a.z - b.z);
}
static V mul(double k, V a)
{
    return v(k * a.x, k * a.y, k * a.z);
}
static double dot(V a, V b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static V cross(V a, V b)
{
    return v(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static V unit(V a)
{
    return mul(1 / sqrt(dot(a, a)), a);
}

typedef struct {
    int is_plane;
    V place, normal, colour;
    double radius;
} Thing;
typedef struct {
    V corner, u, w, radiance;
} Light;
static Thing things[64];
static Light lights[16];
static int nb_things, nb_lights;

static uint64_t next(uint64_t *state) /* splitmix64 */
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}
static double uniform(uint64_t *state)
{
    return (double)(next(state) >> 11) * 0x1p-53;
}

static double meets(const Thing *thing, V from, V way)
{
    if (thing->is_plane) {
        double slope = dot(way, thing->normal);
        double t = dot(sub(thing->place, from), thing->normal) / slope;
        return slope != 0 && t > 1e-6 ? t : INFINITY;
    }
    V away = sub(from, thing->place);
    double b = dot(way, away), c = dot(away, away) - thing->radius * thing->radius;
    double root = b * b - c;
    if (root < 0)
        return INFINITY;
    root = sqrt(root);
    return -b - root > 1e-6 ? -b - root : -b + root > 1e-6 ? -b + root : INFINITY;
}

static int visible(V at, V way, double far)
{
    for (int i = 0; i < nb_things; i++)
        if (meets(&things[i], at, way) < far)
            return 0;
    return 1;
}

static V shade(const Thing *thing, V point, V normal, int n, uint64_t state)
{
    V total = v(0, 0, 0);
    V at = add(point, mul(1e-3, normal));
    for (int l = 0; l < nb_lights; l++) {
        const Light *light = &lights[l];
        V across = cross(light->u, light->w);
        double norm = sqrt(dot(across, across)), sum = 0, s, t;
        for (int i = 0; i < DRAWN; i++) {
            PLACE;
            V to = sub(add(light->corner, add(mul(s, light->u), mul(t, light->w))), point);
            double d = sqrt(dot(to, to));
            to = mul(1 / d, to);
            double cs = fmax(dot(normal, to), 0), cl = fmax(dot(across, to) / norm, 0);
            if (cs > 0 && cl > 0 && SEEN)
                sum += WEIGHT * AREA;
        }
        sum *= SHARE;
        total.x ADD sum * light->radiance.x;
        total.y ADD sum * light->radiance.y;
        total.z ADD sum * light->radiance.z;
    }
    return v(total.x * thing->colour.x, total.y * thing->colour.y, total.z * thing->colour.z);
}

static V vector(json_t *object, const char *key)
{
    json_t *list = json_object_get(object, key);
    return v(json_number_value(json_array_get(list, 0)), json_number_value(json_array_get(list, 1)),
             json_number_value(json_array_get(list, 2)));
}
static double number(json_t *object, const char *key)
{
    return json_number_value(json_object_get(object, key));
}

int main(int count, char **arguments)
{
    json_t *scene = count == 5 ? json_load_file(arguments[1], 0, NULL) : NULL;
    FILE *out = count == 5 ? fopen(arguments[4], "wb") : NULL;
    if (!scene || !out)
        return 1;
    int n = atoi(arguments[2]), seed = atoi(arguments[3]);
    size_t i;
    json_t *one;
    json_array_foreach(json_object_get(scene, "spheres"), i, one) things[nb_things++] =
        (Thing){0, vector(one, "center"), v(0, 0, 0), vector(one, "color"), number(one, "radius")};
    json_array_foreach(json_object_get(scene, "planes"), i, one) things[nb_things++] =
        (Thing){1, vector(one, "point"), unit(vector(one, "normal")), vector(one, "color"), 0};
    json_array_foreach(json_object_get(scene, "quad_lights"), i, one) lights[nb_lights++] =
        (Light){vector(one, "position"), vector(one, "u"), vector(one, "v"),
                mul(number(one, "power"), vector(one, "color"))};
    json_t *camera = json_object_get(scene, "camera"), *image = json_object_get(scene, "image");
    int width = (int)number(image, "width"), height = (int)number(image, "height");
    V eye = vector(camera, "position"), forward = unit(sub(vector(camera, "look_at"), eye));
    V right = unit(cross(vector(camera, "up"), forward)), up = cross(forward, right);
    double half = tan(number(camera, "fov_y_deg") * M_PI / 360),
           cut = number(scene, "ray_max_distance");
    V background = vector(scene, "background");
    float *pixels = malloc(sizeof(float[3]) * (size_t)width * (size_t)height);
#pragma omp parallel for schedule(dynamic)
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            V way = add(mul((2 * (x + 0.5) / width - 1) * half * width / height, right),
                        mul((1 - 2 * (y + 0.5) / height) * half, up));
            way = unit(add(forward, way));
            double nearest = cut;
            const Thing *hit = NULL;
            for (int k = 0; k < nb_things; k++) {
                double t = meets(&things[k], eye, way);
                if (t < nearest)
                    nearest = t, hit = &things[k];
            }
            V colour = background;
            if (hit) {
                V point = add(eye, mul(nearest, way));
                V normal = hit->is_plane ? hit->normal : unit(sub(point, hit->place));
                if (dot(normal, way) > 0)
                    normal = mul(-1, normal);
                uint64_t state = ((uint64_t)seed << 40) ^ (uint64_t)(y * width + x);
                next(&state);
                colour = shade(hit, point, normal, n, state * 0x2545f4914f6cdd1du);
            }
            float *pixel = pixels + 3 * ((size_t)(height - 1 - y) * (size_t)width + (size_t)x);
            pixel[0] = (float)colour.x, pixel[1] = (float)colour.y, pixel[2] = (float)colour.z;
        }
    fprintf(out, "PF\n%d %d\n-1.0\n", width, height);
    fwrite(pixels, sizeof(float[3]), (size_t)width * (size_t)height, out);
    return fclose(out);
}
