"""How a student's camera rays go through the pixels, told from the background's outline alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from penumbra.compare.check.picture import Picture
from penumbra.compare.exact.receivers import BACKGROUND, Receivers, camera_hits
from penumbra.compare.scene import Scene
from penumbra.language import N_, _, say

CUTS = (5e4, 1e4, 2500.0, 1000.0, 500.0, 300.0, 200.0, 150.0, 120.0, 100.0, 90.0, 75.0, 50.0)
"""Where programs end their camera rays [m]."""
SHIFT_CUTS = (5e4, 300.0, 200.0, 150.0, 75.0)
"""Those that a shift is looked for with."""
LAB_CAMERAS = (0.0, -2.0)
"""The lab's two cameras: places on the z axis [m]."""
PLACES = ((0.5, 0), (0.5, 1), (0.0, 0), (0.0, 1))
"""(position, divisor)"""
SAMPLE = 2500
"""Pixels near the outline that a search looks at."""


@dataclass(frozen=True)
class Grid:
    """The ray of each pixel, against the scene's camera."""

    fov_y_deg: float
    position: float = 0.5
    """mean place of the ray in its pixel: 0 corner, 0.5 centre"""
    divisor: int = 0
    """1: places in the picture are divided by W - 1, H - 1"""
    jittered: bool = False
    """a random place of the pixel"""
    cut: float = 100.0
    """rays end there [m]"""
    aspect: float = 1.0
    """horizontal stretch of the picture"""
    moved: float = 0.0
    """of the camera, along its view axis [m]"""
    flip_x: bool = False
    flip_y: bool = False
    shift_x: float = 0.0
    shift_y: float = 0.0
    """[pixels]"""

    def hits(
        self,
        scene: Scene,
        column: np.ndarray,
        row: np.ndarray,
        width: int,
        height: int,
        cut: float | None = None,
    ) -> Receivers:
        """What the rays through the pixels (column, row), (n,), of a picture of width x height
        meet; within cut [m] where it is given."""
        x = (column + self.shift_x + self.position) * (width / (width - self.divisor))
        y = (row + self.shift_y + self.position) * (height / (height - self.divisor))
        x = width / 2 + (x - width / 2) * ((-1 if self.flip_x else 1) / self.aspect)
        y = height - y if self.flip_y else y
        camera = scene.camera
        place = np.asarray(camera.position) + self.moved * np.asarray(camera.forward)
        position = (float(place[0]), float(place[1]), float(place[2]))
        camera = replace(camera, position=position, fov_y_deg=self.fov_y_deg)
        distance = self.cut if cut is None else cut
        mine = replace(scene, camera=camera, ray_max_distance=distance)
        return camera_hits(mine, x, y, width, height)

    def facts(self, scene: Scene) -> list[tuple[str, str]]:
        """(code, text for the student) of each deviation from the scene's camera."""
        said = []
        fov = scene.camera.fov_y_deg
        if self.position < 0.25:
            text = _("your rays go through the corner of each pixel, not its centre")
            said.append(("pixel_corner", text))
        if self.divisor:
            text = _("your pixel coordinates are divided by W - 1 and H - 1, not W and H")
            said.append(("divided_by_w_minus_1", text))
        if self.jittered:
            said.append(("jittered", _("your rays go through a random place of each pixel")))
        if self.cut != scene.ray_max_distance:
            end = (
                N_("your camera rays end at about {cut:g} m, the scene's at {stated:g} m")
                if self.cut < 1000
                else N_("your camera rays end at 1 km or farther, the scene's at {stated:g} m")
            )
            text = say(end, cut=self.cut, stated=scene.ray_max_distance)
            said.append(("ray_cut", text))
        if self.shift_x or self.shift_y:
            text = say(
                "your picture is shifted by ({x:g}, {y:g}) pixels",
                x=self.shift_x,
                y=self.shift_y,
            )
            said.append(("shift", text))
        if self.fov_y_deg != fov:
            text = say(
                "your camera's field of view is {fov:.1f} degrees, the scene's is {stated:g}",
                fov=self.fov_y_deg,
                stated=fov,
            )
            said.append(("fov", text))
        if self.moved:
            said_so = (
                N_("your camera is {moved:g} m further forward than the scene's")
                if self.moved > 0
                else N_("your camera is {moved:g} m further back than the scene's")
            )
            text = say(said_so, moved=abs(self.moved))
            said.append(("camera_moved", text))
        if self.aspect != 1:
            text = say(
                "your picture is stretched horizontally, by {aspect:.2f}", aspect=self.aspect
            )
            said.append(("aspect", text))
        if self.flip_x:
            said.append(("flip_x", _("your picture is mirrored, left for right")))
        if self.flip_y:
            said.append(("flip_y", _("your picture is upside down")))
        return said


