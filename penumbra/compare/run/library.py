"""The C renderer inside this process, warm: for frames shorter than a program's start."""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from penumbra.compare.measure.image import read_image
from penumbra.compare.run.provenance import HOW_TO_BUILD, ROOT
from penumbra.compare.run.renderers import MissingProgramError, RendererError

SOURCES = ROOT / "c_renderer" / "src"
PRECISIONS = ("float32", "float64")
PROGRAM = ROOT / "build" / "bin" / "penumbra-render"
LIBRARY = ROOT / "build" / "lib" / "libpenumbra.so"
SAME, FEW = 1e-4, 1e-3
HEADERS = (
    "exact/irradiance.h",
    "packet/adaptive.h",
    "packet/irradiance_packet.h",
    "frame/trust.h",
    "io/scene_json.h",
)
"""With those that they include: what is called from Python."""


@dataclass(frozen=True)
class Setting:
    """What a user chooses: the options of penumbra-render."""

    sampler: str | None
    """None, like light_samples: an estimator that samples nothing"""
    estimator: str
    light_samples: int | None
    threads: int

    @property
    def options(self) -> str:
        """
        >>> Setting("sobol", "area", 64, 2).options
        '--sampler sobol --estimator area --light-samples 64 --threads 2'
        """
        sampler = f"--sampler {self.sampler} " if self.sampler else ""
        samples = f" --light-samples {self.light_samples}" if self.light_samples else ""
        return f"{sampler}--estimator {self.estimator}{samples} --threads {self.threads}"


def build_of(file: Path, precision: str) -> Path:
    """PROGRAM or LIBRARY as it is called when compiled for one of PRECISIONS.

    >>> build_of(LIBRARY, "float64").name
    'libpenumbra-float64.so'
    """
    return file.with_stem(f"{file.stem}-{precision}") if precision != PRECISIONS[0] else file


def names(option: str, precision: str = PRECISIONS[0]) -> tuple[str, ...]:
    """The names that the program's --sampler or --estimator takes, in the C enum's order.

    Raises MissingProgramError.
    """
    ffi, library = opened(precision)
    listed = getattr(library, f"RENDER_{option.upper()}_NAMES")
    return tuple(ffi.string(name).decode() for name in listed)


class WarmRenderer:
    """One scene, read once, rendered again and again into the same memory.

    Its images are the program's, but for rounding, which `check` proves. Raises
    MissingProgramError, RendererError.
    """

    def __init__(
        self, scene_file: Path, width: int, height: int, precision: str = PRECISIONS[0]
    ) -> None:
        self.scene_file, self.width, self.height = scene_file, width, height
        self.program = build_of(PROGRAM, precision)
        self.samplers, self.estimators = names("sampler"), names("estimator")
        self._ffi, self._library = opened(precision)
        self._scene = read_by_c(scene_file, precision)
        self._buffers = np.zeros((2, 3, height, width), dtype=np.float32)

    @property
    def radiance(self) -> np.ndarray:
        """(3, H, W) float32 of the last frame; the next one overwrites it."""
        return self._buffers[0]

    @property
    def buffers(self) -> np.ndarray:
        """(2, 3, H, W) float32: radiance and variance of the last frame."""
        return self._buffers

    def render(self, setting: Setting, seed: int) -> float:
        """Render a frame; the wall time of C's render() [s]. Raises RendererError."""
        settings = self._settings(setting, seed)
        radiance, variance = (
            self._ffi.cast("float *", plane.ctypes.data) for plane in self._buffers
        )
        null = self._ffi.NULL
        start = time.perf_counter()
        done = self._library.render(self._scene, settings, radiance, variance, null, null)
        seconds = time.perf_counter() - start
        if not done:
            raise RendererError(f"{self.scene_file}: cannot be rendered with {setting.options}")
        return seconds

    def can(self, estimator: str) -> bool:
        """Whether this scene can be rendered that way."""
        try:
            self.render(Setting(self.samplers[0], estimator, 1, 1), 1)
        except RendererError:
            return False
        return True

    def uses_samples(self, estimator: str) -> bool:
        """Whether seed and N make a difference, asked of two images."""
        first = Setting(self.samplers[0], estimator, 1, 1)
        self.render(first, 1)
        one = self.radiance.copy()
        self.render(Setting(self.samplers[0], estimator, 2, 1), 2)
        return not np.array_equal(one, self.radiance)

    def check(self) -> None:
        """Raises RendererError if the library's images are not the program's: then it is of
        another build, or its settings are not laid out as render.h, read here, says.

        The link-time optimiser may fuse other products in the one than in the other: values
        may differ by SAME of the largest, and few (FEW) by more, where rounding decides what
        a ray meets. Another seed or N would change nearly all values by far more.
        """
        able = [e for e in self.estimators if self.can(e)]
        settings = [
            Setting(self.samplers[-1], e, 4, 2)
            if self.uses_samples(e)
            else Setting(None, e, None, 2)
            for e in able
        ]
        settings += [Setting(s, able[0], 4, 2) for s in self.samplers if settings[0].sampler]
        for setting in settings:
            self.render(setting, 7)
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder) / "image.exr"
                command = [str(self.program), str(self.scene_file), "-o", str(out), "--seed", "7"]
                command += [*setting.options.split(), "--width", str(self.width)]
                command += ["--height", str(self.height)]
                ran = subprocess.run(command, capture_output=True, text=True, timeout=600)
                if ran.returncode != 0:
                    raise RendererError(f"{self.program}: {ran.stderr.strip()}")
                theirs = read_image(out).radiance.transpose(2, 0, 1)
            apart = np.abs(theirs - self.radiance) > SAME * theirs.max()
            if apart.mean() > FEW:
                raise RendererError(
                    f"the library and {self.program} give other images with {setting.options}: "
                    "run `make build`"
                )

    def _settings(self, setting: Setting, seed: int) -> Any:
        sampler = setting.sampler or self.samplers[0]
        return self._ffi.new(
            "RenderSettings *",
            {
                "width": self.width,
                "height": self.height,
                "nb_light_samples": setting.light_samples or 1,
                "samples_per_pixel": 1,
                "seed": seed,
                "threads": setting.threads,
                "sampler": self.samplers.index(sampler),
                "estimator": self.estimators.index(setting.estimator),
            },
        )


