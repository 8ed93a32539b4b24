"""The process around a caged program: it starts it, watches what it uses, and leaves nothing alive.

A program of its own (standard library only, so that it starts at once): whoever grades has threads,
other children and no wish to adopt a student's orphans. It reads what to do as JSON from a line of
standard input, writes what came of it as JSON to standard output, and ends everything if standard
input is closed: whoever asked is dead, and so the submission's folders are removed, too.

Memory, processes and disk are watched every TICK seconds, because a limit of the kernel's holds for
one process and not for all, and does not say afterwards that it was reached. The kernel's own stand
behind them, a little wider.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import resource
import select
import signal
import socket
import stat
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from penumbra.grading import kernel

TICK = 0.02
"""[s] in which a program may overrun: touching memory as fast as one can, some 100 MB"""
DISK_TICK = 0.05
"""[s] at least between looks at the disk; a twentieth of the time goes into them"""
HIDDEN = 4
"""Looks in a row: for an instant while it starts, every program's files are hidden"""
DEEPEST, MANY = 100, 1 << 20
"""Folders in folders, more of which count as so many files"""
KEPT = 8000
"""Bytes of the end of what it printed"""
SPARE_PROCESSES = 16
"""The kernel refuses so many later, so that it is seen that a limit was reached"""
OTHERS_PROCESSES = 1024
"""What else of the same user may start meanwhile, where the kernel counts a user's"""
DESCRIPTORS = 256
"""Open files of each process; a pipe or a pair of sockets holds memory that no limit sees"""
FIRST_USER = 0x7000_0000
"""Users from here on are nobody's (systemd's docs/UIDS-GIDS.md): one for each run, if root asks"""
NOBODY = 65534
FILTER = 9
"""The descriptor that bubblewrap reads its filter from"""
CANNOT_START = 127


class Watch:
    """What all the descendants of this process use."""

    def __init__(self, task: dict[str, Any]) -> None:
        self.limits, self.folders, self.apart = task["limits"], task["write"], task["apart"]
        self.open = task["cage"] == "landlock"
        """only an ill-meaning process goes on hiding its files; bubblewrap's own do, too"""
        self.hidden = 0
        """looks in a row at which one did"""
        self.full_file = False
        """one is as large as a file may be"""
        self.size, self.files = self._sizes()
        self._next_disk = 0.0

    def reached(self) -> str:
        """The limit that was reached, or nothing."""
        tasks = memory = 0
        found = {process: _status(process) for process in _descendants()}
        for status in found.values():
            tasks += int(status.get("Threads", 0))
            memory += 1024 * (int(status.get("VmRSS", 0)) + int(status.get("VmPTE", 0)))
        if tasks - self.apart > self.limits["processes"]:
            return "process_limit"
        # What processes share was counted for each of them: only then is it worth the time. Twice,
        # since while some of them end their shares go to those that are still to be asked.
        most = self.limits["memory"]
        if memory > most and all(_shared_once(found) > most for _ in range(2)):
            return "memory_limit"
        now = time.monotonic()
        if now >= self._next_disk:
            over = self.written(found)
            spent = time.monotonic() - now
            self._next_disk = now + max(DISK_TICK, 20 * spent)
            if over:
                return "disk_limit"
        return ""

    def written(self, processes: Iterable[int]) -> bool:
        """Whether it wrote too much, files that have lost their name included."""
        size, files = self._sizes()
        unnamed: dict[tuple[int, int], int] = {}
        hidden = False
        for process in processes:
            try:
                unnamed.update(_unnamed(process))
            except PermissionError:
                hidden = True
        self.hidden = self.hidden + 1 if hidden else 0
        if self.open and self.hidden > HIDDEN:
            return True
        size += sum(unnamed.values())
        return size - self.size > self.limits["disk"] or files - self.files > self.limits["files"]

    def _sizes(self) -> tuple[int, int]:
        """Of all files and folders, bytes on disk, and how many there are."""
        size = files = 0
        todo = [(folder, 0) for folder in self.folders]
        while todo and files < MANY:
            folder, depth = todo.pop()
            for name, found in _files(folder):
                size += 512 * found.st_blocks
                files += 1 if depth < DEEPEST else MANY
                if stat.S_ISDIR(found.st_mode):
                    todo.append((name, depth + 1))
                elif stat.S_ISREG(found.st_mode) and found.st_size >= self.limits["file_size"]:
                    self.full_file = True
        return size, files


def _descendants() -> list[int]:
    """Of this process, by the kernel's lists of children; where it keeps none, by all parents."""
    listed = os.path.exists(f"/proc/self/task/{os.getpid()}/children")
    children = _listed_children if listed else _by_parent().__getitem__
    found, todo = [], [os.getpid()]
    while todo:
        todo += (below := children(todo.pop()))
        found += below
    return found


