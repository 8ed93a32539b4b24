"""Do two images show the same radiance? A verdict a region, with what it could have missed.

`agreement` compares an image with the exact solution, or with another image, region by region;
`compare_files` does so for files and refuses those that cannot be compared. docs/statistics.md
says what the verdicts prove.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import Literal, TypedDict

import numpy as np
from scipy import ndimage

from penumbra.compare.exact.image import LIT, ExactImage, exact_image, regions
from penumbra.compare.exact.receivers import camera_hits
from penumbra.compare.measure.bounds import geometry_range
from penumbra.compare.measure.image import Image, read_image
from penumbra.compare.measure.metrics import luminance, measure_regions
from penumbra.compare.measure.statistics import (
    CONFIDENCE,
    BiasTest,
    Estimate,
    StatisticsError,
    benjamini_hochberg,
    bias_test,
    bias_test_from_scatter,
    estimate,
    holm,
    range_test,
    scatter_test,
)
from penumbra.compare.run.provenance import typed
from penumbra.compare.scene import PointLight, Scene, read_scene

DELTA = 5e-4
"""The bias, relative to a region's mean, that an image may have and still agree with exact."""
DELTA_CYCLES = 1e-3
"""The same where Cycles is one of the two: it fits a scene of its own making."""
CONSISTENT_FRACTION = 0.999
"""The share of pixels that must not contradict the reference."""
ROUNDING = 2.0**-20
"""What float32 arithmetic may add to a pixel, relative to the brightest one: 16 roundings of
2^-24. (Relative to itself a dark pixel may be further off: n.l near 0 is a difference.)"""
SCATTER_RANGE, SCATTER_COUNT = 2.0, 16
"""scatter_test takes a mean of 16 samples for normal if each is within a factor of 2 of any
other: their skewness is then below 0.1 (docs/statistics.md)."""
DARK = 1e-3
"""A region darker than this share of the whole picture is measured against the whole: a relative
bias of the umbra, whose mean is 0, would mean nothing."""
PIXEL_GRID = 3
"""Positions a side that stand in for an anti-aliased pixel."""
EXACT = "exact"
"""Stands for the exact solution where a reference's name is asked for."""


class ComparisonError(ValueError):
    """Two images that must not be compared; the text names both and says why."""


class Row(TypedDict):
    """One region's verdict; the keys of agreement.json."""

    image: str
    reference: str
    scene: str
    region: str
    pixels: int
    mean_image: float
    mean_reference: float
    bias: float
    """[W m^-2 sr^-1], like the means of y = (R + G + B) / 3"""
    relative_bias: float | None
    relative_low: float | None
    relative_high: float | None
    confidence: float
    delta: float
    detectable_relative_bias: float | None
    verdict: Literal["agrees", "differs", "undecided"]
    consistent_fraction: float | None
    p_value: float | None
    """of no bias at all, for this region alone"""
    relative_to: str
    """the region whose mean the relative numbers are relative to: itself, or "all" if it is DARK"""
    note: str
    """why the verdict is undecided or weak, or empty"""


@dataclass(frozen=True)
class Comparison:
    """Two files compared."""

    rows: list[Row]
    metrics: dict[str, dict[str, float]]
    """region -> metric -> value, silhouettes apart as a region of their own"""
    notes: list[str] = field(default_factory=list)

    @property
    def agrees(self) -> bool:
        """Every region agrees and enough pixels are consistent. Undecided is not agreement:
        a test that could not have found the bias proves nothing."""
        return all(passes(row) for row in self.rows)

    @property
    def exit_status(self) -> int:
        """0 where all agrees, 1 where anything differs or is undecided."""
        return 0 if self.agrees else 1


def passes(row: Row) -> bool:
    """Whether a row counts as agreement: its verdict, and its pixels where they were tested."""
    fraction = row["consistent_fraction"]
    return row["verdict"] == "agrees" and (fraction is None or fraction >= CONSISTENT_FRACTION)


