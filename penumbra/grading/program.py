"""A submitted program: what its penumbra.toml says, its build, and its pictures, all in a cage."""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from penumbra.compare.check.program import FIRST, SCENES
from penumbra.compare.run.provenance import cores
from penumbra.compare.run.renderers import (
    SUFFIXES,
    CommandRenderer,
    Job,
    RendererError,
)
from penumbra.grading.archive import copy_folder
from penumbra.grading.cage import Cage, Desk, Ended, Limits, desk
from penumbra.grading.fault import Code, SubmissionFault
from penumbra.language import N_, _, say

MANIFEST = "penumbra.toml"
EXAMPLE = '[program]\nrun = "./mine {scene} {light_samples} {seed} {out}"'
LONGEST, MOST_BRACKETS = 100_000, 200
"""Of a penumbra.toml: bytes, and { and [ together"""
CANNOT_RUN, NOT_FOUND = 126, 127
"""Exit codes of what starts a program (POSIX's shell, prlimit, the warden)"""
NO_PROCESS = ("Cannot fork", "fork: retry", "fork: Resource temporarily unavailable")
"""What shells say when the kernel refuses one more, before all are seen at once"""
NO_MEMORY = ("MemoryError", "std::bad_alloc", "Cannot allocate memory", "OutOfMemoryError")
"""What Python, C++, C and Java print where the kernel refuses what is absurd, on this machine"""
ADVICE = {
    signal.SIGSEGV: N_(
        "it reads or writes memory that is not its own: look for an index out of range"
    ),
    signal.SIGBUS: N_("it reads or writes memory that is not its own"),
    signal.SIGABRT: N_("it gave up by itself: an assertion, or memory freed twice"),
    signal.SIGFPE: N_("it divides an integer by zero"),
    signal.SIGILL: N_("it was compiled for another processor: build without -march=native"),
    signal.SIGKILL: N_(
        "it was killed from outside or by itself: perhaps the machine had no memory"
    ),
}


class ManifestError(SubmissionFault):
    """A penumbra.toml that cannot be used; the text names file, line and key."""

    def __init__(self, text: str) -> None:
        super().__init__("manifest", text)

    def __reduce__(self) -> tuple[type[ManifestError], tuple[str]]:  # type: ignore[override]
        return type(self), (self.text,)


@dataclass(frozen=True)
class Manifest:
    """What a submission says of its program.

    [program]
    build = "make"                                             # a line for sh; may be left out
    run = "./mine {scene} {light_samples} {seed} {out}"        # no shell
    image_suffix = ".png"                                      # what {out} ends in [.exr]
    scenes = ["tp3"]                                           # it can read [all]
    """

    run: str
    build: str = ""
    image_suffix: str = ".exr"
    scenes: tuple[str, ...] = SCENES

    def renderer(self, timeout: float) -> CommandRenderer:
        """The run command, as one that would run without a cage. Raises RendererError."""
        return CommandRenderer("program", self.run, self.image_suffix, timeout)


def read_manifest(folder: Path) -> Manifest:
    """Of the submission in a folder. Raises ManifestError, OSError."""
    file = folder / MANIFEST
    if file.is_symlink() or not file.is_file():
        raise ManifestError(
            say(
                "{manifest}: not there: it says how to run your program:\n{example}",
                manifest=MANIFEST,
                example=EXAMPLE,
            )
        )
    try:
        with file.open("rb") as stream:
            text = stream.read(LONGEST).decode()
        if text.count("[") + text.count("{") > MOST_BRACKETS:  # tomllib calls itself for each
            raise ManifestError(
                say(
                    "{manifest}: more than {most_brackets} brackets: a few will do",
                    manifest=MANIFEST,
                    most_brackets=MOST_BRACKETS,
                )
            )
        table = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise ManifestError(
            say(
                "{manifest}: not UTF-8: save it as such ({reason})",
                manifest=MANIFEST,
                reason=error.reason,
            )
        ) from error
    except tomllib.TOMLDecodeError as error:  # says the line
        raise ManifestError(
            say("{manifest}: not TOML: {error}", manifest=MANIFEST, error=error)
        ) from error
    return _manifest(table, text)


