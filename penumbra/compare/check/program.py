"""A student's program on scenes made to separate mistakes: what to render next, until it is clear.

The first picture is of the lab's scene. Then, as long as there are hypotheses that are not ruled
out and that a further picture would tell from the best one, the picture is asked for that is
expected to tell most for its cost. All pictures are judged together (diagnosis.Search).
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.diagnosis import (
    ACCUSED,
    FINE_GRID,
    PARTS,
    PRICE_ONE,
    TEMPER,
    Diagnosis,
    Search,
    keys_of,
)
from penumbra.compare.check.explanation import titles
from penumbra.compare.check.grid import Grid, fit_grid
from penumbra.compare.check.picture import Picture, read_picture
from penumbra.compare.check.view import View
from penumbra.compare.measure.image import ImageError
from penumbra.compare.run.provenance import ROOT, cores
from penumbra.compare.run.renderers import TIMEOUT, CommandRenderer, Job, RendererError
from penumbra.compare.scene import Scene, read_scene
from penumbra.language import _, say

FIRST = "tp3"
SCENES = (FIRST, "check_low", "check_two_lights", "check_split", "check_scaled")
COUNTS = ((16, 1), (4, 1), (64, 1), (1, 1), (16, 4))
"""(light samples, pixel samples) of the pictures that may be asked for"""
RULED_OUT = 2 * ACCUSED
"""Log-likelihood, as some of the cells say it, from which a hypothesis is behind for good"""
TELLS = ACCUSED + PRICE_ONE
"""Expected gain without which a picture does not tell two hypotheses apart"""
BUDGET = 120.0
"""[s] of our own"""
OWN_SECONDS, OWN_SECONDS_SCENE = 1.0, 3.0
"""What a picture costs us, and one of a scene that was not yet seen [s]"""
SECONDS_A_SAMPLE = 1e-7
"""What a light sample costs a program where that is not measured: about twice what it costs
core/estimator.c on one thread [s]"""
THREADS = 4
"""The several threads of a program whose check must not depend on the machine"""
FOR_PICTURES = 0.7
"""Of the budget; the rest is for the last look at all of them"""
FEWEST_CELLS = 20
RACE = 5.0
"""Standard errors by which one thread must be brighter than several"""
NOISIER = 1.15
"""Noise of several threads over that of one (standard deviations)"""
DARKER = 0.002
"""Less, relative, is no race"""
LONG_ENOUGH = 0.2
"""Seconds from which a run tells how it speeds up"""


@dataclass(frozen=True)
class Experiment:
    """One picture to ask for."""

    scene_file: Path
    nb_light_samples: int
    samples_per_pixel: int = 1
    seed: int = 1
    threads: int | None = None
    """None: as many as the program likes"""

    def __str__(self) -> str:
        m = (
            say(", {count} pixel samples", count=self.samples_per_pixel)
            if self.samples_per_pixel > 1
            else ""
        )
        return say(
            "{scene}, {count} light samples{m}",
            scene=self.scene_file.stem,
            count=self.nb_light_samples,
            m=m,
        )


class Subject(Protocol):
    """A program that is checked: a CommandRenderer, or one that runs in a cage."""

    @property
    def suffix(self) -> str:
        """of its images"""

    @property
    def placeholders(self) -> frozenset[str]:
        """which of renderers.REQUIRED and OPTIONAL it takes; threads, whichever way"""

    def run(self, job: Job, out: Path) -> float:
        """Render one image; the wall time [s]. Raises RendererError, MissingProgramError."""

    def refused(self, job: Job, out: Path, why: str) -> ValueError:
        """The error of an image that was made and is of no use: a RendererError, or one that says
        more."""


Progress = Callable[[Experiment, str], None]
"""Told each picture before it is rendered, and why"""


@dataclass(frozen=True)
class Trial:
    """A picture that was asked for, and got."""

    experiment: Experiment
    why: str
    seconds: float
    """of the program"""
    view: View
    unexplained_outline: int
    """pixels"""


def times_as_fast(threads: int, ratio: float) -> str:
    """ratio: the time of one thread over that of so many.

    >>> times_as_fast(4, 3.6)
    '4 threads are 3.6 times as fast as one'
    """
    return say(
        "{threads} threads are {ratio:.2g} times as fast as one", threads=threads, ratio=ratio
    )


@dataclass(frozen=True)
class Examined:
    """What a program's pictures say."""

    trials: tuple[Trial, ...]
    facts: tuple[tuple[str, str], ...]
    """(code, text for the student), of seeds, threads, sizes and scenes that it fails on"""
    diagnosis: Diagnosis
    undecided: tuple[tuple[str, ...], ...]
    """names of hypotheses that further pictures could have told from the best one"""
    excluded: tuple[str, ...]
    """mistakes that would have shown, alone or beside the best, and did not"""
    seconds: float
    """of our own, without the program's"""
    """None: one core, or too quick to tell"""

    @property
    def telling(self) -> Trial:
        """Where the best explains most that what is right does not; the first if it is right"""
        best, right = self.diagnosis.best.variant, self.diagnosis.right.variant
        return max(self.trials, key=lambda t: t.view.loglik(best) - t.view.loglik(right))

    @property
    def grids(self) -> tuple[tuple[Grid, int], ...]:
        """Of each view of the diagnosis, with the pixels of outline that it leaves unexplained"""
        return tuple((trial.view.grid, trial.unexplained_outline) for trial in self.trials)


