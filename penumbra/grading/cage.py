"""Where a submitted program runs, and what it may use up there.

Three cages, of which find_cage takes the first that works: bubblewrap (namespaces), Landlock with
seccomp, and none, only for those who trust what they run. docs/isolation.md says what each holds
off. All have one shape, a Desk: the submission's own folder, the scenes that it is asked for, and a
folder that is its /tmp, the only one that it may write to (and its own while it is built).

The picture leaves through that /tmp, an ordinary folder of this machine that is made for each run:
when everything that could change it is dead, the file is opened from outside, if it is a plain one
and no link, and copied. So no part of the cage has to be trusted with handing it out, and one look
at folders tells in every cage how much was written.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from penumbra.grading.kernel import filter_works
from penumbra.grading.warden import FILTER, NOBODY, SPARE_PROCESSES
from penumbra.language import N_, say

PACKAGE = Path(__file__).resolve().parents[1]
"""Never seen in a cage, wherever it is installed"""
SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32")
SETTINGS = (
    "/etc/alternatives", "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d",
    "/etc/localtime", "/etc/fonts", "/sys/devices/system/cpu",
)  # fmt: skip
"""What compilers and programs need to know of the machine; the rest of /etc is not theirs"""
PROCESSORS = ("/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/loadavg")
DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")
WARDEN = (
    "import sys; sys.path.append(sys.argv[1]); "
    "from penumbra.grading.warden import main; main()"
)  # fmt: skip
CANARY = "a canary that sings outside"


@dataclass(frozen=True)
class Limits:
    """What a build, or one run of a program, may use."""

    seconds: float = 60.0
    """wall time [s]"""
    memory: int = 2 << 30
    """of all its processes together [bytes]"""
    processes: int = 64
    """with their threads"""
    file_size: int = 64 << 20
    """each file [bytes]"""
    disk: int = 256 << 20
    """all that it writes [bytes]"""
    files: int = 5000
    """files and folders that it makes: a name costs memory, too"""
    output: int = 1 << 20
    """what it prints [bytes]"""


@dataclass(frozen=True)
class Ended:
    """How a caged program ended, with all that it had started."""

    code: int | None
    """exit code, minus the signal that ended it, or None if a limit did"""
    limit: str
    """the code (of a SubmissionFault) of the limit that ended it, or nothing"""
    full_file: bool
    """a file of its is as large as one may be"""
    printed: str
    """the end of it"""
    seconds: float
    """wall time [s]"""


class CageError(RuntimeError):
    """The cage itself failed: no fault of the submission; the text says how."""


class MissingCageError(RuntimeError):
    """Nothing here can hold a hostile program; the text says why, and what to do."""

    exit_code = 3


@dataclass(frozen=True)
class Desk:
    """The folders of one submission."""

    home: Path
    """where it starts; it can be read, and written to while it is built"""
    scenes: Path
    """which it is asked for"""
    tmp: Path
    """emptied before each run"""
    shm: Path
    """its /dev/shm, emptied too"""

    @classmethod
    def below(cls, base: Path) -> Desk:
        return cls(*(base / name for name in ("home", "scenes", "tmp", "shm")))

    @property
    def folders(self) -> tuple[Path, ...]:
        return self.home, self.scenes, self.tmp, self.shm

    def clear(self) -> None:
        """Make the folders that are not there, and empty those of a run."""
        for folder in (self.tmp, self.shm):
            remove(folder)
        for folder in self.folders:
            folder.mkdir(mode=0o755, exist_ok=True)

    def take(self, name: str, target: Path, largest: int) -> None:
        """Copy what a run left as a plain file in its /tmp, unless it is larger [bytes].

        Raises FileNotFoundError, OSError (EINVAL) for what is no plain file, OSError (EFBIG).
        """
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
        folder = os.open(self.tmp, flags | os.O_DIRECTORY)
        try:
            try:  # a pipe does not wait for a writer
                file = os.open(name, flags | os.O_NONBLOCK, dir_fd=folder)
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.ENXIO):  # a link, a socket
                    raise OSError(errno.EINVAL, "no plain file") from error
                raise
        finally:
            os.close(folder)
        try:
            found = os.fstat(file)
            if not stat.S_ISREG(found.st_mode):
                raise OSError(errno.EINVAL, "no plain file")
            if found.st_size > largest:
                raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
            with open(file, "rb", closefd=False) as source, target.open("wb") as sink:
                shutil.copyfileobj(source, sink)
        finally:
            os.close(file)


INSIDE = Desk(Path("/submission"), Path("/scenes"), Path("/tmp"), Path("/dev/shm"))
"""The folders as bubblewrap shows them, and as they are called where they are spoken of"""


@contextlib.contextmanager
def desk() -> Iterator[Desk]:
    """A new one, removed with all that a program made of it."""
    base = Path(tempfile.mkdtemp(prefix="penumbra-cage-"))
    try:
        made = Desk.below(base)
        made.clear()
        yield made
    finally:
        remove(base)


def remove(folder: Path) -> None:
    """A folder with all that is in it, however deep, unreadable or strangely named; links are
    removed, not followed. What is not there is none."""
    try:
        top = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    number = 0
    try:
        # Folders of folders move up, so that no path becomes long.
        while names := os.listdir(top):
            for name in names:
                if not _is_folder(name, top):
                    os.unlink(name, dir_fd=top)
                    continue
                os.chmod(name, 0o700, dir_fd=top)
                inner = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=top)
                try:
                    for below in os.listdir(inner):
                        if _is_folder(below, inner):
                            os.chmod(below, 0o700, dir_fd=inner)
                            number += 1
                            moved = f"{number}.{os.urandom(8).hex()}"
                            os.rename(below, moved, src_dir_fd=inner, dst_dir_fd=top)
                        else:
                            os.unlink(below, dir_fd=inner)
                finally:
                    os.close(inner)
                os.rmdir(name, dir_fd=top)
    finally:
        os.close(top)
    folder.rmdir()


def _is_folder(name: str, folder: int) -> bool:
    return stat.S_ISDIR(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode)


class Cage:
    """Runs a program, as one of the three below."""

    name: ClassVar[str]
    promise: ClassVar[str]
    """what it holds off, in a sentence"""
    apart: ClassVar[int] = 0
    """processes of the cage itself"""

    def inside(self, desk: Desk) -> Desk:
        """The same folders, as the program sees them."""
        return desk

    def run(
        self,
        words: Sequence[str],
        desk: Desk,
        limits: Limits,
        environment: Mapping[str, str] | None = None,
        building: bool = False,
    ) -> Ended:
        """Run a command in desk.home, without a shell, until it and whatever it started has ended.

        environment: beside what is always there; building: desk.home may be written to. Raises
        CageError.
        """
        there = self.inside(desk)
        task = {
            "cage": self.name,
            "words": self.command(list(words), desk, limits, building),
            "environment": {
                "PATH": "/usr/local/bin:/usr/bin:/bin",
                "HOME": str(there.tmp),
                "TMPDIR": str(there.tmp),
                "LANG": "C.UTF-8",
                "ASAN_OPTIONS": "detect_leaks=0",  # for that a program traces itself: forbidden
                **(environment or {}),
            },
            "base": str(desk.home.parent),
            "start": str(desk.home),
            "read": self.readable(desk),
            "write": [str(f) for f in (desk.tmp, desk.shm, *([desk.home] if building else []))],
            "devices": DEVICES,
            "limits": asdict(limits),
            "apart": self.apart,
        }
        found = _guarded(task)
        if "problem" in found:
            raise CageError(f"the {self.name} cage: {found['problem']}")
        printed = found["printed"]
        for ours, theirs in zip(desk.folders, INSIDE.folders, strict=True):
            printed = printed.replace(str(ours), str(theirs))
        return Ended(
            _signalled(found["code"]), found["limit"], found["full_file"], printed, found["seconds"]
        )

    def command(self, words: list[str], desk: Desk, limits: Limits, building: bool) -> list[str]:
        """What is started."""
        return words

    def readable(self, desk: Desk) -> list[str]:
        """What can be read, beside what can be written, if Landlock sees to it."""
        return []


class Bubblewrap(Cage):
    """Debian's bubblewrap: everything in namespaces of its own."""

    name = "bubblewrap"
    promise = N_(
        "no network, and nothing of this machine but its programs and libraries, read only"
    )
    apart = 2  # itself, and the first process inside

    def inside(self, desk: Desk) -> Desk:
        return INSIDE

    def command(self, words: list[str], desk: Desk, limits: Limits, building: bool) -> list[str]:
        command = [
            "bwrap", "--unshare-user", "--unshare-ipc", "--unshare-pid", "--unshare-net",
            "--unshare-uts", "--unshare-cgroup-try", "--die-with-parent", "--new-session",
            "--uid", str(NOBODY), "--gid", str(NOBODY), "--hostname", "cage",
        ]  # fmt: skip
        for path in SYSTEM:
            if os.path.islink(path):
                command += ["--symlink", os.readlink(path), path]
            else:
                command += ["--ro-bind-try", path, path]
        for path in SETTINGS:
            command += ["--ro-bind-try", path, path]
        if _hidden(SYSTEM):
            command += ["--tmpfs", str(PACKAGE), "--remount-ro", str(PACKAGE)]
        command += ["--proc", "/proc", "--dev", "/dev"]
        command += ["--bind", str(desk.shm), str(INSIDE.shm), "--remount-ro", "/dev"]
        command += ["--bind" if building else "--ro-bind", str(desk.home), str(INSIDE.home)]
        command += ["--ro-bind", str(desk.scenes), str(INSIDE.scenes)]
        command += ["--bind", str(desk.tmp), str(INSIDE.tmp), "--remount-ro", "/"]
        command += ["--chdir", str(INSIDE.home), "--seccomp", str(FILTER), "--"]
        # In here the kernel counts this user's processes apart from those outside.
        processes = limits.processes + SPARE_PROCESSES
        return [*command, "prlimit", f"--nproc={processes}", "--", *words]


