"""What each millisecond buys: error against time for every way to render a scene."""

from __future__ import annotations

import math
import socket
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from penumbra.compare.exact import image as exact
from penumbra.compare.measure.image import Image, read_image, write_exr
from penumbra.compare.measure.slope import fit_slope, rmse_interval
from penumbra.compare.run import provenance
from penumbra.compare.run.errands import SceneFile, alone_on_machine, brought, every_core
from penumbra.compare.run.journal import Journal
from penumbra.compare.run.library import Setting, WarmRenderer
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.run.renderers import Job, Renderer
from penumbra.compare.run.tasks import (
    Lost,
    Scheduler,
    Task,
    content_key,
    run_tasks,
    versions_here,
)
from penumbra.compare.scene import Scene, read_scene
from penumbra.compare.studies import choice
from penumbra.compare.studies.convergence import FLOOR, mse_floor
from penumbra.language import N_, speaking

LIGHT_SAMPLES = tuple(2**i for i in range(15))
"""1 to 16384, as far as MAX_SECONDS lets each method go"""
CYCLES_LIGHT_SAMPLES = (1, 4, 8, 16)
CYCLES_SEEDS = 3
SEEDS = 6
"""Frames of each setting. The fastest and the slowest of six hold the median with 97%
confidence, those of five with 94%."""
TARGETS = (0.03, 0.01, 0.003, 0.001)
"""Relative RMSE."""
MAX_SECONDS = 0.05
"""A method's N grow until a frame takes longer. With the rest it makes tp3 take about 50 seconds
on two cores."""
FEWEST = 3
"""N of every method that are measured however long they take: a curve to extrapolate from."""
TEXTBOOK = "textbook"
"""It makes the images of area, and takes longer: measured with the lab's sampler alone."""
TRIES = 3
"""Frames that must all be too slow, in case the machine was busy with something else."""
WARM_BELOW = 0.02
"""Shorter frames [s] are rendered once untimed before, so that caches and threads are awake,"""
BURST = 3
"""and then so many times, of which the median counts: one that another process cut short of the
processor does not."""
CONFIDENCE = 0.95
SLOPE_FROM = 4
"""Smallest N in a slope: the theory is of large N, and a grid of two points is no grid."""
STRIP_SECONDS = 0.003
STRIP_ERROR = 0.01
"""What the strips of pictures have in common: a time [s], an error in the penumbra."""
CLOCK = N_("wall time of render() in one warm process: no start-up, no reading, no writing")

EDGE, SMOOTH = "penumbra", "lit"
THEORY = {
    "independent": {SMOOTH: -0.5, EDGE: -0.5},
    "jittered": {SMOOTH: -1.0, EDGE: -0.75},
    "sobol": {SMOOTH: -1.5, EDGE: -0.75},
}
"""Slopes of RMSE for large N. Mitchell, "Consequences of Stratified Sampling in Graphics" (1996):
variance N^-2 where the integrand is smooth, N^-3/2 across an edge, in two dimensions; Owen,
"Scrambled net variance for integrals of smooth functions" (1997): N^-3, up to logarithms. Other
regions hold edges too, which rule in the end."""

COLUMNS = (
    *("scene", "renderer", "sampler", "estimator", "light_samples", "threads", "seed"),
    *("region", "pixels", "seconds", "mse", "relative_rmse"),
)


class TradeError(ValueError):
    """A trade that cannot be measured; the text names the option or the scene."""


@dataclass(frozen=True)
class TradeStudy:
    """All that decides a trade study."""

    scene_file: Path
    out: Path
    """without suffix: <out>.csv and <out>.json, and with keep_images <out>_images/"""
    verify: tuple[Path, ...] = ()
    """scenes that the recommendation is tried on"""
    cycles: Renderer | None = None
    cycles_light_samples: tuple[int, ...] = CYCLES_LIGHT_SAMPLES
    light_samples: tuple[int, ...] = LIGHT_SAMPLES
    threads: tuple[int, ...] = ()
    """empty: one, and every core"""
    seeds: int = SEEDS
    targets: tuple[float, ...] = TARGETS
    max_seconds: float = MAX_SECONDS
    width: int | None = None
    height: int | None = None
    keep_images: bool = False

    def file(self, suffix: str) -> Path:
        return self.out.with_name(self.out.name + suffix)


