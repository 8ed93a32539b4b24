"""From the pipeline's files to one offline HTML page. Each function below fills one section."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from compare import provenance
from compare.exact import BACKGROUND, LIT, PENUMBRA, UMBRA
from compare.image import Image
from report import figures
from report.figures import Crop, Series
from report.inputs import (
    COMPARISONS,
    FEW,
    IMAGES,
    LIGHT_SAMPLES,
    PIXEL_SAMPLES,
    SCENES,
    Data,
    Input,
    ReportError,
    best_image_file,
    image_file,
    read_inputs,
    reference_file,
)

TEMPLATES = Path(__file__).resolve().parent / "template"
ENLARGED = 6
"""How many times smaller than the picture a crop is, shown at the picture's width."""
RELATIVE_LIMIT = 0.02
"""End of the colour bar of relative differences."""
Z_LIMIT = 4.0
"""End of the colour bar of standardised differences."""
FIRST_REGIONS = ("all", "lit", "penumbra")
REGIONS = {"all": "all objects"}
RENDERERS = {"penumbra": "C", "cycles": "Cycles"}

CONTENTS = (
    ("shadows", "Hard and soft shadows"),
    ("light", "The quad light"),
    ("ray", "One shadow ray"),
    ("samples", "More shadow rays"),
    ("compare", "Compare any two images"),
    ("agreement", "Is it right?"),
    ("convergence", "How fast does it converge?"),
    ("antialiasing", "Why is there less noise in the shadow?"),
    ("threads", "Threads"),
    ("remake", "What was rendered, and how to remake it"),
    ("glossary", "Glossary"),
)


def build(build_dir: Path, out: Path, scenes_dir: Path) -> None:
    """Write the page `out` from the files of `report.inputs.INPUTS` in build_dir.

    Raises ReportError for an input that is missing or unusable (naming it and the command
    that makes it), SceneError, and OSError if `out` cannot be written.
    """
    html = page(read_inputs(build_dir, scenes_dir))
    provenance.write_whole(out, lambda part: part.write_text(html, encoding="utf-8"))


