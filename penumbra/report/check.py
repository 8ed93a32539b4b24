"""How often `penumbra check` is right, as `make calibrate` measured it."""

from __future__ import annotations

import math
from typing import Any

from penumbra.report.inputs import Data, Input
from penumbra.report.words import percent

CALIBRATION = Input(
    "calibration.json",
    "make calibrate",
    "tp3",
    keys=("correct", "detected", "named", "confusion", "alike", "unknown"),
    shipped="docs/calibration.json",
)


def check(data: Data) -> dict[str, Any]:
    """Rates with their 95% intervals, the confusion matrix, and what cannot be told apart."""
    measured = data[CALIBRATION]
    correct, unknown = measured["correct"], measured["unknown"]
    return {
        "correct": correct | {"upper": percent(math.ceil(1000 * correct["upper"]) / 1000)},
        "rates": [
            _rate("wrong renderers that are called wrong", measured["detected"], "found"),
            _rate("of these, the right name (or its class) first", measured["named"], "first"),
        ],
        "unknown": unknown,
        "confusion": _confusion(measured["confusion"]),
        "alike": measured["alike"],
        "settings": _plain(measured.get("settings", {})),
        "command": CALIBRATION.command,
    }


def _rate(text: str, found: dict[str, Any], key: str) -> dict[str, Any]:
    return {
        "text": text,
        "count": found[key],
        "n": found["n"],
        "rate": percent(found[key] / found["n"]) if found["n"] else "–",
        "interval": f"[{percent(found['low'])}, {percent(found['high'])}]",
    }


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


def _plain(settings: dict[str, Any]) -> str:
    return "; ".join(f"{key.replace('_', ' ')}: {_listed(v)}" for key, v in settings.items())


def _listed(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
