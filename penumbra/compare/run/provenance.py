"""Where a result comes from: version, machine, command."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[2]
INSTALLED = (_PACKAGE / "share").is_dir()
"""From a wheel, not in a checkout"""
ROOT = _PACKAGE / "share" if INSTALLED else _PACKAGE.parent
"""The repository; of a wheel, what it brings along of it (CMakeLists.txt)"""
HOW_TO_BUILD = (
    "the package is without it: in Penumbra's repository run `make build`, then .venv/bin/penumbra"
    if INSTALLED
    else "run `make build`"
)
"""What to do where a C program or library is missing"""
VERSION: str = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def how_to_install(extra: str) -> str:
    """What to do where a library is missing that an extra of pyproject.toml names."""
    return f"run pip install 'penumbra[{extra}]'" if INSTALLED else "run ./setup.sh"


def typed(scene_file: str | Path) -> str:
    """A scene file as commands take it: one of our own on every machine alike.

    >>> typed(ROOT / "scenes" / "tp3.json")
    'scenes/tp3.json'
    """
    absolute = Path(scene_file).resolve()
    own = absolute.is_relative_to(ROOT / "scenes")
    return str(absolute.relative_to(ROOT) if own else scene_file)


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
    name = Path(sys.argv[0]).name
    return shlex.join(["penumbra" if name == "__main__.py" else name, *sys.argv[1:]])


def origin() -> dict[str, Any]:
    """Where a result comes from: command, machine and versions."""
    return {"command": command_line(), "machine": machine(), "versions": versions()}


def file_hash(*files: Path) -> str:
    """SHA-256 of the contents of files, in the order given. Raises OSError."""
    whole = hashlib.sha256()
    for file in files:
        whole.update(hashlib.sha256(file.read_bytes()).digest())
    return whole.hexdigest()


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()
