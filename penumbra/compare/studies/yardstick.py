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
    for index, (kind, light) in enumerate(lights(scene)):
        count = 1 if kind == "point" else light_samples
        total = np.zeros((len(pixels), 3), Real)
        for sample in range(count):
            random = uniforms(seed, pixels, sample, index + 1)
            total += contribution(scene, seen, kind, light, random)
        radiance[here] += total / count
    return radiance.reshape(height, width, 3)


def lights(scene: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Each light's shape and its entry, in the C reader's order."""
    return [(kind, light) for kind in PLACES for light in scene.get(f"{kind}_lights", [])]


def contribution(
    scene: dict[str, Any], hits: Hits, kind: str, light: dict[str, Any], random: Array
) -> Array:
    """(P, 3) f_r (L_e / pdf) cos V of one sample each; random: (P, 2)."""
    emitted = np.array(light["color"], Real) * Real(light["power"])
    position, area_normal = PLACES[kind](light, random)
    w = position - hits.point
    d = norm(w)
    safe = np.where(d > 0, d, 1)
    weight = np.maximum(dot(hits.normal, w) / safe, 0) / safe**2
    if area_normal is not None:
        weight = weight * np.maximum(dot(area_normal, w), 0) / safe  # area cos_light
    weight = np.where((d > 0) & (weight > 0), weight, 0)
    open_ = ~occluded(scene, hits, w / safe[:, None], d)
    return hits.brdf * emitted * np.where(open_, weight, 0)[:, None]


# ---- places on lights, from two random numbers: (P, 3) positions, and the light's normal times its
# area, (3,) or (P, 3), which points away from what is lit; None of a point light


Places = tuple[Array, Array | None]


def point_place(light: dict[str, Any], random: Array) -> Places:
    return np.array(light["position"], Real), None


def quad_place(light: dict[str, Any], random: Array) -> Places:
    u, v = np.array(light["u"], Real), np.array(light["v"], Real)
    position = np.array(light["position"], Real) + random[:, :1] * u + random[:, 1:] * v
    return position, np.cross(u, v)


def disk_place(light: dict[str, Any], random: Array) -> Places:
    """Shirley and Chiu's map from the square [-1, 1]^2, in the frame of Duff et al."""
    center, radius = np.array(light["center"], Real), Real(light["radius"])
    normal = unit(np.array(light["normal"], Real))
    sign = Real(-1 if normal[2] < 0 else 1)
    a = -1 / (sign + normal[2])
    x_axis = np.array(
        [1 + sign * normal[0] ** 2 * a, sign * normal[0] * normal[1] * a, -sign * normal[0]]
    )
    x, y = 2 * random.T - 1
    steep = x * x < y * y
    r, across = np.where(steep, y, x), np.where(steep, x, y)
    angle = PI / 4 * across / np.where(r == 0, 1, r)
    angle = np.where(steep, PI / 2 - angle, angle)
    beside = np.cos(angle)[:, None] * x_axis + np.sin(angle)[:, None] * np.cross(normal, x_axis)
    return center + (radius * r)[:, None] * beside, PI * radius**2 * normal


def triangle_place(light: dict[str, Any], random: Array) -> Places:
    root = np.sqrt(random[:, :1])
    position, parallelogram = quad_place(
        light, np.concatenate([1 - root, random[:, 1:] * root], axis=1)
    )
    return position, np.asarray(parallelogram) / 2


def sphere_place(light: dict[str, Any], random: Array) -> Places:
    """By Archimedes: even in height."""
    t, turn = 2 * random[:, 0], 2 * PI * random[:, 1]
    across = np.sqrt(t * (2 - t))
    outwards = np.stack([across * np.cos(turn), across * np.sin(turn), 1 - t], axis=-1)
    radius = Real(light["radius"])
    return np.array(light["center"], Real) + radius * outwards, -4 * PI * radius**2 * outwards


PLACES = {
    "point": point_place,
    "quad": quad_place,
    "disk": disk_place,
    "triangle": triangle_place,
    "sphere": sphere_place,
}
"""In the C reader's order."""


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
