"""What threads bring."""

from __future__ import annotations

from typing import Any

from penumbra.language import say
from penumbra.report import figures
from penumbra.report.figures import Series
from penumbra.report.inputs import Data, Input
from penumbra.report.words import digits, interval, listed

SPEEDUP = Input(
    "speedup.json",
    "penumbra speedup scenes/tp3.json -o build/speedup.csv",
    "tp3",
    keys=("rows", "command"),
)


def threads(data: Data) -> dict[str, Any]:
    """Figure 7."""
    study = data[SPEEDUP]
    rows = study["rows"]
    one = next(row["seconds"] for row in rows if row["threads"] == 1)
    best = max(rows, key=lambda row: row["threads"])
    cores = study["machine"]["cores"]
    sentence = say(
        "Here {threads} threads take {seconds} s where one takes {one} s: {speedup} times the "
        "speed.",
        threads=best["threads"],
        seconds=digits(best["seconds"]),
        one=digits(one),
        speedup=digits(best["speedup"]),
    )
    each = [
        say("{threads}: {speedup:.3g}", threads=row["threads"], speedup=row["speedup"])
        for row in rows
    ]
    description = say("Speed-up by threads: {speedups}", speedups=listed(each))
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
        "caption": say(
            "Median speed-up of {repeats} renders of scene {scene} with N = {samples}; the band "
            "holds the fastest and the slowest.",
            repeats=study["repeats"],
            scene=study["scene"],
            samples=study["light_samples"],
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
