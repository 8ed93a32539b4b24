"""The results in a few lines, above the sections."""

from __future__ import annotations

import math
from typing import Any

from penumbra.language import _, say
from penumbra.report.agreement import all_rows, verdict_words
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
from penumbra.report.words import digits, fixed, interval, percent, phrases, size_of

INPUTS = (*COMPARISONS, *IMAGES, CONVERGENCE, SPEEDUP)


def header(data: Data) -> dict[str, Any]:
    return {"summary": _summary(data), "glance": _glance(data)}


def _summary(data: Data) -> str:
    """What was rendered, in a line."""
    scene = data.scenes["tp3"]
    image = data.images[best_image_file("tp3")]
    cycles = data.images[reference_file("tp3")]
    machine = data[CONVERGENCE]["machine"]
    ours = _("the C renderer")
    return say(
        "Scene {scene} (hash {hash}) and its variants, {size}; {software}, seed {seed}; {cycles}; "
        "on {processor}, {cores} cores.",
        scene=scene.name,
        hash=scene.hash,
        size=size_of(vars(scene)),
        software=image.attributes.get("software", ours),
        seed=str(image.attributes.get("seed", "?")),
        cycles=cycles.attributes.get("software", "Cycles"),
        processor=machine["processor"],
        cores=machine["cores"],
    )


def _glance(data: Data) -> list[dict[str, str]]:
    """The results in one line each."""
    rows = all_rows(data)
    verdicts = {row["verdict"] for row in rows}
    worst = next(v for v in ("differs", "undecided", "agrees") if v in verdicts)
    agreeing = sum(row["verdict"] == "agrees" for row in rows)
    others = verdict_words(rows)[1:]
    items = [
        {
            "term": _("Is it right?"),
            "value": say("{count} of {all}", count=agreeing, all=len(rows)),
            "text": phrases(
                [_("comparisons of regions agree"), *([", ".join(others)] if others else [])]
            ),
            "tone": worst,
        }
    ]
    slope = slope_of(data, "penumbra", "all")
    if slope is not None:
        items.append(
            {
                "term": _("How fast does it converge?"),
                "value": "N",
                "power": fixed(slope["slope"]),
                "text": say(
                    "error of C over all objects, {confidence} interval {interval}",
                    confidence=percent(slope["confidence"]),
                    interval=interval(slope["low"], slope["high"], fixed),
                ),
            }
        )
    off, on = (point_of(data, "penumbra", FEW, m)["rmse"] for m in (1, PIXEL_SAMPLES))
    items.append(
        {
            "term": _("What does anti-aliasing do?"),
            "value": f"÷ {digits(off / on)}",
            "text": say(
                "noise in the penumbra with {samples} pixel samples; the root of {samples} is "
                "{root:g}",
                samples=PIXEL_SAMPLES,
                root=math.sqrt(PIXEL_SAMPLES),
            ),
        }
    )
    best = max(data[SPEEDUP]["rows"], key=lambda row: row["threads"])
    items.append(
        {
            "term": _("What do threads bring?"),
            "value": f"× {digits(best['speedup'])}",
            "text": say("speed with {threads} threads instead of one", threads=best["threads"]),
        }
    )
    return items
