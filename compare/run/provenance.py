"""Where a result comes from: version, machine, command, and whole files or none."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import platform
import shlex
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
VERSION: str = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def machine() -> dict[str, str | int]:
    """Processor, number of cores that this process may use, and system."""
    return {"processor": _processor(), "cores": cores(), "system": platform.platform(terse=True)}


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def versions() -> dict[str, str]:
    """Versions of Penumbra, Python and the libraries that numbers pass through."""
    from importlib import metadata  # slow to load, and `--help` does without

    libraries = {name: metadata.version(name) for name in ("numpy", "scipy", "OpenEXR")}
    return {"penumbra": VERSION, "python": platform.python_version(), **libraries}


def command_line() -> str:
    """The command that is running, to be typed again."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def origin() -> dict[str, Any]:
    """Where a result comes from: command, machine and versions."""
    return {"command": command_line(), "machine": machine(), "versions": versions()}


def file_hash(*files: Path) -> str:
    """SHA-256 of the contents of files, in the order given. Raises OSError."""
    whole = hashlib.sha256()
    for file in files:
        whole.update(hashlib.sha256(file.read_bytes()).digest())
    return whole.hexdigest()


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill `<file>.part`, then rename it: the file is whole or absent.

    Raises OSError, which names the file, if it cannot be written.
    """
    part = file.with_name(file.name + ".part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(part)
            os.replace(part, file)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(file)) from error


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


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()
