"""A picture laid over its scene: which pixels tell of the light, and cells of them.

Two statistics a cell, each held against what a renderer (a Variant) foretells: the mean's residual,
and the noise within the cell, its own mean taken out, so that a wrong mean does not hide how the
noise falls with N. Both with Student's t and a tolerance, so that what the model leaves out (the
edges of pixels, a framework's own offsets) cannot shout. docs/check.md derives it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from penumbra.compare.check.catalogue import RIGHT, Variant
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.moments import Moments
from penumbra.compare.check.picture import Picture
from penumbra.compare.check.prediction import Law, Surroundings, predict, surface_lights
from penumbra.compare.check.quadrature import Sites
from penumbra.compare.scene import Scene

CELL, THIN = 8, 2
"""A cell's side [pixels]; where nothing happens cells are THIN times larger, of every THIN-th
pixel."""
RIM = 3
"""Pixels so near to another object are left out: half of them show both."""
FAR = 0.6
"""What lies beyond this part of the rays' length is left out: a pixel shows much of it."""
MOST_CELLS = 900
NU = 5.0
"""Student's t: how little a cell that no model explains may weigh"""
RELATIVE, NOISE = 2e-3, 0.15
"""Tolerance of the mean, relative; of the noise's variance, as a logarithm"""
SMOOTHED = 0.35
"""What halved colours leave of a pure colour's noise, about: a coarse JPEG's noise says little"""
SLOPE_GRID = 6
"""Squared, points of the light by which the slope of a penumbra is known"""
FEW_EVENTS = 8.0
SPARED = 0.8
"""Part of the foretold variance below which the samples are better spread than random ones"""
SHIFT, SHIFT_FITTED = 0.1, 0.25
"""What rays may be beside where the grid has them [pixels]; where the grid is no camera that the
scene has but one that was fitted"""
FEW = 6
"""Pixels without which a cell tells no noise"""


@dataclass(frozen=True)
class Statistics:
    """Of every cell, (c,) each, observed against a law."""

    residual: np.ndarray
    """mean of observed - foretold"""
    residual_variance: np.ndarray
    """with the tolerance"""
    noise: np.ndarray
    """observed variance within the cell"""
    foretold_noise: np.ndarray
    noise_ratio: np.ndarray
    """log of observed over foretold"""
    noise_variance: np.ndarray
    """of that logarithm, with the tolerance; inf where the cell is too small to tell"""
    mean: np.ndarray
    """foretold"""

    @property
    def misfit(self) -> np.ndarray:
        """(c,): squared residuals in units of their variance"""
        return self.residual**2 / self.residual_variance

    def loosened(self, loose: float) -> Statistics:
        """If the mean may be off by so much, relative."""
        most = np.maximum(self.mean, self.mean + self.residual)
        wide = self.residual_variance + (loose * most) ** 2 + (loose / 30) ** 2
        return replace(self, residual_variance=wide)


