"""Error against the number of light samples: render, measure, fit, for any renderer."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from penumbra.compare.exact import image as exact
from penumbra.compare.measure import metrics
from penumbra.compare.measure.agreement import ROUNDING
from penumbra.compare.measure.image import Image, ImageError, read_image
from penumbra.compare.measure.slope import Slope, fit_slope, rmse_interval
from penumbra.compare.run import provenance
from penumbra.compare.run.errands import rendered_elsewhere
from penumbra.compare.run.journal import Journal
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.run.renderers import Job, Renderer, RendererError
from penumbra.compare.run.tasks import Scheduler
from penumbra.compare.scene import Scene, read_scene

LIGHT_SAMPLES = tuple(2**i for i in range(13))
"""1 to 4096"""
SEEDS = 4
"""Images for each N. tp3's slopes are then known to +-0.002; more only narrows that."""
WIDTH = 300
"""Largest default width [pixels]: half the lab's, a quarter of the time."""
MAX_SHADOW_RAYS = 1024
"""Largest N x M, the shadow rays of a pixel to one light, for M > 1 by default."""
PIXEL_GRID = 4
"""Positions along a pixel's side that the anti-aliased truth is the mean of (exact_image)."""
FLOOR = 4.0
"""An error is used for slopes if its square is this many times what the truth or the file's
rounding may account for: the RMSE is then overstated by no more than 12%."""
CONFIDENCE = 0.95

MEASURES = ("relative_bias", "mse", "rmse", "relative_rmse", "rel_mse", "mae")
AGAINST_CYCLES = ("mse_against_cycles", "relative_rmse_against_cycles")
COLUMNS = (
    *("scene", "renderer", "width", "height", "light_samples", "pixel_samples", "seed"),
    *("region", "pixels", "seconds"),
    *MEASURES,
    *AGAINST_CYCLES,
)


class ConvergenceError(ValueError):
    """A study that cannot be made; the text names the option or the file."""


@dataclass(frozen=True)
class Curve:
    """One renderer and the numbers of samples to run it with."""

    renderer: Renderer
    light_samples: tuple[int, ...] = LIGHT_SAMPLES
    pixel_samples: tuple[int, ...] = (1,)

    def pairs(self, max_shadow_rays: int) -> list[tuple[int, int]]:
        """(M, N), without those of M > 1 that take more than max_shadow_rays."""
        return [
            (m, n)
            for m in self.pixel_samples
            for n in self.light_samples
            if m == 1 or m * n <= max_shadow_rays
        ]


@dataclass(frozen=True)
class ConvergenceStudy:
    """All that decides a convergence study.

    Width and height: those given, else the reference's, else the scene's, brought down to
    WIDTH if every renderer takes {width} and {height}.
    """

    scene_file: Path
    out: Path
    """without suffix: <out>.csv and <out>.json are written, <out>.journal meanwhile"""
    curves: tuple[Curve, ...]
    seeds: int = SEEDS
    width: int | None = None
    height: int | None = None
    reference: Path | None = None
    """Cycles EXR with variance channels; images of one pixel sample are compared with it"""
    max_shadow_rays: int = MAX_SHADOW_RAYS
    pixel_grid: int = PIXEL_GRID
    keep_images: bool = False
    """move the images to <out>_images/"""

    def file(self, suffix: str) -> Path:
        return self.out.with_name(self.out.name + suffix)


def converge(study: ConvergenceStudy, scheduler: Scheduler | None = None) -> dict[str, Any]:
    """Render, measure and fit; write <out>.csv and <out>.json; return what the JSON holds.

    Every image has a seed of its own, so errors are independent between one N and another,
    which the slope's interval needs. A run that was killed goes on from <out>.journal; lines
    of another scene, size, renderer binary, reference or version of compare/ are not used.

    With a scheduler its workers render, one image at a time on each machine, and what they send is
    measured here: all but the seconds is the same as without. The journal stays, so that the same
    study once more costs nothing.

    Raises SceneError, ImageError, ConvergenceError, JournalError, RendererError,
    MissingProgramError, OSError; with a scheduler what run_tasks() raises too.
    """
    solved = _SolvedScene(study)
    for curve in study.curves:
        _check_curve(curve, solved, study)
    fingerprints = [solved.fingerprint(curve.renderer) for curve in study.curves]
    with Journal(study.file(".journal")) as journal, _scratch(study) as scratch:
        measured = [
            (curve, _measure_curve(curve, solved, fingerprint, journal, scratch, scheduler))
            for curve, fingerprint in zip(study.curves, fingerprints, strict=True)
        ]
        rows = [row for curve, images in measured for row in _rows(solved, curve, images)]
        result = _summary(solved, rows, measured)
        write_csv(study.file(".csv"), COLUMNS, rows)
        write_json(study.file(".json"), result)
        if scheduler is None:
            journal.delete()
    return result


