"""How often a check is wrong: pictures whose maker is known, and what was said of each.

A seeded draw over what pictures differ in, covering every mistake that shows in one of four scenes,
pairs of them, correct renderers, and each mistake with its name taken out of the catalogue.
docs/check.md tells what came of it.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from penumbra.compare.check.catalogue import FILE, RIGHT, SPLIT, Variant, catalogue
from penumbra.compare.check.checking import Checker
from penumbra.compare.check.diagnosis import (
    ACCUSED,
    COARSE_GRID,
    FINE_GRID,
    PARTS,
    POWER_OR,
    PRICE_ONE,
    TEMPER,
    diagnose,
    singles,
)
from penumbra.compare.check.diagnosis import _sensible as sensible
from penumbra.compare.check.mistaken import LIBRARY
from penumbra.compare.check.specimens import GENERATORS, Maker, Specimen
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, WRONG, verdict
from penumbra.compare.check.view import View
from penumbra.compare.run.journal import Journal
from penumbra.compare.run.output import write_json
from penumbra.compare.run.provenance import ROOT, file_hash, origin
from penumbra.compare.run.tasks import Lost, Scheduler, Task, content_key, run_tasks
from penumbra.compare.scene import read_scene

SCENES = ("tp3", "tp3_statement", "tp3_sheared", "tp3_two_quads")
SIZES = ((200, 300), (300, 450), (400, 600))
"""Height, width"""
NEED = ACCUSED + PRICE_ONE
"""What a mistake's expected log-likelihood must gain over `right` to be called wrong"""
CLEAR = 2.0
"""Times NEED from which a mistake counts as one that shows"""
FROM = 16
"""Light samples from which every mistake that shows must be found"""
CONFIDENCE = 0.95
CHUNK = 6
"""Specimens of a task: of the same rays, mostly, and so of one view"""
COMMON = (
    ("domain", "diagonal"), ("domain", "corner"), ("domain", "about_corner"),
    ("weight", "pdf_times_cos"), ("weight", "no_light_cosine"), ("weight", "cos_of_cos_receiver"),
    ("weight", "distance_not_squared"), ("scale", "area_3"), ("scale", "normal_not_normalised"),
    ("scale", "area_omitted"), ("average", "n_no_effect"), ("average", "not_divided_by_n"),
    ("average", "running_half"), ("average", "break_first"), ("visibility", "to_centre"),
    ("visibility", "offset_0_1"), ("visibility", "offset_0_5"), ("visibility", "to_corner"),
    ("lights", "averaged_over_lights"), ("lights", "divided_inside_light_loop"),
    ("colour", "flat_colour_squared"), ("output", "ambient_0_1"), ("output", "acne_0_9"),
    ("clamp", "per_light_sample"), ("output", "wrap"),
)  # fmt: skip
"""What pairs are made of: the commonest mistakes of each module"""
TOO_RARE = ("acne_0_995",)
"""Choices whose noise is that of so few pixels that what a cell shows of it is not foretold"""


class CalibrationError(RuntimeError):
    """A picture that ended every process that looked at it; the text names it."""


# ---------------------------------------------------------------- what is drawn


def mistaken(scene: str) -> list[Variant]:
    """One mistake of the catalogue each, that may show in a scene; but not those that are the
    same as another power."""
    own = read_scene(ROOT / "scenes" / f"{scene}.json")
    return [
        variant
        for variant in singles([own])
        if len(variant.wrong) == 1
        and variant.scale not in POWER_OR and variant.output not in TOO_RARE
        and variant.visibility in (RIGHT, *(c.name for c in variant.wrong))
    ]  # fmt: skip


def gain(view: View, truth: Variant, other: Variant) -> float:
    """How far, on average, the score of the truth is above another's, prices aside."""
    part = view.part(PARTS, COARSE_GRID)
    return TEMPER * PARTS * part.apart(part.held_against(truth), part.held_against(other))