def compare_files(
    image_file: str | Path,
    reference_file: str | Path,
    scene_file: str | Path,
    *,
    delta: float | None = None,
    confidence: float = CONFIDENCE,
    perceptual: bool = False,
) -> Comparison:
    """Compare an image file with a reference file, or with the exact solution ("exact").

    delta: relative bias that still agrees; DELTA by default, DELTA_CYCLES if one of the images
    comes in independent parts, as Cycles references do. perceptual adds HDR-FLIP and
    Delta E 2000 to the metrics (slow). Raises ImageError, SceneError for files that cannot be
    read, ComparisonError for files of other scenes or sizes.
    """
    scene = read_scene(scene_file)
    files = [image_file] if str(reference_file) == EXACT else [image_file, reference_file]
    images = [read_image(file) for file in files]
    notes = _check_scenes(files, images, scene_file, scene)
    notes += [
        f"{file}: of 8 bits, and through which place of a pixel its rays go is not known: a region "
        "differs only where no shift by a pixel explains it. To find the place and judge the "
        f"light: penumbra check {quote(str(file))} --scene {quote(typed(scene_file))} "
        "--light-samples N"
        for file, image in zip(files, images, strict=True)
        if image.is_eight_bit
    ]
    if len({image.shape for image in images}) > 1:
        sizes = " and ".join(
            f"{file} ({image.shape[1]} x {image.shape[0]})"
            for file, image in zip(files, images, strict=True)
        )
        raise ComparisonError(f"{sizes} are not of one size: not compared")
    exact = exact_for(images[0], scene)
    reference = images[1] if len(images) > 1 else exact
    rows = agreement(
        images[0],
        reference,
        scene,
        exact=exact,
        names=(str(image_file), str(reference_file)),
        delta=delta,
        confidence=confidence,
    )
    metrics = measure_regions(
        images[0].radiance, reference.radiance, regions(scene, exact), perceptual=perceptual
    )
    return Comparison(rows, metrics, notes)


def exact_for(image: Image, scene: Scene) -> ExactImage:
    """The exact solution of what the image's pixels are means of: their centres, or if the
    header says pixelSamples > 1 their areas.

    An area is a mean over PIXEL_GRID^2 positions; how far that may be off is judged by what
    one fewer a side gives and joins error_bound.
    """
    height, width = image.shape
    if _pixel_samples(image) == 1:
        return exact_image(scene, width, height)
    fine = exact_image(scene, width, height, PIXEL_GRID)
    coarse = exact_image(scene, width, height, PIXEL_GRID - 1)
    change = np.abs(fine.radiance - coarse.radiance).max(axis=-1)
    return dataclasses.replace(
        fine,
        error_bound=fine.error_bound + change,
        silhouette=fine.silhouette | coarse.silhouette,
    )


def agreement(
    image: Image,
    reference: Image | ExactImage,
    scene: Scene,
    *,
    exact: ExactImage | None = None,
    names: tuple[str, str] = ("image", "reference"),
    delta: float | None = None,
    confidence: float = CONFIDENCE,
) -> list[Row]:
    """A row for each region of compare.exact.regions but the silhouettes.

    exact: the exact solution at the image's size (for the regions, and for what a sample may
    be); made if it is not given. delta: relative bias that still agrees; DELTA by default,
    DELTA_CYCLES if an image comes in independent parts, as Cycles references do. A clipped
    image's values are not known at all above 1, so pixels whose samples may exceed 1 are left
    out; an 8-bit one's rays may go through any place of a pixel (grid_bound). Raises
    ComparisonError for arrays of other shapes, NaN or infinite values, and a delta or confidence
    that is none.

    verdict: "agrees" if the interval of the bias lies within +-delta; "differs" if it lies
    outside, at a p-value that stands after Holm's correction over the regions; else
    "undecided". consistent_fraction: the share of the region's pixels that do not contradict
    a bias of delta or less of their own, after Benjamini and Hochberg's correction over all
    pixels at 1 - confidence; None where the images do not tell how many samples they took.
    """
    if exact is None:
        exact = reference if isinstance(reference, ExactImage) else exact_for(image, scene)
    _check_arrays(names, image, reference, exact)
    if delta is None:
        delta = DELTA_CYCLES if _in_parts(image) or _in_parts(reference) else DELTA
    if not (0 < delta < math.inf and 0 < confidence < 1):
        raise ComparisonError(f"delta {delta} must be above 0, confidence {confidence} in (0, 1)")

    case = _Case.of(image, reference, scene, exact)
    if not case.masks:
        raise ComparisonError(f"{names[0]}, {names[1]}: no pixel of {scene.name} can be compared")
    tests = {region: case.region_test(region, confidence) for region in case.masks}
    p_beyond = [
        test.p_beyond(delta * case.scale(region)[1]) if isinstance(test, BiasTest) else 1.0
        for region, test in tests.items()
    ]
    is_beyond = holm(np.array(p_beyond)) < 1 - confidence
    consistent = case.consistent(delta, confidence)
    rows = []
    for (region, test), differs in zip(tests.items(), is_beyond, strict=True):
        relative_to, unit = case.scale(region)
        mask = case.masks[region]
        fraction = None if consistent is None else float(consistent[mask].mean())
        row = Row(
            image=names[0],
            reference=names[1],
            scene=scene.name,
            region=region,
            pixels=int(mask.sum()),
            mean_image=float(case.image.mean[mask].mean()),
            mean_reference=float(case.reference.mean[mask].mean()),
            bias=float((case.image.mean - case.reference.mean)[mask].mean()),
            relative_bias=None,
            relative_low=None,
            relative_high=None,
            confidence=confidence,
            delta=delta,
            detectable_relative_bias=None,
            verdict="undecided",
            consistent_fraction=fraction,
            p_value=None,
            relative_to=relative_to,
            note="",
        )
        if unit > 0:
            row["relative_bias"] = row["bias"] / unit
        if isinstance(test, StatisticsError):
            row["note"] = str(test)
        else:
            row["p_value"] = test.p_value
            if unit > 0:
                row["relative_low"], row["relative_high"] = test.low / unit, test.high / unit
                row["detectable_relative_bias"] = test.detectable / unit
            if differs:
                row["verdict"] = "differs"
            elif -delta * unit <= test.low and test.high <= delta * unit:
                row["verdict"] = "agrees"
        rows.append(row)
    return rows


