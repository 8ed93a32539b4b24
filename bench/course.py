"""python -m bench.course: how long the C core takes in a page, beside the same core in a program.

Prints the tables of docs/course.md. Each round measures everything once, a burst of frames by its
median; of the rounds the least counts, since whatever else a machine runs only adds.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import platform
import random
import shutil
import statistics
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

from penumbra.compare.run.library import Setting, WarmRenderer
from penumbra.compare.run.provenance import ROOT
from penumbra.course.page import asset, packed

SCENE = ROOT / "scenes" / "tp3.json"
MODULES = ("core", "mistakes")
WIDTH, HEIGHT = 600, 400
THREADS = (1, 2)
METHODS = [
    (sampler, estimator, n)
    for sampler, estimator in (("independent", "area"), ("sobol", "area"), (None, "exact"))
    for n in ((16, 64, 256) if sampler else (1,))
]
BURST = 5
"""Frames of which the median counts, after one that does not"""

PAGE = """
"use strict";
const scene = %s, size = { width: %d, height: %d };
const canvas = document.body.appendChild(document.createElement("canvas"));
const middle = (values) => values.sort((a, b) => a - b)[values.length >> 1];
let first = null;
coreReady.then((core) => core.render(scene, { ...size, nb_light_samples: 16 })).then((frame) => {
  paint(canvas, frame);
  requestAnimationFrame(() => setTimeout(() => { first = performance.now(); }));
});

/* Medians [ms]: what C took, and what the page waited for the frame. */
async function timed(core, settings, burst) {
  const c = [], whole = [];
  for (let i = 0; i <= burst; i++) {
    const start = performance.now();
    const frame = await core.render(scene, { ...size, ...settings, seed: i });
    if (i === 0) continue;
    whole.push(performance.now() - start);
    c.push(frame.milliseconds);
  }
  return [middle(c), middle(whole)];
}

/* Frames a second while something is dragged: each painted frame asks for the next. */
async function dragged(core, settings, move, frames) {
  const start = performance.now();
  for (let i = 0; i < frames; i++) {
    move(i / frames);
    paint(canvas, await core.render(scene, { ...size, ...settings }));
    await new Promise(requestAnimationFrame);
  }
  return 1000 * frames / (performance.now() - start);
}
"""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.course", description=__doc__)
    parser.add_argument("--rounds", type=int, default=15, metavar="R", help="[%(default)s]")
    rounds = parser.parse_args().rounds
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    _print_sizes()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = _write_page(Path(folder))
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"),
            args=["--no-sandbox", "--disable-renderer-backgrounding"],
        )
        print(f"Chromium {browser.version}, {rounds} rounds\n")
        _print_times(browser, page, rounds)
        print(f"\nload at the end {os.getloadavg()[0]:.1f}")
    return 0


def _write_page(folder: Path) -> Path:
    modules = "".join(
        f'<script type="text/plain" id="{name}-wasm">{packed(_module(name))}</script>'
        for name in MODULES
    )
    script = PAGE % (json.dumps(json.loads(SCENE.read_text())), WIDTH, HEIGHT)
    file = folder / "index.html"
    file.write_text(
        f'<!doctype html><meta charset="utf-8"><title>t</title><body>{modules}'
        f'<script type="text/plain" id="worker">{asset("worker.js")}</script>'
        f"<script>{asset('core.js')}{script}</script>"
    )
    return file


def _module(name: str) -> bytes:
    return (ROOT / "build" / "wasm" / f"{name}.wasm").read_bytes()


def _print_sizes() -> None:
    print("| module | bytes | gzip | in the page |\n| --- | ---: | ---: | ---: |")
    for name in MODULES:
        data = _module(name)
        zipped = len(gzip.compress(data, 9))
        print(f"| {name} | {len(data):,} | {zipped:,} | {len(packed(data)):,} |")
    print()


def _print_times(browser: Browser, page: Path, rounds: int) -> None:
    """Of frames, of the first one, and while dragging."""
    renderer = WarmRenderer(SCENE, WIDTH, HEIGHT)
    tab = browser.new_page()
    tab.goto(page.as_uri())
    for workers in THREADS:
        tab.evaluate(
            f"Core.open({{ workers: {workers} }}).then((c) => {{ window.core{workers} = c; }})"
        )
    times: defaultdict[tuple[object, ...], list[float]] = defaultdict(list)
    tasks = [(method, threads) for method in METHODS for threads in THREADS]
    for _ in range(rounds):
        random.shuffle(tasks)
        for method, threads in tasks:
            times[method, threads, "native"].append(_native(renderer, *method, threads))
            in_c, whole = _in_page(tab, *method, threads)
            times[method, threads, "c"].append(in_c)
            times[method, threads, "page"].append(whole)
        times["first",].append(_first_frame(browser, page))
        for what, settings, move in DRAGS:
            call = f"dragged(core2, {settings}, (t) => {{ {move} }}, 60)"
            times[what,].append(tab.evaluate(call))
    least = {key: min(values) for key, values in times.items()}
    print("| [ms] | page, 1 worker | page, 2 workers | of it C | program, 1 thread | 2 threads |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for method in METHODS:
        sampler, estimator, n = method
        name = f"`{sampler}`, N = {n}" if sampler else f"`{estimator}`"
        figures = [least[method, t, what] for t, what in
                   ((1, "page"), (2, "page"), (2, "c"), (1, "native"), (2, "native"))]  # fmt: skip
        print(f"| {name} | " + " | ".join(f"{figure:.1f}" for figure in figures) + " |")
    print(
        f"\nfirst frame after navigation: {least['first',]:.0f} ms, "
        f"median {statistics.median(times['first',]):.0f} ms"
    )
    for what, _settings, _move in DRAGS:
        print(f"{what}: {max(times[what,]):.0f} frames a second")


DRAGS = (
    ("light dragged, `independent`, N = 16", "{ nb_light_samples: 16 }",
     "scene.quad_lights[0].position[0] = 1 + t;"),
    ("camera dragged, `independent`, N = 16", "{ nb_light_samples: 16 }",
     "scene.camera.position[1] = t;"),
)  # fmt: skip


def _native(
    renderer: WarmRenderer, sampler: str | None, estimator: str, n: int, threads: int
) -> float:
    setting = Setting(sampler, estimator, n, threads)
    return 1e3 * statistics.median(renderer.render(setting, i) for i in range(BURST + 1))


def _in_page(
    tab: Page, sampler: str | None, estimator: str, n: int, workers: int
) -> tuple[float, float]:
    settings = {"sampler": sampler or "independent", "estimator": estimator, "nb_light_samples": n}
    in_c, whole = tab.evaluate(f"timed(core{workers}, {json.dumps(settings)}, {BURST})")
    return float(in_c), float(whole)


def _first_frame(browser: Browser, page: Path) -> float:
    """On the screen, after navigation began [ms]."""
    tab = browser.new_page()
    tab.goto(page.as_uri())
    tab.wait_for_function("first !== null")
    found = float(tab.evaluate("first"))
    tab.close()
    return found


if __name__ == "__main__":
    sys.exit(main())
