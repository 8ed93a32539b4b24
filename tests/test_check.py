"""penumbra check: pictures in, a true word out."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from penumbra.__main__ import main
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.run.provenance import ROOT

TP3 = ROOT / "scenes" / "tp3.json"


def picture(folder: Path, variant: Variant, n: int = 16, name: str = "") -> str:
    """A student's PNG of the lab's scene, at half its size: the path."""
    radiance = render(TP3, variant, (200, 300), n, 1, 5)
    file = folder / (name or f"n{n:03d}_aa01.png")
    Image.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8)).save(file)
    return str(file)


@pytest.mark.parametrize(
    ("variant", "status", "word"),
    [
        (Variant(), 0, "RIGHT"),
        (Variant(weight="pdf_times_cos"), 1, "the pdf is multiplied by the light's cosine"),
        (Variant(average="n_no_effect"), 1, "the noise at N = 16 is that of about N = 1"),
        (Variant(factor=0.5), 0, "your scene has a light of power 20 where this one has 40"),
    ],
)
def test_exit_status_and_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], variant: Variant, status: int, word: str
) -> None:
    assert main(["check", picture(tmp_path, variant)]) == status
    assert word in capsys.readouterr().out


def test_hints_give_away_no_more_than_they_say(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = picture(tmp_path, Variant(scale="area_omitted"))
    shown = []
    for hint in range(4):
        assert main(["check", file, "--hint", str(hint)]) == 1
        shown.append(capsys.readouterr().out)
    assert shown[0].count("\n") == 1
    assert "section 2, step (c)" in shown[1] and "area is missing" not in shown[1]
    assert "area is missing" in shown[2] and "pdf = d^2 / cos_light" not in shown[2]
    assert "pdf = d^2 / cos_light" in shown[3]


def test_json_has_the_evidence(tmp_path: Path) -> None:
    out = tmp_path / "check.json"
    assert main(["check", picture(tmp_path, Variant(average="extra_sample")), "--json", str(out)])
    said = json.loads(out.read_text())
    assert said["verdict"] == "wrong" and said["mistakes"] == ["extra_sample"]
    assert said["pictures"][0]["light_samples"] == 16 and said["regions"]
    lit = next(r for r in said["regions"] if r["name"] == "the lit part of the floor")
    assert abs(lit["ratio"] - 17 / 16) < 5 * lit["standard_error"] + 0.005


def test_what_only_colours_show_is_sure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = picture(tmp_path, Variant(colour="flat_colour_missing"))
    assert main(["check", file]) == 1
    said = capsys.readouterr().out
    assert "the flat colour is left out" in said and "(confidence above 99.9%)" in said


def test_one_light_sample_is_not_said_to_prove_the_loop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", picture(tmp_path, Variant(), n=1)]) == 0
    assert "as far as brightness shows" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["no.png"], "no.png"),
        (["mine.png"], "--light-samples"),
        (["n016.png", "--scene", "nowhere"], "nowhere"),
        (["n016.png", "--scene", "tp3_point"], "no area light"),
        (["tiny_n016.png"], "too small"),
        (["huge_n016.png"], "render it smaller"),
    ],
)
def test_bad_input_ends_with_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    for name in ("mine.png", "n016.png"):
        picture(tmp_path, Variant(), name=name)
    Image.new("RGB", (12, 8), (200, 0, 0)).save(tmp_path / "tiny_n016.png")
    Image.new("RGB", (4000, 3000)).save(tmp_path / "huge_n016.png")
    monkeypatch.chdir(tmp_path)
    assert main(["check", *arguments]) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(("readme", "lang"), [("README.md", "en"), ("README.fr.md", "fr")])
def test_readme_shows_what_check_says(
    readme: str, lang: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """But for the numbers' last digits, which another processor may round otherwise; of a checkout
    in which no course is made."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("penumbra.cli.check.MADE", ROOT / "build" / "no course")
    monkeypatch.setenv("LANG", lang)
    block = re.search(r"```console\n(.*?)```", (ROOT / readme).read_text(), re.DOTALL)
    assert block
    shown = re.split(r"^\$ \.venv/bin/penumbra (.*)$", block.group(1), flags=re.MULTILINE)[1:]
    assert len(shown) == 4
    for command, output in zip(shown[::2], shown[1::2], strict=True):
        main(shlex.split(command))
        said = capsys.readouterr().out
        assert re.sub(r"[\d.,]+", "#", said).split() == re.sub(r"[\d.,]+", "#", output).split()
