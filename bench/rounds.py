"""The measurement: every task once a round, in another order each round, all in one run."""

from __future__ import annotations

import contextlib
import json
import math
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from bench.law import Law, Row
from bench.systems import (
    STEADY,
    Absent,
    CyclesSystem,
    EmbreeSystem,
    Frame,
    Loop,
    MitsubaSystem,
    Penumbra,
    ScalarLoop,
    System,
    mitsuba_name,
    program,
)
from penumbra.compare.exact.image import exact_image, regions
from penumbra.compare.measure.metrics import relative_rmse
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import Scene, read_scene

COMPARED = (16, 64, 256)
"""Light samples at which the scalar loop and other people's renderers are measured, however long
they take."""
FITTED = (4, 16, 64, 256, 1024, 4096)
"""More of them, for error against time; what takes more than FRAME_LIMIT is left out."""
FRAME_LIMIT = 1.0
"""Longest frame of a system that need not be compared at that N [s]."""
SHORT_FRAME, SHORT_TIMES = 0.1, 3
"""Frames shorter than so many seconds are measured so many times a round: they see only moments
of a machine that other tenants slow down now and then."""
QUICK_LIMIT = 0.5
"""Longest frame for sizes, one thread, and the N of a target [s]."""
SIZES = ((150, 100), (300, 200), (600, 400), (1200, 800), (2400, 1600), (4800, 3200))
SIZE_SAMPLES = 64
TARGETS = (0.01, 0.001)
"""Relative RMSE over all pixels that see an object, but for silhouettes."""
VARIANTS = ("llvm_ad_rgb", "scalar_rgb")
FILTER_GRID = 4
"""Positions across a pixel for the exact image with a box filter."""
EMPTY_PROCESS, WHOLE_PROCESS = "penumbra-render --version", "penumbra-render to a file"
COLUMNS = (
    *("experiment", "system", "width", "height", "light_samples", "threads", "round", "seconds"),
    *("relative_rmse_all", "relative_rmse_lit"),
)


@dataclass(frozen=True)
class Plan:
    """What is to be measured."""

    scene_file: Path
    width: int
    height: int
    threads: int = 2
    rounds: int = 5
    compared: tuple[int, ...] = COMPARED
    fitted: tuple[int, ...] = FITTED
    sizes: tuple[tuple[int, int], ...] = SIZES
    targets: tuple[float, ...] = TARGETS
    cycles: bool = True
    embree: bool = True
    mitsuba_python: str | None = sys.executable
    """the interpreter that may have Mitsuba; None: leave it out"""


@dataclass
class Measured:
    frames: list[Row]
    """as COLUMNS say"""
    peaks: list[Row]
    """round, threads, fma_per_second, divisions_per_second"""
    absent: dict[str, str]
    """systems that were not measured, and why"""
    versions: dict[str, str]
    """of the systems that were"""
    truth: Truth


class Truth:
    """The exact image, seen through pixels' centres and, if need be, their whole area."""

    def __init__(self, scene: Scene, width: int, height: int) -> None:
        self._scene, self._size = scene, (width, height)
        self.exact = exact_image(scene, width, height)
        masks = regions(scene, self.exact)
        self._masks = {name: masks[name] for name in ("all", "lit") if name in masks}
        self._filtered: np.ndarray | None = None

    def errors(self, radiance: np.ndarray, box_filtered: bool) -> Row:
        """relative_rmse_all and _lit"""
        reference = self._box_filtered() if box_filtered else self.exact.radiance
        return {
            f"relative_rmse_{name}": relative_rmse(radiance, reference, mask)
            for name, mask in self._masks.items()
        }

    def _box_filtered(self) -> np.ndarray:
        if self._filtered is None:
            self._filtered = exact_image(self._scene, *self._size, FILTER_GRID).radiance
        return self._filtered


