"""Solid-angle sampling of a rectangle: the right solid angle, and directions even over it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.run.library import PRECISIONS
from tests.core import core, ffi, library
from tests.test_estimator_packet import random_scene
from tests.test_light_sample import draw, f32, quad_light, vec3, xyz
from tests.test_precision import SAMPLERS, array, packet_of, point_set, representable

UNIFORM = np.random.default_rng(0).random((4000, 2))


def rectangle(corner: Any, u: Any, v: Any, point: Any) -> tuple[Any, Any, bool]:
    light = quad_light(corner, u, v, (1, 1, 1))
    rect = ffi.new("SphericalRectangle *")
    quad = ffi.addressof(light.shape, "quad")
    return rect, quad, library().spherical_rectangle_create(rect, quad, vec3(point))


def solid_angle(corner: np.ndarray, u: np.ndarray, v: np.ndarray, point: np.ndarray) -> float:
    """Two triangles by Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30(2), 1983."""

    def triangle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        la, lb, lc = (np.linalg.norm(x) for x in (a, b, c))
        below = la * lb * lc + (a @ b) * lc + (b @ c) * la + (c @ a) * lb
        return float(2 * np.arctan2(abs(a @ np.cross(b, c)), below))

    a, b, c, d = (corner - point + s * u + t * v for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return triangle(a, b, c) + triangle(a, c, d)


def random_rectangle(seed: int) -> tuple[np.ndarray, ...]:
    """Sides and distances over four decades, in any orientation."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    u, v = (axes[i] * 10 ** rng.uniform(-2, 2) for i in (0, 1))
    corner = rng.uniform(-2, 2, 3)
    middle = corner + (u + v) / 2
    point = middle - np.cross(u, v) / np.linalg.norm(np.cross(u, v)) * 10 ** rng.uniform(-2, 2)
    point += rng.uniform(-1, 1) * u + rng.uniform(-1, 1) * v
    return f32(corner), f32(u), f32(v), f32(point)


@pytest.mark.parametrize("seed", range(60))
def test_solid_angle_matches_the_triangles(seed: int) -> None:
    """The frame's axes are floats: each of the rectangle's bounds is right to a few 6e-8 of the
    distances about it, the solid angle to some 1e-6 of them over its smallest one."""
    corner, u, v, point = random_rectangle(seed)
    expected = solid_angle(corner, u, v, point)
    rect, _, usable = rectangle(corner, u, v, point)
    assert usable == (expected >= 1e-7) or expected == pytest.approx(1e-7, rel=1e-3)
    if usable:
        size = max(np.linalg.norm(x) for x in (u, v, corner - point))
        height = abs(np.cross(u, v) @ (corner - point)) / np.linalg.norm(np.cross(u, v))
        room = min(height, np.linalg.norm(u), np.linalg.norm(v))
        assert rect.solid_angle == pytest.approx(expected, rel=2e-6 * size / room)


@pytest.mark.parametrize("seed", range(12))
def test_directions_are_even_over_the_solid_angle(seed: int) -> None:
    """The share of directions that falls on the rectangle's first quarter (s, t < 1/2) is its
    share p of the solid angle: of n = 4,000, within 4 standard errors sqrt(p (1 - p) / n)."""
    corner, u, v, point = random_rectangle(seed + 100)
    light = quad_light(corner, u, v, (1, 1, 1))
    rect, _, usable = rectangle(corner, u, v, point)
    if not usable:
        pytest.fail("choose seeds whose rectangles are seen large enough")
    inside = []
    for x, y in UNIFORM:
        sample = draw(light, point, {"x": x, "y": y}, "SPREAD_SOLID_ANGLE")
        place = point + xyz(sample.direction) * sample.distance - corner
        s, t = place @ u / (u @ u), place @ v / (v @ v)
        slack = 1e-4 + 1e-5 * np.linalg.norm(corner - point) / min(map(np.linalg.norm, (u, v)))
        assert -slack < s < 1 + slack
        assert -slack < t < 1 + slack
        inside.append(s < 0.5 and t < 0.5)
        assert sample.radiance.r == pytest.approx(rect.solid_angle, rel=1e-6)
        assert sample.pdf_solid_angle == pytest.approx(1 / rect.solid_angle, rel=1e-6)
    p = solid_angle(corner, u / 2, v / 2, point) / solid_angle(corner, u, v, point)
    assert abs(np.mean(inside) - p) < 4 * np.sqrt(max(p * (1 - p), 1e-3) / len(inside))


def test_sheared_and_grazing_quads_are_left_to_area_sampling() -> None:
    assert not rectangle([0, 1, 0], [-2, 0, 0], [-2, 0, 1], [0, 0, 0])[2]
    assert not rectangle([1, 1, -1], [-2, 0, 0], [0, 0, 2], [0, 1, 0])[2]
    assert rectangle([1, 1, -1], [-2, 0, 0], [0, 0, 2], [0, 0.5, 0])[2]


def with_rectangles(scene: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Its lights made rectangles, some of them tiny: of 1e-3 m and below are seen as less than
    1e-7 sr from here and there."""
    for quad in scene["quad_lights"]:
        size = 10 ** rng.uniform(-3, 0)
        u, v = np.array(quad["u"]), np.array(quad["v"])
        v -= (u @ v) / (u @ u) * u
        quad["u"], quad["v"] = (size * u).tolist(), (size * v).tolist()
    return scene


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("first_seed", range(0, 60, 15))
def test_sixteen_points_at_a_time_are_the_textbook(
    first_seed: int, precision: str, make_scene: Callable[..., Path]
) -> None:
    """On random scenes, sample for sample. The lights' right angles are rounded to float32, and
    only one of the two keeps what they are off by: in float64, 1e-7 times a few. In float32 as in
    tests/test_estimator_packet.py, which says also what else may differ."""
    c = core(precision)
    tolerance = 1e-6 if precision == "float64" else 1e-4
    differing = pixels = lit = 0
    for seed in range(first_seed, first_seed + 15):
        rng = np.random.default_rng(seed)
        scene = c.read_scene(make_scene(**representable(with_rectangles(random_scene(seed), rng))))
        for sampler in SAMPLERS:
            points = point_set(c, sampler, 7)
            for _ in range(4):
                hits = packet_of(c, scene, rng)
                stream = {"seed": 1, "pixel": int(rng.integers(1 << 30)), "pixel_sample": 0}
                spread = c.library.SPREAD_SOLID_ANGLE
                result, expected = (c.ffi.new("EstimatePacket *") for _ in range(2))
                c.library.packet_direct_lighting(scene, hits, 1, points, spread, stream, result)
                for light in range(scene.nb_lights if hits.any_hit else 0):
                    c.library.packet_textbook(scene, light, hits, points, spread, stream, expected)
                value, truth = array(result.radiance), array(expected.radiance)
                differs = np.abs(value - truth) > tolerance * np.maximum(truth, 1e-3)
                differing += differs.any(axis=-1).sum()
                lit += truth.any(axis=-1).sum()
                pixels += len(truth)
    assert lit > pixels / 20
    assert differing <= 2 + 7 * pixels / 2000, f"{differing} of {pixels}"
