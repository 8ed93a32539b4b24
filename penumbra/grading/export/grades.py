"""grades.json as the exporters read it: what is for the student, and what for the instructor."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from penumbra.language import N_, _, say

SCHEMA = "penumbra-grades/1"
SHOWN, REFUTED, CANNOT_TELL, MISSING = "shown", "refuted", "cannot tell", "missing"
STATES = (SHOWN, REFUTED, CANNOT_TELL, MISSING)
"""Of a claim"""
LEFT_OPEN = N_(" (It costs nothing: your instructor may look at it.)")
"""Said of what cannot be told"""
INTERNAL = "internal"
"""The problem that is a fault of Penumbra's, and no submission's"""
Value = TypeVar("Value")


class GradesError(ValueError):
    """Grades that cannot be exported; the text says why, and what to do."""


@dataclass(frozen=True)
class Claim:
    """One line of the rubric, for one submission."""

    id: str
    title: str
    state: str
    """of STATES"""
    points: int
    of: int
    why: str

    @property
    def reason(self) -> str:
        """What the student reads of it"""
        return self.why + (_(LEFT_OPEN) if self.state == CANNOT_TELL else "")


@dataclass(frozen=True)
class Submission:
    id: str
    """its folder's name, escaped by `penumbra grade`: the student's own words"""
    problem: str
    """code of why nothing could be judged, or empty"""
    verdict: str
    headline: str
    text: str
    """what `penumbra check` prints, at the hint level of the grades"""
    points: int
    of: int
    claims: tuple[Claim, ...]
    mistakes: tuple[str, ...]
    """their titles; for the instructor"""
    for_instructor: tuple[str, ...]
    """titles of the claims that cannot be told: full points, and somebody's look"""

    @property
    def details(self) -> str:
        """What the text says beyond the headline."""
        first, _, rest = self.text.partition("\n")
        return (rest if first.startswith(self.headline) else self.text).strip("\n")


@dataclass(frozen=True)
class Grades:
    scene: str
    title: str
    """the rubric's"""
    total: int
    submissions: tuple[Submission, ...]
    version: str
    """of Penumbra"""
    language: str = "en"
    """of their texts, one of LANGUAGES"""

    def one(self, name: str | None = None) -> Submission:
        """The submission of that id, without a name the only one, for a tool that shows its grade
        at once. Raises GradesError, also for one that Penumbra failed to judge: its points stand
        until the instructor has looked, which nobody would."""
        is_only = name is None and len(self.submissions) == 1
        found = [one for one in self.submissions if is_only or one.id == name]
        if found and found[0].problem == INTERNAL:
            raise GradesError(
                say(
                    "{id}: not judged, so no grade: {headline}",
                    id=found[0].id,
                    headline=found[0].headline,
                )
            )
        if found:
            return found[0]
        ids = ", ".join(one.id for one in self.submissions[:8])
        ids += ", ..." if len(self.submissions) > 8 else ""
        if name is None:
            raise GradesError(
                say(
                    "{count} submissions, and this format holds one: give --submission ID, "
                    "one of {ids}",
                    count=len(self.submissions),
                    ids=ids,
                )
            )
        raise GradesError(
            say("--submission {name}: none of that id; there are {ids}", name=name, ids=ids)
        )


def read_grades(file: Path) -> Grades:
    """What `penumbra grade` wrote. Raises OSError; GradesError, which names file and key."""
    try:
        whole = json.loads(file.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise GradesError(say("{file}: not JSON: {error}", file=file, error=error)) from error
    found = whole.get("schema") if isinstance(whole, dict) else None
    if found != SCHEMA:
        raise GradesError(
            say(
                "{file}: schema: {found}, not {schema}: give the grades.json that `penumbra grade` "
                "wrote",
                file=file,
                found=json.dumps(found),
                schema=json.dumps(SCHEMA),
            )
        )
    try:
        rubric = _get(whole, "rubric", dict)
        return Grades(
            _get(whole, "scene", str),
            _get(rubric, "title", str, "rubric."),
            _get(rubric, "total", int, "rubric."),
            tuple(
                _submission(one, f"submissions[{i}].")
                for i, one in enumerate(_get(whole, "submissions", list))
            ),
            _get(_get(whole, "versions", dict), "penumbra", str, "versions."),
            "fr" if whole.get("language") == "fr" else "en",
        )
    except GradesError as error:
        raise GradesError(say("{file}: {error}", file=file, error=error)) from None


def scaled(points: int, of: int, out_of: Fraction | None) -> str:
    """Points on the scale of the tool, in decimals without an exponent, at most two.

    Halves are rounded up, as people do. out_of: the tool's best grade; None: the rubric's own.

    >>> scaled(14, 20, None), scaled(14, 20, Fraction(100)), scaled(1, 8, Fraction(1))
    ('14', '70', '0.13')
    """
    exact = Fraction(points) if out_of is None else Fraction(points, of) * out_of
    hundredths = int(exact * 100 + Fraction(1, 2))
    return f"{hundredths // 100}.{hundredths % 100:02d}".rstrip("0").rstrip(".")


def _submission(data: Any, where: str) -> Submission:
    if not isinstance(data, dict):
        raise GradesError(say("{key}: not an object", key=where.rstrip(".")))
    problem = data.get("problem")
    claims = tuple(
        _claim(one, f"{where}claims[{i}].")
        for i, one in enumerate(_get(data, "claims", list, where))
    )
    titles = {claim.id: claim.title for claim in claims}
    points, of = _get(data, "points", int, where), _get(data, "of", int, where)
    if sum(claim.points for claim in claims) != points or not 0 <= points <= of:
        raise GradesError(
            say(
                "{where}points: {points} of {of} is not the sum of its claims",
                where=where,
                points=points,
                of=of,
            )
        )
    return Submission(
        _get(data, "id", str, where),
        _get(problem, "code", str, f"{where}problem.") if problem else "",
        _get(data, "verdict", str, where),
        _get(data, "headline", str, where),
        _get(data, "text", str, where),
        points,
        of,
        claims,
        tuple(map(str, _get(data, "titles", list, where))),
        tuple(titles.get(str(one), str(one)) for one in _get(data, "for_instructor", list, where)),
    )


def _claim(data: Any, where: str) -> Claim:
    state = _get(data, "state", str, where)
    if state not in STATES:
        raise GradesError(
            say(
                "{where}state: {state} is none of {states}",
                where=where,
                state=json.dumps(state),
                states=", ".join(STATES),
            )
        )
    return Claim(
        _get(data, "id", str, where),
        _get(data, "title", str, where),
        state,
        _get(data, "points", int, where),
        _get(data, "of", int, where),
        _get(data, "why", str, where),
    )


def _get(data: Any, key: str, kind: type[Value], where: str = "") -> Value:
    value = data.get(key) if isinstance(data, Mapping) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        raise GradesError(
            say("{where}{key}: missing, or not {kind}", where=where, key=key, kind=_(_KINDS[kind]))
        )
    return value


_KINDS = {str: N_("a text"), int: N_("a whole number"), list: N_("a list"), dict: N_("an object")}