def page(data: Data) -> str:
    """The whole page as HTML. Raises ReportError for an input that lacks something."""
    environment = jinja2.Environment(
        autoescape=True,
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    try:
        sections = {
            **_shadows(data),
            **_agreement(data),
            **_maps(data),
            **_convergence(data),
            **_antialiasing(data),
            **_speedup(data),
            **_provenance(data),
            **_comparer(data),
        }
        sections["glance"] = _glance(data)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ReportError(
            f"an input lacks what the page needs ({error!r}); `make clean` and `make report` "
            "make all of them anew"
        ) from error
    return environment.get_template("page.html.j2").render(
        **sections,
        version=provenance.VERSION,
        contents=CONTENTS,
        enlarged=ENLARGED,
        pixel_samples=PIXEL_SAMPLES,
        summary=_summary(data),
        scene=data.scenes["tp3"],
        light=figures.light_drawing(data.scenes["tp3"].quad_lights[0]),
        css=Markup((TEMPLATES / "page.css").read_text()),
        viewer=Markup((TEMPLATES / "viewer.js").read_text()),
    )


# Pictures


def _shadows(data: Data) -> dict[str, Any]:
    """Figures 1, 3 (right) and 4."""
    point, quad = best_image_file("tp3_point"), best_image_file("tp3")
    window = _edge_crop(data, image_file("tp3_statement", 1))
    statement = [image_file("tp3_statement", n) for n in (1, *LIGHT_SAMPLES)]
    one, *more = (_picture(data, file, window) for file in statement)
    return {
        "figure_1": _figure(
            [
                _picture(data, point, _edge_crop(data, point), "a point light"),
                _picture(data, quad, _edge_crop(data, quad), "a quad light"),
            ]
        ),
        "figure_3": _figure([one]),
        "figure_4": _figure(more),
    }


def _picture(data: Data, file: str, window: Crop, caption: str = "") -> dict[str, Any]:
    image = data.images[file]
    height, width = image.shape
    label = _label(image)
    pixels = figures.displayed(image.radiance)
    what = f"Scene {image.attributes['sceneName']}, {label}"
    return {
        "full": {
            "png": figures.png_uri(pixels),
            "width": width,
            "height": height,
            "alt": what,
            "window": {
                "left": 100 * window.left / width,
                "top": 100 * window.top / height,
                "width": 100 * window.width / width,
                "height": 100 * window.height / height,
            },
        },
        "detail": _detail(pixels, window, f"{what}: the framed part enlarged"),
        "caption": caption or _samples(image),
        "facts": _facts(image),
        "command": _command(data, file),
    }


def _detail(pixels: np.ndarray, window: Crop, alt: str) -> dict[str, Any]:
    return {
        "png": figures.png_uri(window.of(pixels)),
        "width": window.width,
        "height": window.height,
        "alt": alt,
        "window": None,
    }


def _edge_crop(data: Data, file: str) -> Crop:
    """Around the shadow on a plane: its penumbra, or both sides of a hard edge."""
    exact = data.truth(file)
    on_plane = exact.object_id >= len(data.scene(file).spheres)
    height, width = exact.shadow.shape
    size = max(1, width // ENLARGED), max(1, height // ENLARGED)
    edge = on_plane & (exact.shadow == PENUMBRA)
    if not edge.any():
        edge = on_plane & exact.silhouette & np.isin(exact.shadow, (LIT, UMBRA))
    # Rather a little less of the edge than another object in the window.
    return figures.crop_around(np.where(on_plane, edge, -1), *size)


def _outline_crop(data: Data, file: str) -> Crop:
    """Around the lit outline of a sphere."""
    exact = data.truth(file)
    on_sphere = (exact.object_id >= 0) & (exact.object_id < len(data.scene(file).spheres))
    outline = exact.silhouette & on_sphere & (exact.shadow == LIT)
    height, width = exact.shadow.shape
    return figures.crop_around(outline, max(1, width // ENLARGED), max(1, height // ENLARGED))


def _comparer(data: Data) -> dict[str, Any]:
    """The images that the comparer holds, and links into it."""
    shown = [
        (item.file, scene, _label(data.images[item.file]), data.images[item.file].radiance)
        for scene in SCENES
        for item in IMAGES
        if item.scene == scene
    ]
    for name, scene in data.scenes.items():
        exact = data.exact[name, scene.height, scene.width]
        shown.append((name, name, "exact", exact.radiance))
    index = {key: position for position, (key, *_) in enumerate(shown)}

    def link(a: str, b: str, mode: str) -> dict[str, Any]:
        return {"a": index[a], "b": index[b], "mode": mode}

    statement = [image_file("tp3_statement", n) for n in LIGHT_SAMPLES]
    antialiased = image_file("tp3", FEW, PIXEL_SAMPLES)
    middle = _edge_crop(data, statement[1])
    place = {"x": middle.left + middle.width // 2, "y": middle.top + middle.height // 2}
    return {
        "comparer_images": [
            {
                "label": label,
                "group": f"scene {scene}",
                "width": radiance.shape[1],
                "height": radiance.shape[0],
                "data": figures.packed_halves(radiance),
            }
            for _, scene, label, radiance in shown
        ],
        "links": {
            "start": link(statement[1], "tp3_statement", "split") | place,
            "figure_1": link(best_image_file("tp3_point"), best_image_file("tp3"), "a"),
            "figure_4": link(statement[0], statement[-1], "split"),
            "figure_8": link(antialiased, image_file("tp3", FEW * PIXEL_SAMPLES), "split"),
        },
    }


# Agreement


def _agreement(data: Data) -> dict[str, Any]:
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
        "confidence": " or ".join(_percent(c) for c in sorted({row["confidence"] for row in rows})),
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
        "label": f"{_name(data, first['image'])} against {_name(data, first['reference'])}",
        "delta": _percent(first["delta"]),
        "rows": [_agreement_row(row, axis) for row in rows],
    }


def _agreement_row(row: dict[str, Any], axis: float) -> dict[str, Any]:
    low, high = row["relative_low"], row["relative_high"]
    return {
        "region": row["region"].replace(":", ", "),
        "pixels": f"{row['pixels']:,}".replace(",", "\u202f"),
        "mean": _digits(row["mean_image"]),
        "bias": _signed_percent(row["relative_bias"]),
        "interval": _interval(low, high, _signed_percent),
        "dark": row["relative_to"] != row["region"],
        "detectable": _digits(_times(100, row["detectable_relative_bias"]), 2),
        "consistent": _fixed(_times(100, row["consistent_fraction"]), 2),
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
        "text": f"Interval from {_signed_percent(low)} to {_signed_percent(high)} percent",
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
                        "pair": f"{_name(data, comparison['rows'][0]['image'])} against "
                        f"{_name(data, comparison['rows'][0]['reference'])}",
                        "region": region,
                        "flip": _digits(metrics["flip"]),
                        "delta_e": _digits(metrics["delta_e"]),
                        "relative_rmse": _digits(_times(100, metrics["relative_rmse"])),
                    }
                )
    return rows


def _maps(data: Data) -> dict[str, Any]:
    """Figure 5."""
    files = (best_image_file("tp3"), reference_file("tp3"))
    maps = [_relative_map(data, file) for file in files]
    maps += [_z_map(data, file) for file in files if data.images[file].variance is not None]
    return {
        "figure_5": _figure(maps),
        "colour_stops": Markup(",".join(figures.diverging_stops())),
    }


def _relative_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.relative_difference(data.images[file].radiance, data.truth(file).radiance)
    end = f"{100 * RELATIVE_LIMIT:g} %"
    return _map(data, file, values, RELATIVE_LIMIT, f"−{end}", f"+{end}", "relative difference")


def _z_map(data: Data, file: str) -> dict[str, Any]:
    values = figures.standardised_difference(data.images[file], data.truth(file))
    end = f"{Z_LIMIT:g}"
    return _map(data, file, values, Z_LIMIT, f"−{end}", f"+{end}", "standardised difference z")


def _map(
    data: Data, file: str, values: np.ndarray, limit: float, low: str, high: str, what: str
) -> dict[str, Any]:
    image = data.images[file]
    background = data.truth(file).shadow == BACKGROUND
    name = _name(data, file)
    return {
        "png": figures.png_uri(figures.diverging_map(values, limit, background)),
        "width": image.shape[1],
        "height": image.shape[0],
        "alt": f"Error map: {what} of {name} from exact, per pixel",
        "bar": what,
        "low": low,
        "high": high,
        "caption": f"{name} − exact: {what}",
        "facts": _facts(image),
        "command": _command(data, file),
    }


# Convergence


def _convergence(data: Data) -> dict[str, Any]:
    """Figures 6 and 7, and the slopes."""
    curves = [c for c in data.convergence["curves"] if c["against"] == "exact"]
    regions = _panel_regions(curves)
    style = figures.styles(c["renderer"] for c in curves)
    scene = data.convergence["scene"]
    confidence = _percent(curves[0]["confidence"])
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
            f"at {_size(data.convergence)} pixels, M = 1; {bands}. Dashed: slope −1/2."
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
        "slope": _fixed(slope["slope"]),
        "interval": _interval(slope["low"], slope["high"], _fixed),
        "confidence": _percent(slope["confidence"]),
    }


def _slope_of(data: Data, renderer: str, region: str) -> dict[str, Any] | None:
    for slope in data.convergence["slopes"]:
        key = (slope["renderer"], slope["region"], slope["pixel_samples"], slope["against"])
        if key == (renderer, region, 1, "exact"):
            return slope
    return None


def _slope_text(slope: dict[str, Any]) -> str:
    return f"{_fixed(slope['slope'])} {_interval(slope['low'], slope['high'], _fixed)}"


def _slope_sentence(data: Data) -> str:
    slope = _slope_of(data, "penumbra", "all")
    if slope is None:
        return ""
    confidence = _percent(slope["confidence"])
    return f"Measured for C over all objects: {_slope_text(slope)}, a {confidence} interval."


# Anti-aliasing


def _antialiasing(data: Data) -> dict[str, Any]:
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
                "seconds": _digits(points[0]["seconds"]),
            }
        )
    titles = [{"title": f"{r}, relative RMSE", "unit": "[interval]"} for r in regions]
    return {
        "antialiasing": {
            "figure": _figure([_antialiasing_picture(data, file) for file in files]),
            "regions": [*titles, {"title": "umbra, RMSE", "unit": "W m⁻² sr⁻¹, largest seed"}],
            "rows": rows,
            "answer": _answer(data, settings),
            "scene": f"{data.convergence['scene']} at {_size(data.convergence)}",
            "confidence": _percent(data.convergence["curves"][0]["confidence"]),
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
    return _digits(max(values)) if values else "–"


def _antialiasing_picture(data: Data, file: str) -> dict[str, Any]:
    image = data.images[file]
    pixels = figures.displayed(image.radiance)
    what = f"Scene tp3, {_label(image)}"
    return {
        "detail": _detail(pixels, _edge_crop(data, file), f"{what}: the penumbra enlarged"),
        "edge": _detail(pixels, _outline_crop(data, file), f"{what}: the outline enlarged"),
        "caption": _samples(image),
        "facts": _facts(image),
        "command": _command(data, file),
    }


def _answer(data: Data, settings: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """The numbers of the answer: compare measured each, or they are a ratio of two."""
    off, on, equal = (_point(data, "penumbra", n, m)["rmse"] for n, m in settings)
    return {
        "pixel_samples": PIXEL_SAMPLES,
        "expected": f"{math.sqrt(PIXEL_SAMPLES):g}",
        "off": _digits(off),
        "on": _digits(on),
        "gain": _digits(off / on),
        "equal_samples": FEW * PIXEL_SAMPLES,
        "equal": _digits(equal),
        "ratio": _digits(on / equal),
    }


# Threads


def _speedup(data: Data) -> dict[str, Any]:
    """Figure 9."""
    study = data.speedup
    rows = study["rows"]
    one = next(row["seconds"] for row in rows if row["threads"] == 1)
    best = max(rows, key=lambda row: row["threads"])
    cores = study["machine"]["cores"]
    sentence = (
        f"Here {best['threads']} threads take {_digits(best['seconds'])} s where one takes "
        f"{_digits(one)} s: {_digits(best['speedup'])} times faster."
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
                    "seconds": f"{_digits(row['seconds'])} "
                    f"{_interval(row['low'], row['high'], _digits)}",
                    "speedup": _digits(row["speedup"]),
                }
                for row in rows
            ],
        }
    }