def plain_view(scene: str, n: int = 64, m: int = 1) -> View:
    """Of a small picture without any nuisance."""
    specimen = Specimen("correct", scene, ("mistakes",), Variant(), SIZES[0], ((n, m),))
    with tempfile.TemporaryDirectory() as folder:
        picture = specimen.pictures(read_scene(specimen.scene_file), Path(folder))[0]
    return View(
        picture, specimen.grid(m), read_scene(specimen.scene_file), specimen.scene_file, FINE_GRID
    )


def shows(views: dict[str, View]) -> dict[tuple[str, str], float]:
    """By scene and choice, how many times NEED a mistake gains, at the views' N."""
    found = {}
    for scene, view in views.items():
        for variant in mistaken(scene):
            found[scene, str(variant)] = gain(view, variant, Variant()) / NEED
    return found


def draw(cases: int, correct: int, seed: int = 1) -> list[Specimen]:
    """cases: of each choice of the catalogue at FROM light samples and more; correct: of correct
    renderers, but some."""
    rng = np.random.default_rng(seed)
    views = {scene: plain_view(scene) for scene in SCENES}
    table = shows(views)
    found = [_correct(rng) for _ in range(correct)]
    every: dict[str, Variant] = {str(v): v for scene in SCENES for v in mistaken(scene)}
    for name, variant in every.items():
        scenes = [s for s in SCENES if table.get((s, name), 0.0) >= CLEAR]
        if variant.clamp == "per_pixel_sample":
            scenes = [s for s in SCENES if s != "tp3_two_quads"]  # where something is too bright
        start = int(rng.integers(4))
        for i in range(cases + 1 if scenes else 0):
            low = i >= cases
            found.append(_mistaken(rng, "single", variant, scenes[(start + i) % len(scenes)], low))
    found += _pairs(rng, table, max(cases // 2, 1))
    found += _left_out(rng, table, every, max(cases // 2, 1))
    return found


FEW = (
    ("domain", "diagonal"), ("domain", "corner"), ("weight", "pdf_times_cos"),
    ("weight", "cos_of_cos_receiver"), ("scale", "area_3"), ("average", "n_no_effect"),
    ("average", "not_divided_by_n"), ("average", "break_first"), ("visibility", "to_centre"),
    ("visibility", "offset_0_3"), ("visibility", "none"), ("output", "ambient_0_1"),
)  # fmt: skip
FEW_PAIRS = ((0, 4), (3, 5), (2, 9), (4, 7), (2, 11))
FEW_LEFT_OUT = (2, 3, 5, 11)


def few(correct: int = 32, seed: int = 1) -> list[Specimen]:
    """What tests take: FEW, pairs of them, some left out, and correct renderers, of one scene and
    its simplest rays."""
    rng = np.random.default_rng(seed)
    choices = catalogue().choices
    ones = [Variant().replaced(choices[key]) for key in FEW]
    twos = [ones[a].replaced(choices[FEW[b]]) for a, b in FEW_PAIRS]
    found: list[Specimen] = []
    while len(found) < correct:
        s = replace(_correct(rng), shape=SIZES[0], scene="tp3", fov_y_deg=60.0)
        simple = s.ray_max_distance == 100 and s.divisor == 0 and s.counts[-1][0] <= 64
        if simple and (s.position is None or s.position[0] < 1):
            found.append(s)
    for variant in (*ones, *twos):
        kind = "single" if len(variant.wrong) == 1 else "pair"
        specimen = replace(_mistaken(rng, kind, variant, "tp3", False), shape=SIZES[0])
        place = (0.5, 0.5) if rng.random() < 0.5 else (0.0, 0.0)
        if specimen.file == "jpg 90":  # hardly tells noise
            specimen = replace(specimen, file="jpg 100")
        found.append(
            replace(
                specimen, position=place, divisor=0, fov_y_deg=60.0, counts=((16, 1),), fitted=True
            )
        )
    for i in FEW_LEFT_OUT:
        found.append(
            Specimen("left out", "tp3", ("mistakes",), ones[i], SIZES[0], ((64, 1),),
                     without=ones[i].mistakes[0])
        )  # fmt: skip
    return found


def _mistaken(
    rng: np.random.Generator, kind: str, variant: Variant, scene: str, low: bool
) -> Specimen:
    specimen = _with_nuisances(
        rng, Specimen(kind, scene, ("mistakes",), variant, _size(rng), ((16, 1),))
    )
    n = int(rng.choice([1, 4]) if low else rng.choice([16, 64, 256], p=[0.45, 0.35, 0.2]))
    m = 1
    if rng.random() < 0.15 or variant.clamp == "per_pixel_sample":
        n, m = min(n, 16), 16
    counts: tuple[tuple[int, int], ...] = ((n, m),)
    if not low and m == 1 and rng.random() < 0.1:
        counts = ((4, 1), (16, 1), (64, 1))
    if variant["output"].field("wrap"):
        specimen = replace(specimen, file="png", encoding="truncated")
    if variant["clamp"].arguments != ("NOWHERE",) and specimen.file == "exr":
        specimen = replace(specimen, file="png")
    fitted = rng.random() < 1 / 8 or variant.colour != RIGHT
    return replace(specimen, counts=counts, fitted=bool(fitted))


def _size(rng: np.random.Generator) -> tuple[int, int]:
    return SIZES[int(rng.choice(3, p=[0.86, 0.1, 0.04]))]


def _with_nuisances(rng: np.random.Generator, specimen: Specimen) -> Specimen:
    """Place in the pixel, field of view, format and encoding."""
    places: list[tuple[tuple[float, float] | None, int, float]] = [
        ((0.5, 0.5), 0, 0.35),
        ((0.0, 0.0), 0, 0.15),
        ((0.0, 0.0), 1, 0.15),
        ((0.5, 0.5), 1, 0.1),
        (None, 0, 0.15),
        ((1.5, 0.5), 0, 0.05),
        ((2.5, 1.5), 0, 0.05),
    ]
    position, divisor, _ = places[int(rng.choice(len(places), p=[p for *_, p in places]))]
    shifted = position is not None and position[0] > 1  # with the scene's field of view only
    wide = not shifted and rng.random() < 0.15
    file = str(
        rng.choice(["png", "bmp", "jpg 100", "jpg 90", "exr"], p=[0.5, 0.05, 0.15, 0.15, 0.15])
    )
    encodings = ["truncated", "rounded", "truncated 256", "sRGB", "gamma 2.2"]
    return replace(
        specimen,
        position=position,
        divisor=divisor,
        fov_y_deg=float(rng.choice([50, 70, 80])) if wide else 60.0,
        file=file,
        encoding=str(rng.choice(encodings, p=[0.6, 0.15, 0.15, 0.05, 0.05])),
        clamped=bool(rng.random() < 0.5),
        seed=int(rng.integers(1, 1 << 31)),
    )


def _correct(rng: np.random.Generator) -> Specimen:
    maker: Maker = ("mistakes",)
    which = rng.random()
    if which < 0.3:
        estimator = str(rng.choice(["area", "solid-angle", "exact"], p=[0.5, 0.35, 0.15]))
        sampler = str(rng.choice(["independent", "jittered", "sobol"]))
        maker = ("library", str(rng.choice(["float32", "float64"])), sampler, estimator)
    elif which < 0.55:
        maker = ("numpy", str(rng.choice(GENERATORS)), str(rng.choice(["float32", "float64"])))
    specimen = _with_nuisances(
        rng, Specimen("correct", str(rng.choice(SCENES)), maker, Variant(), _size(rng), ((16, 1),))
    )
    n = int(rng.choice([1, 4, 16, 64, 256], p=[0.15, 0.2, 0.3, 0.25, 0.1]))
    m = int(rng.choice([1, 4, 16], p=[0.8, 0.12, 0.08]))
    if maker[0] == "numpy":
        n = min(n, 64)
    n = min(n, 256 // m)
    counts: tuple[tuple[int, int], ...] = ((n, m),)
    if rng.random() < 0.08:
        counts = ((1, 1), (4, 1), (16, 1), (64, 1), (4, 4))[: int(rng.integers(2, 6))]
    jittered = bool(rng.random() < 0.5)
    # several rays through one place are looked for in the middle of the pixel
    if maker[0] == "library" or (maker[0] == "numpy" and not jittered and counts[-1][1] > 1):
        specimen = replace(specimen, position=(0.5, 0.5), divisor=0)
    if maker[-1] == "solid-angle" and "sheared" in specimen.scene:
        maker = (*maker[:3], "area")
    return replace(
        specimen,
        maker=maker,
        counts=counts,
        jittered=jittered,
        power=_power(rng, specimen.scene),
        ray_max_distance=float(rng.choice([75, 150, 200, 1000])) if rng.random() < 0.3 else 100.0,
        turn=int(rng.integers(4)),
        offset=str(rng.choice(["std", "offset_0", "offset_0_01"])),
    )


def _power(rng: np.random.Generator, scene: str) -> float:
    """Another power, now and then; not half of it under two lights, whose average is just that."""
    powers = (0.6, 0.9, 1.4, 1.5) if scene == "tp3_two_quads" else (0.5, 0.6, 0.9, 1.4, 1.5)
    return float(rng.choice(powers)) if rng.random() < 0.15 else 1.0


def _pairs(
    rng: np.random.Generator, table: dict[tuple[str, str], float], cases: int
) -> list[Specimen]:
    """36 pairs of COMMON mistakes, of different modules, both of which show in the scene."""
    choices = catalogue().choices
    possible = []
    for a, b in itertools.combinations(COMMON, 2):
        variant = Variant().replaced(choices[a]).replaced(choices[b])
        scenes = [
            s for s in SCENES if min(table.get((s, a[1]), 0), table.get((s, b[1]), 0)) >= CLEAR
        ]
        if a[0] != b[0] and sensible(variant) and len(variant.mistakes) == 2 and scenes:
            possible.append((variant, scenes))
    found = []
    for i in rng.permutation(len(possible))[:36]:
        variant, scenes = possible[i]
        found += [
            _mistaken(rng, "pair", variant, scenes[k % len(scenes)], False) for k in range(cases)
        ]
    return found


def _left_out(
    rng: np.random.Generator,
    table: dict[tuple[str, str], float],
    every: dict[str, Variant],
    cases: int,
) -> list[Specimen]:
    """Each name `cases` times: a choice of it, and the catalogue without the name."""
    by_name: dict[str, list[tuple[Variant, str]]] = {}
    for text, variant in every.items():
        scenes = [s for s in SCENES if table.get((s, text), 0.0) >= CLEAR]
        by_name.setdefault(variant.mistakes[0], []).extend((variant, s) for s in scenes)
    found = []
    for name, possible in by_name.items():
        for _ in range(cases if possible else 0):
            variant, scene = possible[int(rng.integers(len(possible)))]
            n = int(rng.choice([16, 64]))
            m = 16 if variant.clamp == "per_pixel_sample" else 1
            specimen = Specimen("left out", scene, ("mistakes",), variant, SIZES[0], ((n, m),))
            found.append(
                replace(specimen, seed=int(rng.integers(1, 1 << 31)), fitted=False, without=name)
            )
    return found


# ---------------------------------------------------------------- what is said of it


class Bench:
    """What specimens have in common, computed once. Raises MissingProgramError."""

    def __init__(self) -> None:
        self.checker = Checker()

    def judge(self, specimen: Specimen, folder: Path) -> dict[str, Any]:
        """What a check says of it, and how far it should be able to tell. Its pictures pass through
        a folder."""
        scene_file = specimen.scene_file
        pictures = specimen.pictures(self.checker.scene(scene_file), folder)
        given = [(specimen.grid(p.samples_per_pixel), 0) for p in pictures]
        views, grids = self.checker.look(pictures, scene_file, None if specimen.fitted else given)
        diagnosis = diagnose(views, without=specimen.without)
        said = verdict(diagnosis, grids, scene_file)
        best = diagnosis.best.variant
        expected = [gain(view, specimen.variant, Variant()) for view in views]
        from_best = [gain(view, specimen.variant, best) for view in views]
        return {
            "verdict": said.verdict,
            "mistakes": list(said.mistakes),
            "perhaps": list(said.perhaps),
            "alike": [list(names) for names in said.alike],
            "best": str(best) + (f" x {best.factor:.3f}" if best.factor != 1 else ""),
            "gain": diagnosis.best.score - diagnosis.right.score,
            "unexplained": diagnosis.unexplained,
            "loose": diagnosis.loose,
            "local": diagnosis.local,
            "expected": sum(expected) / NEED,
            "from_best": sum(from_best),
            "facts": [code for code, _ in said.facts],
            "miss": [miss for _, miss in grids],
        }


_of_thread = threading.local()


def _judge(chunk: Sequence[Specimen]) -> list[dict[str, Any]]:
    """Of each; what they have in common stays for the next chunk."""
    with tempfile.TemporaryDirectory() as folder:
        bench = _of_thread.bench = getattr(_of_thread, "bench", None) or Bench()
        return [bench.judge(specimen, Path(folder)) for specimen in chunk]


def by_rays(specimens: Sequence[Specimen]) -> list[Specimen]:
    """Those of the same rays one after another."""
    return sorted(
        specimens,
        key=lambda s: (
            s.scene,
            s.shape,
            s.fov_y_deg,
            s.divisor,
            str(s.position),
            s.ray_max_distance,
        ),
    )


def judged(
    specimens: Sequence[Specimen],
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
) -> Generator[tuple[Specimen, dict[str, Any]], None, None]:
    """Each with what was said of it, as they get done; one job is done in this process.

    Raises CalibrationError, and what run_tasks() raises.
    """
    ordered = by_rays(specimens)
    chunks = [tuple(ordered[i : i + CHUNK]) for i in range(0, len(ordered), CHUNK)]
    if jobs == 1 and scheduler is None:
        for chunk in chunks:
            yield from zip(chunk, _judge(chunk), strict=True)
        return
    tasks = [Task(content_key(version(), *(s.key for s in chunk)), chunk) for chunk in chunks]
    with contextlib.closing(run_tasks(_judge, tasks, scheduler, jobs)) as done:
        for task, said in done:
            if isinstance(said, Lost):
                first = task.argument[0]
                raise CalibrationError(f"{first}, or one of the next {CHUNK - 1}: {said.reason}")
            yield from zip(task.argument, said, strict=True)


def version() -> str:
    """Of all that decides what is said."""
    own = sorted((ROOT / "penumbra" / "compare" / "check").glob("*.py"))
    return file_hash(*own, FILE, LIBRARY)[:12]


def study(
    out: Path,
    cases: int,
    correct: int,
    seed: int,
    reduced: bool = False,
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
) -> dict[str, Any]:
    """Draw, judge, sum up, write. A run that was stopped goes on where it was; the result is the
    same whoever did it, but for its origin.

    Raises MissingProgramError, JournalError, OSError, and what judged() raises."""
    specimens = by_rays(few() if reduced else draw(cases, correct, seed))
    own = version()
    with Journal(out.with_suffix(".journal")) as journal:
        rest = [s for s in specimens if journal.get(f"{own} {s.key}") is None]
        progress = tqdm(
            total=len(specimens),
            initial=len(specimens) - len(rest),
            file=sys.stderr,
            unit="picture",
        )
        with progress, contextlib.closing(judged(rest, jobs, scheduler)) as done:
            for s, value in done:
                journal.append(f"{own} {s.key}", value)
                progress.update()
        records = [(s, journal.get(f"{own} {s.key}") or {}) for s in specimens]
        result = summary(records)
        result["settings"] = {
            **{"cases": cases, "correct": correct, "seed": seed, "reduced": reduced},
            "scenes": SCENES,
            "pictures": len(records),
        }
        result["alike"] = alike()
        result["hidden"] = hidden()
        result = {"origin": origin(), **result}
        write_json(out, result)
        if scheduler is None:  # else the same command costs nothing once more
            journal.delete()
    return result


# ---------------------------------------------------------------- what came of it


def interval(hits: int, n: int) -> tuple[float, float]:
    """Clopper and Pearson's, of a proportion.

    >>> [round(p, 4) for p in interval(0, 500)]
    [0.0, 0.0074]
    """
    if n == 0:
        return 0.0, 1.0
    tail = (1 - CONFIDENCE) / 2
    low = float(stats.beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(stats.beta.ppf(1 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return low, high


def upper(hits: int, n: int) -> float:
    """One-sided, of a proportion.

    >>> round(upper(0, 500), 4)
    0.006
    """
    return float(stats.beta.ppf(CONFIDENCE, hits + 1, n - hits)) if hits < n else 1.0


def _share(key: str, hits: int, n: int) -> dict[str, Any]:
    low, high = interval(hits, n)
    return {"n": n, key: hits, "low": low, "high": high}


def named(specimen: Specimen, said: dict[str, Any]) -> bool:
    """Whether what was made is what was said, or of its class."""
    truth = list(specimen.variant.mistakes)
    return sorted(said["mistakes"]) == truth or truth in said["alike"]


def column(specimen: Specimen, said: dict[str, Any]) -> str:
    """Of the confusion matrix."""
    truth = specimen.variant.mistakes
    if said["verdict"] != WRONG:
        return str(said["verdict"])
    if named(specimen, said):
        return " + ".join(truth)
    if len(said["mistakes"]) > 1 and set(truth) <= set(said["mistakes"]):
        return "with another"
    return str(said["mistakes"][0])


def is_shown(specimen: Specimen, said: dict[str, Any]) -> bool:
    return said["expected"] >= CLEAR and max(n for n, _ in specimen.counts) >= FROM


def summary(records: Sequence[tuple[Specimen, dict[str, Any]]]) -> dict[str, Any]:
    """Every figure of the calibration."""
    by: dict[str, list[tuple[Specimen, dict[str, Any]]]] = {}
    for s, said in records:
        by.setdefault(s.kind, []).append((s, said))
    right = by.get("correct", [])
    accused = [(s, said) for s, said in right if said["verdict"] == WRONG]
    all_singles = by.get("single", [])
    shown = [(s, said) for s, said in all_singles if is_shown(s, said)]
    found = [(s, said) for s, said in shown if said["verdict"] == WRONG]
    first = [(s, said) for s, said in shown if named(s, said)]
    two = [(s, said) for s, said in by.get("pair", []) if is_shown(s, said)]
    out = by.get("left out", [])
    return {
        "correct": {
            "n": len(right),
            "accused": len(accused),
            "cannot_tell": _count(right, CANNOT_TELL),
            "upper": upper(len(accused), len(right)),
            "low_high": interval(len(accused), len(right)),
        },
        "detected": _share("found", len(found), len(shown)),
        "named": _share("first", len(first), len(shown)),
        "faint": _faint(all_singles),
        "by_file": _by(shown, lambda s: s.file),
        "by_samples": _by(shown, lambda s: str(max(n for n, _ in s.counts))),
        "pairs": {
            "n": len(two),
            "detected": sum(said["verdict"] == WRONG for _, said in two),
            "both": sum(named(s, said) for s, said in two),
            "one_and_none_wrong": sum(
                bool(said["mistakes"]) and set(said["mistakes"]) <= {*s.variant.mistakes, UNKNOWN}
                for s, said in two
            ),
        },
        "confusion": confusion([*right, *shown]),
        "unknown": left_out(out),
        "wrong": [_case(s, said) for s, said in [*accused, *(r for r in shown if r not in first)]],
        "wrong_pairs": [_case(s, said) for s, said in two if not named(s, said)],
        "left_out": [
            _case(s, said) for s, said in out if _outcome(s, said) not in ("unknown", "named")
        ],
    }


def _count(records: Iterable[tuple[Specimen, dict[str, Any]]], word: str) -> int:
    return sum(said["verdict"] == word for _, said in records)


def _faint(records: Sequence[tuple[Specimen, dict[str, Any]]]) -> list[dict[str, Any]]:
    """How often a mistake is found, by how many times NEED it should gain."""
    edges = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)
    table = []
    for low, high in itertools.pairwise(edges):
        at = [said for _, said in records if low <= said["expected"] < high]
        hits = sum(said["verdict"] == WRONG for said in at)
        table.append({"from": low, "n": len(at), "found": hits})
    return table


def _by(records: Sequence[tuple[Specimen, dict[str, Any]]], what: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for value in sorted({what(s) for s, _ in records}):
        at = [(s, said) for s, said in records if what(s) == value]
        found[value] = {
            "n": len(at),
            "found": _count(at, WRONG),
            "first": sum(named(s, said) for s, said in at),
        }
    return found


def confusion(records: Sequence[tuple[Specimen, dict[str, Any]]]) -> dict[str, Any]:
    """rows: what was made; columns: what was said"""
    counts = Counter(
        (" + ".join(s.variant.mistakes) or RIGHT_, column(s, said)) for s, said in records
    )
    names = [RIGHT_, *catalogue().mistakes]
    last = [CANNOT_TELL, UNKNOWN, "with another"]
    rows = [name for name in names if any(row == name for row, _ in counts)]
    columns = [c for c in [*names, *last] if any(said == c for _, said in counts)]
    return {
        "rows": rows,
        "columns": columns,
        "counts": [[counts[row, said] for said in columns] for row in rows],
    }


def left_out(records: Sequence[tuple[Specimen, dict[str, Any]]]) -> dict[str, Any]:
    """What becomes of mistakes that the catalogue lacks."""
    words = Counter(_outcome(s, said) for s, said in records if said["expected"] >= CLEAR)
    keys = ("unknown", "named", "alike", "nearest", "cannot tell", "right")
    return {"n": sum(words.values()), **{key.replace(" ", "_"): words[key] for key in keys}}


def _outcome(specimen: Specimen, said: dict[str, Any]) -> str:
    if said["verdict"] != WRONG:
        return str(said["verdict"])
    if UNKNOWN in said["mistakes"]:
        return "unknown"
    if tuple(said["mistakes"]) == specimen.variant.mistakes:
        return "named"  # by the light's shape, or as black
    return "alike" if said["from_best"] < ACCUSED else "nearest"


def _case(specimen: Specimen, said: dict[str, Any]) -> dict[str, Any]:
    """For whoever looks into it."""
    made = {k: v for k, v in asdict(specimen).items() if k != "variant"}
    return {**made, "variant": str(specimen.variant), **said, "outcome": _outcome(specimen, said)}


def alike(limit: float = 4.0) -> list[list[str]]:
    """[a, b, scene]: mistakes that a picture of tp3 at N = 64 does not tell apart, and the scene
    of SCENES that does; "" if none does."""
    views = {scene: plain_view(scene) for scene in SCENES}
    found: dict[tuple[str, str], str] = {}
    told: dict[tuple[str, str], str] = {}
    variants = [
        v for v in mistaken(SCENES[0]) if v["average"].macro != SPLIT or v.visibility == RIGHT
    ]
    means = {}
    for v in variants:
        part = views[SCENES[0]].part(PARTS, COARSE_GRID)
        means[v] = part.held_against(v).mean
    shown = [v for v in variants if gain(views[SCENES[0]], v, Variant()) >= NEED]
    for a, b in itertools.combinations(shown, 2):
        names = (a.mistakes[0], b.mistakes[0])
        if names[0] == names[1] or names in found or np.abs(means[a] - means[b]).max() > 0.05:
            continue
        if gain(views[SCENES[0]], a, b) < limit:
            found[names] = ""
            for scene in SCENES[1:]:
                if gain(views[scene], a, b) > NEED:
                    told.setdefault(names, scene)
    return [[*names, told.get(names, "")] for names in found]


def hidden() -> dict[str, list[str]]:
    """By scene, choices that would not be found in a picture of it at N = 64."""
    views = {scene: plain_view(scene) for scene in SCENES}
    table = shows(views)
    return {
        scene: [name for (s, name), times in table.items() if s == scene and times < 1]
        for scene in SCENES
    }
