"""One submission's content in, what is to be said of it out: a function of nothing else.

It runs in workers, which may be on other machines: what it says holds no path, no time and no
machine. Points and hints are given afterwards (gradebook.py), so that another rubric costs nothing.
"""

from __future__ import annotations

import atexit
import base64
import contextlib
import io
import math
import os
import re
import shutil
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from penumbra.compare.check.checking import (
    Checked,
    Checker,
    check_renderer,
    too_small,
    verdict_json,
)
from penumbra.compare.check.explanation import headline, text, title
from penumbra.compare.check.picture import Picture, counts_in_name, read_picture
from penumbra.compare.check.program import FIRST
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, WRONG
from penumbra.compare.check.view import View
from penumbra.compare.measure.image import ImageError
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.run.renderers import Job, RendererError
from penumbra.grading.archive import ending, unpack
from penumbra.grading.cage import Limits, find_cage
from penumbra.grading.claims import HINTS, State, missing, states, untold
from penumbra.grading.fault import SubmissionFault
from penumbra.grading.program import MANIFEST, CagedRenderer, Program, read_manifest
from penumbra.grading.submission import PICTURES, Content, File, is_manifest, read, shown
from penumbra.language import NO_BREAK, _, say, speaking

PATTERN = "n{light_samples}_m{pixel_samples}.png"
PLACEHOLDERS = {
    "light_samples": r"0*(?P<light_samples>[1-9]\d{0,5})",
    "pixel_samples": r"0*(?P<pixel_samples>[1-9]\d{0,5})",
    "scene": r"(?P<scene>[A-Za-z][\w-]*)",
}
MOST_PICTURES = 24
"""Of one scene that are judged: as many as any lab asks for, and minutes of work at the most"""
ASKED_FOR = 8
"""Pictures of a program's, beside three for seeds and threads"""
BEARABLE = ("time_limit", "memory_limit", "crashed", "no_image", "bad_image")
"""What may happen to an honest program in a scene that it was not made for"""
PRINTED, MOST_PRINTED = ("build_failed", "crashed", "no_image"), 2000
"""Faults of which the end of what was printed is shown, and how much of it [characters]"""
THUMBNAIL, QUALITY = 160, 80
"""Width [pixels], and JPEG's quality"""
NAMED = 3
"""Pictures that are named one by one before it is said that there are more"""


class PatternError(ValueError):
    """A pattern of pictures' names that cannot be used; the text says why."""


@dataclass(frozen=True)
class Options:
    """What decides what is said of a submission, beside its content."""

    scene: str
    """the name of the scene's file, as it is shown"""
    scene_text: bytes
    images: str = PATTERN
    trusted: bool = False
    """programs run without a cage"""
    limits: Limits = field(default_factory=Limits)
    language: str = "en"
    """that is spoken to students, of language.LANGUAGES"""

    @property
    def key(self) -> str:
        return sha256(repr(self).encode()).hexdigest()


@dataclass(frozen=True)
class Handed:
    """A picture that was handed in, by its name."""

    file: Path
    """where it is written to, to be read"""
    data: bytes
    name: str
    """below the submission's folder, escaped"""
    scene: str | None
    """that the name says; None: the lab's"""
    light_samples: int
    pixel_samples: int


def judge(argument: tuple[Content, Options]) -> dict[str, Any]:
    """What is to be said of a submission, as JSON: "states" of the claims, "texts" a hint level,
    verdict and evidence. Whatever a submission holds, it is said and never raised.

    Raises MissingProgramError, MissingCageError, OSError: the machine's faults.
    """
    content, options = argument
    if content.problem:
        return _failed(*content.problem)
    with speaking(options.language), tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        try:
            return _judged(content, options, Path(folder))
        except SubmissionFault as fault:
            return _failed(fault.code, fault.text, fault.printed)
        except (OSError, ImportError):
            raise
        except Exception as error:
            if hasattr(error, "exit_code"):
                raise
            return _unforeseen(f"{type(error).__name__}: {error}".replace(folder, ""))


# ---------------------------------------------------------------- what was handed in


