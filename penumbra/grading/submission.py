"""What is in a class's folder: submissions, each with its name and its content as bytes.

Nothing of it is run, unpacked or decoded here, and no link is followed: that is done with the
content where it is judged (grade.py), which may be on another machine.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from penumbra.grading.archive import ending
from penumbra.grading.program import MANIFEST
from penumbra.language import _, say

PICTURES = (".exr", ".npy", ".pfm", ".hdr", ".png", ".bmp", ".ppm", ".jpg", ".jpeg")
"""What is read as a picture; of two with one stem the first is taken"""
MOST_BYTES = 256 << 20
MOST_FILES = 2000
DEEPEST = 12
"""Folders within each other"""
LOOKED_INTO = 2
"""Folders within each other in which pictures and a manifest are looked for: archives and learning
platforms wrap what was handed in"""


class FolderError(ValueError):
    """A folder that holds no class; the text says why."""


@dataclass(frozen=True)
class Entry:
    """A submission in the class's folder."""

    id: str
    """its name, escaped: printable, on one line, different for different names"""
    path: Path


@dataclass(frozen=True)
class File:
    """One file of a submission."""

    name: str
    """below the submission's folder, with /"""
    data: bytes
    executable: bool = False


@dataclass(frozen=True)
class Content:
    """What was handed in, as far as it is looked at."""

    files: tuple[File, ...]
    """sorted by name"""
    links: tuple[str, ...] = ()
    """names of what was not followed"""
    problem: tuple[str, str] | None = None
    """(code, sentence for the student): why nothing of it can be judged"""

    @property
    def key(self) -> str:
        """Of the bytes, whatever the submission is called."""
        whole = hashlib.sha256(repr((self.links, self.problem)).encode())
        for file in self.files:
            digest = hashlib.sha256(file.data).hexdigest()
            whole.update(repr((file.name, file.executable, digest)).encode())
        return whole.hexdigest()


def shown(name: str) -> str:
    r"""A file's name as one printable line; two names never become one.

    >>> shown("Zoé 1"), shown("a\nb"), shown("a\\nb"), shown("\u202egnp.exe")
    ('Zoé 1', 'a\\x0ab', 'a\\\\nb', '\\u202egnp.exe')
    """
    return "".join(_escaped(character) for character in name)


def _escaped(character: str) -> str:
    if character == "\\":
        return "\\\\"
    if character.isprintable():  # not: control, format (also right-to-left), lone surrogates
        return character
    code = ord(character)
    return (
        f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}" if code < 65536 else f"\\U{code:08x}"
    )


def entries(folder: Path, one: bool = False, leave: Iterable[Path] = ()) -> list[Entry]:
    """The submissions of a class, sorted by id; what starts with a dot is none. one: the folder
    itself is the only one. leave: results, that are none if they lie in the folder.

    Raises FolderError.
    """
    try:
        if one:
            if not folder.exists():
                raise FolderError(say("{folder}: no such folder or file", folder=folder))
            return [Entry(shown(folder.resolve().name), folder)]
        if not folder.is_dir():
            raise FolderError(
                say(
                    "{folder}: no such folder: give one with a subfolder a submission",
                    folder=folder,
                )
            )
        names = os.listdir(folder)
    except OSError as error:
        raise FolderError(
            say("{folder}: cannot be read: {strerror}", folder=folder, strerror=error.strerror)
        ) from error
    left = {path.resolve() for path in leave}
    found = [
        Entry(shown(name), folder / name)
        for name in names
        if not name.startswith(".") and (folder.resolve() / name) not in left
    ]
    if not found:
        raise FolderError(
            say("{folder}: is empty: give a folder with a subfolder a submission", folder=folder)
        )
    return sorted(found, key=lambda entry: entry.id)


def read(path: Path) -> Content:
    """A submission's content: all of it if there is a program, else the pictures and archives.
    Never raises for what a submission holds."""
    try:
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            return Content(
                (), (shown(path.name),), ("link", _("It is a link: links are not followed."))
            )
        if stat.S_ISREG(mode):
            return _gathered(path.parent, [path], [])
        if not stat.S_ISDIR(mode):
            said = _("It is neither a folder nor a file.")
            return Content((), (), ("unreadable", said))
        files, links = _walk(path)
        if not any(is_manifest(file.relative_to(path)) for file in files):
            files = [f for f in files if _may_tell(f.relative_to(path))]
        return _gathered(path, files, sorted(shown(str(link.relative_to(path))) for link in links))
    except OSError as error:
        said = say("It cannot be read: {reason}.", reason=error.strerror or error)
        return Content((), (), ("unreadable", said))
    except _TooMuchError as error:
        return Content((), (), ("too_large", str(error)))


class _TooMuchError(ValueError):
    """More than is looked at; the text says what."""


def is_manifest(name: str | Path) -> bool:
    """Whether a file of a submission says how to run its program."""
    parts = Path(name).parts
    return parts[-1] == MANIFEST and len(parts) <= LOOKED_INTO + 1


def _may_tell(name: Path) -> bool:
    kind = name.suffix.lower() in PICTURES or ending(name)
    return bool(kind) and len(name.parts) <= LOOKED_INTO + 1


def _walk(folder: Path) -> tuple[list[Path], list[Path]]:
    """Plain files, and links; without what hidden folders and macOS hold. Raises _TooMuchError."""
    files: list[Path] = []
    links: list[Path] = []
    todo = [(folder, 0)]
    while todo:
        here, depth = todo.pop()
        if depth > DEEPEST:
            raise _TooMuchError(say("Its folders are more than {deepest} deep.", deepest=DEEPEST))
        with os.scandir(here) as found:
            for entry in found:
                if entry.is_symlink():
                    links.append(Path(entry.path))
                elif entry.is_dir(follow_symlinks=False):
                    if not entry.name.startswith(".") and entry.name != "__MACOSX":
                        todo.append((Path(entry.path), depth + 1))
                elif entry.is_file(follow_symlinks=False) and not entry.name.startswith("._"):
                    files.append(Path(entry.path))
                if len(files) + len(links) + len(todo) > MOST_FILES:
                    raise _TooMuchError(
                        say("It holds more than {most_files} files.", most_files=MOST_FILES)
                    )
    return files, links


def _gathered(folder: Path, files: list[Path], links: list[str]) -> Content:
    """Raises _TooMuchError, OSError."""
    found, total = [], 0
    for file in files:
        descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                continue
            data = stream.read(MOST_BYTES - total + 1)
        total += len(data)
        if total > MOST_BYTES:
            raise _TooMuchError(
                say("It holds more than {most_bytes} MB.", most_bytes=MOST_BYTES >> 20)
            )
        name = str(PurePosixPath(*file.relative_to(folder).parts))
        found.append(File(name, data, bool(status.st_mode & stat.S_IXUSR)))
    return Content(tuple(sorted(found, key=lambda f: f.name)), tuple(links))
