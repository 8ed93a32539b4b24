"""Submissions as they come: an archive unpacked, or a folder copied, within limits.

What an archive declares is never trusted: bytes are counted as they are written, names are taken
apart and put together again, and of all that archives can hold only plain files and folders are
made. Nothing stays behind if something is refused.
"""

from __future__ import annotations

import bz2
import errno
import gzip
import io
import lzma
import os
import stat
import tarfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from penumbra.grading.cage import Limits, remove
from penumbra.grading.fault import SubmissionFault
from penumbra.language import _, say

FILES = 10_000
"""Files and folders of a submission"""
DEEPEST = 32
"""Folders in folders"""
LONGEST_NAME = 255
"""Of a file or folder [bytes]: what Linux's file systems take"""
DIRECTORY = 4 << 20
"""A zip's table of contents [bytes]: 400 for each of FILES; it is read as a whole"""
HEADER = 1 << 20
"""What a tar may have before a file [bytes]: its name, some dates"""
LONG_HEADERS = (
    tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE,
    tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK,
)  # fmt: skip
CHUNK = 1 << 16

TARS: dict[str, Callable[[Path], Any]] = {
    ".tar": lambda file: file.open("rb"),
    ".tar.gz": gzip.open, ".tgz": gzip.open,
    ".tar.bz2": bz2.open, ".tbz2": bz2.open,
    ".tar.xz": lzma.open, ".txz": lzma.open,
}  # fmt: skip
ENDINGS = (".zip", *TARS)
"""Of the archives that are known"""


def ending(file: Path) -> str:
    """Which of ENDINGS a name has, or nothing.

    >>> ending(Path("Dupont.TAR.GZ")), ending(Path("mine.png"))
    ('.tar.gz', '')
    """
    name = file.name.lower()
    return next((e for e in sorted(ENDINGS, key=len, reverse=True) if name.endswith(e)), "")


def unpack(file: Path, folder: Path, limits: Limits) -> None:
    """Unpack an archive, one of ENDINGS, into a folder that is not there yet.

    limits: of all its files together, disk; of each, file_size. Archives in it stay archives.
    Raises SubmissionFault, which names the archive and what is wrong with it; OSError.
    """
    with _new(folder) as part:
        sink = _Sink(part, limits, file.name)
        try:
            if ending(file) == ".zip":
                _unzip(file, sink)
            else:
                _untar(file, sink)
        except (
            zipfile.BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError, EOFError,
            RuntimeError, OverflowError, ValueError, gzip.BadGzipFile,
        ) as error:  # fmt: skip
            if isinstance(error, SubmissionFault):
                raise
            raise sink.fault(say("damaged, or no such archive: {error}", error=error)) from error
        except OSError as error:  # bz2 says so of damaged data
            if error.errno is not None:
                raise
            raise sink.fault(say("damaged, or no such archive: {error}", error=error)) from error
        if not sink.files:
            raise sink.fault(_("there is no file in it"))


def copy_folder(source: Path, folder: Path, limits: Limits) -> None:
    """Copy what was handed in as a folder into one that may be there, and is empty.

    Raises SubmissionFault for links and what else is no plain file, and where it is too much;
    OSError.
    """
    sink = _Sink(folder, limits, source.name)
    _copy(source, "", sink)


def only_folder(folder: Path) -> Path:
    """The folder in a folder that holds nothing else, as archives often do; else itself."""
    while True:
        inner = [f for f in folder.iterdir() if f.name not in ("__MACOSX", ".DS_Store")]
        if len(inner) != 1 or inner[0].is_symlink() or not inner[0].is_dir():
            return folder
        folder = inner[0]


@contextmanager
def _new(folder: Path) -> Iterator[Path]:
    """A folder that gets its name when all is well, or is gone."""
    part = folder.with_name(folder.name + ".part")
    remove(part)
    part.mkdir(parents=True)
    try:
        yield part
        part.rename(folder)
    finally:
        remove(part)