class Landlock(Cage):
    """Landlock, seccomp and limits of the kernel's: no namespace is needed."""

    name = "landlock"
    promise = N_(
        "no network, no file but this machine's programs and libraries read, none of another's "
        "written, no process of another's touched"
    )

    def readable(self, desk: Desk) -> list[str]:
        paths = [*SYSTEM, *SETTINGS, *PROCESSORS, str(desk.home), str(desk.scenes)]
        return [seen for path in paths for seen in _without_package(path)]


class Uncaged(Cage):
    """Nothing, but that it ends."""

    name = "none"
    promise = N_(
        "nothing: a program can do all that you can, and only its time and size are limited"
    )


def _hidden(paths: Iterable[str]) -> bool:
    """Whether this package would be seen there."""
    return any(PACKAGE.is_relative_to(os.path.realpath(path)) for path in paths)


def _without_package(path: str) -> list[str]:
    """The path, or all that is in it but this package: Landlock only knows what is allowed."""
    if not _hidden([path]):
        return [path]
    if Path(os.path.realpath(path)) == PACKAGE:
        return []
    return [seen for inner in os.scandir(path) for seen in _without_package(inner.path)]


def _signalled(code: int | None) -> int | None:
    """A shell and bubblewrap say 128 + n for the signal n."""
    return code if code is None or not 128 < code < 128 + signal.NSIG else 128 - code


