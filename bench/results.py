"""What the rounds say: medians, ratios, time to a given error, the share of the machine's peak,
and each target beside what was reached."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bench.law import Law, Row, medians, seconds_of
from bench.rounds import EMPTY_PROCESS, WHOLE_PROCESS, Measured, Plan
from bench.systems import NOISELESS, ScalarLoop
from penumbra.compare.exact.image import LIT, PENUMBRA, ExactImage
from penumbra.compare.scene import Plane, Scene

FAST = "area sobol"
"""The estimator that samples everywhere, with its best points: the one compared at equal N."""
OTHERS = ("scalar loop", "Cycles", "Embree", "Mitsuba llvm", "Mitsuba scalar")
LANES = 16
"""Pixels side by side in a packet; all of them compute, whether they see the light or not."""

COUNTED = {
    "real wx = cx[i] + s * l->ux[i] + t * l->vx[i];": 2,
    "real wy = cy[i] + t * l->vy[i];": 1,
    "real distance_squared = wx * wx + (wy * wy + l->h_squared[i]);": 2,
    "real n_w = l->nx[i] * wx + (l->ny[i] * wy + l->nh[i]);": 2,
}
"""Operations of the FMA pipes for a sample, by line of the sample loop in estimator_packet.c:
a multiply-add is one, so is a product or a sum that has no partner. Not counted: the division,
comparisons, and the integer work on the point's bits."""
COUNTED_FOR_TWO = {
    "product[i] = a * b;": 1,
    "numerator[i] = first.n_w * (b * b) + second.n_w * (a * a);": 4,
    "sum[i] += numerator[i] * (inverse * inverse);": 2,
}
"""Likewise, once for two samples, and one division."""
COUNTED_FOR_A_SPHERE = {
    "real along = l->sphere_x[k][i] * wx + (l->sphere_y[k][i] * wy + l->sphere_h[k][i]);": 2,
    "n_w = along * fabs(along) > distance_squared ? 0 : n_w;": 1,
}
PLAIN = sum(COUNTED.values()) + sum(COUNTED_FOR_TWO.values()) / 2
"""Operations for a sample with nothing before the light"""
WITH_SPHERE = PLAIN + sum(COUNTED_FOR_A_SPHERE.values())


# ---------------------------------------------------------------- error against time


def times_to_targets(measured: Measured, plan: Plan) -> list[Row]:
    """For each system and target: N and seconds by its law, and both measured where they were."""
    rows = medians(measured.frames)
    result = []
    for name in systems(rows):
        law = Law.of(measured.frames, name, plan.threads)
        for target in plan.targets:
            count = law.samples_for(target)
            if count is None:
                continue
            check = [
                r for r in rows
                if r["experiment"] == f"target {target:g}" and r["system"] == name
            ]  # fmt: skip
            result.append(
                {
                    "system": name,
                    "target": target,
                    "light_samples": count,
                    "seconds": check[0]["seconds"] if check else law.seconds_at(count),
                    "relative_rmse": check[0]["relative_rmse_all"] if check else None,
                    "measured": bool(check),
                    "beyond": bool(count > law.counts[-1]),
                }
            )
    return result


def systems(rows: Iterable[Row]) -> list[str]:
    """In the order of tables: ours, by the alphabet, then the others."""
    names = {row["system"] for row in rows if row["experiment"] == "samples"}
    return sorted(names, key=lambda name: (name in OTHERS, name))


# ---------------------------------------------------------------- the machine's peak


def operations(scene: Scene, exact: ExactImage) -> tuple[float, float]:
    """FMA-pipe operations and divisions of the packets' loop per light sample, whole image.

    A lower bound, from the exact solution: sixteen pixels of a row run the loop if one of them
    gets light, and test a sphere if one of them is in the penumbra on a plane. (On a sphere the
    penumbra may be the horizon's.) One light.
    """
    planes = [i for i, thing in enumerate(scene.objects) if isinstance(thing, Plane)]
    shadowed = (exact.shadow == PENUMBRA) & np.isin(exact.object_id, planes)
    runs = _packets((exact.shadow == LIT) | (exact.shadow == PENUMBRA))
    tests = _packets(shadowed)
    lanes = LANES * int(runs.sum())
    spheres = LANES * int(tests.sum())
    return PLAIN * lanes + (WITH_SPHERE - PLAIN) * spheres, lanes / 2


def _packets(pixels: np.ndarray) -> np.ndarray:
    """Whether any of sixteen neighbours is so."""
    height, width = pixels.shape
    padded = np.pad(pixels, ((0, 0), (0, -width % LANES)))
    whole: np.ndarray = padded.reshape(height, -1, LANES).any(axis=2)
    return whole


