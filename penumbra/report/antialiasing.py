"""Why there is less noise in the shadow with anti-aliasing: the handout's question, measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from penumbra.compare.exact.image import LIT
from penumbra.language import N_, _, say
from penumbra.report import figures
from penumbra.report.comparer import link
from penumbra.report.convergence import point_of
from penumbra.report.figures import Crop
from penumbra.report.inputs import (
    CONVERGENCE,
    CONVERGENCE_CSV,
    FEW,
    PIXEL_SAMPLES,
    Data,
    image_file,
)
from penumbra.report.pictures import (
    ENLARGED,
    command_of,
    detail,
    edge_crop,
    facts_of,
    figure_of,
    label_of,
    samples_of,
)
from penumbra.report.words import digits, interval, percent, plain, region_title, size_of


def antialiasing(data: Data) -> dict[str, Any]:
    """Figure 6 and the measured answer to the handout's question."""
    settings = ((FEW, 1), (FEW, PIXEL_SAMPLES), (FEW * PIXEL_SAMPLES, 1))
    files = [image_file("tp3", n, m) for n, m in settings]
    regions = ("penumbra", "lit")
    rows = []
    for n, m in settings:
        points = [point_of(data, region, n, m) for region in regions]
        rows.append(
            {
                "light_samples": n,
                "pixel_samples": m,
                "rays": n * m,
                "noises": [*map(_with_interval, points), _umbra_rmse(data, n, m)],
                "seconds": digits(points[0]["seconds"]),
            }
        )
    titles = [
        {"title": say("{region}, relative RMSE", region=region_title(r)), "unit": _("[interval]")}
        for r in regions
    ]
    return {
        "figure": figure_of([_picture(data, file) for file in files]),
        "regions": [
            *titles,
            {"title": _("umbra, RMSE"), "unit": _("W m⁻² sr⁻¹, largest seed")},
        ],
        "rows": rows,
        "answer": _answer(data, settings),
        "scene": say(
            "{scene} at {size}",
            scene=data[CONVERGENCE]["scene"],
            size=size_of(data[CONVERGENCE]),
        ),
        "confidence": percent(data[CONVERGENCE]["curves"][0]["confidence"]),
        "link": link(data, files[1], files[2], "split"),
        "command": data[CONVERGENCE]["command"],
    }


def _umbra_rmse(data: Data, light_samples: int, pixel_samples: int) -> str:
    values = [
        float(row["rmse"])
        for row in data[CONVERGENCE_CSV]
        if (row["renderer"], row["region"]) == ("penumbra", "umbra")
        and int(row["light_samples"]) == light_samples
        and int(row["pixel_samples"]) == pixel_samples
    ]
    return digits(max(values)) if values else "–"


def _answer(data: Data, settings: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """The numbers of the answer: compare measured each, or they are a ratio of two."""
    off, on, equal = (point_of(data, "penumbra", n, m)["rmse"] for n, m in settings)
    return {
        "pixel_samples": PIXEL_SAMPLES,
        "expected": plain(f"{math.sqrt(PIXEL_SAMPLES):g}"),
        "off": digits(off),
        "on": digits(on),
        "gain": digits(off / on),
        "equal_samples": FEW * PIXEL_SAMPLES,
        "equal": digits(equal),
        "ratio": digits(on / equal),
    }


def _with_interval(point: dict[str, Any]) -> str:
    return f"{digits(point['rmse'])} {interval(point['low'], point['high'], digits)}"


def _picture(data: Data, file: str) -> dict[str, Any]:
    image = data.images[file]
    pixels = figures.displayed(image.radiance)
    penumbra, outline = (
        say(text, label=label_of(image))
        for text in (
            N_("Scene tp3, {label}: the penumbra enlarged"),
            N_("Scene tp3, {label}: the outline enlarged"),
        )
    )
    return {
        "detail": detail(pixels, edge_crop(data, file), penumbra),
        "edge": detail(pixels, _outline_crop(data, file), outline),
        "caption": samples_of(image),
        "facts": facts_of(image),
        "command": command_of(data, file),
    }


def _outline_crop(data: Data, file: str) -> Crop:
    """Around the lit outline of a sphere."""
    exact = data.truth(file)
    on_sphere = (exact.object_id >= 0) & (exact.object_id < len(data.scene(file).spheres))
    outline = exact.silhouette & on_sphere & (exact.shadow == LIT)
    height, width = exact.shadow.shape
    return figures.crop_around(outline, max(1, width // ENLARGED), max(1, height // ENLARGED))
