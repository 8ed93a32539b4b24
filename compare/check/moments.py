"""What one light sample does on average under each mistake, by the library of mistakes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from compare.check.catalogue import MODULES, Variant
from compare.check.grid import Grid
from compare.exact.receivers import Receivers
from compare.run.library import declarations, read_by_c
from compare.run.provenance import ROOT
from compare.run.renderers import MissingProgramError

LIBRARY = ROOT / "build" / "lib" / "libmistakes.so"
HEADERS = ("../mistakes/mistakes.h",)


@dataclass(frozen=True)
class Sites:
    """n points of the picture that receive light, and how far each moves in half a pixel."""

    receivers: Receivers
    right: np.ndarray
    """(n, 3) [m]"""
    down: np.ndarray
    """(n, 3) [m]"""

    def __len__(self) -> int:
        return len(self.receivers)

    def __getitem__(self, which: np.ndarray | slice) -> Sites:
        return Sites(self.receivers[which], self.right[which], self.down[which])


@cache
def opened() -> tuple[cffi.FFI, Any]:
    """The library of mistakes, once, and its types. Raises MissingProgramError."""
    ffi = cffi.FFI()
    ffi.cdef(declarations(HEADERS, "double"))
    try:
        return ffi, ffi.dlopen(str(LIBRARY))
    except OSError as error:
        raise MissingProgramError(f"{LIBRARY}: {error}: run `make build`") from error


@cache
def choice_id(module: str, name: str) -> int:
    """The library's number of a choice."""
    _, library = opened()
    number = int(library.mistakes_choice(MODULES.index(module), name.encode()))
    if number < 0:
        raise MissingProgramError(f"{LIBRARY}: has no {module} {name}: run `make build`")
    return number


@cache
def scene_of_c(scene_file: Path) -> tuple[Any, Any]:
    """C's scene in double precision, as the library of mistakes takes it, and its owner."""
    owner = read_by_c(scene_file, "float64")
    ffi, _ = opened()
    address = int(cffi.FFI().cast("uintptr_t", owner))
    return ffi.cast("Scene *", address), owner


Key = tuple[str, str, str]
"""domain, visibility, weight"""


