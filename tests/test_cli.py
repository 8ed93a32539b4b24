"""The command line: exit codes, one sentence for every error, and what each subcommand does."""

from __future__ import annotations

import argparse
import doctest
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from penumbra.__main__ import main
from penumbra.cli import arguments as cli_arguments
from penumbra.cli.exit import UsageError
from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import Image, read_image, write_exr
from penumbra.compare.scene import dump_scene, read_scene
from tests.conftest import default_signals

ROOT = Path(__file__).resolve().parent.parent
SUBCOMMANDS = (
    *("scene", "reference", "exact", "compare", "converge", "speedup", "png"),
    "report",
)


@dataclass(frozen=True)
class Ran:
    code: int
    out: str
    err: str


def penumbra(*arguments: str | Path, **environment: str) -> Ran:
    """Run the command line in a process of its own, as a user does."""
    command = [sys.executable, "-m", "penumbra", *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env=os.environ | environment
    )
    return Ran(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def scene(make_scene: Callable[..., Path]) -> Path:
    return make_scene(image={"width": 36, "height": 24})


def one_sentence(ran: Ran) -> str:
    """An error is a line on stderr that starts with the program's name, and no traceback."""
    assert ran.err.startswith("penumbra: ") and "Traceback" not in ran.err
    return ran.err


def test_version_is_the_one_in_pyproject() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert penumbra("--version").out == f"penumbra {project['version']}\n"


def test_help_lists_every_subcommand() -> None:
    text = penumbra("--help").out
    assert all(re.search(rf"^    {name}\s", text, re.MULTILINE) for name in SUBCOMMANDS)


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_subcommand_explains_itself_with_an_example(name: str) -> None:
    ran = penumbra(name, "--help")
    assert ran.code == 0
    assert f"example: penumbra {name} " in ran.out or f"example: penumbra {name}\n" in ran.out


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["unknown"],
        ["scene"],
        ["exact", "scenes/tp3.json"],
        ["exact", "scenes/tp3.json", "-o", "x.exr", "--width", "0"],
        ["converge", "scenes/tp3.json", "--light-samples", "4096..1"],
        ["converge", "scenes/tp3.json", "--light-samples", "many"],
        ["converge", "scenes/tp3.json", "--light-samples", "0,1"],
        ["converge", "scenes/tp3.json", "--timeout", "nan"],
        ["converge", "scenes/tp3.json", "--seeds", "-1"],
        ["png", "image.exr", "-o", "x.gif"],
    ],
)
def test_wrong_usage_ends_with_2_and_a_hint(arguments: list[str]) -> None:
    ran = penumbra(*arguments)
    assert ran.code == 2
    assert ran.err.startswith("usage: penumbra") and "error: " in ran.err


def test_scene_prints_the_scene_in_si_units(scene: Path) -> None:
    ran = penumbra("scene", scene)
    assert (ran.code, ran.out, ran.err) == (0, dump_scene(read_scene(scene)), "")


@pytest.mark.parametrize(
    "arguments",
    [
        ["scene", "SCENE"],
        ["exact", "SCENE", "-o", "x.exr"],
        ["compare", "x.exr", "exact", "--scene", "SCENE"],
        ["converge", "SCENE", "-o", "x"],
        ["speedup", "SCENE", "-o", "x.csv"],
    ],
)
def test_bad_scene_ends_with_2_naming_file_line_and_key(
    arguments: list[str], make_scene: Callable[..., Path]
) -> None:
    bad = make_scene(ray_max_distance="far")
    ran = penumbra(*(str(bad) if word == "SCENE" else word for word in arguments))
    assert ran.code == 2
    assert f"{bad}:" in one_sentence(ran) and "ray_max_distance" in ran.err


