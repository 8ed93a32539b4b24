"""One source, two precisions: the float64 build is the yardstick of float32's rounding."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.measure.image import Image
from tests.conftest import built
from tests.core import Core, core
from tests.test_estimator_packet import random_scene

PRECISIONS = ("float32", "float64")
SAMPLERS = ("INDEPENDENT", "JITTERED", "SOBOL")
LANES = 16
ROUNDINGS = 24
"""Errors of the estimator's vectors, in eps of the lengths that they are sums of. A packet's w:
1/2 for corner - point, 4 for each axis of the light's frame (a normalised vector, and a cross
product with a rounded normal), 3/2 for the three-term products with it, 3/2 for the unit of length,
2 for adding s u + t v, twice that with the sobol sampler's points from [1, 2); for n . w as much
again."""


@pytest.mark.parametrize("precision", PRECISIONS)
def test_header_and_version_say_the_precision(
    precision: str, render: Callable[..., Image], scenes: Path
) -> None:
    image = render(scenes / "tp3.json", precision, width=6, height=4)
    assert image.attributes["precision"] == precision
    program = "bin/penumbra-render" + ("-float64" if precision == "float64" else "")
    said = subprocess.run([built(program), "--version"], capture_output=True, text=True)
    assert said.stdout.split()[-1] == precision


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("count", [7, 12, 64])
def test_both_precisions_draw_the_same_points(sampler: str, count: int) -> None:
    """So that their images differ by rounding alone."""
    points = [drawn(core(precision), sampler, count, 2) for precision in PRECISIONS]
    assert np.array_equal(*points)


def test_images_of_both_precisions_differ_by_rounding(
    render: Callable[..., Image], scenes: Path
) -> None:
    """tp3, most of whose terms have conditions below 1e2: 1e-5. Shadow rays within rounding of
    the sphere's edge fall on either side, in at most 1 of 2,000 (test_estimator_packet.py)."""
    single, double = (
        render(scenes / "tp3.json", p, light_samples=16, width=90, height=60).radiance
        for p in PRECISIONS
    )
    differs = (np.abs(single - double) > 1e-5 * np.abs(double)).any(axis=-1)
    assert differs.sum() <= 2 + 90 * 60 * 16 / 2000
    assert (single != double).any()


# ---- term by term


def drawn(c: Core, sampler: str, count: int, dimension: int, pixels: int = 20) -> np.ndarray:
    """(pixels, count, 2) float64"""
    points = point_set(c, sampler, count)
    get = c.library.point_set_get
    values = [
        get(points, {"seed": 1, "pixel": k, "pixel_sample": 0}, i, dimension)
        for k in range(pixels)
        for i in range(count)
    ]
    return np.array([(p.x, p.y) for p in values], np.float64).reshape(pixels, count, 2)


def point_set(c: Core, sampler: str, count: int) -> Any:
    points = c.ffi.gc(c.ffi.new("PointSet *"), c.library.point_set_free)
    kind = getattr(c.library, f"SAMPLER_{sampler}")
    assert c.library.point_set_create(points, kind, count, 1)
    return points


def array(v: Any) -> np.ndarray:
    """A C Vec3, Rgb or packet of them as (3,) or (lanes, 3) float64."""
    names = ("x", "y", "z") if hasattr(v, "x") else ("r", "g", "b")
    return np.array(
        [getattr(v, n) if isinstance(getattr(v, n), float) else list(getattr(v, n)) for n in names],
        np.float64,
    ).T


def as_double(double: Core, hits: Any) -> Any:
    """The float32 core's hits, the same numbers, for the float64 core."""
    copy = double.ffi.new("HitPacket *")
    copy.any_hit, copy.all_hit, copy.one_object = hits.any_hit, hits.all_hit, hits.one_object
    copy.object = list(hits.object)
    for part, names in (("point", "xyz"), ("normal", "xyz"), ("brdf", "rgb")):
        for name in names:
            setattr(getattr(copy, part), name, list(getattr(getattr(hits, part), name)))
    return copy


