"""What a millisecond buys, as the study measured it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from penumbra.compare.measure.image import read_image
from penumbra.compare.studies.choice import (
    answer_text,
    duration,
    options,
    place,
    verdict_text,
)
from penumbra.compare.studies.choice import percent as error_text
from penumbra.language import N_, _, say
from penumbra.report import figures
from penumbra.report.figures import Crop
from penumbra.report.inputs import Data, Input
from penumbra.report.pictures import detail, edge_window
from penumbra.report.words import digits, fixed, interval, percent, region_title, size_of

TRADE = Input(
    "trade/tp3.json",
    "penumbra trade scenes/tp3.json -o build/trade/tp3 --keep-images "
    "--verify scenes/small_light.json scenes/three_spheres.json --cycles",
    "tp3",
)
COLOURS = {"independent": "#0072b2", "jittered": "#009e73", "sobol": "#c2528b"}
CYCLES_COLOUR, OTHER_COLOUR = "#d55e00", "#222222"
SHAPES = {"area": "circle", "textbook": "triangle", "solid-angle": "diamond"}
OTHER_SHAPE = "star"
FRACTIONS = {-0.5: "−1/2", -0.75: "−3/4", -1.0: "−1", -1.5: "−3/2"}
SLOPE_REGIONS = ("lit", "penumbra", "all")
VERDICTS = {
    "reached": "agrees",
    "missed": "differs",
    "impossible": "differs",
    "undecided": "undecided",
}
"""As agreement's verdicts look"""
VERDICT_WORDS = {
    "reached": N_("reached"),
    "missed": N_("missed"),
    "impossible": N_("impossible"),
    "undecided": N_("undecided"),
}
STRIPS = {
    "equal_time": N_("Equal time: at most 3 ms a frame"),
    "equal_error": N_("Equal error: at most 1% in the penumbra"),
}


def trade(data: Data) -> dict[str, Any]:
    """Figures 8 and 9, the answers, their trial and the slopes.

    Raises ValueError for a trade of another scene, ImageError for a broken or missing image.
    """
    measured = data[TRADE]
    if measured["scene_hash"] != data.scenes["tp3"].hash:
        raise ValueError("shows another scene than scenes/tp3.json does now")
    most = _threads(measured)[-1]
    first = _headline(measured["answers"])
    return {
        "sentence": _with_code(answer_text(first), options(first["choice"])) if first else "",
        "plot": _plot(measured),
        "caption": say(
            "Scene {scene}, {size}, M = 1. Medians of {seeds} frames of each setting, which took "
            "turns; errors are relative RMSE against the exact solution over the same frames. "
            "Time: {clock}; for Cycles its own render time on every core, in one process too.",
            scene=measured["scene"],
            size=size_of(measured),
            seeds=measured["seeds"],
            clock=_(measured["clock"]),
        ),
        "confidence": percent(measured["confidence"]),
        "threads": most,
        "frontier": [_row(r) for r in measured["rows"] if r["on_frontier"]],
        "answers": _answers(measured["answers"]),
        "other_names": list(
            dict.fromkeys(_(o["name"]) for a in measured["answers"] for o in a["others"])
        ),
        "trials": [_trial(t) for t in measured["trials"] if t["verdict"] in VERDICTS],
        "verdict": verdict_text(measured["trials"]) if measured["trials"] else "",
        "slopes": _slopes(measured["slopes"]),
        "strips": _strips(data, measured),
        "command": measured["command"],
        "machine": say(
            "{processor}, {cores} cores",
            processor=measured["machine"]["processor"],
            cores=measured["machine"]["cores"],
        ),
    }