@speaking("en")  # what is recorded, and read by programs
def trade(study: TradeStudy, scheduler: Scheduler | None = None) -> dict[str, Any]:
    """Measure, choose, try the choice elsewhere; write <out>.csv and <out>.json; return what
    the JSON holds.

    Every setting is rendered once per seed, in another order for each seed, so that a machine
    that slows down slows all of them; its error is measured on that very frame. One thread or
    many make the same image: its error is measured once.

    With a scheduler each scene is one task, all of whose frames one machine times, with no other
    scene beside it; the result says which. What was measured stays in <out>.journal, so that the
    same study once more costs nothing.

    Raises SceneError, TradeError, RendererError, MissingProgramError, ImageError, OSError; with a
    scheduler what run_tasks() raises too.
    """
    if study.seeds < 2:
        raise TradeError("--seeds must be 2 or more: one frame shows no interval")
    if (study.width is None) != (study.height is None):
        raise TradeError("--width and --height go together")
    for file in study.verify:
        read_scene(file)  # or the mistake shows after a minute
    if study.cycles is not None:
        study.cycles.fingerprint()  # says at once if Blender is missing
    measured = _MeasuredScene(study, study.scene_file)
    threads = tuple(sorted(set(study.threads)))
    first = _Round(study.max_seconds, FEWEST, threads, (), study.cycles is not None)
    machines = {}
    trials = []
    with _timing(study, scheduler) as timed:
        ((frames, machines[measured.scene.name]),) = timed([measured], [first])
        rows = summary(measured, frames)
        most = max(f.setting.threads for f in frames if f.renderer == "penumbra")
        answers = [choice.answer(rows, r, t) for r in measured.masks for t in study.targets]
        others = [_MeasuredScene(study, file) for file in study.verify]
        asked = [[a for a in answers if a["region"] in other.masks] for other in others]
        rounds = []
        for here in asked:
            chosen = sorted({_setting(a["choice"]) for a in here if a["choice"]}, key=str)
            rounds.append(_Round(study.max_seconds / 2, 1, (most,), tuple(chosen), False))
        for other, here, (tried, machine) in zip(others, asked, timed(others, rounds), strict=True):
            machines[other.scene.name] = machine
            tried_rows = summary(other, tried)
            trials += [choice.trial(answer, tried_rows, other.scene.name) for answer in here]
    result = {
        "scene": measured.scene.name,
        "scene_hash": measured.scene.hash,
        "width": measured.width,
        "height": measured.height,
        "seeds": study.seeds,
        "confidence": CONFIDENCE,
        "clock": CLOCK,
        "max_seconds": study.max_seconds,
        "regions": list(measured.masks),
        "targets": list(study.targets),
        **provenance.origin(),
        **({"machines": machines} if scheduler else {}),
        "rows": rows,
        "slopes": slopes(measured, frames),
        "answers": answers,
        "trials": trials,
        "verdict": choice.verdict_text(trials),
        "strips": _strips(measured, rows, most) if study.keep_images else {},
    }
    write_csv(study.file(".csv"), COLUMNS, _csv_rows(measured, frames))
    write_json(study.file(".json"), result)
    return result


