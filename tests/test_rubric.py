"""Points: exact integers of known claims, and a file that says where it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from penumbra.grading.claims import CLAIMS, HINTS, MISSING, REFUTED, SHOWN, UNTOLD, State
from penumbra.grading.rubric import RubricError, for_instructor, read_rubric


def test_the_shipped_rubric_has_every_claim_and_20_points() -> None:
    rubric = read_rubric()
    assert tuple(criterion.claim for criterion in rubric.criteria) == CLAIMS
    assert rubric.total == 20


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[points]\nlight_mean = 6\nnoise_low = 2\n", ":3: noise_low: no claim; there are"),
        ("[points]\nlight_mean = 6.5\n", ":2: light_mean: 6.5 points: whole numbers only"),
        ("[points]\nlight_mean = true\n", ":2: light_mean: True points: whole numbers only"),
        ("[points]\n\nthreads = -1\n", ":3: threads: -1 points: 0 to"),
        ("[points]\nlight_mean = '6'\n", ":2: light_mean: '6' points: whole numbers only"),
        ("points = 3\n", "has no table [points]"),
        ("[points]\n", "has no table [points]"),
        ("[points]\nthreads = 0\n", "no claim is worth anything"),
        ("[point]\nthreads = 1\n", ":1: point: unknown; a rubric has title, points, titles"),
        ("title = 3\n[points]\nthreads = 1\n", ":1: title: not a text"),
        ("[points]\nthreads = 1\n[titles]\nthreads = 1\n", "threads: its title is not a text"),
        ("[points]\nthreads = \n", "is no TOML file"),
    ],
)
def test_errors_name_file_line_and_key(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(RubricError) as error:
        read_rubric(file)
    assert str(error.value).startswith(str(file)) and said in str(error.value)


def test_a_rubric_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RubricError, match=r"no\.toml: no such file"):
        read_rubric(tmp_path / "no.toml")


def test_only_what_is_refuted_or_missing_costs_points(tmp_path: Path) -> None:
    """3 + 4 of 3 + 4 + 5 + 6, and claims that the rubric lacks do not appear."""
    file = tmp_path / "mine.toml"
    file.write_text(
        "[points]\nlight_mean = 3\npenumbra = 4\nnoise_law = 5\nthreads = 6\nother_lights = 0\n"
        '[titles]\nthreads = "Fils"\n'
    )
    rubric = read_rubric(file)
    kinds = (SHOWN, UNTOLD, REFUTED, SHOWN, MISSING, UNTOLD)
    whys = tuple(str(hint) for hint in range(HINTS))
    states = {claim: State(kind, whys) for claim, kind in zip(CLAIMS, kinds, strict=True)}
    marks = rubric.marks(states, 2)
    assert [mark["points"] for mark in marks] == [3, 4, 0, 0, 0]
    assert [mark["of"] for mark in marks] == [3, 4, 5, 6, 0]
    assert {mark["why"] for mark in marks} == {"2"}
    assert marks[3]["title"] == "Fils"
    assert for_instructor(marks) == ["penumbra"]  # other_lights is worth nothing
