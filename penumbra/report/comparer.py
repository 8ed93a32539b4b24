"""The images that the comparer holds, and links into it."""

from __future__ import annotations

from typing import Any

from penumbra.language import _, say
from penumbra.report import figures
from penumbra.report.inputs import LIGHT_SAMPLES, Data, image_file
from penumbra.report.pictures import edge_crop, label_of


def compare(data: Data) -> dict[str, Any]:
    """Every image of the page, then the exact one of each scene; and what is shown first."""
    shown = [
        (data.inputs[file].scene, label_of(data.images[file]), data.images[file].radiance)
        for file in _files(data)
    ]
    for name, scene in data.scenes.items():
        shown.append((name, _("exact"), data.exact(name, scene.width, scene.height).radiance))
    first = image_file("tp3_statement", LIGHT_SAMPLES[1])
    middle = edge_crop(data, first)
    place = {"x": middle.left + middle.width // 2, "y": middle.top + middle.height // 2}
    return {
        "images": [
            {
                "label": label,
                "group": say("scene {scene}", scene=scene),
                "width": radiance.shape[1],
                "height": radiance.shape[0],
                "data": figures.packed_halves(radiance),
            }
            for scene, label, radiance in shown
        ],
        "start": link(data, first, "tp3_statement", "split") | place,
    }


def link(data: Data, a: str, b: str, mode: str) -> dict[str, Any]:
    """Into the comparer. a, b: an image's Input.file, or a scene's name for its exact image.
    mode: a, b, split or difference."""
    places = [*_files(data), *data.scenes]
    return {"a": places.index(a), "b": places.index(b), "mode": mode}


def _files(data: Data) -> list[str]:
    """The images, scene by scene."""
    names = list(data.scenes)
    return sorted(data.images, key=lambda file: names.index(data.inputs[file].scene))
