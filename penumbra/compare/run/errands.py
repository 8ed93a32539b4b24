"""Rendering on a worker: what has to be brought along, and one image at a time on each machine."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shlex
import socket
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from penumbra.compare.run.provenance import machine
from penumbra.compare.run.renderers import (
    CommandRenderer,
    Job,
    MissingProgramError,
    Renderer,
    RendererError,
    penumbra_renderer,
)
from penumbra.compare.run.tasks import Lost, Scheduler, Task, content_key, run_tasks

ONE_THREAD = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""Dask sets them to 1 in its workers, and what they start would inherit that."""


@dataclass(frozen=True)
class SceneFile:
    """A scene file's name and bytes, for machines that may not see it."""

    name: str
    content: bytes

    @classmethod
    def of(cls, file: Path) -> SceneFile:
        return cls(file.name, file.read_bytes())


@dataclass(frozen=True)
class Rendered:
    """One image that came back."""

    file_name: str
    content: bytes
    seconds: float
    """wall time of the command [s]"""
    machine: dict[str, Any]


@dataclass(frozen=True)
class _Errand:
    scene: SceneFile
    jobs: tuple[Job, ...]
    renderer: Renderer | float
    """or the timeout [s] of the worker's own C renderer, wherever it was built"""
    program: str
    """what stamp() says of it here"""


def stamp(renderer: Renderer) -> str:
    """The same wherever the program is; of a command, what it is called does not count.

    Raises MissingProgramError.
    """
    found = renderer.fingerprint()
    return found.rpartition(" ")[2] if isinstance(renderer, CommandRenderer) else found


def absolute(renderer: CommandRenderer) -> CommandRenderer:
    """With the paths of this folder, since a worker runs in another.

    >>> absolute(CommandRenderer("a", "/b {scene} {light_samples} {seed} {out}")).words
    ('/b', '{scene}', '{light_samples}', '{seed}', '{out}')
    """
    first, *rest = renderer.words
    words = [str(Path(first).absolute()) if "/" in first else first]
    words += [str(Path(w).absolute()) if "{" not in w and Path(w).exists() else w for w in rest]
    return replace(renderer, command=shlex.join(words))


def rendered_elsewhere(
    renderer: Renderer, jobs: Iterable[Job], scheduler: Scheduler, together: int
) -> Iterator[tuple[Job, Rendered]]:
    """Each job with its image, as they get done.

    together: jobs of one task, for renderers that start slowly. Raises RendererError,
    MissingProgramError, and what run_tasks() raises.
    """
    jobs = list(jobs)
    program = stamp(renderer)
    sent: Renderer | float = renderer
    if isinstance(renderer, CommandRenderer):
        own = renderer.command == penumbra_renderer(renderer.timeout).command
        sent = renderer.timeout if own else absolute(renderer)
        together = 1
    scenes = {file: SceneFile.of(file) for file in {job.scene_file for job in jobs}}
    tasks = []
    for i in range(0, len(jobs), together):
        some = tuple(jobs[i : i + together])
        scene = scenes[some[0].scene_file]
        sizes = (f"{job.name} {job.width}x{job.height} {job.threads}" for job in some)
        tasks.append(
            Task(
                content_key(program, renderer.label, scene.name, scene.content, *sizes),
                _Errand(scene, some, sent, program),
            )
        )
    with contextlib.closing(run_tasks(_render, tasks, scheduler)) as done:
        for task, found in done:
            if isinstance(found, Lost):
                raise RendererError(
                    f"{renderer.label}: {task.argument.jobs[0].name}: {found.reason}"
                )
            yield from zip(task.argument.jobs, found, strict=True)


def _render(errand: _Errand) -> list[Rendered]:
    """On a worker. Raises RendererError, MissingProgramError."""
    renderer = errand.renderer
    if isinstance(renderer, float):
        renderer = penumbra_renderer(renderer)
    here = f"worker {socket.gethostname()}"
    try:
        if stamp(renderer) != errand.program:
            raise RendererError(
                f"{here}: its {renderer.label} is another program than the one here"
            )
        with alone_on_machine(), every_core(), brought(errand.scene) as scene_file:
            jobs = [replace(job, scene_file=scene_file) for job in errand.jobs]
            return [
                Rendered(file.name, file.read_bytes(), seconds, machine())
                for _, file, seconds in renderer.render(jobs, scene_file.parent)
            ]
    except MissingProgramError as error:
        raise MissingProgramError(f"{here}: {error}") from error


@contextlib.contextmanager
def brought(scene: SceneFile) -> Iterator[Path]:
    """The scene as a file, in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        file = Path(folder, scene.name)
        file.write_bytes(scene.content)
        yield file


@contextlib.contextmanager
def alone_on_machine() -> Iterator[None]:
    """Nobody else of this user in here meanwhile, whatever the number of workers: times count."""
    lock = Path(tempfile.gettempdir(), f"penumbra-timed-{os.getuid()}.lock")
    with open(os.open(lock, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW, 0o600), "rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def every_core() -> Iterator[None]:
    """Without what keeps a program to one thread, if Dask set it."""
    kept = {name: os.environ.pop(name) for name in ONE_THREAD if os.environ.get(name) == "1"}
    try:
        yield
    finally:
        os.environ.update(kept)