class _Sink:
    """Writes files into a folder, and counts."""

    def __init__(self, folder: Path, limits: Limits, name: str) -> None:
        self.folder, self.limits, self.name = folder, limits, name
        self.bytes = self.files = self.entries = 0

    def fault(self, why: str) -> SubmissionFault:
        return SubmissionFault("archive", say("{name}: {why}", name=self.name, why=why))

    def place(self, name: str) -> Path:
        """Where a file goes that an archive calls so. Raises SubmissionFault."""
        self.entries += 1
        if self.entries > FILES:
            raise self.fault(
                say("more than {files:,} files and folders: hand in only your own", files=FILES)
            )
        try:
            name.encode()
        except UnicodeEncodeError:  # tarfile keeps bytes that are no UTF-8: take them as Latin 1
            name = name.encode(errors="surrogateescape").decode("latin-1")
        if not name.replace("/", "").isprintable():
            raise self.fault(say("{name!r}: a name with control characters: rename it", name=name))
        parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
        if name.startswith(("/", "\\")) or ".." in parts or name[1:3] in (":\\", ":/"):
            raise self.fault(
                say("{name!r}: leads out of the folder: pack it from within its folder", name=name)
            )
        if len(parts) > DEEPEST:
            raise self.fault(
                say("{name!r}: more than {deepest} folders in folders", name=name, deepest=DEEPEST)
            )
        if any(len(part.encode()) > LONGEST_NAME for part in parts):
            raise self.fault(say("{name!r}: too long a name", name=name))
        return self.folder.joinpath(*parts)

    def make_folder(self, name: str) -> None:
        place = self.place(name)
        with self._conflicts(name):
            place.mkdir(mode=0o755, parents=True, exist_ok=True)

    def write(self, name: str, source: IO[bytes], executable: bool, modified: float) -> None:
        """A file, to its end. Scripts and programs are made executable: zips forget it."""
        place = self.place(name)
        self.files += 1
        with self._conflicts(name):
            place.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            sink = place.open("xb")
        with sink:
            size = 0
            while chunk := source.read(CHUNK):
                executable |= size == 0 and chunk.startswith((b"#!", b"\x7fELF"))
                size += len(chunk)
                self.bytes += len(chunk)
                if size > self.limits.file_size:
                    raise self.fault(
                        say(
                            "{name!r}: more than {file_size:,.0f} MB",
                            name=name,
                            file_size=self.limits.file_size / (1 << 20),
                        )
                    )
                if self.bytes > self.limits.disk:
                    raise self.fault(
                        say(
                            "more than {disk:,.0f} MB in all: hand in only what your program needs",
                            disk=self.limits.disk / (1 << 20),
                        )
                    )
                sink.write(chunk)
        place.chmod(0o755 if executable else 0o644)
        with_clock = min(max(modified, 0.0), time.time())  # make believes in no future
        os.utime(place, (with_clock, with_clock))

    @contextmanager
    def _conflicts(self, name: str) -> Iterator[None]:
        try:
            yield
        except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
            raise self.fault(
                say("{name!r}: two files of that name, or a file and a folder", name=name)
            ) from error
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            raise self.fault(say("{name!r}: too long a name", name=name)) from error


# ---------------------------------------------------------------- zip


def _unzip(file: Path, sink: _Sink) -> None:
    _look_at_directory(file, sink)
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            mode = member.external_attr >> 16
            kind = stat.S_IFMT(mode)
            if member.flag_bits & 1:
                raise sink.fault(
                    say(
                        "{filename!r}: encrypted: pack it without a password",
                        filename=member.filename,
                    )
                )
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise sink.fault(
                    say(
                        "{filename!r}: {kind}: pack plain files only",
                        filename=member.filename,
                        kind=_kind(kind),
                    )
                )
            if member.is_dir():
                sink.make_folder(member.orig_filename)
                continue
            with archive.open(member) as source:
                modified = _time(member)
                sink.write(member.orig_filename, source, bool(mode & 0o111), modified)


