"""Tasks: on this machine's cores, and on a real scheduler with workers that are killed."""

from __future__ import annotations

import contextlib
import csv
import doctest
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import psutil
import pytest
from distributed import Security

from bench import scale
from penumbra.__main__ import main
from penumbra.cli.exit import MISSING, USAGE
from penumbra.compare.check import calibration
from penumbra.compare.measure.image import read_image
from penumbra.compare.run import errands
from penumbra.compare.run import tasks as tasks_module
from penumbra.compare.run.provenance import machine
from penumbra.compare.run.renderers import CommandRenderer, penumbra_renderer
from penumbra.compare.run.tasks import (
    Lost,
    MissingWorkersError,
    Scheduler,
    SchedulerError,
    Task,
    content_key,
    run_tasks,
)
from penumbra.compare.studies.convergence import ConvergenceStudy, Curve, converge
from penumbra.compare.studies.trade import TradeStudy, trade
from tests import deeds
from tests.classroom import broken, pictures
from tests.conftest import ROOT, default_signals

WITHOUT_EDITABLE = """import sys
sys.meta_path[:] = [f for f in sys.meta_path if "editable" not in type(f).__module__]
"""
LONG = 240.0
"""A condition that takes longer [s] will not come true; a loaded machine takes its time."""


def until(condition: Callable[[], Any]) -> Any:
    """Waits for a condition; what it gives."""
    end = time.monotonic() + LONG
    while not (found := condition()):
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)
    return found


class Machines:
    """A scheduler and workers on loopback, each a process group of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder, self.options = folder, options
        self.file = folder / "scheduler.json"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self._names = itertools.count()

    def start_scheduler(self, port: int = 0) -> None:
        self.file.unlink(missing_ok=True)
        self.scheduler = self._start(
            "scheduler", "--port", str(port), "--scheduler-file", str(self.file)
        )

    def start_worker(self, python_path: Path = ROOT, *options: str) -> subprocess.Popen[bytes]:
        until(self.file.exists)
        if python_path != ROOT:  # an editable package would come before it
            (python_path / "sitecustomize.py").write_text(WITHOUT_EDITABLE)
        worker = self._start(
            *("worker", "--scheduler-file", str(self.file), "--nthreads", "1", "--no-nanny"),
            *("--local-directory", str(self.folder), "--death-timeout", "60", *options),
            python_path=python_path,
        )
        self.workers.append(worker)
        return worker

    @property
    def port(self) -> int:
        return int(json.loads(self.file.read_text())["address"].rpartition(":")[2])

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if process in self.workers:
            self.workers.remove(process)

    def end(self) -> None:
        for process in [*self.workers, self.scheduler]:
            if process is not None:
                self.kill(process)

    def _start(self, what: str, *words: str, python_path: Path = ROOT) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, "--host", "127.0.0.1", "--no-dashboard"]
        log = self.folder / f"{what}{next(self._names)}.log"
        with log.open("wb") as stream:
            return subprocess.Popen(
                [*command, *words, *self.options],
                cwd=python_path,
                env=os.environ | {"PYTHONPATH": str(python_path)},
                stdout=stream,
                stderr=stream,
                start_new_session=True,
            )


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    made = Machines(tmp_path_factory.mktemp("machines"))
    try:
        made.start_scheduler()
        for _ in range(4):
            made.start_worker()
        yield made
    finally:
        made.end()


def tasks(names: list[str]) -> list[Task]:
    return [Task(content_key(name), name) for name in names]


def as_bytes(results: dict[str, Any]) -> bytes:
    return json.dumps(results, sort_keys=True).encode()


# ---------------------------------------------------------------- on this machine


def test_a_task_that_kills_its_worker_three_times_is_lost_and_the_others_go_on() -> None:
    """There is one worker, so that others wait on it for their turn when it is killed."""
    names = [f"task {i}" for i in range(12)]
    names.insert(5, "deadly")
    before = dict(os.environ)
    found = {task.argument: value for task, value in run_tasks(deeds.deadly, tasks(names), jobs=1)}
    lost = found.pop("deadly")
    assert isinstance(lost, Lost)
    assert "3 times" in lost.reason
    names.remove("deadly")
    assert as_bytes(found) == as_bytes({name: deeds.digest(name) for name in names})
    assert dict(os.environ) == before


def test_nothing_is_started_for_no_tasks() -> None:
    assert list(run_tasks(deeds.digest, [], Scheduler("/nowhere"))) == []


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    with pytest.raises(ImportError, match=r"setup"):
        list(run_tasks(deeds.digest, tasks(["a"]), jobs=1))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_one_that_is_ended(number: signal.Signals, tmp_path: Path) -> None:
    """Ctrl-C goes to the whole group. A worker's own children are ended too, unless there is nobody
    left to do it: kill -9."""
    script = (
        "import signal\n"
        "from pathlib import Path\n"
        "from penumbra.compare.run.tasks import Task, run_tasks\n"
        "from tests import deeds\n"
        "if __name__ == '__main__':\n"
        "    def stop(*_): raise KeyboardInterrupt\n"
        "    signal.signal(signal.SIGTERM, stop)\n"
        f"    list(run_tasks(deeds.endless, [Task('a', Path({str(tmp_path)!r}))], jobs=1))\n"
    )
    (tmp_path / "script.py").write_text(script)
    (tmp_path / "started").mkdir()
    ran = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")],
        env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path / "started")},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=default_signals,
    )
    started = until(lambda: [f.name.split() for f in tmp_path.iterdir() if f.name[0].isdigit()])
    worker, child = (psutil.Process(int(pid)) for pid in started[0])
    try:
        if number == signal.SIGINT:
            os.killpg(ran.pid, number)
        else:
            ran.send_signal(number)
        ran.wait(LONG)
        until(lambda: not worker.is_running())
        if number != signal.SIGKILL:
            until(lambda: not child.is_running())
            assert list((tmp_path / "started").iterdir()) == []
    finally:
        for process in (ran, worker, child):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        ran.wait()


# ---------------------------------------------------------------- on several


def test_workers_and_scheduler_are_killed_and_the_bytes_are_the_same(
    machines: Machines, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Four workers: two are killed after 8 of 80 tasks, the scheduler after 24; it comes back
    elsewhere, and so do four workers, as what runs them restarts them. What came back before is
    not worked out again."""
    names = [f"task {i}" for i in range(80)]
    done: dict[str, str] = {}
    made = [Task(content_key(name), (name, tmp_path)) for name in names]
    made.append(made[3])  # once more, but the same content
    times = 0
    for task, value in run_tasks(deeds.counted, iter(made), Scheduler(str(machines.file))):
        name = task.argument[0]
        assert done.setdefault(name, value) == value
        times += 1
        if times == 8:
            for worker in machines.workers[:2]:
                machines.kill(worker)
        if times == 24:
            before = set(done)
            worked_out = {f.name for f in tmp_path.iterdir()}
            assert machines.scheduler is not None
            machines.kill(machines.scheduler)
            for worker in list(machines.workers):  # each ends by itself, having lost it
                worker.wait(LONG)
                machines.workers.remove(worker)
            machines.start_scheduler()
            for _ in range(4):
                machines.start_worker()
    assert times == 81
    assert as_bytes(done) == as_bytes({name: deeds.digest(name) for name in names})
    again = {f.name for f in tmp_path.iterdir()} - worked_out
    assert not {name.rpartition(" ")[0].rpartition(" ")[0] for name in again} & before - {"task 3"}
    assert "the scheduler was lost" in capfd.readouterr().err


