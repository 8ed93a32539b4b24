"""The shadow's edge along a line on the floor, exact, under one light after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from penumbra.compare.exact.image import PENUMBRA, UMBRA, shade
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.measure.metrics import luminance
from penumbra.compare.run import provenance
from penumbra.compare.run.output import write_json
from penumbra.compare.scene import Plane, Scene, Vec3, read_scene

START, END = (-3.0, -2.0, 3.0), (3.0, -2.0, 3.0)
"""[m]: on the floor of tp3, below the ball from one side of its shadow to the other"""
POINTS = 601


class ProfileError(ValueError):
    """The line does not lie in a plane of the scene."""


def profile(
    scene_files: Sequence[Path], out: Path, start: Vec3 = START, end: Vec3 = END
) -> dict[str, Any]:
    """Write out, a JSON: for each scene the exact radiance [W m^-2 sr^-1], (R + G + B)/3, at POINTS
    even steps from start to end [m], and how much of the line is in umbra and in penumbra [m].

    Raises SceneError, ProfileError, OSError.
    """
    share = np.linspace(0, 1, POINTS)[:, None]
    points = (1 - share) * np.asarray(start) + share * np.asarray(end)
    along = np.linalg.norm(points - np.asarray(start), axis=1)
    rows = []
    for file in scene_files:
        scene = read_scene(file)
        radiance, _, shadow, *_ = shade(scene, _receivers(scene, points, file))
        rows.append(
            {
                "scene": scene.name,
                "scene_hash": scene.hash,
                "radiance": luminance(radiance).tolist(),
                "umbra": float(along[-1] * np.mean(shadow == UMBRA)),
                "penumbra": float(along[-1] * np.mean(shadow == PENUMBRA)),
            }
        )
    result = {
        "start": start,
        "end": end,
        "along": along.tolist(),
        "rows": rows,
        **provenance.origin(),
    }
    write_json(out, result)
    return result


def _receivers(scene: Scene, points: np.ndarray, file: Path) -> Receivers:
    for index, thing in enumerate(scene.objects):
        if isinstance(thing, Plane):
            normal = np.asarray(thing.normal)
            if np.abs((points - np.asarray(thing.point)) @ normal).max() < 1e-9:
                count = len(points)
                return Receivers(
                    np.full(count, index),
                    points,
                    np.broadcast_to(normal, points.shape),
                    np.zeros(count, dtype=bool),
                )
    raise ProfileError(f"{file}: the line from {points[0]} to {points[-1]} lies in no plane of it")