def _manifest(table: dict[str, Any], text: str) -> Manifest:
    def wrong(key: str, why: str) -> ManifestError:
        found = re.search(rf'^[ \t]*\[?[ \t]*["\']?{re.escape(key)}\b', text, re.MULTILINE)
        line = f":{text.count(chr(10), 0, found.start()) + 1}" if found else ""
        return ManifestError(
            say("{manifest}{line}: {key}: {why}", manifest=MANIFEST, line=line, key=key, why=why)
        )

    for key in table.keys() - {"program"}:
        raise wrong(key, _("unknown: there is one table, [program]"))
    program = table.get("program")
    if not isinstance(program, dict):
        raise wrong(
            "program", say("there must be a table of that name:\n{example}", example=EXAMPLE)
        )
    known = {"build": str, "run": str, "image_suffix": str, "scenes": list}
    for key, value in program.items():
        if key not in known:
            raise wrong(key, say("unknown: known are {known}", known=", ".join(known)))
        if not isinstance(value, known[key]):
            raise wrong(key, _("must be a list") if known[key] is list else _("must be a text"))
        if isinstance(value, str) and ("\0" in value or "\n" in value.strip()):
            raise wrong(key, _("must be one line"))
    if "run" not in program:
        raise wrong("program", say("has no run:\n{example}", example=EXAMPLE))
    scenes = program.get("scenes", list(SCENES))
    for scene in scenes:
        if scene not in SCENES:
            raise wrong(
                "scenes",
                say("{scene!r}: known are {scenes}", scene=scene, scenes=", ".join(SCENES)),
            )
    if FIRST not in scenes:
        raise wrong("scenes", say("{first}, the lab's own, must be one of them", first=FIRST))
    if program.get("image_suffix", ".exr") not in SUFFIXES:
        raise wrong("image_suffix", say("must be one of {suffixes}", suffixes=", ".join(SUFFIXES)))
    manifest = Manifest(
        program["run"].strip(),
        program.get("build", "").strip(),
        program.get("image_suffix", ".exr"),
        tuple(scene for scene in SCENES if scene in scenes),
    )
    try:
        manifest.renderer(1.0)
    except RendererError as error:
        raise wrong("run", str(error)) from error
    return manifest


class Program:
    """A submission's program, in a copy of its folder, which `with` removes.

    >>> with Program(folder, read_manifest(folder), find_cage(), Limits()) as program:
    ...     program.build()
    ...     checked = check_renderer(program.renderer())         # doctest: +SKIP
    """

    def __init__(self, folder: Path, manifest: Manifest, cage: Cage, limits: Limits) -> None:
        self.folder, self.manifest, self.cage, self.limits = folder, manifest, cage, limits
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self.desk = self._open.enter_context(desk())
        try:
            copy_folder(self.folder, self.desk.home, self.limits)
        except BaseException:
            self._open.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def build(self) -> None:
        """As the manifest says. Raises SubmissionFault, CageError."""
        line = self.manifest.build
        if not line:
            return
        self.desk.clear()
        ended = self.cage.run(["sh", "-c", line], self.desk, self.limits, building=True)
        what = say("The build ({line})", line=line)
        raise_fault(ended, what, self.limits)
        if ended.code != 0:
            raise SubmissionFault(
                "build_failed",
                say(
                    "{what} {how}: try it in a fresh copy of what you handed in, and read what "
                    "it prints",
                    what=what,
                    how=meaning(ended.code),
                ),
                harmless(ended.printed),
            )

    def renderer(self) -> CagedRenderer:
        """What renders its pictures, for check_renderer."""
        command = self.manifest.renderer(self.limits.seconds)
        return CagedRenderer(command, self.desk, self.cage, self.limits)