def test_a_worker_of_another_version_is_refused_whenever_it_joins(
    machines: Machines, tmp_path: Path
) -> None:
    """Its penumbra differs by one comment. First it joins a run that has begun, whose tasks would
    never end; then it is there before the run."""
    shutil.copytree(ROOT / "penumbra", tmp_path / "penumbra", ignore=lambda *_: {"__pycache__"})
    shutil.copytree(ROOT / "tests", tmp_path / "tests", ignore=lambda *_: {"__pycache__", "fuzz"})
    for name in ("pyproject.toml", "build", "c_renderer", "scenes"):
        (tmp_path / name).symlink_to(ROOT / name)
    with (tmp_path / "penumbra" / "__init__.py").open("a") as stream:
        stream.write("# other\n")
    endless = (Task(f"{tmp_path.name} {i}", f"{i}") for i in itertools.count())
    results = run_tasks(deeds.digest, endless, Scheduler(str(machines.file)))
    next(results)
    other = machines.start_worker(tmp_path)
    try:
        with pytest.raises(SchedulerError, match=r"worker .* penumbra's files is \w+ there and"):
            for _ in results:
                pass
        with pytest.raises(SchedulerError, match=r"worker tcp://127\.0\.0\.1:\d+ \(.*other vers"):
            next(run_tasks(deeds.digest, tasks(["a"]), Scheduler(str(machines.file))))
    finally:
        machines.kill(other)


