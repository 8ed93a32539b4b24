"""A program's check: what the lab's scene hides is found, and what is no renderer is said."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from penumbra.compare.check import program
from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.program import Examined, check_program, command_program
from penumbra.compare.run.renderers import CommandRenderer, Job, MissingProgramError, RendererError

TWO = "check_two_lights"
TEMPLATE = f"{shlex.quote(sys.executable)} {{scene}} {{light_samples}} {{seed}} {{out}}"
"""Of programs that run in this process: see examined()"""


def examined(
    variant: Variant,
    scenes: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    alone: Variant | None = None,
) -> Examined:
    """Of a renderer that makes pictures of half the scene's size; alone: what it is on one thread,
    if that is another."""

    def run(self: CommandRenderer, job: Job, out: Path) -> float:
        shape = job.height // 2, job.width // 2
        mine = alone if alone and job.threads == 1 else variant
        radiance = render(job.scene_file, mine, shape, job.light_samples, 1, job.seed)
        Image.fromarray((255 * np.clip(radiance, 0, 1)).astype(np.uint8)).save(out)
        return 0.1

    monkeypatch.setattr(CommandRenderer, "run", run)
    return check_program(command_program(TEMPLATE, ".png"), scenes=scenes)


def test_a_right_program_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    found = examined(Variant(), ("tp3", "check_low", TWO), monkeypatch)
    assert found.diagnosis.best.variant.mistakes == ()
    assert {"area_by_norms", "flat_colour_squared", "only_one_light"} <= set(found.excluded)
    assert dict(found.facts).keys() >= {"seed_repeats", "size"}


@pytest.mark.parametrize(
    ("variant", "mistake", "scene"),
    [
        (Variant(scale="area_by_norms"), "area_by_norms", TWO),
        (Variant(lights="divided_inside_light_loop"), "divided_inside_light_loop", TWO),
        (Variant(lights="averaged_over_lights"), "averaged_over_lights", TWO),
        (Variant(colour="flat_colour_squared"), "flat_colour_squared", TWO),
        (Variant(visibility="unbounded"), "shadow_ray_wrong_length", "check_low"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_the_labs_scene_hides_is_found(
    variant: Variant, mistake: str, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = examined(variant, ("tp3", scene), monkeypatch)
    assert found.diagnosis.best.variant.mistakes == (mistake,)
    assert found.telling.experiment.scene_file.stem == scene


def test_a_data_race_is_told_by_one_thread_and_several(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "cores", lambda: 2)
    found = examined(Variant(visibility="lost_0_3"), ("tp3",), monkeypatch, alone=Variant())
    assert found.diagnosis.best.variant.mistakes == ("samples_lost",)
    assert "data race" in dict(found.facts)["race"]


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("exit 3", "exit code 3"),
        ("sleep 30", "no image in 1 s"),
        ("true", "wrote no image"),
        ('echo nothing > "$3"', "wrote no good image"),
    ],
)
def test_what_is_no_renderer_is_said(script: str, said: str, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text(f"#!/bin/sh\n{script}\n")
    mine.chmod(0o755)
    template = f"{shlex.quote(str(mine))} {{scene}} {{light_samples}} {{out}} {{seed}}"
    with pytest.raises(RendererError, match=said):
        check_program(command_program(template, ".png", timeout=1))


def test_a_program_that_is_missing_is_named() -> None:
    with pytest.raises(MissingProgramError, match="nowhere/mine"):
        command_program("nowhere/mine {scene} {light_samples} {seed} {out}")