def pattern_of(images: str) -> re.Pattern[str]:
    """Of names without their endings. Raises PatternError.

    >>> bool(pattern_of("n{light_samples}_m{pixel_samples}.png").fullmatch("n016_m1"))
    True
    """
    stem = _stem(images)
    found = ""
    for piece in re.split(r"(\{[^{}]*\}|\*)", stem):
        name = piece[1:-1]
        if piece == "*":
            found += "[^/]*"
        elif piece.startswith("{"):
            if name not in PLACEHOLDERS:
                known = " ".join(f"{{{p}}}" for p in PLACEHOLDERS)
                raise PatternError(f"{images}: {piece}: a pattern may have {known} and *")
            if f"(?P<{name}>" in found:
                raise PatternError(
                    say("{images}: {piece} stands there twice", images=images, piece=piece)
                )
            found += PLACEHOLDERS[name]
        else:
            found += re.escape(piece)
    if "(?P<light_samples>" not in found:
        raise PatternError(say("{images}: without {{light_samples}} nobody knows N", images=images))
    return re.compile(found, re.IGNORECASE)


def _stem(name: str) -> str:
    """Without the ending of a picture, if it has one."""
    ending = Path(name).suffix
    return name.removesuffix(ending) if ending.lower() in PICTURES else name


def _judged(content: Content, options: Options, folder: Path) -> dict[str, Any]:
    """Raises SubmissionFault, MissingProgramError, MissingCageError, CageError, OSError."""
    content = _opened(content, options, folder)
    if content.problem:
        return _failed(*content.problem)
    handed, notes = _handed(content, folder, options)
    if _manifests(content):
        try:
            return _of_program(content, bool(handed), options, folder)
        except SubmissionFault as fault:
            return _failed(fault.code, fault.text, fault.printed, "program")
    if not handed:
        raise SubmissionFault("no_image", _nothing(content, options))
    for one in handed:
        one.file.parent.mkdir(exist_ok=True)
        one.file.write_bytes(one.data)
    return _of_pictures(handed, notes, options)


def _opened(content: Content, options: Options, folder: Path) -> Content:
    """What an archive holds, where nothing else was handed in. Raises SubmissionFault."""
    archives = [file for file in content.files if ending(Path(file.name))]
    if not archives or _manifests(content) or _handed(content, folder, options)[0]:
        return content
    return _unpacked(archives, options, folder)


def _manifests(content: Content) -> list[str]:
    return [file.name for file in content.files if is_manifest(file.name)]


def _unpacked(archives: Sequence[File], options: Options, folder: Path) -> Content:
    """Raises SubmissionFault."""
    if len(archives) > 1:
        names = _listed([shown(file.name) for file in archives], _("it holds"))
        raise SubmissionFault("archive", say("Hand in one archive: {names}.", names=names))
    name = shown(Path(archives[0].name).name)
    file = folder / f"archive{ending(Path(name))}"
    file.write_bytes(archives[0].data)
    into = folder / "unpacked"
    try:
        unpack(file, into, options.limits)
    except SubmissionFault as fault:
        raise SubmissionFault(fault.code, fault.text.replace(file.name, name, 1)) from fault
    return read(into)


def _handed(content: Content, folder: Path, options: Options) -> tuple[list[Handed], list[str]]:
    """The pictures that names say something of, one a stem; and what is to be said of others."""
    pattern = pattern_of(options.images)
    root = folder / "pictures"
    by_pattern, by_counts = [], []
    for i, file in enumerate(content.files):
        ending_ = Path(file.name).suffix.lower()
        if ending_ not in PICTURES:
            continue
        stem = _stem(file.name)
        match = pattern.fullmatch(stem if "/" in options.images else stem.rpartition("/")[2])
        place, name = root / f"{i}{ending_}", shown(file.name)
        if match:
            said = match.groupdict()
            n, m = int(said["light_samples"]), int(said.get("pixel_samples") or 1)
            by_pattern.append(Handed(place, file.data, name, said.get("scene"), n, m))
        else:
            found, pixel = counts_in_name(file.name)
            if found:
                by_counts.append(Handed(place, file.data, name, None, found, pixel or 1))
    return _one_a_stem(by_pattern or by_counts)