def _listed_children(process: int) -> list[int]:
    found = []
    with contextlib.suppress(OSError):
        for task in os.listdir(f"/proc/{process}/task"):
            with open(f"/proc/{process}/task/{task}/children") as stream:
                found += [int(word) for word in stream.read().split()]
    return found


def _by_parent() -> defaultdict[int, list[int]]:
    found: defaultdict[int, list[int]] = defaultdict(list)
    for name in os.listdir("/proc"):
        if name.isdigit():
            found[int(_status(int(name)).get("PPid", 0))].append(int(name))
    return found


def _status(process: int) -> dict[str, str]:
    """The words after each name in /proc/PID/status; sizes are in kB."""
    try:
        with open(f"/proc/{process}/status", errors="replace") as stream:
            lines = (line.partition(":") for line in stream)
            return {name: (text.split() or [""])[0] for name, _, text in lines}
    except OSError:
        return {}


def _shared_once(found: dict[int, dict[str, str]]) -> int:
    """Memory [bytes]: what several have counts once, where the kernel tells."""
    total = 0
    for process, status in found.items():
        try:
            with open(f"/proc/{process}/smaps_rollup") as stream:
                kilobytes = next(int(line.split()[1]) for line in stream if line[:4] == "Pss:")
        except (OSError, StopIteration):  # it may have ended since
            kilobytes = int(_status(process).get("VmRSS", 0))
        total += 1024 * (kilobytes + int(status.get("VmPTE", 0)))
    return total