def test_a_worker_without_penumbra_is_named(machines: Machines, tmp_path: Path) -> None:
    (tmp_path / "penumbra.py").write_text("import something_that_is_not_there\n")
    lacking = machines.start_worker(tmp_path)
    scheduler = Scheduler(str(machines.file))
    try:
        with pytest.raises(MissingWorkersError, match=r"cannot import penumbra .*something_that"):
            for i in itertools.count():  # until it has joined
                list(run_tasks(deeds.digest, tasks([f"lacking {i}"]), scheduler))
        assert MissingWorkersError.exit_code == MISSING
    finally:
        machines.kill(lacking)


def test_a_module_that_workers_lack_is_named(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "only_here.py").write_text("def deed(argument):\n    return argument\n")
    monkeypatch.syspath_prepend(tmp_path)
    import only_here

    with pytest.raises(MissingWorkersError, match="lacks the module only_here"):
        list(run_tasks(only_here.deed, tasks(["a"]), Scheduler(str(machines.file))))


def test_what_a_task_raises_is_raised_here(machines: Machines) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        list(run_tasks(deeds.wrong, tasks(["a file"]), Scheduler(str(machines.file))))
    assert raised.value.filename == "a file"


# ---------------------------------------------------------------- what is done with it


NOWHERE = Scheduler("/nowhere.json", patience=0.1)
"""For runs that must not need one"""


def without(data: Any, *names: str) -> Any:
    """JSON without some keys, wherever they are."""
    if isinstance(data, dict):
        return {k: without(v, *names) for k, v in data.items() if k not in names}
    return [without(v, *names) for v in data] if isinstance(data, list) else data


def test_calibration_says_the_same_bytes_on_workers(machines: Machines) -> None:
    """Of one picture, whose grid is given, which saves the time to fit it."""
    lacking = next(s for s in calibration.few() if s.kind == "left out")
    specimens = [replace(lacking, fitted=False)]
    here = {s.key: said for s, said in calibration.judged(specimens, jobs=1)}
    scheduler = Scheduler(str(machines.file))
    there = {s.key: said for s, said in calibration.judged(specimens, None, scheduler)}
    assert len(there) == 1
    assert as_bytes(there) == as_bytes(here)


def test_grades_are_the_same_bytes_on_workers(machines: Machines, tmp_path: Path) -> None:
    """Of pictures, a program that crashes, and a folder with nothing in it."""
    folder = tmp_path / "class"
    pictures(folder, 2)
    broken(folder, ("empty",))
    (folder / "crash").mkdir()
    (folder / "crash" / "penumbra.toml").write_text(
        "[program]\nrun = 'false {scene} {light_samples} {seed} {out}'\n"
    )
    written = []
    for name, options in (
        ("here", ["--jobs", "1"]),
        ("there", ["--scheduler", str(machines.file)]),
    ):
        assert main(["grade", str(folder), "-o", str(tmp_path / name), *options]) == 0
        files = sorted(f for f in (tmp_path / name).rglob("*") if f.suffix in (".json", ".html"))
        written.append([(f.relative_to(tmp_path / name), f.read_bytes()) for f in files])
    assert written[0] == written[1]
    graded = json.loads((tmp_path / "there" / "grades.json").read_text())["submissions"]
    assert [one["status"] for one in graded] == ["failed", "failed", "graded", "graded"]