def _one_a_stem(handed: Sequence[Handed]) -> tuple[list[Handed], list[str]]:
    first: dict[str, Handed] = {}
    notes = []
    for picture in sorted(handed, key=lambda h: PICTURES.index(h.file.suffix.lower())):
        twin = first.setdefault(_stem(picture.name), picture)
        if twin is not picture:
            notes.append(
                say(
                    "{name} is left out: {twin} is the same picture by its name",
                    name=picture.name,
                    twin=twin.name,
                )
            )
    found = sorted(
        first.values(), key=lambda h: (h.scene or "", h.light_samples, h.pixel_samples, h.name)
    )
    if len(found) > MOST_PICTURES:
        notes.append(
            say(
                "of {count} pictures the first {most_pictures} are looked at",
                count=len(found),
                most_pictures=MOST_PICTURES,
            )
        )
    return found[:MOST_PICTURES], notes


def _nothing(content: Content, options: Options) -> str:
    """What to say where there is nothing to judge."""
    names = [shown(file.name) for file in content.files]
    there = _listed(names, "it holds") if names else _("there is none in it")
    if content.links and not names:
        there = say("it holds links only ({links}), which are not followed", links=content.links[0])
    return say(
        "Nothing to judge: pictures named {images} (or n016_aa01.png; as .png, .bmp, .jpg, "
        ".ppm, .exr, .pfm, .hdr or .npy) or a {manifest} were looked for, and {there}.",
        images=options.images,
        manifest=MANIFEST,
        there=there,
    )


def _listed(names: Sequence[str], lead: str) -> str:
    more = say(" and {count} more", count=len(names) - NAMED) if len(names) > NAMED else ""
    return say("{lead} {names}{more}", lead=lead, names=", ".join(names[:NAMED]), more=more)


# ---------------------------------------------------------------- pictures


_of_thread = threading.local()
_writing = threading.Lock()


def _checker() -> Checker:
    """What pictures of the same rays share, within a thread of a worker."""
    _of_thread.checker = getattr(_of_thread, "checker", None) or Checker()
    found: Checker = _of_thread.checker
    return found


def _of_pictures(handed: Sequence[Handed], notes: list[str], options: Options) -> dict[str, Any]:
    """Raises SubmissionFault."""
    by_scene: dict[str | None, list[Handed]] = {}
    for picture in handed:
        own = picture.scene
        if own is not None and own.lower() == Path(options.scene).stem.lower():
            own = None
        by_scene.setdefault(own, []).append(picture)
    checked: dict[str | None, Checked] = {}
    pictures: list[Picture] = []
    for scene in sorted(by_scene, key=lambda name: name or ""):
        file = _scene_file(options) if scene is None else shipped_scene(scene)
        if file is None:
            notes.append(
                say("{name}: no scene is called {scene}", name=by_scene[scene][0].name, scene=scene)
            )
            continue
        views, fitted = _looked_at(by_scene[scene], file, notes)
        if views:
            checked[scene] = _checker().decide(views, fitted, file)
            pictures += [view.picture for view in views]
    if not checked:
        raise SubmissionFault("bad_image", "; ".join(notes[:NAMED]) + ".")
    first, *others = checked
    said = _said(
        "images",
        checked[first],
        [(str(name), checked[name]) for name in others],
        pictures,
        notes,
    )
    words = {str(_scene_file(options)): options.scene}
    words[f"{ROOT / 'scenes'}{os.sep}"] = "scenes/"
    return dict(plain(said, words))


def _looked_at(
    handed: Sequence[Handed], scene_file: Path, notes: list[str]
) -> tuple[list[View], list[Any]]:
    """Those that can be read and tell something; of the others it is noted why not."""
    scene = _checker().scene(scene_file)
    pictures = []
    for one in handed:
        try:
            picture = read_picture(one.file, scene, one.light_samples, one.pixel_samples)
        except ImageError as error:
            notes.append(
                say(
                    "{name}: left out: {reason}",
                    name=one.name,
                    reason=_without(str(error), one.file),
                )
            )
            continue
        pictures.append(replace(picture, name=one.name))
    if not pictures:
        return [], []
    views, fitted = _checker().look(pictures, scene_file)
    kept = []
    for view, fit in zip(views, fitted, strict=True):
        if reason := too_small(view):
            notes.append(reason)
        else:
            kept.append((view, fit))
    return [view for view, _ in kept], [fit for _, fit in kept]


def _without(message: str, file: Path) -> str:
    named = rf"{re.escape(str(file))}{NO_BREAK}?: | '{re.escape(str(file))}'"
    return re.sub(named, "", message).replace(str(file), _("it"))


