"""A renderer is a command that turns (scene, light samples, seed) into an image file."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import string
import subprocess
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

from penumbra.compare.run.provenance import HOW_TO_BUILD, ROOT, cores, file_hash
from penumbra.language import _, say

SUFFIXES = (".exr", ".pfm", ".hdr", ".png", ".jpg", ".bmp")
REQUIRED = ("scene", "light_samples", "seed", "out")
OPTIONAL = ("width", "height", "pixel_samples", "threads")
TIMEOUT = 600.0
"""One image may take this long [s]; the slowest student renderer met needs a tenth of it."""
TAIL_BYTES = 2000
"""How much of what a failed command printed is repeated."""


class RendererError(ValueError):
    """A command that is no renderer, or that did not make an image; the text says which."""


class MissingProgramError(RuntimeError):
    """A program that is not installed or not built; the text says what to do."""

    exit_code = 3


@dataclass(frozen=True)
class Job:
    """One image to render."""

    scene_file: Path
    width: int
    height: int
    light_samples: int
    pixel_samples: int
    seed: int
    threads: int | None = None
    """None: every core that there is"""

    @property
    def name(self) -> str:
        return f"n{self.light_samples}_m{self.pixel_samples}_s{self.seed}"


class Renderer(Protocol):
    """What convergence needs of a renderer."""

    @property
    def label(self) -> str:
        """its name in tables and figures"""

    @property
    def command(self) -> str:
        """what is run, for people to read"""

    @property
    def suffix(self) -> str:
        """of its images, one of SUFFIXES"""

    @property
    def placeholders(self) -> frozenset[str]:
        """which of REQUIRED and OPTIONAL it takes"""

    def fingerprint(self) -> str:
        """Changes whenever its images may. Raises MissingProgramError."""

    def render(self, jobs: Iterable[Job], folder: Path) -> Iterator[tuple[Job, Path, float]]:
        """Each job with its image, a file in folder, and the wall time it took [s].

        Raises RendererError, MissingProgramError.
        """


@dataclass(frozen=True)
class CommandRenderer:
    """Any program: a command with {scene} {light_samples} {seed} {out}, run without a shell.

    {width} {height} {pixel_samples} {threads} may be used too. Raises RendererError for a
    command with an unknown placeholder or without one of the four.

    >>> CommandRenderer("mine", "./mine {scene} {light_samples} {seed} {out}").words
    ('./mine', '{scene}', '{light_samples}', '{seed}', '{out}')
    """

    label: str
    command: str
    suffix: str = ".exr"
    timeout: float = TIMEOUT
    advice: str = "build it first, or give its path"
    """what to do if the program is missing"""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w.+-]{1,40}", self.label):
            raise RendererError(f'"{self.label}": a label is up to 40 letters, digits and ._+-')
        if self.suffix not in SUFFIXES:
            raise RendererError(f"{self.suffix}: images are one of {', '.join(SUFFIXES)}")
        missing = [p for p in REQUIRED if p not in self.placeholders]
        if missing:
            names = ", ".join(f"{{{p}}}" for p in missing)
            raise RendererError(
                say(
                    "{label}: the command has no {names}: {command}",
                    label=self.label,
                    names=names,
                    command=self.command,
                )
            )

    @property
    def words(self) -> tuple[str, ...]:
        try:
            words = tuple(shlex.split(self.command))
        except ValueError as error:
            raise self._unreadable(error) from error
        if not words:
            raise RendererError(say("{label}: the command is empty", label=self.label))
        return words

    def _unreadable(self, error: ValueError) -> RendererError:
        return RendererError(
            say("{label}: {error}: {command}", label=self.label, error=error, command=self.command)
        )

    @property
    def placeholders(self) -> frozenset[str]:
        try:
            fields = [field for word in self.words for field in string.Formatter().parse(word)]
        except ValueError as error:
            raise self._unreadable(error) from error
        names = []
        for _literal, name, spec, conversion in fields:
            if name is None:
                continue
            if name not in REQUIRED + OPTIONAL or spec or conversion:
                known = " ".join(f"{{{p}}}" for p in REQUIRED + OPTIONAL)
                raise RendererError(
                    say(
                        "{label}: unknown placeholder {{{name}}}; known ones are {known}",
                        label=self.label,
                        name=name,
                        known=known,
                    )
                )
            names.append(name)
        return frozenset(names)

    def arguments(self, job: Job, out: Path) -> list[str]:
        values = {
            "scene": str(job.scene_file),
            "light_samples": str(job.light_samples),
            "seed": str(job.seed),
            "out": str(out),
            "width": str(job.width),
            "height": str(job.height),
            "pixel_samples": str(job.pixel_samples),
            "threads": str(job.threads or cores()),
        }
        return [word.format_map(values) for word in self.words]

    def fingerprint(self) -> str:
        """The command, and the contents of each file that it names (program, script)."""
        program = shutil.which(self.words[0])
        if program is None:
            raise self._missing()
        named = (Path(word) for word in self.words[1:] if "{" not in word)
        files = [Path(program), *(file for file in named if file.is_file())]
        return f"{self.command} {self.suffix} {file_hash(*files)}"

    def render(self, jobs: Iterable[Job], folder: Path) -> Iterator[tuple[Job, Path, float]]:
        for job in jobs:
            out = folder.absolute() / f"{self.label}_{job.name}{self.suffix}"
            yield job, out, self.run(job, out)

    def run(self, job: Job, out: Path) -> float:
        """Render one image; the wall time of the command [s].

        Raises RendererError if it fails, hangs or writes no file, MissingProgramError.
        """
        words = self.arguments(job, out)
        start = time.perf_counter()
        try:
            ran = run_program(words, self.timeout)
        except (FileNotFoundError, PermissionError) as error:
            raise self._missing() from error
        except OSError as error:
            raise RendererError(
                say(
                    "{label}: {program}: {reason}",
                    label=self.label,
                    program=words[0],
                    reason=error.strerror,
                )
            ) from error
        seconds = time.perf_counter() - start
        if ran.code is None:
            problem = say("gave no image in {timeout:g} s", timeout=self.timeout)
        elif ran.code != 0:
            problem = say("ended with {how}", how=_meaning(ran.code))
        elif not out.is_file():
            problem = say("ended well but wrote no image {name}", name=out.name)
        else:
            return seconds
        raise RendererError(
            say(
                "{label}: {problem}: {words}{said}",
                label=self.label,
                problem=problem,
                words=shlex.join(words),
                said=ran.said(),
            )
        )

    def refused(self, job: Job, out: Path, why: str) -> RendererError:
        """The error of an image that was made and is of no use."""
        return RendererError(
            say(
                "{label}: {why}: {arguments}",
                label=self.label,
                why=why,
                arguments=shlex.join(self.arguments(job, out)),
            )
        )

    def _missing(self) -> MissingProgramError:
        return MissingProgramError(
            say(
                "{label}: {program} is not there or cannot be run: {advice}",
                label=self.label,
                program=self.words[0],
                advice=self.advice,
            )
        )


@dataclass(frozen=True)
class Ran:
    code: int | None
    """exit code, minus the signal that ended it, or None after a timeout"""
    printed: str
    """the end of what it wrote to stdout and stderr"""

    def said(self) -> str:
        """The end of what it printed, for a message, harmless to a terminal."""
        text = "".join(c if c.isprintable() or c in "\n\t" else "?" for c in self.printed).strip()
        return say("; it printed:\n{text}", text=text) if text else _("; it printed nothing")


def run_program(words: list[str], timeout: float) -> Ran:
    """Run a command and whatever it starts, which all end with it, or at the timeout [s].

    Raises OSError if it cannot be started.
    """
    process: subprocess.Popen[bytes] | None = None
    tail = bytearray()
    code: int | None = None
    try:
        with interrupts_held():  # else one in here would lose sight of what was started
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # a group of its own, to end its children too
            )
        reader = threading.Thread(target=_keep_tail, args=(process.stdout, tail), daemon=True)
        reader.start()
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(timeout)
    finally:
        if process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    reader.join(1)
    return Ran(code, tail.decode(errors="replace"))


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the block is done. Only the main thread gets them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    kinds = (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.signal(kind, lambda number, _: held.append(number)) for kind in kinds}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
        if held:
            signal.raise_signal(held[0])


def _keep_tail(stream: IO[bytes], tail: bytearray) -> None:
    """Read to the end, however much it is, and keep the last bytes."""
    with stream:
        while chunk := stream.read1(1 << 16):  # type: ignore[attr-defined]
            tail += chunk
            del tail[:-TAIL_BYTES]


def _meaning(code: int) -> str:
    if code >= 0:
        return say("exit code {code}", code=code)
    try:
        return say("signal {name}", name=signal.Signals(-code).name)
    except ValueError:
        return say("signal {number}", number=-code)


def penumbra_renderer(timeout: float = TIMEOUT) -> CommandRenderer:
    """The C renderer of this repository."""
    program = os.path.relpath(ROOT / "build" / "bin" / "penumbra-render")
    return CommandRenderer(
        "penumbra",
        f"{shlex.quote(program)} {{scene}} -o {{out}} --light-samples {{light_samples}} "
        "--pixel-samples {pixel_samples} --seed {seed} --threads {threads} "
        "--width {width} --height {height}",
        timeout=timeout,
        advice=HOW_TO_BUILD,
    )
