"""Single terms of the estimator, in both precisions, against extended precision: a million cases
weighted to the corners where floats break."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from penumbra.compare.studies.yardstick import Real, dot, norm, uniforms
from tests.conftest import STRESS
from tests.core import Core, core

CASES = 1_000_000
SEED = 7
FLOAT32_MAX, FLOAT32_MIN = float(np.finfo(np.float32).max), float(np.finfo(np.float32).tiny)
ROUNDINGS = 8
"""Of lengths, in eps of the sum S of those that they come from. position = corner + s u + t v: four
roundings of at most S/2 eps; minus the point, one more: 5/2 eps S for each of w's components, so
4.4 for w and d. h = n . w: n's own rounding, its products and sums are 3 eps more of |w| <= S.
normal . w likewise. Products and quotients of these: ROUNDINGS eps, relatively."""


class Cases:
    """(n,) cases as C structs, whose numbers are exactly those of the precision."""

    def __init__(self, c: Core, n: int, rng: np.random.Generator, **fixed: Any) -> None:
        self.core, self.n, real = c, n, c.dtype
        vec3 = np.dtype((real, 3))
        quad = [("corner", vec3), ("u", vec3), ("v", vec3), ("normal", vec3), ("area", real),
                ("radiance", vec3)]  # fmt: skip
        light = np.dtype([("type", np.int32), ("quad", np.dtype(quad, align=True))], align=True)
        hit = np.dtype([("object", np.int32), ("point", vec3), ("normal", vec3), ("brdf", vec3)],
                       align=True)  # fmt: skip
        assert (light.itemsize, hit.itemsize) == (c.ffi.sizeof("Light"), c.ffi.sizeof("Hit"))
        self.lights, self.hits = np.zeros(n, light), np.zeros(n, hit)
        self._fill(rng, **fixed)

    def _fill(self, rng: np.random.Generator, **fixed: Any) -> None:
        n, q, hit = self.n, self.lights["quad"], self.hits

        def power(name: str, low: float, high: float) -> np.ndarray:
            """10^low to 10^high; half of the cases near one of the ends, half in between."""
            x = np.where(rng.random(n) < 0.5, rng.beta(0.3, 0.3, n), rng.random(n))
            return np.asarray(10 ** (low + (high - low) * fixed.get(name, x)))[:, None]

        axes = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
        e1, e2, e3 = axes[:, 0], axes[:, 1], axes[:, 2]
        side, aspect, angle = power("side", -6, 6), power("aspect", -6, 0), power("angle", -6, 0)
        u = e1 * side
        v = (e1 * np.cos(angle) + e2 * np.sin(angle)) * side * aspect
        front = np.sign(dot(np.cross(e1, e2), e3))[:, None] * e3
        distance, tilt = power("distance", -6, 6), power("tilt", -7, 0)
        # before a place on the light, off its axis by the tilt; one in eight behind it
        away = (
            np.sqrt(np.maximum(1 - tilt**2, 0)) * e1
            + tilt * np.where(rng.random((n, 1)) < 1 / 8, 1, -1) * front
        )
        move = power("move", -3, 7) * np.where(rng.random((n, 1)) < 0.5, 0, 1)
        corner = rng.normal(size=(n, 3)) * move
        q["corner"], q["u"], q["v"] = corner, u, v
        inside = rng.random((n, 2))
        place = corner + inside[:, :1] * u + inside[:, 1:] * v
        hit["point"] = place + away * distance
        # the surface faces the light, or nearly not
        cos = power("cos", -7, 0)
        side_ways = np.cross(-away, e2 + e3)
        side_ways /= np.linalg.norm(side_ways, axis=-1)[:, None]
        normal = -away * cos + side_ways * np.sqrt(np.maximum(1 - cos**2, 0))
        hit["normal"] = normal / np.linalg.norm(normal, axis=-1)[:, None]
        hit["brdf"], q["radiance"] = 0.5, 1
        self.lights["type"] = self.core.library.LIGHT_QUAD
        cross = np.cross(np.asarray(q["u"], Real), np.asarray(q["v"], Real))
        self.cross, area = cross, norm(cross)
        usable = area > 1e-9 * norm(np.asarray(q["u"], Real)) * norm(np.asarray(q["v"], Real))
        self.cross[~usable], area[~usable] = (0, 0, 1), 1  # the reader refuses such
        q["normal"], q["area"] = cross / area[:, None], area
        self.usable = usable

    def samples(self) -> dict[str, np.ndarray]:
        """What light_sample and direct_lighting (one sample) say."""
        c = self.core
        ffi, library = c.ffi, c.library
        lights = ffi.from_buffer("Light[]", self.lights)
        hits = ffi.from_buffer("Hit[]", self.hits)
        out = np.zeros((self.n, 8), c.dtype)
        sample = ffi.from_buffer("LightSample[]", out)
        brought = np.zeros((self.n, 6), c.dtype)
        estimate = ffi.from_buffer("Estimate[]", brought)
        sampler = ffi.new("LightSampler *")
        self.random = uniforms(SEED, np.arange(self.n), 0, 1)
        random = np.asarray(self.random, c.dtype)
        place = ffi.from_buffer("Uniform2[]", random)
        scene = ffi.new("Scene *", {"nb_lights": 1})
        points = ffi.gc(ffi.new("PointSet *"), library.point_set_free)
        assert library.point_set_create(points, library.SAMPLER_INDEPENDENT, 1, SEED)
        stream = ffi.new("RngStream *", {"seed": SEED})
        for k in range(self.n):
            library.light_sampler_create(sampler, lights + k, hits[k].point, library.SPREAD_AREA)
            sample[k] = library.light_sampler_draw(sampler, place[k])
            scene.lights = lights + k
            stream.pixel = k
            estimate[k] = library.direct_lighting(
                scene, hits + k, points, library.SPREAD_AREA, stream[0]
            )
        return {"distance": out[:, 3], "inverse_pdf": out[:, 4], "pdf": out[:, 7],
                "contribution": brought[:, 0]}  # fmt: skip

    def between(self, terms: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """The least and largest value of each term with ROUNDINGS * terms roundings."""
        q = self.lights["quad"]
        eps = Real(np.finfo(self.core.dtype).eps)
        corner, u, v = (np.asarray(q[name], Real) for name in ("corner", "u", "v"))
        point, n = np.asarray(self.hits["point"], Real), np.asarray(self.hits["normal"], Real)
        w = corner + self.random[:, :1] * u + self.random[:, 1:] * v - point
        room = terms * ROUNDINGS * eps * (norm(corner) + norm(u) + norm(v) + norm(point))
        d, area = norm(w), norm(self.cross)
        h, n_w = dot(self.cross, w) / area, dot(n, w)
        found = []
        for sign in (-1, 1):
            more, less = sign * room, -sign * room
            height, above = np.maximum(h + more, 0), np.maximum(n_w + more, 0)
            factor = 1 + sign * terms * ROUNDINGS * eps
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = area * height / np.maximum(d + less, 0) ** 3
                found.append({
                    "distance": (d + more) * factor,
                    "inverse_pdf": inverse * factor,
                    "pdf": np.maximum(d + more, 0) ** 3
                    / (area * np.maximum(h + less, 0)) * factor,
                    "contribution": 0.5 * inverse * above / np.maximum(d + less, 0) * factor,
                })  # fmt: skip
        maybe_behind = h <= room
        found[0]["pdf"] = np.where(maybe_behind, 0, found[0]["pdf"])
        for name in ("pdf", "inverse_pdf", "contribution", "distance"):
            both = found[0][name], found[1][name]
            found[0][name] = np.where(np.isnan(both[0]), 0, both[0])
            found[1][name] = np.where(np.isnan(both[1]), np.inf, both[1])
        # pdf is 0 where the light's dark side is seen
        found[1]["pdf"] = np.where(h < -room, 0, found[1]["pdf"])
        return found[0], found[1]


def outside(cases: Cases) -> dict[str, np.ndarray]:
    """The usable cases of each term that are not within their bound."""
    found = cases.samples()
    low, high = cases.between(1)
    smallest = 64 * FLOAT32_MIN if cases.core.dtype is np.float32 else 0
    wrong = {}
    for name, value in found.items():
        assert np.isfinite(value).all(), name
        assert (value >= 0).all(), name
        # products below the smallest normal float keep fewer digits; those above the largest are it
        at_least = np.minimum(low[name], FLOAT32_MAX) - smallest
        wrong[name] = cases.usable & ~((value >= at_least) & (value <= high[name] + smallest))
    return wrong


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_million_terms_are_within_their_rounding(precision: str) -> None:
    """Distance, pdf, 1 / pdf (area cos / d^2: the geometry term times the area, without the
    surface's cosine) and contribution of one light sample each. Sides and distances of 1e-6 to
    1e6 m, aspects and angles of edges down to 1e-6, tilts against the light and grazing angles
    down to 1e-7, moved by up to 1e7 m; half of all parameters near one end of their range."""
    for batch in range(STRESS):
        cases = Cases(core(precision), CASES if precision == "float32" else CASES // 4,
                      np.random.default_rng(batch + 1))  # fmt: skip
        wrong = outside(cases)
        assert cases.usable.mean() > 0.5
        assert {name: int(bad.sum()) for name, bad in wrong.items()} == dict.fromkeys(wrong, 0)