# ---------------------------------------------------------------- a program


@contextlib.contextmanager
def built(content: Content, options: Options, folder: Path) -> Iterator[Program]:
    """The program that was handed in, ready to run in its cage; folder: an empty one.

    Raises SubmissionFault, MissingCageError, CageError, OSError.
    """
    content = _opened(content, options, folder)
    manifests = _manifests(content)
    if len(manifests) > 1:
        names = _listed([shown(name) for name in manifests], "it holds")
        raise SubmissionFault("manifest", say("Hand in one program: {names}.", names=names))
    home = folder / "program"
    top = manifests[0].removesuffix(MANIFEST)
    for file in content.files:
        if file.name.startswith(top):
            path = home / file.name.removeprefix(top)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.data)
            path.chmod(0o755 if file.executable else 0o644)
    manifest = read_manifest(home)
    with Program(home, manifest, _cage(options.trusted), options.limits) as program:
        program.build()
        yield program


def _of_program(content: Content, beside: bool, options: Options, folder: Path) -> dict[str, Any]:
    """Raises SubmissionFault, MissingCageError, CageError, OSError."""
    with built(content, options, folder) as program:
        subject = _Bearable(program.renderer())
        checked = check_renderer(subject, scenes=program.manifest.scenes, pictures=ASKED_FOR)
    notes = [_("the pictures beside the program are not looked at")] if beside else []
    pictures = [
        replace(trial.view.picture, name=str(trial.experiment))
        for trial in checked.examined.trials  # type: ignore[union-attr]
    ]
    said = _said("program", checked, [], pictures, notes)
    return dict(plain(said, {f"{ROOT / 'scenes'}{os.sep}": "scenes/"}))


_cage = cache(find_cage)
"""Of this machine"""


@dataclass(frozen=True)
class _Bearable:
    """A program as check_program's Subject, that may fail on scenes beyond the lab's: it is said,
    and the rest is judged."""

    renderer: CagedRenderer

    @property
    def suffix(self) -> str:
        return self.renderer.suffix

    @property
    def placeholders(self) -> frozenset[str]:
        return self.renderer.placeholders

    def run(self, job: Job, out: Path) -> float:
        try:
            return self.renderer.run(job, out)
        except SubmissionFault as fault:
            raise self._borne(job, fault) from fault

    def refused(self, job: Job, out: Path, why: str) -> ValueError:
        return self._borne(job, self.renderer.refused(job, out, why))

    def _borne(self, job: Job, fault: SubmissionFault) -> ValueError:
        if fault.code in BEARABLE and job.scene_file.stem != FIRST:
            return RendererError(fault.text)
        return fault


def shipped_scene(name: str) -> Path | None:
    """One of Penumbra's by its name, in any case."""
    folder = ROOT / "scenes"
    for file in sorted(folder.glob("*.json")):
        if file.stem.lower() == name.lower() and "schema" not in file.name:
            return file
    return None


def _scene_file(options: Options) -> Path:
    """The lab's scene as a file of this machine: the shipped one if it is that."""
    own = ROOT / "scenes" / Path(options.scene).name
    if own.is_file() and own.read_bytes() == options.scene_text:
        return own
    file = _scratch() / f"{sha256(options.scene_text).hexdigest()[:16]}.json"
    with _writing:
        if not file.exists():
            write_whole(file, lambda part: part.write_bytes(options.scene_text))
    return file