# Provenance


def _provenance(data: Data) -> dict[str, Any]:
    settings = data.images[reference_file("tp3")].attributes.get("settings", "")
    return {
        "files": [_file_row(data, item) for item in IMAGES],
        "machine": data.convergence["machine"].items(),
        "versions": data.convergence["versions"].items(),
        "scenes": [
            {"name": name, "hash": data.scenes[name].hash, "text": data.scene_texts[name].strip()}
            for name in SCENES
        ],
        "cycles_settings": _indented(str(settings)),
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
        "seconds": _digits(seconds) if isinstance(seconds, float) else "–",
    }


def _indented(text: str) -> str:
    try:
        return json.dumps(json.loads(text), indent=1)
    except ValueError:
        return text


def _summary(data: Data) -> str:
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


def _glance(data: Data) -> list[dict[str, str]]:
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
                "power": _fixed(slope["slope"]),
                "text": f"error of C over all objects, {_percent(slope['confidence'])} interval "
                f"{_interval(slope['low'], slope['high'], _fixed)}",
            }
        )
    off, on = (_point(data, "penumbra", FEW, m)["rmse"] for m in (1, PIXEL_SAMPLES))
    items.append(
        {
            "term": "What does anti-aliasing do?",
            "value": f"÷ {_digits(off / on)}",
            "text": f"noise in the penumbra with {PIXEL_SAMPLES} pixel samples; the root of "
            f"{PIXEL_SAMPLES} is {math.sqrt(PIXEL_SAMPLES):g}",
        }
    )
    best = max(data.speedup["rows"], key=lambda row: row["threads"])
    items.append(
        {
            "term": "What do threads bring?",
            "value": f"× {_digits(best['speedup'])}",
            "text": f"speed with {best['threads']} threads instead of one",
        }
    )
    return items


