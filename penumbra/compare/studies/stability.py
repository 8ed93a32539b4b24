"""Where floats break: scenes at the extremes, in float32 and float64, against yardsticks.

A sweep changes one number of a small scene, over many decades. Sampled images are compared with
compare.studies.yardstick's (the same points, so that only rounding differs), noise-free ones with
compare.exact.image's. The images are tiny: what breaks, breaks in every pixel.
"""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise as pairwise_of
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import read_image
from penumbra.compare.run import provenance
from penumbra.compare.run.library import PRECISIONS, PROGRAM, PixelRenderer, Setting, WarmRenderer
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.run.renderers import RendererError
from penumbra.compare.scene import read_scene
from penumbra.compare.studies import yardstick
from penumbra.compare.studies.extremes import (
    HEIGHT,
    SWEEPS,
    WIDTH,
    Scene,
    Sweep,
    decades,
    light_of_side,
    translated,
)

LIGHT_SAMPLES, SEED = 16, 1
LIMITS = (1e-4, 1e-2)
"""Relative errors whose crossing is marked: what a comparison notices, what an eye notices."""
ESTIMATORS = ("area", "textbook", "exact")
"""area: the program's own, float32; the two others pixel by pixel in both precisions."""


MAP_RATIOS, MAP_TRANSLATIONS = decades(-6, 6), (0.0, *decades(0, 7))


# ---- measuring


@dataclass(frozen=True)
class Row:
    """One image of a sweep."""

    sweep: str
    value: float
    estimator: str
    precision: str
    relative_error: float
    """RMS of the difference over RMS of the yardstick; 1 where only one of the two is dark"""
    mean: float
    """of the yardstick [W m^-2 sr^-1]"""
    nan: int
    inf: int
    negative: int


def measure(
    sweep: str, value: float, scene: Scene, folder: Path, estimators: Sequence[str] = ESTIMATORS
) -> list[Row]:
    """The scene in these estimators and both precisions ("area" in float32 only).

    Raises MissingProgramError, RendererError.
    """
    file = folder / f"{sweep}_{value:.6g}.json"
    file.write_text(json.dumps(scene, indent=1) + "\n")
    sampled = yardstick.image(scene, LIGHT_SAMPLES, SEED)
    exact = exact_image(read_scene(file)).radiance if "exact" in estimators else sampled
    rows = []
    for precision in PRECISIONS:
        by_pixel = PixelRenderer(file, precision)
        for estimator in estimators:
            if estimator != "area":
                found = by_pixel.render(estimator, LIGHT_SAMPLES, SEED)
            elif precision == PRECISIONS[0]:
                found = program_image(file)
            else:
                continue
            truth = exact if estimator == "exact" else sampled
            rows.append(
                Row(
                    sweep, value, estimator, precision, relative_error(found, truth),
                    float(truth.mean()), int(np.isnan(found).sum()), int(np.isinf(found).sum()),
                    int((found < 0).sum()),
                )
            )  # fmt: skip
    return rows


def program_image(
    file: Path, estimator: str = "area", light_samples: int = LIGHT_SAMPLES, seed: int = SEED
) -> np.ndarray:
    """(H, W, 3) of build/bin/penumbra-render's own loops, through its library."""
    warm = WarmRenderer(file, WIDTH, HEIGHT)
    warm.render(Setting("independent", estimator, light_samples, 1), seed)
    return warm.radiance.transpose(1, 2, 0).copy()


def relative_error(image: np.ndarray, reference: np.ndarray) -> float:
    """RMS(image - reference) / RMS(reference), at most 1: beyond, nothing is left of the image.

    >>> relative_error(np.array([1.1, 1.0]), np.array([1.0, 1.0])).__round__(3)
    0.071
    >>> relative_error(np.zeros(2), np.zeros(2))
    0.0
    """
    scale = np.abs(reference).max()
    if scale == 0:
        return float(np.any(image != 0))
    difference = (np.asarray(image, np.longdouble) - reference) / scale
    ratio = np.sqrt((difference**2).mean() / ((reference / scale) ** 2).mean())
    return float(min(ratio, 1.0)) if np.isfinite(ratio) else 1.0


# ---- the map: light size over distance, against translation


def map_rows(folder: Path, every: int = 1) -> Iterator[dict[str, float]]:
    """The area estimator's relative error for each ratio and translation, in both precisions.

    Raises MissingProgramError, RendererError.
    """
    points = list(product(MAP_RATIOS[::every], MAP_TRANSLATIONS[::every]))
    for ratio, by in tqdm(points, disable=None, unit="scene", desc="map"):
        scene = translated(light_of_side(ratio), by)
        rows = measure("map", ratio, scene, folder, ("area", "textbook"))
        errors = {(r.estimator, r.precision): r.relative_error for r in rows}
        yield {
            "ratio": ratio,
            "translation": by,
            "float32": errors["area", "float32"],
            "float64": errors["textbook", "float64"],
        }


