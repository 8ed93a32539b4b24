"""Convergence: slopes and their intervals, any renderer as a command, killed runs."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import Image, write_exr
from penumbra.compare.measure.slope import fit_slope, rmse_interval
from penumbra.compare.measure.statistics import binomial_interval
from penumbra.compare.run.journal import Journal, JournalError
from penumbra.compare.run.renderers import (
    CommandRenderer,
    MissingProgramError,
    RendererError,
    penumbra_renderer,
)
from penumbra.compare.scene import read_scene
from penumbra.compare.studies.convergence import (
    COLUMNS,
    ConvergenceError,
    ConvergenceStudy,
    Curve,
    converge,
)
from penumbra.compare.studies.speedup import speedup

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT = 36, 24
DOUBLINGS = 2.0 ** np.arange(13)

FAKE = """\
import array, math, os, random, struct, sys, time, zlib

what, scene, light_samples, seed, out = sys.argv[1:]
light_samples, seed = int(light_samples), int(seed)
here = os.path.dirname(os.path.abspath(__file__))
with open(os.path.join(here, "calls"), "a") as calls:
    print(light_samples, seed, file=calls)
with open(os.path.join(here, "truth.pfm"), "rb") as stream:
    header = [stream.readline() for _ in range(3)]
    truth = array.array("f", stream.read())
random.seed(seed)
noise = [random.gauss(0, 0.3) for _ in truth]
scale = {"fast": light_samples**-0.75, "flat": 1}.get(what, light_samples**-0.5)
if what == "seedless":
    noise = [0.3] * len(truth)
if what == "nan":
    noise[5] = float("nan")
image = array.array("f", [t + scale * n for t, n in zip(truth, noise)])
if what == "wrong size":
    header[1] = b"36 23\\n"
    del image[-36 * 3 :]
elif what == "slow":
    time.sleep(0.25)
elif what == "nothing":
    sys.exit(0)
elif what == "empty":
    header, image = [], array.array("f")
elif what == "garbage":
    print("\\x1b[31mscreaming\\x1b[0m" * 100000)
    header = [b"not an image" * 1000]
elif what == "fails":
    print("no such light", file=sys.stderr)
    sys.exit(7)
elif what == "crashes":
    os.abort()
elif what == "hangs":
    time.sleep(1000)
elif what == "exact in 8 bits":
    width, height = (int(word) for word in header[1].split())
    levels = bytes(int(255 * min(max(t, 0), 1)) for t in truth)
    rows = [levels[3 * width * y : 3 * width * (y + 1)] for y in reversed(range(height))]
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"".join(b"\\0" + row for row in rows))),
        (b"IEND", b""),
    )
    header, image = [b"\\x89PNG\\r\\n\\x1a\\n"], array.array("f")
    for kind, data in chunks:
        crc = struct.pack(">I", zlib.crc32(kind + data))
        header += [struct.pack(">I", len(data)), kind, data, crc]
elif what == "exact as Radiance":
    width, height = (int(word) for word in header[1].split())
    header = [b"#?RADIANCE\\nFORMAT=32-bit_rle_rgbe\\n\\n", b"-Y %d +X %d\\n" % (height, width)]
    image = array.array("f")
    for y in reversed(range(height)):
        for x in range(width):
            rgb = truth[3 * (width * y + x) :][:3]
            power = math.frexp(max(rgb))[1]
            header.append(bytes([*(int(c * 2 ** (8 - power)) for c in rgb), power + 128]))
            if max(rgb) <= 0:
                header[-1] = bytes(4)
with open(out, "wb") as stream:
    stream.write(b"".join(header) + image.tobytes())