def _headline(answers: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The answer for 1% in the penumbra, or another where it was not asked."""
    wanted = sorted(
        (a for a in answers if a["choice"]),
        key=lambda a: (a["region"] != "penumbra", abs(a["target"] - 0.01)),
    )
    return wanted[0] if wanted else None


def _threads(measured: dict[str, Any]) -> list[int]:
    """That the C renderer was measured with. Cycles always takes every core."""
    return sorted({row["threads"] for row in measured["rows"] if row["renderer"] == "penumbra"})


def _with_code(text: str, command: str) -> Markup:
    before, found, after = text.partition(command)
    return escape(before) + Markup("<code>{}</code>").format(found) + escape(after)


# Figure 8


def _plot(measured: dict[str, Any]) -> dict[str, Any]:
    """All rows, for trade.js."""
    series: dict[tuple[Any, ...], dict[str, Any]] = {}
    points = []
    for row in measured["rows"]:
        key = tuple(row[k] for k in ("renderer", "sampler", "estimator"))
        entry = series.setdefault(key, _series(row) | {"index": len(series)})
        points.append(
            {
                "series": entry["index"],
                "region": row["region"],
                "threads": row["threads"] if row["renderer"] == "penumbra" else None,
                "n": row["light_samples"],
                "x": row["seconds"],
                "y": row["relative_rmse"],
                "frontier": row["on_frontier"],
                "options": options(row),
                "time": duration(row["seconds"]),
                "error": error_text(row["relative_rmse"]),
                "timeRange": _range(row["seconds_low"], row["seconds_high"], duration),
                "errorRange": _range(row["low"], row["high"], error_text),
                "efficiency": digits(row["efficiency"]),
            }
        )
    return {
        "scene": measured["scene"],
        "series": list(series.values()),
        "points": points,
        "regions": [{"name": r, "title": region_title(r)} for r in measured["regions"]],
        "threads": _threads(measured),
        "targets": [{"y": t, "text": error_text(t)} for t in measured["targets"]],
    }


def _range(low: float, high: float, text: Callable[[float], str]) -> str:
    return say("{first} to {last}", first=text(low), last=text(high))


def _series(row: dict[str, Any]) -> dict[str, str]:
    if row["renderer"] == "cycles":
        colour, shape = CYCLES_COLOUR, "square"
    else:
        colour = COLOURS.get(row["sampler"], OTHER_COLOUR)
        shape = SHAPES.get(row["estimator"], OTHER_SHAPE)
    return {"label": _method(row), "colour": colour, "shape": shape}


def _method(row: dict[str, Any]) -> str:
    if row["renderer"] == "cycles":
        return "Cycles"
    return ", ".join(word for word in (row["sampler"], row["estimator"]) if word)


def _row(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "region": region_title(row["region"]),
        "threads": row["threads"],
        "method": _method(row),
        "n": row["light_samples"] or "–",
        "time": f"{duration(row['seconds'])} "
        + interval(row["seconds_low"], row["seconds_high"], duration),
        "error": f"{error_text(row['relative_rmse'])} "
        + interval(row["low"], row["high"], error_text),
        "efficiency": digits(row["efficiency"]),
    }


# Tables


def _answers(answers: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """By region, a row a target."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for a in answers:
        choice = a["choice"]
        groups.setdefault(a["region"], []).append(
            {
                "target": error_text(a["target"]),
                "options": options(choice) if choice else _("no measured setting"),
                "time": duration(choice["seconds"]) if choice else "–",
                "error": error_text(choice["relative_rmse"]) if choice else "–",
                "others": {_(o["name"]): _other(o) for o in a["others"]},
            }
        )
    return [{"title": region_title(r), "rows": rows} for r, rows in groups.items()]


def _other(other: dict[str, Any]) -> str:
    if other["seconds"] is None:
        return "–"
    return ("≈ " if other["extrapolated"] else "") + duration(other["seconds"])


def _trial(trial: dict[str, Any]) -> dict[str, Any]:
    result, best = trial["result"], trial["best"]
    return {
        "scene": trial["scene"],
        "goal": f"{error_text(trial['target'])} {place(trial['region'])}",
        "options": trial["options"],
        "verdict": _(VERDICT_WORDS[trial["verdict"]]),
        "tone": VERDICTS[trial["verdict"]],
        "error": error_text(result["relative_rmse"]) if result else "–",
        "time": duration(result["seconds"]) if result else "–",
        "best": "–" if best is None else f"{options(best)}, {duration(best['seconds'])}",
        "needed": (trial["needed"] or {}).get("light_samples") or "–",
        "method_ratio": digits(trial["method_ratio"], 2),
    }


def _slopes(slopes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A row a method, a column a region."""
    regions = [r for r in SLOPE_REGIONS if any(s["region"] == r for s in slopes)]
    rows: dict[str, dict[str, dict[str, str]]] = {}
    for s in slopes:
        rows.setdefault(_method(s), {})[s["region"]] = _slope(s)
    return {
        "regions": [region_title(r) for r in regions],
        "rows": [{"method": m, "cells": [cells[r] for r in regions]} for m, cells in rows.items()],
    }


def _slope(slope: dict[str, Any]) -> dict[str, str]:
    n = slope["light_samples"]
    return {
        "slope": fixed(slope["slope"]),
        "interval": interval(slope["low"], slope["high"], fixed)
        if slope["slope"] is not None
        else _(slope["reason"]),
        "theory": FRACTIONS.get(slope["theory"], "–"),
        "n": say("N = {first} to {last}", first=n[0], last=n[-1]) if n else "",
    }


# Figure 9


def _strips(data: Data, measured: dict[str, Any]) -> list[dict[str, Any]]:
    """The penumbra, enlarged, of images of one time and of one error, and of the exact one."""
    shown = [(name, entries) for name, entries in measured["strips"].items() if entries]
    if not shown:
        return []
    truth = data.exact("tp3", measured["width"], measured["height"])
    window = edge_window(data.scenes["tp3"], truth)
    folder = TRADE.path(data.build_dir).parent
    strips = []
    for name, entries in shown:
        cells = [_cell(entry, folder, window) for entry in entries]
        cells.append(_picture(truth.radiance, window, _("the exact solution"), _("no noise")))
        strips.append({"title": _(STRIPS.get(name, name)), "cells": cells})
    return strips


def _cell(entry: dict[str, Any], folder: Path, window: Crop) -> dict[str, Any]:
    image = read_image(folder / entry["file"])
    title = _method(entry | {"renderer": "penumbra"})
    samples = f"N = {entry['light_samples']} · " if entry["light_samples"] else ""
    facts = f"{samples}{duration(entry['seconds'])} · {error_text(entry['relative_rmse'])}"
    return _picture(image.radiance, window, title, facts)


def _picture(radiance: np.ndarray, window: Crop, title: str, facts: str) -> dict[str, Any]:
    return {
        "title": title,
        "facts": facts,
        "picture": detail(
            figures.displayed(radiance),
            window,
            say("The penumbra enlarged: {title}, {facts}", title=title, facts=facts),
        ),
    }
