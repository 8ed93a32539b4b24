"""Hostile programs in each cage that this machine has: each ends within its limit, is called what
it is, and leaves the machine as it was."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from penumbra.grading import cage as cages
from penumbra.grading.cage import (
    Bubblewrap,
    Ended,
    Landlock,
    Limits,
    MissingCageError,
    Uncaged,
    desk,
    find_cage,
    remove,
    try_cage,
)
from penumbra.grading.fault import SubmissionFault
from penumbra.grading.kernel import filter_works, landlock_version
from penumbra.grading.program import raise_fault
from tests import caged
from tests.conftest import default_signals

NOBODY = 65534
SMALL: dict[str, Any] = {
    "seconds": 20.0, "memory": 256 << 20, "processes": 16, "file_size": 4 << 20, "disk": 16 << 20,
    "output": 1 << 16, "files": 300,
}  # fmt: skip
HOLDING = [cage.name for cage in (Bubblewrap(), Landlock()) if not try_cage(cage)]
WHERE = [*HOLDING, "landlock as nobody"] if os.geteuid() == 0 and "landlock" in HOLDING else HOLDING
"""What root runs becomes someone else's first, and so may hold where an ordinary user's would not:
with Landlock that is another way"""


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What a cage needs, where any user can read it."""
    folder = Path("/tmp") / f"penumbra-test-{uuid.uuid4().hex}"
    (folder / "penumbra" / "grading").mkdir(parents=True)
    own = Path(cages.__file__).parent
    for name in ("__init__", "cage", "kernel", "warden"):
        shutil.copy(own / f"{name}.py", folder / "penumbra" / "grading")
    for name in ("__init__", "language"):
        shutil.copy(own.parent / f"{name}.py", folder / "penumbra")
    shutil.copy(caged.__file__, folder)
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


Attack = Callable[..., dict[str, Any]]


@pytest.fixture(params=WHERE)
def attack(request: pytest.FixtureRequest, package: Path) -> Attack:
    """Runs a Python program in a cage; whatever it does, the machine must be unharmed."""
    name, _, who = request.param.partition(" ")

    def run(program: str, building: bool = False, **limits: Any) -> dict[str, Any]:
        marker = f"marker-{uuid.uuid4().hex}"
        task = {
            "cage": name, "program": PRELUDE + textwrap.dedent(program),
            "limits": {**SMALL, **limits}, "marker": marker, "building": building,
        }  # fmt: skip
        start = time.monotonic()
        if who:
            ran = subprocess.run(
                ["/usr/bin/python3", "-B", str(package / "caged.py")],
                input=json.dumps(task), capture_output=True, text=True,
                user=NOBODY, group=NOBODY, extra_groups=[], cwd="/",
            )  # fmt: skip
            assert ran.returncode == 0, ran.stderr
            found = json.loads(ran.stdout)
        else:
            found = caged.attack(**task)
        found["took"] = time.monotonic() - start
        found["ended"] = Ended(**found["ended"])
        print(found)
        assert found["unharmed"] and found["bystander"]
        assert found["left"] == caged.marked(marker) == []
        assert found["heard"] == []
        assert not Path(found["base"]).exists()
        return found

    return run


PRELUDE = """\
import ctypes, os, signal, socket, subprocess, sys, threading, time
out, outside, pid, port, abstract, marker = sys.argv[1:]
pid, port = int(pid), int(port)
libc = ctypes.CDLL(None, use_errno=True)

def attempt(what, *arguments, **named):
    try:
        print("DID", what, what(*arguments, **named))
    except OSError as error:
        print("refused", error.strerror)

"""


def fault(found: dict[str, Any]) -> str:
    """What the student and the instructor are told it was, or nothing."""
    try:
        raise_fault(found["ended"], "It", Limits(**SMALL))
    except SubmissionFault as said:
        return said.code
    return ""


def test_a_cage_works_here_and_the_safest_one_is_taken() -> None:
    assert HOLDING
    assert find_cage().name == HOLDING[0]


