"""The C core's noise-free irradiance from every light shape: against 25 digits, against what the
estimator tends to, against geometry. All numbers are representable in float32, so that C and the
witness see one scene."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

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


def turned(shape: str, size: float, center: Any, **rest: Any) -> Case:
    """A light of some size in no particular direction, which faces the receiver."""
    center = f32(center)
    normal = center / np.linalg.norm(center) + [0.3, 0.2, -0.4]
    normal /= np.linalg.norm(normal)
    return Case(*random_light(shape, center, size, normal, np.random.default_rng(1)), **rest)


HARD: dict[str, Case] = {}
AXIS = np.array([0.28, 0.96, 0])
for shape in SHAPES:
    # a ball that covers half of it, the horizon through it, and a plane
    for size in (1e-2, 1e-4, 1e-6, 1e-8):
        middle = 3 * f32(AXIS)
        HARD[f"{shape} of {size}, half behind a ball"] = turned(
            shape, size, middle, balls=[(0.5 * middle + [0.96 * 0.25, -0.28 * 0.25, 0], 0.25)]
        )
        HARD[f"{shape} of {size}, half below the horizon"] = turned(
            shape, size, middle, normal=(0.96, -0.28, 0.2 * size)
        )
        HARD[f"{shape} of {size}, cut by a ball and by a plane"] = turned(
            shape,
            size,
            middle,
            balls=[(middle + size * np.array([0.3, 0.1, 0.5]), 0.5 * size)],
            planes=[(middle + size * np.array([-0.2, 0.1, 0.1]), (1, 0.3, 0.4))],
        )
    HARD[f"{shape} behind three balls that overlap"] = turned(
        shape,
        0.8,
        (0, 3, 0),
        balls=[((0.2, 1.5, 0), 0.25), ((-0.1, 1.5, 0.2), 0.25), ((0, 1.8, -0.2), 0.25)],
    )
    HARD[f"{shape}, receiver in a ball that holds half of it"] = turned(
        shape, 0.5, (0, 1, 0), balls=[((0.5, 0.2, 0.1), 1)]
    )
    HARD[f"{shape}, receiver on the inner side of a ball that holds half of it"] = turned(
        shape, 0.5, (0.125, 1, 0), balls=[((0, 0.5, 0), 0.5)], own=0
    )
    HARD[f"{shape}, two balls and two planes cut it"] = turned(
        shape,
        1,
        (0, 2, 0),
        balls=[((0.7, 2, 0.2), 0.5), ((-0.2, 2.1, 0.6), 0.4)],
        planes=[((0, 2, -0.5), (0.1, 0.2, 1)), ((-0.5, 2, 0), (1, 0.2, -0.1))],
    )
    HARD[f"{shape}, two balls that cut it and one another"] = turned(
        shape, 1, (0, 2, 0), balls=[((0.3, 1.9, 0.2), 0.5), ((-0.2, 1.8, 0.3), 0.4)]
    )
    HARD[f"{shape}, receiver beside a ball's foot"] = turned(
        shape, 0.7, (0.5, 2, 0), balls=[((1e-3, 0.5, 0), 0.5)], planes=[((0, 0, 0), UP)], own=1
    )
    HARD[f"{shape}, a ball just behind and one just before it"] = turned(
        shape, 0.5, (0, 2, 0), balls=[((0.4, 2.75, 0), 0.7), ((0.2, 1.2, 0), 0.125)]
    )
for delta in (0, 1e-7, -1e-7, 1e-4, -1e-4, 1e-2, -1e-2):
    # the cone's half-angle is the light's but for delta: sin = 1 / sqrt(10), or 1 / 4
    r = 1 + delta
    HARD[f"disk eclipsed by a ball but for {delta}"] = Case(
        *disk((0, 3, 0), UP, 1), balls=[((0, 2, 0), r * 2 / np.sqrt(10))]
    )
    HARD[f"sphere eclipsed by a ball but for {delta}"] = Case(
        *sphere((0, 4, 0), 1), balls=[((0, 2, 0), r * 0.5)]
    )
    HARD[f"disk and a cone that touch but for {delta}"] = Case(
        *disk((0, 3, 0), UP, 1), balls=[((1.5, 2.25, 0), r * 1.5 / np.sqrt(2) * (3 - 2.25) / 1.5)]
    )
    # the plane z = 0 holds the receiver's horizon
    HARD[f"disk touches the horizon but for {delta}"] = Case(
        *disk((0.5, 3, 1 + delta), UP, 1), normal=(0, 0, 1)
    )
    HARD[f"sphere touches the horizon but for {delta}"] = Case(
        *sphere((0.5, 3, 1 + delta), 1), normal=(0, 0, 1)
    )
    HARD[f"two silhouettes touch before a sphere but for {delta}"] = Case(
        *sphere((0, 4, 0), 2), balls=[((0.5, 2, 0), 0.5), ((-0.5, 2, 0), r * 0.5)]
    )
    HARD[f"a ball touches a disk's plane but for {delta}"] = Case(
        *disk((0, 2, 0), UP, 1), balls=[((0.3, 1.5, 0), r * 0.5)]
    )
    HARD[f"a ball touches a sphere light but for {delta}"] = Case(
        *sphere((0, 3, 0), 1), balls=[((0, 1.5, 0), r * 0.5)]
    )
    HARD[f"a ball's ring touches the rim but for {delta}"] = Case(
        *disk((0, 2, 0), UP, 1), balls=[((0.5, 2, 0), r * 0.5)]
    )
for height in (1, 1e-3, 1e-6):
    HARD[f"disk, receiver {height} below its rim"] = Case(
        *disk((1, height, 0), UP, 1), balls=[((0.5, 0.3 * height, 0.3), 0.1 * height)]
    )
    HARD[f"disk, receiver {height} below its middle"] = Case(*disk((0, height, 0), UP, 1))
    HARD[f"quad on edge at {height}"] = Case(
        *quad((1, height, -1), (0, 0, 2), (2, 0, 0)), normal=(0.5, 1, 0)
    )
    HARD[f"triangle, a sliver of {height}"] = Case(
        *triangle((-1, 2, 0), (0, 0, height), (2, 0.5, 0.3))
    )
    HARD[f"sphere, receiver {height} below it"] = Case(
        *sphere((0, 1 + height, 0), 1), normal=(1, 0.2, 0), balls=[((1, 1, 0), 0.5)]
    )
HARD |= {
    "sphere half buried in a plane": Case(
        *sphere((0.5, 0, 2), 1), planes=[((0, 0, 0), UP)], point=(0, 0.5, 0), normal=(0, 0, 1)
    ),
    "sphere half buried in the receiver's plane": Case(
        *sphere((0.5, 0, 2), 1), planes=[((0, 0, 0), UP)], own=0
    ),
    "sphere half buried in a ball": Case(*sphere((0, 3, 0), 1), balls=[((0.5, 2.5, 0.5), 1)]),
    "sphere half buried in a ball behind it": Case(
        *sphere((0, 3, 0), 1), balls=[((0.5, 4, 0.5), 1.25)]
    ),
    "sphere half buried in balls before one another": Case(
        *sphere((0, 3, 0), 1),
        balls=[((0.5, 2.25, 0.25), 0.5), ((-0.25, 2.25, 0), 0.5), ((0.2, 1.5, 0.3), 0.25)],
        planes=[((0.3, 3, -0.3), (-1, 0.2, 1))],
        normal=(0.6, 0.2, 0.1),
    ),
}


CHANCE = {
    f"{shape} by chance, {seed}": random_case(shape, np.random.default_rng(seed))
    for shape in SHAPES
    for seed in range(15)
}
CASES = HARD | CHANCE
FILE = Path(__file__).with_suffix(".json")
"""The witness's 25 digits of each case, since it takes a third of a second: python -m
tests.test_irradiance_shapes."""


@cache
def witnessed() -> dict[str, str]:
    return json.loads(FILE.read_text())


def digits(name: str) -> str:
    return str(mp.nstr(CASES[name].truth(), 25, min_fixed=1, max_fixed=0))


def apart(a: Any, b: str) -> float:
    with mp.workdps(40):
        return float(abs(a - mpf(b)))


# ---- against 25 digits


def test_witnessed_cases_are_todays() -> None:
    """All are in the file, and a few of them, worked out anew, are the same."""
    known = witnessed()
    assert known.keys() == CASES.keys()
    for name in list(CASES)[7::40]:
        assert apart(CASES[name].truth(), known[name]) <= 1e-20, name


@pytest.mark.parametrize("name", CASES)
def test_irradiance_is_within_its_bound_of_25_digits(name: str) -> None:
    value, bound = CASES[name].value()
    error = apart(mpf(value), witnessed()[name])
    assert error <= bound, (value, error, bound)


def test_cases_by_chance_see_part_of_their_lights() -> None:
    """The test above would claim little otherwise."""
    partly = 0
    for case in CHANCE.values():
        free = Case(case.light, {}, point=case.point, normal=case.normal).value()[0]
        partly += 0 < case.value()[0] < (1 - 1e-9) * free
    assert partly > len(CHANCE) / 3


# ---- against the rest of the renderer


@pytest.mark.parametrize("name", CASES)
def test_packets_are_the_scalar_solution(name: str) -> None:
    """To the last bit but for quads: their vectors know the arctangent to 2e-13 of each edge's
    term, which is less than 1,000 eps for each radian of outline, where the bound is 16 eps."""
    case = CASES[name]
    value, bound = case.value()
    tolerance = 64 * bound if "quad" in name else 0
    assert abs(case.by_packet() - value) <= tolerance


@pytest.mark.parametrize("shape", SHAPES)
def test_estimator_tends_to_it(shape: str) -> None:
    """The mean of 4,096 independent samples by area is within five of its own standard errors, in
    three scenes with cuts and balls; rounding in float32 adds some 1e-5 of the whole."""
    for seed in (1, 3, 4):
        case = CHANCE[f"{shape} by chance, {seed}"]
        points = ffi.new("PointSet *")
        assert library().point_set_create(points, library().SAMPLER_INDEPENDENT, 4096, 7)
        stream = ffi.new("RngStream *", {"seed": 7})[0]
        estimate = library().light_estimate(
            case.scene, 0, case.hit(), points, library().SPREAD_AREA, stream
        )
        exact = case.value()[0]
        error = 5 * np.sqrt(estimate.variance.r) + 1e-5
        assert abs(estimate.radiance.r - exact) <= error, seed


if __name__ == "__main__":
    with ProcessPoolExecutor() as pool:
        values = dict(zip(CASES, pool.map(digits, CASES), strict=True))
    FILE.write_text(json.dumps(values, indent=1) + "\n")
