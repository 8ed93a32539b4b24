"""When output fails or a run is stopped: the right exit status, one sentence, no half file.

tests/test_cli.py and tests/test_render.py hold the unwritable folder, tests/test_convergence.py
the run that is killed and goes on.
"""

from __future__ import annotations

import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from penumbra.compare.measure.image import Image, read_image, write_exr
from tests.campaign import rounds
from tests.conftest import ROOT, default_signals

PENUMBRA = [sys.executable, "-m", "penumbra"]
RENDER = [str(ROOT / "build" / "bin" / "penumbra-render")]
SCENE = str(ROOT / "scenes" / "tp3.json")
SIGNALS = [signal.SIGINT, signal.SIGTERM]


def shell_status(returncode: int) -> int:
    """As a shell says it: 128 + n for a program that signal n ended."""
    return 128 - returncode if returncode < 0 else returncode


# ---------------------------------------------------------------- standard output

PRINTING = [
    [*PENUMBRA, "scene", SCENE],
    [*RENDER, "--print-scene", SCENE],
    [*RENDER, "--version"],
    [*RENDER, SCENE, "-o", "{out}", "--target-error", "1", "--width", "9", "--height", "6"],
]
PRINTING_NAMES = ["scene", "print-scene", "version", "target-error"]


@pytest.mark.parametrize("command", PRINTING, ids=PRINTING_NAMES)
@pytest.mark.parametrize(
    ("redirection", "reason"),
    [(">/dev/full", "No space left on device"), (">&-", "Bad file descriptor")],
)
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_what_cannot_be_printed_is_an_error(
    command: list[str], redirection: str, reason: str, unbuffered: str, tmp_path: Path
) -> None:
    filled = [word.format(out=tmp_path / "a.exr") for word in command]
    run = subprocess.run(
        ["sh", "-c", f'exec "$@" {redirection}', "-", *filled],
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )
    assert run.returncode == 2
    program = "penumbra-render" if command[0] == RENDER[0] else "penumbra"
    assert run.stderr == f"{program}: standard output: {reason}\n"


def test_a_closed_output_is_no_matter_to_who_prints_nothing(tmp_path: Path) -> None:
    """And the image is not written to the descriptor that is free."""
    for command in ([*RENDER, SCENE], [*PENUMBRA, "exact", SCENE]):
        out = tmp_path / "a.exr"
        run = subprocess.run(
            ["sh", "-c", 'exec "$@" >&-', "-", *command, "-o", str(out), "--width", "6"],
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
        )
        assert (run.returncode, run.stderr) == (0, "")
        assert read_image(out).shape[1] == 6


@pytest.mark.parametrize("command", PRINTING, ids=PRINTING_NAMES)
def test_a_reader_that_went_away_ends_the_program_as_sigpipe_does(
    command: list[str], tmp_path: Path
) -> None:
    """141 = 128 + 13, in silence: a verdict that nobody read is not a pass."""
    filled = [word.format(out=tmp_path / "a.exr") for word in command]
    read, write = os.pipe()
    os.close(read)
    run = subprocess.run(
        filled, stdout=write, stderr=subprocess.PIPE, timeout=120, restore_signals=True
    )
    os.close(write)
    assert (shell_status(run.returncode), run.stderr) == (128 + signal.SIGPIPE, b"")


# ---------------------------------------------------------------- disk full


@pytest.fixture
def folder(make_scene: Callable[..., Path], tmp_path: Path) -> Path:
    """With inputs for every subcommand, and a renderer whose image is smaller than a journal."""
    make_scene(image={"width": 6, "height": 4})
    (tmp_path / "grey.pfm").write_bytes(b"PF\n6 4\n-1.0\n" + np.ones(72, "<f4").tobytes())
    (tmp_path / "copy.sh").write_text("cp grey.pfm $4\n")
    write_exr(tmp_path / "image.exr", Image(np.ones((4, 6, 3))))
    return tmp_path


COPY = "--renderer 'sh copy.sh {scene} {light_samples} {seed} {out}' --image-suffix .pfm"
WRITING = {  # name: (command, what it writes, bytes that a file may have)
    "exact": ("penumbra exact scene.json -o OUT.exr", "OUT.exr", 0),
    "png": ("penumbra png image.exr -o OUT.png", "OUT.png", 0),
    "compare": (
        "penumbra compare grey.pfm exact --scene scene.json --json OUT.json", "OUT.json", 100
    ),
    "converge, its renderer": (
        "penumbra converge scene.json -o OUT --light-samples 1..4", "OUT.csv OUT.json", 100
    ),
    "converge, its journal": (
        f"penumbra converge scene.json -o OUT --light-samples 1..4 {COPY}", "OUT.csv OUT.json", 400
    ),
    "speedup": (
        "penumbra speedup scene.json -o OUT.csv --threads 1 --repeats 1 --light-samples 1",
        "OUT.csv", 100,
    ),
    "trade": (
        "penumbra trade scene.json -o OUT --light-samples 1,4 --max-seconds 0.01 --threads 1 "
        "--seeds 2", "OUT.csv OUT.json", 100,
    ),
    "render": ("penumbra-render scene.json -o OUT.exr", "OUT.exr", 0),
    "render, half": (f"penumbra-render {SCENE} -o OUT.exr", "OUT.exr", 1 << 16),
}  # fmt: skip