# ---- trust: the noise of a light that is near


def trust_rows(
    folder: Path, heights: Sequence[float], counts: Sequence[int], seeds: int
) -> Iterator[dict[str, Any]]:
    """A light of 1 m at height h: the RMS error over seeds of N samples, spread over the area or
    over the solid angle, against the exact solution; and the share of pixels that the program
    says not to trust. Raises MissingProgramError, RendererError."""
    points = list(product(heights, counts, ("area", "solid-angle")))
    for height, count, estimator in tqdm(points, disable=None, unit="setting", desc="trust"):
        file = folder / f"trust_{height:.6g}.json"
        file.write_text(json.dumps(light_of_side(1, height), indent=1) + "\n")
        exact = exact_image(read_scene(file)).radiance
        warm = WarmRenderer(file, WIDTH, HEIGHT)
        squares = []
        for seed in range(1, seeds + 1):
            warm.render(Setting("independent", estimator, count, 1), seed)
            squares.append((warm.radiance.transpose(1, 2, 0) - exact) ** 2)
        yield {
            "height": height,
            "light_samples": count,
            "estimator": estimator,
            "relative_rmse": float(np.sqrt(np.mean(squares) / (exact**2).mean())),
            "untrusted": untrusted_share(file, estimator, count),
        }


def untrusted_share(file: Path, estimator: str, light_samples: int) -> float:
    """Of the pixels, as the program's header says. Raises RendererError."""
    out = file.with_suffix(".exr")
    command = [str(PROGRAM), str(file), "-o", str(out), "--estimator", estimator]
    command += ["--light-samples", str(light_samples)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    if done.returncode != 0:
        raise RendererError(f"{PROGRAM}: {done.stderr.strip()}")
    return float(read_image(out).attributes["untrustedPixels"]) / (WIDTH * HEIGHT)


# ---- accumulation: summing N samples


def naive(values: np.ndarray) -> np.ndarray:
    """(P,) float32: one after the other. values: (N, P) float32."""
    return np.asarray(np.add.accumulate(values)[-1])  # reduce may add pairs instead


def compensated(values: np.ndarray) -> np.ndarray:
    """Kahan, "Further remarks on reducing truncation errors", CACM 8(1), 1965."""
    total, lost = np.zeros((2, values.shape[1]), np.float32)
    for value in values:
        corrected = value - lost
        larger = total + corrected
        lost = (larger - total) - corrected
        total = larger
    return total


def pairwise(values: np.ndarray) -> np.ndarray:
    while len(values) > 1:
        if len(values) % 2:
            values = np.vstack([values, np.zeros_like(values[:1])])
        values = values[::2] + values[1::2]
    return np.asarray(values[0])


def chunked(values: np.ndarray) -> np.ndarray:
    """The renderer's: 256 in float32, one after the other, which then join a float64."""
    total = np.zeros(values.shape[1])
    for start in range(0, len(values), 256):
        total += naive(values[start : start + 256])
    return total


def in_double(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.sum(axis=0, dtype=np.float64))


SUMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "naive": naive,
    "pairwise": pairwise,
    "compensated": compensated,
    "chunks": chunked,
    "double": in_double,
}


def accumulation_rows(counts: Sequence[int], pixels: int = 16) -> Iterator[dict[str, Any]]:
    """RMS relative error of each sum of N light samples, float32 terms as they are, against
    their sum in extended precision."""
    rng = np.random.default_rng(SEED)
    s, t = rng.random((2, max(counts), pixels)) - 0.5
    terms = (1 / (1 + s**2 + t**2) ** 2).astype(np.float32)  # a light of 1 m, 1 m above
    for count, (name, add) in product(tqdm(counts, disable=None, desc="sums"), SUMS.items()):
        truth = terms[:count].sum(axis=0, dtype=np.longdouble)
        error = (add(terms[:count]) - truth) / truth
        yield {
            "sum": name,
            "light_samples": count,
            "relative_error": float(np.sqrt(np.mean(error**2))),
        }


# ---- the study


