"""What `make calibrate` measures in full, on 53 small pictures."""

from __future__ import annotations

from typing import Any

import pytest

from penumbra.compare.check.calibration import few, interval, judged, left_out, named, upper
from penumbra.compare.check.specimens import Specimen
from penumbra.compare.check.verdict import UNKNOWN, WRONG

Said = list[tuple[Specimen, dict[str, Any]]]


def said_of(kind: str) -> Said:
    return list(judged([s for s in few() if s.kind == kind], jobs=1))


def test_no_correct_renderer_is_accused() -> None:
    """32 of them, of three programs, in every form that a picture has."""
    right = said_of("correct")
    assert len(right) == 32
    assert [(s, words) for s, words in right if words["verdict"] == WRONG] == []


def test_every_mistake_is_found_and_named() -> None:
    """12 mistakes at N = 16, each of which shows in tp3."""
    ones = said_of("single")
    assert len(ones) == 12
    assert [(s, words) for s, words in ones if not named(s, words)] == []


def test_of_two_mistakes_both_are_found_and_none_other() -> None:
    twos = said_of("pair")
    assert len(twos) == 5
    for specimen, words in twos:
        assert words["verdict"] == WRONG
        assert words["mistakes"], specimen
        assert set(words["mistakes"]) <= set(specimen.variant.mistakes), specimen


def test_a_mistake_that_the_catalogue_lacks_is_unknown() -> None:
    lacking = said_of("left out")
    assert len(lacking) == 4
    assert [(s, words) for s, words in lacking if UNKNOWN not in words["mistakes"]] == []
    assert left_out(lacking)["nearest"] == 0


def test_intervals_are_those_of_clopper_and_pearson() -> None:
    """None of n: the two-sided one ends where (1 - p)^n = 0.025, the one-sided where it is 0.05."""
    low, high = interval(0, 100)
    assert low == 0
    assert high == pytest.approx(1 - 0.025**0.01)
    assert upper(0, 500) == pytest.approx(1 - 0.05 ** (1 / 500))
    assert interval(100, 100)[1] == 1
