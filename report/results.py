"""The page's measured results, section by section, as compare wrote them."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from report import figures
from report.figures import Series
from report.inputs import (
    COMPARISONS,
    FEW,
    IMAGES,
    PIXEL_SAMPLES,
    SCENES,
    Data,
    Input,
    best_image_file,
    image_file,
    reference_file,
)
from report.pictures import antialiasing_picture, figure_of, name_of
from report.words import digits, fixed, interval, percent, signed_percent, size_of, times

FIRST_REGIONS = ("all", "lit", "penumbra")
REGIONS = {"all": "all objects"}
RENDERERS = {"penumbra": "C", "cycles": "Cycles"}


def agreement(data: Data) -> dict[str, Any]:
    tables = []
    for scene in SCENES:
        files = [i.file for i in COMPARISONS if i.scene == scene and i.file in data.comparisons]
        groups = [_agreement_group(data, data.comparisons[file]) for file in files]
        rows = [row for file in files for row in data.comparisons[file]["rows"]]
        tables.append(
            {
                "title": f"Scene {scene}",
                "summary": _verdict_count(rows),
                "axis": f"{100 * _axis(rows):.3g}",
                "groups": groups,
                "commands": [data.comparisons[file]["command"] for file in files],
                "has_dark": any(row["relative_to"] != row["region"] for row in rows),
            }
        )
    rows = _all_rows(data)
    return {
        "agreement": tables,
        "confidence": " or ".join(percent(c) for c in sorted({row["confidence"] for row in rows})),
        "perceptual": _perceptual(data),
    }


def _all_rows(data: Data) -> list[dict[str, Any]]:
    return [row for comparison in data.comparisons.values() for row in comparison["rows"]]


def _verdict_count(rows: Sequence[dict[str, Any]]) -> str:
    counts = Counter(row["verdict"] for row in rows)
    words = [f"{counts['agrees']} of {len(rows)} agree"]
    if counts["differs"]:
        words.append(f"{counts['differs']} differ")
    if counts["undecided"]:
        words.append(f"{counts['undecided']} undecided")
    return ", ".join(words)


def _agreement_group(data: Data, comparison: dict[str, Any]) -> dict[str, Any]:
    rows = comparison["rows"]
    first = rows[0]
    axis = _axis(rows)
    return {
        "label": f"{name_of(data, first['image'])} against {name_of(data, first['reference'])}",
        "delta": percent(first["delta"]),
        "rows": [_agreement_row(row, axis) for row in rows],
    }


def _agreement_row(row: dict[str, Any], axis: float) -> dict[str, Any]:
    low, high = row["relative_low"], row["relative_high"]
    return {
        "region": row["region"].replace(":", ", "),
        "pixels": f"{row['pixels']:,}".replace(",", "\u202f"),
        "mean": digits(row["mean_image"]),
        "bias": signed_percent(row["relative_bias"]),
        "interval": interval(low, high, signed_percent),
        "dark": row["relative_to"] != row["region"],
        "detectable": digits(times(100, row["detectable_relative_bias"]), 2),
        "consistent": fixed(times(100, row["consistent_fraction"])),
        "verdict": row["verdict"],
        "note": row["note"],
        "plot": _whisker(row, axis),
    }


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
        "text": f"Interval from {signed_percent(low)} to {signed_percent(high)} percent",
    }


def _axis(rows: Iterable[dict[str, Any]]) -> float:
    """Half-width of the drawn intervals: twice the largest delta holds every agreement."""
    return 2 * max(row["delta"] for row in rows)


def _perceptual(data: Data) -> list[dict[str, str]]:
    """Of the comparisons made with --perceptual."""
    rows = []
    for comparison in data.comparisons.values():
        for region in ("all", "penumbra"):
            metrics = comparison["metrics"].get(region, {})
            if "flip" in metrics:
                rows.append(
                    {
                        "pair": f"{name_of(data, comparison['rows'][0]['image'])} against "
                        f"{name_of(data, comparison['rows'][0]['reference'])}",
                        "region": region,
                        "flip": digits(metrics["flip"]),
                        "delta_e": digits(metrics["delta_e"]),
                        "relative_rmse": digits(times(100, metrics["relative_rmse"])),
                    }
                )
    return rows


def convergence(data: Data) -> dict[str, Any]:
    """Figures 6 and 7, and the slopes."""
    curves = [c for c in data.convergence["curves"] if c["against"] == "exact"]
    regions = _panel_regions(curves)
    style = figures.styles(c["renderer"] for c in curves)
    scene = data.convergence["scene"]
    confidence = percent(curves[0]["confidence"])
    bands = (
        f"{data.convergence['seeds']} seeds for each N; bands are {confidence} confidence intervals"
    )
    numbered = []
    for number, key, x_label, x_base, against in (
        (6, "light_samples", "light samples N [1]", 4, "the number of shadow rays"),
        (7, "seconds", "render time [s]", 10, "render time"),
    ):
        panels = []
        for region in regions:
            series = [
                Series(_renderer(c), c["renderer"], c[key], c["rmse"], c["low"], c["high"])
                for c in curves
                if c["region"] == region and c["pixel_samples"] == 1
            ]
            description = f"Relative RMSE against {against}, {REGIONS.get(region, region)}. "
            description += " ".join(_fall(s) for s in series)
            name = f"chart {number} {region}"
            svg = figures.convergence_chart(name, description, series, style, x_label, x_base)
            fitted = [_slope_of(data, x.renderer, region) for x in series] if number == 6 else []
            slopes = [f"{_renderer(x)} {_slope_text(x)}" for x in fitted if x]
            panels.append({"title": REGIONS.get(region, region), "svg": svg, "slopes": slopes})
        caption = (
            f"Relative RMSE against {against}, measured against the exact solution, scene {scene} "
            f"at {size_of(data.convergence)} pixels, M = 1; {bands}. Dashed: slope −1/2."
        )
        numbered.append({"number": number, "panels": panels, "caption": caption})
    return {
        "convergence": numbered,
        "slopes": [_slope_row(slope) for slope in data.convergence["slopes"]],
        "slope_sentence": _slope_sentence(data),
        "convergence_command": data.convergence["command"],
    }


def _fall(series: Series) -> str:
    return (
        f"{series.label} goes from {series.y[0]:.3g} at {series.x[0]:.3g} to {series.y[-1]:.3g} at "
        f"{series.x[-1]:.3g}."
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
        "region": slope["region"].replace(":", ", "),
        "against": RENDERERS.get(slope["against"], slope["against"]),
        "pixel_samples": slope["pixel_samples"],
        "light_samples": f"{samples[0]} to {samples[-1]}" if samples else "–",
        "slope": fixed(slope["slope"]),
        "interval": interval(slope["low"], slope["high"], fixed),
        "confidence": percent(slope["confidence"]),
    }


def _slope_of(data: Data, renderer: str, region: str) -> dict[str, Any] | None:
    for slope in data.convergence["slopes"]:
        key = (slope["renderer"], slope["region"], slope["pixel_samples"], slope["against"])
        if key == (renderer, region, 1, "exact"):
            return slope
    return None


def _slope_text(slope: dict[str, Any]) -> str:
    return f"{fixed(slope['slope'])} {interval(slope['low'], slope['high'], fixed)}"


def _slope_sentence(data: Data) -> str:
    slope = _slope_of(data, "penumbra", "all")
    if slope is None:
        return ""
    confidence = percent(slope["confidence"])
    return f"Measured for C over all objects: {_slope_text(slope)}, a {confidence} interval."


def antialiasing(data: Data) -> dict[str, Any]:
    """Figure 8 and the measured answer to the handout's question."""
    settings = ((FEW, 1), (FEW, PIXEL_SAMPLES), (FEW * PIXEL_SAMPLES, 1))
    files = [image_file("tp3", n, m) for n, m in settings]
    regions = ("penumbra", "lit")
    rows = []
    for n, m in settings:
        points = [_point(data, region, n, m) for region in regions]
        rows.append(
            {
                "light_samples": n,
                "pixel_samples": m,
                "rays": n * m,
                "noises": [*map(_with_interval, points), _umbra_rmse(data, n, m)],
                "seconds": digits(points[0]["seconds"]),
            }
        )
    titles = [{"title": f"{r}, relative RMSE", "unit": "[interval]"} for r in regions]
    return {
        "antialiasing": {
            "figure": figure_of([antialiasing_picture(data, file) for file in files]),
            "regions": [*titles, {"title": "umbra, RMSE", "unit": "W m⁻² sr⁻¹, largest seed"}],
            "rows": rows,
            "answer": _answer(data, settings),
            "scene": f"{data.convergence['scene']} at {size_of(data.convergence)}",
            "confidence": percent(data.convergence["curves"][0]["confidence"]),
        }
    }


