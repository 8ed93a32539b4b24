"""The C core's noise-free irradiance from every light shape: against 30 digits, against what the
estimator tends to, against geometry. All numbers are representable in float32, so that C and the
witness see one scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from mpmath import mpf

from tests.core import ffi, library
from tests.many_digits import along, irradiance, vector

LANES = 16
WHITE = {"r": 1, "g": 1, "b": 1}
UP = (0, 1, 0)
SHAPES = ("quad", "triangle", "disk", "sphere")


def f32(values: Any) -> np.ndarray:
    return np.asarray(values, np.float32).astype(np.float64)


def unit(values: Any) -> np.ndarray:
    return f32(np.asarray(values) / np.linalg.norm(values))


def vec3(values: Any) -> dict[str, float]:
    return dict(zip("xyz", (float(v) for v in f32(values)), strict=True))


def flat(shape: str, corner: Any, u: Any, v: Any) -> tuple[Any, dict[str, Any]]:
    """The light in C, and what the witness is told."""
    light = ffi.new("Light *")
    light.type = getattr(library(), f"LIGHT_{shape.upper()}")
    cross = np.cross(f32(u), f32(v))
    area = float(np.linalg.norm(cross))
    setattr(
        light.shape,
        shape,
        {
            "corner": vec3(corner),
            "edge_u": vec3(u),
            "edge_v": vec3(v),
            "normal": vec3(cross / area),
            "area": area if shape == "quad" else area / 2,
            "radiance": WHITE,
        },
    )
    c, u, v = (vector(f32(x)) for x in (corner, u, v))
    far = [along(along(c, u, 1), v, 1)] if shape == "quad" else []
    return light, {"corners": [c, along(c, u, 1), *far, along(c, v, 1)]}


def quad(corner: Any, u: Any, v: Any) -> tuple[Any, dict[str, Any]]:
    return flat("quad", corner, u, v)


def triangle(corner: Any, u: Any, v: Any) -> tuple[Any, dict[str, Any]]:
    return flat("triangle", corner, u, v)


def disk(center: Any, normal: Any, radius: float) -> tuple[Any, dict[str, Any]]:
    light, r, n = ffi.new("Light *"), float(np.float32(radius)), unit(normal)
    light.type = library().LIGHT_DISK
    light.shape.disk = {
        "center": vec3(center),
        "normal": vec3(n),
        "radius": r,
        "area": np.pi * r**2,
        "radiance": WHITE,
    }
    return light, {"center": f32(center), "normal": n, "radius": r}


def sphere(center: Any, radius: float) -> tuple[Any, dict[str, Any]]:
    light, r = ffi.new("Light *"), float(np.float32(radius))
    light.type = library().LIGHT_SPHERE
    light.shape.sphere = {
        "center": vec3(center),
        "radius": r,
        "area": 4 * np.pi * r**2,
        "radiance": WHITE,
    }
    return light, {"center": f32(center), "radius": r}


@dataclass
class Case:
    """A light, what stands before it, and a receiver."""

    light: Any
    truth_light: dict[str, Any]
    balls: list[Any] = field(default_factory=list)
    planes: list[Any] = field(default_factory=list)
    point: Any = (0, 0, 0)
    normal: Any = UP
    own: int = -1
    """the object's number, balls first, on which the receiver is"""

    def __post_init__(self) -> None:
        self.balls = [(f32(c), float(np.float32(r))) for c, r in self.balls]
        self.planes = [(f32(p), unit(n)) for p, n in self.planes]
        self.point, self.normal = f32(self.point), unit(self.normal)
        self._kept = (
            ffi.new("Sphere[]", [{"center": vec3(c), "radius": r} for c, r in self.balls]),
            ffi.new("Plane[]", [{"point": vec3(p), "normal": vec3(n)} for p, n in self.planes]),
        )
        self.scene = ffi.new(
            "Scene *",
            {
                "nb_spheres": len(self.balls),
                "nb_planes": len(self.planes),
                "nb_lights": 1,
                "spheres": self._kept[0],
                "planes": self._kept[1],
                "lights": self.light,
            },
        )
        self.object = self.own if self.own >= 0 else len(self.balls) + len(self.planes)

    def hit(self, point: Any = None) -> Any:
        return ffi.new(
            "Hit *",
            {
                "object": self.object,
                "point": vec3(self.point if point is None else point),
                "normal": vec3(self.normal),
                "brdf": WHITE,
            },
        )

    def value(self) -> tuple[float, float]:
        """irradiance_light's, and its error bound."""
        bound = ffi.new("double *")
        value = library().irradiance_light(self.scene, self.light, self.hit(), bound)
        return value, bound[0]

    def by_packet(self) -> float:
        """Of a packet whose lanes are all this receiver, but for a few that hit nothing."""
        packet, value = ffi.new("HitPacket *"), ffi.new("double[16]")
        packet.any_hit = True
        for lane in range(LANES):
            packet.object[lane] = self.object if lane < 13 else -1
            for name, p, n in zip("xyz", self.point, self.normal, strict=True):
                getattr(packet.point, name)[lane] = p
                getattr(packet.normal, name)[lane] = n
        library().irradiance_packet(self.scene, self.light, packet, value)
        assert len(set(value[0:13])) == 1 and not any(value[13:16])
        return value[0]

    def truth(self) -> Any:
        return irradiance(
            self.truth_light, self.point, self.normal, self.balls, self.planes, self.own
        )


def assert_within_bound(case: Case) -> float:
    value, bound = case.value()
    truth = case.truth()
    error = abs(mpf(value) - truth)
    assert error <= bound, (value, float(truth), float(error), bound)
    return value


def random_light(
    shape: str, center: np.ndarray, size: float, normal: np.ndarray, rng: np.random.Generator
) -> tuple[Any, dict[str, Any]]:
    if shape == "sphere":
        return sphere(center, size)
    if shape == "disk":
        return disk(center, normal, size)
    x = np.cross(normal, [0.3, 0.5, -0.7])
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    u = size * (x + rng.normal() * 0.3 * y)
    v = size * (rng.uniform(0.5, 1.5) * y + rng.normal() * 0.3 * x)
    return flat(shape, center - (u + v) / (2 if shape == "quad" else 3), u, v)


def random_case(shape: str, rng: np.random.Generator) -> Case:
    """A light some 3 m away; balls between, on it, and at times around the receiver; planes that
    cut it, and a horizon that may."""
    size = 10 ** rng.uniform(-1, 0.3)
    center = np.array([0, 3, 0]) + rng.uniform(-1, 1, 3)
    normal = rng.normal(size=3)
    normal *= np.sign(normal @ center) / np.linalg.norm(normal)
    light = random_light(shape, center, size, normal, rng)
    on_light = rng.random() < 0.4
    balls, planes = [], []
    for _ in range(rng.integers(1, 4)):
        share = 1 if on_light else rng.uniform(0.2, 1.2)
        radius = rng.uniform(0.1, 0.9) * (size if on_light else 1)
        balls.append((share * (center + rng.normal(size=3) * size * 0.8), radius))
    for chance in (0.4, 0.2):
        if rng.random() < chance:
            planes.append((center + rng.normal(size=3) * size * 0.6, rng.normal(size=3)))
    if rng.random() < 0.15:
        around = np.array([0.1, 1, 0.2]) + 0.3 * center
        balls.append((around, np.linalg.norm(center) * rng.uniform(0.7, 1.1)))
    up = UP if rng.random() < 0.7 else rng.normal(size=3)
    return Case(*light, balls, planes, normal=up)