def study(out: Path, budget: str = "full") -> dict[str, Any]:
    """Measure everything and write OUT.csv (a row an image), OUT.json (all else) and the scenes
    that pass a limit, OUT_scenes/*.json. budget: "full" or "small", fewer values.

    Raises MissingProgramError, RendererError, OSError.
    """
    every = {"full": 1, "small": 3}[budget]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        points = [(s, v) for s in SWEEPS for v in _thinned(s.values, every)]
        rows = []
        for sweep, value in tqdm(points, disable=None, unit="scene", desc="sweeps"):
            rows += measure(sweep.name, value, sweep.build(value), folder)
        heights = decades(-7, 0)[:: 2 * every - 1]
        counts = (16, 64, 256, 1024, 4096)[::every]
        trust = list(trust_rows(folder, heights, counts, 16 // every))
        cells = list(map_rows(folder, every))
    sums = list(accumulation_rows([1 << k for k in range(0, 21 if every == 1 else 13, 2)]))
    scenes = out.with_name(out.name + "_scenes")
    scenes.mkdir(parents=True, exist_ok=True)
    result = {
        "limits": LIMITS,
        "light_samples": LIGHT_SAMPLES,
        "seed": SEED,
        "size": [WIDTH, HEIGHT],
        "budget": budget,
        **provenance.origin(),
        "images": len(rows),
        "nan": sum(r.nan for r in rows),
        "inf": sum(r.inf for r in rows),
        "negative": sum(r.negative for r in rows),
        "sweeps": [_summary(s, [r for r in rows if r.sweep == s.name], scenes) for s in SWEEPS],
        "map": cells,
        "trust": trust,
        "sums": sums,
    }
    written = [asdict(row) for row in rows]
    write_csv(out.with_suffix(".csv"), list(written[0]), written)
    write_json(out.with_suffix(".json"), result)
    return result


def _thinned(values: tuple[float, ...], every: int) -> tuple[float, ...]:
    """Each so many-th value, both ends and 0 among them.

    >>> _thinned((-2.0, -1.0, 0.0, 1.0, 2.0, 3.0), 3)
    (-2.0, 0.0, 1.0, 3.0)
    """
    return tuple(
        v for i, v in enumerate(values) if i % every == 0 or v == 0 or i == len(values) - 1
    )


def _summary(sweep: Sweep, rows: list[Row], scenes: Path) -> dict[str, Any]:
    curves = [
        _curve(e, p, [r for r in rows if (r.estimator, r.precision) == (e, p)])
        for p in PRECISIONS
        for e in ESTIMATORS
        if any((r.estimator, r.precision) == (e, p) for r in rows)
    ]
    return {
        "name": sweep.name,
        "title": sweep.title,
        "parameter": sweep.parameter,
        "failure": sweep.failure,
        "text": sweep.text,
        "curves": curves,
        "example": _example(sweep, curves[0], scenes),
    }


def _curve(estimator: str, precision: str, rows: list[Row]) -> dict[str, Any]:
    values, errors = [r.value for r in rows], [r.relative_error for r in rows]
    return {
        "estimator": estimator,
        "precision": precision,
        "values": values,
        "errors": errors,
        "crossings": {f"{limit:g}": crossings(values, errors, limit) for limit in LIMITS},
    }


def crossings(values: Sequence[float], errors: Sequence[float], limit: float) -> list[float]:
    """Values between which the error passes the limit, interpolated on logarithmic axes; where
    that cannot be done (0, or another sign) the one of the two that is beyond the limit.

    >>> [round(v, 6) for v in crossings([1.0, 10.0, 100.0], [1e-7, 1e-5, 1e-3], 1e-4)]
    [31.622777]
    """
    found = []
    for (a, x), (b, y) in pairwise_of(list(zip(values, errors, strict=True))):
        if (x > limit) == (y > limit):
            continue
        if a * b > 0 and x > 0 and y > 0:
            share = math.log(limit / x) / math.log(y / x)
            found.append(math.copysign(abs(a) ** (1 - share) * abs(b) ** share, a))
        else:
            found.append(a if x > limit else b)
    return found


def _example(sweep: Sweep, curve: dict[str, Any], scenes: Path) -> dict[str, Any]:
    """The mildest scene beyond the larger limit; if there is none, beyond the smaller; if there
    is none, the worst."""
    pairs = [(e, v) for e, v in zip(curve["errors"], curve["values"], strict=True)]
    chosen = max(pairs)
    for limit in LIMITS:
        beyond = [pair for pair in pairs if pair[0] > limit]
        chosen = min(beyond) if beyond else chosen
    error, value = chosen
    scene = sweep.build(value)
    file = scenes / f"{sweep.name}_{value:g}.json"
    write_json(file, scene)
    command = (
        f"build/bin/penumbra-render {file} -o {sweep.name}.exr "
        f"--light-samples {LIGHT_SAMPLES} --seed {SEED}"
    )
    return {
        "value": value,
        "error": error,
        "file": str(file),
        "scene": scene,
        "commands": [command, command.replace("penumbra-render", "penumbra-render-float64")],
    }
