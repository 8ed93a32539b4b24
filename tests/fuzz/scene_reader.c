/* libFuzzer's way into the scene reader: any bytes as a scene file (`make stress-fuzz`).
 * A scene that is accepted must be whole; one that is refused, refused in one line. */
#define _GNU_SOURCE

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <jansson.h>

#include "io/scene_json.h"

/* A broken promise stops the fuzzer, which then saves the file. */
static void expect(bool promise, const char *what)
{
    if (promise)
        return;
    fprintf(stderr, "not so: %s\n", what);
    abort();
}

static void expect_finite(Vec3 v)
{
    expect(isfinite(v.x) && isfinite(v.y) && isfinite(v.z), "coordinates are finite");
}

/* To the rounding of three components and of their squares' sum: a few 2^-24. */
static void expect_unit(Vec3 v)
{
    expect(fabs((double)vec3_dot(v, v) - 1) < 1e-6, "directions are unit vectors");
}

static void expect_color(Rgb c, double most)
{
    expect(c.r >= 0 && c.g >= 0 && c.b >= 0 && c.r <= most && c.g <= most && c.b <= most,
           "colours are from 0 to their limit");
}

static void expect_area(real area)
{
    expect(area > 0 && isfinite(area), "a light has an area");
}

/* 1e30 rounded to float32 may be just above. */
static void expect_radiance(Rgb c)
{
    expect_color(c, 1.000001e30);
}

static void expect_whole_light(const Light *light)
{
    switch (light->type) {
    case LIGHT_POINT: {
        const PointLight *point = &light->shape.point;
        expect_finite(point->position);
        expect_radiance(point->radiant_intensity);
        return;
    }
    case LIGHT_QUAD: {
        const QuadLight *quad = &light->shape.quad;
        expect_finite(quad->corner);
        expect_finite(quad->edge_u);
        expect_finite(quad->edge_v);
        expect_unit(quad->normal);
        expect_area(quad->area);
        expect_radiance(quad->radiance);
        return;
    }
    case LIGHT_DISK: {
        const DiskLight *disk = &light->shape.disk;
        expect_finite(disk->center);
        expect_unit(disk->normal);
        expect(disk->radius > 0, "a disk has a radius");
        expect_area(disk->area);
        expect_radiance(disk->radiance);
        return;
    }
    case LIGHT_TRIANGLE: {
        const TriangleLight *triangle = &light->shape.triangle;
        expect_finite(triangle->corner);
        expect_finite(triangle->edge_u);
        expect_finite(triangle->edge_v);
        expect_unit(triangle->normal);
        expect_area(triangle->area);
        expect_radiance(triangle->radiance);
        return;
    }
    case LIGHT_SPHERE: {
        const SphereLight *sphere = &light->shape.sphere;
        expect_finite(sphere->center);
        expect(sphere->radius > 0, "a sphere light has a radius");
        expect_area(sphere->area);
        expect_radiance(sphere->radiance);
        return;
    }
    }
    expect(false, "a light has a shape");
}

static void expect_whole(const Scene *scene)
{
    expect(scene->width >= 1 && scene->height >= 1, "an image has pixels");
    expect(strlen(scene->hash) == 16 && *scene->name, "a scene has a name and a hash");
    expect(scene->ray_max_distance > 0, "rays have a length");
    expect(scene->camera.tan_half_fov_y > 0 && isfinite(scene->camera.tan_half_fov_y),
           "the camera sees");
    expect_finite(scene->camera.position);
    expect_unit(scene->camera.forward);
    expect_unit(scene->camera.right);
    expect_unit(scene->camera.up);
    expect_color(scene->background, 1e6);
    for (int i = 0; i < scene->nb_spheres; i++) {
        expect_finite(scene->spheres[i].center);
        expect(scene->spheres[i].radius > 0, "a sphere has a radius");
        expect_color(scene->spheres[i].brdf, 1e6);
    }
    for (int i = 0; i < scene->nb_planes; i++) {
        expect_finite(scene->planes[i].point);
        expect_unit(scene->planes[i].normal);
        expect_color(scene->planes[i].brdf, 1e6);
    }
    for (int i = 0; i < scene->nb_lights; i++)
        expect_whole_light(&scene->lights[i]);
}

size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size);
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* Every other change puts one value in the place of another: the file stays JSON, and the reader
 * goes on to the keys and limits that changes of single bytes seldom get to. */
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed)
{
    static const char *const VALUES[] = {"0",
                                         "-0.0",
                                         "1",
                                         "-1",
                                         "1e-9",
                                         "9.99e-10",
                                         "1e9",
                                         "1.1e9",
                                         "1e6",
                                         "1e30",
                                         "1e31",
                                         "1e-38",
                                         "1e-400",
                                         "1e400",
                                         "0.001",
                                         "179",
                                         "180",
                                         "16384",
                                         "16385",
                                         "1.5",
                                         "null",
                                         "true",
                                         "\"\"",
                                         "\"lit\"",
                                         "\"a\"",
                                         "\"\\u000a\"",
                                         "[0,0,0]",
                                         "[0,1,0]",
                                         "[0,1e-9,0]",
                                         "[1e9,-1e9,1e9]",
                                         "[1e6,1e6,1e6]",
                                         "[0,0]",
                                         "[]",
                                         "{}"};
    size_t start = size ? (seed >> 8) % size : 0;
    while (start < size && !strchr(":,[", data[start]))
        start++;
    size_t end = ++start;
    while (end < size && !strchr(",]}\n", data[end]))
        end++;
    const char *value = VALUES[(seed >> 1) % (sizeof VALUES / sizeof *VALUES)];
    size_t length = strlen(value);
    if (seed % 2 || end >= size || size - (end - start) + length > max_size)
        return LLVMFuzzerMutate(data, size, max_size);
    memmove(data + start + length, data + end, size - end);
    memcpy(data + start, value, length);
    return size - (end - start) + length;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static int file = -1;
    static char name[40];
    if (file < 0) {
        file = memfd_create("scene.json", 0);
        snprintf(name, sizeof name, "/proc/self/fd/%d", file);
    }
    if (ftruncate(file, 0) || pwrite(file, data, size, 0) != (ssize_t)size)
        abort();

    Scene scene;
    char message[1024] = "", *dump = NULL;
    if (scene_read(name, &scene, &dump, message, sizeof message)) {
        expect_whole(&scene);
        json_t *json = json_loads(dump, JSON_REJECT_DUPLICATES, NULL);
        expect(json != NULL, "the dump is JSON");
        json_decref(json);
        free(dump);
        scene_free(&scene);
    } else {
        expect(strncmp(message, name, strlen(name)) == 0 && strlen(message) > strlen(name) + 2,
               "a refusal names the file and a reason");
        for (const char *c = message; *c; c++)
            expect((unsigned char)*c >= ' ' && *c != 127, "a refusal is one printable line");
        json_t *text = json_string(message);
        expect(text != NULL, "a refusal is UTF-8");
        json_decref(text);
    }
    return 0;
}