@cache
def _scratch() -> Path:
    """Of this process, until it ends."""
    folder = tempfile.mkdtemp(prefix="penumbra-scenes-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


# ---------------------------------------------------------------- what is said


def _said(
    kind: str,
    first: Checked,
    others: Sequence[tuple[str, Checked]],
    pictures: Sequence[Picture],
    notes: Sequence[str],
) -> dict[str, Any]:
    found = first.verdict
    every = [found, *(checked.verdict for _, checked in others)]
    words = [f.verdict for f in every]
    word = next((w for w in (WRONG, CANNOT_TELL) if w in words), RIGHT_)
    told = found if found.verdict == word else next(f for f in every if f.verdict == word)
    names = list(dict.fromkeys(name for f in every for name in f.mistakes))
    facts = dict.fromkeys(said for f in every for _, said in f.facts)
    return {
        "kind": kind,
        "status": "graded",
        "problem": None,
        "verdict": word,
        "confidence": told.confidence,
        "headline": headline(told),
        "texts": [_text(first, others, notes, hint) for hint in range(HINTS)],
        "mistakes": names,
        "titles": [title(name) for name in names],
        "perhaps": list(dict.fromkeys(name for f in every for name in f.perhaps)),
        "alike": list(dict.fromkeys(tuple(a) for f in every for a in f.alike)),
        "facts": [*facts, *notes],
        "states": {claim: asdict(state) for claim, state in states(first, others).items()},
        "pictures": [
            {
                "name": picture.name,
                "light_samples": picture.nb_light_samples,
                "pixel_samples": picture.samples_per_pixel,
                "thumbnail": thumbnail(picture.values),
            }
            for picture in pictures
        ],
        "evidence": _evidence(first),
        "other_scenes": [
            {"scene": scene, "verdict": checked.verdict.verdict, "evidence": _evidence(checked)}
            for scene, checked in others
        ],
    }


def _text(
    first: Checked, others: Sequence[tuple[str, Checked]], notes: Sequence[str], hint: int
) -> str:
    said = text(first.verdict, hint)
    for scene, checked in others:
        said += f"\n{scene}:\n{text(checked.verdict, hint)}"
    return (
        said
        + "".join(say("\nNote: {note}.", note=note) for note in notes)
        + ("\n" if notes else "")
    )


def _evidence(checked: Checked) -> dict[str, Any]:
    """Every figure, without what differs from machine to machine."""
    whole = verdict_json(checked, 3)
    del whole["origin"], whole["exhibits"]
    for picture in whole["pictures"]:
        picture.pop("seconds", None)
    whole["excluded"] = list(checked.diagnosis.excluded)
    return whole


def _failed(code: str, said: str, printed: str = "", kind: str = "none") -> dict[str, Any]:
    problem = {"code": code, "text": said.rstrip(".") + "."}
    if printed and code in PRINTED:
        problem["printed"] = printed[-MOST_PRINTED:]
    return _nothing_said(kind, problem, missing())


def lost(reason: str) -> dict[str, Any]:
    """Of a submission that ended every process that worked on it."""
    said = say(
        "Judging it ended the process that did: {reason}. Is one of its files damaged?",
        reason=reason,
    )
    return _failed("killed_worker", said)


def _unforeseen(error: str) -> dict[str, Any]:
    """A fault of ours, which neither ends the class nor costs a point."""
    said = say(
        "Penumbra itself failed on it, which is no fault of the submission's ({error}).",
        error=error,
    )
    return _nothing_said("none", {"code": "internal", "text": said}, untold(said))


def _nothing_said(kind: str, problem: dict[str, str], claims: dict[str, State]) -> dict[str, Any]:
    return {
        "kind": kind,
        "status": "failed",
        "problem": problem,
        "verdict": CANNOT_TELL,
        "confidence": 0.0,
        "headline": problem["text"],
        "texts": [problem["text"] + "\n"] * HINTS,
        **{key: [] for key in ("mistakes", "titles", "perhaps", "alike", "facts")},
        "states": {claim: asdict(state) for claim, state in claims.items()},
        "pictures": [],
        "evidence": None,
        "other_scenes": [],
    }


def thumbnail(values: np.ndarray) -> str:
    """(H, W, 3) linear values as they look, small, as a data URI."""
    levels = (np.clip(values, 0, 1) * 255).astype(np.uint8)
    small = PillowImage.fromarray(levels)
    small.thumbnail((THUMBNAIL, THUMBNAIL))
    stream = io.BytesIO()
    small.save(stream, "JPEG", quality=QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(stream.getvalue()).decode()


def plain(value: Any, words: dict[str, str]) -> Any:
    """As JSON: six digits of a number, so that machines agree on it, null for what is none; and
    words for what texts hold (paths of this machine).

    >>> plain((1.23456789, math.inf, "/tmp/x.json: no"), {"/tmp/x.json": "x"})
    [1.23457, None, 'x: no']
    """
    if isinstance(value, dict):
        return {str(key): plain(item, words) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, words) for item in value]
    if isinstance(value, bool | int) or value is None:
        return value
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.6g}") if math.isfinite(value) else None
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    found = str(value)
    for was, becomes in words.items():
        found = found.replace(was, becomes)
    return found
