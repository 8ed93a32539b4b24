"""The lab's estimator once more, in extended precision: the yardstick of rounding.

numpy's longdouble has 64 bits of mantissa on x86-64 (113 on Arm Linux), so its own rounding is
2,000 times below float64's and 10^12 times below float32's. It draws the renderer's points
(Threefry, c_renderer/src/core/rng.h) and takes the scene file's numbers as they are written: what a
renderer's image differs by is its rounding, that of its input included. Written from
docs/estimator.md, not from the C code; tests/test_stability.py checks it with 40 digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Real = np.longdouble
Array = np.ndarray[Any, Any]
PI = Real("3.14159265358979323846264338327950288")
NOTHING = -1


@dataclass(frozen=True)
class Hits:
    """What the pixels' rays meet; point, normal and brdf hold where object is not NOTHING."""

    object: Array
    """(P,) spheres from 0, then planes"""
    point: Array
    """(P, 3) [m]"""
    normal: Array
    """(P, 3) unit, towards the ray's origin"""
    brdf: Array
    """(P, 3) [sr^-1]"""


def image(scene: dict[str, Any], light_samples: int, seed: int) -> Array:
    """(H, W, 3) longdouble [W m^-2 sr^-1]: what `penumbra-render` would write without rounding.

    scene: a scene file's content; one ray through each pixel's centre, independent samples.
    """
    width, height = scene["image"]["width"], scene["image"]["height"]
    hits = first_hits(scene)
    radiance = np.where(
        (hits.object == NOTHING)[:, None], np.array(scene["background"], Real), Real(0)
    )
    here = hits.object != NOTHING
    seen = Hits(hits.object[here], hits.point[here], hits.normal[here], hits.brdf[here])
    pixels = np.nonzero(here)[0]
    # lights in the C reader's order: point lights, then quads
    lights = [(light, False) for light in scene.get("point_lights", [])]
    lights += [(light, True) for light in scene.get("quad_lights", [])]
    for index, (light, is_quad) in enumerate(lights):
        count = light_samples if is_quad else 1
        total = np.zeros((len(pixels), 3), Real)
        for sample in range(count):
            random = uniforms(seed, pixels, sample, index + 1)
            total += contribution(scene, seen, light, is_quad, random)
        radiance[here] += total / count
    return radiance.reshape(height, width, 3)


def contribution(
    scene: dict[str, Any], hits: Hits, light: dict[str, Any], is_quad: bool, random: Array
) -> Array:
    """(P, 3) f_r (L_e / pdf) cos V of one sample each; random: (P, 2)."""
    emitted = np.array(light["color"], Real) * Real(light["power"])
    position: Array = np.array(light["position"], Real)
    if is_quad:
        u, v = np.array(light["u"], Real), np.array(light["v"], Real)
        position = position + random[:, :1] * u + random[:, 1:] * v
    w = position - hits.point
    d = norm(w)
    safe = np.where(d > 0, d, 1)
    weight = np.maximum(dot(hits.normal, w) / safe, 0) / safe**2
    if is_quad:
        weight = weight * np.maximum(dot(np.cross(u, v), w), 0) / safe  # area cos_light
    weight = np.where((d > 0) & (weight > 0), weight, 0)
    open_ = ~occluded(scene, hits, w / safe[:, None], d)
    return hits.brdf * emitted * np.where(open_, weight, 0)[:, None]


# ---- rays


def first_hits(scene: dict[str, Any]) -> Hits:
    camera, width, height = scene["camera"], scene["image"]["width"], scene["image"]["height"]
    origin = np.array(camera["position"], Real)
    forward = unit(np.array(camera["look_at"], Real) - origin)
    right = unit(np.cross(np.array(camera["up"], Real), forward))
    up = np.cross(forward, right)
    half = np.tan(Real(camera["fov_y_deg"]) * PI / 360)
    y, x = np.mgrid[0:height, 0:width].reshape(2, -1).astype(Real) + Real(0.5)
    direction = unit(
        forward
        + ((2 * x / width - 1) * half * width / height)[:, None] * right
        + ((1 - 2 * y / height) * half)[:, None] * up
    )
    start = np.broadcast_to(origin, direction.shape)
    nearest = np.full(len(x), Real(scene["ray_max_distance"]))
    object_ = np.full(len(x), NOTHING)
    objects = [*scene.get("spheres", []), *scene.get("planes", [])]
    for index, item in enumerate(objects):
        t = (
            sphere_hit(item, start, direction)
            if "radius" in item
            else plane_hit(item, start, direction)
        )
        closer = (t > 0) & (t < nearest)
        nearest[closer], object_[closer] = t[closer], index
    point = origin + nearest[:, None] * direction
    normal, brdf = np.zeros_like(point), np.zeros_like(point)
    for index, item in enumerate(objects):
        mine = object_ == index
        brdf[mine] = np.array(item["color"], Real)
        if "radius" in item:
            normal[mine] = unit(point[mine] - np.array(item["center"], Real))
            continue
        normal[mine] = n = unit(np.array(item["normal"], Real))
        # back onto the plane: longdouble rounds as well
        point[mine] -= ((point[mine] - np.array(item["point"], Real)) @ n)[:, None] * n
    normal *= np.where(dot(normal, direction) > 0, -1, 1)[:, None]
    return Hits(object_, point, normal, brdf)