def test_what_works_here_is_what_the_kernel_allows() -> None:
    spaces = subprocess.run(
        ["unshare", "--user", "--pid", "--net", "--fork", "true"], capture_output=True
    )
    if spaces.returncode == 0 and shutil.which("bwrap"):
        assert "bubblewrap" in HOLDING
    assert ("landlock" in HOLDING) == (landlock_version() > 0)


def test_without_a_cage_a_program_is_refused_unless_it_is_trusted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(cages, "try_cage", lambda cage: "not here")
    with pytest.raises(MissingCageError, match="bubblewrap: not here; landlock: not here") as said:
        find_cage()
    assert said.value.exit_code == 3
    assert find_cage(trust=True).name == "none"


def test_a_cage_that_holds_nothing_is_not_taken_for_one() -> None:
    assert try_cage(Uncaged()) == "it holds nothing"


# ---------------------------------------------------------------- honest programs


def test_an_image_comes_out(attack: Attack) -> None:
    found = attack("open(out, 'w').write('image of ' + str(os.path.exists('own.txt')))")
    assert (found["ended"].code, found["taken"]) == (0, "image of True")
    assert fault(found) == ""


def test_a_program_is_compiled_and_run(attack: Attack) -> None:
    found = attack(
        """
        open("a.c", "w").write('#include <stdio.h>\\nint main(void) { puts("compiled"); }')
        open("Makefile", "w").write("a: a.c\\n\\tgcc -fopenmp $< -o $@\\n\\tstrip a\\n")
        subprocess.run(["make"], check=True)
        subprocess.run(["./a"], check=True)
        line = "touch -d 2001-01-01 b; cp -p a.c b; chmod 700 b; ar rcs l.a b"
        subprocess.run(line, shell=True, check=True)
        os.chmod("b", 0o640)
        print(oct(os.stat("b").st_mode))
        """,
        building=True,
    )
    assert found["ended"].code == 0, found["ended"].printed
    assert found["ended"].printed.split() == ["gcc", "-fopenmp", "a.c", "-o", "a", "strip", "a",
                                              "compiled", "0o100640"]  # fmt: skip


def test_exit_codes_and_signals_are_told(attack: Attack) -> None:
    assert attack("sys.exit(7)")["ended"].code == 7
    assert attack("os.abort()")["ended"].code in (-signal.SIGABRT, -signal.SIGSEGV)


def test_threads_and_children_work(attack: Attack) -> None:
    found = attack(
        """
        for thread in [threading.Thread(target=os.write, args=(1, b"t ")) for _ in range(4)]:
            thread.start()
            thread.join()
        left, right = socket.socketpair()
        left.send(b"pair")
        print(right.recv(9), subprocess.run(["sh", "-c", "echo child"]).returncode)
        """
    )
    assert found["ended"].printed.split() == ["t"] * 4 + ["child", "b'pair'", "0"]


# ---------------------------------------------------------------- what is not theirs


def test_nothing_outside_is_read(attack: Attack) -> None:
    found = attack(
        """
        def read(path):
            return open(path).read()
        for name in ("reference.exr", "grades.json", "dupont/mine.c"):
            attempt(read, f"{outside}/{name}")
        attempt(os.listdir, outside)
        attempt(os.listdir, os.path.dirname(outside))
        for path in ("/etc/passwd", "/etc/shadow", "/dev/mem", "/dev/kmsg", f"/proc/{pid}/mem",
                     f"/proc/{pid}/environ", f"/proc/{pid}/root{outside}/grades.json",
                     f"/proc/{pid}/cwd/tests/caged.py", f"/proc/self/root{outside}/grades.json"):
            attempt(read, path)
        os.symlink(f"{outside}/grades.json", os.path.dirname(out) + "/link")
        attempt(read, os.path.dirname(out) + "/link")
        attempt(os.link, f"{outside}/grades.json", os.path.dirname(out) + "/hard")
        """
    )
    assert found["ended"].code == 0
    assert "DID" not in found["ended"].printed and caged.SECRET not in found["ended"].printed
    assert found["ended"].printed.count("refused") == 16


def test_the_same_program_without_a_cage_reads_it_all() -> None:
    program = PRELUDE + 'print(open(outside + "/grades.json").read())'
    found = caged.attack("none", program, SMALL, "unmarked")
    assert caged.SECRET in found["ended"]["printed"]


