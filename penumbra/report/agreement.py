"""Whether the images agree with the exact solution and with each other, as compare judged it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from penumbra.compare.exact.image import BACKGROUND
from penumbra.report import figures
from penumbra.report.inputs import COMPARISONS, Data, best_image_file, reference_file
from penumbra.report.pictures import command_of, facts_of, figure_of, name_of
from penumbra.report.words import digits, fixed, interval, percent, signed_percent, times

RELATIVE_LIMIT = 0.02
"""End of the colour bar of relative differences."""
Z_LIMIT = 4.0
"""End of the colour bar of standardised differences."""


def agreement(data: Data) -> dict[str, Any]:
    tables = []
    for scene in dict.fromkeys(i.scene for i in COMPARISONS):
        compared = [data[i] for i in COMPARISONS if i.scene == scene and data.has(i)]
        rows = [row for comparison in compared for row in comparison["rows"]]
        tables.append(
            {
                "title": f"Scene {scene}",
                "summary": verdict_count(rows),
                "axis": f"{100 * _axis(rows):.3g}",
                "groups": [_agreement_group(data, comparison) for comparison in compared],
                "commands": [comparison["command"] for comparison in compared],
                "has_dark": any(row["relative_to"] != row["region"] for row in rows),
            }
        )
    rows = all_rows(data)
    return {
        "tables": tables,
        "confidence": " or ".join(percent(c) for c in sorted({row["confidence"] for row in rows})),
        "perceptual": _perceptual(data),
        "maps": _maps(data),
        "colour_stops": Markup(",".join(figures.diverging_stops())),
    }


def all_rows(data: Data) -> list[dict[str, Any]]:
    return [row for i in COMPARISONS if data.has(i) for row in data[i]["rows"]]


def verdict_count(rows: Sequence[dict[str, Any]]) -> str:
    counts = Counter(row["verdict"] for row in rows)
    words = [f"{counts['agrees']} of {len(rows)} agree"]
    if counts["differs"]:
        words.append(f"{counts['differs']} differ")
    if counts["undecided"]:
        words.append(f"{counts['undecided']} undecided")
    return ", ".join(words)


def _agreement_group(data: Data, comparison: dict[str, Any]) -> dict[str, Any]:
    rows = comparison["rows"]
    first = rows[0]
    axis = _axis(rows)
    return {
        "label": f"{name_of(data, first['image'])} against {name_of(data, first['reference'])}",
        "delta": percent(first["delta"]),
        "rows": [_agreement_row(row, axis) for row in rows],
    }


def _agreement_row(row: dict[str, Any], axis: float) -> dict[str, Any]:
    low, high = row["relative_low"], row["relative_high"]
    return {
        "region": row["region"].replace(":", ", "),
        "pixels": f"{row['pixels']:,}".replace(",", "\u202f"),
        "mean": digits(row["mean_image"]),
        "bias": signed_percent(row["relative_bias"]),
        "interval": interval(low, high, signed_percent),
        "dark": row["relative_to"] != row["region"],
        "detectable": digits(times(100, row["detectable_relative_bias"]), 2),
        "consistent": fixed(times(100, row["consistent_fraction"])),
        "verdict": row["verdict"],
        "note": row["note"],
        "plot": _whisker(row, axis),
    }


def _whisker(row: dict[str, Any], axis: float) -> dict[str, Any] | None:
    """The interval drawn 120 wide, zero at 60."""
    low, middle, high = (row[k] for k in ("relative_low", "relative_bias", "relative_high"))
    if low is None or middle is None or high is None:
        return None

    def at(value: float) -> float:
        return round(60 + 56 * max(-1.05, min(1.05, value / axis)), 2)

    delta = 56 * min(1.05, row["delta"] / axis)
    return {
        "low": at(low),
        "middle": at(middle),
        "high": at(high),
        "delta_low": round(60 - delta, 2),
        "delta_width": round(2 * delta, 2),
        "text": f"Interval from {signed_percent(low)} to {signed_percent(high)} percent",
    }


def _axis(rows: Iterable[dict[str, Any]]) -> float:
    """Half-width of the drawn intervals: twice the largest delta holds every agreement."""
    return 2 * max(row["delta"] for row in rows)


def _perceptual(data: Data) -> list[dict[str, str]]:
    """Of the comparisons made with --perceptual."""
    rows = []
    for comparison in (data[i] for i in COMPARISONS if data.has(i)):
        for region in ("all", "penumbra"):
            metrics = comparison["metrics"].get(region, {})
            if "flip" in metrics:
                rows.append(
                    {
                        "pair": f"{name_of(data, comparison['rows'][0]['image'])} against "
                        f"{name_of(data, comparison['rows'][0]['reference'])}",
                        "region": region,
                        "flip": digits(metrics["flip"]),
                        "delta_e": digits(metrics["delta_e"]),
                        "relative_rmse": digits(times(100, metrics["relative_rmse"])),
                    }
                )
    return rows


def _maps(data: Data) -> dict[str, Any]:
    """Figure 5."""
    files = (best_image_file("tp3"), reference_file("tp3"))
    maps = [_relative_map(data, file) for file in files]
    maps += [_z_map(data, file) for file in files if data.images[file].variance is not None]
    return figure_of(maps)


def _relative_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.relative_difference(data.images[file].radiance, data.truth(file).radiance)
    end = f"{100 * RELATIVE_LIMIT:g} %"
    return _map(data, file, values, RELATIVE_LIMIT, f"−{end}", f"+{end}", "relative difference")


def _z_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.standardised_difference(data.images[file], data.truth(file))
    end = f"{Z_LIMIT:g}"
    return _map(data, file, values, Z_LIMIT, f"−{end}", f"+{end}", "standardised difference z")


def _map(
    data: Data, file: str, values: np.ndarray, limit: float, low: str, high: str, what: str
) -> dict[str, Any]:
    image = data.images[file]
    background = data.truth(file).shadow == BACKGROUND
    name = name_of(data, file)
    return {
        "png": figures.png_uri(figures.diverging_map(values, limit, background)),
        "width": image.shape[1],
        "height": image.shape[0],
        "alt": f"Error map: {what} of {name} from exact, per pixel",
        "bar": what,
        "low": low,
        "high": high,
        "caption": f"{name} − exact: {what}",
        "facts": facts_of(image),
        "command": command_of(data, file),
    }
