"""grades.json made to measure, of the form that `penumbra grade` writes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

CLAIMS = (
    ("light_mean", "The light's mean", 6),
    ("penumbra", "The penumbra", 4),
    ("noise_law", "Noise falls as 1/N", 4),
    ("n_has_effect", "N has an effect", 2),
    ("threads", "Speed-up by threads", 2),
    ("other_lights", "Other lights", 2),
)
"""Of the shipped rubric: id, title, points"""
TOTAL = 20


def submission(name: str, states: str = "sssscc", **changes: Any) -> dict[str, Any]:
    """states: a letter a claim, s(hown) r(efuted) c(annot tell) m(issing)."""
    names = {"s": "shown", "r": "refuted", "c": "cannot tell", "m": "missing"}
    claims = [
        {
            "id": claim,
            "title": title,
            "state": names[state],
            "points": of if state in "sc" else 0,
            "of": of,
            "why": f"{title}: {names[state]}.",
        }
        for (claim, title, of), state in zip(CLAIMS, states, strict=True)
    ]
    wrong = "r" in states
    return {
        "id": name,
        "kind": "images",
        "status": "graded",
        "problem": None,
        "verdict": "wrong" if wrong else "right",
        "confidence": 0.99,
        "headline": "WRONG" if wrong else "RIGHT",
        "text": "WRONG (confidence 99%)\n\n  No cosine at the light\n" if wrong else "RIGHT\n",
        "mistakes": ["no_light_cosine"] if wrong else [],
        "titles": ["No cosine at the light"] if wrong else [],
        "perhaps": [],
        "alike": [],
        "facts": [],
        "points": sum(claim["points"] for claim in claims),
        "of": TOTAL,
        "claims": claims,
        "for_instructor": [c["id"] for c in claims if c["state"] == "cannot tell"],
        "pictures": [],
        "evidence": None,
    } | changes


def write_grades(file: Path, *submissions: dict[str, Any], **changes: Any) -> Path:
    file.write_text(json.dumps(grades(*submissions, **changes)))
    return file


def grades(*submissions: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {
        "schema": "penumbra-grades/1",
        "scene": "tp3",
        "hint": 1,
        "trusted": False,
        "rubric": {
            "title": "Direct lighting",
            "total": TOTAL,
            "claims": [{"id": i, "title": t, "points": p} for i, t, p in CLAIMS],
        },
        "submissions": sorted(submissions, key=lambda one: one["id"]),
        "mistakes": [],
        "versions": {"penumbra": "0.1.0"},
    } | changes
