"""What was rendered, on what, and how."""

from __future__ import annotations

import json
from typing import Any

from penumbra.language import N_, _
from penumbra.report.inputs import CONVERGENCE, Data, reference_file
from penumbra.report.words import digits

MACHINE = {"processor": N_("processor"), "cores": N_("cores"), "system": N_("system")}


def remake(data: Data) -> dict[str, Any]:
    cycles = data.images[reference_file("tp3")].attributes
    return {
        "files": [_file_row(data, file) for file in data.images],
        "machine": [
            (_(MACHINE.get(key, key)), value) for key, value in data[CONVERGENCE]["machine"].items()
        ],
        "versions": (data[CONVERGENCE]["versions"] | {"cycles": cycles["software"]}).items(),
        "scenes": [
            {"name": name, "hash": scene.hash, "text": data.scene_texts[name].strip()}
            for name, scene in data.scenes.items()
        ],
        "cycles_settings": _indented(str(cycles.get("settings", ""))),
    }


def _file_row(data: Data, file: str) -> dict[str, Any]:
    image = data.images[file]
    height, width = image.shape
    a = image.attributes
    seconds = a.get("renderSeconds")
    return {
        "file": f"build/{file}",
        "scene": a.get("sceneName", data.inputs[file].scene),
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
