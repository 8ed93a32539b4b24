"""Where should a shadow ray start? Four ways, counted ray by ray against the truth.

The scene is what its numbers are once they are stored: translated, scaled, rounded to float32 or
float64. The truth about one shadow ray is worked out with 113 bits (self_shadow.c): the
camera ray's exact point on the exact surface, and whether the straight line from there to the
light's point is free. So rounding the scene is nobody's fault; rounding the hit point, the
direction and the test is, and "rounding" says how much of that no start could have avoided.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import ArrayLike
from scipy import stats
from tqdm import tqdm

from penumbra.compare.run import provenance
from penumbra.compare.run.library import build_of, load
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.scene import Scene, read_scene
from penumbra.language import N_

SCENE = provenance.ROOT / "scenes" / "tp3.json"
LIBRARY = provenance.ROOT / "build" / "lib" / "libself_shadow.so"
PRECISIONS: dict[str, Any] = {"float32": np.float32, "float64": np.float64}
NOT_SENT, VISIBLE, OWN, OTHER = range(4)
"""C's enum Answer"""
STRATEGIES = ("fixed", "integer", "bounded", "skip")
"""(1) 1e-3 m along the normal; (2) Waechter and Binder's integer offset; (3) the smallest offset
that rounding cannot undo; (4) no offset, the surface that the ray leaves is not tested"""
JUDGED = ("rounding", *STRATEGIES)
"""rounding: the exact visibility from the stored hit point, the ray's own surface left out"""
TRANSLATIONS = (0.0, *(10.0**k for k in range(8)))
SCALES = tuple(10.0**k for k in range(-6, 7))
CONFIDENCE = 0.95
RAYS = 4096
MISTAKES = ("self_shadow", "light_leak", "other_shadow")
COLUMNS = (
    "precision", "scene", "translation", "scale", "strategy", "sent", "visible", "hidden",
    *(f"{m}{end}" for m in MISTAKES for end in ("", "_rate", "_low", "_high")),
)  # fmt: skip
DECLARATION = """
void self_shadow(const {real} *spheres, int nb_spheres, const {real} *planes, int nb_planes,
                 const {real} *quad, const {real} *camera, const {real} *rays, int nb_rays,
                 signed char *answers);
"""


@dataclass(frozen=True)
class AimedScene:
    """A scene of spheres, planes and one quad light, and where its camera rays aim."""

    name: str
    text: str
    spheres: np.ndarray
    """(n, 4) centre and radius"""
    planes: np.ndarray
    """(n, 6) point and normal"""
    quad: np.ndarray
    """(9,) corner, edge_u, edge_v"""
    camera: np.ndarray
    """(3,)"""
    aims: np.ndarray
    """(k, 9) parallelograms (corner and two edges) that camera rays aim at, uniformly"""

    def stored(
        self, precision: str, translation: float = 0.0, scale: float = 1.0
    ) -> tuple[np.ndarray, ...]:
        """Spheres, planes, quad and camera, times scale, then each coordinate plus translation,
        then rounded: from here on these numbers are the scene."""
        s, t = scale, translation
        place = np.array([t, t, t])
        spheres = np.column_stack([self.spheres[:, :3] * s + place, self.spheres[:, 3] * s])
        planes = np.column_stack([self.planes[:, :3] * s + place, self.planes[:, 3:]])
        quad = self.quad * s + np.concatenate([place, np.zeros(6)])
        camera = self.camera * s + place
        return tuple(
            np.ascontiguousarray(a, dtype=PRECISIONS[precision])
            for a in (spheres, planes, quad, camera)
        )

    def is_representable(self, precision: str, translation: float, scale: float) -> bool:
        """Whether its smallest length (a radius, a side of the light) is at least one unit in the
        last place of the translated coordinates: else there is no such scene any more.

        >>> ball = aimed_scenes()[4]
        >>> ball.name, [ball.is_representable("float32", t, 1.0) for t in (1e5, 1e6)]
        ('small', [True, False])
        """
        sides = np.linalg.norm(self.quad.reshape(3, 3)[1:], axis=1)
        smallest = min(self.spheres[:, 3].min(), sides.min())
        return bool(scale * smallest >= np.spacing(PRECISIONS[precision](translation)))

    def rays(self, precision: str, count: int, seed: int) -> np.ndarray:
        """(count, 5): direction of the camera ray, place on the light in [0, 1)^2.

        The same for every translation and scale; the numbers have 24 bits, as the renderer's.
        """
        rng = np.random.default_rng(seed)
        aim = self.aims[rng.integers(len(self.aims), size=count)]
        s, t = rng.random((2, count, 1))
        direction = aim[:, :3] + s * aim[:, 3:6] + t * aim[:, 6:] - self.camera
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        place = rng.integers(1 << 24, size=(count, 2)) / (1 << 24)
        rays = np.column_stack([direction, place]).astype(PRECISIONS[precision])
        return np.ascontiguousarray(rays)