class _MeasuredScene:
    """A scene, its truth by region, and the renderer, made once."""

    def __init__(self, study: TradeStudy, scene_file: Path) -> None:
        self.study, self.scene_file = study, scene_file
        self.scene: Scene = read_scene(scene_file)
        self.width = study.width or self.scene.width
        self.height = study.height or self.scene.height

    @cached_property
    def renderer(self) -> WarmRenderer:
        renderer = WarmRenderer(self.scene_file, self.width, self.height)
        renderer.check()
        return renderer

    @cached_property
    def truth(self) -> exact.ExactImage:
        return exact.exact_image(self.scene, self.width, self.height)

    @cached_property
    def masks(self) -> dict[str, np.ndarray]:
        """The regions that count: all, lit, penumbra and the objects; none that is black."""
        names = ["all", SMOOTH, EDGE, *(thing.name for thing in self.scene.objects)]
        found = exact.regions(self.scene, self.truth)
        masks = {name: found[name] for name in names if name in found}
        kept = {name: m for name, m in masks.items() if self.truth.radiance[m].any()}
        if not kept:
            raise TradeError(f"{self.scene_file}: no object that light falls on is seen")
        return kept

    @cached_property
    def _pixels(self) -> dict[str, np.ndarray]:
        return {name: np.flatnonzero(mask) for name, mask in self.masks.items()}

    @cached_property
    def _planes(self) -> np.ndarray:
        return np.ascontiguousarray(self.truth.radiance.transpose(2, 0, 1))

    @cached_property
    def mean_square(self) -> dict[str, float]:
        """Of the truth over each region's pixels and channels."""
        return self._means(self._planes)

    def mse(self, radiance: np.ndarray) -> dict[str, float]:
        """(3, H, W) against the truth, by region."""
        return self._means(radiance - self._planes)

    def floor(self, region: str) -> float:
        """MSE that float32 and the truth's own error may account for."""
        return mse_floor(self.truth.radiance, self.truth.error_bound, self.masks[region])

    def _means(self, planes: np.ndarray) -> dict[str, float]:
        square = np.square(planes, dtype=np.float64).sum(axis=0).ravel()
        return {name: float(square[i].mean()) / 3 for name, i in self._pixels.items()}


@dataclass(frozen=True)
class Frame:
    """One timed frame; its image's error by region."""

    renderer: str
    setting: Setting
    seed: int
    seconds: float
    mse: dict[str, float] = field(repr=False)


def _grid(
    measured: _MeasuredScene, threads: Sequence[int], most: float, fewest: int
) -> list[list[Setting]]:
    """For each image its settings, which differ in threads alone, the most threads first.

    Each method's N grow, from the `fewest` first ones on until a frame on the most threads takes
    longer than `most` seconds.
    """
    renderer, always = measured.renderer, sorted(measured.study.light_samples)[:fewest]
    images: list[Setting] = []
    for estimator in filter(renderer.can, renderer.estimators):
        if not renderer.uses_samples(estimator):
            images.append(Setting(None, estimator, None, threads[-1]))
            continue
        for sampler in renderer.samplers[: 1 if estimator == TEXTBOOK else None]:
            for n in measured.study.light_samples:
                setting = Setting(sampler, estimator, n, threads[-1])
                tries = (renderer.render(setting, 0) for _ in range(TRIES))
                if n not in always and not any(seconds <= most for seconds in tries):
                    break
                images.append(setting)
    return [[replace(s, threads=t) for t in reversed(threads)] for s in images]


def _frames(measured: _MeasuredScene, grid: Sequence[Sequence[Setting]]) -> list[Frame]:
    """Every setting for every seed, in the grid's order. No two images share a seed."""
    random = np.random.default_rng(0)
    turns = [(k, i) for k in range(measured.study.seeds) for i in random.permutation(len(grid))]
    frames: list[list[Frame]] = [[] for _ in grid]
    for k, i in tqdm(turns, desc=measured.scene.name, unit="image", disable=None, file=sys.stderr):
        seed = k * len(grid) + int(i) + 1
        mse: dict[str, float] = {}
        for setting in grid[i]:
            seconds = _timed(measured.renderer, setting, seed)
            mse = mse or measured.mse(measured.renderer.radiance)
            frames[i].append(Frame("penumbra", setting, seed, seconds, mse))
    return [frame for group in frames for frame in group]


def _timed(renderer: WarmRenderer, setting: Setting, seed: int) -> float:
    """Seconds of a frame; of a short one in the median of BURST, after one untimed."""
    seconds = renderer.render(setting, seed)
    if seconds >= WARM_BELOW:
        return seconds
    return float(np.median([renderer.render(setting, seed) for _ in range(BURST)]))


def _cycles_frames(measured: _MeasuredScene, cycles: Renderer) -> list[Frame]:
    """Cycles' own render seconds, in one process too, on every core."""
    jobs = [
        Job(measured.scene_file, measured.width, measured.height, n, 1, seed)
        for seed, n in enumerate(measured.study.cycles_light_samples * CYCLES_SEEDS, start=1)
    ]
    frames = []
    with tempfile.TemporaryDirectory() as folder:
        rendered = cycles.render(jobs, Path(folder))
        bar = tqdm(rendered, desc="cycles", total=len(jobs), disable=None, file=sys.stderr)
        for job, file, seconds in bar:
            mse = measured.mse(read_image(file).radiance.transpose(2, 0, 1))
            setting = Setting(None, "", job.light_samples, provenance.cores())
            frames.append(Frame("cycles", setting, job.seed, seconds, mse))
            file.unlink()
    return frames