@dataclass(frozen=True)
class _Truth:
    """What images of one pixel sample, or of several, are measured against."""

    radiance: np.ndarray
    """(H, W, 3)"""
    regions: dict[str, np.ndarray]
    """name -> (H, W) bool"""
    error_bound: np.ndarray
    """(H, W) bound on the error of radiance's largest channel"""

    def region_floor(self, region: str) -> float:
        """MSE that the truth's own error may account for."""
        mask = self.regions[region]
        return mse_floor(self.radiance, self.error_bound, mask)


def mse_floor(radiance: np.ndarray, error_bound: np.ndarray, mask: np.ndarray) -> float:
    """MSE that float32 and the truth's own error may account for.

    radiance (H, W, 3), error_bound (H, W): of the truth; mask: (H, W) bool, a region.
    """
    rounding = ROUNDING * float(radiance.max())
    return float(np.mean((error_bound[mask] + rounding) ** 2))


class _SolvedScene:
    """A study's scene and truths, read and solved once."""

    def __init__(self, study: ConvergenceStudy) -> None:
        self.study = study
        self.scene: Scene = read_scene(study.scene_file)
        self.reference: Image | None = None
        if study.reference is not None:
            self.reference = _read_reference(study.reference, self.scene)
        self.width, self.height = self._size()

    @cached_property
    def centre(self) -> _Truth:
        """One position a pixel."""
        return self._truth(1)

    @cached_property
    def area(self) -> _Truth:
        """The mean over the pixel."""
        return self._truth(self.study.pixel_grid)

    def truth(self, pixel_samples: int) -> _Truth:
        return self.centre if pixel_samples == 1 else self.area

    def reference_noise(self, region: str) -> tuple[float, float]:
        """Mean variance of the reference over a region, and the standard error of what is
        left of a squared difference once it is subtracted.

        With normal noise of variance s^2 in the mean of p parts, (R - T)^2 - s^2 has the
        variance 2 s^4 (1 + 1 / (p - 1)), the second term being the variance of the estimate
        of s^2. Channels see the same light samples: they count as one draw.
        """
        assert self.reference is not None and self.reference.variance is not None
        variance = self.reference.variance[self.centre.regions[region]]
        parts = max(2, int(self.reference.attributes.get("parts", 2)))
        spread = 2 * (1 + 1 / (parts - 1)) * np.sum(variance.sum(axis=-1) ** 2)
        return float(variance.mean()), float(np.sqrt(spread)) / variance.size

    def fingerprint(self, renderer: Renderer) -> str:
        """Changes whenever a row measured before may be wrong now."""
        files = sorted((provenance.ROOT / "penumbra" / "compare").rglob("*.py"))
        if self.study.reference is not None:
            files.append(self.study.reference)
        parts = (
            self.scene.hash,
            f"{self.width}x{self.height}",
            str(self.study.pixel_grid),
            provenance.file_hash(*files),
            renderer.label,
            renderer.fingerprint(),
        )
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def _truth(self, pixel_grid: int) -> _Truth:
        solved = exact.exact_image(self.scene, self.width, self.height, pixel_grid)
        regions = exact.regions(self.scene, solved)
        return _Truth(solved.radiance, regions, solved.error_bound)

    def _size(self) -> tuple[int, int]:
        study, scene = self.study, self.scene
        if (study.width is None) != (study.height is None):
            raise ConvergenceError("--width and --height go together")
        if study.width is not None and study.height is not None:
            size = study.width, study.height
        elif self.reference is not None:
            size = self.reference.shape[1], self.reference.shape[0]
        elif all({"width", "height"} <= c.renderer.placeholders for c in study.curves):
            width = min(WIDTH, scene.width)
            size = width, max(1, round(scene.height * width / scene.width))
        else:
            size = scene.width, scene.height
        if self.reference is not None and self.reference.shape != (size[1], size[0]):
            height, width = self.reference.shape
            raise ConvergenceError(
                f"{study.reference}: is {width}x{height}, not {size[0]}x{size[1]}: "
                "leave --width and --height out, or render a reference of that size"
            )
        return size