def run_limited(command: str, cwd: Path, most: int) -> subprocess.CompletedProcess[str]:
    """A limit on the size of files stands for a full disk: writing fails, not opening."""
    words = {"penumbra": PENUMBRA, "penumbra-render": RENDER}
    program, arguments = command.split(" ", 1)
    shell = " ".join(f"'{word}'" for word in words[program]) + " " + arguments
    return subprocess.run(
        ["sh", "-c", f"exec {shell}"],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
    )


@pytest.mark.parametrize("case", WRITING)
def test_a_full_disk_keeps_what_was_there_and_leaves_nothing_else(case: str, folder: Path) -> None:
    """Files small enough to be in a buffer until they are closed, and larger ones."""
    command, outputs, most = WRITING[case]
    for name in outputs.split():
        (folder / name).write_text("of an earlier run")
    before = sorted(f.name for f in folder.iterdir())
    run = run_limited(command, folder, most)
    assert run.returncode == 2, run.stderr
    assert run.stderr.startswith(command.split()[0] + ": ") and "Traceback" not in run.stderr
    assert re.search(
        r"\S+\.(exr|png|json|journal): cannot be written: File too large"
        r"|OUT\.json: File too large",
        run.stderr,
    ), run.stderr
    assert sorted(f.name for f in folder.iterdir()) == before
    for name in outputs.split():
        assert (folder / name).read_text() == "of an earlier run"


# ---------------------------------------------------------------- signals


@pytest.mark.parametrize("sent", SIGNALS)
def test_a_render_stopped_while_it_writes_leaves_no_part(
    sent: signal.Signals, tmp_path: Path
) -> None:
    """Caught in the act: stopped (SIGSTOP) as soon as its unfinished file is there."""
    out, part = tmp_path / "a.exr", tmp_path / "a.exr.part"
    command = [*RENDER, SCENE, "-o", str(out), "--light-samples", "1"]
    command += ["--width", "3000", "--height", "2000"]
    for _ in range(10):
        out.write_text("of an earlier run")
        with subprocess.Popen(command, preexec_fn=default_signals) as process:
            while process.poll() is None and not part.exists():
                time.sleep(0.001)
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.01)
            caught = part.exists()
            process.send_signal(sent)
            process.send_signal(signal.SIGCONT)
        assert not part.exists()
        if caught:
            assert process.returncode == -sent
            assert out.read_text() == "of an earlier run"
            return
    pytest.fail("never caught while writing")


def test_an_ignored_interrupt_stays_ignored(tmp_path: Path) -> None:
    """As in a shell's background jobs."""
    out = tmp_path / "a.exr"
    with subprocess.Popen(
        [*RENDER, SCENE, "-o", str(out), "--light-samples", "1", "--width", "3000"],
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    ) as process:
        while process.poll() is None:
            process.send_signal(signal.SIGINT)
            time.sleep(0.01)
    assert process.returncode == 0
    assert read_image(out).shape[1] == 3000


COMPARE = f"penumbra compare reference.exr exact --scene {SCENE} --json OUT.json"


def wait_until_ready(process: subprocess.Popen[str]) -> None:
    """Until Python, whose start a signal may end in other ways, has come to our main function,
    which begins by catching SIGTERM."""
    while process.poll() is None:
        status = Path(f"/proc/{process.pid}/status").read_text()
        caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.001)


STOPPABLE = {
    "compare": (COMPARE, "OUT.json"),
    **{
        name: (command.replace("scene.json", SCENE), outputs)
        for name, (command, outputs, _) in WRITING.items()
        if name not in ("render, half", "converge, its journal", "compare")
    },
}


