"""The catalogue of mistakes: what is foretold of each is what each does to a picture."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.check import mistaken, quadrature
from penumbra.compare.check.catalogue import MODULES, RIGHT, STUDENTS, Variant, catalogue
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.mistaken import choice_id, render
from penumbra.compare.check.moments import Moments
from penumbra.compare.check.prediction import Surroundings, _sample, predict, surface_lights
from penumbra.compare.check.quadrature import Sites
from penumbra.compare.check.view import _sites_at, _slope
from penumbra.compare.exact.receivers import camera_hits
from penumbra.compare.scene import read_scene
from tests.conftest import ROOT, built

WIDTH, HEIGHT = 27, 18
LIGHT_GRID = 24
SEEDS = 24
SIGMAS = 4.5
MEAN, VARIANCE = 0.01, 0.06
"""Relative error of a law, over all sites: clamps of what is not normal, and the light's grid"""
GRID = 4e-3
"""Of one site's mean: its share of the light, counted on 24 x 24 places"""
ROUGH = {"running_half": 0.2, "running_half_from_first": 0.2, "wrap": 0.4}
"""Of the variance: unequal weights at a clamp, taken for fewer equal ones; and
what is nearly 1, which wraps or does not by a hair, taken for normal"""
EDGE = 2e-4
"""Of the variance of an average over the pixel: that light and shadow differ within it"""
STEEP = ("any_visible", "all_visible")
"""What varies within a pixel of the penumbra by more than the light does; a law of M > 1 has its
mean"""
WIDE = {"position": [0, 0, 0], "look_at": [0, -0.72, 3], "up": [0, 1, 0], "fov_y_deg": 26}
NEAR = {"position": [0, 0, 0], "look_at": [0, -2, 1.8], "up": [0, 1, 0], "fov_y_deg": 5}
"""On the penumbra, in pixels as small as the lab's, so that light is even in each"""
WHITE = {"v": [0, 0, 2], "color": [1, 1, 1]}
QUADS = [
    {"name": "left", "position": [2, 10, 2], "u": [-2, 0, 0], "power": 25} | WHITE,
    {"name": "right", "position": [-1, 9, 2], "u": [-1, 0, 0], "power": 20} | WHITE,
]
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "tp3": ("tp3", {}),
    "sheared": ("tp3_sheared", {}),
    "two_lights": ("tp3", {"quad_lights": QUADS}),
    "disk": ("tp3_disk", {}),
    "sphere": ("tp3_sphere", {}),
}
PAIRS: list[dict[str, Any]] = [
    {"domain": "diagonal", "average": "n_no_effect"},
    {"domain": "about_corner", "weight": "no_light_cosine"},
    {"visibility": "offset_0_3", "scale": "area_omitted"},
    {"visibility": "lost_0_3", "clamp": "per_light_sample"},
    {"visibility": "apart", "average": "divided_by_n_plus_one"},
    {"visibility": "to_corner", "weight": "pdf_times_cos"},
    {"weight": "cos_of_cos_both", "average": "running_half"},
    {"average": "any_visible", "output": "ambient_0_1"},
    {"average": "break_first", "output": "fog_0_02"},
    {"lights": "only_last_light", "average": "extra_sample"},
    {"scale": "light_twice", "output": "wrap"},
    {"colour": "flat_colour_squared", "clamp": "per_pixel_sample"},
]


@dataclass(frozen=True)
class Stage:
    """A scene and the pixels of a picture of it that receive light."""

    file: Path
    around: Surroundings
    row: np.ndarray
    column: np.ndarray
    channel: np.ndarray


def stage(file: Path) -> Stage:
    scene = read_scene(file)
    grid = Grid(scene.camera.fov_y_deg)
    row, column = (a.ravel() for a in np.mgrid[0:HEIGHT, 0:WIDTH])
    sites = _sites_at(scene, grid, column.astype(float), row.astype(float), WIDTH, HEIGHT)
    distance = np.linalg.norm(sites.receivers.point - np.asarray(scene.camera.position), axis=1)
    met = (sites.receivers.object_id >= 0) & (distance < scene.ray_max_distance * 0.9)
    sites, row, column, distance = sites[met], row[met], column[met], distance[met]
    brdf = np.array([thing.brdf for thing in scene.objects])[sites.receivers.object_id]
    radiance = [np.asarray(scene.lights[i].radiance) for i in surface_lights(scene)]  # type: ignore[union-attr]
    channel = np.argmax(brdf * sum(radiance), axis=1)
    around = Surroundings(
        tuple(Moments(file, i, sites, LIGHT_GRID) for i in surface_lights(scene)),
        scene,
        brdf[np.arange(len(row)), channel],
        tuple(r[channel] for r in radiance),
        np.asarray(scene.background_radiance)[channel],
        distance,
        _slope(scene, file, sites),
    )
    return Stage(file, around, row, column, channel)


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """stages(name, m): a scene of SCENES as it is looked at for m pixel samples. Pictures are so
    small that a second thread would cost more than it brings."""
    threads = ctypes.CDLL("libgomp.so.1")
    before = threads.omp_get_max_threads()
    threads.omp_set_num_threads(1)
    folder = tmp_path_factory.mktemp("scenes")

    @cache
    def look(name: str, m: int) -> Stage:
        base, changes = SCENES[name]
        scene = json.loads((ROOT / "scenes" / f"{base}.json").read_text())
        scene |= {**changes, "camera": WIDE if m == 1 else NEAR}
        file = folder / f"{name}_{m}.json"
        file.write_text(json.dumps(scene))
        return stage(file)

    yield look
    threads.omp_set_num_threads(before)


