"""Where floats break, as the study measured it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from penumbra.language import N_, _, localised, say
from penumbra.report.figures import Line, log_chart
from penumbra.report.inputs import Data, Input
from penumbra.report.words import all_of, digits, phrases, power, signed_power

STABILITY = Input(
    "stability/stability.json",
    "penumbra stability -o build/stability/stability",
    "tp3",
)
CURVES = {
    ("area", "float32"): (N_("sampled, float32"), "#0072b2", "o", "-"),
    ("exact", "float32"): (N_("closed form, float32"), "#d55e00", "^", "--"),
    ("textbook", "float64"): (N_("sampled, float64"), "#009e73", "s", "-"),
}
"""Those that are drawn: label, colour, marker, dashes; the CSV holds the others too."""
SUM_COLOURS = ("#d55e00", "#cc79a7", "#009e73", "#0072b2", "#222222")
SMALLEST = 1e-17
"""Errors of 0 are drawn there."""
SUMS = N_("naive"), N_("pairwise"), N_("compensated"), N_("chunks"), N_("double")
"""Names of compare.studies.stability's"""
CAUSES = {
    "cancellation": (
        N_("Cancellation"),
        N_(
            "Two numbers that are almost equal are subtracted: what remains is made of digits that "
            "rounding had already spoilt."
        ),
    ),
    "absorption": (
        N_("Absorption"),
        N_("A small number is added to a large one, in whose last digit it vanishes."),
    ),
    "overflow": (
        N_("Overflow"),
        N_("A number grows without bound, up to the largest float."),
    ),
    "underflow": (
        N_("Underflow"),
        N_("A product becomes smaller than floats with all their digits are."),
    ),
    "none": (
        N_("Nothing to lose"),
        N_("Not everything extreme is dangerous."),
    ),
}
"""Title and meaning"""


def stability(data: Data) -> dict[str, Any]:
    """The stability map, the sweeps, pixels near a light, and sums of many samples."""
    measured = data[STABILITY]
    return {
        "groups": [
            {
                "cause": cause,
                "title": _(title),
                "text": _(text),
                "count": _count([s for s in measured["sweeps"] if s["failure"] == cause]),
                "sweeps": [
                    _sweep(s, measured["limits"])
                    for s in measured["sweeps"]
                    if s["failure"] == cause
                ],
            }
            for cause, (title, text) in CAUSES.items()
        ],
        "rows": [_row(s, measured["limits"]) for s in measured["sweeps"]],
        "limits": all_of([power(limit) for limit in measured["limits"]]),
        "map": {"cells": measured["map"], "limits": measured["limits"]},
        "trust": _trust(measured["trust"]),
        "sums": _sums(measured["sums"]),
        "light_samples": measured["light_samples"],
        "images": measured["images"],
        "bad": measured["nan"] + measured["inf"] + measured["negative"],
        "command": measured["command"],
        "machine": measured["machine"]["processor"],
    }


def _count(sweeps: Sequence[dict[str, Any]]) -> str:
    return _("one sweep") if len(sweeps) == 1 else say("{count} sweeps", count=len(sweeps))


def _sweep(sweep: dict[str, Any], limits: Sequence[float]) -> dict[str, Any]:
    values = sweep["curves"][0]["values"]
    lines = []
    for curve in sweep["curves"]:
        key = curve["estimator"], curve["precision"]
        if key in CURVES:
            label, colour, marker, dashes = CURVES[key]
            errors = [max(e, SMALLEST) for e in curve["errors"]]
            lines.append(Line(_(label), range(len(values)), errors, colour, marker, dashes))
    first = sweep["curves"][0]
    title, parameter = _(sweep["title"]), sweep["parameter"]
    described = say(
        "{title}: relative error against {parameter}; largest in float32 {error}",
        title=title,
        parameter=parameter,
        error=digits(max(first["errors"])),
    )
    example = sweep["example"]
    return {
        "name": sweep["name"],
        "title": title,
        "text": _(sweep["text"]),
        "svg": log_chart(
            f"stability-{sweep['name']}", described, lines, parameter,
            [signed_power(v) for v in values], limits,
        ),
        "boundary": say("float32: {boundary}", boundary=_boundary(first, limits)),
        "example": {
            "what": say(
                "{name} = {value}: error {error}",
                name=parameter.partition(" ")[0],
                value=signed_power(example["value"]),
                error=digits(example["error"]),
            ),
            "text": json.dumps(example["scene"], indent=1),
            "commands": [f"# {example['file']}", *example["commands"]],
        },
    }  # fmt: skip