def test_penumbra_itself_is_not_seen(attack: Attack) -> None:
    found = attack("import penumbra")
    assert "No module named 'penumbra'" in found["ended"].printed


def test_nothing_outside_is_written(attack: Attack) -> None:
    found = attack(
        """
        def write(path, mode):
            open(path, mode).write("mine")
        victim = f"{outside}/grades.json"
        for path in (victim, "own.txt", "attack.py", "../scenes/tp3.json", "/scenes/tp3.json",
                     "new", "/usr/bin/new", "/new", "/dev/new", "/proc/sys/kernel/hostname"):
            for mode in ("w", "a", "r+"):
                attempt(write, path, mode)
        for what in (os.unlink, os.rmdir):
            attempt(what, victim)
        attempt(os.truncate, victim, 0)
        attempt(os.rename, victim, f"{outside}/other")
        attempt(os.rename, victim, out)
        attempt(os.rename, "own.txt", out)
        attempt(os.replace, "attack.py", victim)
        attempt(os.mkdir, f"{outside}/new")
        attempt(os.symlink, victim, f"{outside}/new")
        attempt(os.mkfifo, f"{outside}/new")
        attempt(os.chmod, victim, 0)
        attempt(os.chmod, outside, 0)
        attempt(os.chown, victim, os.getuid(), os.getgid())
        attempt(os.setxattr, victim, "user.mine", b"1")
        """
    )
    assert found["ended"].code == 0
    assert "DID" not in found["ended"].printed
    assert found["ended"].printed.count("refused") == 44


def test_times_and_modes_outside_stay_through_links_too(attack: Attack) -> None:
    attack(
        """
        tmp = os.path.dirname(out)
        os.symlink(f"{outside}/grades.json", tmp + "/link")
        os.symlink(outside, tmp + "/folder")
        for path in (outside, f"{outside}/grades.json", tmp + "/link", tmp + "/folder/grades.json",
                     f"/proc/self/cwd/../../../../..{outside}/grades.json"):
            attempt(os.utime, path, (1, 1))
            attempt(os.chmod, path, 0o777)
        inside = os.open(tmp, os.O_RDONLY)
        attempt(os.chmod, "link", 0o777, dir_fd=inside)
        os.chdir(tmp + "/folder")
        attempt(os.chmod, "grades.json", 0o777)
        held = os.open(".", os.O_PATH)
        attempt(os.chmod, f"/proc/self/fd/{held}/grades.json", 0o777)
        attempt(os.chmod, "grades.json", 0o777, dir_fd=held)
        """
    )


def test_what_is_left_as_the_image_is_taken_only_if_it_is_a_plain_file(attack: Attack) -> None:
    for left in ("os.symlink(outside + '/grades.json', out)", "os.mkfifo(out)", "os.mkdir(out)"):
        assert attack(left)["taken"] == "error: no plain file", left
    assert attack("pass")["taken"] == "error: No such file or directory"


def test_strange_names_are_removed_with_the_rest(attack: Attack) -> None:
    attack(
        """
        os.chdir(os.path.dirname(out))
        for name in ("new\\nline", "..image", "-rf", "\\x1b[31m", "é", b"\\xff\\xfe", " ", "*"):
            os.mkdir(name)
            open(os.path.join(name, name), "w").write("x")
        os.chmod(" ", 0)
        os.chmod("*", 0o500)
        for _ in range(99):
            os.mkdir("a")
            os.chdir("a")
        """
    )


# ---------------------------------------------------------------- limits


def test_an_endless_loop_ends(attack: Attack) -> None:
    found = attack(
        """
        for kind in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
            signal.signal(kind, signal.SIG_IGN)
        open(out, "w").write("almost")
        print("loops", flush=True)
        while True:
            pass
        """,
        seconds=1.0,
    )
    assert fault(found) == "time_limit"
    assert found["ended"].printed == "loops\n"
    assert 1.0 <= found["ended"].seconds < 10.0


def test_sleepers_end_too(attack: Attack) -> None:
    found = attack("os.kill(os.getpid(), signal.SIGSTOP)", seconds=0.5)
    assert fault(found) == "time_limit"