"""


@pytest.fixture
def scene(make_scene: Callable[..., Path]) -> Path:
    return make_scene(image={"width": WIDTH, "height": HEIGHT})


@pytest.fixture
def fake(tmp_path: Path, scene: Path) -> Callable[..., CommandRenderer]:
    """fake("independent") is a renderer that adds noise of that kind to the exact image."""
    (tmp_path / "fake.py").write_text(FAKE)
    truth = exact_image(read_scene(scene)).radiance[::-1].astype("<f4")
    (tmp_path / "truth.pfm").write_bytes(f"PF\n{WIDTH} {HEIGHT}\n-1\n".encode() + truth.tobytes())

    def make(what: str, timeout: float = 60, suffix: str = ".pfm") -> CommandRenderer:
        return CommandRenderer("fake", fake_command(tmp_path, what), suffix, timeout)

    return make


def fake_command(folder: Path, what: str) -> str:
    program = f"'{sys.executable}' -I -S '{folder / 'fake.py'}'"
    return f"{program} '{what}' {{scene}} {{light_samples}} {{seed}} {{out}}"


def study(scene: Path, renderer: CommandRenderer, **changes: Any) -> ConvergenceStudy:
    curve = Curve(renderer, changes.pop("light_samples", (1, 4, 16, 64)))
    out = scene.parent / "result"
    return ConvergenceStudy(scene, out, (curve,), **{"seeds": 3, **changes})


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def slope_of(result: dict[str, Any], region: str, against: str = "exact") -> dict[str, Any]:
    """The one slope of a region."""
    (found,) = (
        row for row in result["slopes"] if row["region"] == region and row["against"] == against
    )
    return found


# ---------------------------------------------------------------- slope


@pytest.mark.parametrize("power", [-0.5, -0.75, 0.0])
def test_slope_of_a_power_law_is_its_power(power: float) -> None:
    """RMSE = N^p is a straight line of slope p on log-log paper: least squares finds it to
    rounding, whatever its weights."""
    mse = (DOUBLINGS ** (2 * power))[:, None] * np.ones(4)
    for offset_error in (0.0, 1e-9):
        found = fit_slope(DOUBLINGS, mse, offset_error)
        assert found is not None
        assert found.slope == pytest.approx(power, abs=1e-12)


@pytest.mark.parametrize("seeds", [2, 4])
def test_interval_holds_the_true_slope_as_often_as_it_says(seeds: int) -> None:
    """The MSE over P pixels of normal noise of variance 1/N is chi^2_P / (P N): slope -1/2.
    Of 200 intervals of 95% the number that hold it is binomial; the test's limits are those
    that a 95% interval leaves once in 1000. P = 200 makes log MSE skewed by 0.2 only."""
    random = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        found = fit_slope(
            DOUBLINGS, random.chisquare(200, (13, seeds)) / (200 * DOUBLINGS[:, None])
        )
        assert found is not None and found.low is not None and found.high is not None
        hits += found.low <= -0.5 <= found.high
    low, high = binomial_interval(200, 0.95, 0.999)
    assert low <= hits <= high


def test_interval_shrinks_as_the_root_of_the_number_of_seeds() -> None:
    """The standard error of a mean of K values is sigma / sqrt(K), and t(df) tends to the
    normal: 32 seeds give intervals sqrt(32 / 8) = 2 times narrower than 8, times
    t_51 / t_226 = 1.02. Each width is known to 1 / sqrt(2 df), 10% and 5%: three standard
    errors are 33%."""
    random = np.random.default_rng(2)
    widths = []
    for seeds in (8, 32):
        found = fit_slope(
            DOUBLINGS, random.chisquare(500, (13, seeds)) / (500 * DOUBLINGS[:, None])
        )
        assert found is not None and found.low is not None and found.high is not None
        widths.append(found.high - found.low)
    assert widths[0] / widths[1] == pytest.approx(2.04, rel=0.33)


def test_equal_images_have_a_slope_but_no_interval() -> None:
    """If the seed changes nothing, the scatter between seeds says nothing about the slope."""
    found = fit_slope(DOUBLINGS, (1 / DOUBLINGS)[:, None] * np.ones(4))
    assert found is not None
    assert (found.low, found.high) == (None, None)
    assert fit_slope(DOUBLINGS, (1 / DOUBLINGS)[:, None]) == found


def test_numbers_of_samples_below_the_noise_are_left_out() -> None:
    """1/N is 3 standard errors of 0.01 above zero up to N = 32 (1/32 = 0.031), and above a
    floor of 0.01 up to N = 64. From the first that is not on, none is used, though N = 4096
    stands out again by accident."""
    mse = (1 / DOUBLINGS)[:, None] * np.array([0.99, 1.0, 1.01])
    mse[-1] = 1
    by_noise = fit_slope(DOUBLINGS, mse, offset_error=0.01)
    assert by_noise is not None and by_noise.light_samples == (1, 2, 4, 8, 16, 32)
    by_floor = fit_slope(DOUBLINGS, mse, floor=0.01)
    assert by_floor is not None and by_floor.light_samples == (1, 2, 4, 8, 16, 32, 64)
    assert fit_slope(DOUBLINGS, mse, offset_error=0.1) is None


def test_slope_interval_widens_with_the_noise_of_the_reference() -> None:
    """An error of standard deviation e in a constant common to all MSE moves log MSE_N by
    e / MSE_N: a few per cent at the largest N here, far more than the scatter of the seeds."""
    mse = (1 / DOUBLINGS[:7])[:, None] * np.array([0.999, 1.0, 1.001])
    alone = fit_slope(DOUBLINGS[:7], mse)
    noisy = fit_slope(DOUBLINGS[:7], mse, offset_error=1e-3)
    assert alone is not None and alone.low is not None and alone.high is not None
    assert noisy is not None and noisy.low is not None and noisy.high is not None
    assert noisy.high - noisy.low > 3 * (alone.high - alone.low)


def test_rmse_interval_is_student_t_on_the_log_of_the_mean() -> None:
    """MSE 3, 4, 5: mean 4, RMSE 2, standard error of the mean 1/sqrt(3); t_2(0.975) = 4.302653,
    and half of the relative error goes into the root: 2 exp(+-4.302653 / (2 * 4 sqrt(3)))."""
    rmse, low, high = rmse_interval(np.array([3.0, 4.0, 5.0]))
    half = 4.302652729911275 / (8 * 3**0.5)
    assert (rmse, low, high) == pytest.approx((2, 2 * np.exp(-half), 2 * np.exp(half)), rel=1e-9)


# ---------------------------------------------------------------- converge


@pytest.mark.parametrize(("what", "power"), [("independent", -0.5), ("fast", -0.75), ("flat", 0)])
def test_known_noise_has_its_slope(
    what: str, power: float, scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """The fake's error is normal of standard deviation 0.3 N^p in each of 3 channels, so the
    slope is p; "flat" is the commonest fault of students' renderers, N without effect. The
    interval is the statement's own, at 95%; the seeds are fixed."""
    result = converge(study(scene, fake(what), light_samples=(1, 4, 16, 64, 256)))
    found = slope_of(result, "all")
    assert found["low"] <= power <= found["high"]
    assert found["high"] - found["low"] < 0.1


