"""Samples of each light shape: spread as their density says, and the density integrates to one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tests.core import ffi, library
from tests.test_light_sample import f32, quad_light, vec3, xyz

WHITE = {"r": 1, "g": 1, "b": 1}
POINT = np.array([0.7, -0.4, -1.1])
CELLS, FINE = 6, 64
"""Cells of each of a shape's two coordinates, and steps of each cell in numerical integrals."""


@dataclass(frozen=True)
class Shape:
    """A light in two coordinates of [0, 1]^2 of which equal parts have equal areas."""

    light: Any
    area: float
    place: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """(n,), (n,) -> (n, 3): places [m]"""
    normal: Callable[[np.ndarray], np.ndarray]
    """(n, 3) -> (n, 3) or (3,): away from what is lit"""
    coordinates: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    """The inverse of place."""

    def solid_angle_density(self, place: np.ndarray) -> np.ndarray:
        """cos_light / d^2 [m^-2 sr], 0 where the place faces away from POINT."""
        to_light = place - POINT
        d = np.linalg.norm(to_light, axis=-1)
        cos = (to_light * self.normal(place)).sum(axis=-1) / d
        return np.maximum(cos, 0) / d**2

    def by_cell(self, of: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """(CELLS, CELLS): the integrals over the cells' areas, by midpoints."""
        middle = (np.arange(CELLS * FINE) + 0.5) / (CELLS * FINE)
        x, y = (c.ravel() for c in np.meshgrid(middle, middle, indexing="ij"))
        value = of(self.place(x, y)).reshape(CELLS, FINE, CELLS, FINE)
        return value.sum(axis=(1, 3)) * self.area / (CELLS * FINE) ** 2


def parallelogram(corner: Any, u: Any, v: Any, triangle: bool) -> Shape:
    corner, u, v = f32(corner), f32(u), f32(v)
    light = quad_light(corner, u, v, (1, 1, 1))
    cross = np.cross(u, v)
    area = float(np.linalg.norm(cross))
    if triangle:
        area /= 2
        light.type = library().LIGHT_TRIANGLE
        light.shape.triangle.area = area
    edges = np.stack([u, v], axis=1)

    def place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s, t = (1 - np.sqrt(x), y * np.sqrt(x)) if triangle else (x, y)
        return corner + s[:, None] * u + t[:, None] * v

    def coordinates(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s, t = np.linalg.lstsq(edges, (at - corner).T, rcond=None)[0]
        return ((1 - s) ** 2, t / np.maximum(1 - s, 1e-9)) if triangle else (s, t)

    return Shape(light, area, place, lambda _: cross / np.linalg.norm(cross), coordinates)


def disk() -> Shape:
    center, radius = f32([0.3, 0.8, 0.4]), 0.75
    normal = f32(np.array([1, 2, 3]) / np.sqrt(14))
    x_axis = np.cross(normal, [0, 0, 1])
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(normal, x_axis)
    light = ffi.new("Light *")
    light.type = library().LIGHT_DISK
    area = np.pi * radius**2
    light.shape.disk = {"center": vec3(center), "normal": vec3(normal), "radius": radius,
                        "area": area, "radiance": WHITE}  # fmt: skip

    def place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r, phi = radius * np.sqrt(x), 2 * np.pi * y
        return center + (r * np.cos(phi))[:, None] * x_axis + (r * np.sin(phi))[:, None] * y_axis

    def coordinates(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = (at - center) @ x_axis, (at - center) @ y_axis
        return (a * a + b * b) / radius**2, np.arctan2(b, a) / (2 * np.pi) % 1

    return Shape(light, area, place, lambda _: normal, coordinates)


def sphere() -> Shape:
    """Its first coordinate runs along the axis from POINT, so that the visible cap is cells."""
    center, radius = f32([0.3, 0.8, 0.4]), 0.75
    axis = (POINT - center) / np.linalg.norm(POINT - center)
    x_axis = np.cross(axis, [0, 0, 1])
    x_axis /= np.linalg.norm(x_axis)
    y_axis = np.cross(axis, x_axis)
    light = ffi.new("Light *")
    light.type = library().LIGHT_SPHERE
    area = 4 * np.pi * radius**2
    light.shape.sphere = {"center": vec3(center), "radius": radius, "area": area,
                          "radiance": WHITE}  # fmt: skip

    def place(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z, phi = 1 - 2 * x, 2 * np.pi * y
        r = np.sqrt(1 - z * z)
        local = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
        return center + radius * local @ np.stack([x_axis, y_axis, axis])

    def coordinates(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b, z = (np.stack([x_axis, y_axis, axis]) @ (at - center).T) / radius
        return np.clip((1 - z) / 2, 0, 1 - 1e-9), np.arctan2(b, a) / (2 * np.pi) % 1

    return Shape(light, area, place, lambda at: (center - at) / radius, coordinates)


SHAPES: dict[str, Callable[[], Shape]] = {
    "rectangle": lambda: parallelogram([0, 1, 0], [-0.3, 0, 0.9], [1.5, 0, 0.5], False),
    "sheared": lambda: parallelogram([0, 1, 0], [1, 0.5, 0.9], [1.5, 0, 0.5], False),
    "triangle": lambda: parallelogram([0, 1, 0], [0.4, 0.5, 0.9], [1.5, 0, 0.5], True),
    "disk": disk,
    "sphere": sphere,
}


def samples(shape: Shape, spread: str, count: int) -> tuple[np.ndarray, np.ndarray, int]:
    """(n, 3) places with a pdf above 0, their (n,) pdfs, and what the sampler settled on."""
    c = library()
    sampler = ffi.new("LightSampler *")
    c.light_sampler_create(sampler, shape.light, vec3(POINT), getattr(c, spread))
    uniform = np.random.default_rng(7).random((count, 2), dtype=np.float32)
    place, pdf = np.zeros((count, 3)), np.zeros(count)
    for i, (x, y) in enumerate(uniform.tolist()):
        sample = c.light_sampler_draw(sampler, {"x": x, "y": y})
        place[i] = POINT + sample.distance * xyz(sample.direction)
        pdf[i] = sample.pdf_solid_angle
    return place[pdf > 0], pdf[pdf > 0], sampler.spread


CASES = [(name, spread) for name in SHAPES for spread in ("SPREAD_AREA", "SPREAD_SOLID_ANGLE")]


@pytest.mark.parametrize(("name", "spread"), CASES)
def test_places_are_spread_as_their_density_says(name: str, spread: str) -> None:
    """Chi-square over 36 cells of equal area: of n samples each cell expects n times the integral
    of its density of places, 1 / area or cos_light / d^2 / solid angle. The seed is fixed, the
    level 1e-6."""
    shape = SHAPES[name]()
    n = 20_000
    place, _, spread_taken = samples(shape, spread, n)
    by_angle = spread_taken == library().SPREAD_SOLID_ANGLE
    assert by_angle == (
        spread == "SPREAD_SOLID_ANGLE" and name in ("rectangle", "triangle", "sphere")
    )
    seen = shape.by_cell(shape.solid_angle_density)
    facing = shape.by_cell(lambda at: 1.0 * (shape.solid_angle_density(at) > 0))
    expected = n * (seen / seen.sum() if by_angle else facing / shape.area)
    x, y = shape.coordinates(place)
    found = np.histogram2d(x, y, CELLS, ((0, 1), (0, 1)))[0]
    assert found.sum() >= len(place) - 5  # rounding may put one on the rim
    few = expected < 10
    assert found[few].sum() <= expected[few].sum() + 6 * np.sqrt(expected[few].sum() + 1)
    statistic = ((found - expected)[~few] ** 2 / expected[~few]).sum()
    assert stats.chi2.sf(statistic, (~few).sum() - 1) > 1e-6


@pytest.mark.parametrize(("name", "spread"), CASES)
def test_pdf_is_that_of_its_place_and_integrates_to_one(name: str, spread: str) -> None:
    """By area every pdf is d^2 / (area cos); by solid angle every pdf is one over the solid angle,
    here the numerical integral of cos / d^2 over the light. Its midpoints are right to 1e-4 where
    the sphere's outline is a kink."""
    shape = SHAPES[name]()
    place, pdf, spread_taken = samples(shape, spread, 500)
    solid_angle = shape.by_cell(shape.solid_angle_density).sum()
    if spread_taken == library().SPREAD_SOLID_ANGLE:
        assert pdf == pytest.approx(np.full(len(pdf), 1 / solid_angle), rel=1e-4)
    else:
        assert len(place) > 100
        assert pdf == pytest.approx(1 / (shape.area * shape.solid_angle_density(place)), rel=2e-3)
        inverse = np.zeros(500)
        inverse[: len(pdf)] = 1 / pdf
        assert abs(inverse.mean() - solid_angle) < 4.5 * inverse.std() / np.sqrt(500)


@pytest.mark.parametrize("sine", [0.9, 1e-2, 1e-4, 1e-6, 1e-8])
def test_solid_angle_of_a_far_sphere_keeps_its_digits(sine: float) -> None:
    """2 pi (1 - cos) as it stands is off by a tenth at 1e-3 rad in float32, and 0 at 1e-4."""
    c = library()
    light = {"center": {"x": 0, "y": 0, "z": 1}, "radius": sine, "area": 1, "radiance": WHITE}
    cone = ffi.new("SphereCone *")
    assert c.sphere_cone_create(cone, ffi.new("SphereLight *", light), vec3([0, 0, 0]))
    s = float(np.float32(sine))
    expected = 2 * np.pi * s * s / (1 + np.sqrt(1 - s * s))
    assert cone.solid_angle == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("size", [1, 1e-2, 1e-4])
@pytest.mark.parametrize("flatness", [1, 1e-3, 1e-6])
def test_solid_angle_of_a_small_or_sliver_triangle_keeps_its_digits(
    size: float, flatness: float
) -> None:
    """Against Van Oosterom and Strackee's formula in double."""
    c = library()
    u, v = f32([size, 0, 0]), f32([0.3 * size, flatness * size, 0])
    corner = f32([0.1, 0.2, 1])
    light = parallelogram(corner, u, v, True).light
    seen = ffi.new("SphericalTriangle *")
    usable = c.spherical_triangle_create(
        seen, ffi.addressof(light.shape, "triangle"), vec3([0, 0, 0])
    )
    a, b, d = corner, corner + u, corner + v
    la, lb, ld = (np.linalg.norm(x) for x in (a, b, d))
    below = la * lb * ld + (a @ b) * ld + (b @ d) * la + (d @ a) * lb
    expected = 2 * np.arctan2(abs(corner @ np.cross(u, v)), below)
    assert usable == (expected >= 1e-9)
    assert seen.solid_angle == pytest.approx(expected, rel=2e-6) or not usable


@pytest.mark.parametrize("spread", ["SPREAD_AREA", "SPREAD_SOLID_ANGLE"])
def test_no_light_inside_a_sphere_light_or_behind_a_flat_one(spread: str) -> None:
    """A point inside sees the sphere's dark side; so does one behind a disk or a triangle."""
    behind = {"sphere": [0.3, 0.8, 0.4], "disk": [0.3, 0.8, 1.5], "triangle": [0.5, 3, 0.5]}
    c, sampler = library(), ffi.new("LightSampler *")
    for name, point in behind.items():
        light = SHAPES[name]().light
        c.light_sampler_create(sampler, light, vec3(point), getattr(c, spread))
        shines = c.light_shines_on(light, vec3(point))
        for x in (0.0, 0.25, 0.75):
            sample = c.light_sampler_draw(sampler, {"x": x, "y": x})
            assert not shines and (sample.radiance.r, sample.pdf_solid_angle) == (0, 0), name