# Summaries


def median_interval(
    values: Sequence[float], confidence: float = CONFIDENCE
) -> tuple[float, float, float]:
    """Median, and two order statistics that hold the true one with at least that confidence.

    The true median lies below the j-th smallest of n values with the probability that fewer
    than j of n fair coins show heads. With fewer than six values no two order statistics
    are enough for 95%: then the smallest and the largest.

    >>> median_interval([3.0, 1.0, 2.0, 6.0, 5.0, 4.0])
    (3.5, 1.0, 6.0)
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = len(ordered)
    j = max(1, int(stats.binom.ppf((1 - confidence) / 2, n, 0.5)))
    return float(np.median(ordered)), float(ordered[j - 1]), float(ordered[n - j])


def summary(measured: _MeasuredScene, frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """A row for each setting and region: error, time and efficiency with their intervals.

    efficiency = 1 / (relative MSE x seconds) [1/s]: of two unbiased methods whose variance
    falls as 1/N, the one of twice the efficiency takes half the time. Its interval multiplies
    the limits of both; without an error there is no efficiency (None). on_frontier: no other
    row of that region and number of threads is both faster and nearer the truth; Cycles counts
    among those of the most threads.
    """
    rows: list[dict[str, Any]] = []
    for (renderer, setting), group in _groups(frames).items():
        seconds, fastest, slowest = median_interval([f.seconds for f in group])
        for region, square in measured.mean_square.items():
            error, low, high = _error([f.mse[region] / square for f in group])
            work = [
                None if e == 0 else 1 / (e**2 * t)
                for e, t in ((error, seconds), (high, slowest), (low, fastest))
            ]
            rows.append(
                {
                    "renderer": renderer,
                    "sampler": setting.sampler,
                    "estimator": setting.estimator or None,
                    "light_samples": setting.light_samples,
                    "threads": setting.threads,
                    "region": region,
                    "pixels": int(measured.masks[region].sum()),
                    "relative_rmse": error,
                    "low": low,
                    "high": high,
                    "seconds": seconds,
                    "seconds_low": fastest,
                    "seconds_high": slowest,
                    "efficiency": work[0],
                    "efficiency_low": work[1],
                    "efficiency_high": work[2],
                    "on_frontier": False,
                }
            )
    alike: dict[tuple[str, int], list[dict[str, Any]]] = {}
    most = max(f.setting.threads for f in frames if f.renderer == "penumbra")
    for row in rows:
        threads = row["threads"] if row["renderer"] == "penumbra" else most
        alike.setdefault((row["region"], threads), []).append(row)
    for here in alike.values():
        for i in choice.frontier([(row["seconds"], row["relative_rmse"]) for row in here]):
            here[i]["on_frontier"] = True
    return rows


def _error(relative_mse: Sequence[float]) -> tuple[float, float, float]:
    if not any(relative_mse):
        return 0.0, 0.0, 0.0
    error, low, high = rmse_interval(np.array(relative_mse), CONFIDENCE)
    return float(error), float(low), float(high)


def _groups(frames: Sequence[Frame]) -> dict[tuple[str, Setting], list[Frame]]:
    groups: dict[tuple[str, Setting], list[Frame]] = {}
    for frame in frames:
        groups.setdefault((frame.renderer, frame.setting), []).append(frame)
    return groups


def slopes(measured: _MeasuredScene, frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Of every method and region: the fitted slope, its interval, and what theory says.

    slope is None where there are fewer than three N from SLOPE_FROM on with an error above
    what rounding explains, as for a method without N; reason says which.
    """
    most = max(f.setting.threads for f in frames if f.renderer == "penumbra")
    methods: dict[tuple[Any, ...], dict[int | None, list[Frame]]] = {}
    alike = [f for f in frames if f.setting.threads == most or f.renderer != "penumbra"]
    for (renderer, s), group in _groups(alike).items():
        methods.setdefault((renderer, s.sampler, s.estimator), {})[s.light_samples] = group
    found = []
    for (renderer, sampler, estimator), by_n in methods.items():
        for region in measured.masks:
            entry = {
                "renderer": renderer,
                "sampler": sampler,
                "estimator": estimator or None,
                "region": region,
                "theory": THEORY.get(sampler or "", {}).get(region),
                "confidence": CONFIDENCE,
            }
            found.append(entry | _fit(by_n, region, FLOOR * measured.floor(region)))
    return found