def _look_at_directory(file: Path, sink: _Sink) -> None:
    """zipfile reads a zip's whole table of contents: so it must be a small one, whichever of the
    places that look like its end is taken for it (APPNOTE.TXT 4.3.16)."""
    with file.open("rb") as stream:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(max(0, size - (1 << 16) - 22 - 20))
        tail = stream.read()
    found = tail.find(b"PK\5\6")
    while found >= 0:
        if int.from_bytes(tail[found + 12 : found + 16], "little") > DIRECTORY:
            raise sink.fault(
                say("more than {files:,} files and folders: hand in only your own", files=FILES)
            )
        found = tail.find(b"PK\5\6", found + 1)
    if b"PK\6\7" in tail:
        raise sink.fault(_("a zip of the 64-bit kind, for more than 4 GB: pack it as a .tar.gz"))


def _time(member: zipfile.ZipInfo) -> float:
    try:
        return time.mktime((*member.date_time, 0, 0, -1))
    except (ValueError, OverflowError):
        return 0.0


# ---------------------------------------------------------------- tar


def _untar(file: Path, sink: _Sink) -> None:
    class Member(tarfile.TarInfo):
        """tarfile reads long names and maps of sparse files as wholes, before anyone is asked."""

        def _proc_member(self, *rest: Any) -> Any:  # with the block that says its type read
            if self.type == tarfile.GNUTYPE_SPARSE:
                raise sink.fault(
                    say("{name!r}: a file with holes: pack it without --sparse", name=self.name)
                )
            if self.type in LONG_HEADERS and self.size > HEADER:
                raise sink.fault(
                    say("{name!r}: a header of {size:,} bytes", name=self.name, size=self.size)
                )
            return super()._proc_member(*rest)  # type: ignore[misc]

        def _proc_gnusparse_10(self, *_: object) -> None:
            raise sink.fault(
                say("{name!r}: a file with holes: pack it without --sparse", name=self.name)
            )

    with TARS[ending(file)](file) as stream:
        bounded: Any = _Bounded(stream, sink)
        options: Any = {"tarinfo": Member, "encoding": "utf-8"}
        with tarfile.open(fileobj=bounded, mode="r|", **options) as archive:
            for member in archive:
                if member.isdir():
                    sink.make_folder(member.name)
                    continue
                if not member.isreg():
                    link = member.issym() or member.islnk()
                    said = _kind(stat.S_IFLNK if link else stat.S_IFCHR)
                    raise sink.fault(
                        say("{name!r}: {said}: pack plain files only", name=member.name, said=said)
                    )
                source = archive.extractfile(member)
                assert source
                with source:
                    sink.write(member.name, source, bool(member.mode & 0o111), member.mtime)


class _Bounded:
    """A tar as it is unpacked: no longer than its limits, and no long header."""

    def __init__(self, stream: IO[bytes], sink: _Sink) -> None:
        self.stream, self.sink = stream, sink
        self.left = sink.limits.disk + 4 * tarfile.BLOCKSIZE * FILES + HEADER

    def read(self, size: int) -> bytes:
        data = self.stream.read(size)
        self.left -= len(data)
        if self.left < 0:
            mega = self.sink.limits.disk / (1 << 20)
            raise self.sink.fault(
                say(
                    "more than {mega:,.0f} MB in all: hand in only what your program needs",
                    mega=mega,
                )
            )
        return data


def _kind(mode: int) -> str:
    if mode == stat.S_IFLNK:
        return _("a link")
    return _("a device, a pipe or the like")


# ---------------------------------------------------------------- a folder


def _copy(source: Path, inside: str, sink: _Sink) -> None:
    with os.scandir(source / inside) as entries:
        for entry in sorted(entries, key=lambda e: e.name):
            name = f"{inside}/{entry.name}" if inside else entry.name
            if entry.is_symlink():
                raise sink.fault(say("{name!r}: a link: hand in plain files only", name=name))
            elif entry.is_dir():
                sink.make_folder(name)
                _copy(source, name, sink)
            else:
                _copy_file(entry.path, name, sink)


def _copy_file(path: str, name: str, sink: _Sink) -> None:
    """Plain, and still no link."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(path, flags)
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.ENXIO, errno.EACCES):
            raise
        raise sink.fault(say("{name!r}: no plain file that can be read", name=name)) from error
    with os.fdopen(descriptor, "rb") as source:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise sink.fault(say("{name!r}: no plain file that can be read", name=name))
        sink.write(name, source, bool(found.st_mode & 0o111), found.st_mtime)
