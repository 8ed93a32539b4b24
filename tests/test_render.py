"""The C program: determinism, provenance, honest variances, clear errors, whole files."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from penumbra.compare.measure.image import CHANNELS, Image, read_image
from penumbra.compare.run.library import Setting, WarmRenderer
from penumbra.compare.scene import read_scene

Render = Callable[..., Image]


def run(renderer: Path, *arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(renderer), *map(str, arguments)],
        capture_output=True, text=True, timeout=60, **options,  # type: ignore[call-overload]
    )  # fmt: skip


@pytest.mark.parametrize("scene", ["tp3", "tp3_statement", "tp3_point"])
@pytest.mark.parametrize("pixel_samples", [1, 3])
def test_image_is_bit_identical_for_any_number_of_threads(
    scene: str, pixel_samples: int, render: Render, scenes: Path
) -> None:
    digests = set()
    for threads in (1, 2, 3, 8):
        image = render(
            scenes / f"{scene}.json", threads=threads, light_samples=8,
            pixel_samples=pixel_samples, width=61, height=43, seed=7,
        )  # fmt: skip
        assert image.variance is not None
        digests.add(hashlib.sha256(image.radiance.tobytes() + image.variance.tobytes()).digest())
    assert len(digests) == 1


def test_more_threads_than_rows_is_no_difference(render: Render, scenes: Path) -> None:
    one = render(scenes / "tp3.json", threads=1, width=20, height=3)
    many = render(scenes / "tp3.json", threads=64, width=20, height=3)
    assert np.array_equal(one.radiance, many.radiance)


def test_seeds_differ_and_repeat(render: Render, scenes: Path) -> None:
    def image(seed: int) -> np.ndarray:
        return render(scenes / "tp3.json", seed=seed, width=60, height=40).radiance

    first = image(0)
    assert np.array_equal(first, image(0))
    for other in (1, 2**32, 2**64 - 1):
        assert not np.array_equal(first, image(other))


def test_background_is_seen_where_nothing_is_and_beyond_the_cut_off(
    render: Render, make_scene: Callable[..., Path]
) -> None:
    """The lab's floor ends at distance 100: from the origin, straight ahead and 2 below, at
    depression arcsin(2 / 100) = 1.146 degrees. In 400 rows over 60 degrees the row y looks down by
    arctan((2 (y + 1/2) / 400 - 1) tan 30): 1.158 degrees for row 207, the first of the floor in
    the middle column. The cut-off is 101 below: arcsin(2 / 101) = 1.135 still hides row 206."""
    image = render(make_scene(background=[0.5, 0.25, 0.125], spheres=[]), light_samples=1)
    middle = image.radiance[:, 300]
    depression = np.degrees(np.arctan((2 * (np.arange(400) + 0.5) / 400 - 1) * np.tan(np.pi / 6)))
    floor = depression > np.degrees(np.arcsin(2 / 100))
    assert np.array_equal(np.all(middle == [0.5, 0.25, 0.125], axis=-1), ~floor)


def test_image_x_grows_along_world_x(render: Render, make_scene: Callable[..., Path]) -> None:
    """A sphere at x = +1 is seen right of the middle (a left-handed picture)."""
    ball = {"name": "ball", "center": [1, 0, 4], "radius": 0.3, "color": [0, 1, 0]}
    image = render(make_scene(spheres=[ball], planes=[]), width=60, height=40)
    columns = np.nonzero((image.radiance != 0.5).any(axis=(0, 2)))[0]
    assert columns.min() > 30


def test_header_says_what_was_rendered(render: Render, scenes: Path) -> None:
    image = render(
        scenes / "tp3.json", light_samples=9, pixel_samples=2, seed=2**63, threads=2,
        width=30, height=20,
    )  # fmt: skip
    assert image.shape == (20, 30)
    attributes = image.attributes
    assert attributes["sceneName"] == "tp3"
    assert attributes["sceneHash"] == read_scene(scenes / "tp3.json").hash
    assert attributes["lightSamples"] == 9
    assert attributes["pixelSamples"] == 2
    assert attributes["seed"] == str(2**63)
    assert attributes["threads"] == 2
    assert attributes["sampler"] == "independent"
    assert str(attributes["software"]).startswith("penumbra-render ")
    assert 0 < float(attributes["renderSeconds"]) < 60


def test_variance_is_left_out_where_one_sample_cannot_tell_it(render: Render, scenes: Path) -> None:
    assert render(scenes / "tp3.json", light_samples=1, width=6, height=4).variance is None
    hard = render(scenes / "tp3_point.json", light_samples=1, width=6, height=4)
    assert hard.variance is not None and not hard.variance.any()


@pytest.mark.parametrize(
    ("light_samples", "pixel_samples", "lights"), [(8, 1, 1), (8, 1, 2), (2, 4, 1)]
)
def test_stated_variance_is_that_of_the_pixel_over_seeds(
    light_samples: int,
    pixel_samples: int,
    lights: int,
    render: Render,
    make_scene: Callable[..., Path],
) -> None:
    """E[stated variance] = Var over seeds, per pixel. Summed over all pixels and K = 300 seeds,
    both are unbiased estimates of the same sum; the standard error of their difference comes from
    the scatter between 10 groups of 30 seeds; 4 of them allowed (t of 9 degrees: p = 0.3%)."""
    quad = {"position": [1, 10, 2], "u": [-2, 0, 0], "v": [0, 0, 2]}
    quad |= {"color": [1, 1, 1], "power": 40}
    second = {**quad, "position": [4, 3, 1], "v": [0.5, 1, 1]}
    scene = make_scene(
        quad_lights=[{"name": f"q{i}", **q} for i, q in enumerate([quad, second][:lights])]
    )
    images = [
        render(
            scene, light_samples=light_samples, pixel_samples=pixel_samples, seed=seed,
            width=24, height=16,
        )
        for seed in range(300)
    ]  # fmt: skip
    differences = []
    for group in range(10):
        members = images[group::10]
        scatter = np.var([m.radiance for m in members], axis=0, ddof=1).sum()
        stated = np.mean([m.variance for m in members], axis=0).sum()
        differences.append((stated - scatter) / scatter)
    standard_error = np.std(differences, ddof=1) / np.sqrt(10)
    assert abs(np.mean(differences)) < 4 * standard_error
    assert standard_error < 0.05  # the test would notice 20%


def test_n_samples_are_the_mean_of_their_number(render: Render, scenes: Path) -> None:
    """The most common student fault is an nbLightSamples without effect. The variance of the
    image falls as 1 / N: with P pixels the F ratio of N = 1 (between two seeds) to N = 16 is 16."""

    def scatter(light_samples: int) -> float:
        a, b = (
            render(scenes / "tp3.json", light_samples=light_samples, seed=s, width=150, height=100)
            for s in (1, 2)
        )
        return float(((a.radiance - b.radiance) ** 2).sum())

    # relative standard error of each sum of squares is about sqrt(2 / 8000 noisy pixels) = 1.6%,
    # 2.3% for the ratio; heavy tails double it: 4 x 5%
    assert scatter(1) / scatter(16) == pytest.approx(16, rel=0.2)


def test_many_seeds_average_to_a_mean_free_of_structure(render: Render, scenes: Path) -> None:
    """Pixels are independent: over a wholly lit patch of floor the error of neighbours does not
    correlate. n pairs: standard error n^-1/2, 4 allowed."""
    errors = []
    for seed in range(20):
        image = render(scenes / "tp3.json", light_samples=1, seed=seed, width=60, height=40)
        errors.append(image.radiance[26:32, 2:12, 0])
    errors = np.array(errors) - np.mean(errors, axis=0)
    pairs = (errors[:, :, :-1] * errors[:, :, 1:]).ravel()
    z = pairs.mean() / errors.var() * np.sqrt(pairs.size)
    assert abs(z) < stats.norm.isf(3e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["no scene file"]),
        (["{scene}"], ["-o OUT.exr"]),
        (["{scene}", "{scene}", "-o", "{out}"], ["more than one scene file"]),
        (["nowhere.json", "-o", "{out}"], ["nowhere.json", "No such file"]),
        (["{scene}", "-o", "{out}", "--light-samples", "0"], ["--light-samples", '"0"', "1 to"]),
        (["{scene}", "-o", "{out}", "--light-samples", "4x"], ["--light-samples", '"4x"']),
        (["{scene}", "-o", "{out}", "--light-samples", "-4"], ["--light-samples", '"-4"']),
        (["{scene}", "-o", "{out}", "--pixel-samples", ""], ["--pixel-samples"]),
        (["{scene}", "-o", "{out}", "--seed", "18446744073709551616"], ["--seed"]),
        (["{scene}", "-o", "{out}", "--threads", "0"], ["--threads"]),
        (["{scene}", "-o", "{out}", "--width", "16385"], ["--width"]),
        (["{scene}", "-o", "{out}", "--samples", "4"], ["--samples", "--help"]),
        (["{scene}", "-o", "/nowhere/at/all.exr"], ["/nowhere/at/all.exr", "No such file"]),
        (["{scene}", "-o", "/dev/full/x.exr"], ["/dev/full/x.exr"]),
    ],
)
def test_wrong_usage_is_named_and_exits_with_2(
    arguments: list[str], words: list[str], renderer: Path, scenes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.exr"
    filled = [a.format(scene=scenes / "tp3.json", out=out) for a in arguments]
    result = run(renderer, *filled, "--width", "6", "--height", "4") if "--width" not in filled \
        else run(renderer, *filled)  # fmt: skip
    assert result.returncode == 2
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_help_and_version_say_so_and_exit_with_0(renderer: Path) -> None:
    for option, word in (("--help", "--light-samples"), ("--version", "penumbra-render 0.")):
        result = run(renderer, option)
        assert (result.returncode, result.stderr) == (0, "")
        assert word in result.stdout


def test_nothing_is_printed_when_all_is_well(renderer: Path, scenes: Path, tmp_path: Path) -> None:
    result = run(renderer, scenes / "tp3.json", "-o", tmp_path / "a.exr", "--width", 6)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    assert [f.name for f in tmp_path.iterdir()] == ["a.exr"]


def test_full_disk_is_named_and_leaves_nothing(
    renderer: Path, scenes: Path, tmp_path: Path
) -> None:
    """A file-size limit of 64 kB stands for a full disk: the write fails midway."""
    out = tmp_path / "a.exr"
    script = 'trap "" XFSZ; ulimit -f 64; exec "$@"'
    result = subprocess.run(
        ["bash", "-c", script, "-", str(renderer), str(scenes / "tp3.json"), "-o", str(out)],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert result.returncode == 2
    assert str(out) in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_image_survives_a_killed_render(
    renderer: Path, scenes: Path, tmp_path: Path
) -> None:
    """kill -9 at several moments: the name holds the old whole image or the new whole one, never
    half a file; a second run then completes."""
    out = tmp_path / "a.exr"
    command = [str(renderer), str(scenes / "tp3.json"), "-o", str(out), "--light-samples"]
    subprocess.run([*command, "4"], check=True)
    whole = {4, 64}
    for delay in (0.02, 0.1, 0.2, 0.3, 0.4, 0.6):
        with subprocess.Popen([*command, "64"]) as process:
            time.sleep(delay)
            os.kill(process.pid, signal.SIGKILL)
        assert read_image(out).attributes["lightSamples"] in whole
    subprocess.run([*command, "16"], check=True)
    assert read_image(out).attributes["lightSamples"] == 16
    assert [f.name for f in tmp_path.iterdir()] == ["a.exr"]


def test_channels_are_32_bit_floats_by_name(renderer: Path, scenes: Path, tmp_path: Path) -> None:
    import OpenEXR

    out = tmp_path / "a.exr"
    run(renderer, scenes / "tp3.json", "-o", out, "--width", 6, "--height", 4)
    with OpenEXR.File(str(out), separate_channels=True) as exr:
        channels = {name: c.pixels.dtype for name, c in exr.channels().items()}
    names = [*CHANNELS, *(f"variance.{c}" for c in CHANNELS)]
    assert channels == dict.fromkeys(names, np.dtype(np.float32))


@pytest.mark.parametrize("scene", ["tp3", "three_spheres"])
def test_program_and_library_give_the_same_textbook_image(
    scene: str, render: Render, scenes: Path
) -> None:
    """Bit for bit: both are compiled alike."""
    program = render(
        scenes / f"{scene}.json", estimator="textbook", light_samples=2, width=150, height=100
    )
    library = WarmRenderer(scenes / f"{scene}.json", 150, 100)
    library.render(Setting("independent", "textbook", 2, 1), 0)
    assert (program.radiance == library.radiance.transpose(1, 2, 0)).all()