def _point(data: Data, region: str, light_samples: int, pixel_samples: int) -> dict[str, Any]:
    """One point of the C renderer's curve."""
    for c in data.convergence["curves"]:
        key = (c["renderer"], c["region"], c["pixel_samples"], c["against"])
        if key == ("penumbra", region, pixel_samples, "exact"):
            i = c["light_samples"].index(light_samples)
            return {k: c[k][i] for k in ("rmse", "low", "high", "seconds")}
    raise KeyError(f"curve of penumbra, {region}, M = {pixel_samples}")


def _umbra_rmse(data: Data, light_samples: int, pixel_samples: int) -> str:
    values = [
        float(row["rmse"])
        for row in data.convergence_rows
        if (row["renderer"], row["region"]) == ("penumbra", "umbra")
        and int(row["light_samples"]) == light_samples
        and int(row["pixel_samples"]) == pixel_samples
    ]
    return digits(max(values)) if values else "–"


def _answer(data: Data, settings: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """The numbers of the answer: compare measured each, or they are a ratio of two."""
    off, on, equal = (_point(data, "penumbra", n, m)["rmse"] for n, m in settings)
    return {
        "pixel_samples": PIXEL_SAMPLES,
        "expected": f"{math.sqrt(PIXEL_SAMPLES):g}",
        "off": digits(off),
        "on": digits(on),
        "gain": digits(off / on),
        "equal_samples": FEW * PIXEL_SAMPLES,
        "equal": digits(equal),
        "ratio": digits(on / equal),
    }


def speedup(data: Data) -> dict[str, Any]:
    """Figure 9."""
    study = data.speedup
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
        "speedup": {
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
                    "seconds": f"{digits(row['seconds'])} "
                    f"{interval(row['low'], row['high'], digits)}",
                    "speedup": digits(row["speedup"]),
                }
                for row in rows
            ],
        }
    }