CONTACT_AIMS = (
    ((-0.1, 0, 0), (0.2, 0, 0), (0, 0.002, 0)),
    ((-0.1, 0, -0.1), (0.2, 0, 0), (0, 0, 0.2)),
)
"""into the crevice between a ball of radius 1 and the floor below it, and at the floor around it"""


def aimed_scenes(lab: Scene | None = None) -> tuple[AimedScene, ...]:
    """The lab's scene as it is, and six that provoke, turned so that no coordinate is luckily
    exact. Lengths are in units that the scale multiplies."""
    return (
        _lab(lab or read_scene(SCENE)),
        _turned(
            "contact",
            N_("a ball on the floor, seen close to where they touch; the light stands beside them"),
            spheres=[(0, 1, 0, 1)],
            floor=True,
            quad=[(3, 0.1, -1), (0, 1, 0), (0, 0, 2)],
            camera=(0.1, 0.005, 1),
            aims=CONTACT_AIMS,
        ),
        _turned(
            "crevice",
            N_("the same, a hundred times closer"),
            spheres=[(0, 1, 0, 1)],
            floor=True,
            quad=[(3, 0.1, -1), (0, 1, 0), (0, 0, 2)],
            camera=(1e-3, 5e-7, 1e-2),
            aims=np.array(CONTACT_AIMS) * (1e-2, 1e-4, 1e-2),
        ),
        _turned(
            "below",
            N_("the same ball and floor, the light under the floor: nothing may be lit"),
            spheres=[(0, 1, 0, 1)],
            floor=True,
            quad=[(-1, -3, -1), (2, 0, 0), (0, 0, 2)],
            camera=(0.1, 0.005, 1),
            aims=CONTACT_AIMS,
        ),
        _turned(
            "small",
            N_("a ball of 1/100 on the floor under a light of 1/10"),
            spheres=[(0, 0.01, 0, 0.01)],
            floor=True,
            quad=[(0.05, 1, -0.05), (-0.1, 0, 0), (0, 0, 0.1)],
            camera=(0.3, 0.7, -1),
            aims=[[(-0.02, 0, -0.02), (0.04, 0, 0), (0, 0, 0.04)]],
        ),
        _turned(
            "grazing",
            N_("a low hill (the top of a ball sunk in the floor), its light standing on the floor"),
            spheres=[(0, -9.95, 0, 10)],
            floor=True,
            quad=[(4, 0, -1), (0, 0.1, 0), (0, 0, 2)],
            camera=(-1, 3, -2),
            aims=[[(-3, 0, -1.5), (6, 0, 0), (0, 0, 3)]],
        ),
        _turned(
            "inside",
            N_("camera, light and a ball that touches the wall, all inside a ball"),
            spheres=[(0, 0, 0, 3), (0, -2.5, 0, 0.5)],
            floor=False,
            quad=[(0.5, 2, -0.5), (-1, 0, 0), (0, 0, 1)],
            camera=(1, 1, -1.5),
            aims=[[(-3, -3, -3), (6, 0, 0), (0, 0, 6)], [(-1, -3, -1), (2, 0, 0), (0, 1, 2)]],
        ),
    )


def _lab(scene: Scene) -> AimedScene:
    """Its aims are the camera's image, one unit ahead."""
    c, light = scene.camera, scene.quad_lights[0]
    half = np.tan(np.radians(c.fov_y_deg) / 2)
    right = np.array(c.right) * half * scene.width / scene.height
    up = np.array(c.up) * half
    corner = np.array(c.position) + np.array(c.forward) - right - up
    return AimedScene(
        scene.name,
        N_("the lab's scene"),
        np.array([(*s.center, s.radius) for s in scene.spheres]),
        np.array([(*p.point, *p.normal) for p in scene.planes]),
        np.concatenate([light.corner, light.edge_u, light.edge_v]),
        np.array(c.position),
        np.concatenate([corner, 2 * right, 2 * up])[None],
    )