def _read_reference(file: Path, scene: Scene) -> Image:
    reference = read_image(file)
    if reference.variance is None:
        raise ConvergenceError(
            f"{file}: has no variance channels, so its noise cannot be subtracted; "
            "make it with `penumbra reference`"
        )
    if reference.attributes.get("sceneHash") != scene.hash:
        raise ConvergenceError(f"{file}: shows another scene than {scene.name} ({scene.hash})")
    return reference


def _check_curve(curve: Curve, solved: _SolvedScene, study: ConvergenceStudy) -> None:
    label, takes = curve.renderer.label, curve.renderer.placeholders
    if [c.renderer.label for c in study.curves].count(label) > 1:
        raise ConvergenceError(f"two renderers are labelled {label}: set --label")
    if study.seeds < 1:
        raise ConvergenceError("--seeds must be 1 or more")
    if max(curve.pixel_samples) > 1 and "pixel_samples" not in takes:
        raise ConvergenceError(f"{label}: --pixel-samples needs {{pixel_samples}} in the command")
    own_size = (solved.width, solved.height) == (solved.scene.width, solved.scene.height)
    if not own_size and not {"width", "height"} <= takes:
        raise ConvergenceError(
            f"{label}: to render {solved.width}x{solved.height} the command needs {{width}} and "
            "{height}"
        )
    if not curve.pairs(study.max_shadow_rays):
        raise ConvergenceError(
            f"{label}: every N x M is above --max-shadow-rays {study.max_shadow_rays}"
        )


@dataclass(frozen=True)
class _Measured:
    """One image, measured."""

    light_samples: int
    pixel_samples: int
    seed: int
    values: dict[str, Any]
    """{"seconds", "clock", "software", "machine" if it was another,
    "regions": {region: {measure: number or None}},
    "rounding": {region: MSE that the file's rounding accounts for}}"""


def _jobs(curve: Curve, solved: _SolvedScene) -> list[Job]:
    """Seeds 1, 2, 3, ...: small, since some renderers take them as a C int."""
    study = solved.study
    pairs = curve.pairs(study.max_shadow_rays)
    images = [(m, n) for m, n in pairs for _ in range(study.seeds)]
    return [
        Job(study.scene_file, solved.width, solved.height, n, m, seed)
        for seed, (m, n) in enumerate(images, start=1)
    ]


def _measure_curve(
    curve: Curve,
    solved: _SolvedScene,
    fingerprint: str,
    journal: Journal,
    scratch: Path,
    scheduler: Scheduler | None,
) -> list[_Measured]:
    """Every image of a curve: from the journal, or rendered now."""
    renderer = curve.renderer
    jobs = _jobs(curve, solved)
    keys = {job: f"{fingerprint} {job.name}" for job in jobs}
    missing = [job for job in jobs if journal.get(keys[job]) is None]
    with tqdm(
        total=sum(_work(job) for job in jobs),
        initial=sum(_work(job) for job in jobs if job not in missing),
        desc=renderer.label,
        unit="spp",
        unit_scale=True,
        disable=None,
        file=sys.stderr,
    ) as bar:
        for job, file, seconds, machine in _images(
            renderer, missing, scratch, solved.study.seeds, scheduler
        ):
            try:
                values = _measure(job, file, seconds, solved) | machine
            except ImageError as error:
                raise RendererError(f"{renderer.label}: {error}") from error
            journal.append(keys[job], values)
            _put_away(file, solved.study)
            bar.update(_work(job))
    return [
        _Measured(job.light_samples, job.pixel_samples, job.seed, journal.get(keys[job]) or {})
        for job in jobs
    ]


def _images(
    renderer: Renderer, jobs: list[Job], scratch: Path, seeds: int, scheduler: Scheduler | None
) -> Iterator[tuple[Job, Path, float, dict[str, Any]]]:
    """Each job with its image, a file in scratch, the seconds, and the machine if not this one."""
    if scheduler is None:
        for job, file, seconds in renderer.render(jobs, scratch):
            yield job, file, seconds, {}
        return
    for job, image in rendered_elsewhere(renderer, jobs, scheduler, together=seeds):
        file = scratch / image.file_name
        file.write_bytes(image.content)
        yield job, file, image.seconds, {"machine": image.machine}


def _work(job: Job) -> int:
    return job.light_samples * job.pixel_samples


def _put_away(image: Path, study: ConvergenceStudy) -> None:
    if study.keep_images:
        folder = study.file("_images")
        folder.mkdir(exist_ok=True)
        image.replace(folder / image.name)
    else:
        image.unlink()