def _fit(by_n: dict[int | None, list[Frame]], region: str, floor: float) -> dict[str, Any]:
    nothing: dict[str, Any] = {"slope": None, "low": None, "high": None, "light_samples": []}
    if None in by_n:
        return nothing | {"reason": N_("no N")}
    used = sorted(n for n in by_n if n is not None and n >= SLOPE_FROM)
    if len(used) < 3:
        return nothing | {"reason": N_("fewer than three N")}
    mse = np.array([[f.mse[region] for f in by_n[n]] for n in used])
    slope = fit_slope(np.array(used), mse, 0.0, floor, CONFIDENCE)
    if slope is None:
        return nothing | {"reason": N_("no more error than rounding explains")}
    return {
        "slope": slope.slope,
        "low": slope.low,
        "high": slope.high,
        "light_samples": list(slope.light_samples),
        "reason": None,
    }


# Which frames of a scene are timed, and where


@dataclass(frozen=True)
class _Round:
    """What to time of a scene."""

    most: float
    """[s], and fewest: as in _grid"""
    fewest: int
    threads: tuple[int, ...]
    """empty: one, and every core of the machine that measures"""
    chosen: tuple[Setting, ...]
    """settings to time whatever they take: recommended from another scene"""
    cycles: bool

    def frames(self, measured: _MeasuredScene) -> list[Frame]:
        threads = self.threads or tuple(sorted({1, provenance.cores()}))
        grid = _grid(measured, threads, self.most, self.fewest)
        known = {setting for settings in grid for setting in settings}
        more = (s for s in self.chosen if s not in known and measured.renderer.can(s.estimator))
        grid += [[setting] for setting in more]
        frames = _frames(measured, grid)
        if self.cycles and measured.study.cycles is not None:
            frames += _cycles_frames(measured, measured.study.cycles)
        return frames


_Timed = tuple[list[Frame], dict[str, Any]]
"""A scene's frames, and the machine that they were timed on"""


@contextmanager
def _timing(
    study: TradeStudy, scheduler: Scheduler | None
) -> Iterator[Callable[[Sequence[_MeasuredScene], Sequence[_Round]], Iterable[_Timed]]]:
    """A function that times scenes, here or on the scheduler's workers."""
    if scheduler is None:
        machine = provenance.machine()
        yield lambda scenes, rounds: (
            (one.frames(scene), machine) for scene, one in zip(scenes, rounds, strict=True)
        )
        return
    with Journal(study.file(".journal")) as journal:
        yield lambda scenes, rounds: _timed_elsewhere(scenes, rounds, scheduler, journal)


def _timed_elsewhere(
    scenes: Sequence[_MeasuredScene],
    rounds: Sequence[_Round],
    scheduler: Scheduler,
    journal: Journal,
) -> list[_Timed]:
    tasks = []
    for scene, one in zip(scenes, rounds, strict=True):
        sent = SceneFile.of(scene.scene_file)
        study = replace(scene.study, verify=())
        same = replace(study, scene_file=Path(sent.name), out=Path(), cycles=None)
        versions = ascii(sorted(versions_here().items()))
        cycles = study.cycles.fingerprint() if one.cycles and study.cycles else ""
        key = content_key(sent.name, sent.content, ascii(same), ascii(one), versions, cycles)
        tasks.append(Task(key, (sent, study, one, cycles)))
    missing = [task for task in tasks if journal.get(task.key) is None]
    with closing(run_tasks(_time_there, missing, scheduler)) as done:
        for task, found in done:
            if isinstance(found, Lost):
                raise TradeError(f"{task.argument[0].name}: {found.reason}")
            journal.append(task.key, found)
    values = [journal.get(task.key) or {} for task in tasks]
    return [([_frame(**f) for f in value["frames"]], value["machine"]) for value in values]