def occluded(scene: dict[str, Any], hits: Hits, direction: Array, distance: Array) -> Array:
    """(P,) whether something stands between the point and the light: decision 3's rules."""
    hidden = np.zeros(len(distance), bool)
    objects = [*scene.get("spheres", []), *scene.get("planes", [])]
    for index, item in enumerate(objects):
        mine = hits.object == index
        if "radius" in item:
            far_wall = -2 * dot(hits.point - np.array(item["center"], Real), direction)
            t = np.where(mine, far_wall, sphere_hit(item, hits.point, direction))
        else:
            t = np.where(mine, 0, plane_hit(item, hits.point, direction))
        hidden |= (t > 0) & (t < distance)
    return hidden


def sphere_hit(sphere: dict[str, Any], origin: Array, direction: Array) -> Array:
    """(P,) the nearest t > 0, or 0."""
    radius = Real(sphere["radius"])
    to_origin: Array = origin - np.array(sphere["center"], Real)
    along = dot(to_origin, direction)
    across = to_origin - direction * along[:, None]
    root = np.sqrt(np.maximum(radius**2 - dot(across, across), 0))
    outside = dot(to_origin, to_origin) - radius**2
    # t1 t2 = outside: no difference of near-equal numbers in either root
    far = np.where(along > 0, np.where(root + along == 0, 0, -outside), root - along)
    divisor = np.where(along > 0, root + along, 1)
    inside = far / np.where(divisor == 0, 1, divisor)
    ahead = np.where(along < 0, outside, 0) / np.where(along < 0, root - along, 1)
    meets = radius**2 - dot(across, across) >= 0
    return np.where(meets, np.where(outside < 0, inside, ahead), 0)


def plane_hit(plane: dict[str, Any], origin: Array, direction: Array) -> Array:
    normal = np.array(plane["normal"], Real)
    approach = direction @ normal
    t = (np.array(plane["point"], Real) - origin) @ normal
    t = t / np.where(approach == 0, 1, approach)
    return np.where((approach != 0) & (t > 0), t, 0)


# ---- random numbers


def uniforms(seed: int, pixels: Array, sample: int, dimension: int) -> Array:
    """(P, 2) of rng.h's rng_uniform2 for one pixel sample."""
    words = threefry([pixels, sample // 2, 0, dimension], seed)[sample % 2 * 2 :][:2]
    return np.stack([(w >> np.uint32(8)).astype(Real) / Real(2**24) for w in words], axis=-1)


def threefry(counter: list[Any], seed: int) -> list[Array]:
    """Threefry4x32-13 (Salmon and others, SC 2011) of each counter: four arrays of uint32."""
    rotations = ((10, 26), (11, 21), (13, 27), (23, 5), (6, 20), (17, 11), (25, 10), (18, 20))
    key = [seed & 0xFFFFFFFF, seed >> 32, 0, 0]
    key.append(0x1BD11BDA ^ key[0] ^ key[1])
    keys = [np.uint32(k) for k in key]
    words = np.broadcast_arrays(*(np.asarray(c, np.uint32) for c in counter))
    x = [word + keys[i] for i, word in enumerate(words)]
    for step in range(13):
        if step and step % 4 == 0:
            turn = step // 4
            x = [word + keys[(turn + i) % 5] for i, word in enumerate(x)]
            x[3] = x[3] + np.uint32(turn)
        if step % 2:
            x[1], x[3] = x[3], x[1]
        for pair, by in zip((0, 2), rotations[step % 8], strict=True):
            x[pair] = x[pair] + x[pair + 1]
            mixed = x[pair + 1]
            x[pair + 1] = (mixed << np.uint32(by) | mixed >> np.uint32(32 - by)) ^ x[pair]
        if step % 2:
            x[1], x[3] = x[3], x[1]
    return x


# ---- vectors


def dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def norm(a: Array) -> Array:
    return np.asarray(np.sqrt(dot(a, a)))


def unit(a: Array) -> Array:
    return np.asarray(a / norm(a)[..., None])
