"""What one light sample does on average under each mistake, in numpy: the library of mistakes'
moments again, slower, for machines without a compiler and as a witness.

The same jittered points, so that the two agree but for rounding (tests/test_mistakes.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from penumbra.compare.check.catalogue import RIGHT, Choice, catalogue
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.scene import (
    DiskLight,
    Light,
    PointLight,
    QuadLight,
    Scene,
    SphereLight,
    TriangleLight,
)

CHUNK = 1 << 18
"""Samples worked on at once: what keeps the temporary arrays near the cache"""
PLACES = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5))
"""s, t of a shadow ray's fixed targets, from 1"""
SPOTS = (-2 / 3, 0.0, 2 / 3)
"""In half pixels about a pixel's middle, where it is asked whether it sees a fixed place"""
STEPS = 0.7548776662466927, 0.5698402909980532
"""Of the lattice that jitters the points (Roberts's R2)"""


@dataclass(frozen=True)
class Sites:
    """n points of the picture that receive light, and how far each moves in half a pixel."""

    receivers: Receivers
    right: np.ndarray
    """(n, 3) [m]"""
    down: np.ndarray
    """(n, 3) [m]"""

    def __len__(self) -> int:
        return len(self.receivers)

    def __getitem__(self, which: np.ndarray | slice) -> Sites:
        return Sites(self.receivers[which], self.right[which], self.down[which])


def moments(
    scene: Scene,
    light: int,
    sites: Sites,
    domain: str,
    rays: Sequence[str],
    weights: Sequence[str],
    grid: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The chance (r, n) that a sample of a domain sees the light, and the means (r, w, n) of V w
    and V w^2 [sr, sr^2], of each shadow ray and weight; light: its position in scene.lights."""
    chosen = catalogue().choices
    fixed = fixed_place(chosen["domain", domain])
    own = [chosen["visibility", ray] for ray in rays]
    factors = [chosen["weight", weight] for weight in weights]
    n = len(sites)
    chance = np.empty((len(rays), n), np.float32)
    first = np.empty((len(rays), len(weights), n), np.float32)
    second = np.empty_like(first)
    count = 1 if fixed else grid * grid
    step = max(1, CHUNK // count)
    for start in range(0, n, step):
        part = slice(start, min(start + step, n))
        a, b = _points(np.arange(part.start, part.stop), 1 if fixed else grid)
        s, t = (
            np.broadcast_to(np.asarray(chosen["domain", domain].evaluate(i, a=a, b=b)), a.shape)
            for i in (0, 1)
        )
        at = sites[part]
        way = _ways(scene.lights[light], at.receivers, s, t)
        value = np.stack([_weight(factor, way) for factor in factors], axis=1) * way.area
        seen = np.stack([_seen(scene, light, at, ray, way, fixed) for ray in own], axis=1)
        chance[:, part] = seen.mean(axis=2).T
        apart = np.array([bool(ray.field("apart")) for ray in own])
        shaded = np.where(apart[None, :, None], 1.0, seen)
        for moment, power in ((first, value), (second, value * value)):
            moment[:, :, part] = np.einsum("nwj,nrj->rwn", power, shaded, optimize=True) / count
    return chance, first, second


def places(scene: Scene, light: int, sites: Sites, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(k, n) float32 [sr]: what each of k places of the light would bring, were all of its power
    there."""
    right = catalogue().choices["visibility", RIGHT], catalogue().choices["weight", RIGHT]
    brings = []
    for one_s, one_t in zip(s, t, strict=True):
        at = [np.full((len(sites), 1), value) for value in (one_s, one_t)]
        way = _ways(scene.lights[light], sites.receivers, *at)
        seen = _visible(scene, right[0], sites.receivers, way)
        brings.append((way.area * _weight(right[1], way) * seen)[:, 0])
    return np.asarray(brings, np.float32)


def fixed_place(domain: Choice) -> tuple[float, float] | None:
    """s, t, if all samples are one place."""
    a, b = np.array([0.1, 0.7, 0.4]), np.array([0.2, 0.5, 0.9])
    s, t = (
        np.broadcast_to(np.asarray(domain.evaluate(i, a=a, b=b), dtype=float), a.shape)
        for i in (0, 1)
    )
    return (float(s[0]), float(t[0])) if np.ptp(s) == 0 and np.ptp(t) == 0 else None


def _points(index: np.ndarray, grid: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, grid^2) in [0, 1): in each cell of a grid one point, at the places of a lattice that is
    shifted for every site."""
    j = np.arange(grid * grid)
    shift = (index[:, None] + 1.0) * np.array([STEPS[1], STEPS[0]])
    a = (j % grid + np.mod(shift[:, :1] + j * STEPS[0], 1)) / grid
    b = (j // grid + np.mod(shift[:, 1:] + j * STEPS[1], 1)) / grid
    return a, b


@dataclass(frozen=True)
class _Ways:
    """From n sites to k places of the light each."""

    to: np.ndarray
    """(n, k, 3) [m]"""
    distance: np.ndarray
    """(n, k) [m]"""
    raw: np.ndarray
    """(n, k) cosine at the surface, as it is"""
    cl: np.ndarray
    """(n, k) cosine at the light"""
    area: float
    """[m^2]"""


def _ways(light: Light, receivers: Receivers, s: np.ndarray, t: np.ndarray) -> _Ways:
    if isinstance(light, PointLight):
        raise ValueError("a point light has no places")
    place, normal = _place(light, s, t)
    to = place - receivers.point[:, None]
    distance = np.sqrt(np.einsum("nki,nki->nk", to, to))
    raw = np.einsum("nki,ni->nk", to, receivers.normal) / distance
    return _Ways(to, distance, raw, (to * normal).sum(axis=2) / distance, light.area)


def _place(
    light: QuadLight | DiskLight | TriangleLight | SphereLight, s: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(..., 3) [m], and the normal that points away from what the light shines on. Lights that are
    not quads keep to numbers in [0, 1)."""
    if not isinstance(light, QuadLight):
        s, t = np.mod(s, 1), np.mod(t, 1)
    if isinstance(light, SphereLight):
        height, angle = 1 - 2 * s, 2 * math.pi * t
        ring = np.sqrt(np.maximum(1 - height**2, 0))
        outwards = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=-1)
        return np.asarray(light.center) + light.radius * outwards, -outwards
    normal = np.asarray(light.normal)
    if isinstance(light, DiskLight):  # Shirley and Chiu 1997
        x, y = 2 * s - 1, 2 * t - 1
        steep = np.abs(y) > np.abs(x)
        r, across = np.where(steep, y, x), np.where(steep, x, y)
        angle = math.pi / 4 * across / np.where(r == 0, 1, r)
        x, y = (r * np.where(steep, f(angle), g(angle))
                for f, g in ((np.sin, np.cos), (np.cos, np.sin)))  # fmt: skip
        edge = np.cross(normal, [1.0, 0, 0] if abs(normal[0]) < 0.5 else [0, 1.0, 0])
        edge /= np.linalg.norm(edge)
        disk = x[..., None] * edge + y[..., None] * np.cross(normal, edge)
        return np.asarray(light.center) + light.radius * disk, normal
    if isinstance(light, TriangleLight):
        root = np.sqrt(s)
        s, t = 1 - root, t * root
    edges = s[..., None] * np.asarray(light.edge_u) + t[..., None] * np.asarray(light.edge_v)
    return np.asarray(light.corner) + edges, normal


