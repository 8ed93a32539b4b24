"""The catalogue of mistakes: what is foretold of each is what each does to a picture."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from compare.check.catalogue import MODULES, RIGHT, Variant, catalogue
from compare.check.grid import Grid
from compare.check.moments import Moments, Sites, choice_id, render
from compare.check.prediction import Law, Surroundings, one_place, predict, surface_lights
from compare.check.view import _sites_at, _slope
from compare.scene import read_scene
from tests.conftest import ROOT

WIDTH, HEIGHT = 27, 18
LIGHT_GRID = 24


@dataclass(frozen=True)
class Stage:
    """A scene and the pixels of a picture of it that receive light."""

    file: Path
    around: Surroundings
    row: np.ndarray
    column: np.ndarray
    channel: np.ndarray


def stage(file: Path) -> Stage:
    scene = read_scene(file)
    grid = Grid(scene.camera.fov_y_deg)
    row, column = (a.ravel() for a in np.mgrid[0:HEIGHT, 0:WIDTH])
    sites = _sites_at(scene, grid, column.astype(float), row.astype(float), WIDTH, HEIGHT)
    distance = np.linalg.norm(sites.receivers.point - np.asarray(scene.camera.position), axis=1)
    met = (sites.receivers.object_id >= 0) & (distance < scene.ray_max_distance * 0.9)
    sites, row, column, distance = sites[met], row[met], column[met], distance[met]
    brdf = np.array([thing.brdf for thing in scene.objects])[sites.receivers.object_id]
    radiance = [np.asarray(scene.lights[i].radiance) for i in surface_lights(scene)]
    channel = np.argmax(brdf * sum(radiance), axis=1)
    around = Surroundings(
        tuple(Moments(file, i, sites, LIGHT_GRID) for i in surface_lights(scene)),
        scene,
        brdf[np.arange(len(row)), channel],
        tuple(r[channel] for r in radiance),
        np.asarray(scene.background_radiance)[channel],
        distance,
        _slope(scene, file, sites),
    )
    return Stage(file, around, row, column, channel)


def values(at: Stage, variant: Variant, n: int, m: int, seeds: int) -> np.ndarray:
    """(seeds, sites): what 8 bits would hold, unquantised."""
    pictures = [
        render(at.file, variant, (HEIGHT, WIDTH), n, m, seed)[at.row, at.column, at.channel]
        for seed in range(seeds)
    ]
    found = np.array(pictures, dtype=float)
    if variant["output"].field("wrap"):
        return found % (256 / 255)
    return np.clip(found, 0, 1)
