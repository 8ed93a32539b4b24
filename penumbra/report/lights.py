"""The lab's scene under other lights: pictures, the shadow along a line, and whether all agree."""

from __future__ import annotations

from typing import Any

from penumbra.language import _
from penumbra.report.agreement import verdict_count
from penumbra.report.figures import OTHER_STYLES, STYLES, Line, profile_chart
from penumbra.report.inputs import COMPARISONS, LIGHTS, Data, Input, best_image_file
from penumbra.report.pictures import edge_crop, figure_of, name_of, picture
from penumbra.report.words import against, digits, region_word, signed_percent

_SCENES = " ".join(f"scenes/{name}.json" for name in LIGHTS)
PROFILE = Input(
    "lights/profile.json",
    f"penumbra profile {_SCENES} -o build/lights/profile.json",
    "tp3",
    keys=("start", "end", "along", "rows", "command"),
)
DASHES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))


def lights(data: Data) -> dict[str, Any]:
    """Figures 10 and 11, and a table of verdicts: the same objects, another light each."""
    pictures = []
    for scene, shape in LIGHTS.items():
        file = best_image_file(scene)
        pictures.append(picture(data, file, edge_crop(data, file), _(shape)))
    compared = [i for i in COMPARISONS if i.scene in LIGHTS and data.has(i)]
    measured = data[PROFILE]
    start = measured["start"][0]
    colours = [colour for colour, _ in (*STYLES.values(), *OTHER_STYLES)]
    lines = [
        Line(_(LIGHTS[row["scene"]]), [start + x for x in measured["along"]], row["radiance"],
             colour, "", dashes)
        for row, colour, dashes in zip(measured["rows"], colours, DASHES, strict=True)
    ]  # fmt: skip
    return {
        "figure": figure_of(pictures),
        "profile": profile_chart(
            "light-profiles",
            _("Radiance of the floor along a line through the shadow, under each light"),
            lines,
            _("x on the floor, at z = 3 [m]"),
            _("radiance [W m⁻² sr⁻¹]"),
        ),
        "widths": [
            {
                "light": _(LIGHTS[row["scene"]]),
                "umbra": digits(row["umbra"]),
                "penumbra": digits(row["penumbra"]),
            }
            for row in measured["rows"]
        ],
        "command": measured["command"],
        "agreement": [_verdicts(data, i) for i in compared],
        "summary": verdict_count([row for i in compared for row in data[i]["rows"]]),
    }


def _verdicts(data: Data, item: Input) -> dict[str, Any]:
    """A comparison in a line: its verdicts, and the region with the largest bias."""
    rows = data[item]["rows"]
    largest = max(rows, key=lambda row: abs(row["relative_bias"] or 0))
    verdicts = {row["verdict"] for row in rows}
    return {
        "light": _(LIGHTS[item.scene]),
        "pair": against(name_of(data, rows[0]["image"]), name_of(data, rows[0]["reference"])),
        "tone": next(v for v in ("differs", "undecided", "agrees") if v in verdicts),
        "summary": verdict_count(rows),
        "region": region_word(largest["region"]),
        "bias": signed_percent(largest["relative_bias"]),
    }
