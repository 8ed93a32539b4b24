"""Cycles shows the scene that the exact solution describes, and its references can be trusted.

Where bpy has no wheel (CYCLES below) the tests that render are skipped, with that reason; where it
has one they fail if it is missing.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra import blender_ref
from penumbra.blender_ref import Cycles, CyclesError, CyclesRenderer, OptionsError
from penumbra.compare.exact.image import PENUMBRA, exact_image
from penumbra.compare.measure.agreement import agreement, exact_for, passes
from penumbra.compare.measure.image import Image, read_image
from penumbra.compare.run.renderers import Job
from penumbra.compare.scene import read_scene

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "penumbra" / "blender_ref" / "shipped"
LIGHT_SCENES = ("tp3_disk", "tp3_sphere", "tp3_triangle", "tp3_sheared", "tp3_two_lights")
SCENES = ("tp3", "tp3_statement", "tp3_point", *LIGHT_SCENES)
HAS_WHEEL = sys.version_info[:2] in ((3, 11), (3, 13)) and not (
    platform.system() == "Linux" and platform.machine() != "x86_64"
)
cycles = pytest.mark.skipif(
    not HAS_WHEEL, reason="bpy exists for Python 3.11 and 3.13 only, and not for Linux on Arm"
)
CONFIDENCE = 0.999
"""Of each interval; verdicts are corrected for the number of regions on top. Seeds are fixed, so
a test that passes always passes."""
DELTA = 1e-3
"""The relative bias of a region that Cycles may have."""


def disagreements(
    image: Image, reference: Any, scene_file: Path, resolution: float, spared: int = 0
) -> list[str]:
    """What speaks against the two showing one scene.

    Regions whose bias is beyond DELTA by more than its interval, pixels that contradict the
    reference, and an interval of the whole that is wider than `resolution`: it would show
    nothing. Pixels are looked at for scenes of one light only: of several, Cycles draws one for
    each sample, and the pixel test takes a sample to hold them all; and so many pixels are
    `spared`.
    """
    scene = read_scene(scene_file)
    rows = agreement(image, reference, scene, delta=DELTA, confidence=CONFIDENCE)
    problems = [
        f"{row['region']}: {row['relative_bias']}" for row in rows if row["verdict"] == "differs"
    ]
    if len(scene.lights) == 1:
        problems += [
            f"{row['region']}: {row['consistent_fraction']} of the pixels consistent"
            for row in rows
            if row["consistent_fraction"] is None
            or row["consistent_fraction"] < min(0.999, 1 - (spared + 0.5) / row["pixels"])
        ]
    whole = next(row for row in rows if row["region"] == "all")
    if whole["relative_low"] is None or whole["relative_high"] is None:
        problems.append(f"all: {whole['note']}")
    elif max(-whole["relative_low"], whole["relative_high"]) > resolution:
        problems.append(f"all: [{whole['relative_low']}, {whole['relative_high']}]")
    return problems


def make_reference(scene_file: Path, out: Path, **options: Any) -> Image:
    blender_ref.reference(scene_file, out, progress=False, **options)
    return read_image(out)


# ------------------------------------------------------------------ shipped references


@pytest.mark.parametrize("name", SCENES)
def test_shipped_reference_agrees_with_the_exact_solution(name: str, scenes: Path) -> None:
    """Every region's bias is within 0.1% (99.9% intervals), and 99.9% of the pixels away from
    silhouettes are consistent: `passes` says both of a row."""
    image, scene = read_image(SHIPPED / f"{name}.exr"), read_scene(scenes / f"{name}.json")
    rows = agreement(image, exact_for(image, scene), scene, delta=DELTA, confidence=CONFIDENCE)
    assert {"all", "lit", "umbra", "sphere", "floor"} <= {row["region"] for row in rows}
    assert [row for row in rows if not passes(row)] == []


@pytest.mark.parametrize("name", SCENES)
def test_shipped_reference_tells_where_it_comes_from(name: str, scenes: Path) -> None:
    image = read_image(SHIPPED / f"{name}.exr")
    header = image.attributes
    assert image.shape == (100, 150)
    assert image.variance is not None
    assert header["sceneHash"] == read_scene(scenes / f"{name}.json").hash
    assert header["sceneName"] == name
    assert str(header["software"]).startswith("Cycles (bpy ")
    assert int(header["lightSamples"]) % int(header["parts"]) == 0
    settings = json.loads(str(header["settings"]))
    assert settings["cycles.samples"] == int(header["lightSamples"]) // int(header["parts"])
    assert len(set(settings["cycles.seed"])) == header["parts"]
    assert settings["cycles.max_bounces"] == 0


def test_shipped_references_are_small() -> None:
    assert sum(file.stat().st_size for file in SHIPPED.iterdir()) < 1_500_000


@cycles
@pytest.mark.parametrize(
    ("name", "samples"), [("tp3", 128), ("tp3_statement", 64), ("tp3_point", 8)]
)
def test_fresh_reference_agrees_with_the_shipped_one(
    name: str, samples: int, scenes: Path, tmp_path: Path
) -> None:
    """Welch's test between the two, both with the variance of their own parts; another seed, so
    that they are independent."""
    shipped = read_image(SHIPPED / f"{name}.exr")
    height, width = shipped.shape
    fresh = make_reference(
        scenes / f"{name}.json",
        tmp_path / "fresh.exr",
        samples=samples,
        parts=8,
        seed=1,
        width=width,
        height=height,
    )
    assert disagreements(fresh, shipped, scenes / f"{name}.json", resolution=2e-3) == []
    assert not np.array_equal(fresh.radiance, shipped.radiance)


# ------------------------------------------------------------------ the identical scene

QUAD = {"name": "quad", "position": [1, 10, 2], "u": [-2, 0, 0], "v": [0, 0, 2]}
WHITE = {"color": [1, 1, 1], "power": 40}
SPHERE = {"name": "sphere", "center": [0, 0, 3], "radius": 1, "color": [0.3, 0.6, 1.2]}
FLOOR = {"name": "floor", "point": [0, -2, 0], "normal": [0, 1, 0], "color": [0.9, 0.7, 0.5]}
POINT = {"name": "point", "position": [3, 5, 0], "color": [1, 0.8, 0.6], "power": 40}
ROOF = {"name": "roof", "point": [0, 14, 0], "normal": [0, 1, -0.9], "color": [0.4, 0.4, 0.4]}

TRIANGLE = {"name": "triangle", "position": [2.5, 7, 1], "u": [-5, 0.3, 0.5], "v": [0, 0, 5]}
SHEARED = {"name": "sheared", "position": [2, 9, 1], "u": [-4, 0, 1], "v": [1, 0.5, 4]}

IN_ITS_PLANE = {"sheared_upright": 2}
"""Pixels within 0.002 radians of an upright light's plane: there Cycles is off (docs/cycles.md)."""
CASES: dict[str, dict[str, Any]] = {
    # one under the other, of four colours: none hides another, no mesh and no lamp
    "stacked": {
        "spheres": [SPHERE],
        "planes": [FLOOR],
        "disk_lights": [
            {"name": "disk", "center": [0.5, 5, 3], "normal": [0.3, 1, -0.2], "radius": 2}
            | {"color": [1, 0.2, 0.1], "power": 2}
        ],
        "triangle_lights": [TRIANGLE | {"color": [0.1, 1, 0.3], "power": 4}],
        "quad_lights": [SHEARED | {"color": [0.2, 0.3, 1], "power": 4}],
        "sphere_lights": [
            {"name": "bulb", "center": [0.3, 13, 3.2], "radius": 1.5}
            | {"color": [1, 1, 0.2], "power": 20}
        ],
    },
    # upright before the sky, towards the camera: the floor behind them is dark
    "in_view": {
        "quad_lights": None,
        "triangle_lights": [
            {"name": "triangle", "position": [-4, 0.5, 6], "u": [2.5, 0.2, 0.5]}
            | {"v": [0.5, 2, 0.3], "color": [1, 1, 1], "power": 20}
        ],
        "disk_lights": [
            {"name": "disk", "center": [2.5, 1.2, 6], "normal": [0.3, 0.2, 1], "radius": 1}
            | {"color": [1, 1, 1], "power": 20}
        ],
    },
    # u and v at 76 degrees: an emissive mesh, not an area light
    "sheared": {"quad_lights": [QUAD | WHITE | {"v": [1, 0.5, 2]}]},
    # upright: the floor behind it is dark, so it emits on the side of -n alone
    "sheared_upright": {
        "quad_lights": [
            {"name": "quad", "position": [0, 0.5, 5], "u": [0, 2, 0.5], "v": [1.5, 0.4, 0]}
            | {"color": [1, 0.7, 0.3], "power": 40}
        ]
    },
    # two coloured quads and a point light; a camera that looks down, rolled
    "lights_and_camera": {
        "spheres": [SPHERE],
        "planes": [FLOOR],
        "quad_lights": [
            QUAD | {"color": [1, 0.5, 0.1], "power": 40},
            {"name": "left", "position": [-6, 4, 0], "u": [0, 1.5, 0], "v": [0, 0, 1]}
            | {"color": [0.2, 0.4, 1], "power": 30},
        ],
        "point_lights": [POINT],
        "camera": {
            "position": [4, 3, -3],
            "look_at": [0, -1, 3],
            "up": [0.2, 1, 0.3],
            "fov_y_deg": 70,
        },
    },
    "point": {"quad_lights": None, "point_lights": [POINT], "spheres": [SPHERE]},
    # rays end on the near sides of two spheres and before a third, which casts its shadow still
    "cut_spheres": {
        "ray_max_distance": 7,
        "camera": {"position": [0, 1, -4.2], "look_at": [0, 1, 1], "up": [0, 1, 0]}
        | {"fov_y_deg": 60},
        "spheres": [
            SPHERE,
            {"name": "cut", "center": [-2.5, 0, 3.2], "radius": 1.2, "color": [0, 1, 0]},
            {"name": "beyond", "center": [1, 6, 3], "radius": 0.7, "color": [1, 1, 0]},
        ],
        "planes": [FLOOR],
    },
    # half the light is above a roof that is seen nowhere: it is beyond the rays' end
    "roof_beyond_the_cut": {
        "ray_max_distance": 12,
        "planes": [FLOOR, ROOF],
        "quad_lights": [QUAD | WHITE | {"position": [6, 30, 14], "u": [-10, 0, 0], "v": [0, 0, 8]}],
    },
}