def values(at: Stage, variant: Variant, n: int, m: int, seeds: int = SEEDS) -> np.ndarray:
    """(seeds, sites): what is written, but for the rounding to 8 bits."""
    pictures = [
        render(at.file, variant, (HEIGHT, WIDTH), n, m, seed)[at.row, at.column, at.channel]
        for seed in range(seeds)
    ]
    found = np.array(pictures, dtype=float)
    if variant["output"].field("wrap"):
        return found % (256 / 255)
    return np.clip(found, 0, 1)


def disagreements(at: Stage, variant: Variant, n: int, m: int) -> list[str]:
    """How the pictures of some seeds differ from what is foretold: in sites' means, the sum of all
    sites, and the sum of their variances, whose errors the seeds themselves tell."""
    x, law = values(at, variant, n, m), predict(at.around, variant, n, m, jittered=m > 1)
    kept = np.ones(x.shape[1], dtype=bool)
    for moments in at.around.moments:  # one place of the light: hidden, or not, but at an edge
        p, _, _, fixed = _sample(moments, variant)
        kept &= (p < 1e-3) | (p > 1 - 1e-3) | (not fixed)
    x, mean, variance = x[:, kept], law.mean[kept], law.variance[kept]
    found, scatter = x.mean(axis=0), x.var(axis=0, ddof=1)
    root = np.sqrt(SEEDS)

    error = np.maximum(variance, scatter) / SEEDS + (GRID * mean) ** 2 + 1e-8
    misfit = float(((found - mean) ** 2 / error).mean())
    shared = law.correlation != "NONE"
    bias = (x - mean).sum(axis=1)
    even = 1 / (variance + 1e-4)  # so that the penumbra does not drown the rest
    noise = ((x - found) ** 2 @ even) * SEEDS / (SEEDS - 1)
    foretold = float(variance @ even)
    said = []
    if misfit > (4 if shared else 1 + SIGMAS * np.sqrt(4 / x.shape[1]) + 0.2 * (m > 1)):
        said.append(f"sites' means: chi-square {misfit:.2f} each")
    if abs(bias.mean()) > MEAN * mean.sum() + SIGMAS * bias.std(ddof=1) / root + 1e-4 * len(mean):
        said.append(f"mean {found.mean():.4f}, foretold {mean.mean():.4f}")
    rough = ROUGH.get(variant.average, ROUGH.get(variant.output, VARIANCE))
    allowed = rough * foretold + SIGMAS * noise.std(ddof=1) / root
    allowed += (EDGE if m > 1 else 1e-5) * even.sum()
    if m > 1 and variant.average in STEEP:
        allowed = np.inf
    if abs(noise.mean() - foretold) > allowed:
        said.append(f"variance {noise.mean() / max(foretold, 1e-9):.3f} of what is foretold")
    return [f"{variant}, N = {n}, M = {m}: {what}" for what in said]


def all_variants() -> list[Variant]:
    """Right, each choice alone, and the pairs."""
    ones = [Variant().replaced(c) for c in catalogue().choices.values() if c.name != RIGHT]
    return [Variant(), *ones, *(Variant(**pair) for pair in PAIRS)]


COUNTS = [(n, m) for m in (1, 4) for n in (1, 4, 16)]
CASES = [("tp3", n, m) for n, m in COUNTS]
CASES += [(scene, n, m) for scene in ("sheared", "two_lights") for n, m in COUNTS if n * m <= 4]