def measure(plan: Plan) -> Measured:
    """Measure all of the plan. Raises SceneError, NotBuilt, SystemFailed, CyclesError."""
    scene = read_scene(plan.scene_file)
    with contextlib.ExitStack() as stack:
        systems, absent = _systems(plan, stack)
        rounds = _Rounds(plan, Truth(scene, plan.width, plan.height))
        rounds.run(_tasks(plan, rounds, systems, stack), "rounds")
        rounds.run(list(_target_tasks(plan, rounds, systems)), "targets")
        versions = {s.name: s.version for s in systems if not isinstance(s, Penumbra)}
        return Measured(rounds.frames, rounds.peaks, absent, versions, rounds.truth)


def use_cores(count: int) -> None:
    """Confine this process and all that it starts to so many cores: the same for every system."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:count])


def _systems(plan: Plan, stack: contextlib.ExitStack) -> tuple[list[System], dict[str, str]]:
    absent: dict[str, str] = {}
    loop = Loop(plan.scene_file)
    stack.callback(loop.close)
    systems: list[System] = list(loop.systems())

    def start(name: str, make: Callable[[], Any], wanted: bool) -> None:
        if not wanted:
            absent[name] = "left out on request"
            return
        try:
            system = make()
        except Absent as error:
            absent[name] = str(error).replace(f"{ROOT}/", "")  # the page is for other machines
            return
        stack.callback(system.close)
        systems.append(system)

    size = (plan.width, plan.height)
    start("Cycles", lambda: CyclesSystem(plan.scene_file, *size), plan.cycles)
    for variant in VARIANTS:
        make = partial(
            MitsubaSystem, plan.scene_file, *size, plan.threads, variant, plan.mitsuba_python or ""
        )
        start(mitsuba_name(variant), make, plan.mitsuba_python is not None)
    start(ScalarLoop.name, partial(ScalarLoop, plan.scene_file), True)
    start("Embree", partial(EmbreeSystem, plan.scene_file), plan.embree)
    return systems, absent


# ---------------------------------------------------------------- tasks

Task = Callable[[int], None]
"""Measures something, in the round of that number, from 1."""


@dataclass
class _Rounds:
    plan: Plan
    truth: Truth

    def __post_init__(self) -> None:
        self.frames: list[Row] = []
        self.peaks: list[Row] = []

    def run(self, tasks: Sequence[Task], name: str) -> None:
        """All tasks in each round, each round in another order, the same in every run."""
        turns = []
        for number in range(1, self.plan.rounds + 1):
            order = list(tasks)
            random.Random(number).shuffle(order)
            turns += [(task, number) for task in order]
        for task, number in tqdm(turns, desc=name, disable=None, file=sys.stderr):
            task(number)

    def shoot(self, experiment: str, system: System, frame: Frame, picture: bool) -> Task:
        def task(number: int) -> None:
            shot = system.shoot(replace(frame, seed=number), picture)
            errors: Row = {}
            if picture and shot.radiance is not None:
                errors = self.truth.errors(shot.radiance, system.box_filtered)
            self.frames.append(_row(experiment, system.name, frame, number, shot.seconds) | errors)

        return task

    def peak(self, threads: int) -> Task:
        def task(number: int) -> None:
            command = [str(program("fma-peak")), str(threads)]
            done = subprocess.run(
                command, check=True, capture_output=True, text=True, env=os.environ | STEADY
            )
            self.peaks.append({"round": number, **json.loads(done.stdout)})

        return task

    def process(self, name: str, command: Sequence[str], frame: Frame) -> Task:
        """A whole program from its start to its end, as its user waits for it."""
        environment = os.environ | STEADY | {"PYTHONPATH": str(ROOT)}

        def task(number: int) -> None:
            start = time.perf_counter()
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
            seconds = time.perf_counter() - start
            self.frames.append(_row("process", name, frame, number, seconds))

        return task


def _row(experiment: str, system: str, frame: Frame, number: int, seconds: float) -> Row:
    return {
        "experiment": experiment,
        "system": system,
        "width": frame.width,
        "height": frame.height,
        "light_samples": frame.light_samples,
        "threads": frame.threads,
        "round": number,
        "seconds": seconds,
    }


def _tasks(
    plan: Plan, rounds: _Rounds, systems: Sequence[System], stack: contextlib.ExitStack
) -> list[Task]:
    tasks = [rounds.peak(threads) for threads in sorted({1, plan.threads})]
    warming = tqdm(systems, desc="warming up", disable=None, file=sys.stderr)
    for system in warming:
        seconds = _warm_up(plan, system)
        for count in seconds:
            frame = Frame(plan.width, plan.height, count, plan.threads)
            times = _times(seconds[count])
            tasks += times * [rounds.shoot("samples", system, frame, picture=True)]
            quick = seconds[count] * plan.threads < QUICK_LIMIT
            if quick and system.flexible and count in plan.compared and plan.threads > 1:
                one = rounds.shoot("samples", system, replace(frame, threads=1), False)
                tasks += times * [one]
        if system.flexible:
            known = SIZE_SAMPLES if SIZE_SAMPLES in seconds else min(plan.compared)
            a_pixel = seconds[known] * max(1, SIZE_SAMPLES / known) / (plan.width * plan.height)
            for size in plan.sizes:
                if a_pixel * math.prod(size) < QUICK_LIMIT:
                    frame = Frame(*size, SIZE_SAMPLES, plan.threads)
                    tasks.append(rounds.shoot("size", system, frame, False))
    return tasks + list(_process_tasks(plan, rounds, systems, stack))


def _times(seconds: float) -> int:
    return SHORT_TIMES if seconds < SHORT_FRAME else 1


def _warm_up(plan: Plan, system: System) -> dict[int, float]:
    """Numbers of samples that will be measured, and about how long each takes [s]."""
    seconds: dict[int, float] = {}
    for count in sorted({*plan.compared, *plan.fitted}):
        expected = seconds[max(seconds)] * count / max(seconds) if seconds else 0.0
        if expected > FRAME_LIMIT:
            if count in plan.compared and not system.flexible:
                seconds[count] = expected
            continue
        frame = Frame(plan.width, plan.height, count, plan.threads)
        # The first may compile, or fetch memory.
        seconds[count] = min(system.shoot(frame, picture=False).seconds for _ in range(2))
    return seconds


def _process_tasks(
    plan: Plan, rounds: _Rounds, systems: Sequence[System], stack: contextlib.ExitStack
) -> Iterator[Task]:
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="penumbra-bench-"))
    renderer = str(program("penumbra-render"))
    frame = Frame(plan.width, plan.height, min(plan.compared), plan.threads)
    options = {
        "light-samples": frame.light_samples,
        "threads": frame.threads,
        "width": frame.width,
        "height": frame.height,
        "sampler": "sobol",
    }
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    out = str(Path(folder) / "frame.exr")
    scene = str(plan.scene_file)
    yield rounds.process(EMPTY_PROCESS, [renderer, "--version"], frame)
    yield rounds.process(WHOLE_PROCESS, [renderer, scene, "-o", out, *words], frame)
    if any(system.name == "Cycles" for system in systems):
        cycles = [
            sys.executable,
            "-P",
            "-m",
            "penumbra.blender_ref",
            scene,
            str(frame.light_samples),
            "1",
        ]
        size = ["--width", str(frame.width), "--height", str(frame.height)]
        yield rounds.process("Cycles to a file", [*cycles, out, *size], frame)


def _target_tasks(plan: Plan, rounds: _Rounds, systems: Sequence[System]) -> Iterator[Task]:
    """Frames with as many samples as a target needs by the fit, where that takes no time."""
    for system in systems:
        law = Law.of(rounds.frames, system.name, plan.threads)
        for target in plan.targets:
            count = law.samples_for(target)
            if count and law.seconds_at(count) < QUICK_LIMIT and system.flexible:
                frame = Frame(plan.width, plan.height, math.ceil(count), plan.threads)
                task = rounds.shoot(f"target {target:g}", system, frame, picture=True)
                yield from [task] * _times(law.seconds_at(count))
