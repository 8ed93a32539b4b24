"""A program in a cage, with something beside it that it must not touch.

Only the standard library and the cage, so that it can be run as another user: see test_cage.py.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from penumbra.grading.cage import Bubblewrap, Cage, Landlock, Limits, Uncaged, desk

CAGES: dict[str, type[Cage]] = {c.name: c for c in (Bubblewrap, Landlock, Uncaged)}
SECRET = "what no submission may see"


def attack(
    cage: str, program: str, limits: dict[str, Any], marker: str, building: bool = False
) -> dict[str, Any]:
    """Run `python3 attack.py OUT OUTSIDE PID PORT ABSTRACT MARKER` and say what came of it.

    OUT: in its /tmp; OUTSIDE: a folder that anyone may read and write; PID: of a process of the
    same user; PORT, ABSTRACT: sockets that listen.
    """
    with outside() as folder, desk() as own, listeners(folder) as listening:
        (own.home / "attack.py").write_text(program)
        (own.home / "own.txt").write_text("the submission's own\n")
        (own.scenes / "tp3.json").write_text("{}\n")
        kept = [folder, own.scenes] if building else [folder, own.scenes, own.home]
        before = [snapshot(f) for f in kept]
        bystander = subprocess.Popen(["sleep", "100"])
        there = CAGES[cage]().inside(own)
        port, abstract = listening[0].getsockname()[1], listening[1].getsockname()[1:].decode()
        try:
            ended = CAGES[cage]().run(
                ["python3", "attack.py", str(there.tmp / "image.pfm"), str(folder),
                 str(bystander.pid), str(port), abstract, marker],
                own, Limits(**limits), building=building,
            )  # fmt: skip
            left = marked(marker)
            stands = bystander.poll() is None
        finally:
            bystander.kill()
            bystander.wait()
        try:
            own.take("image.pfm", folder.parent / "taken", Limits(**limits).file_size)
            taken = (folder.parent / "taken").read_text()
        except OSError as error:
            taken = f"error: {error.strerror}"
        return {
            "ended": asdict(ended),
            "taken": taken,
            "unharmed": before == [snapshot(f) for f in kept],
            "heard": heard(listening),
            "bystander": stands,
            "left": left,
            "base": str(own.home.parent),
        }


@contextmanager
def outside() -> Iterator[Path]:
    """Files of whoever grades, which only a cage protects."""
    base = Path(tempfile.mkdtemp(prefix="penumbra-outside-"))
    try:
        base.chmod(0o755)
        folder = base / "class"
        (folder / "dupont").mkdir(parents=True)
        for name in ("reference.exr", "grades.json", "dupont/mine.c"):
            (folder / name).write_text(SECRET)
            (folder / name).chmod(0o666)
        (folder / "dupont").chmod(0o777)
        folder.chmod(0o777)
        yield folder
    finally:
        shutil.rmtree(base)


def snapshot(folder: Path) -> list[tuple[object, ...]]:
    """All that can be changed of the files in a folder."""
    found = []
    for path in sorted(folder.rglob("*")):
        about = path.lstat()
        content = path.read_bytes() if path.is_file() else b""
        found.append((str(path), about.st_mode, about.st_uid, about.st_mtime_ns, content))
    return found


@contextmanager
def listeners(folder: Path) -> Iterator[list[socket.socket]]:
    """A TCP port, an abstract socket and one with a name, `socket` beside the folder."""
    tcp, abstract, named = (
        socket.socket(socket.AF_INET),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM),
    )  # fmt: skip
    with tcp, abstract, named:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        abstract.bind(f"\0penumbra-{os.getpid()}")
        named.bind(str(folder.parent / "socket"))
        os.chmod(folder.parent / "socket", 0o777)
        yield [tcp, abstract, named]


def heard(listening: list[socket.socket]) -> list[str]:
    """Who connected, and what was sent."""
    found = []
    for one in listening:
        one.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            tcp = one.family == socket.AF_INET
            found.append(str(one.accept()) if tcp else one.recv(100).decode())
    return found


def marked(marker: str) -> list[str]:
    """Processes, anyone's, that were started with a word."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if marker.encode() in words:
                found.append(f"{folder.name}: {words!r}")
    return found


if __name__ == "__main__":
    print(json.dumps(attack(**json.load(sys.stdin))))
