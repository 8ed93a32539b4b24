"""python -m bench: measure, and write CSV, JSON and the tables of docs/performance.md."""

from __future__ import annotations

import argparse
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from bench.page import PageError, tables, write_page
from bench.results import summary
from bench.rounds import COLUMNS, Measured, Plan, measure, use_cores
from bench.systems import NotBuilt, SystemFailed
from penumbra.blender_ref import CyclesError
from penumbra.compare.measure.image import ImageError
from penumbra.compare.run import provenance
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.scene import SceneError, read_scene

PEAK_COLUMNS = ("round", "threads", "fma_per_second", "divisions_per_second")
QUIET = 0.3
"""Load average of a machine at rest, about; above it the times are not to be trusted."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done, 2 usage, bad input or unwritable output, 3 not built, 130 stopped."""
    options = _parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return _bench(options)
    except KeyboardInterrupt:
        print("bench: stopped; nothing is written", file=sys.stderr)
        return 130
    except NotBuilt as error:
        code, said = error.exit_code, str(error)
    except (SceneError, ImageError, CyclesError, SystemFailed, PageError, OSError) as error:
        code, said = 2, str(error)
    print(f"bench: {said}", file=sys.stderr)
    return code


def _bench(options: argparse.Namespace) -> int:
    scene = read_scene(options.scene)
    plan = _plan(options, scene.width, scene.height)
    use_cores(plan.threads)
    load, stolen, start = os.getloadavg()[0], _stolen_seconds(), time.perf_counter()
    if load > QUIET:
        print(
            f"bench: other work is running (load {load:.1f}): times will be long", file=sys.stderr
        )
    measured = measure(plan)
    elapsed = time.perf_counter() - start
    result: dict[str, Any] = {
        **summary(measured, plan, scene),
        "machine": provenance.machine(),
        "versions": _versions(measured),
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "load": load,
        "stolen": (_stolen_seconds() - stolen) / (os.cpu_count() or 1) / elapsed,
        "minutes": elapsed / 60,
        "command": provenance.command_line(),
    }
    out: Path = options.out
    write_csv(out / "frames.csv", COLUMNS, measured.frames)
    write_csv(out / "peak.csv", PEAK_COLUMNS, measured.peaks)
    write_json(out / "bench.json", result)
    if options.page:
        write_page(options.page, result)
    print(tables(result))
    print(f"written: {out}/frames.csv, peak.csv and bench.json", file=sys.stderr)
    return 0


def _plan(options: argparse.Namespace, width: int, height: int) -> Plan:
    given = {f.name: getattr(options, f.name, None) for f in fields(Plan)}
    chosen = {name: value for name, value in given.items() if value is not None}
    chosen |= {
        "scene_file": options.scene,
        "width": options.width or width,
        "height": options.height or height,
        "threads": min(options.threads, provenance.cores()),
        "cycles": "cycles" not in options.without,
        "embree": "embree" not in options.without,
    }
    if "mitsuba" in options.without:
        chosen["mitsuba_python"] = None
    return Plan(**chosen)


def _stolen_seconds() -> float:
    """Time of all cores together that a virtual machine's host gave to others; 0 if it is none."""
    try:
        words = Path("/proc/stat").read_text().split(maxsplit=9)
    except OSError:
        return 0
    return int(words[8]) / os.sysconf("SC_CLK_TCK")


def _versions(measured: Measured) -> dict[str, str]:
    found = {"penumbra": provenance.VERSION, "python": platform.python_version()}
    try:
        done = subprocess.run(["gcc", "-dumpfullversion"], capture_output=True, text=True)
        found["gcc"] = done.stdout.strip()
    except OSError:
        pass  # built elsewhere
    return found | measured.versions


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("scene", type=Path, help="scenes/*.json")
    parser.add_argument("-o", "--out", type=Path, default=Path("build/bench"), help="[build/bench]")
    parser.add_argument("--page", type=Path, help="page with markers, whose tables are replaced")
    parser.add_argument("--rounds", type=_positive, help="medians are of so many [5]")
    parser.add_argument("--threads", type=_positive, default=2, help="and as many cores [2]")
    parser.add_argument("--width", type=_positive, help="pixels [the scene's]")
    parser.add_argument("--height", type=_positive, help="pixels [the scene's]")
    parser.add_argument("--compared", type=_counts, help="N at which all are compared [16,64,256]")
    parser.add_argument("--fitted", type=_counts, help="N for error against time [4,...,4096]")
    parser.add_argument("--sizes", type=_sizes, help="image sizes, as 150x100,300x200,...")
    parser.add_argument(
        "--without",
        action="append",
        choices=("cycles", "embree", "mitsuba"),
        default=[],
        help="leave out",
    )
    parser.add_argument(
        "--mitsuba-python", metavar="PYTHON", help="the interpreter that has Mitsuba [this one]"
    )
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def _counts(text: str) -> tuple[int, ...]:
    return tuple(sorted({_positive(word) for word in text.split(",")}))


def _sizes(text: str) -> tuple[tuple[int, int], ...]:
    sizes = [tuple(_positive(word) for word in size.split("x")) for size in text.split(",")]
    if any(len(size) != 2 for size in sizes):
        raise argparse.ArgumentTypeError(f'"{text}" is not a list like 150x100,300x200')
    return tuple((size[0], size[1]) for size in sizes)


if __name__ == "__main__":
    sys.exit(main())