def command_program(
    template: str, suffix: str = ".exr", timeout: float = TIMEOUT
) -> CommandRenderer:
    """A CommandRenderer's command, as a program to check. It runs on this machine, as you, without
    a shell, in a process group of its own.

    suffix: of the pictures that it writes; timeout: of each [s]. Raises RendererError,
    MissingProgramError.
    """
    renderer = CommandRenderer("program", template, suffix, timeout)
    renderer.fingerprint()  # says that it is missing
    if "threads" in renderer.placeholders:
        return renderer
    return replace(renderer, command=f"env OMP_NUM_THREADS={{threads}} {template}")


def check_program(
    subject: Subject,
    budget: float = BUDGET,
    scenes: Sequence[str] = SCENES,
    pictures: int | None = None,
    progress: Progress | None = None,
) -> Examined:
    """Run a program until its pictures tell what is wrong with it.

    budget: of our own time [s]; scenes: names in scenes/, the first one first; pictures: so many
    at most, whatever time they take, beside three for seeds and threads. Which ones are asked for
    then depends on the pictures and on nothing of this machine, and no fact has a measured time.
    Raises RendererError, MissingProgramError, SceneError.
    """
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        program = _Program(subject, Path(folder))
        told = progress or (lambda experiment, why: None)
        return _Examination(program, scenes, pictures, told).run(budget)


class _Program:
    """The program, and what its runs took."""

    def __init__(self, subject: Subject, folder: Path) -> None:
        self.folder = folder
        self.subject = subject
        self.runs: list[tuple[float, float]] = []
        """light samples drawn, and seconds, of each run"""
        self.seconds = 0.0
        self._number = 0

    def picture(self, experiment: Experiment, scene: Scene) -> tuple[Picture, float]:
        """The picture, and the seconds that it took. Raises RendererError."""
        self._number += 1
        out = self.folder / f"{self._number:03d}{self.subject.suffix}"
        job = _job(experiment, scene)
        seconds = self.subject.run(job, out)
        try:
            picture = read_picture(out, scene, job.light_samples, job.pixel_samples)
        except ImageError as error:
            raise self.subject.refused(
                job, out, say("wrote no good image: {error}", error=error)
            ) from error
        finally:
            out.unlink(missing_ok=True)
        self.seconds += seconds
        self.runs.append((_drawn(experiment, scene), seconds))
        return picture, seconds

    def expected_seconds(self, experiment: Experiment, scene: Scene) -> float:
        """A start-up and a time for each light sample, fitted to the runs."""
        from scipy.optimize import nnls

        drawn, seconds = np.array(self.runs).T
        (start, each), _ = nnls(np.stack([np.ones_like(drawn), drawn], axis=1), seconds)
        return float(start + each * _drawn(experiment, scene))


