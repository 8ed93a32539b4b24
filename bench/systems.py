"""What is measured: each system renders the same frames in a warm process of its own."""

from __future__ import annotations

import contextlib
import json
import math
import os
import statistics
import subprocess
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.mitsuba_scene import UnsupportedScene, mitsuba_scene
from penumbra.compare.measure.image import read_image
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import QuadLight, read_scene

BURST = 0.03
"""Frames that are shorter are repeated until this time is over [s]; the median frame counts."""
MOST_FRAMES = 31
STEADY = {"OMP_PROC_BIND": "true", "OMP_PLACES": "threads"}
"""For every process with OpenMP: threads that move between cores make short frames vary."""
NOISELESS = "exact"
"""An estimator that draws no samples: any sampler gives the same image."""
ONE_SAMPLER = {NOISELESS: "independent", "textbook": "independent", "solid-angle": "sobol"}
"""Estimators measured with one sampler, since the slow ones take the same time with each."""


class SystemFailed(RuntimeError):
    """A system that is there but failed; the text says how."""


class Absent(Exception):
    """A system that is not installed or cannot render the scene; the text says why."""


class NotBuilt(RuntimeError):
    """A program of ours is missing."""

    exit_code = 3

    def __init__(self, program: Path) -> None:
        super().__init__(f"{os.path.relpath(program)} is missing: run `make bench`")


@dataclass(frozen=True)
class Frame:
    width: int
    height: int
    light_samples: int
    threads: int
    seed: int = 1


@dataclass(frozen=True)
class Shot:
    seconds: float
    """of rendering one frame: no start-up, and no file but where the system cannot do without"""
    radiance: np.ndarray | None
    """(height, width, 3)"""


class System(Protocol):
    @property
    def name(self) -> str:
        """in tables"""

    @property
    def version(self) -> str:
        """and what it is of"""

    @property
    def flexible(self) -> bool:
        """whether it renders any size, on any number of threads"""

    @property
    def box_filtered(self) -> bool:
        """whether each sample looks through another place of the pixel, not its centre"""

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        """Render. Raises SystemFailed."""


def program(name: str) -> Path:
    """One of ours. Raises NotBuilt."""
    path = ROOT / "build" / "bin" / name
    if not path.exists():
        raise NotBuilt(path)
    return path


# ---------------------------------------------------------------- Penumbra


class Loop:
    """The process of build/bin/penumbra-loop, or another that answers like it.

    Raises NotBuilt, SystemFailed.
    """

    def __init__(self, scene_file: Path, name: str = "penumbra-loop") -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="penumbra-bench-")
        self._process = _Lines(name, [str(program(name)), str(scene_file)], STEADY)
        names = self._process.read()
        self.version: str = names["version"]
        self.samplers: list[str] = names["samplers"]
        self.estimators: list[str] = names["estimators"]
        self._expected: dict[tuple[str, str, Frame], float] = {}

    def systems(self) -> list[Penumbra]:
        """Every estimator that the program offers, with the samplers that ONE_SAMPLER leaves it."""
        return [
            Penumbra(self, estimator, sampler)
            for estimator in self.estimators
            for sampler in self.samplers
            if sampler == ONE_SAMPLER.get(estimator, sampler)
        ]

    def shoot(self, estimator: str, sampler: str, frame: Frame, picture: bool) -> Shot:
        """The frame again and again for the time of a burst; the median of their seconds."""
        key = (estimator, sampler, Frame(**{**frame.__dict__, "seed": 0}))
        expected = self._expected.get(key, math.inf)
        frames = min(MOST_FRAMES, max(1, math.ceil(BURST / expected)))
        out = Path(self._folder.name) / "frame.f32"
        self._process.write(
            f"{estimator} {sampler} {frame.width} {frame.height} {frame.light_samples} "
            f"{frame.seed} {frame.threads} {frames} {out if picture else '-'}"
        )
        seconds = statistics.median(self._process.read()["seconds"])
        self._expected[key] = seconds
        if not picture:
            return Shot(seconds, None)
        planes = np.fromfile(out, np.float32).reshape(3, frame.height, frame.width)
        return Shot(seconds, np.moveaxis(planes, 0, 2).astype(float))

    def close(self) -> None:
        self._process.close()
        self._folder.cleanup()


@dataclass
class Penumbra:
    loop: Loop
    estimator: str
    sampler: str
    flexible: bool = True
    box_filtered: bool = False

    @property
    def version(self) -> str:
        return self.loop.version

    @property
    def name(self) -> str:
        if self.estimator == NOISELESS:
            return self.estimator
        return f"{self.estimator} {self.sampler}"

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        return self.loop.shoot(self.estimator, self.sampler, frame, picture)


# ---------------------------------------------------------------- others


def _refuse_other_lights(scene_file: Path, program: str) -> None:
    """Raises Absent for a scene of other lights than quads."""
    for light in read_scene(scene_file).lights:
        if not isinstance(light, QuadLight):
            raise Absent(f'the benchmark\'s {program} knows quad lights only, not "{light.name}"')


