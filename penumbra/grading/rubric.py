"""A rubric: how many points each claim is worth. Exact integers, so that a grade is a sum."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from penumbra.grading.claims import CLAIMS, HINTS, MISSING, REFUTED, TITLES, UNTOLD, State
from penumbra.language import N_, _, say

SHIPPED = Path(__file__).with_name("rubric.toml")
KEYS = ("title", "points", "titles")
MOST_POINTS = 1_000_000


class RubricError(ValueError):
    """A rubric that cannot be used; the text names file, line and key."""


@dataclass(frozen=True)
class Criterion:
    """What a claim is worth."""

    claim: str
    title: str
    points: int


@dataclass(frozen=True)
class Rubric:
    title: str
    criteria: tuple[Criterion, ...]

    @property
    def total(self) -> int:
        return sum(criterion.points for criterion in self.criteria)

    def json(self) -> dict[str, Any]:
        claims = [{"id": c.claim, "title": c.title, "points": c.points} for c in self.criteria]
        return {"title": self.title, "total": self.total, "claims": claims}

    def marks(self, states: Mapping[str, State], hint: int) -> list[dict[str, Any]]:
        """What the claims' states are worth, each with its reason: all of the points unless it is
        refuted, or nothing was handed in. hint: 0 to 3, how much the reasons give away."""
        assert 0 <= hint < HINTS
        return [
            {
                "id": criterion.claim,
                "title": criterion.title,
                "state": states[criterion.claim].state,
                "points": 0 if states[criterion.claim].state in (REFUTED, MISSING)
                else criterion.points,
                "of": criterion.points,
                "why": states[criterion.claim].why[hint],
            }
            for criterion in self.criteria
        ]  # fmt: skip


def for_instructor(marks: list[dict[str, Any]]) -> list[str]:
    """Claims that cannot be told and are worth something: somebody should look."""
    return [mark["id"] for mark in marks if mark["state"] == UNTOLD and mark["of"]]


def read_rubric(file: Path = SHIPPED) -> Rubric:
    """Raises RubricError."""
    try:
        text = file.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except FileNotFoundError:
        raise RubricError(say("{file}: no such file", file=file)) from None
    except OSError as error:
        raise RubricError(
            say("{file}: cannot be read: {strerror}", file=file, strerror=error.strerror)
        ) from error
    except ValueError as error:  # no UTF-8, or no TOML
        raise RubricError(
            say("{file}: is no TOML file: {error}", file=file, error=error)
        ) from error

    def wrong(key: str, message: str) -> RubricError:
        return RubricError(
            say(
                "{file}{line}: {key}: {message}",
                file=file,
                line=_line(text, key),
                key=key,
                message=message,
            )
        )

    for key in data:
        if key not in KEYS:
            raise wrong(key, say("unknown; a rubric has {keys}", keys=", ".join(KEYS)))
    title = data.get("title", N_("Soft shadows"))
    if not isinstance(title, str):
        raise wrong("title", _("not a text"))
    points, titles = data.get("points"), data.get("titles", {})
    if not isinstance(points, dict) or not points:
        raise RubricError(
            say("{file}: has no table [points] with a claim's points, as light_mean = 6", file=file)
        )
    if not isinstance(titles, dict):
        raise wrong("titles", _("not a table of texts"))
    for table in (points, titles):
        for claim in table:
            if claim not in CLAIMS:
                raise wrong(claim, say("no claim; there are {claims}", claims=", ".join(CLAIMS)))
    for claim, said in titles.items():
        if not isinstance(said, str):
            raise wrong(claim, _("its title is not a text"))
    for claim, worth in points.items():
        if not isinstance(worth, int) or isinstance(worth, bool):
            raise wrong(claim, say("{worth!r} points: whole numbers only, such as 6", worth=worth))
        if not 0 <= worth <= MOST_POINTS:
            raise wrong(
                claim,
                say("{worth} points: 0 to {most_points}", worth=worth, most_points=MOST_POINTS),
            )
    if not any(points.values()):
        raise RubricError(say("{file}: [points]: no claim is worth anything", file=file))
    return Rubric(
        _(title),
        tuple(
            Criterion(claim, titles.get(claim) or _(TITLES[claim]), points[claim])
            for claim in CLAIMS
            if claim in points
        ),
    )


def _line(text: str, key: str) -> str:
    """:NUMBER of the line that a key, or a table's name, stands in; "" if none does."""
    for number, line in enumerate(text.splitlines(), 1):
        if re.match(rf"""\s*\[?\s*["']?{re.escape(key)}["']?\s*[\]=]""", line):
            return f":{number}"
    return ""
