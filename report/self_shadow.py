"""Where a shadow ray should start, as the study measured it. The page does without where
it did not."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from report.figures import rate_maps
from report.inputs import Input, ReportError
from report.words import digits, percent

SELF_SHADOW = Input(
    "stability/self_shadow.json",
    "penumbra self-shadow -o build/stability/self_shadow",
    "tp3",
    needed=False,
)
TITLES = {
    "fixed": "fixed 1e-3 m",
    "integer": "integer offset",
    "bounded": "error bound",
    "skip": "skip the surface",
    "rounding": "hit point alone",
}
"""In the figure's order: the four ways, and what none of them can avoid"""
MISTAKES = {"self_shadow": "false self-shadow", "light_leak": "light leak"}
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def self_shadow(build_dir: Path) -> dict[str, Any]:
    """The section on self-shadowing; {"self_shadow": None} where it was not measured.

    Raises ReportError for files that are broken or do not belong together.
    """
    file = SELF_SHADOW.path(build_dir)
    if not file.is_file():
        return {"self_shadow": None}
    try:
        measured = json.loads(file.read_text())
        with file.with_suffix(".csv").open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        section = _section(measured, rows)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReportError(f"{file}: {error}; make it with: {SELF_SHADOW.command}") from error
    return {"self_shadow": section}


def _section(measured: dict[str, Any], rows: Sequence[dict[str, str]]) -> dict[str, Any]:
    verdict = {(v["precision"], v["strategy"]): v for v in measured["verdict"]}
    return {
        "svg": heat_map(rows, "float32"),
        "skip_wrong": percent_of(verdict["float32", "skip"]["wrong_rate"]),
        "floor_wrong": percent_of(verdict["float32", "rounding"]["wrong_rate"]),
        "scenes": [{"name": k, "text": v} for k, v in measured["scenes"].items()],
        "rays": measured["rays"],
        "confidence": percent(measured["confidence"]),
        "verdict": [_verdict(v) for v in measured["verdict"]],
        "command": measured["command"],
    }


def _verdict(row: dict[str, Any]) -> dict[str, Any]:
    def rate(mistake: str) -> str:
        low, high = (percent_of(row[f"{mistake}_{end}"]) for end in ("low", "high"))
        return f"{percent_of(row[f'{mistake}_rate'])} [{low}, {high}]"

    return {
        "precision": row["precision"],
        "title": TITLES[row["strategy"]],
        "rates": [rate(m) for m in ("self_shadow", "light_leak", "other_shadow")],
        "wrong": percent_of(row["wrong_rate"]),
        "beaten": f"{row['cells_beaten']} of {row['cells']}",
        "wins": row["wins"],
    }


def percent_of(rate: float) -> str:
    """
    >>> percent_of(0.1234567), percent_of(0.0)
    ('12.3', '0')
    """
    return digits(100 * rate)


def heat_map(rows: Sequence[dict[str, str]], precision: str) -> Markup:
    """Rates of MISTAKES (rows of panels) for each of TITLES (columns) over translation and
    scale, all scenes together, as inline SVG.

    rows: of compare.studies.self_shadow's CSV.
    """
    translations = sorted({float(r["translation"]) for r in rows})
    scales = sorted({float(r["scale"]) for r in rows})
    rates = np.full((len(MISTAKES), len(TITLES), len(scales), len(translations)), np.nan)
    for row in rows:
        if row["precision"] == precision and row["scene"] == "all":
            place = scales.index(float(row["scale"])), translations.index(float(row["translation"]))
            for i, mistake in enumerate(MISTAKES):
                if row[f"{mistake}_rate"]:
                    strategy = list(TITLES).index(row["strategy"])
                    rates[(i, strategy, *place)] = float(row[f"{mistake}_rate"])
    return rate_maps(
        f"self-shadow-{precision}",
        description(precision),
        rates,
        tuple(TITLES.values()),
        tuple(MISTAKES.values()),
        ("translation [m]", [power(t) for t in translations]),
        ("scale", [power(s) for s in scales]),
    )


def description(precision: str) -> str:
    return (
        f"Heat maps in {precision}: rates of false self-shadow and of light leaks against "
        "translation and scale, for a fixed offset, an integer offset, an error bound, skipping "
        "the surface, and the rounding of the hit point alone"
    )


def power(value: float) -> str:
    """
    >>> power(0.0), power(1.0), power(1e-6), power(20.0)
    ('0', '1', '10⁻⁶', '20')
    """
    if value == 0 or value == 1 or not math.log10(value).is_integer():
        return f"{value:g}"
    return "10" + f"{math.log10(value):.0f}".translate(SUPERSCRIPT)