def _guarded(task: Mapping[str, Any]) -> dict[str, Any]:
    """What the warden says came of it. If this process dies or is interrupted, all of it ends."""
    words = [sys.executable, "-I", "-S", "-c", WARDEN, str(PACKAGE.parent)]
    with subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for us
    ) as warden:
        assert warden.stdin and warden.stdout and warden.stderr
        with contextlib.suppress(BrokenPipeError):
            warden.stdin.write(json.dumps(task).encode() + b"\n")
            warden.stdin.flush()
        said = warden.stdout.read()  # its standard input stays open until it has ended
        wrong = warden.stderr.read()
    try:
        found: dict[str, Any] = json.loads(said)
    except ValueError:
        lines = wrong.decode(errors="replace").strip().splitlines() or ["it was killed"]
        raise CageError(f"the warden gave no answer: {lines[-1]}") from None
    return found


# ---------------------------------------------------------------- which one works here


def find_cage(trust: bool = False) -> Cage:
    """The first cage that holds here, found by trying; trust: none at all if there is no other.

    Raises MissingCageError.
    """
    problems = []
    for cage in (Bubblewrap(), Landlock()):
        problem = try_cage(cage)
        if not problem:
            return cage
        problems.append(f"{cage.name}: {problem}")
    if trust:
        return Uncaged()
    raise MissingCageError(
        say(
            "nothing here can hold a program that may be hostile ({problems}). Install bubblewrap "
            "where user namespaces are allowed, or use a kernel from 5.13 on with Landlock; "
            "--trust runs programs without a cage, as you",
            problems="; ".join(problems),
        )
    )


def try_cage(cage: Cage) -> str:
    """Why a cage does not hold here, or nothing: a program in it must write where it may, and
    not read a file outside or write to its own folder."""
    if not sys.platform.startswith("linux"):
        return "needs Linux"
    if isinstance(cage, Landlock) and not filter_works():
        return f"knows no {platform.machine()}"
    with desk() as found, tempfile.NamedTemporaryFile(prefix="penumbra-canary-") as canary:
        canary.write(CANARY.encode())
        canary.flush()
        os.chmod(canary.name, 0o644)
        there = cage.inside(found)
        script = 'echo works > "$1/out"; { cat "$2"; echo > "$3/out"; } 2> "$1/said"; cat "$1/out"'
        words = ["sh", "-c", script, "sh", str(there.tmp), canary.name, str(there.home)]
        try:
            ended = cage.run(words, found, Limits(seconds=20.0, processes=8))
        except CageError as error:
            return str(error)
        if ended.printed.strip() != "works" or ended.code != 0:
            lines = ended.printed.strip().splitlines() or [f"ended with {ended.code}"]
            return lines[-1] if ended.code else "it holds nothing"
        if (found.home / "out").exists():
            return "it lets a program write to its own folder"
    return ""
