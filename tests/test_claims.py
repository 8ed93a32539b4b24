"""Which claim a fault costs, and which it does not."""

from __future__ import annotations

import doctest
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from penumbra.compare.check import program
from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.checking import Checked, check
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.program import Examined
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, WRONG
from penumbra.compare.run.provenance import ROOT
from penumbra.grading import claims, grade, gradebook
from penumbra.grading.claims import (
    CLAIMS,
    HINTS,
    LIGHT_MEAN,
    N_HAS_EFFECT,
    NOISE_LAW,
    OTHER_LIGHTS,
    PENUMBRA,
    REFUTED,
    SHOWN,
    THREADS,
    TITLES,
    UNTOLD,
    mistakes_against,
    refuted_by,
    states,
    timed,
)

RIGHT_IMAGE = (SHOWN, SHOWN, SHOWN, SHOWN, UNTOLD, UNTOLD)


def checked(folder: Path, variant: Variant, n: int = 16, scene: str = "tp3") -> Checked:
    scene_file = ROOT / "scenes" / f"{scene}.json"
    radiance = render(scene_file, variant, (200, 300), n, 1, 5)
    file = folder / f"n{n}.png"
    Image.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8)).save(file)
    return check([file], scene_file)


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> Checked:
    return checked(tmp_path_factory.mktemp("right"), Variant())


def kinds(found: Checked, *others: tuple[str, Checked]) -> tuple[str, ...]:
    said = states(found, others)
    return tuple(said[claim].state for claim in CLAIMS)


def told(found: Checked, **changes: object) -> Checked:
    """With another verdict."""
    return replace(found, verdict=replace(found.verdict, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", catalogue().mistakes)
def test_every_mistake_of_the_catalogue_refutes_a_claim(name: str) -> None:
    assert refuted_by(name) <= set(CLAIMS)
    assert refuted_by(name)


@pytest.mark.parametrize(
    ("name", "claims"),
    [
        ("pdf_times_cos", {LIGHT_MEAN}),
        ("area_omitted", {LIGHT_MEAN}),
        ("flat_colour_missing", {LIGHT_MEAN}),
        ("ambient_added", {LIGHT_MEAN}),
        ("clamp_before_light_average", {LIGHT_MEAN}),
        ("quad_parametrisation_wrong", {PENUMBRA}),
        ("shadow_ray_to_fixed_point", {PENUMBRA}),
        ("no_shadow", {PENUMBRA}),
        ("shadow_acne", {PENUMBRA}),
        ("loop_left_early", {PENUMBRA}),
        ("divided_by_visible_count", {PENUMBRA}),
        ("same_samples_everywhere", {PENUMBRA}),
        ("not_divided_by_n", {LIGHT_MEAN}),
        ("divided_by_n_plus_one", {LIGHT_MEAN}),
        ("extra_sample", {LIGHT_MEAN}),
        ("sample_missing", {LIGHT_MEAN}),
        ("fewer_samples_than_stated", {NOISE_LAW}),
        ("n_no_effect", {NOISE_LAW, N_HAS_EFFECT}),
        ("running_half", {NOISE_LAW, N_HAS_EFFECT}),
        ("samples_lost", {LIGHT_MEAN, THREADS}),
        ("only_one_light", {OTHER_LIGHTS}),
        ("black", {LIGHT_MEAN, PENUMBRA, NOISE_LAW, N_HAS_EFFECT}),
    ],
)
def test_where_a_mistake_stands_says_what_it_costs(name: str, claims: set[str]) -> None:
    """Of an average its weights say it: n_no_effect's sum to 1 (the mean is right), their squares
    to 1 at any N (and not 1/N); not_divided_by_n's sum to N, their squares to N = N^2 / N."""
    assert refuted_by(name) == claims


def test_every_claim_has_a_title_and_a_mistake_against_it() -> None:
    assert set(TITLES) == set(CLAIMS)
    assert all(mistakes_against(claim) for claim in CLAIMS)


def test_a_right_picture_shows_what_a_picture_can_show(right: Checked) -> None:
    assert kinds(right) == RIGHT_IMAGE


def test_one_light_sample_shows_the_mean_and_not_what_n_does(tmp_path: Path) -> None:
    assert kinds(checked(tmp_path, Variant(), n=1)) == (SHOWN, SHOWN, *(UNTOLD,) * 4)


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        (Variant(weight="pdf_times_cos"), (REFUTED, SHOWN, SHOWN, SHOWN, UNTOLD, UNTOLD)),
        (Variant(average="n_no_effect"), (SHOWN, SHOWN, REFUTED, REFUTED, UNTOLD, UNTOLD)),
        (Variant(average="extra_sample"), (REFUTED, SHOWN, SHOWN, SHOWN, UNTOLD, UNTOLD)),
        (Variant(visibility="to_centre"), (SHOWN, REFUTED, SHOWN, SHOWN, UNTOLD, UNTOLD)),
        (Variant(scale="normal_reversed"), (*(REFUTED,) * 4, UNTOLD, UNTOLD)),
    ],
)
def test_a_fault_costs_its_claim_and_no_other(
    tmp_path: Path, variant: Variant, expected: tuple[str, ...]
) -> None:
    assert kinds(checked(tmp_path, variant)) == expected


