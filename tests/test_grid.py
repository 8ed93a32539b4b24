"""The fitted grid is the one that the picture was made with, in each scene and file format."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from penumbra.compare.check.grid import Grid, fit_grid
from penumbra.compare.check.picture import Picture, read_picture
from penumbra.compare.exact.image import shade
from penumbra.compare.scene import Scene, read_scene

ROOT = Path(__file__).resolve().parent.parent
SCENES = ("tp3", "tp3_statement", "tp3_sheared", "tp3_two_lights", "three_spheres")


@cache
def scene_named(name: str) -> Scene:
    return read_scene(ROOT / "scenes" / f"{name}.json")


def rendered(
    scene: Scene, grid: Grid, width: int = 300, height: int = 200, samples: int = 1
) -> np.ndarray:
    """(H, W, 3): surfaces of even, noisy brightness; with places of its own in each pixel where it
    is jittered. Its outline is that of a lit picture."""
    rng = np.random.default_rng(3)
    row, column = (a.ravel().astype(float) for a in np.mgrid[0:height, 0:width])
    colours = [2 * np.array(thing.brdf) for thing in scene.objects]
    colours.append(np.array(scene.background_radiance))
    total = np.zeros((height * width, 3))
    for _ in range(samples):
        dx, dy = rng.random((2, len(row))) - 0.5 if grid.jittered else (0, 0)
        met = grid.hits(scene, column + dx, row + dy, width, height).object_id
        light = np.where(met < 0, 1, 0.4 + 0.2 * rng.random(len(met)))
        total += np.array(colours)[met] * light[:, None]
    return (total / samples).reshape(height, width, 3)


def saved(folder: Path, values: np.ndarray, suffix: str = ".png", **options: object) -> Path:
    file = folder / f"picture{suffix}"
    if suffix == ".npy":
        np.save(file, values)
    else:
        Image.fromarray((np.clip(values, 0, 1) * 255).astype(np.uint8)).save(file, **options)
    return file


def check(found: Grid, true: Grid) -> None:
    assert found.fov_y_deg == pytest.approx(true.fov_y_deg, abs=0.1)
    assert found.aspect == pytest.approx(true.aspect, rel=0.005)
    exact = ("position", "divisor", "jittered", "cut", "moved", "flip_x", "flip_y")
    for name in (*exact, "shift_x", "shift_y"):
        assert getattr(found, name) == getattr(true, name), (name, found)


NUISANCES = {
    "none": {},
    "corner": {"position": 0.0},
    "w_minus_1": {"divisor": 1},
    "corner_w_minus_1": {"position": 0.0, "divisor": 1},
    "jittered": {"jittered": True},
    "cut": {"cut": 5e4},
    "fov": {"fov_y_deg": 81.787},
    "narrow": {"fov_y_deg": 45.0},
    "shift": {"shift_x": 2.0, "shift_y": -1.0},
    "aspect": {"aspect": 1.5},
    "flip_y": {"flip_y": True},
}


def tells(name: str, nuisance: str) -> bool:
    """Whether it is worth a test: two scenes have tp3's objects, and where spheres stand below the
    horizon the outline is a straight line, which does not tell some."""
    if name in SCENES[2:4]:
        return nuisance in ("none", "jittered")
    return name != "three_spheres" or nuisance not in ("fov", "narrow", "shift", "aspect")


@pytest.mark.parametrize(
    ("name", "nuisance"), [(s, n) for s in SCENES for n in NUISANCES if tells(s, n)]
)
def test_nuisance(tmp_path: Path, name: str, nuisance: str) -> None:
    scene = scene_named(name)
    true = replace(Grid(scene.camera.fov_y_deg), **NUISANCES[nuisance])
    values = rendered(scene, true)
    picture = read_picture(saved(tmp_path, values), scene, 16, 1)
    found, unexplained = fit_grid(picture, scene)
    check(found, true)
    if not true.jittered:
        assert unexplained <= 8


@pytest.mark.parametrize("suffix", [".jpg", ".npy"])
@pytest.mark.parametrize("name", ["tp3", "three_spheres"])
def test_other_formats(tmp_path: Path, name: str, suffix: str) -> None:
    scene = scene_named(name)
    true = Grid(scene.camera.fov_y_deg, position=0.0, divisor=1)
    options = {"quality": 75} if suffix == ".jpg" else {}
    file = saved(tmp_path, rendered(scene, true), suffix, **options)
    found, _ = fit_grid(read_picture(file, scene, 16, 1), scene)
    # an outline frayed by coarse JPEG may pass for a random place
    check(replace(found, jittered=False), true)


@pytest.mark.parametrize("name", ["tp3", "three_spheres"])
def test_several_samples_are_a_random_place_about_the_centre(tmp_path: Path, name: str) -> None:
    scene = scene_named(name)
    true = Grid(scene.camera.fov_y_deg, divisor=1, jittered=True)
    file = saved(tmp_path, rendered(scene, true, 200, 134, samples=16))
    check(fit_grid(read_picture(file, scene, 16, 16), scene)[0], true)


@pytest.mark.parametrize("moved", [("tp3", -2.0), ("tp3_statement", 2.0)])
def test_the_labs_other_camera(tmp_path: Path, moved: tuple[str, float]) -> None:
    scene = scene_named(moved[0])
    true = Grid(60, moved=moved[1])
    file = saved(tmp_path, rendered(scene, true))
    check(fit_grid(read_picture(file, scene, 16, 1), scene)[0], true)


def test_a_mirrored_picture_where_the_outline_tells(tmp_path: Path) -> None:
    scene = scene_named("tp3")
    aside = replace(scene, spheres=(replace(scene.spheres[0], center=(0.7, 0.2, 3.0)),))
    true = Grid(60, flip_x=True)
    file = saved(tmp_path, rendered(aside, true))
    check(fit_grid(read_picture(file, aside, 16, 1), aside)[0], true)


def test_a_straight_outline_leaves_the_scenes_camera(tmp_path: Path) -> None:
    scene = scene_named("three_spheres")
    file = saved(tmp_path, rendered(scene, Grid(60, flip_x=True)))
    check(fit_grid(read_picture(file, scene, 16, 1), scene)[0], Grid(60))


@pytest.mark.parametrize("name", SCENES)
def test_a_lit_picture(tmp_path: Path, name: str) -> None:
    scene = scene_named(name)
    true = Grid(60, position=0.0, cut=5e4)
    row, column = (a.ravel().astype(float) for a in np.mgrid[0:134, 0:200])
    values = shade(scene, true.hits(scene, column, row, 200, 134))[0].reshape(134, 200, 3)
    found, unexplained = fit_grid(read_picture(saved(tmp_path, values), scene, 16, 1), scene)
    assert unexplained <= 2
    if name != "three_spheres":  # whose horizon alone does not tell
        check(found, true)


@pytest.mark.parametrize("size", [(400, 300), (150, 100), (200, 200)])
def test_other_sizes(tmp_path: Path, size: tuple[int, int]) -> None:
    scene = scene_named("three_spheres")
    file = saved(tmp_path, rendered(scene, Grid(60, position=0.0), *size))
    check(fit_grid(read_picture(file, scene, 16, 1), scene)[0], Grid(60, position=0.0))


def test_without_background_the_scenes_own() -> None:
    shape = (20, 30)
    none = np.zeros(shape, dtype=bool)
    picture = Picture("x", np.zeros((*shape, 3)), none, none, 1, 1, "truncated", 0.0, "")
    assert fit_grid(picture, scene_named("tp3")) == (Grid(60), 0)


def test_facts_name_what_deviates_and_nothing_else() -> None:
    scene = scene_named("tp3")
    assert Grid(60).facts(scene) == []
    odd = Grid(53.13, 0.0, 1, True, 5e4, 1.5, -2.0, True, True, 1.0, 0.0)
    codes = {
        *("pixel_corner", "divided_by_w_minus_1", "jittered", "ray_cut", "shift", "fov"),
        *("camera_moved", "aspect", "flip_x", "flip_y"),
    }
    assert {code for code, _ in odd.facts(scene)} == codes
    said = dict(odd.facts(scene))
    assert said["fov"] == "your camera's field of view is 53.1 degrees, the scene's is 60"


def test_a_fit_takes_little_time(tmp_path: Path) -> None:
    """The claim is 0.6 s; the limit leaves room for a machine that is busy."""
    scene = scene_named("tp3")
    true = Grid(81.787, jittered=True)
    picture = read_picture(saved(tmp_path, rendered(scene, true, 600, 400)), scene, 16, 1)
    start = time.process_time()
    fit_grid(picture, scene)
    assert time.process_time() - start < 2