def test_convergence_differs_in_its_seconds_alone_and_costs_nothing_again(
    machines: Machines, make_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """Two renderers: ours, which every worker has, and a command with a path of this folder."""
    scene = make_scene(image={"width": 36, "height": 24})
    program = os.path.relpath(ROOT / "build" / "bin" / "penumbra-render")
    command = f"{program} {{scene}} -o {{out}} --light-samples {{light_samples}} --seed {{seed}}"
    found = {}
    for name, scheduler in (("here", None), ("there", Scheduler(str(machines.file)))):
        curves = tuple(
            Curve(renderer, (1, 4, 16))
            for renderer in (penumbra_renderer(), CommandRenderer("other", command))
        )
        study = ConvergenceStudy(scene, tmp_path / name, curves, seeds=2, keep_images=True)
        result = converge(study, scheduler)
        with study.file(".csv").open(newline="") as stream:
            rows = [without(row, "seconds") for row in csv.DictReader(stream)]
        images = {
            file.name: read_image(file).radiance.tobytes()
            for file in study.file("_images").iterdir()
        }
        found[name] = rows, without(result, "seconds", "machines", "command"), images
    assert len(found["there"][2]) == 12
    assert found["there"] == found["here"]
    assert result["machines"] == [machine()]
    written = study.file(".csv").read_bytes()
    converge(study, NOWHERE)
    assert study.file(".csv").read_bytes() == written


def test_a_trade_on_workers_has_the_same_errors_and_names_the_machines(
    machines: Machines, make_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """Three N of each method, which are measured however long they take: the same settings."""
    scene = make_scene(image={"width": 36, "height": 24})
    other = make_scene("tp3_disk", "other.json", image={"width": 36, "height": 24})
    errors = {}
    for name, scheduler in (("here", None), ("there", Scheduler(str(machines.file)))):
        study = TradeStudy(
            scene, tmp_path / name, (other,), light_samples=(1, 4, 16), threads=(1,), seeds=2
        )
        result = trade(study, scheduler)
        with study.file(".csv").open(newline="") as stream:
            errors[name] = [without(row, "seconds") for row in csv.DictReader(stream)]
    assert errors["there"] == errors["here"]
    assert list(result["machines"].values()) == [machine(), machine()]
    assert len(result["machines"]) == 2
    written = study.file(".csv").read_bytes()
    trade(study, NOWHERE)
    assert study.file(".csv").read_bytes() == written


# ---------------------------------------------------------------- keys, addresses


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Authority, certificate, key: a certificate that signs itself."""
    return write_keys(tmp_path_factory.mktemp("keys"))


def write_keys(folder: Path) -> tuple[Path, Path, Path]:
    made = Security.temporary()
    certificate, key = folder / "cert.pem", folder / "key.pem"
    certificate.write_text(made.tls_client_cert)
    key.write_text(made.tls_client_key)
    return certificate, certificate, key


def test_encrypted_tasks_need_the_keys(tmp_path: Path, keys: tuple[Path, Path, Path]) -> None:
    authority, certificate, key = map(str, keys)
    machines = Machines(
        tmp_path, *("--protocol", "tls", "--tls-ca-file", authority),
        *("--tls-cert", certificate, "--tls-key", key),
    )  # fmt: skip
    try:
        machines.start_scheduler()
        machines.start_worker()
        scheduler = Scheduler(str(machines.file), *keys)
        assert scheduler.address().startswith("tls://")
        found = list(run_tasks(deeds.digest, tasks(["a"]), scheduler))
        assert [value for _, value in found] == [deeds.digest("a")]
        with pytest.raises(SchedulerError, match="needs --tls-ca"):
            list(run_tasks(deeds.digest, tasks(["a"]), Scheduler(str(machines.file))))
        (tmp_path / "others").mkdir()
        others = Scheduler(str(machines.file), *write_keys(tmp_path / "others"), patience=2)
        with pytest.raises(SchedulerError, match="certificate"):
            list(run_tasks(deeds.digest, tasks(["a"]), others))
    finally:
        machines.end()


def test_keys_that_would_protect_nothing_are_refused(
    tmp_path: Path, keys: tuple[Path, Path, Path]
) -> None:
    with pytest.raises(SchedulerError, match="not encrypted"):
        Scheduler("tcp://127.0.0.1:1", *keys).address()
    with pytest.raises(SchedulerError, match="no --tls-key"):
        Scheduler("tls://127.0.0.1:1", *keys[:2]).security()
    with pytest.raises(SchedulerError, match=r"gone\.pem: no such file"):
        Scheduler("tls://127.0.0.1:1", *keys[:2], tmp_path / "gone.pem").security()


@pytest.mark.parametrize("text", ["", "[]", "{}", "not json"])
def test_a_file_that_is_no_schedulers_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "scheduler.json"
    file.write_text(text)
    with pytest.raises(SchedulerError, match=r"scheduler\.json: no file of `dask scheduler"):
        Scheduler(str(file)).address()
    assert getattr(SchedulerError, "exit_code", USAGE) == USAGE


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--tls-ca", "a.pem"), "go with --scheduler"),
        (("--scheduler", "tcp://a:1", "--jobs", "2"), "leave it out with --scheduler"),
        (("--scheduler", "tls://a:1"), "needs --tls-ca, --tls-cert and --tls-key"),
        (("--scheduler", "tls://a:1", "--tls-ca", "a.pem"), "go together: no --tls-cert"),
        (("--scheduler", "ftp://a:1"), "begins with tcp:// or tls://"),
    ],
)
def test_options_that_do_not_go_together_are_usage_errors(
    options: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "calibration.json"
    assert main(["calibrate", "--reduced", "-o", str(out), *options]) == USAGE
    assert said in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("module", [tasks_module, errands, scale])
def test_doctests_hold(module: ModuleType) -> None:
    tried = doctest.testmod(module)
    assert tried.attempted and not tried.failed


def test_patience_ends() -> None:
    with pytest.raises(MissingWorkersError, match=r"nowhere\.json: no scheduler answers"):
        list(run_tasks(deeds.digest, tasks(["a"]), Scheduler("/nowhere.json", patience=0.1)))