def test_reasons_give_away_no_more_than_the_hint(tmp_path: Path) -> None:
    said = states(checked(tmp_path, Variant(scale="area_omitted")))
    whys = said[LIGHT_MEAN].why
    assert len(whys) == HINTS
    assert "area" not in whys[0] + whys[1] and "0.25" in whys[1]
    assert "area is missing" in whys[2]
    assert all(len(state.why) == HINTS for state in said.values())


def test_what_no_mistake_explains_is_held_against_where_it_shows(right: Checked) -> None:
    """Half of the light is missing where it is lit; or a tenth in the penumbra alone."""
    dim = [replace(r, ratio=r.ratio / 2) for r in right.verdict.regions]
    unknown = told(right, verdict=WRONG, mistakes=(UNKNOWN,), regions=tuple(dim))
    assert kinds(unknown) == (REFUTED, *(UNTOLD,) * 5)
    hard = [
        replace(r, ratio=r.ratio * 0.7) if r.kind == "penumbra" else r
        for r in right.verdict.regions
    ]
    unknown = told(right, verdict=WRONG, mistakes=(UNKNOWN,), regions=tuple(hard))
    assert kinds(unknown) == (UNTOLD, REFUTED, *(UNTOLD,) * 4)
    loud = told(right, verdict=WRONG, mistakes=(UNKNOWN,), effective_samples=4.0)
    assert kinds(loud) == (UNTOLD, UNTOLD, REFUTED, REFUTED, UNTOLD, UNTOLD)


def test_what_cannot_be_told_refutes_nothing(right: Checked) -> None:
    assert kinds(told(right, verdict=CANNOT_TELL)) == (UNTOLD,) * 6


def test_mistakes_that_are_not_told_apart_cost_only_what_all_of_them_refute(
    right: Checked,
) -> None:
    wrong = told(right, verdict=WRONG, mistakes=("no_shadow",), alike=(("ambient_added",),))
    assert kinds(wrong)[:2] == (UNTOLD, UNTOLD)
    same = told(right, verdict=WRONG, mistakes=("no_shadow",), alike=(("shadow_ray_reversed",),))
    assert kinds(same)[:2] == (SHOWN, REFUTED)


def test_other_lights_are_judged_by_pictures_of_other_scenes(
    tmp_path: Path, right: Checked
) -> None:
    """What is wrong there, and not in the lab's scene, costs that claim alone."""
    two = "tp3_two_quads"
    averaged = checked(tmp_path, Variant(lights="averaged_over_lights"), scene=two)
    assert averaged.verdict.mistakes == ("averaged_over_lights",)
    assert kinds(right, (two, averaged)) == (*RIGHT_IMAGE[:5], REFUTED)
    assert kinds(right, (two, checked(tmp_path, Variant(), scene=two)))[5] == SHOWN
    disk = told(right, verdict=WRONG, mistakes=("no_shadow",))
    assert kinds(right, ("tp3_disk", disk)) == (*RIGHT_IMAGE[:5], REFUTED)


def test_threads_are_refuted_by_a_race_and_never_by_a_slow_machine(right: Checked) -> None:
    def program(*facts: tuple[str, str]) -> str:
        examined = Examined((), facts, right.diagnosis, (), (), 0.0)
        return kinds(replace(right, examined=examined))[4]

    race = ("race", "with several threads your picture is 0.90 times as bright as with one")
    assert program() == UNTOLD
    assert program(race) == REFUTED
    assert timed({"threads": 2, "ratio": 1.9}).state == SHOWN
    assert timed({"threads": 2, "ratio": 1.1}).state == UNTOLD
    assert "1.1 times" in timed({"threads": 2, "ratio": 1.1}).why[0]
    assert timed({"problem": "the grader's machine has one core"}).state == UNTOLD
    assert right.verdict.verdict == RIGHT_


@pytest.mark.parametrize("module", [claims, grade, gradebook, program])
def test_examples_in_docstrings_hold(module: ModuleType) -> None:
    tried = doctest.testmod(module)
    assert tried.attempted > 0 and tried.failed == 0
