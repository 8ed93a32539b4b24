"""The library of mistakes: renderers that make them, and what their samples do on average."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from penumbra.compare.check.catalogue import MODULES, Variant
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.quadrature import Sites
from penumbra.compare.run.library import declarations, load, read_scene
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.run.renderers import MissingProgramError

LIBRARY = ROOT / "build" / "lib" / "libmistakes.so"
HEADERS = ("../mistakes/mistakes.h", "io/scene_json.h")


@cache
def opened() -> tuple[cffi.FFI, Any]:
    """The library of mistakes, once, and its types. Raises MissingProgramError."""
    ffi, library = load(LIBRARY)
    ffi.cdef(declarations(HEADERS, "double"))
    return ffi, library


@cache
def choice_id(module: str, name: str) -> int:
    """The library's number of a choice."""
    _, library = opened()
    number = int(library.mistakes_choice(MODULES.index(module), name.encode()))
    if number < 0:
        raise MissingProgramError(f"{LIBRARY}: has no {module} {name}: run `make build`")
    return number


@cache
def scene_of_c(scene_file: Path) -> Any:
    """C's Scene *, in double. Raises MissingProgramError, RendererError."""
    return read_scene(scene_file, *opened())


def is_built() -> bool:
    return LIBRARY.is_file()


def moments(
    scene_file: Path,
    light: int,
    sites: Sites,
    domain: str,
    rays: Sequence[str],
    weights: Sequence[str],
    grid: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As quadrature.moments. Raises MissingProgramError."""
    ffi, library = opened()
    n = len(sites)
    receivers, _keep = _receivers(sites)
    chance = np.empty((len(rays), n), np.float32)
    first = np.empty((len(rays), len(weights), n), np.float32)
    second = np.empty_like(first)
    scene = scene_of_c(scene_file)
    library.mistakes_moments(
        *(scene, light, receivers, choice_id("domain", domain)),
        *([choice_id("visibility", ray) for ray in rays], len(rays)),
        *([choice_id("weight", weight) for weight in weights], len(weights), grid),
        *(ffi.from_buffer("float[]", a) for a in (chance, first, second)),
    )
    return chance, first, second


def places(scene_file: Path, light: int, sites: Sites, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """As quadrature.places. Raises MissingProgramError."""
    ffi, library = opened()
    receivers, _keep = _receivers(sites)
    first = np.empty((len(s), len(sites)), np.float32)
    scene = scene_of_c(scene_file)
    s, t = np.ascontiguousarray(s, dtype=float), np.ascontiguousarray(t, dtype=float)
    library.mistakes_places(
        *(scene, light, receivers),
        *(ffi.from_buffer("double[]", s), ffi.from_buffer("double[]", t), len(s)),
        ffi.from_buffer("float[]", first),
    )
    return first


def _receivers(at: Sites) -> tuple[Any, Any]:
    """C's, and what must outlive them."""
    ffi, _ = opened()
    arrays = [
        np.ascontiguousarray(a, dtype=np.float64)
        for a in (at.receivers.point, at.receivers.normal, at.right, at.down)
    ]
    objects = np.ascontiguousarray(at.receivers.object_id, dtype=np.int32)
    buffers = [ffi.from_buffer("double[]", a) for a in arrays]
    buffers.append(ffi.from_buffer("int[]", objects))
    return ffi.new("Receivers *", [len(at), *buffers]), (arrays, objects, buffers)


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
    W - 1 and H - 1; grid: that of a student's picture, instead of these three. Light samples beyond
    MISTAKES_MOST_LIGHT_SAMPLES are left out. The output's wrapping is the writer's business. Raises
    MissingProgramError.
    """
    ffi, library = opened()
    scene = scene_of_c(scene_file)
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
            "nb_light_samples": min(nb_light_samples, library.MISTAKES_MOST_LIGHT_SAMPLES),
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
