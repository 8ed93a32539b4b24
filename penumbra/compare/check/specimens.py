"""Pictures whose maker is known, saved as students save them: what a check is calibrated with."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.picture import GAMMAS, Picture, read_picture
from penumbra.compare.exact.receivers import BACKGROUND
from penumbra.compare.measure.image import Image, write_exr
from penumbra.compare.run.library import Setting, WarmRenderer
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import QuadLight, Scene, read_scene

Maker = tuple[str, ...]
"""("mistakes",): the library of mistakes; ("library", precision, sampler, estimator): the C
renderer; ("numpy", generator, precision): a third, here"""
GENERATORS = ("MT19937", "PCG64", "Philox", "SFC64", "15 bits")
"""numpy's, and one of 32768 different numbers, both ends among them, as rand() of some systems"""


@dataclass(frozen=True)
class Specimen:
    """How one or several pictures of a scene are made."""

    kind: str
    """"correct", "single", "pair", "left out" """
    scene: str
    """its name in scenes/"""
    maker: Maker
    variant: Variant
    shape: tuple[int, int]
    counts: tuple[tuple[int, int], ...]
    """(light samples, pixel samples) of each picture"""
    position: tuple[float, float] | None = (0.5, 0.5)
    """of the ray in its pixel; 1.5: a pixel further; None: random"""
    divisor: int = 0
    jittered: bool = True
    """several pixel samples are at random places"""
    fov_y_deg: float = 60.0
    power: float = 1.0
    """relative to the scene's"""
    ray_max_distance: float = 100.0
    turn: int = 0
    """which of its corners the light's own is: the same light in other words"""
    offset: str = "std"
    """of shadow rays, one of the sound ones of the catalogue"""
    file: str = "png"
    """"png", "bmp", "jpg 100", "jpg 90", "exr" """
    encoding: str = "truncated"
    clamped: bool = True
    """of floats: cut to [0, 1]"""
    seed: int = 1
    fitted: bool = True
    """its grid is fitted, not given"""
    without: str = ""
    """a name that the catalogue is made to lack"""

    @property
    def key(self) -> str:
        return sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()[:16]

    @property
    def scene_file(self) -> Path:
        return ROOT / "scenes" / f"{self.scene}.json"

    def grid(self, samples_per_pixel: int) -> Grid:
        """That it was made with."""
        shift = (0.0, 0.0)
        position = 0.5
        random = self.position is None or (samples_per_pixel > 1 and self.maker[0] == "mistakes")
        if not random and self.position is not None:
            position = self.position[0] % 1
            shift = (self.position[0] // 1, self.position[1] // 1)
        return Grid(
            self.fov_y_deg,
            position,
            self.divisor,
            random or samples_per_pixel > 1,
            self.ray_max_distance,
            shift_x=shift[0],
            shift_y=shift[1],
        )

    def files(self, folder: Path) -> list[Path]:
        """The pictures, made and saved. Raises MissingProgramError."""
        told = _told(self, folder)
        found = []
        for i, (n, m) in enumerate(self.counts):
            radiance = _radiance(self, told, n, m, self.seed + i)
            kind, _, quality = self.file.partition(" ")
            file = folder / f"{self.key}_{i}.{kind}"
            _save(file, radiance, self, int(quality or 0))
            found.append(file)
        return found

    def pictures(self, scene: Scene, folder: Path) -> list[Picture]:
        """Made, saved and read again. Raises MissingProgramError, ImageError."""
        found = []
        for file, (n, m) in zip(self.files(folder), self.counts, strict=True):
            found.append(read_picture(file, scene, n, m))
            file.unlink()
        return found


def _told(specimen: Specimen, folder: Path) -> Path:
    """The scene file that the maker reads: the scene's own, or with the specimen's camera, power
    and light in other words."""
    scene = json.loads(specimen.scene_file.read_text())
    scene["camera"]["fov_y_deg"] = specimen.fov_y_deg
    scene["ray_max_distance"] = specimen.ray_max_distance
    for light in scene["quad_lights"]:
        light["power"] *= specimen.power
        for _ in range(specimen.turn):
            u, v = np.asarray(light["u"], float), np.asarray(light["v"], float)
            light["position"] = (np.asarray(light["position"], float) + u).tolist()
            light["u"], light["v"] = v.tolist(), (-u).tolist()
    text = json.dumps(scene)
    file = folder / f"{specimen.scene}_{sha256(text.encode()).hexdigest()[:12]}.json"
    if not file.exists():
        file.write_text(text)
    return file


def _radiance(specimen: Specimen, told: Path, n: int, m: int, seed: int) -> np.ndarray:
    """(H, W, 3), linear, not clamped."""
    if specimen.maker[0] == "mistakes":
        variant = specimen.variant
        if not variant.mistakes:
            variant = replace(variant, visibility=specimen.offset)
        return render(
            told, variant, specimen.shape, n, m, seed, specimen.position, specimen.divisor
        )
    if specimen.maker[0] == "library":
        _, precision, sampler, estimator = specimen.maker
        renderer = _renderer(told, *specimen.shape, precision)
        total = np.zeros((*specimen.shape, 3))
        for i in range(m):
            renderer.render(Setting(sampler, estimator, n, 1), seed + 1000 * i)
            total += renderer.radiance.transpose(1, 2, 0)
        return total / m
    total = np.zeros((*specimen.shape, 3))
    scene, rng = read_scene(told), np.random.default_rng(seed)
    draw = _drawing(specimen.maker[1], seed, np.dtype(specimen.maker[2]))
    random = specimen.position is None or (m > 1 and specimen.jittered)
    for _ in range(m):
        place = rng.random((2, *specimen.shape)) if random else specimen.position
        total += _textbook(specimen, scene, place, n, draw)
    return total / m


@cache
def _renderer(told: Path, height: int, width: int, precision: str) -> WarmRenderer:
    return WarmRenderer(told, width, height, precision)


def _drawing(generator: str, seed: int, kind: np.dtype[Any]) -> Any:
    """draw(shape): random numbers in [0, 1]"""
    if generator == "15 bits":
        coarse = np.random.default_rng(seed)
        return lambda shape: np.asarray(coarse.integers(0, 32768, shape) / 32767, kind)
    bits = np.random.Generator(getattr(np.random, generator)(seed))
    return lambda shape: bits.random(shape, dtype=kind.type)


def _textbook(specimen: Specimen, scene: Scene, place: Any, n: int, draw: Any) -> np.ndarray:
    """One ray a pixel: spheres and planes under quads, by areas."""
    height, width = specimen.shape
    row, column = (a.ravel().astype(float) for a in np.mgrid[0:height, 0:width])
    x, y = (np.broadcast_to(p, (height, width)).ravel() for p in place)
    grid = Grid(specimen.fov_y_deg, 0.0, specimen.divisor, cut=specimen.ray_max_distance)
    hits = grid.hits(scene, column + x, row + y, width, height)
    radiance = np.tile(np.asarray(scene.background_radiance), (height * width, 1))
    met = hits.object_id != BACKGROUND
    lit = hits[met]
    kind = draw(1).dtype
    offset = {"offset_0": 1e-6, "offset_0_01": 1e-2}.get(specimen.offset, 1e-3)
    point, normal = lit.point.astype(kind), lit.normal.astype(kind)
    origin = point + kind.type(offset) * normal
    light_in = np.zeros((len(lit), 3), kind)
    for light in scene.lights:
        assert isinstance(light, QuadLight)
        corner, u, v, facing = (
            np.asarray(a, kind) for a in (light.corner, light.edge_u, light.edge_v, light.normal)
        )
        total = np.zeros(len(lit), kind)
        for _ in range(n):
            s, t = draw((2, len(lit)))
            way = corner + s[:, None] * u + t[:, None] * v - point
            distance2 = np.einsum("ij,ij->i", way, way)
            cosines = np.maximum(np.einsum("ij,ij->i", way, normal), 0) * np.maximum(
                way @ facing, 0
            )
            total += cosines / distance2**2 * _seen(scene, origin, point + way - origin)
        light_in += total[:, None] * np.asarray(light.radiance, kind) * kind.type(light.area / n)
    brdf = np.array([thing.brdf for thing in scene.objects])[lit.object_id]
    radiance[met] = brdf * light_in
    return radiance.reshape(height, width, 3)


def _seen(scene: Scene, origin: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Whether no sphere stands between origin and origin + way; the planes lie under everything."""
    seen = np.ones(len(origin), bool)
    a = np.einsum("ij,ij->i", way, way)
    for sphere in scene.spheres:
        from_centre = origin - np.asarray(sphere.center, origin.dtype)
        b = np.einsum("ij,ij->i", way, from_centre)
        c = np.einsum("ij,ij->i", from_centre, from_centre) - sphere.radius**2
        root = b * b - a * c
        near = -b - np.sqrt(np.maximum(root, 0))
        seen &= ~((root > 0) & (near > 0) & (near < a))
    return seen


def _save(file: Path, radiance: np.ndarray, specimen: Specimen, quality: int) -> None:
    if file.suffix == ".exr":
        cut = np.clip(radiance, 0, 1) if specimen.clamped else radiance
        write_exr(file, Image(cut.astype(np.float32)))
        return
    wraps = specimen.variant["output"].field("wrap")
    value = np.maximum(radiance, 0) if wraps else np.clip(radiance, 0, 1)
    if specimen.encoding in GAMMAS:
        value = GAMMAS[specimen.encoding][0](value)
    if specimen.encoding == "truncated 256":
        levels = np.minimum(np.floor(value * 256), 255)
    elif specimen.encoding == "truncated":
        levels = np.floor(value * 255) % 256
    else:
        levels = np.floor(value * 255 + 0.5)
    picture = PillowImage.fromarray(levels.astype(np.uint8))
    if quality:
        picture.save(file, "JPEG", quality=quality, subsampling=0 if quality == 100 else 2)
    else:
        picture.save(file)