def fit_grid(picture: Picture, scene: Scene) -> tuple[Grid, int]:
    """The grid that explains the background's outline, and how many pixels near the outline it
    does not explain. Where nothing tells, the scene's own: a picture without background says
    nothing, a symmetric outline nothing of flips."""
    grid = Grid(scene.camera.fov_y_deg, cut=scene.ray_max_distance)
    several = picture.samples_per_pixel > 1
    outline = _Outline.of(picture, scene)
    if outline.length == 0:
        return replace(grid, jittered=several), 0
    frayed = several or outline.frayed > (0.08 if picture.jpeg == "coarse" else 0.008)
    # a random place is the centre on average
    places = PLACES[:2] if several or (frayed and picture.jpeg != "coarse") else PLACES
    shifted, shifted_cost = outline.shifted(*outline.placed(grid, places), places)
    if shifted_cost < outline.tolerable:
        return replace(shifted, jittered=frayed), shifted_cost
    grid, cost = outline.fit(grid, places)
    if abs(grid.fov_y_deg - scene.camera.fov_y_deg) > 1:
        # a camera elsewhere with the scene's own field of view is the likelier of the two
        for moved in _moves(scene):
            start = Grid(scene.camera.fov_y_deg, cut=scene.ray_max_distance, moved=moved)
            other, its_cost = outline.placed(start, places)
            if its_cost < cost + 0.02 * outline.length:
                grid, cost = other, its_cost
    if cost > 0.3 * outline.length:
        grid, cost = _other_camera(outline, grid, cost, scene, places)
    if cost > 0.15 * outline.length:
        grid, cost = outline.shifted(grid, cost, places)
    return replace(grid, jittered=frayed), cost


def _other_camera(
    outline: _Outline, grid: Grid, cost: int, scene: Scene, places: tuple[tuple[float, int], ...]
) -> tuple[Grid, int]:
    """Flipped or stretched, if one of these explains the outline clearly better."""
    start = Grid(scene.camera.fov_y_deg, cut=scene.ray_max_distance)
    variants = [
        replace(start, flip_y=True),
        replace(start, flip_x=True),
        replace(start, flip_x=True, flip_y=True),
    ]
    for variant in variants:
        if outline.rough(variant) < 0.8 * cost:
            other, its_cost = outline.fit(variant, places)
            if its_cost < 0.6 * cost:
                grid, cost = other, its_cost
    if cost > 0.3 * outline.length:
        other, its_cost = outline.stretched(grid, start.fov_y_deg, places)
        if its_cost < 0.7 * cost:
            grid, cost = other, its_cost
    return grid, cost


def _moves(scene: Scene) -> list[float]:
    """How far along the view axis the lab's other camera is, for a scene with one of the two."""
    camera = scene.camera
    if camera.position[:2] != (0, 0) or camera.forward != (0, 0, 1):
        return []
    if camera.position[2] not in LAB_CAMERAS:
        return []
    return [z - camera.position[2] for z in LAB_CAMERAS if z != camera.position[2]]


