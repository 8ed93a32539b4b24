"""The results in a few lines, above the sections."""

from __future__ import annotations

import math
from typing import Any

from penumbra.report.agreement import all_rows, verdict_count
from penumbra.report.convergence import point_of, slope_of
from penumbra.report.inputs import (
    COMPARISONS,
    CONVERGENCE,
    FEW,
    IMAGES,
    PIXEL_SAMPLES,
    Data,
    best_image_file,
    reference_file,
)
from penumbra.report.threads import SPEEDUP
from penumbra.report.words import digits, fixed, interval, percent

INPUTS = (*COMPARISONS, *IMAGES, CONVERGENCE, SPEEDUP)


def header(data: Data) -> dict[str, Any]:
    return {"summary": _summary(data), "glance": _glance(data)}


def _summary(data: Data) -> str:
    """What was rendered, in a line."""
    scene = data.scenes["tp3"]
    image = data.images[best_image_file("tp3")]
    cycles = data.images[reference_file("tp3")]
    machine = data[CONVERGENCE]["machine"]
    return (
        f"Scene {scene.name} (hash {scene.hash}) and its variants, {scene.width} × {scene.height}; "
        f"{image.attributes.get('software', 'the C renderer')}, seed "
        f"{image.attributes.get('seed', '?')}; {cycles.attributes.get('software', 'Cycles')}; on "
        f"{machine['processor']}, {machine['cores']} cores."
    )


def _glance(data: Data) -> list[dict[str, str]]:
    """The results in one line each."""
    rows = all_rows(data)
    verdicts = {row["verdict"] for row in rows}
    worst = next(v for v in ("differs", "undecided", "agrees") if v in verdicts)
    agreeing = sum(row["verdict"] == "agrees" for row in rows)
    others = verdict_count(rows).partition(", ")[2]
    items = [
        {
            "term": "Is it right?",
            "value": f"{agreeing} of {len(rows)}",
            "text": "comparisons of regions agree" + (f"; {others}" if others else ""),
            "tone": worst,
        }
    ]
    slope = slope_of(data, "penumbra", "all")
    if slope is not None:
        items.append(
            {
                "term": "How fast does it converge?",
                "value": "N",
                "power": fixed(slope["slope"]),
                "text": f"error of C over all objects, {percent(slope['confidence'])} interval "
                f"{interval(slope['low'], slope['high'], fixed)}",
            }
        )
    off, on = (point_of(data, "penumbra", FEW, m)["rmse"] for m in (1, PIXEL_SAMPLES))
    items.append(
        {
            "term": "What does anti-aliasing do?",
            "value": f"÷ {digits(off / on)}",
            "text": f"noise in the penumbra with {PIXEL_SAMPLES} pixel samples; the root of "
            f"{PIXEL_SAMPLES} is {math.sqrt(PIXEL_SAMPLES):g}",
        }
    )
    best = max(data[SPEEDUP]["rows"], key=lambda row: row["threads"])
    items.append(
        {
            "term": "What do threads bring?",
            "value": f"× {digits(best['speedup'])}",
            "text": f"speed with {best['threads']} threads instead of one",
        }
    )
    return items