def _job(experiment: Experiment, scene: Scene) -> Job:
    n, m = experiment.nb_light_samples, experiment.samples_per_pixel
    width, height = scene.width, scene.height
    return Job(experiment.scene_file, width, height, n, m, experiment.seed, experiment.threads)


def _drawn(experiment: Experiment, scene: Scene) -> int:
    """Light samples in all."""
    samples = experiment.nb_light_samples * experiment.samples_per_pixel
    return scene.width * scene.height * samples


@dataclass
class _Stage:
    """A scene, and the program's rays in it."""

    file: Path
    scene: Scene
    grid: Grid
    miss: int = 0
    """pixels of outline that the grid leaves unexplained"""
    seen: bool = False
    views: dict[tuple[Grid, tuple[int, ...]], View] = field(default_factory=dict)
    """of black pictures, by their rays and shape"""

    def view_of(self, picture: Picture, grid: Grid) -> View:
        """Those with the same rays share what is computed for them."""
        rays, shape = replace(grid, jittered=False), picture.values.shape
        if (rays, shape) not in self.views:
            black = _black(picture, shape)
            self.views[rays, shape] = View(black, rays, self.scene, self.file, FINE_GRID)
        return self.views[rays, shape].of(picture, grid)

    def foreseen(self, samples_per_pixel: int) -> Grid:
        """The grid of a picture to come: several rays a pixel are at random places of it."""
        return self.grid if samples_per_pixel == 1 else _jittered(self.grid)


def _jittered(grid: Grid) -> Grid:
    return replace(grid, jittered=True, position=0.5)


def _black(like: Picture, shape: tuple[int, ...]) -> Picture:
    none = np.zeros(shape, dtype=bool)
    return replace(
        like, values=np.zeros(shape), clipped=none, background=none[..., 0], name="not rendered"
    )


