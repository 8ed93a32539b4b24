"""What to choose: the Pareto frontier, the cheapest setting for a target, and its trial elsewhere.

Rows are dictionaries as trade.py makes them: renderer, sampler, estimator, light_samples,
threads, region, relative_rmse with low and high, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from penumbra.language import N_, _, localised, say

Row = Mapping[str, Any]

SERIES = ("renderer", "sampler", "estimator", "threads")
"""What points of one curve have in common."""
TAIL = 4
"""Points at the end of a curve from which it is extrapolated."""
FLAT = -0.1
"""A tail falling less steeply than N to this power is not extrapolated: N hardly matters."""
FARTHEST = 1e4
"""Times the largest N beyond which nothing is extrapolated."""
NEARLY_BEST = 1.25
"""A choice that takes up to so many times the best one's time is called nearly as fast."""


def frontier(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the (time, error) that no other point beats in one without losing in the
    other, by time. Of equal points the first.

    >>> frontier([(1, 9), (2, 5), (3, 6), (4, 5), (5, 1)])
    [0, 1, 4]
    """
    best, kept = math.inf, []
    for i in sorted(range(len(points)), key=lambda i: (*points[i], i)):
        if points[i][1] < best:
            best = points[i][1]
            kept.append(i)
    return kept


def cheapest(rows: Sequence[Row], target: float) -> Row | None:
    """The fastest row whose error is below target with its whole interval."""
    able = [row for row in rows if row["high"] <= target]
    return min(able, key=lambda row: row["seconds"], default=None)


@dataclass(frozen=True)
class Need:
    """What a curve takes to reach an error."""

    light_samples: float | None
    """None: the method has no N"""
    seconds: float
    extrapolated: bool


def need(curve: Sequence[Row], target: float) -> Need | None:
    """N and time at which a curve (rows that differ in N alone) falls to target.

    Between measured points straight lines in log N, log error and log time. Beyond the last,
    the power of N fitted to the TAIL last errors, and time in proportion to N. None where the
    tail is flat or the point is out of reach; a first point below target is itself the answer.
    """
    points = sorted(curve, key=lambda row: row["light_samples"] or 0)
    for i, row in enumerate(points):
        if row["relative_rmse"] > target:
            continue
        n = row["light_samples"]
        if i == 0 or n is None:
            return Need(n, row["seconds"], False)
        before = points[i - 1]
        x = _between(before["relative_rmse"], row["relative_rmse"], target)
        return Need(
            _log_mean(before["light_samples"], n, x),
            _log_mean(before["seconds"], row["seconds"], x),
            False,
        )
    return _beyond(points[-TAIL:], target)


def _between(first: float, last: float, value: float) -> float:
    """0 at first, 1 at last, linear in the logarithm. last may be 0: then 1."""
    if last <= 0 or first <= last:
        return 1.0
    return math.log(first / value) / math.log(first / last)


def _log_mean(first: float, last: float, x: float) -> float:
    return float(first ** (1 - x) * last**x)


def _beyond(tail: Sequence[Row], target: float) -> Need | None:
    if len(tail) < 2:
        return None
    n = np.log([row["light_samples"] for row in tail])
    error = np.log([row["relative_rmse"] for row in tail])
    slope, constant = np.polyfit(n, error, 1)
    if slope > FLAT:
        return None
    wanted = math.exp((math.log(target) - constant) / slope)
    last = tail[-1]
    wanted = max(wanted, last["light_samples"])
    factor = wanted / last["light_samples"]
    return Need(wanted, last["seconds"] * factor, True) if factor <= FARTHEST else None


def curves(rows: Sequence[Row]) -> dict[tuple[Any, ...], list[Row]]:
    """Rows of one region by what SERIES says of them."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in SERIES), []).append(row)
    return found


def answer(rows: Sequence[Row], region: str, target: float) -> dict[str, Any]:
    """The recommended choice among the C renderer's rows for an error in a region.

    choice: the row, or None where no measured one is surely below target; others: what the
    lab's own way (independent, textbook) and Cycles take, with the most threads; text: all
    of it in words.
    """
    here = [row for row in rows if row["region"] == region]
    choice = cheapest([row for row in here if row["renderer"] == "penumbra"], target)
    others = []
    for name, wanted in (
        (N_("the lab's way"), ("penumbra", "independent", "textbook")),
        ("Cycles", ("cycles", None, None)),
    ):
        found = [c for key, c in curves(here).items() if key[:3] == wanted]
        if found:
            curve = max(found, key=lambda c: c[0]["threads"])
            others.append({"name": name, **_need_entry(need(curve, target))})
    entry: dict[str, Any] = {
        "region": region,
        "target": target,
        "choice": None if choice is None else dict(choice),
        "others": others,
    }
    return entry | {"text": answer_text(entry)}


def _need_entry(found: Need | None) -> dict[str, Any]:
    if found is None:
        return {"light_samples": None, "seconds": None, "extrapolated": None}
    n = None if found.light_samples is None else math.ceil(found.light_samples - 1e-9)
    return {"light_samples": n, "seconds": found.seconds, "extrapolated": found.extrapolated}


def answer_text(entry: Mapping[str, Any]) -> str:
    """An answer in words."""
    goal = f"{percent(entry['target'])} {place(entry['region'])}"
    choice = entry["choice"]
    if choice is None:
        said = say("For {goal} no measured setting is enough.", goal=goal)
    else:
        said = say(
            "For {goal} use {options}: it takes {time} (error {error}).",
            goal=goal,
            options=options(choice),
            time=duration(choice["seconds"]),
            error=percent(choice["relative_rmse"]),
        )
    return " ".join([said, *map(_other_text, entry["others"])])


def _other_text(other: Mapping[str, Any]) -> str:
    name, n, seconds = _(other["name"]), other["light_samples"], other["seconds"]
    name = name[:1].upper() + name[1:]
    if seconds is None:
        return say("{name} did not get there.", name=name)
    text = N_("{name} takes {time} (N = {n}).")
    if other["extrapolated"]:
        text = N_("{name} takes about {time} (N about {n}, extrapolated).")
        n = f"{float(f'{n:.2g}'):.0f}"
    return say(text, name=name, time=duration(seconds), n=n)


def trial(answered: Mapping[str, Any], rows: Sequence[Row], scene: str) -> dict[str, Any]:
    """How a choice fitted on one scene does on another, whose rows are given.

    verdict: "reached" or "missed" with the error's whole interval on that side of the target,
    else "undecided"; "no choice" if there was none; "impossible" if that scene cannot be
    rendered so (result is None for both). best: the cheapest row there. time_ratio:
    the choice's time over the best one's, None unless reached. needed: what the chosen method
    (sampler, estimator, threads) takes there with another N; method_ratio: its time over that
    of the method for which it is smallest.
    """
    region, target, choice = answered["region"], answered["target"], answered["choice"]
    here = [r for r in rows if r["region"] == region and r["renderer"] == "penumbra"]
    best = cheapest(here, target)
    entry: dict[str, Any] = {
        "scene": scene,
        "region": region,
        "target": target,
        "verdict": "no choice",
        "options": None if choice is None else options(choice),
        "result": None,
        "best": None if best is None else dict(best),
        "time_ratio": None,
        "needed": None,
        "method_ratio": None,
    }
    if choice is None:
        return entry | {"text": _trial_text(entry)}
    keys = (*SERIES, "light_samples")
    result = next((r for r in here if all(r[k] == choice[k] for k in keys)), None)
    if result is None:
        entry["verdict"] = "impossible"
        return entry | {"text": _trial_text(entry)}
    entry["result"] = dict(result)
    if result["high"] <= target:
        entry["verdict"] = "reached"
    elif result["low"] > target:
        entry["verdict"] = "missed"
    else:
        entry["verdict"] = "undecided"
    if entry["verdict"] == "reached" and best is not None:
        entry["time_ratio"] = result["seconds"] / best["seconds"]
    needs = {key: need(curve, target) for key, curve in curves(here).items()}
    own = needs[tuple(choice[k] for k in SERIES)]
    entry["needed"] = _need_entry(own)
    if own is not None:
        smallest = min(n.seconds for n in needs.values() if n is not None)
        entry["method_ratio"] = own.seconds / smallest
    return entry | {"text": _trial_text(entry)}


def _trial_text(entry: Mapping[str, Any]) -> str:
    goal = f"{percent(entry['target'])} {place(entry['region'])} of {entry['scene']}"
    best = entry["best"]
    other = (
        "Nothing measured there is enough."
        if best is None
        else f"Best there: {options(best)}, {duration(best['seconds'])}."
    )
    if entry["verdict"] == "no choice":
        return f"{goal}: nothing was recommended. {other}"
    if entry["verdict"] == "impossible":
        return f"{goal}: cannot be rendered with {entry['options']}. {other}"
    result, verdict = entry["result"], entry["verdict"]
    text = (
        f"{goal}: {verdict} with {entry['options']}: error {percent(result['relative_rmse'])} "
        f"in {duration(result['seconds'])}."
    )
    if entry["time_ratio"] is not None and entry["time_ratio"] <= NEARLY_BEST:
        return f"{text} Nothing measured there is more than {NEARLY_BEST:g} times faster."
    needed = entry["needed"]
    if verdict != "reached" and needed["light_samples"] is not None:
        text += f" The same method needs N = {needed['light_samples']} there."
    return f"{text} {other}"


def verdict_text(trials: Sequence[Mapping[str, Any]]) -> str:
    """All trials in a sentence."""
    made = [t for t in trials if t["verdict"] != "no choice"]
    if not made:
        return _("No recommendation was tried on another scene.")
    reached = [t for t in made if t["verdict"] == "reached"]
    fast = [t for t in reached if t["time_ratio"] is not None and t["time_ratio"] <= NEARLY_BEST]
    ratios = [t["method_ratio"] for t in made if t["method_ratio"] is not None]
    said = say(
        "On scenes that it was not fitted on the recommended setting reached its target in "
        "{reached} of {made} cases, and in {fast} of these nothing measured was more than "
        "{nearly:g} times faster.",
        reached=len(reached),
        made=len(made),
        fast=len(fast),
        nearly=NEARLY_BEST,
    )
    if ratios:
        said += " " + say(
            "With N adapted to the scene the recommended method takes, in the median, "
            "{median:.2f} times as long as the best one, {worst:.2f} times at worst.",
            median=float(np.median(ratios)),
            worst=max(ratios),
        )
    return said


# Words


def options(row: Row) -> str:
    """The command line options of a row. Defaults are said too: they may change."""
    if row["renderer"] != "penumbra":
        return f"{row['renderer']}, N = {row['light_samples']}"
    sampler = f"--sampler {row['sampler']} " if row["sampler"] else ""
    samples = f" --light-samples {row['light_samples']}" if row["light_samples"] else ""
    return f"{sampler}--estimator {row['estimator']}{samples} --threads {row['threads']}"


def place(region: str) -> str:
    """
    >>> place("penumbra"), place("lit"), place("all"), place("floor")
    ('in the penumbra', 'where all light is seen', 'over all objects', 'on floor')
    """
    words = {
        "penumbra": _("in the penumbra"),
        "lit": _("where all light is seen"),
        "all": _("over all objects"),
        "floor": _("on floor"),
        "sphere": _("on sphere"),
    }
    return words.get(region) or say("on {region}", region=region)


def percent(value: float) -> str:
    """
    >>> percent(0.003), percent(0.0123456), percent(2e-7)
    ('0.3%', '1.23%', '2e-05%')
    """
    return localised(f"{100 * value:.3g}%")


def duration(seconds: float) -> str:
    """
    >>> duration(0.0019), duration(0.000213), duration(113.4), duration(1044), duration(9000)
    ('1.9 ms', '0.21 ms', '110 s', '17 min', '2.5 h')
    """
    if seconds < 1:
        return localised(f"{float(f'{1000 * seconds:.2g}'):g} ms")
    if seconds < 1000:
        return localised(f"{float(f'{seconds:.2g}'):g} s")
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return localised(f"{float(f'{seconds / 3600:.2g}'):g} h")