class Terms:
    """One light sample for each lane of a packet: what the float64 textbook says of it, and
    between which values a sum of roundings leaves it."""

    def __init__(self, double: Core, scene: Any, hits: Any, points: Any, stream: Any, eps: float):
        self.double, self.scene, self.hits = double, scene, hits
        self.points, self.stream = points, stream
        light = scene.lights[0]
        x, n = array(hits.point), array(hits.normal)
        if light.type == double.library.LIGHT_POINT:
            place = np.broadcast_to(array(light.shape.point.position), x.shape)
            emitted, edges = array(light.shape.point.radiant_intensity), 0.0
        else:
            quad = light.shape.quad
            u, v = array(quad.edge_u), array(quad.edge_v)
            st = np.array([self._random(i) for i in range(LANES)])
            place = array(quad.corner) + st[:, :1] * u + st[:, 1:] * v
            emitted, edges = array(quad.radiance), np.linalg.norm(u) + np.linalg.norm(v)
        w = place - x
        self.distance = np.linalg.norm(w, axis=-1)
        size = np.linalg.norm(x, axis=-1) + np.linalg.norm(place, axis=-1) + 2 * edges
        self.room = ROUNDINGS * eps * size
        """[m] of each lane's vectors"""
        n_w = (n * w).sum(axis=-1)
        factor = array(hits.brdf) * emitted
        self.low, self.high = (
            self._value(factor, light, w, n_w, sign * self.room) * (1 + sign * ROUNDINGS * eps)
            for sign in (-1, 1)
        )

    def _random(self, lane: int) -> tuple[float, float]:
        stream = {**self.stream, "pixel": self.stream["pixel"] + lane}
        random = self.double.library.point_set_get(self.points, stream, 0, 1)
        return random.x, random.y

    def _value(
        self, factor: np.ndarray, light: Any, w: np.ndarray, n_w: np.ndarray, room: np.ndarray
    ) -> np.ndarray:
        """f_r L_e A h (n . w) / |w|^4, or f_r I (n . w) / |w|^3 of a point light, with each of
        its lengths off by room in the direction that makes it larger (room > 0) or smaller."""
        distance = np.maximum(np.linalg.norm(w, axis=-1) - room, 0)
        above = np.maximum(n_w + room, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            if light.type == self.double.library.LIGHT_POINT:
                value = above / distance**3
            else:
                quad = light.shape.quad
                height = np.maximum(w @ array(quad.normal) + room, 0)
                value = quad.area * height * above / distance**4
            return factor * np.where(above > 0, value, 0)[:, None]

    def textbook(self, scene: Any = None, hits: Any = None) -> np.ndarray:
        """(LANES, 3)"""
        result = self.double.ffi.new("EstimatePacket *")
        library = self.double.library
        library.packet_textbook(
            scene or self.scene, 0, hits or self.hits, self.points, library.SPREAD_AREA,
            self.stream, result,
        )  # fmt: skip
        return array(result.radiance)

    def undecided(self) -> np.ndarray:
        """(LANES,) whether rounding decides what the shadow ray meets: the float64 textbook's
        answer changes when spheres grow or shrink, and planes or the point move, by the room."""
        here = np.array(list(self.hits.object)) >= 0
        room = float(self.room[here].max())
        stretch = float((1 + self.room[here] / self.distance[here]).max())
        answers = [self.textbook().any(axis=-1)]
        for sign in (-1, 1):
            answers.append(self.textbook(scene=self._grown(sign, room, stretch)).any(axis=-1))
            answers.append(self.textbook(hits=self._moved(sign * room)).any(axis=-1))
        return np.any(answers, axis=0) & ~np.all(answers, axis=0)

    def _grown(self, sign: int, room: float, stretch: float) -> Any:
        """A sphere's cone is that of (w . C)^2 > |w|^2 (|C|^2 - r^2): rounding of C and w amounts
        to another r^2, by a share of |C|^2."""
        ffi, scene = self.double.ffi, self.scene
        copy = ffi.new("Scene *", scene[0])
        spheres = [scene.spheres[i] for i in range(scene.nb_spheres)]
        planes = [scene.planes[i] for i in range(scene.nb_planes)]
        self.kept = [ffi.new("Sphere[]", spheres), ffi.new("Plane[]", planes)]
        copy.spheres, copy.planes = self.kept
        x = array(self.hits.point)
        for sphere in self.kept[0]:
            far = float(np.linalg.norm(x - array(sphere.center), axis=-1).max()) + sphere.radius
            squared = sphere.radius**2 + sign * (4 * room * far + room**2) * stretch
            sphere.radius = max(squared, 0.0) ** 0.5
        for plane in self.kept[1]:
            for axis in "xyz":
                moved = getattr(plane.point, axis) + sign * room * getattr(plane.normal, axis)
                setattr(plane.point, axis, moved)
        return copy

    def _moved(self, by: float) -> Any:
        copy = self.double.ffi.new("HitPacket *", self.hits[0])
        moved = array(self.hits.point) + by * array(self.hits.normal)
        for axis, values in zip("xyz", moved.T, strict=True):
            setattr(copy.point, axis, [float(v) for v in values])
        return copy


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("first_seed", range(0, 40, 10))
def test_every_term_of_a_packet_is_the_float64_textbooks(
    first_seed: int, precision: str, make_scene: Callable[..., Path]
) -> None:
    """One light sample in each pixel, one light at a time, on random scenes: the
    packet's value, given the points that its rays met, lies between those that ROUNDINGS eps of
    the lengths involved allow around the exact value. Where rounding decides what the shadow ray
    meets, 0 is right too."""
    single, double = core(precision), core("float64")
    eps = float(np.finfo(single.dtype).eps)
    terms = lit = undecided = 0
    for seed in range(first_seed, first_seed + 10):
        rng = np.random.default_rng(seed)
        file = make_scene(**representable(random_scene(seed)))
        scenes = single.read_scene(file), double.read_scene(file)
        for sampler in SAMPLERS:
            for _ in range(6):
                hits = packet_of(single, scenes[0], rng)
                if not hits.any_hit:
                    continue
                stream = {"seed": 1, "pixel": int(rng.integers(1 << 30)), "pixel_sample": 0}
                for light in range(scenes[0].nb_lights):
                    views = [
                        one_light(c, s, light)
                        for c, s in zip((single, double), scenes, strict=True)
                    ]
                    expected = Terms(
                        double, views[1], as_double(double, hits), point_set(double, sampler, 1),
                        stream, eps,
                    )  # fmt: skip
                    result = single.ffi.new("EstimatePacket *")
                    points = point_set(single, sampler, 1)
                    single.library.packet_direct_lighting(
                        views[0], hits, 1, points, single.library.SPREAD_AREA, stream, result
                    )
                    value, truth = array(result.radiance), expected.textbook()
                    unsure = expected.undecided()
                    may_be_dark = (unsure | ~truth.any(axis=-1))[:, None]
                    may_be_lit = (unsure | truth.any(axis=-1))[:, None]
                    low = np.where(may_be_dark, 0, expected.low)
                    high = np.where(may_be_lit | (expected.low <= 0), expected.high, 0)
                    here = np.array(list(hits.object)) >= 0
                    assert (value >= low)[here].all(), f"seed {seed}, light {light}, {sampler}"
                    assert (value <= high)[here].all(), f"seed {seed}, light {light}, {sampler}"
                    terms += here.sum()
                    lit += truth.any(axis=-1)[here].sum()
                    undecided += unsure[here].sum()
    assert terms > 2000
    assert lit > terms / 20
    assert undecided < terms / 100


def representable(scene: dict[str, Any]) -> dict[str, Any]:
    """All numbers rounded to float32: both builds then read the same."""

    def rounded(value: Any) -> Any:
        if isinstance(value, float):
            return float(np.float32(value))
        if isinstance(value, list):
            return [rounded(v) for v in value]
        if isinstance(value, dict):
            return {k: rounded(v) for k, v in value.items()}
        return value

    return {k: rounded(v) for k, v in scene.items()}


def packet_of(c: Core, scene: Any, rng: np.random.Generator) -> Any:
    """What sixteen neighbouring pixels of the 37 x 23 image hit."""
    x = [float(v) for v in rng.integers(0, 21) + np.arange(LANES) + 0.5]
    y = [float(rng.integers(0, 23)) + 0.5] * LANES
    hits = c.ffi.new("HitPacket *")
    camera = c.ffi.addressof(scene, "camera")
    plane = c.ffi.new("ImagePlane *", c.library.image_plane(camera, 37, 23))
    c.library.packet_hit(scene, plane, x, y, hits)
    for i in range(LANES):
        if hits.object[i] < 0:  # such lanes are not set: something finite
            for part, names in (("point", "xyz"), ("normal", "xyz"), ("brdf", "rgb")):
                for name in names:
                    getattr(getattr(hits, part), name)[i] = 0
    return hits


def one_light(c: Core, scene: Any, light: int) -> Any:
    copy = c.ffi.new("Scene *", scene[0])
    copy.lights, copy.nb_lights = scene.lights + light, 1
    return copy