class View:
    """A picture on its grid, at the sites that tell. Raises MissingProgramError."""

    def __init__(
        self,
        picture: Picture,
        grid: Grid,
        scene: Scene,
        scene_file: Path,
        light_grid: int = 16,
        most_cells: int = MOST_CELLS,
    ) -> None:
        self.picture, self.grid, self.scene, self.quick = picture, grid, scene, False
        self._parts: dict[tuple[int, int], View] = {}  # of all pictures with these rays
        height, width = picture.values.shape[:2]
        self.row, self.column, self.cell = _sites(
            scene, scene_file, grid, width, height, most_cells
        )
        self._look(scene_file, light_grid)

    def _look(self, scene_file: Path, light_grid: int) -> None:
        scene, picture, grid = self.scene, self.picture, self.grid
        height, width = picture.values.shape[:2]
        column, row = self.column.astype(float), self.row.astype(float)
        sites = _sites_at(scene, grid, column, row, width, height)
        self.object_id = sites.receivers.object_id
        brdf = np.array([thing.brdf for thing in scene.objects]).reshape(-1, 3)[self.object_id]
        lights = [np.asarray(scene.lights[i].radiance) for i in surface_lights(scene)]  # type: ignore[union-attr]
        self._foretold = brdf * sum(lights)
        self.channel = np.argmax(self._foretold, axis=1)
        every = np.arange(len(row))
        self.recoloured = self._recoloured(picture)
        self._turn_channels()
        self.value = np.minimum(picture.values[self.row, self.column, self.channel], 1)
        camera = np.asarray(scene.camera.position) + grid.moved * np.asarray(scene.camera.forward)
        self.around = Surroundings(
            tuple(Moments(scene_file, i, sites, light_grid) for i in surface_lights(scene)),
            scene,
            brdf.max(axis=1) if self.recoloured else brdf[every, self.channel],
            tuple(light[self.channel] for light in lights),
            np.asarray(scene.background_radiance)[self.channel],
            np.linalg.norm(sites.receivers.point - camera, axis=1),
            _slope(scene, scene_file, sites),
        )
        self._count()

    def _recoloured(self, picture: Picture) -> dict[str, tuple[float, float, float]]:
        """Objects whose colour in the picture is another than the scene's, and which it is, the
        largest channel 1."""
        found = {}
        seen = picture.values[self.row, self.column]
        for i, thing in enumerate(self.scene.objects):
            bright = (self.object_id == i) & (seen.max(axis=1) > 0.1) & (seen.max(axis=1) < 0.95)
            if bright.sum() < 50:
                continue
            colour = np.median(seen[bright] / seen[bright].max(axis=1)[:, None], axis=0)
            stated = self._foretold[self.object_id == i][0]
            stated = stated / max(stated.max(), 1e-9)
            if np.abs(colour - stated).max() > 0.25:
                r, g, b = (float(c) for c in colour / max(colour.max(), 1e-9))
                found[thing.name] = (r, g, b)
        return found

    def _turn_channels(self) -> None:
        """Where an object lacks the scene's main channel, its own brightest one is looked at
        instead; how bright it should be is then a guess, that it is as light a colour."""
        for i, thing in enumerate(self.scene.objects):
            colour = self.recoloured.get(thing.name)
            if colour and colour[self.channel[self.object_id == i][0]] < 0.5:
                self.channel[self.object_id == i] = int(np.argmax(colour))

    def _count(self) -> None:
        _, self.cell = np.unique(self.cell, return_inverse=True)
        self.count = np.bincount(self.cell).astype(float)

    @property
    def sites(self) -> Sites:
        return self.around.moments[0].sites

    def part(self, share: int, light_grid: int) -> View:
        """Every share-th cell, its moments computed anew with light_grid squared points."""
        if (share, light_grid) in self._parts:
            return self._parts[share, light_grid].of(self.picture, self.grid)
        which = np.flatnonzero(self.cell % share == 0)
        part = object.__new__(View)
        part.__dict__.update(self.__dict__)
        for name in ("row", "column", "cell", "object_id", "channel", "value"):
            setattr(part, name, getattr(self, name)[which])
        around = self.around
        part.quick = True
        part.around = replace(
            around,
            moments=tuple(
                Moments(m.scene_file, m.light, m.sites[which], light_grid) for m in around.moments
            ),
            flat_colour=around.flat_colour[which],
            radiance=tuple(r[which] for r in around.radiance),
            background=around.background[which],
            distance=around.distance[which],
            slope=around.slope[which],
        )
        part._count()
        self._parts[share, light_grid] = part
        return part

    def of(self, picture: Picture, grid: Grid) -> View:
        """Another picture with the same rays."""
        view = object.__new__(View)
        view.__dict__.update(self.__dict__)
        view.picture, view.grid = picture, grid
        view.value = np.minimum(picture.values[self.row, self.column, self.channel], 1)
        return view

    def suits(self, picture: Picture) -> bool:
        """Whether of() shows it as a view of its own would: neither has colours of its own."""
        return not self.recoloured and not self._recoloured(picture)

    def prepare(self, keys: list[tuple[str, str, str]]) -> None:
        """Compute the moments that these need together."""
        for moments in self.around.moments:
            moments.prepare(keys)

    def predict(self, variant: Variant) -> Law:
        return predict(
            self.around,
            variant,
            self.picture.nb_light_samples,
            self.picture.samples_per_pixel,
            self.grid.jittered,
            self.quick,
        )

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Of each cell"""
        return np.bincount(self.cell, values, minlength=len(self.count)) / self.count

    def statistics(self, law: Law) -> Statistics:
        mean, variance = law.mean, law.variance
        step = self.picture.quantisation_variance
        shown = mean
        if step > 0:  # 8 bits: black below a step
            shown = np.where(
                (mean < 1 / 255) & (np.sqrt(variance) < 0.3 / 255), 0.0, np.minimum(mean, 1)
            )
        residual = self.value - shown
        mean_residual = self.mean(residual)
        within = self.mean(residual**2) - mean_residual**2
        ends = self.mean(((mean > 1 - 1e-6) | (mean < 1e-6)).astype(float))
        foretold = self.mean(variance)
        shown_mean = self.mean(shown)
        shared: np.ndarray | float = 1.0
        inside = foretold
        if law.correlation == "ALL":
            shared, inside = self.count, 0.03 * foretold
        elif law.correlation == "ROW":
            shared, inside = np.sqrt(self.count), foretold * (1 - 1 / np.sqrt(self.count))
        coarse = self.picture.jpeg == "coarse"
        inside = inside * (SMOOTHED if coarse else 1) + step * (1 - ends)
        floor, absolute = self._tolerances()
        variance_of_mean = foretold * shared / self.count + step * (1 - ends) / self.count
        beside = self.shift * self.mean(np.sqrt(12 * self.around.slope) * shown)
        residual_variance = (
            variance_of_mean + (RELATIVE * shown_mean) ** 2 + absolute**2 + beside**2
        )
        noise = within * self.count / np.maximum(self.count - 1, 1)
        ratio = np.log((noise + floor) / (inside + floor))
        wide: np.ndarray | float = 1.0 if law.correlation == "ALL" or coarse else NOISE**2
        if law.rare > 0.01:  # a cell may have none of those pixels, or many
            wide = wide + np.minimum(1 / (law.rare * np.maximum(self.count, 1)), 1)
        noise_variance = np.where(
            self.tells_noise, 2 * 1.5 / np.maximum(self.count - 1, 1) + wide, np.inf
        )
        return Statistics(
            mean_residual, residual_variance, noise, inside, ratio, noise_variance, shown_mean
        )

    @property
    def tells_noise(self) -> np.ndarray:
        """(c,) bool: whether the scatter in a cell is a variance. It is not where only a few
        samples are expected to be hidden among visible ones, or visible among hidden ones."""
        picture = self.picture
        drawn = picture.nb_light_samples * picture.samples_per_pixel
        few = np.zeros(len(self.count), dtype=bool)
        for moments in self.around.moments:
            p = moments[RIGHT, RIGHT, RIGHT][0].astype(float)
            events = drawn * self.mean(np.minimum(p, 1 - p)) * self.count
            few |= (events > 0) & (events < FEW_EVENTS)
        return (self.count >= FEW) & ~few

    @property
    def shift(self) -> float:
        """[pixels]"""
        grid = self.grid
        own = grid.fov_y_deg == self.scene.camera.fov_y_deg and grid.aspect == 1
        return SHIFT if own and not (grid.shift_x or grid.shift_y) else SHIFT_FITTED

    def _tolerances(self) -> tuple[float, float]:
        """Of the noise's variance and of the mean, absolute."""
        if self.picture.quantisation_variance == 0:
            return (0.25 / 255) ** 2, 1e-4
        jpeg = bool(self.picture.jpeg)
        return ((1.0 if jpeg else 0.5) / 255) ** 2, 0.25 * (3 if jpeg else 1) / 255

    def held_against(self, variant: Variant) -> Statistics:
        return self.statistics(self.predict(variant))

    def loglik(self, variant: Variant) -> float:
        """Log-likelihood of the picture."""
        return float(self.loglik_of(self.held_against(variant)).sum())

    def loglik_of(self, found: Statistics, spared_noise: bool = False) -> np.ndarray:
        """(c,): log-likelihood of every cell. spared_noise: noise that is lower than foretold by
        one factor is a better sampler, no fault."""
        ratio = found.noise_ratio
        if spared_noise:
            ratio = self._spared(found)
        s2 = found.residual_variance
        return (
            -0.5 * (NU + 1) * np.log1p(found.misfit / NU)
            - 0.5 * np.log(s2)
            - np.where(
                np.isfinite(found.noise_variance),
                0.5 * (NU + 1) * np.log1p(ratio**2 / found.noise_variance / NU)
                + 0.5 * np.log(found.noise_variance),
                0.0,
            )
        )

    def apart(self, one: Statistics, two: Statistics) -> float:
        """Expected log-likelihood of one above two's where one is the truth."""
        shift = (one.mean - two.mean) ** 2 / two.residual_variance
        finite = np.isfinite(two.noise_variance)
        floor, _ = self._tolerances()
        louder = np.log((one.foretold_noise + floor) / (two.foretold_noise + floor)) ** 2
        louder = np.where(finite, louder / np.where(finite, two.noise_variance, 1), 0)
        return float((0.5 * (NU + 1) * (np.log1p(shift / NU) + np.log1p(louder / NU))).sum())

    def _spared(self, found: Statistics) -> np.ndarray:
        """Noise ratios, but 0 where samples are better spread than random ones, which is where the
        noise of most cells is lower than foretold: by how much is then nobody's business. Cells of
        little noise and of much are asked apart."""
        ratio = found.noise_ratio
        loud = found.foretold_noise > (0.02 * found.mean) ** 2
        for kind in (loud, ~loud):
            kind = kind & (found.mean > 0.01) & np.isfinite(found.noise_variance)
            if kind.sum() > 10 and np.median(ratio[kind]) < math.log(SPARED):
                ratio = np.where(kind, 0.0, ratio)
        return ratio

    def best_factor(self, variant: Variant) -> float:
        """The brightness that fits the picture best, from cells away from the ends."""
        factor = variant.factor
        for _ in range(3):
            law = self.predict(replace(variant, factor=factor))
            foretold, seen = self.mean(law.mean), self.mean(self.value)
            fine = (foretold > 0.03) & (foretold < 0.93) & (seen < 0.93) & (seen > 0.03)
            if fine.sum() < 20:
                fine = (foretold > 0.01) & (seen < 0.97) & (seen > 0.01)
                if fine.sum() < 20:
                    return factor
            factor *= float(np.clip(np.median(seen[fine] / foretold[fine]), 0.05, 20))
        return factor


