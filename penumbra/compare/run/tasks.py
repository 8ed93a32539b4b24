"""Tasks: one function of many arguments, on this machine's cores or on a Dask scheduler's workers.

The caller keeps what comes back (Journal); nothing here is written. docs/scale.md tells how to
start a scheduler and workers, and when that is worth it.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import logging
import os
import pickle
import platform
import queue
import re
import signal
import socket
import ssl
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import penumbra
from penumbra.compare.run.provenance import VERSION, cores, file_hash, how_to_install
from penumbra.compare.run.renderers import interrupts_held

IN_FLIGHT = 2
"""Tasks handed over for each thread of a worker: the next one is there when one ends."""
DEATHS = 3
"""Workers that must have died of a task before it is given up, the last of them alone with it"""
PATIENCE = 600.0
"""How long to wait for a scheduler that is gone, or for a worker where there is none [s]"""
CONNECTING = 5.0
"""How long one attempt to reach a scheduler may take [s]; Ctrl-C waits for it"""
SILENCE = 20.0
"""How long to wait without saying so: a worker that died takes a while to start again [s]"""
POLL = 0.5
"""How often to look whether scheduler and workers are still there [s]"""
PACKAGES = ("numpy", "scipy", "pillow", "OpenEXR", "dask", "distributed", "cloudpickle", "msgpack")
"""Whose versions must be the same everywhere, for the same bytes or the same pickles"""
EXTRA = how_to_install("class")


class SchedulerError(ValueError):
    """A scheduler that cannot be used, or workers of other versions; the text says which."""


class MissingWorkersError(RuntimeError):
    """No scheduler answers, no worker is there, or one lacks a module; the text says what to do."""

    exit_code = 3


@dataclass(frozen=True)
class Task:
    """One argument, and what it is called."""

    key: str
    """a hash of the content that decides the result: see content_key()"""
    argument: Any
    """pickled, sent to a worker"""


@dataclass(frozen=True)
class Lost:
    """Instead of a result: whichever worker took the task died of it."""

    reason: str


@dataclass(frozen=True)
class Scheduler:
    """A Dask scheduler that somebody started.

    >>> Scheduler("cluster:8786").is_file, Scheduler("build/scheduler.json").is_file
    (False, True)
    """

    place: str
    """host:port, tcp://host:port, tls://host:port, or the file that `dask scheduler` writes with
    --scheduler-file, read anew whenever the scheduler has to be found again"""
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    patience: float = PATIENCE
    """[s]"""

    @property
    def is_file(self) -> bool:
        return not re.fullmatch(r"(\w+://.+|[\w.-]+:\d+)", self.place)

    def address(self) -> str:
        """Raises SchedulerError, OSError if the file is not there (yet)."""
        address = self.place
        if self.is_file:
            try:
                address = str(json.loads(Path(self.place).read_text())["address"])
            except (ValueError, KeyError, TypeError) as error:
                raise SchedulerError(
                    f"{self.place}: no file of `dask scheduler --scheduler-file`, "
                    "nor an address like tcp://host:8786"
                ) from error
        if "://" not in address:
            address = ("tls://" if self.tls_ca else "tcp://") + address
        kind = address.partition("://")[0]
        if kind not in ("tcp", "tls"):
            raise SchedulerError(f"{address}: a scheduler's address begins with tcp:// or tls://")
        if kind == "tls" and not self.tls_ca:
            raise SchedulerError(f"{address}: needs --tls-ca, --tls-cert and --tls-key")
        if kind == "tcp" and self.tls_ca:
            raise SchedulerError(
                f"{address}: is not encrypted, so --tls-ca would protect nothing: "
                "start the scheduler with --protocol tls"
            )
        return address

    def security(self) -> Any:
        """For a Client; None without TLS. Raises SchedulerError."""
        files = {"--tls-ca": self.tls_ca, "--tls-cert": self.tls_cert, "--tls-key": self.tls_key}
        missing = [option for option, file in files.items() if file is None]
        if len(missing) == len(files):
            return None
        if missing:
            raise SchedulerError(f"--tls-ca, --tls-cert and --tls-key go together: no {missing[0]}")
        for option, file in files.items():
            if not Path(str(file)).is_file():
                raise SchedulerError(f"{option} {file}: no such file")
        return _distributed().Security(
            require_encryption=True,
            tls_ca_file=str(self.tls_ca),
            tls_client_cert=str(self.tls_cert),
            tls_client_key=str(self.tls_key),
        )


def content_key(*parts: str | bytes | int | float | None) -> str:
    """A hash of parts, for Task.key: what decides a result, the version of its code included.

    >>> content_key("ab", "c") == content_key("a", "bc")
    False
    """
    whole = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else repr(part).encode()
        whole.update(hashlib.sha256(data).digest())
    return whole.hexdigest()[:32]


def run_tasks(
    function: Callable[[Any], Any],
    tasks: Iterable[Task],
    scheduler: Scheduler | None = None,
    jobs: int | None = None,
) -> Generator[tuple[Task, Any], None, None]:
    """Each task with function(task.argument), or with Lost, as they get done.

    function: of a module, deterministic; runs in a process that is not this one. tasks: taken one
    after another, IN_FLIGHT for each thread of a worker. Without a scheduler there are `jobs`
    processes of this machine (every core), which end with the iterator: exhaust or close() it.

    Dask gives a task of a worker that died to another one. A task of which as many died as the
    scheduler allows is tried again at the end, alone, since who shared a worker with it is no
    culprit; if it kills that one too, DEATHS in all, it is Lost. A scheduler that is restarted gets
    what was not done again.

    Raises SchedulerError for workers that differ in versions, MissingWorkersError, ImportError if
    Dask is not installed, and whatever function raises.
    """
    pending = iter(tasks)
    first = next(pending, None)
    if first is None:
        return
    with _Pool(scheduler, jobs or cores()) as pool:
        yield from _Run(function, first, pending, pool).results()


# ---------------------------------------------------------------- versions


def versions_here() -> dict[str, str]:
    """Everything that a result's bytes depend on: versions, and hashes of what is run."""
    return dict(_versions_here())