def test_exact_writes_the_exact_image(scene: Path, tmp_path: Path) -> None:
    """To float32, 2^-24 of the value; with the scene's hash, and no noise."""
    out = tmp_path / "exact.exr"
    ran = penumbra("exact", scene, "-o", out, "--width", 20, "--height", 10, "--pixel-grid", 2)
    assert (ran.code, ran.err) == (0, "")
    image = read_image(out)
    truth = exact_image(read_scene(scene), 20, 10, 2).radiance
    np.testing.assert_allclose(image.radiance, truth, rtol=2**-24, atol=0)
    assert image.attributes["sceneHash"] == read_scene(scene).hash
    assert image.variance is not None and not image.variance.any()


def test_png_is_clamped_scaled_and_truncated(tmp_path: Path) -> None:
    """As the lab saves it: 0.5 * 255 = 127.5 becomes 127, 1.7 becomes 255, -0.1 becomes 0."""
    write_exr(tmp_path / "a.exr", Image(np.array([[[0.5, 1.7, -0.1]]])))
    assert penumbra("png", tmp_path / "a.exr", "-o", tmp_path / "a.png").code == 0
    assert PIL.Image.open(tmp_path / "a.png").getpixel((0, 0)) == (127, 255, 0)


@pytest.mark.parametrize("factor", [1.0, 1.01])
def test_compare_ends_with_0_for_agreement_and_1_for_a_bias_of_one_per_cent(
    factor: float, scene: Path, tmp_path: Path
) -> None:
    """The exact image times 1 and 1.01: a bias of 0 and of 1% in every region, without noise;
    delta is 0.05%."""
    description = read_scene(scene)
    truth = exact_image(description).radiance
    image = Image(factor * truth, np.zeros_like(truth), {"sceneHash": description.hash})
    write_exr(tmp_path / "a.exr", image)
    out = tmp_path / "a.json"
    ran = penumbra("compare", tmp_path / "a.exr", "exact", "--scene", scene, "--json", out)
    assert ran.code == (0 if factor == 1 else 1)
    (row,) = (r for r in json.loads(out.read_text())["rows"] if r["region"] == "lit")
    assert row["verdict"] == ("agrees" if factor == 1 else "differs")
    assert row["relative_bias"] == pytest.approx(factor - 1, abs=1e-7)
    assert row["verdict"] in ran.out


def test_compare_refuses_an_image_of_another_scene(scene: Path, tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", Image(np.ones((24, 36, 3)), None, {"sceneHash": "0"}))
    ran = penumbra("compare", tmp_path / "a.exr", "exact", "--scene", scene)
    assert ran.code == 2 and "a.exr" in one_sentence(ran)


@pytest.mark.parametrize(
    "arguments",
    [
        ["exact", "SCENE", "-o", "BAD/x.exr"],
        ["png", "IMAGE", "-o", "BAD/x.png"],
        ["converge", "SCENE", "-o", "BAD/x"],
        ["speedup", "SCENE", "-o", "BAD/x.csv", "--repeats", "1", "--threads", "1"],
    ],
)
def test_unwritable_output_ends_with_2(
    arguments: list[str], renderer: Path, scene: Path, tmp_path: Path
) -> None:
    """BAD is a file where a folder should be: not even root can write into it."""
    (tmp_path / "file").touch()
    write_exr(tmp_path / "image.exr", Image(np.ones((2, 3, 3))))
    names = {"SCENE": scene, "IMAGE": tmp_path / "image.exr"}
    words = [str(names.get(w, w)).replace("BAD", str(tmp_path / "file")) for w in arguments]
    ran = penumbra(*words)
    assert ran.code == 2
    one_sentence(ran)


def test_course_without_what_it_is_made_of_ends_with_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["course", "--build", str(tmp_path)]) == 3
    assert "run `make course`" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_missing_program_ends_with_3_and_says_what_to_do(scene: Path, tmp_path: Path) -> None:
    command = "./not-there {scene} {light_samples} {seed} {out}"
    ran = penumbra("converge", scene, "-o", tmp_path / "x", "--renderer", command)
    assert ran.code == 3
    assert "not-there" in one_sentence(ran) and "build it" in ran.err