class Moments:
    """Of some sites and one light of unit radiance: (3, n) float32 for a domain, a visibility and
    a weight: the chance that a sample sees the light, and the means of V w and V w^2, where w is
    the area times the weight [sr]. Computed when asked for, by a grid x grid of jittered points at
    each site, and kept. Raises MissingProgramError.
    """

    def __init__(self, scene_file: Path, light: int, sites: Sites, grid: int) -> None:
        self._scene_file, self._light, self._sites, self.grid = scene_file, light, sites, grid
        self._table: dict[Key, np.ndarray] = {}

    def prepare(self, keys: Iterable[Key]) -> None:
        """Compute those that are not there yet: of a domain all rays with all weights."""
        missing: dict[str, list[Key]] = {}
        for key in keys:
            if key not in self._table:
                missing.setdefault(key[0], []).append(key)
        for domain, wanted in missing.items():
            rays, weights = (sorted({key[i] for key in wanted}) for i in (1, 2))
            self._compute(domain, rays, weights)

    def __getitem__(self, key: Key) -> np.ndarray:
        self.prepare([key])
        return self._table[key]

    def part(self, which: np.ndarray) -> Moments:
        """Of some of the sites."""
        part = Moments(self._scene_file, self._light, self._sites[which], self.grid)
        part._table = {key: values[:, which] for key, values in self._table.items()}
        return part

    def places(self, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        """(k, n) float32 [sr]: what each of k places of the light would bring, were all of its
        power there."""
        ffi, library = opened()
        receivers, _keep = self._receivers()
        first = np.empty((len(s), len(self._sites)), np.float32)
        scene, _ = scene_of_c(self._scene_file)
        s, t = np.ascontiguousarray(s, dtype=float), np.ascontiguousarray(t, dtype=float)
        library.mistakes_places(
            *(scene, self._light, receivers),
            *(ffi.from_buffer("double[]", s), ffi.from_buffer("double[]", t), len(s)),
            ffi.from_buffer("float[]", first),
        )
        return first

    def _receivers(self) -> tuple[Any, Any]:
        """C's, and what must outlive them."""
        ffi, _ = opened()
        at = self._sites
        arrays = [
            np.ascontiguousarray(a, dtype=np.float64)
            for a in (at.receivers.point, at.receivers.normal, at.right, at.down)
        ]
        objects = np.ascontiguousarray(at.receivers.object_id, dtype=np.int32)
        buffers = [ffi.from_buffer("double[]", a) for a in arrays]
        buffers.append(ffi.from_buffer("int[]", objects))
        return ffi.new("Receivers *", [len(at), *buffers]), (arrays, objects, buffers)

    def _compute(self, domain: str, rays: list[str], weights: list[str]) -> None:
        ffi, library = opened()
        n = len(self._sites)
        receivers, _keep = self._receivers()
        chance = np.empty((len(rays), n), np.float32)
        first = np.empty((len(rays), len(weights), n), np.float32)
        second = np.empty_like(first)
        scene, _ = scene_of_c(self._scene_file)
        library.mistakes_moments(
            *(scene, self._light, receivers, choice_id("domain", domain)),
            *([choice_id("visibility", ray) for ray in rays], len(rays)),
            *([choice_id("weight", weight) for weight in weights], len(weights), self.grid),
            *(ffi.from_buffer("float[]", a) for a in (chance, first, second)),
        )
        for r, ray in enumerate(rays):
            for w, weight in enumerate(weights):
                self._table[domain, ray, weight] = np.stack([chance[r], first[r, w], second[r, w]])


def render(
    scene_file: Path,
    variant: Variant,
    shape: tuple[int, int],
    nb_light_samples: int,
    samples_per_pixel: int,
    seed: int,
    position: tuple[float, float] | None = (0.5, 0.5),
    divisor: int = 0,
    fov_y_deg: float | None = None,
    grid: Grid | None = None,
) -> np.ndarray:
    """The picture that a mistaken renderer makes: (H, W, 3) float32, linear, not clamped.

    position: of the ray in its pixel, None for a random one; divisor: 1 for pixels divided by
    W - 1 and H - 1; grid: that of a student's picture, instead of these three. The output's
    wrapping is the writer's business. Raises MissingProgramError.
    """
    ffi, library = opened()
    scene, _ = scene_of_c(scene_file)
    own = ffi.new("Scene *", scene[0])
    height, width = shape
    if grid is not None:
        fov_y_deg, divisor = grid.fov_y_deg, grid.divisor
        position = None if grid.jittered else (grid.position, grid.position)
    if fov_y_deg is not None:
        own.camera.tan_half_fov_y = float(np.tan(np.radians(fov_y_deg) / 2))
    if grid is not None:
        _aim(own, grid, width, height)
    settings = ffi.new(
        "MistakenSettings *",
        {
            "choice": [choice_id(module, getattr(variant, module)) for module in MODULES],
            "factor": variant.factor,
            "width": width,
            "height": height,
            "nb_light_samples": nb_light_samples,
            "samples_per_pixel": samples_per_pixel,
            "seed": seed,
            "position_x": -1.0 if position is None else position[0],
            "position_y": -1.0 if position is None else position[1],
            "divisor": divisor,
        },
    )
    radiance = np.empty((height, width, 3), np.float32)
    library.mistakes_render(own, settings, ffi.from_buffer("float[]", radiance))
    return radiance


def _aim(scene: Any, grid: Grid, width: int, height: int) -> None:
    """Give C's scene the camera of a grid: what it does to the picture's plane is done to the
    vectors that span it."""
    camera = scene.camera
    forward, right, up = (
        np.array([v.x, v.y, v.z]) for v in (camera.forward, camera.right, camera.up)
    )
    place = np.array([camera.position.x, camera.position.y, camera.position.z])
    place += grid.moved * forward
    right = right * ((-1 if grid.flip_x else 1) / grid.aspect)
    up = up * (-1 if grid.flip_y else 1)
    half_height = camera.tan_half_fov_y
    half_width = half_height * width / height
    forward = forward + right * (2 * half_width * grid.shift_x / (width - grid.divisor))
    forward = forward - up * (2 * half_height * grid.shift_y / (height - grid.divisor))
    vectors = {"position": place, "forward": forward, "right": right, "up": up}
    for name, vector in vectors.items():
        setattr(camera, name, dict(zip("xyz", map(float, vector), strict=True)))
    scene.ray_max_distance = grid.cut
