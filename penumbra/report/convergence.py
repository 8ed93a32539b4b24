"""How the error falls with the number of light samples: figures 4 and 5, and the slopes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from penumbra.language import N_, _, say
from penumbra.report import figures
from penumbra.report.figures import Series
from penumbra.report.inputs import CONVERGENCE, PIXEL_SAMPLES, Data
from penumbra.report.words import (
    fixed,
    interval,
    percent,
    region_title,
    region_word,
    size_of,
)

FIRST_REGIONS = ("all", "lit", "penumbra")
RENDERERS = {"penumbra": "C", "cycles": "Cycles", "exact": N_("exact")}


def convergence(data: Data) -> dict[str, Any]:
    """Figures 4 and 5, and the slopes."""
    measured = data[CONVERGENCE]
    curves = [c for c in measured["curves"] if c["against"] == "exact"]
    regions = _panel_regions(curves)
    style = figures.styles(c["renderer"] for c in curves)
    scene = measured["scene"]
    confidence = percent(curves[0]["confidence"])
    numbered = []
    for number, key, x_label, x_base, what in (
        (4, "light_samples", _("light samples N [1]"), 4, _("the number of shadow rays")),
        (5, "seconds", _("render time [s]"), 10, _("render time")),
    ):
        panels = []
        for region in regions:
            series = [
                Series(_renderer(c), c["renderer"], c[key], c["rmse"], c["low"], c["high"])
                for c in curves
                if c["region"] == region and c["pixel_samples"] == 1
            ]
            description = say(
                "Relative RMSE against {what}, {region}.", what=what, region=region_title(region)
            )
            description = " ".join((description, *map(_fall, series)))
            name = f"chart {number} {region}"
            svg = figures.convergence_chart(name, description, series, style, x_label, x_base)
            fitted = [slope_of(data, x.renderer, region) for x in series] if number == 4 else []
            slopes = [f"{_renderer(x)} {_slope_text(x)}" for x in fitted if x]
            panels.append({"title": region_title(region), "svg": svg, "slopes": slopes})
        caption = say(
            "Relative RMSE against {what}, measured against the exact solution, scene {scene} at "
            "{size} pixels, M = 1; {seeds} seeds for each N; bands are {confidence} confidence "
            "intervals. Dashed: slope −1/2.",
            what=what,
            scene=scene,
            size=size_of(measured),
            seeds=measured["seeds"],
            confidence=confidence,
        )
        numbered.append(
            {"number": number, "panels": panels, "caption": caption, "command": measured["command"]}
        )
    return {
        "figures": numbered,
        "slopes": [_slope_row(slope) for slope in measured["slopes"]],
        "sentence": _slope_sentence(data),
        "pixel_samples": PIXEL_SAMPLES,
    }


def _fall(series: Series) -> str:
    return say(
        "{label} goes from {y0:.3g} at {x0:.3g} to {y1:.3g} at {x1:.3g}.",
        label=series.label,
        x0=series.x[0],
        y0=series.y[0],
        x1=series.x[-1],
        y1=series.y[-1],
    )


def _panel_regions(curves: Sequence[dict[str, Any]]) -> list[str]:
    """The shadow's regions first, then objects; not their combinations, not silhouettes."""
    present = dict.fromkeys(c["region"] for c in curves if c["pixel_samples"] == 1)
    shown = [r for r in present if ":" not in r and r not in ("silhouette", "umbra")]
    return sorted(shown, key=lambda region: region not in FIRST_REGIONS)


def _slope_row(slope: dict[str, Any]) -> dict[str, Any]:
    samples = slope["light_samples"]
    return {
        "renderer": _renderer(slope),
        "region": region_word(slope["region"]),
        "against": _(RENDERERS.get(slope["against"], slope["against"])),
        "pixel_samples": slope["pixel_samples"],
        "light_samples": (
            say("{first} to {last}", first=samples[0], last=samples[-1]) if samples else "–"
        ),
        "slope": fixed(slope["slope"]),
        "interval": interval(slope["low"], slope["high"], fixed),
        "confidence": percent(slope["confidence"]),
    }


def slope_of(data: Data, renderer: str, region: str) -> dict[str, Any] | None:
    for slope in data[CONVERGENCE]["slopes"]:
        key = (slope["renderer"], slope["region"], slope["pixel_samples"], slope["against"])
        if key == (renderer, region, 1, "exact"):
            return slope
    return None


def _slope_text(slope: dict[str, Any]) -> str:
    return f"{fixed(slope['slope'])} {interval(slope['low'], slope['high'], fixed)}"


def _slope_sentence(data: Data) -> str:
    slope = slope_of(data, "penumbra", "all")
    if slope is None:
        return ""
    return say(
        "Measured for C over all objects: {slope}, a {confidence} interval.",
        slope=_slope_text(slope),
        confidence=percent(slope["confidence"]),
    )


def point_of(data: Data, region: str, light_samples: int, pixel_samples: int) -> dict[str, Any]:
    """One point of the C renderer's curve."""
    for c in data[CONVERGENCE]["curves"]:
        key = (c["renderer"], c["region"], c["pixel_samples"], c["against"])
        if key == ("penumbra", region, pixel_samples, "exact"):
            i = c["light_samples"].index(light_samples)
            return {k: c[k][i] for k in ("rmse", "low", "high", "seconds")}
    raise KeyError(f"curve of penumbra, {region}, M = {pixel_samples}")


def _renderer(row: dict[str, Any]) -> str:
    return RENDERERS.get(row["renderer"], row["renderer"])