def _files(folder: str) -> Iterator[tuple[str, os.stat_result]]:
    """All that is in a folder, links not followed."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):
                yield entry.path, entry.stat(follow_symlinks=False)


def _unnamed(process: int) -> dict[tuple[int, int], int]:
    """Sizes on disk [bytes] of files that a process has open or mapped, and that have no name.

    Raises PermissionError.
    """
    sizes = {}
    folder = f"/proc/{process}/fd"
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
        for name in os.listdir(folder):
            with contextlib.suppress(FileNotFoundError):
                found = os.stat(f"{folder}/{name}")
                if stat.S_ISREG(found.st_mode) and found.st_nlink == 0:
                    sizes[found.st_dev, found.st_ino] = 512 * found.st_blocks
        with open(f"/proc/{process}/maps", errors="replace") as stream:
            for line in stream:
                if line.endswith("(deleted)\n") and line.split(None, 2)[1].endswith("s"):
                    place, _, _, device, inode, _ = line.split(None, 5)
                    low, high = (int(end, 16) for end in place.split("-"))
                    major, minor = (int(part, 16) for part in device.split(":"))
                    sizes.setdefault((os.makedev(major, minor), int(inode)), high - low)
    return sizes


# ---------------------------------------------------------------- the program


def _user() -> int | None:
    """Whom to become: nobody else, if this is root; None: nobody has to. Raises OSError."""
    if os.geteuid() != 0:
        return None
    with open("/proc/self/uid_map") as stream:
        ranges = [[int(word) for word in line.split()] for line in stream]
    for user in (FIRST_USER + os.getpid(), NOBODY):
        if any(first <= user < first + count for first, _, count in ranges):
            return user
    raise OSError(errno.EPERM, "root here has no other user to run a program as")


def _give(folder: str, user: int) -> None:
    """Everything in a folder, to a user; links are not followed."""
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            os.chown(os.path.join(place, name), user, user, follow_symlinks=False)
    os.chown(folder, user, user, follow_symlinks=False)


def _limit(kind: int, value: int) -> None:
    hard = resource.getrlimit(kind)[1]
    value = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(kind, (value, value))


def _of_this_user() -> int:
    """How many processes and threads the user has."""
    mine = str(os.getuid())
    found = (_status(int(name)) for name in os.listdir("/proc") if name.isdigit())
    return sum(int(status["Threads"]) for status in found if status.get("Uid") == mine)


def _become(task: dict[str, Any], user: int | None, output: int, line: socket.socket) -> None:
    """In the child: the caged program, from here on. Raises OSError; never returns."""
    os.setsid()
    kernel.prctl(kernel.PR_SET_PDEATHSIG, signal.SIGKILL)
    for kind in (signal.SIGPIPE, signal.SIGXFSZ):  # which Python had ignored
        signal.signal(kind, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_RDONLY)
    for here, there in ((null, 0), (output, 1), (output, 2)):
        os.dup2(here, there)
    with open("/proc/self/oom_score_adj", "w") as stream:
        stream.write("1000")  # the first to go if the machine has no memory left
    limits, sandboxed = task["limits"], task["cage"] == "bubblewrap"
    processes = limits["processes"] + SPARE_PROCESSES
    if user is None and not sandboxed:
        processes += _of_this_user() + OTHERS_PROCESSES
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_FSIZE, limits["file_size"])
    _limit(resource.RLIMIT_NOFILE, DESCRIPTORS)
    _limit(resource.RLIMIT_MSGQUEUE, 0)
    if not sandboxed:  # which counts its own: see Bubblewrap
        _limit(resource.RLIMIT_NPROC, processes)
    if user is not None:
        os.setgroups([])
        os.setresgid(user, user, user)
        os.setresuid(user, user, user)
    os.chdir(task["start"])
    os.umask(0o022)
    if sandboxed:
        source, sink = os.pipe()
        os.write(sink, kernel.filter_program(namespaces=True))
        os.close(sink)
        os.dup2(source, FILTER)
        os.set_inheritable(FILTER, True)
    elif task["cage"] == "landlock":
        kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
        kernel.landlock(task["read"], [*task["write"], *task["devices"]])
        alone = user is None
        program = kernel.filter_program(False, kernel.landlock_version(), notify=alone)
        listener = kernel.seccomp(program, listen=alone)
        if alone:
            socket.send_fds(line, [b"l"], [listener])
            os.close(listener)
    os.execvpe(task["words"][0], task["words"], task["environment"])


def _start(task: dict[str, Any], user: int | None, output: int, line: socket.socket) -> int:
    """The process of the program."""
    child = os.fork()
    if child:
        return child
    try:
        _become(task, user, output, line)
    except BaseException as error:
        text = getattr(error, "strerror", None) or str(error)
        os.write(2, f"{task['words'][0]}: {text}\n".encode())
    finally:
        os._exit(CANNOT_START)


def _end_all(child: int) -> int | None:
    """Kill whatever is alive below this process; the status of the child, if it still had one.

    Until nothing is left: the kernel hands orphans to this process. The child's group goes first,
    at one blow; the rest only where something could leave it.
    """
    status = None
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    while True:
        for process in _descendants():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        try:
            while True:
                process, ended = os.waitpid(-1, os.WNOHANG)
                if process == 0:
                    break
                if process == child:
                    status = ended
        except ChildProcessError:
            return status
        time.sleep(0.001)


def watch(task: dict[str, Any]) -> dict[str, Any]:
    """Run a program as the task says until it ends or reaches a limit. Raises OSError."""
    user = _user() if task["cage"] != "none" else None
    if user is not None:
        os.chown(task["base"], user, -1)
        for folder in task["write"]:
            _give(folder, user)
    kernel.prctl(kernel.PR_SET_CHILD_SUBREAPER, 1)
    observer = Watch(task)
    source, sink = os.pipe2(os.O_CLOEXEC)
    ours, theirs = socket.socketpair()
    start = time.perf_counter()
    child = _start(task, user, sink, theirs)
    os.close(sink)
    theirs.close()
    tail, printed, listener = bytearray(), 0, None
    limit, status = "", None
    ended = os.pidfd_open(child)
    waiting = select.poll()
    for descriptor in (sys.stdin.fileno(), source, ours.fileno(), ended):
        waiting.register(descriptor, select.POLLIN)
    try:
        tick = start
        while not limit:
            ready = {descriptor for descriptor, _ in waiting.poll(1000 * TICK)}
            if sys.stdin.fileno() in ready:  # closed
                limit = "abandoned"
            if ours.fileno() in ready:
                waiting.unregister(ours.fileno())
                _, received, _, _ = socket.recv_fds(ours, 1, 1)
                if received:
                    listener = kernel.Listener(received[0], task["write"])
                    waiting.register(listener.descriptor, select.POLLIN)
            if listener and listener.descriptor in ready:
                listener.answer()
            if source in ready:
                chunk = os.read(source, 1 << 16)
                if not chunk:
                    waiting.unregister(source)
                printed += len(chunk)
                tail = (tail + chunk)[-KEPT:]
                if printed > task["limits"]["output"]:
                    limit = "output_limit"
            if ended in ready:
                break
            now = time.perf_counter()
            if now - start > task["limits"]["seconds"]:
                limit = "time_limit"
            elif now - tick >= TICK:
                tick = now
                limit = limit or observer.reached()
    finally:
        seconds = time.perf_counter() - start
        status = _end_all(child)
    if limit == "abandoned":
        from penumbra.grading.cage import remove  # which imports this file

        remove(Path(task["base"]))
        return {}
    os.set_blocking(source, False)
    with contextlib.suppress(BlockingIOError):
        while not limit and (chunk := os.read(source, 1 << 16)):
            printed += len(chunk)
            tail = (tail + chunk)[-KEPT:]
    if not limit and printed > task["limits"]["output"]:
        limit = "output_limit"
    if not limit and observer.written([]):
        limit = "disk_limit"
    code = None if status is None else os.waitstatus_to_exitcode(status)
    return {
        "code": None if limit else code,
        "limit": limit,
        "full_file": observer.full_file,
        "printed": tail.decode(errors="replace"),
        "seconds": seconds,
    }


def main() -> None:
    task = json.loads(sys.stdin.readline())
    try:
        found = watch(task)
    except OSError as error:
        found = {"problem": str(error)}
    sys.stdout.write(json.dumps(found))