@cycles
@pytest.mark.parametrize("case", [*CASES, *LIGHT_SCENES])
def test_cycles_agrees_with_the_exact_solution(
    case: str, scenes: Path, make_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """8 parts of 32 samples, 60 x 40 pixels: the interval of the whole image's bias is then
    narrower than 0.6%, so a wrong factor, side, colour or cut shows. The background is itself,
    but where one of Cycles' stray rays (cycles_settings.CENTRE_OFFSET) meets a sliver."""
    scene_file = make_scene(**CASES[case]) if case in CASES else scenes / f"{case}.json"
    image = make_reference(scene_file, tmp_path / "out.exr", samples=256, width=60, height=40)
    scene = read_scene(scene_file)
    exact, spared = exact_for(image, scene), IN_ITS_PLANE.get(case, 0)
    assert disagreements(image, exact, scene_file, resolution=6e-3, spared=spared) == []
    exact = exact_image(scene, 60, 40)
    sky = (exact.object_id < 0) & ~exact.silhouette
    untouched = (image.radiance == exact.radiance.astype(np.float32)).all(axis=-1)
    assert untouched[sky].mean() > 0.99


@cycles
def test_no_sample_of_a_distant_mesh_light_is_lost(make_scene: Callable[..., Path]) -> None:
    """One sample for each of 2,400 pixels, 25 to 150 m from the light. As a single triangle it
    would be sampled by its solid angle, and 41 of them come back black."""
    scene_file = make_scene(
        "tp3_triangle",
        spheres=None,
        ray_max_distance=300,
        camera={"position": [0, 20, 20], "look_at": [0, -2, 60], "up": [0, 1, 0], "fov_y_deg": 40},
    )
    with Cycles(scene_file, 60, 40) as cycles:
        assert (cycles.render(1, 0).radiance[..., 0] > 0).all()


@cycles
def test_antialiased_cycles_agrees_with_the_mean_over_each_pixel(
    scenes: Path, tmp_path: Path
) -> None:
    image = make_reference(
        scenes / "tp3.json", tmp_path / "out.exr", samples=256, width=60, height=40, antialias=True
    )
    exact = exact_for(image, read_scene(scenes / "tp3.json"))
    assert image.attributes["pixelSamples"] == 256
    assert disagreements(image, exact, scenes / "tp3.json", resolution=4e-3) == []


@cycles
def test_unsupported_scenes_are_refused(make_scene: Callable[..., Path]) -> None:
    """Cycles' spheres have no inner side, it takes a colour below 1e-5 for black, and its lights of
    a radius light what is inside of them."""
    around = make_scene(spheres=[SPHERE | {"center": [0, 0, 0]}], file_name="around.json")
    with pytest.raises(CyclesError, match=r'around\.json: .*inside of the sphere "sphere"'):
        Cycles(around)
    dark = make_scene(spheres=[SPHERE | {"color": [1e-6, 0, 0]}], file_name="dark.json")
    with pytest.raises(CyclesError, match=r'dark\.json: the colour of "sphere"'):
        Cycles(dark)
    lit = make_scene(
        quad_lights=None,
        sphere_lights=[{"name": "bulb", "center": [3, -1.5, 4], "radius": 0.6} | WHITE],
        file_name="lit.json",
    )
    with pytest.raises(CyclesError, match=r'lit\.json: "floor" reaches .* light "bulb"'):
        Cycles(lit)


# ------------------------------------------------------------------ noise and variance


@cycles
def test_images_are_a_function_of_the_seed_and_independent_between_seeds(
    scenes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With each pixel's mean and standard deviation over R seeds taken out, the mean product of
    two images' errors over n pixels is -1/(R-1) and scatters by about 1/sqrt(n) if the seeds
    are independent; six times that is allowed. (Sobol-Burley sampling shows 0.3 to 0.9.)
    A user's colour management does not leak in."""
    with Cycles(scenes / "tp3.json", 60, 40) as first:
        images = [first.render(16, seed).radiance.mean(axis=-1) for seed in range(16)]
    monkeypatch.setenv("OCIO", "/nowhere/config.ocio")
    with Cycles(scenes / "tp3.json", 60, 40) as second:
        again = second.render(16, 15).radiance.mean(axis=-1)
    assert np.array_equal(again, images[15])

    noisy = np.std(images, axis=0) > 1e-6
    errors = np.array([image[noisy] for image in images])
    errors = (errors - errors.mean(axis=0)) / errors.std(axis=0, ddof=1)
    products = errors @ errors.T / noisy.sum()
    pairs = products[~np.eye(len(images), dtype=bool)]
    assert noisy.sum() > 500
    assert np.abs(pairs + 1 / 15).max() < 6 / np.sqrt(noisy.sum())


@cycles
def test_variance_is_the_squared_error(scenes: Path, tmp_path: Path) -> None:
    """Over the penumbra, sum (mean - exact)^2 / sum variance is 1: the numerator's relative
    standard deviation is sqrt(2/m), the denominator's sqrt(2/(7 m)) (8 parts), with
    m = (sum v)^2 / sum v^2 the number of pixels that count; five times both is allowed."""
    image = make_reference(
        scenes / "tp3.json", tmp_path / "o.exr", samples=128, width=120, height=80
    )
    exact = exact_image(read_scene(scenes / "tp3.json"), 120, 80)
    penumbra = (exact.shadow == PENUMBRA) & ~exact.silhouette
    assert image.variance is not None
    variance = image.variance.max(axis=-1)[penumbra]
    squared = ((image.radiance - exact.radiance) ** 2).max(axis=-1)[penumbra]
    counted = variance.sum() ** 2 / (variance**2).sum()
    tolerance = 5 * np.sqrt(2 / counted * (1 + 1 / 7))
    assert tolerance < 1
    assert abs(squared.sum() / variance.sum() - 1) < tolerance


# ------------------------------------------------------------------ files


@cycles
def test_killed_reference_leaves_no_half_file_and_the_next_run_completes_it(
    scenes: Path, tmp_path: Path
) -> None:
    """kill -9 after the first part: Blender ends too and takes its folder along, finished parts
    are kept and not rendered again, and the image is that of a run without interruption."""
    options: dict[str, Any] = {"samples": 8 * 64, "parts": 8, "width": 90, "height": 60}
    out, temporary = tmp_path / "killed" / "out.exr", tmp_path / "temporary"
    temporary.mkdir()
    program = (
        f"from penumbra import blender_ref; blender_ref.reference({str(scenes / 'tp3.json')!r}, "
    )
    program += f"{str(out)!r}, **{options!r})"
    process = subprocess.Popen(
        [sys.executable, "-c", program], cwd=ROOT, env=os.environ | {"TMPDIR": str(temporary)}
    )
    parts = out.with_name("out.exr.parts")
    _wait(lambda: process.poll() is not None or any(parts.glob("*.exr")))
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    _wait(lambda: not any(temporary.iterdir()))

    assert not out.exists()
    finished = {file: file.stat().st_mtime_ns for file in parts.glob("*.exr")}
    assert 1 <= len(finished) < 8
    for file in finished:
        assert read_image(file).shape == (60, 90)

    resumed = make_reference(scenes / "tp3.json", out, **options)
    assert len(list(parts.glob("*.exr"))) == 8
    assert {file: file.stat().st_mtime_ns for file in finished} == finished
    whole = make_reference(scenes / "tp3.json", tmp_path / "whole.exr", **options)
    assert np.array_equal(resumed.radiance, whole.radiance)
    assert resumed.variance is not None and whole.variance is not None
    assert np.array_equal(resumed.variance, whole.variance)


def _wait(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 240
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@cycles
def test_parts_of_another_scene_size_seed_or_sample_count_are_not_used(
    make_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """Each of these into one OUT gives what it gives on its own."""
    dim = make_scene(quad_lights=[QUAD | WHITE | {"power": 20}], file_name="dim.json")
    bright = make_scene(file_name="bright.json")
    out = tmp_path / "out.exr"
    size = {"width": 15, "height": 10}
    images = [
        make_reference(dim, out, samples=4, parts=2, **size),
        make_reference(bright, out, samples=4, parts=2, **size),
        make_reference(bright, out, samples=4, parts=2, seed=1, **size),
        make_reference(bright, out, samples=2, parts=2, seed=1, **size),
        make_reference(bright, out, samples=2, parts=2, seed=1, width=10, height=10),
    ]
    shown = {(image.shape, image.radiance.tobytes()) for image in images}
    assert len(shown) == len(images)
    assert [image.attributes["lightSamples"] for image in images] == [4, 4, 4, 2, 2]
    assert len(list(tmp_path.glob("out.exr.parts/*"))) == 2


@cycles
def test_saved_blend_renders_the_same_picture(scenes: Path, tmp_path: Path) -> None:
    """Opened and rendered (F12) as any user would, with the part's number of samples."""
    make_reference(
        scenes / "tp3.json", tmp_path / "out.exr", samples=8, parts=2, width=60, height=40
    )
    program = (
        "import bpy, sys; bpy.ops.wm.open_mainfile(filepath=sys.argv[1]);"
        "bpy.context.scene.cycles.samples = 4;"
        "bpy.context.scene.render.filepath = sys.argv[2];"
        "bpy.ops.render.render(write_still=True)"
    )
    blend, again = tmp_path / "out.blend", tmp_path / "again.exr"
    subprocess.run(
        [sys.executable, "-c", program, str(blend), str(again)],
        check=True,
        capture_output=True,
        env=os.environ
        | {"BLENDER_USER_RESOURCES": str(tmp_path / "user"), "TMPDIR": str(tmp_path)},
        timeout=120,
    )
    first = min((tmp_path / "out.exr.parts").glob("*.exr"))
    assert np.array_equal(read_image(again).radiance, read_image(first).radiance)


@cycles
def test_renderer_for_convergence_makes_the_images_of_its_jobs(
    scenes: Path, tmp_path: Path
) -> None:
    jobs = [Job(scenes / "tp3.json", 30, 20, n, 1, seed) for n, seed in ((1, 3), (4, 3), (4, 4))]
    rendered = list(CyclesRenderer().render(jobs, tmp_path))
    assert [job for job, _, _ in rendered] == jobs
    assert all(seconds > 0 for _, _, seconds in rendered)
    images = [read_image(file) for _, file, _ in rendered]
    assert [image.attributes["lightSamples"] for image in images] == [1, 4, 4]
    assert len({image.radiance.tobytes() for image in images}) == 3


# ------------------------------------------------------------------ without bpy


def test_package_is_imported_without_bpy() -> None:
    program = "import sys; sys.modules['bpy'] = None; from penumbra import blender_ref"
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, timeout=60)


def test_missing_bpy_is_said_with_exit_code_3(scenes: Path, tmp_path: Path) -> None:
    """A bpy that cannot be loaded, as where a system library is missing."""
    (tmp_path / "bpy.py").write_text("raise ImportError('libX11.so.6: cannot open')\n")
    out = tmp_path / "out.exr"
    ran = subprocess.run(
        [
            sys.executable,
            "-m",
            "penumbra.blender_ref",
            str(scenes / "tp3.json"),
            "1",
            "0",
            str(out),
        ],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ran.returncode == 3
    assert "Cycles cannot run" in ran.stderr and platform.python_version() in ran.stderr
    assert "blender_ref/shipped" in ran.stderr and "Traceback" not in ran.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    ("out", "options", "said"),
    [
        ("out.png", {"samples": 8}, "ends in .exr"),
        ("out.exr", {"samples": 9}, "not a multiple"),
        ("out.exr", {"samples": 8, "parts": 1}, "2 or more"),
        ("out.exr", {"samples": 8, "seed": -1}, "0 or more"),
    ],
)
def test_options_that_make_no_reference_are_refused(
    out: str, options: dict[str, int], said: str, scenes: Path, tmp_path: Path
) -> None:
    with pytest.raises(OptionsError, match=said):
        blender_ref.reference(scenes / "tp3.json", tmp_path / out, **options)
    assert list(tmp_path.iterdir()) == []