# Words and numbers


def _size(values: dict[str, Any]) -> str:
    return f"{values['width']} × {values['height']}"


def _label(image: Image) -> str:
    """What an image is, from its header: "C, N = 64"."""
    if _is_cycles(image):
        return "Cycles"
    return f"C, {_samples(image)}"


def _samples(image: Image) -> str:
    n, m = image.attributes.get("lightSamples", "?"), image.attributes.get("pixelSamples", 1)
    return f"N = {n}" + (f", M = {m}" if m != 1 else "")


def _is_cycles(image: Image) -> bool:
    return "parts" in image.attributes


def _facts(image: Image) -> list[str]:
    a = image.attributes
    seconds = a.get("renderSeconds")
    facts = [
        f"scene {a.get('sceneName', '?')}",
        f"{image.shape[1]} × {image.shape[0]}",
        f"N = {a.get('lightSamples', '?')}",
        f"M = {a.get('pixelSamples', '?')}",
        f"seed {a.get('seed', '?')}",
        f"{a.get('software', '?')}",
        f"{a.get('threads', '?')} threads",
    ]
    return [*facts, f"{_digits(seconds)} s"] if isinstance(seconds, float) else facts


def _figure(cells: list[dict[str, Any]]) -> dict[str, Any]:
    """A figure of images: what all have in common is said once, the rest under each."""
    common = [f for f in cells[0]["facts"] if all(f in cell["facts"] for cell in cells)]
    for cell in cells:
        said = [*common, *cell["caption"].split(", ")]
        cell["facts"] = " · ".join(fact for fact in cell["facts"] if fact not in said)
    return {
        "cells": cells,
        "common": " · ".join(common),
        "commands": list(dict.fromkeys(cell["command"] for cell in cells)),
    }


