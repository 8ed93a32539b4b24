"""The shadow, hard and soft, and with more and more samples: figures 1 and 2."""

from __future__ import annotations

from typing import Any

from penumbra.language import _
from penumbra.report.comparer import link
from penumbra.report.inputs import LIGHT_SAMPLES, Data, best_image_file, image_file
from penumbra.report.pictures import edge_crop, figure_of, picture

POINT, QUAD = best_image_file("tp3_point"), best_image_file("tp3")
MORE = tuple(image_file("tp3_statement", n) for n in (1, *LIGHT_SAMPLES))


def shadows(data: Data) -> dict[str, Any]:
    """Figure 1."""
    point = picture(data, POINT, edge_crop(data, POINT), _("a point light"))
    quad = picture(data, QUAD, edge_crop(data, QUAD), _("a quad light"))
    return {"figure": figure_of([point, quad]), "link": link(data, POINT, QUAD, "a")}


def samples(data: Data) -> dict[str, Any]:
    """Figure 2. All show the same window."""
    window = edge_crop(data, MORE[0])
    return {
        "figure": figure_of([picture(data, file, window) for file in MORE]),
        "link": link(data, MORE[0], MORE[-1], "split"),
    }