def shares(measured: Measured, plan: Plan, scene: Scene) -> list[Row]:
    """Of the sample loop, by number of threads, at the largest N compared and at the largest that
    was measured: what part of its time the counted multiply-adds, and the divisions, would take
    alone at the measured peaks."""
    rows = medians(measured.frames)
    fma, divisions = operations(scene, measured.truth.exact)
    result = []
    for threads in sorted({peak["threads"] for peak in measured.peaks}):
        peaks = [p for p in measured.peaks if p["threads"] == threads]
        fma_peak = float(np.median([p["fma_per_second"] for p in peaks]))
        division_peak = float(np.median([p["divisions_per_second"] for p in peaks]))
        for count in sorted({max(plan.compared), max(plan.fitted)}):
            seconds = seconds_of(rows, FAST, light_samples=count, threads=threads)
            if not seconds:
                continue
            result.append(
                {
                    "threads": threads,
                    "light_samples": count,
                    "fma_per_second": fma_peak,
                    "divisions_per_second": division_peak,
                    "samples_per_second": 2 * divisions * count / seconds,
                    "fma_share": fma * count / fma_peak / seconds,
                    "division_share": divisions * count / division_peak / seconds,
                }
            )
    return result


# ---------------------------------------------------------------- the targets


def ratio(slow: float | None, fast: float | None) -> float | None:
    return slow / fast if slow and fast else None


def targets(measured: Measured, plan: Plan, scene: Scene) -> list[Row]:
    """Each target: what, unit, at_least, stretch, reached (None: not measured), bound_by, and
    whether smaller is better."""
    rows = medians(measured.frames)
    peak_shares = shares(measured, plan, scene)
    at_all_threads = [s for s in peak_shares if s["threads"] == plan.threads]
    result = [
        *_against(rows, plan, "Cycles", {16: (1000, 3000), 64: (2500, 5000), 256: (4000, 6500)}),
        *_against(rows, plan, "Mitsuba llvm", {256: (200, 400)}),
        *_against(rows, plan, ScalarLoop.name, {256: (40, 75)}),
        *(
            _target(
                f"share of the FMA peak, N = {share['light_samples']}", "%", 55, 80,
                _times(share["fma_share"], 100), _arithmetic(share),
            )
            for share in at_all_threads
        ),
        *_times_to_error(measured, plan),
        _exact_frame(rows, plan),
        *_slopes(measured, plan),
        _speedup(rows, peak_shares, plan),
        _process(rows, plan),
    ]  # fmt: skip
    return [row for row in result if row is not None]


def _target(
    what: str, unit: str, at_least: float | None, stretch: float | None, reached: float | None,
    bound_by: str, smaller: bool = False,
) -> Row:  # fmt: skip
    return {
        "what": what,
        "unit": unit,
        "at_least": at_least,
        "stretch": stretch,
        "reached": reached,
        "met": None if reached is None or at_least is None
        else bool(reached <= at_least if smaller else reached >= at_least),
        "smaller_is_better": smaller,
        "bound_by": bound_by,
    }  # fmt: skip


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _against(
    rows: Sequence[Row], plan: Plan, other: str, wanted: dict[int, tuple[int, int]]
) -> list[Row]:
    result = []
    for count, (at_least, stretch) in wanted.items():
        if count not in plan.compared:
            continue
        ours = seconds_of(rows, FAST, light_samples=count, threads=plan.threads)
        theirs = seconds_of(rows, other, light_samples=count, threads=plan.threads)
        what = f"render time, {other} / {FAST}, N = {count}"
        bound_by = _fixed_cost(rows, plan, count)
        result.append(_target(what, "×", at_least, stretch, ratio(theirs, ours), bound_by))
    return result


def _fixed_cost(rows: Sequence[Row], plan: Plan, count: int) -> str:
    """What part of our frame is not samples: the line through the times at the two ends."""
    low, high = min(plan.compared), max(plan.compared)
    first, here, last = (
        seconds_of(rows, FAST, light_samples=n, threads=plan.threads) for n in (low, count, high)
    )
    if low == high or not first or not here or not last:
        return ""
    fixed = max(0.0, first - (last - first) / (high - low) * low)
    return f"{min(1, fixed / here):.0%} of our frame is not samples (intercept of time against N)"


def _arithmetic(share: Row) -> str:
    return (
        f"divisions, one for two samples, alone take {share['division_share']:.0%} of the time at "
        "their own measured peak; they are not among the counted operations"
    )