@cache
def _versions_here() -> dict[str, str]:
    folder = Path(penumbra.__file__).parent
    sources = sorted([*folder.rglob("*.py"), *folder.glob("locale/*/*/*.mo")])
    found = {"python": platform.python_version(), "penumbra": VERSION}
    found["penumbra's files"] = file_hash(*sources)[:12]
    found["C libraries"] = _libraries_hash()
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "none"
    return found


def _libraries_hash() -> str:
    from penumbra.compare.check.mistaken import LIBRARY as MISTAKES
    from penumbra.compare.run.library import LIBRARY

    files = [file for file in (LIBRARY, MISTAKES) if file.is_file()]
    return file_hash(*files)[:12] if files else "none"


def differences(here: dict[str, str], there: dict[str, str]) -> list[str]:
    """What to say of a worker's versions.

    >>> differences({"numpy": "2.2", "scipy": "1.17"}, {"numpy": "2.3", "scipy": "1.17"})
    ['numpy is 2.3 there and 2.2 here']
    """
    return [
        f"{name} is {there.get(name, 'none')} there and {version} here"
        for name, version in here.items()
        if there.get(name, "none") != version
    ]


def _refusal(worker: str, found: list[str]) -> str:
    return f"worker {worker} has other versions: {'; '.join(found)}. Make them the same"


def _checked(function: Callable[[Any], Any], argument: Any, expected: dict[str, str]) -> Any:
    """On a worker, which may have joined after the others were compared."""
    if found := differences(expected, versions_here()):
        from distributed import get_worker

        worker = f"{get_worker().address} ({socket.gethostname()})"
        raise SchedulerError(_refusal(worker, found))
    return function(argument)