def test_error_of_known_noise_is_its_standard_deviation(
    scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """At N = 4 the fake's RMSE is 0.3 / 2 over 3 channels of P pixels: each image's MSE is
    0.0225 chi^2_{3P} / 3P, known to sqrt(2 / 3P). Five standard errors."""
    converge(study(scene, fake("independent"), light_samples=(1, 4, 16)))
    for row in rows_of(scene.parent / "result.csv"):
        if row["light_samples"] == "4" and row["region"] == "all":
            error = (2 / (3 * int(row["pixels"]))) ** 0.5
            assert float(row["mse"]) == pytest.approx(0.0225, rel=5 * error)
            assert float(row["rmse"]) == pytest.approx(float(row["mse"]) ** 0.5, rel=1e-12)


def test_table_holds_every_image_and_region_once_with_its_own_seed(
    scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """4 numbers of light samples x 3 seeds = 12 images, each with a seed of its own (else the
    errors at different N would be correlated), in order, with the columns agreed on."""
    result = converge(study(scene, fake("independent")))
    rows = rows_of(scene.parent / "result.csv")
    assert tuple(rows[0]) == COLUMNS
    images = {(r["light_samples"], r["seed"]) for r in rows}
    assert len(images) == 12 and len({seed for _, seed in images}) == 12
    regions = [r["region"] for r in rows if r["seed"] == "1"]
    assert {"all", "lit", "penumbra", "umbra", "floor", "sphere", "silhouette"} <= set(regions)
    assert len(rows) == 12 * len(regions)
    order = [(int(r["light_samples"]), int(r["seed"])) for r in rows]
    assert order == sorted(order)
    assert {r["mse_against_cycles"] for r in rows} == {""}
    assert result == json.loads((scene.parent / "result.json").read_text())
    assert {"machine", "command", "versions", "scene_hash", "curves"} <= set(result)


def test_relative_error_of_the_umbra_is_left_empty(
    scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """Nothing is relative to a truth of 0; the MSE still shows light that leaks in."""
    converge(study(scene, fake("independent")))
    umbra = [r for r in rows_of(scene.parent / "result.csv") if r["region"] == "umbra"]
    assert {r["relative_rmse"] for r in umbra} == {""}
    assert all(float(r["mse"]) > 0 for r in umbra)


def test_images_that_do_not_change_with_the_seed_have_no_interval(
    scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """A renderer that ignores {seed} has a slope, but K equal images measure no scatter."""
    found = slope_of(converge(study(scene, fake("seedless"))), "lit")
    assert found["slope"] == pytest.approx(-0.5, abs=1e-5)
    assert found["low"] is None


@pytest.mark.parametrize(
    ("what", "suffix", "most"),
    [("exact in 8 bits", ".png", 1 / 510), ("exact as Radiance", ".hdr", 1 / 256)],
)
def test_an_exact_image_is_within_half_a_step_of_its_file_and_has_no_slope(
    what: str,
    suffix: str,
    most: float,
    scene: Path,
    fake: Callable[..., CommandRenderer],
) -> None:
    """The lab's file says v for all of [v, v + 1) / 255, read as its middle: off by 1/510 at
    most, black and white included; Radiance's by 1/256 of a radiance below 1. An error that the
    file's numbers account for is no noise."""
    result = converge(study(scene, fake(what, suffix=suffix)))
    rows = rows_of(scene.parent / "result.csv")
    assert max(float(row["rmse"]) for row in rows) <= most
    assert max(float(row["rmse"]) for row in rows if row["region"] == "lit") > 0
    assert result["slopes"] == []
    reasons = {row["region"]: row["reason"] for row in result["without_slope"]}
    assert reasons["lit"] == "no more error than rounding and the exact solution may have"
    assert reasons["umbra"] == "no error at all"


def test_images_are_kept_only_if_asked(scene: Path, fake: Callable[..., CommandRenderer]) -> None:
    converge(study(scene, fake("independent"), light_samples=(1, 2, 4)))
    assert not list(scene.parent.glob("result[._]*/"))
    converge(study(scene, fake("independent"), light_samples=(1, 2, 4), keep_images=True))
    assert len(list((scene.parent / "result_images").glob("fake_n*.pfm"))) == 9


# ---------------------------------------------------------------- a noisy reference


def write_reference(scene: Path, out: Path, parts: int = 4, deviation: float = 0.1) -> None:
    """The exact image as Cycles would give it: the mean of noisy parts, and its variance."""
    description = read_scene(scene)
    random = np.random.default_rng(1000)
    truth = exact_image(description).radiance
    noise = deviation * random.standard_normal((parts, *truth.shape))
    variance = noise.var(axis=0, ddof=1) / parts
    header: dict[str, str | int | float] = {"sceneHash": description.hash, "parts": parts}
    write_exr(out, Image(truth + noise.mean(axis=0), variance, header))


def test_error_against_a_noisy_reference_is_the_error_against_the_truth(
    scene: Path, fake: Callable[..., CommandRenderer], tmp_path: Path
) -> None:
    """The reference's noise has standard deviation 0.1 / sqrt(4) = 0.05, as much as the
    image's at N = 36. Its variance subtracted, mse_against_cycles - mse has mean 0. Over
    n = 3P values of s = 0.3 / sqrt(N) and r = 0.05 its variance is
    (4 s^2 r^2 + 2 r^4 (1 + 1/3)) / n: the product of the two noises, the square of the
    reference's, and of the estimate of its variance. Five standard errors."""
    write_reference(scene, tmp_path / "reference.exr")
    converge(study(scene, fake("independent"), reference=tmp_path / "reference.exr"))
    for row in rows_of(scene.parent / "result.csv"):
        if row["region"] in ("all", "umbra"):
            n, s, r = 3 * int(row["pixels"]), 0.3 / int(row["light_samples"]) ** 0.5, 0.05
            error = ((4 * s**2 * r**2 + 8 / 3 * r**4) / n) ** 0.5
            difference = float(row["mse_against_cycles"]) - float(row["mse"])
            assert abs(difference) < 5 * error


def test_slope_against_a_noisy_reference_has_no_noise_floor(
    scene: Path, fake: Callable[..., CommandRenderer], tmp_path: Path
) -> None:
    """Without the subtraction the RMSE would level off at 0.05, near N = 36, and the slope
    over N = 1..256 would be about -0.33. Errors that the reference cannot resolve are said to
    be below its noise."""
    write_reference(scene, tmp_path / "reference.exr")
    result = converge(
        study(
            scene,
            fake("independent"),
            light_samples=(1, 4, 16, 64, 256, 1 << 20),
            reference=tmp_path / "reference.exr",
        )
    )
    found = slope_of(result, "all", "cycles")
    assert found["low"] <= -0.5 <= found["high"]
    assert found["below_noise"][-1] == 1 << 20
    assert slope_of(result, "all")["light_samples"][-1] == 1 << 20


@pytest.mark.parametrize("fault", ["scene", "size", "variance", "missing"])
def test_reference_that_cannot_be_compared_is_refused(
    fault: str, scene: Path, fake: Callable[..., CommandRenderer], tmp_path: Path
) -> None:
    file = tmp_path / "reference.exr"
    truth = exact_image(read_scene(scene)).radiance
    scene_hash = "0" if fault == "scene" else read_scene(scene).hash
    variance = None if fault == "variance" else np.zeros_like(truth)
    if fault == "size":
        truth, variance = truth[:-2], np.zeros_like(truth[:-2])
    if fault != "missing":
        write_exr(file, Image(truth, variance, {"sceneHash": scene_hash, "parts": 4}))
    size = {"width": WIDTH, "height": HEIGHT}
    with pytest.raises(ValueError, match=r"reference\.exr: "):
        converge(study(scene, fake("independent"), reference=file, **size))


# ---------------------------------------------------------------- renderers that fail


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("wrong size", r"is 36x23, not 36x24"),
        ("nan", r"NaN or infinite"),
        ("nothing", r"wrote no image"),
        ("empty", r"not a colour PFM|cannot be read"),
        ("garbage", r"not a colour PFM|cannot be read"),
        ("fails", r"exit code 7[^\0]*no such light"),
        ("crashes", r"signal SIGABRT"),
        ("hangs", r"no image in 1 s"),
    ],
)
def test_renderer_that_fails_is_named_with_the_reason(
    what: str, message: str, scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """And no table, no image and no folder is left behind."""
    with pytest.raises(RendererError, match=message) as caught:
        converge(study(scene, fake(what, timeout=1 if what == "hangs" else 60)))
    assert str(caught.value).startswith("fake: ")
    assert "\x1b" not in str(caught.value)
    assert not list(scene.parent.glob("result*"))


def test_timeout_ends_what_the_command_started(scene: Path, tmp_path: Path) -> None:
    """A shell script's children, too: the sleeping one no longer runs once run() is over."""
    script = tmp_path / "hang.sh"
    script.write_text(f"#!/bin/sh\nsleep 1000 &\necho $! > {tmp_path}/child\nwait\n")
    script.chmod(0o755)
    command = f"{script} {{scene}} {{light_samples}} {{seed}} {{out}}"
    with pytest.raises(RendererError, match="no image"):
        converge(study(scene, CommandRenderer("hang", command, timeout=1)))
    child = int((tmp_path / "child").read_text())
    deadline = time.monotonic() + 10
    while running(child) and time.monotonic() < deadline:
        time.sleep(0.01)  # a killed orphan is there until init has seen it
    assert not running(child)


def running(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("mine {scene} {light_samples} {seed}", r"no \{out\}"),
        ("mine", r"no \{scene\}, \{light_samples\}, \{seed\}, \{out\}"),
        ("mine {scene} {light_samples} {seed} {out} {spp}", r"unknown placeholder \{spp\}"),
        ("mine {scene} {light_samples} {seed:3} {out}", r"unknown placeholder"),
        ("mine {scene} {light_samples} {seed} {out} {", r"mine: .*\{"),
        ("mine '{scene} {light_samples} {seed} {out}", r"No closing quotation"),
        ("", r"empty"),
    ],
)
def test_command_that_is_no_template_is_refused(command: str, message: str) -> None:
    with pytest.raises(RendererError, match=message):
        CommandRenderer("mine", command)


def test_command_is_split_as_a_shell_does_but_not_run_by_one(tmp_path: Path) -> None:
    """Spaces within a placeholder's value stay in one argument; $ and ; mean nothing."""
    renderer = CommandRenderer("mine", "a 'b c' {scene}; $X {light_samples} {seed} --o={out}")
    study_file = tmp_path / "a scene.json"
    job = replace(_job(study_file), light_samples=16, seed=5)
    assert renderer.arguments(job, Path("an image.exr")) == [
        *("a", "b c", f"{study_file};", "$X", "16", "5", "--o=an image.exr")
    ]


def _job(scene_file: Path) -> Any:
    from penumbra.compare.run.renderers import Job

    return Job(scene_file, 3, 2, 1, 1, 1)


def test_missing_program_says_what_to_do(scene: Path) -> None:
    command = "./not-built {scene} {light_samples} {seed} {out}"
    with pytest.raises(MissingProgramError, match=r"not-built is not there .* build it"):
        converge(study(scene, CommandRenderer("mine", command)))
    assert not list(scene.parent.glob("result*"))


def test_study_that_a_command_cannot_do_is_refused(
    scene: Path, fake: Callable[..., CommandRenderer]
) -> None:
    """The fake takes neither {width} nor {pixel_samples}."""
    renderer = fake("independent")
    with pytest.raises(ConvergenceError, match=r"needs \{width\}"):
        converge(study(scene, renderer, width=10, height=10))
    anti_aliased = ConvergenceStudy(
        scene, scene.parent / "result", (Curve(renderer, (1,), (1, 4)),)
    )
    with pytest.raises(ConvergenceError, match=r"needs \{pixel_samples\}"):
        converge(anti_aliased)
    with pytest.raises(ConvergenceError, match="two renderers are labelled fake"):
        converge(
            ConvergenceStudy(scene, scene.parent / "result", (Curve(renderer), Curve(renderer)))
        )


# ---------------------------------------------------------------- killed runs


def test_killed_run_leaves_no_half_file_and_the_next_one_completes_it(
    scene: Path, fake: Callable[..., CommandRenderer], tmp_path: Path
) -> None:
    """kill -9 after the third of 12 images. Nothing is at the final names; the second run
    renders only what the first had not recorded; the table is that of a run never stopped,
    but for the times."""
    renderer = fake("slow")
    options = ["--renderer", renderer.command, "--label", "fake", "--image-suffix", ".pfm"]
    options += ["--light-samples", "1,4,16,64", "--seeds", "3", "-o", str(tmp_path / "result")]
    command = [sys.executable, "-m", "penumbra", "converge", str(scene), *options]
    journal = tmp_path / "result.journal"
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not (journal.exists() and journal.read_bytes().count(b"\n") >= 3):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not [f for f in tmp_path.glob("result*") if f.suffix in (".csv", ".json", ".part")]
    recorded = journal.read_bytes().count(b"\n")
    with journal.open("ab") as stream:  # as if killed in the middle of a line
        stream.write(journal.read_bytes()[:100])
    time.sleep(0.5)  # the image that was being rendered when its parent died ends by itself
    calls = len((tmp_path / "calls").read_text().splitlines())

    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=100)
    assert len((tmp_path / "calls").read_text().splitlines()) - calls == 12 - recorded
    assert not list(tmp_path.glob("result.scratch-*")) and not journal.exists()
    resumed = rows_of(tmp_path / "result.csv")

    converge(replace(study(scene, fake("slow")), out=tmp_path / "whole"))
    whole = rows_of(tmp_path / "whole.csv")
    for row in (*resumed, *whole):
        del row["seconds"]
    assert resumed == whole


def test_rows_of_another_renderer_are_not_taken_over(
    scene: Path, fake: Callable[..., CommandRenderer], tmp_path: Path
) -> None:
    """A run that fails at its end leaves a journal of 4 images. With the same program 4 are
    taken from it; once the program has changed, none."""
    renderer = fake("independent")
    plan = study(scene, renderer, light_samples=(1, 4, 16), seeds=2)
    (tmp_path / "fake.py").write_text(FAKE.replace("here =", "assert light_samples < 16\nhere ="))
    with pytest.raises(RendererError, match="AssertionError"):
        converge(plan)
    assert len((tmp_path / "calls").read_text().splitlines()) == 4
    (tmp_path / "calls").unlink()
    with pytest.raises(RendererError, match="AssertionError"):
        converge(plan)
    assert not (tmp_path / "calls").exists()
    (tmp_path / "fake.py").write_text(FAKE)
    converge(plan)
    assert len((tmp_path / "calls").read_text().splitlines()) == 6


def test_two_runs_cannot_write_one_journal(tmp_path: Path) -> None:
    with Journal(tmp_path / "a.journal"), pytest.raises(JournalError, match="another run"):
        Journal(tmp_path / "a.journal")


def test_journal_drops_a_torn_line_and_goes_on_after_the_whole_ones(tmp_path: Path) -> None:
    """Cut anywhere within its last line, a journal holds the lines before, and takes new ones."""
    file = tmp_path / "a.journal"
    with Journal(file) as journal:
        journal.append("one", {"mse": 1})
        journal.append("two", {"mse": 2})
    whole = file.read_bytes()
    first = whole.index(b"\n") + 1
    for cut in range(first, len(whole)):
        file.write_bytes(whole[:cut])
        with Journal(file) as journal:
            assert (journal.get("one"), journal.get("two")) == ({"mse": 1}, None)
            journal.append("three", 3)
        with Journal(file) as journal:
            assert (journal.get("one"), journal.get("three")) == ({"mse": 1}, 3)


# ---------------------------------------------------------------- the real renderer


def test_c_renderer_converges_with_slope_minus_half(
    renderer: Path, scenes: Path, tmp_path: Path
) -> None:
    """The mean of N independent samples has variance V / N in every pixel, so the slope of the
    RMSE is -1/2 exactly, and the 95% interval holds it and is not wider than +-0.02. Fixed
    seeds: it can fail after a change of the random numbers alone, once in 20."""
    curve = Curve(penumbra_renderer())
    result = converge(
        ConvergenceStudy(
            scenes / "tp3.json", tmp_path / "tp3", (curve,), seeds=4, width=90, height=60
        )
    )
    found = slope_of(result, "all")
    assert found["low"] <= -0.5 <= found["high"]
    for region in ("all", "lit", "penumbra", "sphere", "floor"):
        interval = slope_of(result, region)
        assert interval["high"] - interval["low"] <= 0.04
        assert interval["light_samples"] == list(DOUBLINGS)
    umbra = [row for row in result["without_slope"] if row["region"] == "umbra"]
    assert umbra == [
        {
            "renderer": "penumbra",
            "pixel_samples": 1,
            "region": "umbra",
            "against": "exact",
            "reason": "no error at all",
        }
    ]


def test_anti_aliased_error_is_that_of_the_lights_and_of_the_positions(
    renderer: Path, scenes: Path, tmp_path: Path
) -> None:
    """The law of total variance: with M positions and N light samples at each, MSE(M, N) =
    (V_light / N + V_position) / M against the mean over the pixel, and MSE(1, N) =
    V_light / N through the centre. So 16 (MSE(16, 1) - MSE(16, 64)) / (63/64 MSE(1, 1)) is 1
    on the lit floor, where V_light hardly changes within a pixel; in the limit of 16 N shadow
    rays anti-aliasing costs nothing. Each MSE is the mean of 4 images over P pixels, known to
    sqrt(2 / 4P); five standard errors of the ratio of two."""
    curve = Curve(penumbra_renderer(), (1, 8, 64), (1, 16))
    result = converge(
        ConvergenceStudy(scenes / "tp3.json", tmp_path / "tp3", (curve,), width=90, height=60)
    )
    assert result["pixel_grid"] > 1
    images: dict[tuple[int, int], list[float]] = {}
    for row in rows_of(tmp_path / "tp3.csv"):
        if row["region"] == "floor:lit":
            key = int(row["pixel_samples"]), int(row["light_samples"])
            images.setdefault(key, []).append(float(row["mse"]))
            pixels = int(row["pixels"])
    assert set(images) == {(1, 1), (1, 8), (1, 64), (16, 1), (16, 8), (16, 64)}
    mse = {key: float(np.mean(values)) for key, values in images.items()}
    ratio = 16 * (mse[16, 1] - mse[16, 64]) / (63 / 64 * mse[1, 1])
    assert ratio == pytest.approx(1, abs=5 * (2 * 2 / (4 * pixels)) ** 0.5)


# ---------------------------------------------------------------- speed-up


def test_speedup_is_the_ratio_of_medians(
    renderer: Path, make_scene: Callable[..., Path], tmp_path: Path
) -> None:
    """Not how fast, which a test cannot say, but that the JSON follows from the CSV."""
    scene = make_scene(image={"width": 30, "height": 20})
    result = speedup(scene, tmp_path / "speedup.csv", threads=(2, 3), repeats=3, light_samples=4)
    rows = rows_of(tmp_path / "speedup.csv")
    assert [(r["repeat"], r["threads"]) for r in rows] == [(r, t) for r in "123" for t in "123"]
    assert result == json.loads((tmp_path / "speedup.json").read_text())
    times = {t: sorted(float(r["seconds"]) for r in rows if r["threads"] == t) for t in "123"}
    for row, threads in zip(result["rows"], "123", strict=True):
        low, median, high = times[threads]
        assert row["threads"] == int(threads)
        assert (row["low"], row["seconds"], row["high"]) == (low, median, high)
        assert row["speedup"] == times["1"][1] / median