@dataclass(frozen=True)
class _Outline:
    """The pixels within 4 of the background's outline."""

    scene: Scene
    column: np.ndarray
    row: np.ndarray
    seen: np.ndarray
    """(n,) bool: is background"""
    thin: np.ndarray
    """(k,) int: some of them"""
    lattice: _Outline | None
    """pixels of the whole picture, for a camera that is far off"""
    length: int
    """pixels of the outline itself"""
    notches: int
    """of them, those unlike both neighbours in their row or column"""
    width: int
    height: int

    @staticmethod
    def of(picture: Picture, scene: Scene) -> _Outline:
        shows = picture.background
        height, width = shows.shape
        inner = np.zeros_like(shows)
        inner[1:] |= shows[1:] != shows[:-1]
        inner[:, 1:] |= shows[:, 1:] != shows[:, :-1]
        length = int(np.count_nonzero(inner))
        across = shows[:, 1:] != shows[:, :-1]
        down = shows[1:] != shows[:-1]
        notches = int(
            np.count_nonzero(across[:, 1:] & across[:, :-1])
            + np.count_nonzero(down[1:] & down[:-1])
        )
        near = ndimage.binary_dilation(inner, np.ones((3, 3), dtype=bool), iterations=4)
        row, column = np.nonzero(near)
        # not every k-th, which would fall on the same columns of each row
        order = np.random.default_rng(1).permutation(len(row))
        step = max(1, height // 40)
        y, x = (a.ravel() for a in np.mgrid[step // 2 : height : step, step // 2 : width : step])
        all_of_it = np.arange(len(x))
        lattice = _Outline(
            scene, x, y, shows[y, x], all_of_it, None, length, notches, width, height
        )  # fmt: skip
        thin = np.sort(order[:SAMPLE])
        return _Outline(
            scene, column, row, shows[near], thin, lattice, length, notches, width, height
        )

    def unexplained(self, grid: Grid) -> int:
        hits = grid.hits(self.scene, self.column, self.row, self.width, self.height)
        return int(np.count_nonzero((hits.object_id == BACKGROUND) != self.seen))

    def sampled(self, grid: Grid) -> int:
        """unexplained(), of all, as some of the pixels tell"""
        i = self.thin
        hits = grid.hits(self.scene, self.column[i], self.row[i], self.width, self.height)
        wrong = np.count_nonzero((hits.object_id == BACKGROUND) != self.seen[i])
        return round(wrong * len(self.row) / len(i))

    def rough(self, grid: Grid) -> int:
        """Least cost over wide fields of view: a bound on how well such a grid may do."""
        return min(self.sampled(replace(grid, fov_y_deg=fov)) for fov in self._wide(grid)[:3])

    @property
    def tolerable(self) -> float:
        """Pixels that the right grid may leave unexplained, more where the outline is frayed."""
        return 0.04 * self.length + 2.5 * self.notches

    @property
    def frayed(self) -> float:
        """Of the outline, how much are notches: a tenth where rays are random, else almost none"""
        return self.notches / self.length

    def fit(self, grid: Grid, places: tuple[tuple[float, int], ...]) -> tuple[Grid, int]:
        """Field of view, place in the pixel and ray cut. The grid's own field of view is kept
        unless another is clearly better."""
        own, own_cost = self.placed(grid, places)
        if own_cost < self.tolerable:
            return own, own_cost
        start = min(
            (replace(grid, fov_y_deg=f, cut=c) for f in self._wide(grid) for c in (grid.cut, 5e4)),
            key=self.sampled,
        )
        # each place with a field of view of its own: a corner over W - 1 is nearly a centre over W
        # that is seen a little narrower
        found = [self.placed(self._focused(start, place), (place,)) for place in places]
        best, cost = min(found, key=lambda result: result[1])
        return (best, cost) if cost < own_cost - 0.04 * self.length else (own, own_cost)

    def _wide(self, grid: Grid) -> list[float]:
        """Fields of view near which the right one is, if one is: best first."""
        assert self.lattice is not None
        half = np.tan(np.radians(grid.fov_y_deg) / 2) * np.geomspace(0.2, 5, 65)
        fovs = [math.degrees(2 * math.atan(t)) for t in half]
        lattice = self.lattice
        fovs.sort(key=lambda fov: lattice.unexplained(replace(grid, fov_y_deg=fov)))
        return fovs[:5]

    def _focused(self, grid: Grid, place: tuple[float, int]) -> Grid:
        """Field of view to 0.03 degrees, and the ray cut along with it."""
        grid = replace(grid, position=place[0], divisor=place[1])
        for step in (0.5, 0.12, 0.03):
            choices = [
                replace(grid, fov_y_deg=round(float(fov), 3), cut=cut)
                for fov in grid.fov_y_deg + step * np.arange(-4, 5)
                if 1 < fov < 175
                for cut in sorted({grid.cut, self.scene.ray_max_distance, 5e4})
            ]
            grid = min(choices, key=self.sampled)
        return grid

    def placed(self, grid: Grid, places: tuple[tuple[float, int], ...]) -> tuple[Grid, int]:
        """Place in the pixel and ray cut, the scene's own first."""
        cuts = (self.scene.ray_max_distance, *CUTS)
        choices = [replace(grid, position=p, divisor=d, cut=cut) for cut in cuts for p, d in places]
        choices = sorted(choices, key=self.sampled)[:6]
        costs = [self.unexplained(choice) for choice in choices]
        odd = [(c.cut != self.scene.ray_max_distance) + (c.divisor != 0) for c in choices]
        # an outline frayed by random places is so by chance: what is odd must be clearly better
        chance = 0.5 * self.notches if places == PLACES[:2] else 0.0
        best = int(np.argmin(np.array(costs) + chance * np.array(odd)))
        return choices[best], costs[best]

    def stretched(
        self, grid: Grid, fov: float, places: tuple[tuple[float, int], ...]
    ) -> tuple[Grid, int]:
        """Aspect ratio and field of view."""
        assert self.lattice is not None
        half = np.tan(np.radians(fov) / 2) * np.geomspace(0.4, 2.5, 25)
        fovs = [fov, grid.fov_y_deg, *(math.degrees(2 * math.atan(t)) for t in half)]
        choices = [
            replace(grid, fov_y_deg=f, aspect=float(a))
            for f in fovs
            for a in np.geomspace(0.5, 2, 17)
        ]
        choices = sorted(choices, key=self.lattice.unexplained)[:12]
        best = min(choices, key=self.sampled)
        for step in (0.03, 0.01, 0.003):
            fovs = [best.fov_y_deg + 25 * step * k for k in range(-3, 4)]
            choices = [
                replace(best, fov_y_deg=f, aspect=best.aspect * (1 + step * k))
                for f in fovs
                for k in range(-3, 4)
            ]
            best = min(choices, key=self.sampled)
        ratio = self.width / self.height
        known = [replace(best, aspect=a, fov_y_deg=f) for a in (ratio, 1 / ratio, best.aspect)
                 for f in (fov, best.fov_y_deg)]  # fmt: skip
        results = [self.placed(choice, places) for choice in known]
        return min(results, key=lambda result: result[1] + 0.02 * self.length * (
            (result[0].fov_y_deg != fov) + (result[0].aspect == best.aspect)))  # fmt: skip

    def shifted(
        self, grid: Grid, cost: int, places: tuple[tuple[float, int], ...]
    ) -> tuple[Grid, int]:
        """Shifts of up to two pixels, if one explains the outline clearly better."""
        if cost < self.tolerable:
            return grid, cost
        steps = (-2.0, -1.0, 0.0, 1.0, 2.0)
        choices = [
            replace(grid, position=0.5, divisor=0, cut=cut, shift_x=x, shift_y=y)
            for cut in (self.scene.ray_max_distance, *SHIFT_CUTS)
            for x in steps
            for y in steps
        ]
        choices = sorted(choices, key=self.sampled)[:3]
        results = [self.placed(choice, places) for choice in choices]
        best, its_cost = min(results, key=lambda result: result[1])
        return (best, its_cost) if its_cost < 0.6 * cost else (grid, cost)