@dataclass(frozen=True)
class CagedRenderer:
    """A program in a cage, as check_program's Subject."""

    command: CommandRenderer
    desk: Desk
    cage: Cage
    limits: Limits

    @property
    def suffix(self) -> str:
        return self.command.suffix

    @property
    def placeholders(self) -> frozenset[str]:
        return self.command.placeholders

    def run(self, job: Job, out: Path) -> float:
        """Render one image; the wall time [s]. Raises SubmissionFault, CageError."""
        self.desk.clear()
        scene = self.desk.scenes / job.scene_file.name
        if not scene.exists():
            shutil.copyfile(job.scene_file, scene)
            scene.chmod(0o644)
        there = self.cage.inside(self.desk)
        name = f"image{self.suffix}"
        # Each thread is one of its processes.
        threads = max(1, min(job.threads or cores(), self.limits.processes // 2))
        shown = replace(job, scene_file=there.scenes / scene.name, threads=threads)
        words = self.command.arguments(shown, there.tmp / name)
        environment = {"OMP_NUM_THREADS": str(threads)}
        ended = self.cage.run(words, self.desk, self.limits, environment)
        what = _rendering(job)
        raise_fault(ended, what, self.limits)
        if ended.code in (NOT_FOUND, CANNOT_RUN):
            raise SubmissionFault(
                "crashed",
                say(
                    "{program} could not be started: is it what your build makes, for Linux, and "
                    "named so in penumbra.toml?",
                    program=self.command.words[0],
                ),
                harmless(ended.printed),
            )
        if ended.code != 0:
            raise SubmissionFault(
                "crashed",
                say("{what} {how}", what=what, how=meaning(ended.code)),
                harmless(ended.printed),
            )
        self._take(name, out, what, harmless(ended.printed))
        return ended.seconds

    def _take(self, name: str, out: Path, what: str, printed: str) -> None:
        try:
            self.desk.take(name, out, self.limits.file_size)
        except FileNotFoundError as error:
            raise SubmissionFault(
                "no_image",
                say(
                    "{what} ended well but wrote no image: it must be in the file that {{out}} "
                    "names",
                    what=what,
                ),
                printed,
            ) from error
        except OSError as error:
            raise SubmissionFault(
                "bad_image",
                say(
                    "{what} left something else than a plain file where {{out}} is: write the "
                    "image itself there",
                    what=what,
                ),
                printed,
            ) from error

    def refused(self, job: Job, out: Path, why: str) -> SubmissionFault:
        why = why.replace(str(out), f"image{self.suffix}").replace(out.name, f"image{self.suffix}")
        return SubmissionFault(
            "bad_image", say("{rendering} {why}", rendering=_rendering(job), why=why)
        )


def _rendering(job: Job) -> str:
    m = say(" and {count} pixel samples", count=job.pixel_samples) if job.pixel_samples > 1 else ""
    return say(
        "Rendering {scene} with {count} light samples{m}, your program",
        scene=job.scene_file.stem,
        count=job.light_samples,
        m=m,
    )


def raise_fault(ended: Ended, what: str, limits: Limits) -> None:
    """Raise the SubmissionFault of a limit or a misdeed that ended a program, if one did."""
    mega = 1 / (1 << 20)
    limit: dict[str, str] = {
        "time_limit": say(
            "took longer than {seconds:g} s: make it faster, or look for a loop that does not end",
            seconds=limits.seconds,
        ),
        "memory_limit": say(
            "took more than {memory:,.0f} MB of memory", memory=limits.memory * mega
        ),
        "process_limit": say(
            "started more than {processes} processes and threads", processes=limits.processes
        ),
        "file_limit": say(
            "wrote a file of more than {file_size:,.0f} MB", file_size=limits.file_size * mega
        ),
        "disk_limit": say(
            "wrote more than {disk:,.0f} MB, or {files:,} files",
            disk=limits.disk * mega,
            files=limits.files,
        ),
        "output_limit": say(
            "printed more than {output:,.1f} MB: print less", output=limits.output * mega
        ),
        "forbidden": _(
            "did what no renderer needs and what is not allowed here: it opened a "
            "network connection, or looked into another process"
        ),
    }
    code: Code | None = ended.limit or None  # type: ignore[assignment]
    if ended.code == -signal.SIGSYS:
        code = "forbidden"
    elif ended.code == -signal.SIGXFSZ or (ended.code and ended.full_file):
        code = "file_limit"
    elif code == "time_limit" and any(said in ended.printed for said in NO_PROCESS):
        code = "process_limit"
    elif ended.code and any(said in ended.printed for said in NO_MEMORY):
        code = "memory_limit"
    if code:
        raise SubmissionFault(
            code, say("{what} {limit}", what=what, limit=limit[code]), harmless(ended.printed)
        )


def meaning(code: int | None) -> str:
    """How a program ended, in words."""
    if code is None or code >= 0:
        return say("ended with exit code {code}", code=code)
    try:
        kind = signal.Signals(-code)
    except ValueError:
        return say("was ended by signal {number}", number=-code)
    if kind in ADVICE:
        return say("was ended by {name}: {advice}", name=kind.name, advice=_(ADVICE[kind]))
    return say("was ended by {name}", name=kind.name)


def harmless(printed: str) -> str:
    """Without what could move a terminal's cursor or colour it."""
    return "".join(c if c.isprintable() or c in "\n\t" else "?" for c in printed).strip()
