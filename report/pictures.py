"""The page's pictures of rendered images: figures 1, 3, 4, 5 and 8, and the comparer's store."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup

from compare.exact.image import BACKGROUND, LIT, PENUMBRA, UMBRA
from compare.measure.image import Image
from report import figures
from report.figures import Crop
from report.inputs import (
    FEW,
    IMAGES,
    LIGHT_SAMPLES,
    PIXEL_SAMPLES,
    SCENES,
    Data,
    best_image_file,
    image_file,
    reference_file,
)
from report.words import digits

ENLARGED = 6
"""How many times smaller than the picture a crop is, shown at the picture's width."""
RELATIVE_LIMIT = 0.02
"""End of the colour bar of relative differences."""
Z_LIMIT = 4.0
"""End of the colour bar of standardised differences."""


def shadows(data: Data) -> dict[str, Any]:
    """Figures 1, 3 (right) and 4."""
    point, quad = best_image_file("tp3_point"), best_image_file("tp3")
    window = _edge_crop(data, image_file("tp3_statement", 1))
    statement = [image_file("tp3_statement", n) for n in (1, *LIGHT_SAMPLES)]
    one, *more = (_picture(data, file, window) for file in statement)
    return {
        "figure_1": figure_of(
            [
                _picture(data, point, _edge_crop(data, point), "a point light"),
                _picture(data, quad, _edge_crop(data, quad), "a quad light"),
            ]
        ),
        "figure_3": figure_of([one]),
        "figure_4": figure_of(more),
    }


def maps(data: Data) -> dict[str, Any]:
    """Figure 5."""
    files = (best_image_file("tp3"), reference_file("tp3"))
    maps = [_relative_map(data, file) for file in files]
    maps += [_z_map(data, file) for file in files if data.images[file].variance is not None]
    return {
        "figure_5": figure_of(maps),
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
    name = name_of(data, file)
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


def comparer(data: Data) -> dict[str, Any]:
    """The images that the comparer holds, and links into it."""
    shown = [
        (item.file, scene, label_of(data.images[item.file]), data.images[item.file].radiance)
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


def antialiasing_picture(data: Data, file: str) -> dict[str, Any]:
    image = data.images[file]
    pixels = figures.displayed(image.radiance)
    what = f"Scene tp3, {label_of(image)}"
    return {
        "detail": _detail(pixels, _edge_crop(data, file), f"{what}: the penumbra enlarged"),
        "edge": _detail(pixels, _outline_crop(data, file), f"{what}: the outline enlarged"),
        "caption": _samples(image),
        "facts": _facts(image),
        "command": _command(data, file),
    }


def _picture(data: Data, file: str, window: Crop, caption: str = "") -> dict[str, Any]:
    image = data.images[file]
    height, width = image.shape
    label = label_of(image)
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


def figure_of(cells: list[dict[str, Any]]) -> dict[str, Any]:
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
    return [*facts, f"{digits(seconds)} s"] if isinstance(seconds, float) else facts


def label_of(image: Image) -> str:
    """What an image is, from its header: "C, N = 64"."""
    if _is_cycles(image):
        return "Cycles"
    return f"C, {_samples(image)}"


def _samples(image: Image) -> str:
    n, m = image.attributes.get("lightSamples", "?"), image.attributes.get("pixelSamples", 1)
    return f"N = {n}" + (f", M = {m}" if m != 1 else "")


def _is_cycles(image: Image) -> bool:
    return "parts" in image.attributes


def name_of(data: Data, text: str) -> str:
    """A file named in agreement.json, in words where the page knows it."""
    for file, image in data.images.items():
        if text.replace("\\", "/").endswith(file):
            return label_of(image)
    return text


def _command(data: Data, file: str) -> str:
    """What remakes an image, with the samples, seed and size of its header."""
    scene_name = next(i.scene for i in IMAGES if i.file == file)
    image, scene = data.images[file], data.scenes[scene_name]
    a = image.attributes
    size = ""
    if image.shape != (scene.height, scene.width):
        size = f" --width {image.shape[1]} --height {image.shape[0]}"
    if _is_cycles(image):
        return (
            f"penumbra reference scenes/{scene_name}.json --samples {a['lightSamples']} "
            f"--parts {a['parts']} --seed {a['seed']}{size} -o build/{file}"
        )
    return (
        f"build/bin/penumbra-render scenes/{scene_name}.json --light-samples {a['lightSamples']} "
        f"--pixel-samples {a['pixelSamples']} --seed {a['seed']}{size} -o build/{file}"
    )
