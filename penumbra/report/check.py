"""How often `penumbra check` is right, as `make calibrate` measured it."""

from __future__ import annotations

import math
from typing import Any

from penumbra.language import N_, _, say
from penumbra.report.inputs import Data, Input
from penumbra.report.words import interval, percent, phrases

CALIBRATION = Input(
    "calibration.json",
    "make calibrate",
    "tp3",
    keys=("correct", "detected", "named", "confusion", "alike", "unknown"),
    shipped="docs/calibration.json",
)
SETTINGS = {
    "cases": N_("cases"),
    "correct": N_("correct"),
    "seed": N_("seed"),
    "reduced": N_("reduced"),
    "scenes": N_("scenes"),
    "light_samples": N_("light samples"),
    "pictures": N_("pictures"),
}
TRUE_OR_FALSE = N_("True"), N_("False")


def check(data: Data) -> dict[str, Any]:
    """Rates with their 95% intervals, the confusion matrix, and what cannot be told apart."""
    measured = data[CALIBRATION]
    correct, unknown = measured["correct"], measured["unknown"]
    return {
        "correct": correct | {"upper": percent(math.ceil(1000 * correct["upper"]) / 1000)},
        "rates": [
            _rate(_("wrong renderers that are called wrong"), measured["detected"], "found"),
            _rate(_("of these, the right name (or its class) first"), measured["named"], "first"),
        ],
        "unknown": {
            "count": _share(unknown["unknown"], unknown["n"]),
            "nearest": say("{count} got the nearest name", count=unknown["nearest"]),
        },
        "confusion": _confusion(measured["confusion"]),
        "alike": [_alike(*entry) for entry in measured["alike"]],
        "settings": _settings(measured.get("settings", {})),
        "command": CALIBRATION.command,
    }


def _rate(text: str, found: dict[str, Any], key: str) -> dict[str, Any]:
    return {
        "text": text,
        "count": _share(found[key], found["n"]),
        "rate": percent(found[key] / found["n"]) if found["n"] else "–",
        "interval": interval(found["low"], found["high"], percent),
    }


def _share(count: int, n: int) -> str:
    return say("{count} of {all}", count=count, all=n)


def _alike(first: str, second: str, scene: str) -> str:
    text = N_("{first} and {second}: {scene} tells") if scene else N_("{first} and {second}")
    return say(text, first=first, second=second, scene=scene)


def _confusion(matrix: dict[str, Any]) -> list[dict[str, Any]]:
    """A row for each mistake: what it was called, the most frequent first, as shares."""
    rows = []
    for name, counts in zip(matrix["rows"], matrix["counts"], strict=True):
        total = sum(counts)
        called = [
            {
                "name": column,
                "count": count,
                "share": round(100 * count / total, 1),
                "right": column == name,
            }
            for column, count in zip(matrix["columns"], counts, strict=True)
            if count
        ]
        called.sort(key=lambda cell: -cell["count"])
        rows.append({"name": name, "n": total, "called": called})
    return rows


def _settings(settings: dict[str, Any]) -> str:
    return phrases(
        say("{name}: {value}", name=_(SETTINGS.get(key, key)), value=_value(value))
        for key, value in settings.items()
    )


def _value(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else _(str(value))