class _Examination:
    def __init__(
        self,
        program: _Program,
        scenes: Sequence[str],
        pictures: int | None,
        progress: Progress,
    ) -> None:
        self.program, self.pictures, self.progress = program, pictures, progress
        self.threads = None if pictures is None else THREADS
        files = [ROOT / "scenes" / f"{name}.json" for name in scenes]
        read = [(file, read_scene(file)) for file in files]
        self.stages = [
            _Stage(file, scene, Grid(scene.camera.fov_y_deg, cut=scene.ray_max_distance))
            for file, scene in read
        ]
        self.many = "pixel_samples" in program.subject.placeholders
        self.search = Search(power_known=True, many=self.many)
        self.trials: list[Trial] = []
        self.facts: dict[str, str] = {}
        self.start = time.perf_counter()
        self._expected: dict[tuple[Experiment, Variant, Variant], float] = {}

    @property
    def own_seconds(self) -> float:
        return time.perf_counter() - self.start - self.program.seconds

    def run(self, budget: float) -> Examined:
        stage = self.stages[0]
        first = Experiment(stage.file, *COUNTS[0], threads=self.threads)
        picture = self.take(stage, first, _("to begin with"))
        for other in self.stages[1:]:
            own_cut = stage.grid.cut == stage.scene.ray_max_distance
            cut = other.scene.ray_max_distance if own_cut else stage.grid.cut
            other.grid = replace(stage.grid, cut=cut)
        self.seeds_and_threads(stage, picture)
        self.search.coarse()
        candidates = self.candidates()
        while self.may_ask(budget):
            chosen = self.next(candidates) or self.unseen(candidates)
            if chosen is None:
                break
            stage, experiment, why = chosen
            candidates.remove((stage, experiment))
            try:
                self.take(stage, experiment, why)
            except RendererError as error:
                self.facts[f"fails_{stage.scene.name}"] = say(
                    "it fails on {experiment}: {error}", experiment=experiment, error=error
                )
                candidates = [c for c in candidates if c[0] is not stage]
                continue
            self.search.coarse()
        undecided = {v.mistakes for v, _ in self.rivals() if self.tellable(v, candidates)}
        diagnosis = self.search.fine()
        return Examined(
            tuple(self.trials),
            tuple(self.facts.items()),
            diagnosis,
            tuple(sorted(undecided)),
            diagnosis.excluded,
            self.own_seconds,
        )

    def may_ask(self, budget: float) -> bool:
        """There is time, or are pictures, left."""
        if self.pictures is None:
            return self.own_seconds < FOR_PICTURES * budget
        return len(self.trials) + sum(f.startswith("fails_") for f in self.facts) < self.pictures

    # -- pictures

    def take(self, stage: _Stage, experiment: Experiment, why: str) -> Picture:
        """A picture, looked at with all before. Raises RendererError."""
        self.progress(experiment, why)
        picture, seconds = self.program.picture(experiment, stage.scene)
        height, width = picture.values.shape[:2]
        if (width, height) != (stage.scene.width, stage.scene.height):
            said = say(
                "your pictures are {width} x {height}, not as large as the scene says",
                width=width,
                height=height,
            )
            self.facts.setdefault("size", said)
        grid, miss = stage.grid, stage.miss
        if not stage.seen or experiment.samples_per_pixel > 1:
            grid, miss = fit_grid(picture, stage.scene)
        if experiment.samples_per_pixel == 1:
            stage.grid, stage.miss, stage.seen = grid, miss, True
        view = stage.view_of(picture, grid)
        if len(view.count) < FEWEST_CELLS:
            raise self.program.subject.refused(
                _job(experiment, stage.scene),
                Path(picture.name),
                say(
                    "its picture of {name}, {width} x {height}, is too small to tell anything: "
                    "fewer than {fewest_cells} cells of 8x8 pixels",
                    name=stage.scene.name,
                    width=width,
                    height=height,
                    fewest_cells=FEWEST_CELLS,
                ),
            )
        self.trials.append(Trial(experiment, why, seconds, view, miss))
        self.search.add([view])
        return picture

    def seeds_and_threads(self, stage: _Stage, first: Picture) -> None:
        """What a seed and threads do to the first picture, rendered again."""
        experiment, several = self.trials[0].experiment, self.trials[0].seconds
        self.progress(experiment, _("again, with another seed, and on one thread"))
        again, seconds = self.program.picture(experiment, stage.scene)
        other, _seconds = self.program.picture(replace(experiment, seed=2), stage.scene)
        repeats = np.array_equal(first.values, again.values)
        if not repeats:
            self.facts["seed_not_repeated"] = _("the same seed gives another picture each time")
        elif np.array_equal(first.values, other.values):
            self.facts["seed_no_effect"] = _("the seed has no effect: two seeds give one picture")
        else:
            self.facts["seed_repeats"] = _(
                "the same seed gives the same picture, another one another"
            )
        if cores() == 1 and self.threads is None:
            return
        one, alone = self.program.picture(replace(experiment, threads=1), stage.scene)
        if not np.array_equal(one.values, first.values):
            self.facts.update(_race(one.values, first.values))
        several = min(several, seconds)
        if alone > LONG_ENOUGH and self.pictures is None:
            self.facts["speed_up"] = times_as_fast(cores(), alone / several)

    def candidates(self) -> list[tuple[_Stage, Experiment]]:
        """All but the first one, those that cost least first, each with a seed of its own."""
        counts = [(n, m) for n, m in COUNTS if m == 1 or self.many]
        every = [(stage, count) for count in counts for stage in self.stages]
        found = [
            (s, Experiment(s.file, *c, seed=3 + i, threads=self.threads))
            for i, (s, c) in enumerate(every)
        ]
        return found[1:]

    # -- what to ask next

    def rivals(self) -> list[tuple[Variant, float]]:
        """Those that the pictures have not ruled out, and how far each is behind the best."""
        search, best = self.search, self.search.ordered()[0]
        said = {v: score + search.price(v) for v, score in search.scored.items()}
        return [
            (v, said[best] - s)
            for v, s in said.items()
            if v.factor == best.factor and v.mistakes != best.mistakes
            and said[best] - s < RULED_OUT
            # what has not come apart where it was foretold to will not do so again
            and search.apart(best, v) < 2 * RULED_OUT
        ]  # fmt: skip

    def next(
        self, candidates: list[tuple[_Stage, Experiment]]
    ) -> tuple[_Stage, Experiment, str] | None:
        """The picture that is expected to put the rivals farthest behind, for its cost."""
        best, rivals = self.search.ordered()[0], self.rivals()
        found, most = None, 0.0
        for stage, experiment in candidates:
            apart = self.expected(stage, experiment, best, [v for v, _ in rivals])
            gains = [
                min(a, RULED_OUT - behind) if a > TELLS else 0.0
                for a, (_, behind) in zip(apart, rivals, strict=True)
            ]
            value = sum(gains) / self.cost(stage, experiment)
            if value > most:
                most, rival = value, rivals[int(np.argmax(gains))][0]
                found = (
                    stage,
                    experiment,
                    say("may tell {best} from {rival}", best=_named(best), rival=_named(rival)),
                )
        return found

    def unseen(
        self, candidates: list[tuple[_Stage, Experiment]]
    ) -> tuple[_Stage, Experiment, str] | None:
        """A scene that was not yet rendered: what is in no catalogue may show there."""
        for stage, experiment in candidates:
            if not stage.seen:
                return stage, experiment, _("a scene not yet seen")
        return None

    def tellable(self, variant: Variant, candidates: list[tuple[_Stage, Experiment]]) -> bool:
        best = self.search.ordered()[0]
        return any(self.expected(s, e, best, [variant])[0] > TELLS for s, e in candidates)

    def cost(self, stage: _Stage, experiment: Experiment) -> float:
        own = OWN_SECONDS if stage.seen else OWN_SECONDS_SCENE
        if self.pictures is not None:
            return own + SECONDS_A_SAMPLE * _drawn(experiment, stage.scene)
        return own + self.program.expected_seconds(experiment, stage.scene)

    def expected(
        self, stage: _Stage, experiment: Experiment, best: Variant, others: list[Variant]
    ) -> list[float]:
        """Gain in score of the best over each of the others, were it the truth, by a picture that
        was not made."""
        new = [v for v in others if (experiment, best, v) not in self._expected]
        if new:
            first = self.trials[0].view.picture
            height, width = first.values.shape[:2]
            if (width, height) == (self.stages[0].scene.width, self.stages[0].scene.height):
                width, height = stage.scene.width, stage.scene.height
            n, m = experiment.nb_light_samples, experiment.samples_per_pixel
            picture = replace(
                _black(first, (height, width, 3)), nb_light_samples=n, samples_per_pixel=m
            )
            view = self.search.part(stage.view_of(picture, stage.foreseen(m)))
            view.prepare(keys_of([best, *new]))
            mine = view.held_against(best)
            for v in new:
                gain = view.apart(mine, view.held_against(v))
                self._expected[experiment, best, v] = TEMPER * PARTS * gain
        return [self._expected[experiment, best, v] for v in others]


def _race(one: np.ndarray, several: np.ndarray) -> dict[str, str]:
    """What two pictures of one seed, by one thread and by several, say of data races."""
    difference = one - several
    error = float(difference.std()) / math.sqrt(difference.size)
    darker = float(several.mean() / one.mean()) if one.mean() > 0 else 1.0
    grain = [float(np.diff(picture, axis=1).std()) for picture in (one, several)]
    noisier = grain[1] / grain[0] if grain[0] > 0 else 1.0
    if difference.mean() > max(RACE * error, DARKER * one.mean()) or noisier > NOISIER:
        said = say(
            "with several threads your picture is {darker:.2f} times as bright as with one, and "
            "its grain {noisier:.2f} times: threads write to one variable (a data race)",
            darker=darker,
            noisier=noisier,
        )
        return {"race": said}
    return {"threads_differ": _("another number of threads gives other noise, and no other light")}


def _named(variant: Variant) -> str:
    return titles(variant.mistakes) if variant.mistakes else _("what is right")