@pytest.mark.parametrize(
    "options",
    [
        ["--renderer", "mine {scene} {out}"],
        ["--renderer", "mine {scene} {light_samples} {seed} {out} {spp}"],
        ["--renderer", "sh {scene} {light_samples} {seed} {out}", "--image-suffix", ".gif"],
        ["--renderer", "sh {scene} {light_samples} {seed} {out}", "--label", "a b"],
        ["--renderer", "sh {scene} {light_samples} {seed} {out}", "--width", "9"],
        ["--label", "one", "--label", "two"],
        ["--reference", "not-there.exr"],
    ],
)
def test_converge_refuses_what_it_cannot_do(
    options: list[str], scene: Path, tmp_path: Path
) -> None:
    ran = penumbra("converge", scene, "-o", tmp_path / "x", *options)
    assert ran.code == 2
    one_sentence(ran)
    assert not list(tmp_path.glob("x*"))


def test_converge_prints_the_slopes_and_where_they_are(
    renderer: Path, scene: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x"
    ran = penumbra("converge", scene, "-o", out, "--light-samples", "1..16", "--seeds", "2")
    assert (ran.code, ran.err) == (0, "")  # no progress bar: stderr is no terminal
    result = json.loads((tmp_path / "x.json").read_text())
    slope = next(s for s in result["slopes"] if s["region"] == "lit")
    assert f"{slope['slope']:.4f}  {slope['low']:.4f} to {slope['high']:.4f}" in ran.out
    assert str(tmp_path / "x.csv") in ran.out
    assert result["renderers"]["penumbra"]["software"].startswith("penumbra-render ")


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_stopped_converge_says_where_its_results_are(
    sent: signal.Signals, scene: Path, tmp_path: Path
) -> None:
    """And ends what it had started, and leaves no folder."""
    script = tmp_path / "hang.sh"
    script.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/pid\nexec sleep 1000\n")
    script.chmod(0o755)
    command = [sys.executable, "-m", "penumbra", "converge", str(scene)]
    command += ["--renderer", f"{script} {{scene}} {{light_samples}} {{seed}} {{out}}"]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "x")],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=default_signals,
    )
    deadline = time.monotonic() + 60
    while not ((tmp_path / "pid").exists() and (tmp_path / "pid").read_text().strip()):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    process.send_signal(sent)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + sent
    assert error.startswith("penumbra: stopped") and f"{tmp_path}/x.journal" in error
    assert "Traceback" not in error
    assert not list(tmp_path.glob("x*"))
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_the_courses_address_is_a_url_or_a_page_that_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The option's before the environment's; a folder's index.html; no fragment of its own."""
    parser = argparse.ArgumentParser()
    cli_arguments.add_course(parser)

    def address(*arguments: str) -> str:
        return cli_arguments.course_of(parser.parse_args(arguments))

    monkeypatch.delenv("PENUMBRA_COURSE", raising=False)
    assert address() == address("--course", "") == ""
    page = tmp_path / "index.html"
    page.touch()
    monkeypatch.setenv("PENUMBRA_COURSE", "https://example.org/c/#top")
    assert address() == "https://example.org/c/"
    assert address("--course", str(tmp_path)) == address("--course", str(page)) == page.as_uri()
    for wrong in ("javascript:alert(1)", str(tmp_path / "elsewhere"), "data:text/html,x"):
        with pytest.raises(UsageError):
            address("--course", wrong)


def test_doctests_hold() -> None:
    tried = doctest.testmod(cli_arguments)
    assert tried.attempted and not tried.failed


def test_output_can_be_cut_short_by_a_pipe(scene: Path) -> None:
    shell = f"'{sys.executable}' -m penumbra scene '{scene}' | true"
    done = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, timeout=60)
    assert done.stderr == ""


def test_subcommands_load_only_what_they_need(scene: Path) -> None:
    """bpy is never loaded here; colour-science takes seconds, matplotlib is the report's."""
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); from penumbra.__main__ import main; "
        f"main(['scene', {str(scene)!r}]); "
        "slow = {'bpy', 'colour', 'matplotlib', 'scipy', 'flip_evaluator'}; "
        "print(sorted(slow & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.endswith("\n[]\n")