def provenance(data: Data) -> dict[str, Any]:
    cycles = data.images[reference_file("tp3")].attributes
    return {
        "files": [_file_row(data, item) for item in IMAGES],
        "machine": data.convergence["machine"].items(),
        "versions": (data.convergence["versions"] | {"cycles": cycles["software"]}).items(),
        "scenes": [
            {"name": name, "hash": data.scenes[name].hash, "text": data.scene_texts[name].strip()}
            for name in SCENES
        ],
        "cycles_settings": _indented(str(cycles.get("settings", ""))),
    }


def _file_row(data: Data, item: Input) -> dict[str, Any]:
    image = data.images[item.file]
    height, width = image.shape
    a = image.attributes
    seconds = a.get("renderSeconds")
    return {
        "file": f"build/{item.file}",
        "scene": a.get("sceneName", item.scene),
        "size": f"{width} × {height}",
        "light_samples": a.get("lightSamples", "–"),
        "pixel_samples": a.get("pixelSamples", "–"),
        "seed": a.get("seed", "–"),
        "sampler": a.get("sampler", "–"),
        "software": a.get("software", "–"),
        "threads": a.get("threads", "–"),
        "seconds": digits(seconds) if isinstance(seconds, float) else "–",
    }


def _indented(text: str) -> str:
    try:
        return json.dumps(json.loads(text), indent=1)
    except ValueError:
        return text


def summary(data: Data) -> str:
    """What was rendered, in a line."""
    scene = data.scenes["tp3"]
    image = data.images[best_image_file("tp3")]
    cycles = data.images[reference_file("tp3")]
    machine = data.convergence["machine"]
    return (
        f"Scene {scene.name} (hash {scene.hash}) and two variants, {scene.width} × {scene.height}; "
        f"{image.attributes.get('software', 'the C renderer')}, seed "
        f"{image.attributes.get('seed', '?')}; {cycles.attributes.get('software', 'Cycles')}; on "
        f"{machine['processor']}, {machine['cores']} cores."
    )


def glance(data: Data) -> list[dict[str, str]]:
    """The results in one line each."""
    rows = _all_rows(data)
    verdicts = {row["verdict"] for row in rows}
    worst = next(v for v in ("differs", "undecided", "agrees") if v in verdicts)
    agreeing = sum(row["verdict"] == "agrees" for row in rows)
    others = _verdict_count(rows).partition(", ")[2]
    items = [
        {
            "term": "Is it right?",
            "value": f"{agreeing} of {len(rows)}",
            "text": "comparisons of regions agree" + (f"; {others}" if others else ""),
            "tone": worst,
        }
    ]
    slope = _slope_of(data, "penumbra", "all")
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
    off, on = (_point(data, "penumbra", FEW, m)["rmse"] for m in (1, PIXEL_SAMPLES))
    items.append(
        {
            "term": "What does anti-aliasing do?",
            "value": f"÷ {digits(off / on)}",
            "text": f"noise in the penumbra with {PIXEL_SAMPLES} pixel samples; the root of "
            f"{PIXEL_SAMPLES} is {math.sqrt(PIXEL_SAMPLES):g}",
        }
    )
    best = max(data.speedup["rows"], key=lambda row: row["threads"])
    items.append(
        {
            "term": "What do threads bring?",
            "value": f"× {digits(best['speedup'])}",
            "text": f"speed with {best['threads']} threads instead of one",
        }
    )
    return items


def _renderer(row: dict[str, Any]) -> str:
    return RENDERERS.get(row["renderer"], row["renderer"])


def _with_interval(point: dict[str, Any]) -> str:
    return f"{digits(point['rmse'])} {interval(point['low'], point['high'], digits)}"
