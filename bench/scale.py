"""python -m bench.scale: what a task and its handing over cost, and what many machines would do.

Task times and the scheduler's cost are measured on this machine; what 10 and more machines would do
is a simulation with them, and docs/scale.md calls it so.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import itertools
import math
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

from penumbra.compare.check.calibration import CHUNK, Bench, by_rays, few
from penumbra.compare.check.checking import check
from penumbra.compare.check.specimens import Specimen
from penumbra.compare.run import provenance
from penumbra.compare.run.output import write_json, write_whole
from penumbra.compare.run.tasks import IN_FLIGHT, Task, run_tasks
from penumbra.compare.scene import read_scene

BEGIN = "<!-- measured by `python -m bench.scale`: begin -->"
END = "<!-- measured by `python -m bench.scale`: end -->"
EMPTY = 2000
"""Tasks that do nothing, to measure what one costs to hand over"""
HEAVY = 200
"""and of a picture's size"""
PICTURE_BYTES = 300_000
"""About a 600x400 PNG of a soft shadow"""
SUBMISSIONS = 12
"""Pictures that are checked, each alone, to know what one takes"""
ROUNDS = 3
MACHINES = (1, 10, 100, 1000)
COUNTS = (300, 3000, 30_000, 300_000)
HOUR = 3600.0


# ---------------------------------------------------------------- what is measured


def nothing(argument: bytes) -> None:
    """A task."""


def handing_over(count: int, size: int, jobs: int) -> dict[str, float]:
    """Seconds of `count` empty tasks of `size` bytes each, of which the first is not counted.

    start: until the first is done, which starts the workers. wall: of each of the others. serial:
    of a processor, by client and scheduler, which are this process, for each: one after another,
    however many workers there are.
    """
    payload = os.urandom(size)
    tasks = (Task(f"{i}", payload) for i in range(count + 1))
    with contextlib.closing(run_tasks(nothing, tasks, jobs=jobs)) as done:
        start = time.perf_counter()
        next(done)
        first, own = time.perf_counter(), time.process_time()
        for _ in itertools.islice(done, count):
            pass
        wall, serial = time.perf_counter() - first, time.process_time() - own
    return {"start": first - start, "wall": wall / count, "serial": serial / count}


def checked(specimen: Specimen) -> float:
    """A task: seconds of `penumbra check` on a specimen's last picture, as PNG."""
    with tempfile.TemporaryDirectory() as folder:
        scene = read_scene(specimen.scene_file)
        picture = specimen.pictures(scene, Path(folder))[-1]
        file = Path(folder, "picture.png")
        levels = np.clip(picture.values * 255, 0, 255).astype(np.uint8)
        PIL.Image.fromarray(levels).save(file)
        start = time.perf_counter()
        check([file], specimen.scene_file, *specimen.counts[-1])
        return time.perf_counter() - start


def calibrated(chunk: Sequence[Specimen]) -> float:
    """A task: seconds of what `penumbra calibrate` makes one of."""
    start = time.perf_counter()
    bench = Bench()
    with tempfile.TemporaryDirectory() as folder:
        for specimen in chunk:
            bench.judge(specimen, Path(folder))
    return time.perf_counter() - start


@dataclass(frozen=True)
class Work:
    seconds: tuple[float, ...]
    """of each task"""
    wall: float
    """of all [s]"""

    @property
    def mean(self) -> float:
        return statistics.fmean(self.seconds)


def working(function: Callable[[Any], float], arguments: Sequence[Any], jobs: int) -> Work:
    """All arguments as tasks on this machine, each core busy. The first of each worker, which load
    what there is to load, do not count."""
    tasks = [Task(f"{i}", argument) for i, argument in enumerate([*arguments[:jobs], *arguments])]
    with contextlib.closing(run_tasks(function, tasks, jobs=jobs)) as done:
        for _ in itertools.islice(done, jobs):
            pass
        start = time.perf_counter()
        seconds = [float(took) for _, took in itertools.islice(done, len(arguments))]
        return Work(tuple(seconds), time.perf_counter() - start)


# ---------------------------------------------------------------- what follows


def simulated(
    seconds: Sequence[float], count: int, workers: int, serial: float, start: float
) -> float:
    """How long `count` tasks take [s], whose times are drawn from `seconds`.

    Client and scheduler are one server: it hands over a task, or takes what came of it, in half of
    `serial` each. A worker has IN_FLIGHT tasks at most, and does one after another. Nothing else
    costs time: no network, no disk, no worker that is slower than the others.

    >>> simulated([1.0], 4, 2, 0.0, 10.0)
    12.0
    >>> simulated([0.001], 1000, 100, 0.01, 0.0) >= 10.0  # as fast as the scheduler hands over
    True
    """
    drawn = np.random.default_rng(0).choice(np.asarray(seconds, dtype=float), count)
    step, server = serial / 2, start
    free = [start] * workers
    given = done = 0
    ends: list[tuple[float, int]] = []

    def give(worker: int) -> None:
        nonlocal server, given
        server += step
        free[worker] = max(free[worker], server) + float(drawn[given])
        heapq.heappush(ends, (free[worker], worker))
        given += 1

    for k in range(min(count, IN_FLIGHT * workers)):
        give(k % workers)
    while done < count:
        end, worker = heapq.heappop(ends)
        server = max(server, end) + step
        done += 1
        if given < count:
            give(worker)
    return server