def _boundary(curve: dict[str, Any], limits: Sequence[float]) -> str:
    """Where the program's float32 passes each limit."""
    said = []
    for limit in limits:
        crossings = curve["crossings"][f"{limit:g}"]
        if crossings:
            places = [signed_power(float(f"{c:.2g}")) for c in sorted(set(crossings))]
            said.append(say("{limit} at {places}", limit=power(limit), places=all_of(places)))
    if said:
        return phrases(said)
    return say("never above {error}", error=digits(max(curve["errors"]), 2))


def _row(sweep: dict[str, Any], limits: Sequence[float]) -> dict[str, Any]:
    curves = {(c["estimator"], c["precision"]): c for c in sweep["curves"]}
    values = sweep["curves"][0]["values"]
    return {
        "title": _(sweep["title"]),
        "name": sweep["name"],
        "range": say(
            "{parameter}: {first} to {last}",
            parameter=sweep["parameter"],
            first=signed_power(min(values)),
            last=signed_power(max(values)),
        ),
        "cause": sweep["failure"],
        "worst": [digits(max(curves[key]["errors"]), 2) for key in CURVES],
        "boundary": _boundary(sweep["curves"][0], limits),
    }


# Pixels near a light


def _trust(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    heights = sorted({row["height"] for row in rows})
    counts = sorted({row["light_samples"] for row in rows})
    few, many = counts[len(counts) // 2], counts[-1]
    lines = []
    for estimator, colour in (("area", "#0072b2"), ("solid-angle", "#d55e00")):
        for count, dashes in ((few, "-"), (many, "--")):
            here = [r for r in rows if (r["estimator"], r["light_samples"]) == (estimator, count)]
            here.sort(key=lambda row: row["height"])
            lines.append(
                Line(
                    f"{estimator}, N = {count}",
                    [heights.index(r["height"]) for r in here],
                    [r["relative_rmse"] for r in here],
                    colour, "o", dashes,
                    hollow=[r["untrusted"] > 0 for r in here],
                )
            )  # fmt: skip
    described = _(
        "Relative RMS error of N samples against the height of a light over the floor: spread "
        "over the area it grows as 1 / h, over the solid angle it stays"
    )
    return {
        "svg": log_chart(
            "stability-trust", described, lines, "h [m]", [signed_power(h) for h in heights],
            (), size=(6.2, 3.4),
        ),
        "rows": [
            {
                "height": signed_power(h),
                "cells": [
                    {"error": digits(r["relative_rmse"], 2), "untrusted": r["untrusted"] > 0}
                    for e in ("area", "solid-angle")
                    for r in rows
                    if (r["height"], r["estimator"]) == (h, e)
                ],
            }
            for h in heights
        ],
        "counts": counts,
    }  # fmt: skip


# Sums of many samples


def _sums(rows: Sequence[dict[str, Any]]) -> Markup:
    names = list(dict.fromkeys(row["sum"] for row in rows))
    counts = sorted({row["light_samples"] for row in rows})
    lines = [
        Line(
            _(name),
            range(len(counts)),
            [max(r["relative_error"], SMALLEST) for r in rows if r["sum"] == name],
            colour, "o", "-",
        )
        for name, colour in zip(names, SUM_COLOURS, strict=True)
    ]  # fmt: skip
    return log_chart(
        "stability-sums",
        _("Relative error of the sum of N float32 samples: naive summation loses digits as N "
          "grows, pairwise, compensated and chunked sums do not"),
        lines, "N", [localised(f"{n:,}") for n in counts], (), size=(6.2, 3.4),
    )  # fmt: skip