def _measure(job: Job, file: Path, wall_seconds: float, solved: _SolvedScene) -> dict[str, Any]:
    """Measures of one image by region.

    Time is the header's renderSeconds where the image has it, else the command's wall time.
    An image of few bits is measured against the truth within what it can say.
    """
    image = read_image(file)
    if image.shape != (solved.height, solved.width):
        raise ImageError(
            f"{file.name}: is {image.shape[1]}x{image.shape[0]}, not {solved.width}x{solved.height}"
        )
    truth = solved.truth(job.pixel_samples)
    half = np.broadcast_to(np.expand_dims(image.rounding, -1), truth.radiance.shape)
    radiance = np.maximum(truth.radiance, half)
    if image.clipped:
        radiance = np.where(radiance >= 1, 1 + half, radiance)
    # A third of half a step squared, where a channel is not simply black or white.
    is_rounded = (truth.radiance > 0) & ~(image.clipped & (truth.radiance >= 1))
    squared = np.where(is_rounded, half**2, 0) / 3
    regions = {}
    for region, mask in truth.regions.items():
        values = {
            name: _finite(metrics.NUMBERS[name](image.radiance, radiance, mask))
            for name in MEASURES
        }
        values["pixels"] = int(mask.sum())
        if solved.reference is not None and job.pixel_samples == 1:
            values |= _measure_against_cycles(image, solved, region)
        regions[region] = values
    return {
        "seconds": float(image.attributes.get("renderSeconds", wall_seconds)),
        "clock": "rendering" if "renderSeconds" in image.attributes else "whole command",
        "software": str(image.attributes.get("software", "")),
        "regions": regions,
        "rounding": {name: float(squared[mask].mean()) for name, mask in truth.regions.items()},
    }


def _measure_against_cycles(
    image: Image, solved: _SolvedScene, region: str
) -> dict[str, float | None]:
    """E[(image - reference)^2] is the image's own MSE plus the reference's variance."""
    assert solved.reference is not None
    mask = solved.centre.regions[region]
    reference = solved.reference.radiance
    noise, _ = solved.reference_noise(region)
    mse = metrics.mse(image.radiance, reference, mask) - noise
    square = float(np.mean(reference[mask] ** 2))
    relative = math.sqrt(mse / square) if mse >= 0 and square > 0 else None
    return {"mse_against_cycles": mse, "relative_rmse_against_cycles": relative}


def _finite(value: float) -> float | None:
    """None for the relative error of something that should be black."""
    return value if math.isfinite(value) else None


def _rows(solved: _SolvedScene, curve: Curve, images: Iterable[_Measured]) -> list[dict[str, Any]]:
    """The tidy table, one row an image and region."""
    rows = []
    for image in images:
        for region, values in image.values["regions"].items():
            rows.append(
                {
                    "scene": solved.scene.name,
                    "renderer": curve.renderer.label,
                    "width": solved.width,
                    "height": solved.height,
                    "light_samples": image.light_samples,
                    "pixel_samples": image.pixel_samples,
                    "seed": image.seed,
                    "region": region,
                    "seconds": image.values["seconds"],
                    **values,
                }
            )
    return rows


def _summary(
    solved: _SolvedScene,
    rows: Sequence[dict[str, Any]],
    measured: Sequence[tuple[Curve, list[_Measured]]],
) -> dict[str, Any]:
    """What <out>.json holds: provenance, slopes, and the curves with their intervals."""
    study = solved.study
    renderers = {
        curve.renderer.label: {
            "command": curve.renderer.command,
            "software": images[-1].values["software"],
            "seconds": images[-1].values["clock"],
        }
        for curve, images in measured
    }
    rounding = {
        (curve.renderer.label, image.pixel_samples, region): mse
        for curve, images in measured
        for image in images
        for region, mse in image.values["rounding"].items()
    }
    fits = _Fits(solved, rows, rounding)
    machines = {
        json.dumps(image.values["machine"], sort_keys=True): image.values["machine"]
        for _, images in measured
        for image in images
        if "machine" in image.values
    }
    return {
        "scene": solved.scene.name,
        "scene_hash": solved.scene.hash,
        "width": solved.width,
        "height": solved.height,
        "seeds": study.seeds,
        "pixel_grid": study.pixel_grid,
        "reference": None if study.reference is None else str(study.reference),
        **provenance.origin(),
        **({"machines": [machines[key] for key in sorted(machines)]} if machines else {}),
        "renderers": renderers,
        "slopes": fits.slopes,
        "without_slope": fits.without_slope,
        "curves": fits.curves,
    }


