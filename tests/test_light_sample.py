"""One light sample, against the handout's formulas in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.core import ffi, library

EPS = float(np.finfo(np.float32).eps)  # one unit in the last place, relative


def f32(values: Any) -> np.ndarray:
    return np.asarray(values, np.float32).astype(np.float64)


def quad_light(corner: Any, u: Any, v: Any, radiance: Any = (40, 30, 20)) -> Any:
    corner, u, v = f32(corner), f32(u), f32(v)
    normal = np.cross(u, v)
    area = np.linalg.norm(normal)
    light = ffi.new("Light *")
    light.type = library().LIGHT_QUAD
    light.shape.quad = {
        "corner": vec3(corner),
        "edge_u": vec3(u),
        "edge_v": vec3(v),
        "normal": vec3(normal / area),
        "area": area,
        "radiance": dict(zip("rgb", radiance, strict=True)),
    }
    return light


def draw(light: Any, point: Any, random: Any, spread: str = "SPREAD_AREA") -> Any:
    """A LightSample of a light as a point sees it."""
    sampler = ffi.new("LightSampler *")
    library().light_sampler_create(sampler, light, vec3(point), getattr(library(), spread))
    return library().light_sampler_draw(sampler, random)


def vec3(v: Any) -> dict[str, float]:
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}


def xyz(v: Any) -> np.ndarray:
    return np.array([v.x, v.y, v.z])


COORDINATE = st.floats(-10, 10, width=32)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
EDGE = st.floats(-3, 3, width=32)
UNIFORM = st.integers(0, 2**24 - 1).map(lambda i: i / 2**24)


@settings(max_examples=1000, deadline=None, derandomize=True)
@given(
    corner=POINT,
    u=st.tuples(EDGE, EDGE, EDGE),
    v=st.tuples(EDGE, EDGE, EDGE),
    point=POINT,
    s=UNIFORM,
    t=UNIFORM,
)
def test_quad_sample_follows_steps_a_to_d(
    corner: Any, u: Any, v: Any, point: Any, s: float, t: float
) -> None:
    """position = corner + s u + t v, pdf = d^2 / (area cos), radiance = L / pdf, all in double.

    Each coordinate of (position - point) is known to about 4 roundings of the largest term, so
    d to delta = 4 eps * size / d relatively; pdf ~ d^2 / cos with cos itself known to delta
    absolutely: the bound below is that first-order sum, with a factor 2.
    """
    corner, u, v, point = f32(corner), f32(u), f32(v), f32(point)
    cross = np.cross(u, v)
    area = np.linalg.norm(cross)
    assume(area > 1e-3 * np.linalg.norm(u) * np.linalg.norm(v) > 1e-7)
    to_light = corner + s * u + t * v - point
    d = np.linalg.norm(to_light)
    assume(d > 1e-3)
    cos_light = cross @ to_light / area / d

    size = np.abs([corner, u, v, point]).sum()
    delta = 4 * EPS * size / d
    assume(abs(cos_light) > 8 * delta)

    sample = draw(quad_light(corner, u, v), point, {"x": s, "y": t})
    assert np.abs(xyz(sample.direction) - to_light / d).max() < 2 * delta
    assert sample.distance == pytest.approx(d, rel=2 * delta)
    if cos_light < 0:
        assert (sample.radiance.r, sample.pdf_solid_angle) == (0, 0)
        return
    pdf = d * d / (area * cos_light)
    relative = 2 * (2 * delta + delta / cos_light) + 8 * EPS
    assert sample.pdf_solid_angle == pytest.approx(pdf, rel=relative)
    radiance = np.array([sample.radiance.r, sample.radiance.g, sample.radiance.b])
    assert radiance == pytest.approx(np.array([40, 30, 20]) / pdf, rel=relative)


def test_area_of_a_sheared_quad_is_the_norm_of_the_cross_product() -> None:
    """u = (2, 0, 0), v = (2, 0, 1): |u x v| = 2, whereas |u| |v| = 4.47 (most students' area).
    From straight below a point of it at d = 1, cos = 1: pdf = 1 / 2."""
    light = quad_light([0, 1, 0], [-2, 0, 0], [-2, 0, 1])
    sample = draw(light, [-2, 0, 0.5], {"x": 0.5, "y": 0.5})
    assert sample.pdf_solid_angle == pytest.approx(1 / 2, rel=4 * EPS)


def test_mean_of_inverse_pdf_is_the_solid_angle() -> None:
    """E[1 / pdf_solid_angle] = integral of 1 over the light's directions. A square of side 2
    centred 1 above the point is one face of a cube about it: 4 pi / 6. With n = 40,000 fixed
    random samples the mean is known to its own standard error; 4 of them allowed."""
    light = quad_light([1, 1, -1], [-2, 0, 0], [0, 0, 2])
    inverse = []
    for sample in range(40_000):
        random = library().rng_uniform2({"seed": 5, "pixel": 0, "pixel_sample": 0}, sample, 1)
        inverse.append(1 / draw(light, [0, 0, 0], random).pdf_solid_angle)
    standard_error = np.std(inverse) / np.sqrt(len(inverse))
    assert abs(np.mean(inverse) - 4 * np.pi / 6) < 4 * standard_error


@pytest.mark.parametrize("point", [[0, 2, 0], [0, 1, 0], [5, 1, 5], [1, 1, -1]])
def test_no_light_behind_in_the_plane_or_on_the_corner_of_a_quad(point: list[float]) -> None:
    light = quad_light([1, 1, -1], [-2, 0, 0], [0, 0, 2])
    for random in ({"x": 0, "y": 0}, {"x": 0.5, "y": 0.5}):
        sample = draw(light, point, random)
        assert (sample.radiance.r, sample.pdf_solid_angle) == (0, 0)


def test_point_light_falls_off_with_distance_squared() -> None:
    """The lab's scene before: power 100 at d = 2 gives 25, with pdf 1."""
    light = ffi.new("Light *")
    light.type = library().LIGHT_POINT
    light.shape.point = {
        "position": vec3([0, 3, 0]),
        "radiant_intensity": {"r": 100, "g": 50, "b": 0},
    }
    sample = draw(light, [0, 1, 0], {"x": 0.3, "y": 0.7})
    assert (sample.radiance.r, sample.radiance.g, sample.radiance.b) == (25, 12.5, 0)
    assert (sample.distance, sample.pdf_solid_angle) == (2, 1)
    assert xyz(sample.direction).tolist() == [0, 1, 0]