def _weight(factor: Choice, way: _Ways) -> np.ndarray:
    """[m^-2]"""
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = factor.evaluate(
            0, raw=way.raw, cs=np.maximum(way.raw, 0), cl=way.cl, d=way.distance
        )
    return np.where(way.cl > 0, weight, 0.0)


def _seen(
    scene: Scene,
    light: int,
    at: Sites,
    ray: Choice,
    way: _Ways,
    fixed: tuple[float, float] | None,
) -> np.ndarray:
    """(n, k): whether each place is seen; of a fixed one, by how much of the pixel."""
    target = int(ray.field("target"))
    place = PLACES[target - 1] if target else fixed
    if place is None:
        return _visible(scene, ray, at.receivers, way)
    share = np.zeros((len(at), 1))
    s, t = (np.full((len(at), 1), value) for value in place)
    for u in SPOTS:
        for v in SPOTS:
            point = at.receivers.point + u * at.right + v * at.down
            moved = replace(at.receivers, point=point)
            share += _visible(scene, ray, moved, _ways(scene.lights[light], moved, s, t)) / 9
    return np.broadcast_to(share, way.distance.shape)


def _visible(scene: Scene, ray: Choice, receivers: Receivers, way: _Ways) -> np.ndarray:
    """(n, k) of 0 and 1: which of the rays meet nothing on the way that the choice looks at."""
    free = np.ones(way.distance.shape)
    if ray.field("ignored"):
        return free
    offset, start, length = (ray.field(name) for name in ("offset", "start", "length"))
    origin = receivers.point + offset * receivers.normal
    sign = -1.0 if ray.field("reversed") else 1.0
    end = np.full_like(way.distance, length) if length else way.distance
    direction = sign * way.to / way.distance[..., None]
    for i, sphere in enumerate(scene.spheres):
        centre = np.asarray(sphere.center) - origin
        on_it = (receivers.object_id == i)[:, None] & (offset == 0)
        outside = np.where(on_it[:, 0], 0, (centre**2).sum(axis=1) - sphere.radius**2)[:, None]
        along = np.einsum("nki,ni->nk", direction, centre)
        root = along**2 - outside
        half = np.sqrt(np.maximum(root, 0))
        near, far = along - half, along + half
        meets = ((near > start) & (near < end) & ~on_it) | ((far > start) & (far < end))
        free[(root > 0) & meets] = 0
    for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
        normal = np.asarray(plane.normal)
        height = ((np.asarray(plane.point) - origin) @ normal)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = height / (direction @ normal)
        own = (receivers.object_id == i)[:, None] & (offset == 0)
        free[(distance > start) & (distance < end) & ~own] = 0
    return 1 - free if ray.field("inverted") else free