class _Fits:
    """Slopes and curves of every (renderer, pixel samples, region, truth)."""

    def __init__(
        self,
        solved: _SolvedScene,
        rows: Sequence[dict[str, Any]],
        rounding: Mapping[tuple[str, int, str], float],
    ) -> None:
        self.solved = solved
        self.slopes: list[dict[str, Any]] = []
        self.without_slope: list[dict[str, Any]] = []
        self.curves: list[dict[str, Any]] = []
        groups: dict[tuple[str, int, str], list[dict[str, Any]]] = {}
        for row in rows:
            key = row["renderer"], row["pixel_samples"], row["region"]
            groups.setdefault(key, []).append(row)
        for key, group in groups.items():
            renderer, pixel_samples, region = key
            name = {"renderer": renderer, "pixel_samples": pixel_samples, "region": region}
            truth = solved.truth(pixel_samples)
            floor = FLOOR * (truth.region_floor(region) + rounding[key])
            self._fit(name | {"against": "exact"}, group, "mse", floor=floor)
            if "mse_against_cycles" in group[0]:
                _, error = solved.reference_noise(region)
                self._fit(name | {"against": "cycles"}, group, "mse_against_cycles", error)

    def _fit(
        self,
        name: dict[str, Any],
        group: list[dict[str, Any]],
        column: str,
        offset_error: float = 0.0,
        floor: float = 0.0,
    ) -> None:
        light_samples = np.array(sorted({row["light_samples"] for row in group}))
        mse = np.array(
            [[r[column] for r in group if r["light_samples"] == n] for n in light_samples]
        )
        slope = fit_slope(light_samples, mse, offset_error, floor, CONFIDENCE)
        if slope is None:
            reason = _why_not(mse, offset_error, floor)
            self.without_slope.append(name | {"reason": reason})
        else:
            self.slopes.append(name | _slope_entry(slope, light_samples))
        self._add_curve(name, group, light_samples, mse)

    def _add_curve(
        self,
        name: dict[str, Any],
        group: list[dict[str, Any]],
        light_samples: np.ndarray,
        mse: np.ndarray,
    ) -> None:
        """Relative RMSE over the seeds; left out where the truth is black."""
        square = self._mean_square(name)
        kept = [i for i in range(len(mse)) if square > 0 and mse[i].mean() > 0]
        if not kept:
            return
        intervals = [rmse_interval(mse[i] / square, CONFIDENCE) for i in kept]
        seconds = [
            float(np.median([r["seconds"] for r in group if r["light_samples"] == n]))
            for n in light_samples[kept]
        ]
        self.curves.append(
            name
            | {
                "light_samples": [int(n) for n in light_samples[kept]],
                "rmse": [rmse for rmse, _, _ in intervals],
                "low": [low for _, low, _ in intervals],
                "high": [high for _, _, high in intervals],
                "confidence": CONFIDENCE,
                "seconds": seconds,
            }
        )

    def _mean_square(self, name: dict[str, Any]) -> float:
        truth = self.solved.truth(name["pixel_samples"])
        radiance = truth.radiance
        if name["against"] == "cycles":
            assert self.solved.reference is not None
            radiance = self.solved.reference.radiance
        return float(np.mean(radiance[truth.regions[name["region"]]] ** 2))


def _why_not(mse: np.ndarray, offset_error: float, floor: float) -> str:
    if len(mse) < 3:
        return "fewer than three numbers of light samples"
    if not mse.any():
        return "no error at all"
    if offset_error > 0:
        return "below the noise of the reference"
    if (mse.mean(axis=1) <= floor).any():
        return "no more error than rounding and the exact solution may have"
    return "no error at some number of light samples"


def _slope_entry(slope: Slope, light_samples: np.ndarray) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "slope": slope.slope,
        "low": slope.low,
        "high": slope.high,
        "confidence": CONFIDENCE,
        "light_samples": list(slope.light_samples),
    }
    left_out = [int(n) for n in light_samples[len(slope.light_samples) :]]
    if left_out:
        entry["below_noise"] = left_out
    return entry


@contextmanager
def _scratch(study: ConvergenceStudy) -> Iterator[Path]:
    """A folder for images beside the output, of this run alone.

    Those that killed runs left behind are removed: the journal's lock says that none is alive.
    """
    prefix = f"{study.out.name}.scratch-"
    for left in study.out.parent.glob(prefix + "*"):
        shutil.rmtree(left, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=study.out.parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