def _times_to_error(measured: Measured, plan: Plan) -> list[Row]:
    """Of our fastest estimator, and of the fastest that samples."""
    target = min(plan.targets)
    found = [r for r in times_to_targets(measured, plan) if r["target"] == target]
    theirs = [r["seconds"] for r in found if r["system"] == "Cycles"]
    ours = sorted((r for r in found if r["system"] not in OTHERS), key=lambda r: r["seconds"])
    sampling = [r for r in ours if r["system"] != NOISELESS]
    result = []
    for best in sampling[:1] if ours[:1] == sampling[:1] else ours[:1] + sampling[:1]:
        slope = Law.of(measured.frames, best["system"], plan.threads).slope("all")
        falls = "" if slope is None else f"; the error falls as N to the {slope:.2f}"
        needed = f"N = {best['light_samples']:.0f} are needed{falls}"
        result.append(
            _target(
                f"time to {target:.1%} relative RMSE, Cycles / {best['system']}", "×", 20000,
                75000, ratio(theirs[0] if theirs else None, best["seconds"]),
                "it has no noise" if best["system"] == NOISELESS else needed,
            )
        )  # fmt: skip
    return result


def _exact_frame(rows: Sequence[Row], plan: Plan) -> Row:
    found = [
        r for r in rows
        if r["system"] == NOISELESS and r["experiment"] == "samples"
        and r["threads"] == plan.threads and (r["relative_rmse_all"] or 0) <= 1e-6
    ]  # fmt: skip
    said = "" if found else f"the program offers no --estimator {NOISELESS} of that accuracy"
    reached = min((r["seconds"] for r in found), default=None)
    return _target(
        "exact frame, relative RMSE ≤ 1e-6", "ms", 4, 1.5, _times(reached, 1e3), said, smaller=True
    )


def _slopes(measured: Measured, plan: Plan) -> list[Row]:
    law = Law.of(measured.frames, FAST, plan.threads)
    return [
        _target(
            f"slope of error against N, {FAST}, {region}", "", at_least, None, law.slope(region),
            f"least squares over N = {law.counts[0]:.0f} to {law.counts[-1]:.0f}", smaller=True,
        )
        for region, at_least in (("all", -0.74), ("lit", -1.25))
    ]  # fmt: skip


def _speedup(rows: Sequence[Row], peak_shares: Sequence[Row], plan: Plan) -> Row | None:
    found = [
        ratio(
            seconds_of(rows, FAST, light_samples=n, threads=1),
            seconds_of(rows, FAST, light_samples=n, threads=plan.threads),
        )
        for n in plan.compared
        if n >= 64
    ]
    values = [value for value in found if value is not None]
    if not values or plan.threads < 2:
        return None
    return _target(
        f"speed-up from 1 to {plan.threads} threads, N ≥ 64 (the smallest)", "×", 1.85, 1.95,
        min(values), _peak_speedup(peak_shares),
    )  # fmt: skip


def _peak_speedup(peak_shares: Sequence[Row]) -> str:
    """What the machine itself gives to more threads, of arithmetic that needs no memory."""
    peaks = {share["threads"]: share["fma_per_second"] for share in peak_shares}
    if len(peaks) < 2:
        return ""
    most = max(peaks)
    return (
        f"the FMA peak rose {peaks[most] / peaks[1]:.2f} times from 1 to {most} threads in this run"
    )


def _process(rows: Sequence[Row], plan: Plan) -> Row:
    count = min(plan.compared)
    whole, empty = (
        seconds_of(rows, name, experiment="process") for name in (WHOLE_PROCESS, EMPTY_PROCESS)
    )
    frame = seconds_of(rows, FAST, light_samples=count, threads=plan.threads)
    parts = (
        f"{empty * 1e3:.1f} ms start and end, {frame * 1e3:.1f} ms a warm frame, "
        f"{(whole - empty - frame) * 1e3:.1f} ms the rest: reading the scene, first touch of "
        "memory, writing the file"
        if whole and empty and frame
        else ""
    )
    return _target(
        f"whole process to an EXR file, N = {count}", "ms", 15, 6, _times(whole, 1e3), parts,
        smaller=True,
    )  # fmt: skip


def summary(measured: Measured, plan: Plan, scene: Scene) -> dict[str, Any]:
    """All of the above, for JSON and the page."""
    rows = medians(measured.frames)
    laws = {name: Law.of(measured.frames, name, plan.threads) for name in systems(rows)}
    return {
        "scene": scene.name,
        "width": plan.width,
        "height": plan.height,
        "threads": plan.threads,
        "rounds": plan.rounds,
        "compared": list(plan.compared),
        "systems": systems(rows),
        "targets": targets(measured, plan, scene),
        "medians": rows,
        "times_to_error": times_to_targets(measured, plan),
        "slopes": {
            name: {region: law.slope(region) for region in ("all", "lit")}
            for name, law in laws.items()
        },
        "peak": shares(measured, plan, scene),
        "operations": {
            "sample": PLAIN,
            "sample with a sphere": WITH_SPHERE,
        },
        "absent": measured.absent,
    }