def _time_there(argument: tuple[SceneFile, TradeStudy, _Round, str]) -> dict[str, Any]:
    """On a worker. cycles: its fingerprint here, if it is timed too."""
    scene, study, one, cycles = argument
    if cycles and study.cycles and study.cycles.fingerprint() != cycles:
        raise TradeError(f"worker {socket.gethostname()}: its Cycles is another than here")
    with alone_on_machine(), every_core(), brought(scene) as file:
        frames = one.frames(_MeasuredScene(study, file))
        return {"frames": [asdict(f) for f in frames], "machine": provenance.machine()}


def _frame(setting: dict[str, Any], **others: Any) -> Frame:
    return Frame(setting=Setting(**setting), **others)


def _setting(row: dict[str, Any]) -> Setting:
    return Setting(row["sampler"], row["estimator"], row["light_samples"], row["threads"])


# Files


def _csv_rows(measured: _MeasuredScene, frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """A row a frame and region."""
    return [
        {
            "scene": measured.scene.name,
            "renderer": f.renderer,
            "sampler": f.setting.sampler or "",
            "estimator": f.setting.estimator,
            "light_samples": f.setting.light_samples or "",
            "threads": f.setting.threads,
            "seed": f.seed,
            "region": region,
            "pixels": int(measured.masks[region].sum()),
            "seconds": f.seconds,
            "mse": mse,
            "relative_rmse": math.sqrt(mse / measured.mean_square[region]),
        }
        for f in frames
        for region, mse in f.mse.items()
    ]


def _strips(
    measured: _MeasuredScene, rows: Sequence[dict[str, Any]], threads: int
) -> dict[str, list[dict[str, Any]]]:
    """Images of every method at one time and at one error, written to <out>_images/.

    equal_time: the most light samples within STRIP_SECONDS; equal_error: the fewest with an
    error of at most STRIP_ERROR in the penumbra. A method that has none is left out.
    """
    region = EDGE if EDGE in measured.masks else "all"
    methods: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        if (row["renderer"], row["threads"], row["region"]) == ("penumbra", threads, region):
            methods.setdefault((row["sampler"], row["estimator"]), []).append(row)
    picks: dict[str, list[dict[str, Any]]] = {"equal_time": [], "equal_error": []}
    for group in methods.values():
        group.sort(key=lambda row: row["light_samples"] or 0)
        quick = [row for row in group if row["seconds"] <= STRIP_SECONDS]
        fine = [row for row in group if row["relative_rmse"] <= STRIP_ERROR]
        picks["equal_time"] += quick[-1:]
        picks["equal_error"] += fine[:1]
    shown = {name: [_keep(measured, name, row) for row in rows] for name, rows in picks.items()}
    _sweep(measured.study, {entry["file"] for strip in shown.values() for entry in strip})
    return shown


def _keep(measured: _MeasuredScene, strip: str, row: dict[str, Any]) -> dict[str, Any]:
    setting, seed = _setting(row), 1
    measured.renderer.render(setting, seed)
    words = [w for w in (strip, setting.sampler, setting.estimator) if w]
    folder = measured.study.file("_images")
    file = folder / f"{'_'.join(words)}.exr"
    attributes: dict[str, str | int | float] = {
        "sceneName": measured.scene.name,
        "sceneHash": measured.scene.hash,
        "lightSamples": setting.light_samples or 0,
        "pixelSamples": 1,
        "threads": setting.threads,
        "seed": str(seed),
        "sampler": setting.sampler or "none",
        "estimator": setting.estimator,
        "software": f"penumbra {provenance.VERSION}",
        "renderSeconds": float(row["seconds"]),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_exr(file, Image(measured.renderer.radiance.transpose(1, 2, 0).astype(np.float64), None,
                          attributes))  # fmt: skip
    keys = ("sampler", "estimator", "light_samples", "threads", "region", "seconds",
            "relative_rmse")  # fmt: skip
    return {"file": f"{folder.name}/{file.name}", **{k: row[k] for k in keys}}


def _sweep(study: TradeStudy, kept: set[str]) -> None:
    """Remove images of an earlier run that this one has not made."""
    folder = study.file("_images")
    for file in folder.glob("equal_*.exr"):
        if f"{folder.name}/{file.name}" not in kept:
            file.unlink()
