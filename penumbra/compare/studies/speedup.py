"""How much faster the C renderer is with more threads."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from penumbra.compare.measure.image import read_image
from penumbra.compare.run import provenance
from penumbra.compare.run.output import write_csv, write_json
from penumbra.compare.run.renderers import Job, penumbra_renderer
from penumbra.compare.scene import read_scene

LIGHT_SAMPLES = 1024
REPEATS = 5
COLUMNS = ("threads", "seconds", "repeat")


def default_threads(cores: int) -> tuple[int, ...]:
    """1, 2, 4, ... and the number of cores.

    >>> default_threads(6)
    (1, 2, 4, 6)
    """
    powers = [2**i for i in range(cores.bit_length()) if 2**i <= cores]
    return tuple(sorted({*powers, cores}))


def speedup(
    scene_file: Path,
    out: Path,
    threads: Sequence[int] = (),
    repeats: int = REPEATS,
    light_samples: int = LIGHT_SAMPLES,
) -> dict[str, Any]:
    """Time the scene, at its own size, on each number of threads; write out and its .json.

    out: .csv, a row a run (threads, seconds, repeat); seconds are the header's renderSeconds,
    the wall time of the rendering loop without start-up and writing. The JSON holds for each
    number of threads the median and range of seconds, and the speed-up, the ratio of the
    medians. Numbers of threads take turns within each repeat, so that a machine that slows
    down slows all of them; one untimed run goes first. threads: all of default_threads if
    empty; 1 is always measured.

    Raises SceneError, RendererError, MissingProgramError, ImageError, OSError.
    """
    scene = read_scene(scene_file)
    counts = sorted({1, *(threads or default_threads(provenance.cores()))})
    renderer = penumbra_renderer()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        image = Path(folder) / "speedup.exr"

        def seconds(count: int) -> float:
            job = Job(scene_file, scene.width, scene.height, light_samples, 1, 1, count)
            renderer.run(job, image)
            return float(read_image(image).attributes["renderSeconds"])

        turns = [(repeat, count) for repeat in range(1, repeats + 1) for count in counts]
        seconds(counts[-1])
        for repeat, count in tqdm(turns, desc="speed-up", disable=None, file=sys.stderr):
            rows.append({"threads": count, "seconds": seconds(count), "repeat": repeat})
    result = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "width": scene.width,
        "height": scene.height,
        "light_samples": light_samples,
        "repeats": repeats,
        **provenance.origin(),
        "rows": summary(rows),
    }
    write_csv(out, COLUMNS, rows)
    write_json(out.with_suffix(".json"), result)
    return result


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per number of threads: median, smallest and largest seconds, and the speed-up.

    >>> rows = [{"threads": t, "seconds": 6 / t + r, "repeat": r} for t in (1, 2) for r in (0, 1)]
    >>> summary(rows)[1]
    {'threads': 2, 'seconds': 3.5, 'low': 3.0, 'high': 4.0, 'speedup': 1.8571428571428572}
    """
    times: dict[int, list[float]] = {}
    for row in rows:
        times.setdefault(row["threads"], []).append(row["seconds"])
    one = float(np.median(times[1]))
    return [
        {
            "threads": threads,
            "seconds": float(np.median(seconds)),
            "low": min(seconds),
            "high": max(seconds),
            "speedup": one / float(np.median(seconds)),
        }
        for threads, seconds in sorted(times.items())
    ]