@dataclass(frozen=True)
class _Call:
    """Pickled, it is called by whoever loads it, and its value is loaded: a worker. The scheduler,
    which looks into what it is given, sees bytes, and so needs neither penumbra nor memory for what
    the argument holds."""

    arguments: tuple[Callable[[Any], Any], Any, dict[str, str]]

    def __reduce__(self) -> tuple[Any, ...]:
        return _checked, self.arguments


# ---------------------------------------------------------------- scheduler and workers


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ImportError(f"tasks need Dask distributed ({error}): {EXTRA}") from error
    for name in ("distributed", "distributed.client", "distributed.core", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what matters is said here
    return distributed


class _Gone(Exception):
    """The scheduler does not answer."""


class _Pool:
    """A client, and the embedded cluster if there is one."""

    def __init__(self, scheduler: Scheduler | None, jobs: int) -> None:
        self.scheduler, self.jobs = scheduler, jobs
        self.client: Any = None
        self._cluster: Any = None
        self._on_close = contextlib.ExitStack()
        self._threads, self._looked = 0, float("-inf")

    def __enter__(self) -> _Pool:
        try:
            if self.scheduler is None:
                self._embed(self.jobs)
            self.connect()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def patience(self) -> float:
        return self.scheduler.patience if self.scheduler else PATIENCE

    def connect(self) -> None:
        """To the scheduler, again if it was lost; then compares versions."""
        distributed = _distributed()
        self._drop_client()
        until = time.monotonic() + self.patience
        told = False
        while True:
            try:
                where, security = self._cluster, None
                if self.scheduler is not None:
                    where, security = self.scheduler.address(), self.scheduler.security()
                with interrupts_held():  # else nobody could close it
                    self.client = distributed.Client(
                        where, security=security, timeout=CONNECTING, set_as_default=False
                    )
                self._compare()
                return
            except (OSError, _Gone) as error:  # Dask's and Python's TimeoutError are OSErrors
                self._drop_client()
                if reason := _distrust(error):
                    raise SchedulerError(
                        f"the scheduler's certificate or ours is not trusted: {reason}"
                    ) from error
                place = self.scheduler.place if self.scheduler else "the embedded cluster"
                if time.monotonic() > until:
                    raise MissingWorkersError(f"{place}: no scheduler answers: {error}") from error
                if not told:
                    _say(f"{place}: no scheduler answers; waiting {self.patience:g} s for it")
                    told = True
                time.sleep(POLL)

    def threads(self) -> int:
        """Of all workers; waits for the first. Raises _Gone, MissingWorkersError."""
        if self._threads and time.monotonic() - self._looked < POLL:
            return self._threads
        start, told = time.monotonic(), False
        while not (threads := sum(self.ask(self.client.nthreads).values())):
            waited = time.monotonic() - start
            if waited > self.patience:
                raise MissingWorkersError(
                    "the scheduler has no worker: start some, by `dask worker ADDRESS`"
                )
            if waited > SILENCE and not told:
                _say(f"the scheduler has no worker; waiting {self.patience:g} s for one")
                told = True
            time.sleep(POLL)
        self._threads, self._looked = int(threads), time.monotonic()
        return self._threads

    def isolate(self) -> None:
        """From now on one death is enough to hear of."""
        if self._cluster is not None:
            self._cluster.scheduler.allowed_failures = 0

    def is_gone(self) -> bool:
        return self.client.status != "running"

    def ask(self, question: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Of the scheduler. Raises _Gone."""
        try:
            return question(*arguments, **options)
        except (OSError, CancelledError, asyncio.CancelledError) as error:
            raise _Gone(str(error)) from error
        except Exception as error:  # of whatever kind, on a client that is closing
            if self.is_gone():
                raise _Gone(str(error)) from error
            raise

    def _compare(self) -> None:
        """Versions here, at the scheduler and at the workers there are. Raises SchedulerError."""
        self.threads()
        here = versions_here()
        told = self.ask(self.client.get_versions)
        found = dict(told["scheduler"]["packages"])
        for name in ("dask", "distributed"):
            if found.get(name) != here[name]:
                raise SchedulerError(
                    f"the scheduler has {name} {found.get(name)}, not {here[name]} as here: "
                    "make them the same"
                )

        python = told["client"]["host"]["python"]
        for address, worker in told["workers"].items():  # what another one could not even load
            if (other := worker["host"]["python"]) != python:
                raise SchedulerError(
                    _refusal(address, differences({"python": python}, {"python": other}))
                )

        def look() -> Any:  # by value: a worker may lack penumbra
            import socket

            try:
                from penumbra.compare.run.tasks import versions_here
            except Exception as error:
                return socket.gethostname(), f"{type(error).__name__}: {error}"
            return socket.gethostname(), versions_here()

        for address, (host, versions) in self.ask(self.client.run, look).items():
            worker = f"{address} ({host})"
            if isinstance(versions, str):
                raise MissingWorkersError(
                    f"worker {worker} cannot import penumbra ({versions}): "
                    "install it there, or start the worker where it is"
                )
            if differing := differences(here, versions):
                raise SchedulerError(_refusal(worker, differing))

    def _embed(self, jobs: int) -> None:
        """A cluster on loopback, its traffic encrypted by a key made now: others may have accounts
        on this machine, and whoever reaches a scheduler can have it run anything."""
        distributed = _distributed()
        import dask

        try:
            security = distributed.Security.temporary()
        except ImportError as error:
            raise ImportError(f"{error}: {EXTRA}") from error
        loop = distributed.utils.LoopRunner()
        # What its thread starts inherits the mask: a terminal's Ctrl-C is sent to workers too, but
        # it is this process that ends them.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            loop.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._on_close.callback(loop.stop)
        self._on_close.callback(_restore_environment, dict(os.environ))  # Dask changes it
        scratch = self._on_close.enter_context(tempfile.TemporaryDirectory(prefix="penumbra-"))
        settings = {
            "distributed.scheduler.allowed-failures": DEATHS - 2,  # the last one is isolate()'s
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            "temporary-directory": scratch,
        }
        with dask.config.set(settings), interrupts_held():
            self._cluster = distributed.LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                protocol="tls://",
                security=security,
                dashboard_address="127.0.0.1:0",
                worker_dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
                local_directory=scratch,
                loop=loop.loop,
            )
            self._on_close.callback(_end, self._cluster)
            self._cluster.scale(jobs)  # returns at once, so that what stops us finds all to end

    def _drop_client(self) -> None:
        if self.client is not None:
            with contextlib.suppress(Exception):
                self.client.close(timeout=2)
            self.client = None

    def _close(self) -> None:
        with self._on_close:
            self._drop_client()


def _end(cluster: Any) -> None:
    """A cluster, and whatever tasks started in its workers."""
    started = _started_by(cluster)
    with contextlib.suppress(Exception):
        cluster.close(timeout=10)
    for process in started:
        with contextlib.suppress(Exception):  # ended already
            process.kill()


def _started_by(cluster: Any) -> list[Any]:
    """The workers' processes, and those that tasks started in them."""
    import psutil

    found: list[Any] = []
    for nanny in list(cluster.workers.values()):
        with contextlib.suppress(psutil.Error, AttributeError, TypeError):
            worker = psutil.Process(nanny.pid)
            found += [*worker.children(recursive=True), worker]
    return found


def _distrust(error: BaseException | None) -> str:
    """What TLS said, of which an error may be the consequence; else nothing."""
    while error is not None:
        if isinstance(error, ssl.SSLError) or "SSL" in str(error):
            return str(error)
        error = error.__cause__ or error.__context__
    return ""


def _restore_environment(before: dict[str, str]) -> None:
    for name in os.environ.keys() - before.keys():
        del os.environ[name]
    os.environ.update(before)


def _say(text: str) -> None:
    print(f"penumbra: {text}", file=sys.stderr)


# ---------------------------------------------------------------- a run


_SUSPECT = object()
"""Instead of an outcome: workers died of this task, or of one that shared a worker with it"""


@dataclass
class _Flight:
    """A task that a scheduler has, and others of the same content."""

    tasks: list[Task]
    future: Any


class _Run:
    def __init__(
        self, function: Callable[[Any], Any], first: Task, pending: Iterator[Task], pool: _Pool
    ) -> None:
        self.function, self.pool = function, pool
        self._pending = pending
        self._again: deque[list[Task]] = deque([[first]])
        self._suspects: deque[list[Task]] = deque()
        self._alone = False
        self._deaths: dict[str, int] = {}
        self._flights: dict[str, _Flight] = {}
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._versions = versions_here()
        digest = content_key(*self._versions.values())[:8]
        self._prefix = f"{function.__module__}.{function.__qualname__}-{digest}-"

    def results(self) -> Iterator[tuple[Task, Any]]:
        while True:
            try:
                self._fill()
                if not self._flights:
                    return
                found = self._next()
            except _Gone:
                self._recover()
                continue
            yield from found

    def _fill(self) -> None:
        """Hand over what there is room for. Raises _Gone, and what `tasks` raises."""
        room = 1 if self._alone else IN_FLIGHT * self.pool.threads()
        while len(self._flights) < room:
            tasks = self._take()
            if tasks is None:
                return
            key = self._prefix + tasks[0].key
            if key in self._flights:
                self._flights[key].tasks += tasks
                continue
            flight = self._flights[key] = _Flight(tasks, None)
            flight.future = self.pool.ask(
                self.pool.client.submit,
                pickle.loads,
                pickle.dumps(_Call((self.function, tasks[0].argument, self._versions))),
                key=key,
            )
            flight.future.add_done_callback(self._done.put)

    def _take(self) -> list[Task] | None:
        if self._again:
            return self._again.popleft()
        task = next(self._pending, None)
        if task is not None:
            return [task]
        if not self._flights and self._suspects:
            self._alone = True
            self.pool.isolate()
            return self._suspects.popleft()
        return None

    def _next(self) -> list[tuple[Task, Any]]:
        """What got done next; nothing after POLL seconds without. Raises _Gone, function's."""
        try:
            future = self._done.get(timeout=POLL)
        except queue.Empty:
            if self.pool.is_gone():
                raise _Gone("the connection was lost") from None
            self.pool.threads()
            return []
        flight = self._flights.get(future.key)
        if flight is None or flight.future is not future:  # of a scheduler that is gone
            return []
        if future.status == "finished":
            try:
                outcome = self.pool.ask(future.result)
            except _Gone:
                raise
            except Exception as error:  # the worker that held it died: it was done once more
                outcome = self._failed(flight.tasks[0].key, error)
        elif future.status == "error":
            outcome = self._failed(flight.tasks[0].key, future.exception())
        else:
            raise _Gone("the scheduler forgot a task")
        del self._flights[future.key]
        if outcome is _SUSPECT:
            self._suspects.append(flight.tasks)
            return []
        return [(task, outcome) for task in flight.tasks]

    def _failed(self, key: str, error: BaseException) -> Any:
        """Lost, or _SUSPECT; raises what function raised."""
        if isinstance(error, _distributed().KilledWorker):
            deaths = self._deaths[key] = self._deaths.get(key, 0) + error.allowed_failures + 1
            if self._alone and deaths >= DEATHS:
                return Lost(f"the process that worked on it died, {deaths} times of {deaths}")
            return _SUSPECT
        if isinstance(error, ModuleNotFoundError):
            raise MissingWorkersError(
                f"a worker lacks the module {error.name}: install there what is installed here"
            ) from error
        raise error

    def _recover(self) -> None:
        """The scheduler was lost, and with it what it had."""
        _say("the scheduler was lost; what it had not done is handed over again")
        self._again.extendleft([flight.tasks for flight in self._flights.values()][::-1])
        self._flights = {}
        self.pool.connect()
