"""The benchmark: what it renders is the scene, what it counts is the sample loop, what it computes
from seconds is right. No time is judged here."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import page, results
from bench.__main__ import main
from bench.law import Law, medians, round_up
from bench.mitsuba_scene import UnsupportedScene, mitsuba_scene
from bench.rounds import VARIANTS, Measured, Plan, Truth
from bench.systems import Absent, EmbreeSystem, Frame, Loop, MitsubaSystem, ScalarLoop, SystemFailed
from penumbra.compare.exact.image import LIT, exact_image
from penumbra.compare.scene import read_scene
from penumbra.report.inputs import ReportError
from penumbra.report.speed import speed
from tests.conftest import ROOT, built
from tests.section import data_of, rendered_section

WIDTH, HEIGHT = 36, 24


@pytest.fixture
def loop(scenes: Path) -> Any:
    built("bin/penumbra-loop")
    loop = Loop(scenes / "tp3.json")
    yield loop
    loop.close()


# ---------------------------------------------------------------- programs


@pytest.mark.parametrize("threads", [1, 2])
def test_peak_program_does_its_arithmetic(threads: int) -> None:
    """It compares each of its results with the closed form, and ends with 1 if one differs."""
    done = subprocess.run(
        [built("bin/fma-peak"), str(threads)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0
    answer = json.loads(done.stdout)
    assert answer["threads"] == threads
    assert answer["fma_per_second"] > 0 and answer["divisions_per_second"] > 0


def test_peak_loop_keeps_every_operation_in_the_program() -> None:
    """Twelve chains of multiply-adds (or, without FMA, products) and twelve of divisions."""
    listing = subprocess.run(
        ["objdump", "--disassemble", built("bin/fma-peak")], capture_output=True, text=True
    ).stdout
    assert len(re.findall(r"\b(?:v?divps|fdiv)\b", listing)) >= 12
    assert len(re.findall(r"\b(?:vfmadd\w+ps|v?mulps|fmla|fmul)\b", listing)) >= 12


@pytest.mark.parametrize("arguments", [[], ["0"], ["x"], ["1", "2"]])
def test_peak_program_refuses_other_arguments(arguments: list[str]) -> None:
    done = subprocess.run([built("bin/fma-peak"), *arguments], capture_output=True)
    assert done.returncode == 2 and b"usage" in done.stderr


def test_loop_renders_what_the_program_renders_bit_for_bit(
    loop: Loop, scenes: Path, render: Any
) -> None:
    for system in loop.systems():
        options = {"estimator": system.estimator, "sampler": system.sampler}
        image = render(
            scenes / "tp3.json", width=WIDTH, height=HEIGHT, light_samples=8, seed=5, **options
        )
        shot = system.shoot(Frame(WIDTH, HEIGHT, 8, threads=2, seed=5), picture=True)
        assert shot.radiance is not None and shot.seconds > 0
        np.testing.assert_array_equal(shot.radiance, image.radiance, err_msg=system.name)


def test_scalar_loop_is_the_same_estimator(loop: Loop, scenes: Path) -> None:
    """Of the same variance as independent samples in packets: both errors are root mean squares
    over 5,400 pixels, known to some 2%; 10% allowed. Without bias: the mean of the errors is within
    4.5 of its standard errors, which the errors' scatter tells."""
    frame = Frame(90, 60, 64, threads=2)
    exact = loop.shoot("exact", "independent", frame, picture=True).radiance
    packets = loop.shoot("area", "independent", frame, picture=True).radiance
    scalar = ScalarLoop(scenes / "tp3.json").shoot(frame, picture=True).radiance
    assert exact is not None and packets is not None and scalar is not None
    error = scalar - exact
    assert np.linalg.norm(error) == pytest.approx(np.linalg.norm(packets - exact), rel=0.1)
    pixel = error.mean(axis=2)
    assert abs(pixel.mean()) < 4.5 * pixel.std() / np.sqrt(pixel.size)


def test_loop_offers_every_estimator_and_sampler_of_the_program(loop: Loop, renderer: Path) -> None:
    """An unknown name makes the program print those that it knows."""
    for option, names in (("estimator", loop.estimators), ("sampler", loop.samplers)):
        done = subprocess.run(
            [renderer, f"--{option}", "?", "x", "-o", "y"], capture_output=True, text=True
        )
        assert done.stderr.strip().endswith("is none of " + ", ".join(names))


