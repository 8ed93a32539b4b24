"""The C core's functions, called one by one through build/lib/libpenumbra.so (cffi, ABI mode), or
through libpenumbra-float64.so."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from tests.conftest import built

DECLARATIONS = """
typedef struct { real x, y, z; } Vec3;
typedef struct { real r, g, b; } Rgb;

typedef struct { real x, y; } Uniform2;
typedef struct { uint64_t seed; uint32_t pixel; uint32_t pixel_sample; } RngStream;
typedef struct { uint32_t word[4]; } RngBlock;
RngBlock rng_threefry4x32(RngBlock counter, RngBlock key);
Uniform2 rng_uniform2(RngStream stream, uint32_t sample, uint32_t dimension);

typedef enum { SAMPLER_INDEPENDENT, SAMPLER_JITTERED, SAMPLER_SOBOL } Sampler;
typedef struct {
    Sampler sampler; int count; int columns, rows; uint32_t *table[2];
} PointSet;
bool point_set_create(PointSet *set, Sampler sampler, int count, uint64_t seed);
void point_set_free(PointSet *set);
Uniform2 point_set_get(const PointSet *set, RngStream stream, uint32_t index, uint32_t dimension);

typedef enum { LIGHT_POINT, LIGHT_QUAD } LightType;
typedef struct { Vec3 position; Rgb radiant_intensity; } PointLight;
typedef struct {
    Vec3 corner; Vec3 edge_u, edge_v; Vec3 normal; real area; Rgb radiance;
} QuadLight;
typedef struct { LightType type; union { PointLight point; QuadLight quad; } shape; } Light;
typedef struct {
    Vec3 direction; real distance; Rgb radiance; real pdf_solid_angle;
} LightSample;
LightSample light_sample(const Light *light, Vec3 point, Uniform2 random);

typedef struct {
    Vec3 x, y, z; double x0, x1, y0, y1, z0; double b0, b1, k; double solid_angle;
} SphericalRectangle;
bool spherical_rectangle_create(SphericalRectangle *rectangle, const QuadLight *light, Vec3 point);
LightSample spherical_rectangle_light_sample(
    const SphericalRectangle *rectangle, const QuadLight *light, Uniform2 random);

typedef struct { Vec3 origin; Vec3 direction; } Ray;
typedef struct { Vec3 center; real radius; Rgb brdf; } Sphere;
typedef struct { Vec3 point; Vec3 normal; Rgb brdf; } Plane;
real sphere_hit(const Sphere *sphere, Ray ray);
real plane_hit(const Plane *plane, Ray ray);
real sphere_hit_from_its_surface(const Sphere *sphere, Ray ray);

typedef struct { Rgb radiance; Rgb variance; } Estimate;
typedef enum { SPREAD_AREA, SPREAD_SOLID_ANGLE } Spread;
typedef struct { double sum[3], sum_of_squares[3]; int count; } Moments;
void moments_add(Moments *moments, Rgb value);
Estimate moments_estimate(const Moments *moments);

typedef struct { Vec3 position; Vec3 forward, right, up; real tan_half_fov_y; } Camera;
typedef struct {
    char name[41]; char hash[17]; int width, height; Camera camera; Rgb background;
    real ray_max_distance; int nb_spheres, nb_planes, nb_lights;
    Sphere *spheres; Plane *planes; Light *lights;
} Scene;
typedef struct { int object; Vec3 point; Vec3 normal; Rgb brdf; } Hit;
Estimate direct_lighting(const Scene *scene, const Hit *hit, const PointSet *points, Spread spread,
                         RngStream stream);
double trust_distance(const QuadLight *light, Vec3 point);
double irradiance_quad(const Scene *scene, const QuadLight *light, const Hit *hit,
                       double *error_bound);
Rgb exact_lighting(const Scene *scene, const Hit *hit);

typedef struct { real x[16], y[16], z[16]; } Vec3Packet;
typedef struct { real r[16], g[16], b[16]; } RgbPacket;
typedef struct {
    bool any_hit; bool all_hit; bool one_object; int object[16];
    Vec3Packet point; Vec3Packet normal; RgbPacket brdf;
} HitPacket;
typedef struct { Vec3 origin; Vec3 corner, right, down; } ImagePlane;
ImagePlane image_plane(const Camera *camera, int width, int height);
void packet_hit(const Scene *scene, const ImagePlane *plane, const real *x, const real *y,
                HitPacket *hits);
void irradiance_packet(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                       double *irradiance);
int irradiance_packet_of_plain(const Scene *scene, const QuadLight *light, const HitPacket *hits,
                               double *irradiance, int *known);
void exact_lighting_packet(const Scene *scene, const HitPacket *hits, RgbPacket *radiance);

typedef struct { RgbPacket radiance; RgbPacket variance; } EstimatePacket;
void kernel_direct_lighting(const Scene *scene, const HitPacket *hits, int nb_packets,
                            const PointSet *points, Spread spread, RngStream first,
                            EstimatePacket *result);
void kernel_textbook(const Scene *scene, int light, const HitPacket *hits, const PointSet *points,
                     Spread spread, RngStream first, EstimatePacket *result);
bool scene_read(const char *file, Scene *scene, char **dump, char *message, size_t message_size);
void scene_free(Scene *scene);
"""


@dataclass(frozen=True)
class Core:
    """The core in one precision: its types and its functions."""

    ffi: cffi.FFI
    library: Any
    dtype: type[np.floating[Any]]
    """what C calls real"""

    def read_scene(self, file: Path) -> Any:
        message = self.ffi.new("char[1024]")
        scene = self.ffi.gc(self.ffi.new("Scene *"), self.library.scene_free)
        read = self.library.scene_read(
            str(file).encode(), scene, self.ffi.NULL, message, len(message)
        )
        assert read, self.ffi.string(message)
        return scene


def _declared(real: str) -> cffi.FFI:
    declared = cffi.FFI()
    declared.cdef(f"typedef {real} real;\n{DECLARATIONS}")
    return declared


ffi = _declared("float")


@cache
def library() -> Any:
    return ffi.dlopen(str(built("lib/libpenumbra.so")))


@cache
def core(precision: str) -> Core:
    """precision: "float32" or "float64"."""
    if precision == "float32":
        return Core(ffi, library(), np.float32)
    double = _declared("double")
    return Core(double, double.dlopen(str(built("lib/libpenumbra-float64.so"))), np.float64)
