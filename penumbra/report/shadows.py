"""The shadow, and how it is estimated: figures 1 to 4."""

from __future__ import annotations

from typing import Any

from penumbra.report import figures
from penumbra.report.comparer import link
from penumbra.report.inputs import LIGHT_SAMPLES, Data, best_image_file, image_file
from penumbra.report.pictures import edge_crop, figure_of, picture

POINT, QUAD = best_image_file("tp3_point"), best_image_file("tp3")
ONE, *MORE = (image_file("tp3_statement", n) for n in (1, *LIGHT_SAMPLES))


def shadows(data: Data) -> dict[str, Any]:
    """Figure 1."""
    point = picture(data, POINT, edge_crop(data, POINT), "a point light")
    quad = picture(data, QUAD, edge_crop(data, QUAD), "a quad light")
    return {"figure": figure_of([point, quad]), "link": link(data, POINT, QUAD, "a")}


def light(data: Data) -> dict[str, Any]:
    """Figure 2."""
    scene = data.scenes["tp3"]
    return {"scene": scene.name, **figures.light_drawing(scene.quad_lights[0])}


def ray(data: Data) -> dict[str, Any]:
    """Figure 3, right."""
    return {"figure": figure_of([picture(data, ONE, edge_crop(data, ONE))])}


def samples(data: Data) -> dict[str, Any]:
    """Figure 4. All show the window of figure 3."""
    window = edge_crop(data, ONE)
    return {
        "figure": figure_of([picture(data, file, window) for file in MORE]),
        "link": link(data, MORE[0], MORE[-1], "split"),
    }