@pytest.mark.parametrize("body", [None, "echo no library >&2; exit 127"])
def test_embree_that_is_missing_or_does_not_start_is_absent(
    body: str | None, scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bench.systems.ROOT", tmp_path)
    if body:
        script = tmp_path / "build/bin/embree-loop"
        script.parent.mkdir(parents=True)
        script.write_text(f"#!/bin/sh\n{body}\n")
        script.chmod(0o755)
    with pytest.raises(Absent, match="no library" if body else "libembree-dev"):
        EmbreeSystem(scenes / "tp3.json")


@pytest.mark.parametrize("variant", VARIANTS)
def test_python_without_mitsuba_makes_it_absent(variant: str, scenes: Path, tmp_path: Path) -> None:
    """-S -E: an interpreter that sees no installed package."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S -E "$@"\n')
    python.chmod(0o755)
    with pytest.raises(Absent, match="bench-extras"):
        MitsubaSystem(scenes / "tp3.json", 6, 4, 1, variant, str(python))


def test_loop_ends_with_a_sentence_for_a_request_that_is_none(loop: Loop) -> None:
    with pytest.raises(SystemFailed, match="a request that is none"):
        loop.shoot("area", "sobol", Frame(0, 0, 0, 0), picture=False)


# ---------------------------------------------------------------- Mitsuba's scene


def test_mitsuba_scene_is_the_lab_scene(scenes: Path) -> None:
    """Corners of the light and points of the floor, by hand: the quad from (1, 10, 2) spanned by
    (-2, 0, 0) and (0, 0, 2) shines downwards with pi 40; the floor is the disc of radius
    sqrt(100^2 - 2^2) about (0, -2, 0); the picture's right is -x of Mitsuba's camera."""
    scene = mitsuba_scene(read_scene(scenes / "tp3.json"), 600, 400)
    assert scene["sphere0"]["center"] == [0, 0, 3] and scene["sphere0"]["radius"] == 1
    light = np.array(scene["light0"]["to_world"])
    corners = {tuple(light @ (x, y, 0, 1)) for x in (-1, 1) for y in (-1, 1)}
    assert corners == {(x, 10, z, 1) for x in (-1, 1) for z in (2, 4)}
    np.testing.assert_allclose(light @ (0, 0, 1, 0), (0, -1, 0, 0), atol=1e-15)
    np.testing.assert_allclose(scene["light0"]["emitter"]["radiance"]["value"], np.pi * 40)
    floor = np.array(scene["plane0"]["to_world"])
    np.testing.assert_allclose(floor @ (0, 0, 0, 1), (0, -2, 0, 1))
    rim = floor @ (np.cos(1), np.sin(1), 0, 1)
    assert rim[1] == -2 and np.hypot(*rim[[0, 2]]) == pytest.approx(np.sqrt(100**2 - 2**2))
    camera = np.array(scene["sensor"]["to_world"])
    np.testing.assert_allclose(camera @ (-1, 0, 0, 0), (1, 0, 0, 0), atol=1e-15)


@pytest.mark.parametrize(
    "changes",
    [
        {"quad_lights": [{"name": "q", "position": [1, 10, 2], "u": [-2, 0, 0], "v": [1, 0, 2],
                          "color": [1, 1, 1], "power": 40}]},
        {"ray_max_distance": 5},
    ],
)  # fmt: skip
def test_mitsuba_scene_refuses_what_would_not_be_identical(
    changes: dict[str, Any], make_scene: Any
) -> None:
    with pytest.raises(UnsupportedScene):
        mitsuba_scene(read_scene(make_scene(**changes)), 6, 4)


@pytest.mark.parametrize(
    ("name", "light"),
    [("tp3_point", "point"), ("tp3_disk", "disk"), ("tp3_sphere", "bulb"),
     ("tp3_triangle", "triangle"), ("tp3_two_lights", "point")],
)  # fmt: skip
def test_other_lights_than_quads_are_refused_by_name(name: str, light: str, scenes: Path) -> None:
    """The scalar loop would take any of them for a quad."""
    file, said = scenes / f"{name}.json", f'quad lights only, not "{light}"'
    with pytest.raises(UnsupportedScene, match=said):
        mitsuba_scene(read_scene(file), 6, 4)
    for program in (ScalarLoop, EmbreeSystem):
        with pytest.raises(Absent, match=said):
            program(file)


# ---------------------------------------------------------------- results


def rows(system: str, seconds: Any, error: Any, counts: Any = (4, 16, 64, 256)) -> list[Any]:
    return [
        {
            "experiment": "samples", "system": system, "width": 6, "height": 4,
            "light_samples": n, "threads": 2, "round": number,
            "seconds": seconds(n) * number,  # median: twice
            "relative_rmse_all": error(n), "relative_rmse_lit": error(n),
        }
        for n in counts for number in (1, 2, 3)
    ]  # fmt: skip


def test_law_recovers_the_power_law_and_the_line() -> None:
    """RMSE 0.5 N^-0.75 meets 1% at N = 50^(4/3) = 184.2, rounded up to 192; seconds 1e-3 + 1e-5 N,
    of which the median is twice, make 2 (1e-3 + 1.92e-3); beyond 256 in proportion to N."""
    frames = rows("a", lambda n: 1e-3 + 1e-5 * n, lambda n: 0.5 * n**-0.75)
    law = Law.of(frames, "a", 2)
    assert law.slope("all") == pytest.approx(-0.75)
    assert law.samples_for(0.01) == 192
    assert law.seconds_at(192) == pytest.approx(2 * (1e-3 + 1.92e-3))
    assert law.samples_for(0.001) == round_up(500 ** (4 / 3))
    assert law.seconds_at(512) == pytest.approx(2 * 2 * (1e-3 + 2.56e-3))


def test_noise_free_system_needs_the_fewest_samples_and_a_biased_one_never_gets_there() -> None:
    frames = rows("exact", lambda n: 1.0, lambda n: 2e-7) + rows("biased", float, lambda n: 0.1)
    assert Law.of(frames, "exact", 2).samples_for(0.001) == 4
    assert Law.of(frames, "exact", 2).slope("all") is None
    assert Law.of(frames, "biased", 2).samples_for(0.001) is None


def test_medians_are_medians_and_errors_are_root_mean_squares() -> None:
    frames = rows("a", lambda n: 1.0, lambda n: 1.0, counts=(4,))
    for row, error in zip(frames, (1.0, 2.0, 2.0), strict=True):
        row["relative_rmse_all"] = error
    (row,) = medians(frames)
    assert (row["seconds"], row["low"], row["high"], row["rounds"]) == (2, 1, 3, 3)
    assert row["relative_rmse_all"] == pytest.approx(np.sqrt(3))


def test_counted_operations_are_those_of_the_sample_loop() -> None:
    """Each line that is counted stands in the sample loop as it is; what it holds is counted here
    anew: a multiply-add takes one of the sums, each product and each sum that remains is one."""
    text = (ROOT / "c_renderer/src/packet/estimator_packet.c").read_text()
    loop = text[text.index("Term look(") : text.index("static void sum_chunk")]
    lines = {**results.COUNTED, **results.COUNTED_FOR_TWO, **results.COUNTED_FOR_A_SPHERE}
    for line, count in lines.items():
        assert line in loop
        _, _, formula = line.partition("=")
        products, sums = formula.count(" * "), formula.count(" + ") + line.count("+=")
        assert count == max(products, sums), line


def test_operations_of_a_lit_image_are_all_its_packets(scenes: Path) -> None:
    """Of 36 pixels a row has three packets of 16 lanes. With every pixel lit no sphere is tested:
    ten and a half operations and half a division."""
    scene = read_scene(scenes / "tp3.json")
    exact = exact_image(scene, WIDTH, HEIGHT)
    exact.shadow[:] = LIT
    assert results.operations(scene, exact) == (10.5 * 48 * HEIGHT, 24 * HEIGHT)


def test_shares_are_counted_operations_over_peak_and_time(scenes: Path) -> None:
    """A frame whose counted operations take half of its time at the peak has a share of 1/2."""
    scene = read_scene(scenes / "tp3.json")
    truth = Truth(scene, WIDTH, HEIGHT)
    fma, divisions = results.operations(scene, truth.exact)
    assert fma > 21 * divisions > 0  # some penumbra
    peaks = [{"round": 1, "threads": 2, "fma_per_second": 1e9, "divisions_per_second": 1e8}]
    frames = rows(results.FAST, lambda n: n * fma / 1e9, lambda n: 0.1, (256, 4096))
    measured = Measured(frames, peaks, {}, {}, truth)
    found = results.shares(measured, Plan(Path(), WIDTH, HEIGHT), scene)
    assert [share["light_samples"] for share in found] == [256, 4096]
    for share in found:
        assert share["fma_share"] == pytest.approx(0.5)
        assert share["division_share"] == pytest.approx(5 * divisions / fma)


def test_speedup_stands_beside_that_of_the_peak(scenes: Path) -> None:
    """Two threads that take 2/3 of one's time, on a machine that adds and multiplies 1.25 times as
    fast with two."""
    scene = read_scene(scenes / "tp3.json")
    frames = rows(results.FAST, lambda n: 2e-3, lambda n: 0.1)
    frames += [{**row, "threads": 1, "seconds": 1.5 * row["seconds"]} for row in frames]
    peaks = [
        {"round": 1, "threads": t, "fma_per_second": rate, "divisions_per_second": 1e8}
        for t, rate in ((1, 4e9), (2, 5e9))
    ]
    measured = Measured(frames, peaks, {}, {}, Truth(scene, WIDTH, HEIGHT))
    found = results.targets(measured, Plan(Path(), WIDTH, HEIGHT), scene)
    (speedup,) = (row for row in found if row["what"].startswith("speed-up"))
    assert speedup["reached"] == pytest.approx(1.5) and not speedup["met"]
    assert "1.25 times" in speedup["bound_by"]


# ---------------------------------------------------------------- the whole


def test_benchmark_writes_csv_json_and_the_page(scenes: Path, tmp_path: Path) -> None:
    """Tiny and without the others, which are then said to be left out."""
    built("bin/penumbra-loop")
    document = tmp_path / "performance.md"
    document.write_text(f"before\n{page.BEGIN}\nold\n{page.END}\nafter\n")
    options = f"--width {WIDTH} --height {HEIGHT} --rounds 1 --compared 4,16 --fitted 4"
    options += " --sizes 16x8 --without cycles --without mitsuba --without embree"
    files = ["-o", str(tmp_path / "bench"), "--page", str(document)]
    code = main([str(scenes / "tp3.json"), *files, *options.split()])
    assert code == 0
    text = document.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "Cycles: left out on request" in text and "| `area sobol` | 1.00 | 1.00 |" in text
    with (tmp_path / "bench/frames.csv").open() as stream:
        written = list(csv.DictReader(stream))
    assert {row["experiment"] for row in written} >= {"samples", "size", "process"}
    assert all(float(row["seconds"]) > 0 for row in written)
    result = json.loads((tmp_path / "bench/bench.json").read_text())
    assert result["rounds"] == 1 and result["machine"]["processor"]
    assert 0 <= result["stolen"] <= 1
    reached = {row["what"]: row["met"] for row in result["targets"]}
    assert reached["render time, Cycles / area sobol, N = 16"] is None
    section = speed(data_of("speed", tmp_path))
    assert "<code>make bench</code>" in section["about"]
    compared = section["tables"][1]
    assert compared["title"].endswith("a multiple of <code>area sobol</code>")
    assert ["<code>area sobol</code>", "1.00", "1.00"] in compared["rows"]
    shown = rendered_section("speed", tmp_path)
    assert shown and str(section["about"]) in shown.html


def test_report_does_without_a_benchmark_and_refuses_a_broken_one(tmp_path: Path) -> None:
    assert rendered_section("speed", tmp_path) is None
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench/bench.json").write_text('{"targets": []}')
    with pytest.raises(ReportError, match=r"bench\.json.*make bench"):
        rendered_section("speed", tmp_path)


@pytest.mark.parametrize(
    "text", ["no markers", f"{page.END}{page.BEGIN}", 2 * f"{page.BEGIN}{page.END}"]
)
def test_page_without_one_marked_place_is_refused(text: str, tmp_path: Path) -> None:
    document = tmp_path / "performance.md"
    document.write_text(text)
    with pytest.raises(page.PageError, match=r"performance\.md"):
        page.write_page(document, {})
    assert document.read_text() == text