def stop(command: str, outputs: str, folder: Path, sent: signal.Signals, delay: float) -> int:
    """Send a signal after a delay [s]; checks the folder, and returns the exit status."""
    for name in outputs.split():
        (folder / name).write_text("of an earlier run")
    words = {"penumbra": PENUMBRA, "penumbra-render": RENDER}
    program, *arguments = command.split()
    process = subprocess.Popen(
        [*words[program], *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=default_signals,
    )
    if program == "penumbra":
        wait_until_ready(process)
    time.sleep(delay)
    process.send_signal(sent)
    _, error = process.communicate(timeout=300)
    left = {f.name for f in folder.iterdir()}
    assert not [name for name in left if name.endswith(".part") or ".scratch-" in name], left
    finished = process.returncode in (0, 1)  # 1: compare's verdict
    assert finished or shell_status(process.returncode) == 128 + sent, error
    if not finished and program == "penumbra":
        # Above it, if numpy was being imported: its C code prints what it makes of the exception.
        assert error.splitlines()[-1].startswith("penumbra: stopped"), error
    kept = [(folder / name).read_bytes() == b"of an earlier run" for name in outputs.split()]
    assert not any(kept) or not finished
    return shell_status(process.returncode)


@pytest.mark.parametrize("name", STOPPABLE)
def test_a_stopped_program_says_so_and_leaves_only_whole_files(name: str, folder: Path) -> None:
    """At random moments of its first second."""
    command, outputs = STOPPABLE[name]
    shutil.copy(ROOT / "penumbra" / "blender_ref" / "shipped" / "tp3.exr", folder / "reference.exr")
    for number in rounds(share=1 / 6 / len(STOPPABLE)):
        draw = random.Random(f"{name} {number}")
        sent = SIGNALS[number % 2] if number else draw.choice(SIGNALS)
        stop(command, outputs, folder, sent, draw.uniform(0, 1))
        for journal in folder.glob("*.journal"):
            journal.unlink()


@pytest.mark.parametrize("sent", SIGNALS)
def test_a_signal_after_the_work_is_done_changes_nothing(
    sent: signal.Signals, tmp_path: Path
) -> None:
    """While Python ends: at its first step, and at random moments, since at its last step it
    has restored the default of every signal that it caught."""
    out = tmp_path / "a.exr"
    command = [*PENUMBRA, "exact", SCENE, "-o", str(out), "--width", "6"]
    first = f"import atexit, signal; atexit.register(signal.raise_signal, {int(sent)})\n"
    (tmp_path / "sitecustomize.py").write_text(first)
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    run = subprocess.run(
        command,
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=default_signals,
    )
    assert (run.returncode, run.stderr) == (0, "")
    wrong = [*PENUMBRA, "scene", str(tmp_path / "none.json")]
    run = subprocess.run(wrong, env=env, capture_output=True, text=True, timeout=120)
    assert run.returncode == 2 and len(run.stderr.splitlines()) == 1, run.stderr
    draw = random.Random(int(sent))
    for _ in range(5):
        out.unlink()
        with subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, preexec_fn=default_signals
        ) as process:
            while process.poll() is None and not out.exists():
                time.sleep(0.001)
            time.sleep(draw.uniform(0, 0.1))
            process.send_signal(sent)
            _, error = process.communicate(timeout=120)
        stopped = process.returncode == 128 + sent and error == "penumbra: stopped\n"
        assert stopped or (process.returncode, error) == (0, "")


def test_each_signal_has_its_own_status(folder: Path) -> None:
    """128 + n, with one sentence; the image would take 20 s."""
    for sent in SIGNALS:
        with subprocess.Popen(
            [*PENUMBRA, "exact", SCENE, "-o", "OUT.exr", "--width", "3000"],
            cwd=folder,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=default_signals,
        ) as process:
            wait_until_ready(process)
            process.send_signal(sent)
            _, error = process.communicate(timeout=60)
        assert process.returncode == 128 + sent
        assert error.splitlines()[-1] == "penumbra: stopped"
        assert not list(folder.glob("OUT*"))


@pytest.mark.parametrize("sent", SIGNALS)
def test_a_signal_while_a_string_is_run_has_its_status_too(
    sent: signal.Signals, tmp_path: Path
) -> None:
    """As when a dataclass is made: `python -m` remembers a KeyboardInterrupt of there, and dies of
    SIGINT, whatever is returned."""
    (tmp_path / "stopped_there.py").write_text(
        "import os, sys, penumbra.cli.scene as scene\n"
        "from penumbra.__main__ import main\n"
        "import time\n"
        f"scene.run = lambda _: exec('os.kill(os.getpid(), {sent.value}); time.sleep(9)')\n"
        "sys.exit(main())\n"
    )
    ran = subprocess.run(
        [sys.executable, "-m", "stopped_there", "scene", "x"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, preexec_fn=default_signals,
    )  # fmt: skip
    assert ran.returncode == 128 + sent and ran.stderr == "penumbra: stopped\n"