@pytest.mark.parametrize(
    "bomb",
    [
        "while True:\n    try: os.fork()\n    except OSError: pass",
        "while True:\n    try:\n        if os.fork() == 0: os.setsid()\n    except OSError: pass",
        "while True:\n    try: threading.Thread(target=time.sleep, args=(99,)).start()\n"
        "    except RuntimeError: pass",
        "os.execvp('sh', ['sh', '-c', 'b() { b | b & }; b; sleep 99', marker])",
    ],
    ids=["processes", "sessions", "threads", "shell"],
)
def test_a_fork_bomb_ends(bomb: str, attack: Attack) -> None:
    assert fault(attack(bomb)) == "process_limit"


def test_one_that_runs_from_process_to_process_ends(attack: Attack) -> None:
    found = attack(
        """
        while True:
            if os.fork():
                os._exit(0)
            try:
                os.setsid()
            except OSError:
                pass
        """,
        seconds=1.0,
    )
    assert found["ended"].code == 0  # the first of them, and the rest with it


def test_a_daemon_does_not_outlive_its_run(attack: Attack) -> None:
    found = attack(
        """
        if os.fork() == 0:
            try:
                os.setsid()
            except OSError:
                pass
            if os.fork() == 0:
                for kind in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
                    signal.signal(kind, signal.SIG_IGN)
                os.execvp("sleep", ["sleep", "100", marker][:2])
            os._exit(0)
        os.wait()
        open(out, "w").write("an image")
        """
    )
    assert (found["ended"].code, found["taken"]) == (0, "an image")
    assert found["took"] < 15


@pytest.mark.parametrize(
    "hog",
    [
        "block = b'x' * (100 << 30)",
        "blocks = []\nwhile True: blocks.append(bytearray(b'x') * (8 << 20))",
        "import mmap\nwhole = mmap.mmap(-1, 100 << 30)\n"
        "for i in range(0, 100 << 30, 4096): whole[i] = 1",
        "import mmap\nwhole = mmap.mmap(-1, 16 << 40, mmap.MAP_PRIVATE | 0x4000, mmap.PROT_READ)\n"
        "for i in range(0, 16 << 40, 2 << 20): whole[i]",
    ],
    ids=["at once", "bit by bit", "shared", "page tables"],
)
def test_memory_has_an_end(hog: str, attack: Attack) -> None:
    found = attack(hog)
    assert fault(found) == "memory_limit"


def test_many_processes_have_the_memory_of_one(attack: Attack) -> None:
    found = attack(
        """
        for _ in range(8):
            if os.fork() == 0:
                block = bytearray(os.urandom(1)) * (60 << 20)
                time.sleep(60)
        time.sleep(60)
        """
    )
    assert fault(found) == "memory_limit"


def test_what_processes_share_counts_once(attack: Attack) -> None:
    found = attack(
        """
        block = bytearray(b"x") * (100 << 20)
        children = [os.fork() for _ in range(3)]
        time.sleep(0.5)
        print(len(block))
        """
    )
    assert found["ended"].code == 0 and fault(found) == ""


def test_memory_that_no_process_has_mapped_is_refused(attack: Attack) -> None:
    found = attack(
        """
        attempt(os.memfd_create, "hoard")
        print(libc.shmget(0, 1 << 20, 0o1600), libc.msgget(0, 0o1600), libc.semget(0, 1, 0o1600))
        """
    )
    assert found["ended"].printed == "refused Function not implemented\n-1 -1 -1\n"


def test_a_disk_is_not_filled(attack: Attack) -> None:
    found = attack(
        """
        for i in range(100000):
            open(f"{os.path.dirname(out)}/{i}", "wb").write(bytes(1 << 20))
        """
    )
    assert fault(found) == "disk_limit"


@pytest.mark.parametrize("hidden", ["", "libc.prctl(4, 0)"], ids=["seen", "hidden"])
def test_files_without_a_name_fill_no_disk(hidden: str, attack: Attack) -> None:
    """Hidden: no process of the same user may look into it."""
    found = attack(
        f"""
        {hidden}
        held = []
        while len(held) < 200:  # of the 256 that it may have open
            held.append(open(out, "wb"))
            os.unlink(out)
            held[-1].write(bytes(1 << 20))
            held[-1].flush()
        time.sleep(60)
        """
    )
    assert fault(found) == "disk_limit"


