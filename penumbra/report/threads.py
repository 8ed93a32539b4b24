"""What threads bring."""

from __future__ import annotations

from typing import Any

from penumbra.report import figures
from penumbra.report.figures import Series
from penumbra.report.inputs import Data, Input
from penumbra.report.words import digits, interval

SPEEDUP = Input(
    "speedup.json",
    "penumbra speedup scenes/tp3.json -o build/speedup.csv",
    "tp3",
    keys=("rows", "command"),
)


def threads(data: Data) -> dict[str, Any]:
    """Figure 9."""
    study = data[SPEEDUP]
    rows = study["rows"]
    one = next(row["seconds"] for row in rows if row["threads"] == 1)
    best = max(rows, key=lambda row: row["threads"])
    cores = study["machine"]["cores"]
    sentence = (
        f"Here {best['threads']} threads take {digits(best['seconds'])} s where one takes "
        f"{digits(one)} s: {digits(best['speedup'])} times the speed."
    )
    description = "Speed-up by threads: " + ", ".join(
        f"{row['threads']}: {row['speedup']:.3g}" for row in rows
    )
    return {
        "svg": figures.speedup_chart(
            "speedup",
            description,
            Series(
                "C",
                "penumbra",
                [row["threads"] for row in rows],
                [row["speedup"] for row in rows],
                [one / row["high"] for row in rows],
                [one / row["low"] for row in rows],
            ),
            cores,
        ),
        "sentence": sentence,
        "caption": (
            f"Median speed-up of {study['repeats']} renders of scene {study['scene']} with "
            f"N = {study['light_samples']}; the band holds the fastest and the slowest."
        ),
        "command": study["command"],
        "rows": [
            {
                "threads": row["threads"],
                "seconds": f"{digits(row['seconds'])} {interval(row['low'], row['high'], digits)}",
                "speedup": digits(row["speedup"]),
            }
            for row in rows
        ],
    }