def lead_of(views: Sequence[View]) -> View:
    """The picture whose noise says most."""
    return min(
        views,
        key=lambda v: (
            v.picture.samples_per_pixel > 1,
            abs(math.log2(v.picture.nb_light_samples) - 4),
        ),
    )


# ---------------------------------------------------------------- sites


def _sites_at(
    scene: Scene, grid: Grid, column: np.ndarray, row: np.ndarray, width: int, height: int
) -> Sites:
    hits = grid.hits(scene, column, row, width, height, cut=np.inf)
    steps = [
        grid.hits(scene, column + dx, row + dy, width, height, cut=np.inf).point - hits.point
        for dx, dy in ((0.5, 0.0), (0.0, 0.5))
    ]
    return Sites(hits, *steps)


def _sites(
    scene: Scene, scene_file: Path, grid: Grid, width: int, height: int, most_cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column and cell of the pixels that tell: all where shadows may fall, one in THIN^2
    elsewhere, none at an object's rim or far away."""
    row, column = (a.ravel() for a in np.mgrid[0:height, 0:width])
    hits = grid.hits(scene, column.astype(float), row.astype(float), width, height, cut=np.inf)
    objects = hits.object_id.reshape(height, width)
    rim = ndimage.maximum_filter(objects, 2 * RIM + 1) != ndimage.minimum_filter(
        objects, 2 * RIM + 1
    )
    camera = np.asarray(scene.camera.position) + grid.moved * np.asarray(scene.camera.forward)
    distance = np.linalg.norm(hits.point - camera, axis=1).reshape(height, width)
    cut = min(grid.cut, scene.ray_max_distance)
    usable = ~rim & (objects >= 0) & (distance < FAR * cut)
    busy = _busy(scene, scene_file, hits, usable)
    large = CELL * THIN
    r, c = row.reshape(height, width), column.reshape(height, width)
    keep = usable & (busy | ((r % THIN == 0) & (c % THIN == 0)))
    side = np.where(busy, CELL, large)
    cell = (r // side) * (width + 1) + c // side
    cell = cell + (width + 1) * (height + 1) * (objects + 1 + (len(scene.objects) + 1) * busy)
    r, c, cell = r[keep], c[keep], cell[keep]
    _, cell = np.unique(cell, return_inverse=True)
    number = int(cell.max()) + 1 if len(cell) else 0
    if number > most_cells:
        chosen = np.zeros(number, dtype=bool)
        chosen[np.random.default_rng(1).permutation(number)[:most_cells]] = True
        r, c, cell = r[chosen[cell]], c[chosen[cell]], cell[chosen[cell]]
    return r, c, cell


def _busy(scene: Scene, scene_file: Path, hits: object, usable: np.ndarray) -> np.ndarray:
    """(H, W) bool: where a light may be seen in part, be it by a renderer with a large offset or
    with samples beside the light."""
    height, width = usable.shape
    step = 4
    lattice = np.zeros_like(usable)
    lattice[::step, ::step] = usable[::step, ::step]
    where = np.flatnonzero(lattice.ravel())
    receivers = hits[where]  # type: ignore[index]
    sites = Sites(receivers, np.zeros((len(where), 3)), np.zeros((len(where), 3)))
    partly = np.zeros(len(where), dtype=bool)
    for light in surface_lights(scene):
        moments = Moments(scene_file, light, sites, 6)
        keys = [
            ("std", "std", "std"),
            ("std", "offset_0_5", "std"),
            ("about_corner_double", "std", "std"),
        ]
        moments.prepare(keys)
        for key in keys:
            chance = moments[key][0]
            lit = moments[key][1] > 0
            partly |= (chance > 0.001) & ((chance < 0.999) | ~lit)
        full = moments["std", "none", "std"]
        top = moments["std", "none", "no_receiver_cosine"]
        terminator = (full[1] > 0) & (full[1] < 0.35 * top[1])
        partly |= terminator
    spread = np.zeros(usable.size, dtype=bool)
    spread[where] = partly
    near = ndimage.maximum_filter(spread.reshape(height, width), 2 * step + 1)
    cells = ndimage.maximum_filter(near, CELL)
    # whole cells
    rows, columns = -(-height // (CELL * THIN)), -(-width // (CELL * THIN))
    padded = np.zeros((rows * CELL * THIN, columns * CELL * THIN), dtype=bool)
    padded[:height, :width] = cells
    blocks = padded.reshape(rows, CELL * THIN, columns, CELL * THIN).any(axis=(1, 3))
    return np.repeat(np.repeat(blocks, CELL * THIN, 0), CELL * THIN, 1)[:height, :width]


def _slope(scene: Scene, scene_file: Path, sites: Sites) -> np.ndarray:
    """(dE/dx)^2 + (dE/dy)^2 over 12 E^2: relative variance of the irradiance under a uniform place
    in the pixel: of a penumbra at many light samples it is most of the noise."""
    points = sites.receivers.point
    around = []
    for shift in (sites.right, -sites.right, sites.down, -sites.down):
        at, normal = points + shift, sites.receivers.normal.copy()
        for i, sphere in enumerate(scene.spheres):
            on = (sites.receivers.object_id == i) & ~sites.receivers.inside
            normal[on] = (at[on] - np.asarray(sphere.center)) / sphere.radius
        moved = Sites(replace(sites.receivers, point=at, normal=normal), sites.right, sites.down)
        total = np.zeros(len(points))
        for light in surface_lights(scene):
            total += Moments(scene_file, light, moved, SLOPE_GRID)["std", "std", "std"][1]
        around.append(np.maximum(total, 1e-9))
    middle = sum(around) / 4
    across, down = (around[0] - around[1]) / middle, (around[2] - around[3]) / middle
    return np.minimum((across**2 + down**2) / 12, 0.3)