@pytest.mark.parametrize("scene, n, m", CASES)
def test_what_is_foretold_of_each_choice_is_what_it_does(
    stages: Any, scene: str, n: int, m: int
) -> None:
    at = stages(scene, m)
    assert len(at.row) > 300
    found = [line for v in all_variants() for line in disagreements(at, v, n, m)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("scene", ["disk", "sphere"])
def test_other_lights_too(stages: Any, scene: str) -> None:
    at = stages(scene, 1)
    some = ["std", "diagonal", "no_light_cosine", "offset_0_3", "running_half", "light_twice"]
    variants = [Variant().replaced(c) for c in catalogue().choices.values() if c.name in some]
    found = [line for v in variants for line in disagreements(at, v, 4, 1)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("choice, same", [("same_everywhere", (1, 1)), ("same_along_rows", (0, 1))])
def test_shared_random_numbers_make_neighbours_alike(
    stages: Any, choice: str, same: tuple[int, int]
) -> None:
    """Where the light is seen in part, noise of pixels side by side, and one above the other."""
    at = stages("tp3", 4)
    x = values(at, Variant(generator=choice), 1, 1, seeds=32)
    noise = (x - x.mean(axis=0)).reshape(len(x), HEIGHT, WIDTH)
    for axis, alike in zip((1, 2), same, strict=True):
        one, two = (np.take(noise, range(i, noise.shape[axis] - 1 + i), axis) for i in (0, 1))
        correlation = float((one * two).sum() / np.sqrt((one**2).sum() * (two**2).sum()))
        assert correlation > 0.75 if alike else abs(correlation) < 0.25


def test_the_catalogue_of_python_is_that_of_c() -> None:
    table = catalogue()
    assert len(table.mistakes) >= 30
    for mistake in table.mistakes.values():
        texts = [value for key, value in vars(mistake).items() if key != "seen"]
        assert all(texts) and mistake.look.endswith("?"), mistake.name
        assert 0 <= mistake.seen <= STUDENTS, mistake.name
    under = {choice.mistake for choice in table.choices.values()} - {""}
    assert under == set(table.mistakes)
    numbers = {choice_id(c.module, c.name) for c in table.choices.values()}
    assert numbers == set(range(len(table.choices)))


@pytest.mark.parametrize("product", ["bin/penumbra-render", "lib/libpenumbra.so"])
def test_the_renderer_knows_no_mistake(product: str) -> None:
    for options in ([], ["-D"]):
        done = subprocess.run(["nm", *options, built(product)], capture_output=True, text=True)
        assert "mistakes_" not in done.stdout


ADDED = """
import sys
from pathlib import Path
import ctypes
from penumbra.compare.check import catalogue, mistaken
folder = Path(sys.argv[1])
catalogue.FILE, mistaken.LIBRARY = folder / "catalogue.def", folder / "libmistakes.so"
from tests import test_mistakes as test
ctypes.CDLL("libgomp.so.1").omp_set_num_threads(1)
variant = catalogue.Variant(weight="half_lambert")
assert variant.mistakes == ("half_lambert",)
at = test.stage(test.ROOT / "scenes" / "tp3.json")
right = test.predict(at.around, catalogue.Variant(), 4, 1, False).mean
assert abs(test.predict(at.around, variant, 4, 1, False).mean - right).mean() > 0.005
assert not test.disagreements(at, variant, 4, 1)
"""


def test_the_page_s_example_is_foretold_and_rendered_alike(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "adding-a-mistake.md").read_text()
    (entry,) = re.findall(r"```c\n(.*?)```", page, re.S)
    source = ROOT / "c_renderer" / "mistakes"
    for file in source.glob("*.[ch]"):
        (tmp_path / file.name).write_text(file.read_text())
    (tmp_path / "catalogue.def").write_text((source / "catalogue.def").read_text() + entry)
    core = ROOT / "c_renderer" / "src"
    command = ["gcc", "-std=c17", "-O1", "-fopenmp", "-fPIC", "-shared", "-DPENUMBRA_FLOAT64"]
    command += [
        f"-I{core}",
        *map(str, tmp_path.glob("*.c")),
        *map(str, (core / "core").glob("*.c")),
        str(core / "io" / "scene_json.c"),
    ]
    subprocess.run(
        [*command, "-ljansson", "-lm", "-o", str(tmp_path / "libmistakes.so")], check=True
    )
    subprocess.run([sys.executable, "-c", ADDED, str(tmp_path)], check=True, cwd=ROOT)


@pytest.mark.parametrize("name", ["tp3", "check_low", "tp3_triangle", "tp3_sphere"])
def test_moments_without_the_library_are_the_same(name: str) -> None:
    """Two texts, of the same points: but for two sites where a ray grazes and rounding decides."""
    file = ROOT / "scenes" / f"{name}.json"
    scene = read_scene(file)
    rng = np.random.default_rng(1)
    column, row = rng.uniform(0, 600, 600), rng.uniform(0, 400, 600)
    hits = camera_hits(scene, column, row, 600, 400)
    hits = hits[hits.object_id >= 0]
    step = np.full((len(hits), 3), 1e-3)
    sites = Sites(hits, step, -step)
    choices = {m: [c.name for c in catalogue().of_module(m)] for m in MODULES}
    for domain in choices["domain"]:
        few = domain != RIGHT
        rays = ["std", "none"] if few else choices["visibility"]
        weights = ["std", "no_light_cosine"] if few else choices["weight"]
        found = mistaken.moments(file, 0, sites, domain, rays, weights, 6)
        again = quadrature.moments(scene, 0, sites, domain, rays, weights, 6)
        for one, other in zip(found, again, strict=True):
            scale = np.abs(one).max(axis=-1, keepdims=True) + 1e-12
            apart = np.abs(one - other) > 1e-5 * scale
            assert apart.reshape(-1, len(hits)).any(axis=0).sum() <= 2, domain
    s, t = rng.uniform(-1, 2, (2, 7))
    places = mistaken.places(file, 0, sites, s, t), quadrature.places(scene, 0, sites, s, t)
    assert (np.abs(places[0] - places[1]) > 1e-5 * places[0].max()).sum() <= 2