def test_nothing_is_allocated_without_being_written(attack: Attack) -> None:
    found = attack("attempt(lambda: libc.fallocate(os.open(out, 66), 0, 0, 1 << 20))")
    assert found["ended"].printed.split()[-1] == "-1"


@pytest.mark.parametrize(
    "many",
    ["for i in range(10**7): open(f'{out}{i}', 'w').close()",
     "os.chdir(os.path.dirname(out))\nwhile True:\n    os.mkdir('a')\n    os.chdir('a')"],
    ids=["beside", "below"],
)  # fmt: skip
def test_files_are_counted(many: str, attack: Attack) -> None:
    assert fault(attack(many)) == "disk_limit"


def test_a_file_has_an_end(attack: Attack) -> None:
    grown = "signal.signal(signal.SIGXFSZ, signal.{})\nf = open(out, 'wb')\n{}"
    written = "for _ in range(9): f.write(bytes(1 << 20)); f.flush()"
    assert fault(attack(grown.format("SIG_DFL", written))) == "file_limit"
    assert fault(attack(grown.format("SIG_IGN", written))) == "file_limit"
    assert fault(attack(grown.format("SIG_DFL", "f.truncate(1 << 40)"))) == "file_limit"


def test_printing_has_an_end(attack: Attack) -> None:
    found = attack("while True: os.write(1, b'spam ' * 10000); os.write(2, b'eggs ' * 10000)")
    assert fault(found) == "output_limit"
    assert len(found["ended"].printed) < 10_000


# ---------------------------------------------------------------- other processes, the network


@pytest.mark.parametrize(
    "opened",
    [
        'socket.create_connection(("127.0.0.1", port))',
        'socket.socket(socket.AF_INET6, socket.SOCK_STREAM).connect(("::1", port))',
        'socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("127.0.0.1", port))',
        "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)",
        "libc.ptrace(16, pid, 0, 0)",
        "libc.process_vm_readv(pid, 0, 0, 0, 0, 0)",
    ],
    ids=["TCP", "IPv6", "UDP", "netlink", "ptrace", "memory"],
)
def test_a_network_or_a_look_into_others_is_called_forbidden(opened: str, attack: Attack) -> None:
    assert fault(attack(f"{opened}\nprint('DID')")) == "forbidden"


def test_local_sockets_lead_nowhere(attack: Attack) -> None:
    found = attack(
        """
        named = os.path.dirname(outside) + "/socket"
        local, datagrams = socket.AF_UNIX, socket.SOCK_DGRAM
        attempt(lambda: socket.socket(local, datagrams).sendto(b"x", "\\0" + abstract))
        attempt(lambda: socket.socket(socket.AF_UNIX).connect(named))
        attempt(lambda: socket.socketpair(local, datagrams)[0].sendto(b"x", named))
        attempt(lambda: socket.socketpair()[0].sendto(b"x", named))
        attempt(lambda: socket.socketpair()[0].connect(named))
        """
    )
    assert found["ended"].printed.count("refused") == 5


def test_other_processes_stay_as_they_are(attack: Attack) -> None:
    found = attack(
        """
        import resource
        for process in {pid, os.getppid(), 1} - {os.getpid()}:
            for kind in (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM):
                try:
                    os.kill(process, kind)
                except OSError:
                    pass
        try:
            attempt(resource.prlimit, pid, resource.RLIMIT_CPU, (0, 0))
            attempt(os.setpriority, os.PRIO_PROCESS, pid, 19)
            attempt(os.sched_setaffinity, pid, {0})
            attempt(os.pidfd_open, pid)
        finally:
            print("to the end")
        """
    )
    assert "DID" not in found["ended"].printed
    assert "to the end" in found["ended"].printed


def test_killing_everyone_kills_oneself_at_most(attack: Attack) -> None:
    attack("os.kill(-1, signal.SIGKILL)")


