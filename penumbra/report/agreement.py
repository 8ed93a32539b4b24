"""Whether the images agree with the exact solution and with each other, as compare judged it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from penumbra.compare.exact.image import BACKGROUND
from penumbra.compare.measure.statistics import TOO_FEW_TILES
from penumbra.language import N_, _, localised, say
from penumbra.report import figures
from penumbra.report.inputs import COMPARISONS, Data, best_image_file, reference_file
from penumbra.report.pictures import command_of, facts_of, figure_of, name_of
from penumbra.report.words import (
    against,
    any_of,
    digits,
    fixed,
    interval,
    percent,
    plain,
    region_word,
    signed_percent,
    times,
)

RELATIVE_LIMIT = 0.02
"""End of the colour bar of relative differences."""
Z_LIMIT = 4.0
"""End of the colour bar of standardised differences."""
VERDICTS = {"agrees": N_("agrees"), "differs": N_("differs"), "undecided": N_("undecided")}


def agreement(data: Data) -> dict[str, Any]:
    tables = []
    for scene in dict.fromkeys(i.scene for i in COMPARISONS):
        compared = [data[i] for i in COMPARISONS if i.scene == scene and data.has(i)]
        rows = [row for comparison in compared for row in comparison["rows"]]
        tables.append(
            {
                "title": say("Scene {scene}", scene=scene),
                "label": say("Agreement, scene {scene}", scene=scene),
                "summary": verdict_count(rows),
                "axis": plain(f"{100 * _axis(rows):.3g}"),
                "groups": [_agreement_group(data, comparison) for comparison in compared],
                "commands": [comparison["command"] for comparison in compared],
                "has_dark": any(row["relative_to"] != row["region"] for row in rows),
            }
        )
    rows = all_rows(data)
    return {
        "tables": tables,
        "confidence": any_of([percent(c) for c in sorted({row["confidence"] for row in rows})]),
        "perceptual": _perceptual(data),
        "maps": _maps(data),
        "colour_stops": Markup(",".join(figures.diverging_stops())),
    }


def all_rows(data: Data) -> list[dict[str, Any]]:
    return [row for i in COMPARISONS if data.has(i) for row in data[i]["rows"]]


def verdict_count(rows: Sequence[dict[str, Any]]) -> str:
    return ", ".join(verdict_words(rows))


def verdict_words(rows: Sequence[dict[str, Any]]) -> list[str]:
    """How many agree, and how many do not, if any."""
    counts = Counter(row["verdict"] for row in rows)
    words = [say("{count} of {all} agree", count=counts["agrees"], all=len(rows))]
    if counts["differs"]:
        words.append(say("{count} differ", count=counts["differs"]))
    if counts["undecided"]:
        words.append(say("{count} undecided", count=counts["undecided"]))
    return words


def _agreement_group(data: Data, comparison: dict[str, Any]) -> dict[str, Any]:
    rows = comparison["rows"]
    first = rows[0]
    axis = _axis(rows)
    return {
        "label": against(name_of(data, first["image"]), name_of(data, first["reference"])),
        "delta": percent(first["delta"]),
        "rows": [_agreement_row(row, axis) for row in rows],
    }


def _agreement_row(row: dict[str, Any], axis: float) -> dict[str, Any]:
    low, high = row["relative_low"], row["relative_high"]
    return {
        "region": region_word(row["region"]),
        "pixels": f"{row['pixels']:,}".replace(",", "\u202f"),
        "mean": digits(row["mean_image"]),
        "bias": signed_percent(row["relative_bias"]),
        "interval": interval(low, high, signed_percent),
        "dark": row["relative_to"] != row["region"],
        "detectable": digits(times(100, row["detectable_relative_bias"]), 2),
        "consistent": fixed(times(100, row["consistent_fraction"])),
        "verdict": row["verdict"],
        "word": _(VERDICTS[row["verdict"]]),
        "note": _note(row["note"]),
        "plot": _whisker(row, axis),
    }


def _note(text: str) -> str:
    """Why a region was not judged."""
    pattern = re.sub(r"\\{(\w+)\\}", r"(?P<\1>.+)", re.escape(TOO_FEW_TILES))
    found = re.fullmatch(pattern, text)
    if found is None:
        return _(text)
    return say(TOO_FEW_TILES, **{key: localised(v) for key, v in found.groupdict().items()})


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
        "text": say(
            "Interval from {low} to {high} percent",
            low=signed_percent(low),
            high=signed_percent(high),
        ),
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
                        "pair": against(
                            name_of(data, comparison["rows"][0]["image"]),
                            name_of(data, comparison["rows"][0]["reference"]),
                        ),
                        "region": region_word(region),
                        "flip": digits(metrics["flip"]),
                        "delta_e": digits(metrics["delta_e"]),
                        "relative_rmse": digits(times(100, metrics["relative_rmse"])),
                    }
                )
    return rows


def _maps(data: Data) -> dict[str, Any]:
    """Figure 3."""
    files = (best_image_file("tp3"), reference_file("tp3"))
    maps = [_relative_map(data, file) for file in files]
    maps += [_z_map(data, file) for file in files if data.images[file].variance is not None]
    return figure_of(maps)


def _relative_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.relative_difference(data.images[file].radiance, data.truth(file).radiance)
    what = _("relative difference")
    end = percent(RELATIVE_LIMIT)
    return _map(data, file, values, RELATIVE_LIMIT, f"−{end}", f"+{end}", what)


def _z_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.standardised_difference(data.images[file], data.truth(file))
    what = _("standardised difference z")
    end = plain(f"{Z_LIMIT:g}")
    return _map(data, file, values, Z_LIMIT, f"−{end}", f"+{end}", what)


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
        "alt": say("Error map: {what} of {name} from exact, per pixel", what=what, name=name),
        "scale": say(
            "Colour bar: {what}, from {low} (purple) through 0 (white) to {high} (orange)",
            what=what,
            low=low,
            high=high,
        ),
        "low": low,
        "high": high,
        "caption": say("{name} − exact: {what}", name=name, what=what),
        "facts": facts_of(image),
        "command": command_of(data, file),
    }
