"""Pictures to hold a student's beside: the right one, the mistaken one, what neither has."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.prediction import TOP
from penumbra.compare.check.view import View
from penumbra.compare.exact.image import shade

ROWS = 32
"""Rows whose light is computed together: bounds the memory"""
PLACES = (-1 / 3, 0.0, 1 / 3)
"""In a pixel, about its middle, where rays are random"""


def right_picture(view: View, factor: float = 1.0) -> np.ndarray:
    """What the light really is through the picture's own rays, without noise: (H, W, 3) float64
    [W m^-2 sr^-1], clamped to [0, 1] where the picture is. factor: of a light of another power."""
    scene, grid = view.scene, view.grid
    height, width = view.picture.values.shape[:2]
    places = [(x, y) for x in PLACES for y in PLACES] if grid.jittered else [(0.0, 0.0)]
    radiance = np.zeros((height, width, 3))
    for first in range(0, height, ROWS):
        row, column = (a.ravel() for a in np.mgrid[first : min(first + ROWS, height), 0:width])
        for dx, dy in places:
            hits = grid.hits(scene, column + dx, row + dy, width, height)
            shown = shade(scene, hits)[0]
            shown[hits.object_id >= 0] *= factor
            shown = _recoloured(view, shown, hits.object_id)
            radiance[row, column] += shown / len(places)
    return _clamped(view, radiance)


def mistaken_picture(view: View, scene_file: Path, variant: Variant, seed: int = 1) -> np.ndarray:
    """What a renderer with these mistakes makes, with its noise, through the picture's own rays:
    (H, W, 3) float32, clamped or wrapped as in its file. Raises MissingProgramError."""
    picture = view.picture
    radiance = render(
        scene_file,
        variant,
        (picture.values.shape[0], picture.values.shape[1]),
        picture.nb_light_samples,
        picture.samples_per_pixel,
        seed,
        grid=view.grid,
    )
    if view.recoloured:
        height, width = radiance.shape[:2]
        row, column = (a.ravel() for a in np.mgrid[0:height, 0:width])
        seen = view.grid.hits(view.scene, column, row, width, height).object_id
        radiance = _recoloured(view, radiance.reshape(-1, 3), seen).reshape(radiance.shape)
    if variant["output"].field("wrap"):
        return np.asarray(np.mod(radiance, TOP))
    return _clamped(view, radiance)


def _recoloured(view: View, radiance: np.ndarray, object_id: np.ndarray) -> np.ndarray:
    """(n, 3), with objects in the colours that they have in the picture."""
    for i, thing in enumerate(view.scene.objects):
        if thing.name in view.recoloured:
            on = object_id == i
            radiance[on] = radiance[on].max(axis=1, keepdims=True) * view.recoloured[thing.name]
    return radiance


def _clamped(view: View, radiance: np.ndarray) -> np.ndarray:
    return radiance if view.picture.law == "float" else np.clip(radiance, 0, 1)


def unexplained(view: View, scene_file: Path, variant: Variant) -> np.ndarray:
    """(H, W) float64: of the cell around each pixel, how far the picture's mean is above what the
    variant foretells [standard errors, the check's tolerance among them]; NaN where no cell is.
    Raises MissingProgramError."""
    picture, light_grid = view.picture, view.around.moments[0].grid
    every_cell = picture.values.size
    view = View(picture, view.grid, view.scene, scene_file, light_grid, every_cell)
    found = view.held_against(variant)
    height, width = view.picture.values.shape[:2]
    shown = np.full((height, width), np.nan)
    score = (found.residual / np.sqrt(found.residual_variance))[view.cell]
    # where nothing happens a cell is of every other pixel
    for down, right in ((1, 1), (1, 0), (0, 1), (0, 0)):
        row, column = view.row + down, view.column + right
        inside = (row < height) & (column < width)
        shown[row[inside], column[inside]] = score[inside]
    return shown