class PixelRenderer:
    """One scene, pixel by pixel, by the textbook's functions: in a precision's own numbers, where
    images are float32. Raises MissingProgramError, RendererError."""

    def __init__(self, scene_file: Path, precision: str) -> None:
        self._ffi, self._library = opened(precision)
        self.scene = read_by_c(scene_file, precision)

    def render(self, estimator: str, light_samples: int, seed: int) -> np.ndarray:
        """(H, W, 3) float64, the scene's size; estimator: "textbook", "solid-angle" or "exact"."""
        library, ffi, scene = self._library, self._ffi, self.scene
        points = ffi.gc(ffi.new("PointSet *"), library.point_set_free)
        if not library.point_set_create(points, library.SAMPLER_INDEPENDENT, light_samples, seed):
            raise RendererError("not enough memory for so many light samples")
        spread = library.SPREAD_SOLID_ANGLE if estimator == "solid-angle" else library.SPREAD_AREA
        radiance = np.empty((scene.height, scene.width, 3))
        for y, x in np.ndindex(scene.height, scene.width):
            camera = ffi.addressof(scene, "camera")
            ray = library.camera_ray(camera, x + 0.5, y + 0.5, scene.width, scene.height)
            hit = ffi.new("Hit *", library.scene_hit(scene, ray))
            if hit.object < 0:
                rgb = scene.background
            elif estimator == "exact":
                rgb = library.exact_lighting(scene, hit)
            else:
                stream = {"seed": seed, "pixel": y * scene.width + x, "pixel_sample": 0}
                rgb = library.direct_lighting(scene, hit, points, spread, stream).radiance
            radiance[y, x] = rgb.r, rgb.g, rgb.b
        return radiance


def _with_includes(header: Path, seen: dict[Path, str]) -> None:
    """Puts the texts of a header and of those that it includes into seen, these first."""
    if header in seen:
        return
    text = header.read_text()
    for name in re.findall(r'#include "([^"]+)"', text):
        beside = header.parent / name
        _with_includes(beside if beside.exists() else SOURCES / name, seen)
    seen[header] = text


def declarations(headers: tuple[str, ...], real: str) -> str:
    """What the headers declare, for cffi: one place says what C's types and functions are."""
    seen: dict[Path, str] = {}
    for header in headers:
        _with_includes(SOURCES / header, seen)
    text = "".join(seen.values())
    text = re.sub(r"/\*[\s\S]*?\*/", "", text)
    text = re.sub(r"^#(?:.*\\\n)*.*$", "", text, flags=re.M)
    body = r"([^;{]*)\{[\s\S]*?^\}"
    text = re.sub(r"^(?:static inline|(?:static )?ALWAYS_INLINE) " + body, "", text, flags=re.M)
    text = re.sub(r"^inline " + body, r"\1;", text, flags=re.M)
    text = re.sub(r"^typedef \w+ real;", "", text, flags=re.M).replace("ALIGNED", "")
    return f"typedef {real} real;\n{text}"


@cache
def opened(precision: str) -> tuple[cffi.FFI, Any]:
    """A precision's library, once, and its types. Raises MissingProgramError."""
    ffi, library = load(build_of(LIBRARY, precision))
    ffi.cdef(declarations(HEADERS, "float" if precision == PRECISIONS[0] else "double"))
    return ffi, library


def load(file: Path) -> tuple[cffi.FFI, Any]:
    """A library, and where its types and functions are to be declared. Raises
    MissingProgramError."""
    if not file.is_file():
        raise MissingProgramError(f"{file} is not there: {HOW_TO_BUILD}")
    ffi = cffi.FFI()
    try:
        return ffi, ffi.dlopen(str(file))
    except OSError as error:
        raise MissingProgramError(f"{file}: {error}: {HOW_TO_BUILD}") from error


def read_by_c(scene_file: Path, precision: str = PRECISIONS[0]) -> Any:
    """The C reader's Scene *. Raises RendererError, MissingProgramError."""
    return read_scene(scene_file, *opened(precision))


def read_scene(scene_file: Path, ffi: cffi.FFI, library: Any) -> Any:
    """A library's Scene *, freed when it is no longer used. Raises RendererError."""
    message = ffi.new("char[1024]")
    scene = ffi.gc(ffi.new("Scene *"), library.scene_free)
    if not library.scene_read(str(scene_file).encode(), scene, ffi.NULL, message, len(message)):
        raise RendererError(ffi.string(message).decode())
    return scene
