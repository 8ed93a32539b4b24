"""Rendered images as the page shows them, and what it says under each."""

from __future__ import annotations

from typing import Any

import numpy as np

from penumbra.compare.exact.image import LIT, PENUMBRA, UMBRA, ExactImage
from penumbra.compare.measure.image import Image
from penumbra.compare.scene import Scene
from penumbra.language import N_, _, say
from penumbra.report import figures
from penumbra.report.figures import Crop
from penumbra.report.inputs import Data
from penumbra.report.words import digits

ENLARGED = 6
"""How many times smaller than the picture a crop is, shown at the picture's width."""


def picture(data: Data, file: str, window: Crop, caption: str = "") -> dict[str, Any]:
    image = data.images[file]
    height, width = image.shape
    label = label_of(image)
    pixels = figures.displayed(image.radiance)
    whole, framed = (
        say(text, scene=str(image.attributes["sceneName"]), label=label)
        for text in (
            N_("Scene {scene}, {label}"),
            N_("Scene {scene}, {label}: the framed part enlarged"),
        )
    )
    return {
        "full": {
            "png": figures.png_uri(pixels),
            "width": width,
            "height": height,
            "alt": whole,
            "window": {
                "left": 100 * window.left / width,
                "top": 100 * window.top / height,
                "width": 100 * window.width / width,
                "height": 100 * window.height / height,
            },
        },
        "detail": detail(pixels, window, framed),
        "caption": caption or samples_of(image),
        "facts": facts_of(image),
        "command": command_of(data, file),
    }


def detail(pixels: np.ndarray, window: Crop, alt: str) -> dict[str, Any]:
    return {
        "png": figures.png_uri(window.of(pixels)),
        "width": window.width,
        "height": window.height,
        "alt": alt,
        "window": None,
    }


def edge_crop(data: Data, file: str) -> Crop:
    return edge_window(data.scene(file), data.truth(file))


def edge_window(scene: Scene, exact: ExactImage) -> Crop:
    """Around the shadow on a plane: its penumbra, or both sides of a hard edge."""
    on_plane = exact.object_id >= len(scene.spheres)
    height, width = exact.shadow.shape
    size = max(1, width // ENLARGED), max(1, height // ENLARGED)
    edge = on_plane & (exact.shadow == PENUMBRA)
    if not edge.any():
        edge = on_plane & exact.silhouette & np.isin(exact.shadow, (LIT, UMBRA))
    # Rather a little less of the edge than another object in the window.
    return figures.crop_around(np.where(on_plane, edge, -1), *size)


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


def facts_of(image: Image) -> list[str]:
    a = image.attributes
    seconds = a.get("renderSeconds")
    facts = [
        say("scene {scene}", scene=str(a.get("sceneName", "?"))),
        f"{image.shape[1]} × {image.shape[0]}",
        f"N = {a.get('lightSamples', '?')}",
        f"M = {a.get('pixelSamples', '?')}",
        say("seed {seed}", seed=str(a.get("seed", "?"))),
        f"{a.get('software', '?')}",
        say("{count} threads", count=str(a.get("threads", "?"))),
    ]
    return [*facts, f"{digits(seconds)} s"] if isinstance(seconds, float) else facts


def label_of(image: Image) -> str:
    """What an image is, from its header: "C, N = 64"."""
    if _is_cycles(image):
        return "Cycles"
    return f"C, {samples_of(image)}"


def samples_of(image: Image) -> str:
    n, m = image.attributes.get("lightSamples", "?"), image.attributes.get("pixelSamples", 1)
    return f"N = {n}" + (f", M = {m}" if m != 1 else "")


def _is_cycles(image: Image) -> bool:
    return "parts" in image.attributes


def name_of(data: Data, text: str) -> str:
    """A file named in agreement.json, in words where the page knows it."""
    for file, image in data.images.items():
        if text.replace("\\", "/").endswith(file):
            return label_of(image)
    return _("exact") if text == "exact" else text


def command_of(data: Data, file: str) -> str:
    """What remakes an image, with the samples, seed and size of its header."""
    scene_name = data.inputs[file].scene
    image, scene = data.images[file], data.scene(file)
    a = image.attributes
    size = ""
    if image.shape != (scene.height, scene.width):
        size = f" --width {image.shape[1]} --height {image.shape[0]}"
    if _is_cycles(image):
        return (
            f"penumbra reference scenes/{scene_name}.json --samples {a['lightSamples']} "
            f"--parts {a['parts']} --seed {a['seed']}{size} -o build/{file}"
        )
    how = ""
    for option, default in (("sampler", "independent"), ("estimator", "area")):
        how += f" --{option} {a[option]}" if a.get(option, default) != default else ""
    return (
        f"build/bin/penumbra-render scenes/{scene_name}.json --light-samples {a['lightSamples']} "
        f"--pixel-samples {a['pixelSamples']} --seed {a['seed']}{size}{how} -o build/{file}"
    )