def _turned(
    name: str,
    text: str,
    spheres: Sequence[Sequence[float]],
    floor: bool,
    quad: Sequence[Sequence[float]],
    camera: Sequence[float],
    aims: ArrayLike,
) -> AimedScene:
    """floor: the plane y = 0 before turning."""
    turn = _turn()
    balls, sheets = np.array(spheres, dtype=float), np.asarray(aims, dtype=float)
    return AimedScene(
        name,
        text,
        np.column_stack([balls[:, :3] @ turn.T, balls[:, 3]]),
        np.concatenate([np.zeros(3), turn[:, 1]])[None] if floor else np.zeros((0, 6)),
        (np.array(quad) @ turn.T).ravel(),
        turn @ np.array(camera),
        (sheets @ turn.T).reshape(len(sheets), 9),
    )


def _turn() -> np.ndarray:
    """A rotation by 0.5, 0.3 and 0.7 rad about x, y and z: no axis stays near an axis."""
    matrix = np.eye(3)
    for axis, angle in enumerate((0.5, 0.3, 0.7)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one = np.eye(3)
        one[i, i] = one[j, j] = np.cos(angle)
        one[j, i], one[i, j] = np.sin(angle), -np.sin(angle)
        matrix = one @ matrix
    return matrix


def answers(
    scene: AimedScene, precision: str, translation: float, scale: float, count: int, seed: int
) -> np.ndarray:
    """(count, 6) of NOT_SENT, VISIBLE, OWN, OTHER: the truth, then JUDGED, for each ray.

    Raises MissingProgramError.
    """
    spheres, planes, quad, camera = scene.stored(precision, translation, scale)
    rays = scene.rays(precision, count, seed)
    ffi, library = _library(precision)
    result = np.zeros((count, 1 + len(JUDGED)), dtype=np.int8)
    real = "double *" if precision == "float64" else "float *"

    def pointer(array: np.ndarray, kind: str = real) -> Any:
        return ffi.cast(kind, array.ctypes.data)

    library.self_shadow(
        pointer(spheres), len(spheres), pointer(planes), len(planes), pointer(quad),
        pointer(camera), pointer(rays), count, pointer(result, "signed char *"),
    )  # fmt: skip
    return result


def counts(judged: np.ndarray) -> list[dict[str, Any]]:
    """`mistakes`, with their rates and Clopper-Pearson intervals.

    Rates are of the visible or the hidden rays; None where there are none.

    >>> counts(np.array([[1, 1, 2, 1, 1, 1], [3, 3, 1, 3, 3, 3]]))[1]["self_shadow_rate"]
    1.0
    """
    return _with_rates(mistakes(judged))


def mistakes(judged: np.ndarray) -> list[dict[str, Any]]:
    """From answers(): for each of JUDGED, how many shadow rays were sent, how many of them are
    truly visible and hidden, and its mistakes.

    self_shadow: truly visible, hidden by the surface that the ray leaves. light_leak: truly
    hidden, said to be visible. other_shadow: truly visible, hidden by another surface.
    """
    sent = judged[judged[:, 0] != NOT_SENT]
    visible = sent[:, 0] == VISIBLE
    rows = []
    for k, strategy in enumerate(JUDGED):
        said = sent[:, 1 + k]
        found = {
            "self_shadow": int((visible & (said == OWN)).sum()),
            "light_leak": int((~visible & (said == VISIBLE)).sum()),
            "other_shadow": int((visible & (said == OTHER)).sum()),
        }
        row: dict[str, Any] = {
            "strategy": strategy,
            "sent": len(sent),
            "visible": int(visible.sum()),
        }
        row["hidden"] = row["sent"] - row["visible"]
        rows.append(row | found)
    return rows


def _with_rates(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    result = [dict(row) for row in rows]
    for mistake in MISTAKES:
        of = "hidden" if mistake == "light_leak" else "visible"
        n, k = (np.array([row[name] for row in rows]) for name in (of, mistake))
        low, high = proportion_interval(k, n)
        for i in range(len(rows)):
            values = (k[i] / n[i], low[i], high[i]) if n[i] else (None, None, None)
            for name, value in zip(("rate", "low", "high"), values, strict=True):
                result[i][f"{mistake}_{name}"] = None if value is None else float(value)
    return result


def proportion_interval(
    successes: np.ndarray | int, trials: np.ndarray | int, confidence: float = CONFIDENCE
) -> tuple[np.ndarray, np.ndarray]:
    """Clopper and Pearson's interval of a probability (Biometrika 26, 1934): it holds the truth
    at least as often as `confidence` says. [0, 1] for no trials.

    >>> [round(float(end), 4) for end in proportion_interval(0, 100)]
    [0.0, 0.0362]
    """
    tail = (1 - confidence) / 2
    k, n = np.asarray(successes, dtype=float), np.asarray(trials, dtype=float)
    low = stats.beta.ppf(tail, k, n - k + 1)
    high = stats.beta.isf(tail, k + 1, n - k)
    return np.where(k > 0, low, 0.0), np.where(k < n, high, 1.0)


def self_shadow_map(
    rays: int = RAYS,
    translations: Sequence[float] = TRANSLATIONS,
    scales: Sequence[float] = SCALES,
    precisions: Sequence[str] = tuple(PRECISIONS),
    seed: int = 1,
) -> list[dict[str, Any]]:
    """Rows of COLUMNS: each of JUDGED in each scene, at each precision, translation and scale
    at which the scene is representable; scene "all" is their sum.

    rays: camera rays, each with one shadow ray, of each scene. The same rays everywhere.
    Raises MissingProgramError.
    """
    rows: list[dict[str, Any]] = []
    scenes = aimed_scenes()
    cells = list(itertools.product(precisions, translations, scales))
    for precision, translation, scale in tqdm(cells, desc="self-shadow", disable=None):
        where = {"precision": precision, "translation": translation, "scale": scale}
        one = [
            row | where | {"scene": scene.name}
            for scene in scenes
            if scene.is_representable(precision, translation, scale)
            for row in mistakes(answers(scene, precision, translation, scale, rays, seed))
        ]
        rows += one
        if one:
            rows += [row | where | {"scene": "all"} for row in _summed(one)]
    return _with_rates(rows)


def _summed(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a strategy."""
    result = []
    for strategy in JUDGED:
        same = [row for row in rows if row["strategy"] == strategy]
        total = {k: sum(row[k] for row in same) for k in ("sent", "visible", "hidden", *MISTAKES)}
        result.append({"strategy": strategy} | total)
    return result


def verdict(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each precision and strategy, over all scenes, translations and scales.

    The mistakes and their rates; wrong_rate, the share of all shadow rays that it answers
    wrongly; in how many cells of the map another strategy makes fewer mistakes; and whether it
    wins: fewest wrong answers in all."""
    result: list[dict[str, Any]] = []
    for precision in dict.fromkeys(row["precision"] for row in rows):
        cells = [r for r in rows if r["precision"] == precision and r["scene"] == "all"]
        least: dict[tuple[float, float], int] = {}
        for row in cells:
            if row["strategy"] in STRATEGIES:
                place = row["translation"], row["scale"]
                least[place] = min(_wrong(row), least.get(place, row["sent"]))
        totals = _summed(cells)
        fewest = min(_wrong(t) for t in totals if t["strategy"] in STRATEGIES)
        for total in totals:
            own = [r for r in cells if r["strategy"] == total["strategy"]]
            beaten = sum(_wrong(r) > least[r["translation"], r["scale"]] for r in own)
            extra = {
                "precision": precision,
                "wrong_rate": _wrong(total) / total["sent"],
                "cells": len(own),
                "cells_beaten": beaten,
                "wins": total["strategy"] in STRATEGIES and _wrong(total) == fewest,
            }
            result.append(total | extra)
    return _with_rates(result)


def verdict_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The verdict in sentences, best first."""
    return [
        f"{row['precision']} {row['strategy']}: {row['wrong_rate']:.3%} of {row['sent']} rays "
        f"wrong ({row['self_shadow']} self-shadowed, {row['light_leak']} leaks, "
        f"{row['other_shadow']} hidden by another surface)" + (": wins" if row["wins"] else "")
        for row in sorted(rows, key=lambda row: (row["precision"], row["wrong_rate"]))
    ]


def _wrong(row: dict[str, Any]) -> int:
    return int(sum(row[mistake] for mistake in MISTAKES))


def write_map(out: Path, rays: int = RAYS) -> dict[str, Any]:
    """Measure the whole map; write out.csv (COLUMNS) and out.json (the verdict and how to make
    it again), which is returned. Raises MissingProgramError, OSError."""
    rows = self_shadow_map(rays)
    result = {
        "rays": rays,
        "confidence": CONFIDENCE,
        "translations": TRANSLATIONS,
        "scales": SCALES,
        "scenes": {scene.name: scene.text for scene in aimed_scenes()},
        "verdict": verdict(rows),
        **provenance.origin(),
    }
    write_csv(out.with_name(out.name + ".csv"), COLUMNS, rows)
    write_json(out.with_name(out.name + ".json"), result)
    return result


@cache
def _library(precision: str) -> tuple[cffi.FFI, Any]:
    ffi, library = load(build_of(LIBRARY, precision))
    ffi.cdef(DECLARATION.format(real="double" if precision == "float64" else "float"))
    return ffi, library