def sample_range(
    scene: Scene, exact: ExactImage, pixel_samples: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """The least and the most that one light sample brings to each pixel's R, G, B: two arrays
    (H, W, 3) [W m^-2 sr^-1].

    A sample of a light brings brdf L_e A cos cos / d^2 within the bounds of geometry_range, or 0
    if it is hidden: the least is 0 wherever the exact solution does not say that every light is
    wholly visible. Of n lights a sample may take all, as this
    repository's renderer does, or one at random and n times its light, as Cycles does: it
    brings n times the brightest one's at most. With pixel_samples > 1 the range covers the
    3x3 pixels around.
    """
    height, width = exact.object_id.shape
    y, x = np.mgrid[0:height, 0:width]
    hits = camera_hits(scene, x.ravel() + 0.5, y.ravel() + 0.5, width, height)
    on = np.flatnonzero(hits.object_id >= 0)
    point, normal = hits.point[on], hits.normal[on]
    least, most = np.full((len(on), 3), np.inf), np.zeros((len(on), 3))
    for light in scene.lights:
        emitted = light.radiant_intensity if isinstance(light, PointLight) else light.radiance
        darkest, brightest = geometry_range(light, point, normal)
        least = np.minimum(least, np.asarray(emitted) * darkest[:, None])
        most = np.maximum(most, np.asarray(emitted) * brightest[:, None])
    least[~np.isfinite(least)] = 0  # no light at all
    brdf = np.array([thing.brdf for thing in scene.objects]).reshape(-1, 3)[hits.object_id[on]]
    low, high = np.zeros((2, height * width, 3))
    low[on], high[on] = len(scene.lights) * brdf * least, len(scene.lights) * brdf * most
    low, high = low.reshape(height, width, 3), high.reshape(height, width, 3)
    low[exact.shadow != LIT] = 0
    if pixel_samples > 1:
        size = (3, 3, 1)
        low = ndimage.minimum_filter(low, size, mode="nearest")
        high = ndimage.maximum_filter(high, size, mode="nearest")
    return low, high


def grid_bound(exact: ExactImage) -> np.ndarray:
    """By how much y may be off at most in an image on another pixel grid: (H, W) [W m^-2 sr^-1].

    Through a pixel's corner, x / W, x / (W - 1) or (x + 1/2) / (W - 1), a ray goes at most one
    pixel aside of its centre in x and in y, so it sees what lies between the exact solution's
    3x3 pixels around (of one object: silhouettes are in no region).
    """
    y = luminance(exact.radiance)
    above = ndimage.maximum_filter(y, 3, mode="nearest") - y
    below = y - ndimage.minimum_filter(y, 3, mode="nearest")
    return np.asarray(np.maximum(above, below))


def format_rows(rows: Sequence[Row]) -> str:
    """The rows as a table for a terminal, one comparison after the other."""
    lines: list[str] = []
    title = None
    for row in rows:
        if title != (row["scene"], row["image"], row["reference"]):
            title = (row["scene"], row["image"], row["reference"])
            lines += ["", f"{row['scene']}: {row['image']} against {row['reference']}"]
            interval = f"{100 * row['confidence']:g}% interval"
            lines.append(
                f"{'region':<18}{'pixels':>8}{'mean':>11}{'bias %':>10}{interval:>22}{'delta %':>9}"
                f"{'detects %':>11}{'consistent':>12}  verdict"
            )
        interval = f"[{_percent(row['relative_low'])}, {_percent(row['relative_high'])}]"
        fraction = row["consistent_fraction"]
        lines.append(
            f"{row['region']:<18}{row['pixels']:>8}{row['mean_image']:>11.5g}"
            f"{_percent(row['relative_bias']):>10}{interval:>22}{100 * row['delta']:>9.3g}"
            f"{_percent(row['detectable_relative_bias'], sign=''):>11}"
            f"{'-' if fraction is None else f'{100 * fraction:.3f}%':>12}  {row['verdict']}"
            + (f" ({row['note']})" if row["note"] else "")
        )
    return "\n".join(lines).lstrip("\n")


def format_metrics(metrics: Mapping[str, Mapping[str, float]]) -> str:
    """Metrics by region as a table for a terminal."""
    names = next(iter(metrics.values())).keys()
    lines = [f"{'region':<18}" + "".join(f"{name:>15}" for name in names)]
    for region, values in metrics.items():
        lines.append(f"{region:<18}" + "".join(f"{values[name]:>15.6g}" for name in names))
    return "\n".join(lines)


def unbiasedness_p_values(
    images: Iterable[Image], scene: Scene, exact: ExactImage, tested: Sequence[str]
) -> dict[str, np.ndarray]:
    """p-values of the unbiasedness test for images of many seeds: what was tested -> (images,).

    Each image is tested against exact as `agreement` does, in the regions that `tested` names.
    "pixels" is the smallest p-value of the pixel test after its correction over all pixels:
    below alpha where any pixel was called inconsistent. The share of p-values below alpha is
    the test's false-alarm rate if the renderer is unbiased, and its power if it is not.
    Raises StatisticsError for an image without a variance.
    """
    p_values: dict[str, list[float]] = {name: [] for name in tested}
    case = None
    for image in images:
        if case is None:
            case = _Case.of(image, exact, scene, exact)
        case = dataclasses.replace(case, image=estimate(image, case.image.error_bound))
        for name, values in p_values.items():
            if name == "pixels":
                p = float(benjamini_hochberg(case.pixel_p_values()).min())
            else:
                p = bias_test(case.image, case.reference, case.masks[name]).p_value
            values.append(p)
    return {name: np.array(values) for name, values in p_values.items()}


@dataclass(frozen=True)
class _Case:
    """An image and its reference, ready to be tested."""

    image: Estimate
    reference: Estimate
    lit: np.ndarray
    """(H, W) bool"""
    object_id: np.ndarray
    low: np.ndarray
    high: np.ndarray
    """(H, W) range of a sample's y"""
    masks: dict[str, np.ndarray]
    """the regions to test"""

    @staticmethod
    def of(
        image: Image,
        reference: Image | ExactImage,
        scene: Scene,
        exact: ExactImage,
    ) -> _Case:
        pair = [one for one in (image, reference) if isinstance(one, Image)]
        low, high = sample_range(scene, exact, max(_pixel_samples(one) for one in pair))
        masks = {k: v for k, v in regions(scene, exact).items() if k != "silhouette"}
        brightest = np.abs(luminance(reference.radiance)).max(where=exact.object_id >= 0, initial=0)
        rounding = ROUNDING * float(brightest)
        if any(one.clipped for one in pair):
            unclipped = high.max(axis=-1) <= 1
            masks = {k: v & unclipped for k, v in masks.items() if (v & unclipped).any()}

        def bound(one: Image) -> np.ndarray:
            of_values = np.maximum(rounding, one.rounding)
            return of_values + (grid_bound(exact) if one.is_eight_bit else 0.0)

        if isinstance(reference, Image):
            other = estimate(reference, bound(reference))
        else:
            other = Estimate.known(reference.radiance, reference.error_bound)
        return _Case(
            estimate(image, bound(image)),
            other,
            exact.shadow == LIT,
            exact.object_id,
            luminance(low),
            luminance(high),
            masks,
        )

    def scale(self, region: str) -> tuple[str, float]:
        """What a region's bias is relative to: its mean, or in the dark that of "all"."""
        mean, overall = (float(self.reference.mean[self.masks[r]].mean()) for r in (region, "all"))
        return (region, mean) if mean > DARK * overall else ("all", max(overall, 0.0))

    def region_test(self, region: str, confidence: float) -> BiasTest | StatisticsError:
        """The region's test, or why there is none."""
        known = self.image.variance is not None and self.reference.variance is not None
        test = bias_test if known else bias_test_from_scatter
        try:
            return test(self.image, self.reference, self.masks[region], confidence)
        except StatisticsError as error:
            return error

    def pixel_p_values(self, delta: float = 0.0) -> np.ndarray:
        """p-values of the pixels of "all", (n,): that their bias, relative to the reference's
        pixel, is at most delta. Raises StatisticsError."""
        allowed = self.reference.error_bound + delta * np.abs(self.reference.mean)
        reference = dataclasses.replace(self.reference, error_bound=allowed)
        mask = self.masks["all"]
        counts = [one.count for one in (self.image, reference) if not one.is_known]
        is_normal = self.lit & (self.high <= SCATTER_RANGE * self.low)
        is_normal &= min(counts, default=0) >= SCATTER_COUNT
        if self.image.variance is None or reference.variance is None:
            is_normal[:] = False
        p = np.ones(mask.shape)
        if is_normal.any():
            classes = np.where(self.lit, self.object_id, -1)
            p = scatter_test(self.image, reference, classes)
        rest = mask & ~is_normal
        p[rest] = range_test(
            self.image.at(rest), reference.at(rest), self.low[rest], self.high[rest]
        )
        return p[mask]

    def consistent(self, delta: float, confidence: float) -> np.ndarray | None:
        """(H, W) bool of the pixels of "all", or None if pixels cannot be tested."""
        try:
            p = self.pixel_p_values(delta)
        except StatisticsError:
            return None
        consistent = np.ones(self.lit.shape, dtype=bool)
        consistent[self.masks["all"]] = benjamini_hochberg(p) > 1 - confidence
        return consistent


def _in_parts(image: Image | ExactImage) -> bool:
    return isinstance(image, Image) and "parts" in image.attributes


def _pixel_samples(image: Image) -> int:
    value = image.attributes.get("pixelSamples", 1)
    return value if isinstance(value, int) and value > 1 else 1


def _check_arrays(
    names: tuple[str, str], image: Image, reference: Image | ExactImage, exact: ExactImage
) -> None:
    for name, one in zip((*names, EXACT), (image, reference, exact), strict=True):
        if one.radiance.shape != image.radiance.shape:
            (h, w), (height, width) = image.shape, one.radiance.shape[:2]
            raise ComparisonError(
                f"{names[0]} is {w} x {h} pixels, {name} {width} x {height}: not compared"
            )
        values = [one.radiance]
        if isinstance(one, Image) and one.variance is not None:
            values.append(one.variance)
        if not all(np.isfinite(a).all() for a in values):
            raise ComparisonError(
                f"{names[0]}, {names[1]}: {name} holds NaN or infinite values: not compared"
            )


def _check_scenes(
    files: Sequence[str | Path], images: Sequence[Image], scene_file: str | Path, scene: Scene
) -> list[str]:
    """Notes on images that do not say their scene. Raises ComparisonError for another one."""
    notes = []
    shown = typed(scene_file)
    for file, image in zip(files, images, strict=True):
        found = image.attributes.get("sceneHash")
        if found is None:
            notes.append(f"{file}: does not say which scene it shows; {shown} is assumed")
        elif found != scene.hash:
            others = ", ".join(str(other) for other in files if other != file)
            raise ComparisonError(
                f"{file} shows the scene of hash {found}, {shown} has {scene.hash}: "
                f"not compared" + (f" with {others}" if others else "")
            )
    return notes


def _percent(value: float | None, sign: str = "+") -> str:
    return "-" if value is None else f"{100 * value:{sign}.4f}"