class ScalarLoop:
    """The lab's loop in scalar C, bench/scalar.c. Raises Absent, NotBuilt."""

    name = "scalar loop"
    flexible = False
    box_filtered = False

    def __init__(self, scene_file: Path) -> None:
        _refuse_other_lights(scene_file, "scalar loop")
        self._loop = Loop(scene_file, "scalar-loop")
        self.version = self._loop.version

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        return self._loop.shoot("textbook", "independent", frame, picture)

    def close(self) -> None:
        self._loop.close()


class EmbreeSystem:
    """Embree's rays with the textbook's light samples, bench/embree.c. Raises Absent."""

    name = "Embree"
    flexible = False
    box_filtered = False

    def __init__(self, scene_file: Path) -> None:
        _refuse_other_lights(scene_file, "Embree program")
        try:
            self._loop = Loop(scene_file, "embree-loop")
        except NotBuilt as error:
            raise Absent("not built: it needs Debian's libembree-dev, then `make bench`") from error
        except SystemFailed as error:  # built, but its library has gone since
            raise Absent(str(error)) from error
        self.version = self._loop.version

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        return self._loop.shoot("textbook", "independent", frame, picture)

    def close(self) -> None:
        self._loop.close()


class CyclesSystem:
    """Blender's Cycles; its seconds hold the scene's set-up and the writing of its EXR, which it
    offers no way to leave out. Raises Absent."""

    name = "Cycles"
    flexible = False
    box_filtered = False

    def __init__(self, scene_file: Path, width: int, height: int) -> None:
        from penumbra.blender_ref import Cycles, CyclesError, MissingBlender

        try:
            self._cycles = Cycles(scene_file, width, height)
        except (MissingBlender, CyclesError) as error:
            raise Absent(str(error)) from error
        self.version = f"bpy {self._cycles.version}"

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        image = self._cycles.render(frame.light_samples, frame.seed)
        return Shot(float(image.attributes["renderSeconds"]), image.radiance)

    def close(self) -> None:
        self._cycles.close()


class MitsubaSystem:
    """Mitsuba 3, spp = N, in the interpreter that has it. Raises Absent."""

    flexible = False
    box_filtered = True

    def __init__(
        self, scene_file: Path, width: int, height: int, threads: int, variant: str, python: str
    ) -> None:
        self.name = mitsuba_name(variant)
        self._folder = tempfile.TemporaryDirectory(prefix="penumbra-bench-")
        self._process = _Lines(
            self.name, [python, str(ROOT / "bench" / "mitsuba_process.py")], {}, cwd=ROOT / "bench"
        )
        try:
            scene = mitsuba_scene(read_scene(scene_file), width, height)
            ready = self._process.ask(variant=variant, threads=threads, scene=scene)
            # Its compiler is looked for when it is first needed.
            self.version = f"mitsuba {ready['version']}"
            self.shoot(Frame(width, height, 1, threads), picture=False)
        except (SystemFailed, UnsupportedScene) as error:
            self.close()
            said = str(error).removeprefix(f"{self.name}: ")
            raise Absent(f"{said}{_advice(said)}") from error

    def shoot(self, frame: Frame, picture: bool) -> Shot:
        out = Path(self._folder.name) / "frame.exr"
        done = self._process.ask(samples=frame.light_samples, seed=frame.seed, out=str(out))
        return Shot(done["seconds"], read_image(out).radiance if picture else None)

    def close(self) -> None:
        self._process.close()
        self._folder.cleanup()


def _advice(problem: str) -> str:
    if "No module named" in problem:
        return "; `make bench-extras` installs it"
    if "LLVM" in problem:
        return "; on Debian that is libllvm15 or another libllvm"
    return ""


def mitsuba_name(variant: str) -> str:
    """
    >>> mitsuba_name("llvm_ad_rgb")
    'Mitsuba llvm'
    """
    return f"Mitsuba {variant.partition('_')[0]}"


@dataclass
class _Lines:
    """A process that answers a line with a line of JSON."""

    name: str
    command: list[str]
    environment: dict[str, str]
    cwd: Path | None = None
    _process: subprocess.Popen[str] = field(init=False)

    def __post_init__(self) -> None:
        self._log = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115 (see close)
        self._process = subprocess.Popen(
            self.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | self.environment,
            cwd=self.cwd,
            start_new_session=True,  # Ctrl-C is ours alone: we then end the process
        )

    def write(self, line: str) -> None:
        assert self._process.stdin
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise SystemFailed(self._why()) from None

    def read(self) -> dict[str, Any]:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise SystemFailed(self._why())
        answer: dict[str, Any] = json.loads(line)
        if "failed" in answer:
            raise SystemFailed(f"{self.name}: {' '.join(answer['failed'].split())}")
        return answer

    def ask(self, **request: Any) -> dict[str, Any]:
        self.write(json.dumps(request))
        return self.read()

    def _why(self) -> str:
        code = self._process.wait()
        self._log.seek(0)
        said = " ".join(self._log.read()[-500:].split())
        return f"{self.name} ended with {code}: {said or 'it said nothing'}"

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
