"""Where a shadow ray should start, as the study measured it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from penumbra.language import N_, _, say
from penumbra.report.figures import rate_maps
from penumbra.report.inputs import Data, Input
from penumbra.report.words import digits, interval, percent, power

_COMMAND = "penumbra self-shadow -o build/stability/self_shadow"
SELF_SHADOW = Input("stability/self_shadow.json", _COMMAND, "tp3")
SELF_SHADOW_CSV = Input("stability/self_shadow.csv", _COMMAND, "tp3")
TITLES = {
    "fixed": N_("fixed 1e-3 m"),
    "integer": N_("integer offset"),
    "bounded": N_("error bound"),
    "skip": N_("skip the surface"),
    "rounding": N_("hit point alone"),
}
"""In the figure's order: the four ways, and what none of them can avoid"""
MISTAKES = {"self_shadow": N_("false self-shadow"), "light_leak": N_("light leak")}


def self_shadow(data: Data) -> dict[str, Any]:
    """Four ways to start a shadow ray: how often each is wrong, on a map and all together."""
    measured, rows = data[SELF_SHADOW], data[SELF_SHADOW_CSV]
    verdict = {(v["precision"], v["strategy"]): v for v in measured["verdict"]}
    return {
        "svg": heat_map(rows, "float32"),
        "skip_wrong": percent_of(verdict["float32", "skip"]["wrong_rate"]),
        "floor_wrong": percent_of(verdict["float32", "rounding"]["wrong_rate"]),
        "scenes": [{"name": k, "text": _(v)} for k, v in measured["scenes"].items()],
        "rays": measured["rays"],
        "confidence": percent(measured["confidence"]),
        "verdict": [_verdict(v) for v in measured["verdict"]],
        "command": measured["command"],
    }


def _verdict(row: dict[str, Any]) -> dict[str, Any]:
    def rate(mistake: str) -> str:
        low, high = row[f"{mistake}_low"], row[f"{mistake}_high"]
        return f"{percent_of(row[f'{mistake}_rate'])} {interval(low, high, percent_of)}"

    return {
        "precision": row["precision"],
        "title": _(TITLES[row["strategy"]]),
        "rates": [rate(m) for m in ("self_shadow", "light_leak", "other_shadow")],
        "wrong": percent_of(row["wrong_rate"]),
        "beaten": say("{count} of {all}", count=row["cells_beaten"], all=row["cells"]),
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
        tuple(map(_, TITLES.values())),
        tuple(map(_, MISTAKES.values())),
        (_("translation [m]"), [power(t) for t in translations]),
        (_("scale"), [power(s) for s in scales]),
    )


def description(precision: str) -> str:
    return say(
        "Heat maps in {precision}: rates of false self-shadow and of light leaks against "
        "translation and scale, for a fixed offset, an integer offset, an error bound, skipping "
        "the surface, and the rounding of the hit point alone",
        precision=precision,
    )
