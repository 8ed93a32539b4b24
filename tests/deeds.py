"""What tests give to workers to do: little to import, since each worker imports it."""

from __future__ import annotations

import hashlib
import os
import signal
import time
from pathlib import Path


def digest(text: str) -> str:
    """Enough work that a worker killed meanwhile is likely to have some."""
    data = text.encode()
    for _ in range(20000):
        data = hashlib.sha256(data).digest()
    return data.hex()


def counted(argument: tuple[str, Path]) -> str:
    """digest, leaving a file for each time that it was worked out."""
    text, folder = argument
    (folder / f"{text} {os.getpid()} {time.time_ns()}").touch()
    return digest(text)


def deadly(text: str) -> str:
    if text == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return digest(text)


def wrong(text: str) -> str:
    raise FileNotFoundError(2, "not there", text)


def endless(folder: Path) -> None:
    """Starts a process that would outlive this one, and never ends."""
    import subprocess

    child = subprocess.Popen(["sleep", "1000"], start_new_session=True)
    (folder / f"{os.getpid()} {child.pid}").touch()
    child.wait()