def _command(data: Data, file: str) -> str:
    """What remakes an image, with the samples, seed and size of its header."""
    item = next(i for i in IMAGES if i.file == file)
    image = data.images[file]
    if _is_cycles(image):
        return item.command
    a, scene = image.attributes, data.scenes[item.scene]
    size = ""
    if image.shape != (scene.height, scene.width):
        size = f" --width {image.shape[1]} --height {image.shape[0]}"
    return (
        f"build/bin/penumbra-render scenes/{item.scene}.json --light-samples {a['lightSamples']} "
        f"--pixel-samples {a['pixelSamples']} --seed {a['seed']}{size} -o build/{file}"
    )


def _name(data: Data, text: str) -> str:
    """A file named in agreement.json, in words where the page knows it."""
    for file, image in data.images.items():
        if text.replace("\\", "/").endswith(file):
            return _label(image)
    return text


def _renderer(row: dict[str, Any]) -> str:
    return RENDERERS.get(row["renderer"], row["renderer"])


def _digits(value: float | None, digits: int = 3) -> str:
    """
    >>> _digits(0.0123456), _digits(-12345.0), _digits(0.0), _digits(None)
    ('0.0123', '−12300', '0', '–')
    """
    if value is None:
        return "–"
    if value == 0 or not math.isfinite(value):
        return {0: "0", math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    rounded = float(f"{value:.{digits}g}")
    if 1e-3 <= abs(rounded) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
        return f"{rounded:.{decimals}f}".replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    superscript = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} × 10{superscript}".replace("-", "−")


def _fixed(value: float | None, decimals: int = 3) -> str:
    return "–" if value is None else f"{value:.{decimals}f}".replace("-", "−")


def _signed_percent(value: float | None) -> str:
    """
    >>> _signed_percent(-0.000123), _signed_percent(1.2e-9), _signed_percent(None)
    ('−0.0123', '0.0000', '–')
    """
    if value is None:
        return "–"
    text = f"{100 * value:+.4f}"
    return "0.0000" if float(text) == 0 else text.replace("-", "−")


def _percent(value: float) -> str:
    return f"{100 * value:.4g} %"


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def _interval(low: float | None, high: float | None, text: Callable[[float], str]) -> str:
    return "–" if low is None or high is None else f"[{text(low)}, {text(high)}]"


def _with_interval(point: dict[str, Any]) -> str:
    return f"{_digits(point['rmse'])} {_interval(point['low'], point['high'], _digits)}"