def test_a_cage_in_the_cage_is_refused(attack: Attack) -> None:
    found = attack(
        """
        print(libc.unshare(0x10000000), libc.mount(b"none", b"/tmp", b"tmpfs", 0, 0))
        print(libc.chroot(b"."), subprocess.run(["unshare", "-U", "true"]).returncode)
        print(libc.syscall(425, 1, 0), libc.syscall(435, 0, 0), libc.syscall(470, 0))
        """
    )
    words = found["ended"].printed.split()
    assert words[-4:] == ["1", "-1", "-1", "-1"] and found["ended"].printed.count("-1") == 6


def test_nothing_of_the_graders_environment_is_seen(
    attack: Attack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PENUMBRA_TOKEN", "a secret of the grader's")
    found = attack("print(sorted(os.environ), os.listdir('/proc/self/fd') if 0 else '')")
    assert "PENUMBRA_TOKEN" not in found["ended"].printed


def test_no_file_of_the_graders_is_left_open(attack: Attack) -> None:
    found = attack(
        """
        opened = []
        for number in range(200):
            try:
                opened.append((number, os.fstat(number).st_mode))
            except OSError:
                pass
        print([number for number, _ in opened])
        """
    )
    assert found["ended"].printed == "[0, 1, 2]\n"


def test_where_landlock_is_old_the_filter_does_its_part() -> None:
    """Before version 6 it lets signals through, before 3 truncate; this process refuses itself."""
    assert filter_works()
    program = """
        import fcntl, sys
        sys.path.append(sys.argv.pop())
        from penumbra.grading import kernel
        kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
        kernel.seccomp(kernel.filter_program(False, 1))
        attempt(os.kill, pid, 0)
        attempt(signal.pthread_kill, threading.get_ident(), 0)
        attempt(fcntl.fcntl, 0, fcntl.F_SETOWN, pid)
        attempt(os.truncate, out, 0)
        print(os.getpid(), fcntl.fcntl(0, fcntl.F_GETFL) >= 0)
    """
    package = str(Path(cages.__file__).parents[2])
    words = ["out", "outside", str(os.getpid()), "0", "abstract", "marker", package]
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE.replace("= sys.argv[1:]", "= sys.argv[1:7]")
         + textwrap.dedent(program), *words], capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.count("refused Operation not permitted") == 4 and "True" in ran.stdout


# ---------------------------------------------------------------- when the grader ends first


@pytest.mark.parametrize("cage", HOLDING)
@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGINT])
def test_a_grader_that_ends_takes_its_programs_along(
    cage: str, kind: signal.Signals, package: Path
) -> None:
    folder = package / uuid.uuid4().hex[:8]  # a socket has a short name
    folder.mkdir(mode=0o755)
    marker = f"marker-{uuid.uuid4().hex}"
    program = PRELUDE + "print('runs')\nos.fork()\ntime.sleep(60)"
    task = {"cage": cage, "program": program, "limits": SMALL, "marker": marker}
    with subprocess.Popen(
        [sys.executable, package / "caged.py"],
        stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "TMPDIR": str(folder)},
        preexec_fn=default_signals,
    ) as grader:
        assert grader.stdin
        grader.stdin.write(json.dumps(task).encode())
        grader.stdin.close()
        until(lambda: len([p for p in caged.marked(marker) if "sleep" not in p]) >= 2)
        grader.send_signal(kind)
        grader.wait(10)
        until(lambda: not caged.marked(marker))
        until(lambda: not list(folder.glob("penumbra-cage-*")))


def until(true: Callable[[], bool], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


# ---------------------------------------------------------------- what is left on the disk


def test_folders_are_removed_however_deep_and_links_not_followed(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("kept")
    folder = tmp_path / "folder"
    folder.mkdir()
    here = os.open(folder, os.O_RDONLY)
    for _ in range(1100):  # more than Python calls itself, and than a path may be long
        os.symlink(kept, "link", dir_fd=here)
        os.mkdir("long", dir_fd=here)
        below = os.open("long", os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = below
    os.close(here)
    remove(folder)
    assert not folder.exists() and (kept / "file").read_text() == "kept"


def test_a_desk_leaves_nothing_behind() -> None:
    with pytest.raises(KeyboardInterrupt), desk() as found:
        (found.tmp / "file").write_text("x")
        raise KeyboardInterrupt
    assert not found.home.parent.exists()
