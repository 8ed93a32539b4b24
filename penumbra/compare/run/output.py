"""Where results are written: whole files or none, under names that say what they hold."""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from penumbra.language import say

PICTURES = (".png", ".jpg", ".jpeg")
"""What `penumbra png` writes"""
ENDINGS = frozenset((
    *PICTURES, ".bmp", ".gif", ".hdr", ".pfm", ".ppm", ".tif", ".tiff", ".webp", ".exr",
    ".blend", ".csv", ".html", ".json", ".npy", ".npz", ".pdf", ".svg", ".txt",
))  # fmt: skip
"""They say what a file holds"""


def named(*endings: str) -> Callable[[str], Path]:
    """For argparse, a file of one format: its name ends so, or in nothing that says otherwise.

    >>> named(".exr")("a.exr"), named(".exr")("/dev/null")
    (PosixPath('a.exr'), PosixPath('/dev/null'))
    >>> named(".csv")("a.JSON")
    Traceback (most recent call last):
    argparse.ArgumentTypeError: "a.JSON" does not end in .csv
    """

    def parse(text: str) -> Path:
        file = Path(text)
        ending = file.suffix.lower()
        if ending in ENDINGS and ending not in endings:
            message = say('"{text}" does not end in {endings}', text=text, endings=endings[0])
            if endings == (".exr",) and ending in PICTURES:
                message += say("; for a picture of it: penumbra png OUT.exr -o {text}", text=text)
            raise argparse.ArgumentTypeError(message)
        return file

    return parse


def plain(parse: Callable[[str], Path]) -> Callable[[str], Path]:
    """For argparse, a file that others are written beside: no device or pipe.

    >>> plain(Path)("/dev/null")
    Traceback (most recent call last):
    argparse.ArgumentTypeError: "/dev/null" is a device or a pipe, and files are written beside it
    """

    def parse_plain(text: str) -> Path:
        file = parse(text)
        if file.exists() and not file.is_file() and not file.is_dir():
            raise argparse.ArgumentTypeError(
                say('"{text}" is a device or a pipe, and files are written beside it', text=text)
            )
        return file

    return parse_plain


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill `<file>.part`, then rename it: the file is whole or absent.

    A link is followed, and stays: what it leads to is replaced. What is no plain file, or is what
    standard output or error is redirected to, is written to instead, once `write` has filled a
    temporary file. Raises OSError, which names the file, if it cannot be written.
    """
    target = file
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            found = file.stat()
        except FileNotFoundError:
            found = None
        stream = _standard_stream(found) if found else None
        if found and (stream is not None or not stat.S_ISREG(found.st_mode)):
            _write_through(file, stream, write)
            return
        if file.is_symlink():
            target = Path(os.path.realpath(file))
        part = target.with_name(target.name + ".part")
        try:
            write(part)
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(target)) from error


def write_json(file: Path, value: Any) -> None:
    """Write JSON that is whole or absent. Raises OSError; ValueError for NaN."""
    text = json.dumps(value, indent=1, allow_nan=False) + "\n"
    write_whole(file, lambda part: part.write_text(text))


def write_csv(file: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a CSV file that is whole or absent; what a row lacks is left empty.

    Raises OSError; ValueError for a row that has other columns.
    """

    def write(part: Path) -> None:
        with part.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)

    write_whole(file, write)


def _standard_stream(found: os.stat_result) -> int | None:
    """The descriptor of standard output or error, if that is this file. Terminals and other
    devices are opened by name."""
    for descriptor in (1, 2):
        try:
            opened = os.fstat(descriptor)
        except OSError:  # it is closed
            continue
        if os.path.samestat(opened, found) and not stat.S_ISCHR(opened.st_mode):
            return descriptor
    return None


def _write_through(file: Path, stream: int | None, write: Callable[[Path], object]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder, file.name)
        write(part)
        sys.stdout.flush()  # what was printed before comes before
        with (
            part.open("rb") as source,
            file.open("wb") if stream is None else os.fdopen(os.dup(stream), "wb") as device,
        ):
            shutil.copyfileobj(source, device)