def in_an_hour(mean: float, workers: int, serial: float) -> float:
    """Tasks, once it is going: as many as the workers can do or the scheduler can hand over."""
    return HOUR * min(workers / mean, 1 / serial if serial else math.inf)


def measured() -> dict[str, Any]:
    jobs = provenance.cores()
    empty = [handing_over(EMPTY, 0, jobs) for _ in range(ROUNDS)]
    heavy = [handing_over(HEAVY, PICTURE_BYTES, jobs) for _ in range(ROUNDS)]
    alone = [s for s in few() if s.counts[-1][1] == 1]
    ordered = by_rays(few())
    kinds = {
        "check": working(checked, alone[:: len(alone) // SUBMISSIONS], jobs),
        "calibrate": working(
            calibrated, [ordered[i : i + CHUNK] for i in range(0, len(ordered), CHUNK)], jobs
        ),
    }

    def median(rounds: list[dict[str, float]], what: str) -> float:
        return statistics.median(one[what] for one in rounds)

    start, light = median(empty, "start"), median(empty, "serial")
    serial = {"check": median(heavy, "serial"), "calibrate": light}
    return {
        "jobs": jobs,
        "start": start,
        "wall": {"empty": median(empty, "wall"), "picture": median(heavy, "wall")},
        "serial": {"empty": light, "picture": median(heavy, "serial")},
        "tasks": {
            kind: {
                "seconds": list(work.seconds),
                "mean": work.mean,
                "saturates_at": work.mean / serial[kind],
                "measured_in_an_hour": HOUR * len(work.seconds) / work.wall,
                "in_an_hour": [in_an_hour(work.mean, m * jobs, serial[kind]) for m in MACHINES],
                "whole": [
                    [simulated(work.seconds, count, m * jobs, serial[kind], start)
                     for m in MACHINES]
                    for count in COUNTS
                ],
            }
            for kind, work in kinds.items()
        },
        "load": os.getloadavg()[0],
        **provenance.origin(),
    }  # fmt: skip


# ---------------------------------------------------------------- tables


def duration(seconds: float) -> str:
    """
    >>> duration(0.0012), duration(12.34), duration(600), duration(90_000)
    ('1.2 ms', '12 s', '10 min', '25 h')
    """
    if seconds < 1:
        return f"{1e3 * seconds:.2g} ms"
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"


def tables(result: dict[str, Any]) -> str:
    """Markdown."""
    machine, wall, serial = result["machine"], result["wall"], result["serial"]
    text = [
        f"{machine['processor']}, {result['jobs']} cores, load average {result['load']:.1f} at the "
        f"end; medians of {ROUNDS} rounds; Dask {result['versions']['distributed']}.",
        "",
        "| measured | |",
        "|---|---:|",
        f"| embedded cluster, until the first task is done | {duration(result['start'])} |",
        f"| an empty task, wall time with {result['jobs']} workers | {duration(wall['empty'])} |",
        f"| of it client and scheduler, processor | {duration(serial['empty'])} |",
        f"| a task with {PICTURE_BYTES // 1000} kB, wall time | {duration(wall['picture'])} |",
        f"| of it client and scheduler, processor | {duration(serial['picture'])} |",
    ]
    for kind, found in result["tasks"].items():
        low, high = min(found["seconds"]), max(found["seconds"])
        text.append(
            f"| a task of `{kind}`, mean of {len(found['seconds'])} ({duration(low)} to "
            f"{duration(high)}) | {duration(found['mean'])} |"
        )
    heads = " | ".join(f"{m:,} machine{'s' if m > 1 else ''}" for m in MACHINES)
    for kind, found in result["tasks"].items():
        text += [
            "",
            f"`{kind}`: {found['measured_in_an_hour']:,.0f} in an hour on this machine, measured. "
            "Simulated, with the scheduler busy all the time from "
            f"{found['saturates_at']:,.0f} workers on:",
            "",
            f"| tasks | {heads} |",
            "|---" + "|---:" * len(MACHINES) + "|",
            "| in an hour | " + " | ".join(f"{n:,.0f}" for n in found["in_an_hour"]) + " |",
        ]
        text += [
            f"| {count:,} | " + " | ".join(duration(s) for s in row) + " |"
            for count, row in zip(COUNTS, found["whole"], strict=True)
        ]
    return "\n".join(text)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("build/scale.json"))
    parser.add_argument("--page", type=Path, help="page with markers, whose tables are replaced")
    options = parser.parse_args(arguments)
    result = measured()
    result["versions"]["distributed"] = metadata.version("distributed")
    write_json(options.out, result)
    if options.page:
        before, rest = options.page.read_text().split(BEGIN)
        after = rest.split(END)[1]
        text = f"{before}{BEGIN}\n\n{tables(result)}\n\n{END}{after}"
        write_whole(options.page, lambda part: part.write_text(text))
    print(tables(result))
    print(f"written: {options.out}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
