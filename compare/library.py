"""The C renderer inside this process, warm: for frames shorter than a program's start."""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from compare.image import read_image
from compare.provenance import ROOT
from compare.renderers import MissingProgramError, RendererError

SOURCES = ROOT / "c_renderer" / "src"
PRECISIONS = ("float32", "float64")
PROGRAM = ROOT / "build" / "bin" / "penumbra-render"
LIBRARY = ROOT / "build" / "lib" / "libpenumbra.so"
SCENE_BYTES = 1 << 16
"""Room for the C struct Scene, which holds pointers and a few numbers."""
SAME, FEW = 1e-4, 1e-3
FUNCTIONS = """
bool scene_read(const char *file, void *scene, char **dump, char *message, size_t message_size);
void scene_free(void *scene);
bool render(const void *scene, const RenderSettings *settings, float *radiance, float *variance,
            void *progress, void *user);
"""


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


def names(option: str) -> tuple[str, ...]:
    """The names that the program's --option takes, in the C enum's order, asked of the program.

    Raises MissingProgramError, RendererError.
    """
    command = [str(PROGRAM), "scene", "-o", "image", f"--{option}", "?"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=60).stderr
    except OSError as error:
        raise MissingProgramError(f"{PROGRAM}: {error.strerror}: run `make build`") from error
    found = re.search(r"is none of (.+)", said)
    if not found:
        raise RendererError(f"{PROGRAM}: does not list the names of --{option}: {said.strip()}")
    return tuple(found[1].split(", "))


class WarmRenderer:
    """One scene, read once, rendered again and again into the same memory.

    Its images are the program's, but for rounding, which `check` proves. Raises
    MissingProgramError, RendererError.
    """

    def __init__(
        self, scene_file: Path, width: int, height: int, precision: str = PRECISIONS[0]
    ) -> None:
        self.scene_file, self.width, self.height = scene_file, width, height
        self.program, library = build_of(PROGRAM, precision), build_of(LIBRARY, precision)
        self.samplers, self.estimators = names("sampler"), names("estimator")
        self._ffi = _declarations()
        try:
            self._library: Any = self._ffi.dlopen(str(library))
        except OSError as error:
            raise MissingProgramError(f"{library}: {error}: run `make build`") from error
        self._scene = self._read()
        self._buffers = np.zeros((2, 3, height, width), dtype=np.float32)

    @property
    def radiance(self) -> np.ndarray:
        """(3, H, W) float32 of the last frame; the next one overwrites it."""
        return self._buffers[0]

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

    def _read(self) -> Any:
        message = self._ffi.new("char[1024]")
        scene = self._ffi.new("char[]", SCENE_BYTES)
        file = str(self.scene_file).encode()
        if not self._library.scene_read(file, scene, self._ffi.NULL, message, len(message)):
            raise RendererError(self._ffi.string(message).decode())
        return self._ffi.gc(scene, self._library.scene_free)


def _declarations() -> cffi.FFI:
    """render() and its settings, from the C headers themselves: one place says their layout."""
    ffi = cffi.FFI()
    text = "".join((SOURCES / name).read_text() for name in ("sampling.h", "render.h"))
    enums = re.findall(r"typedef enum \{[^}]*\} \w+;", text)
    settings = re.findall(r"typedef struct \{[^}]*\} RenderSettings;", text)
    ffi.cdef("\n".join([*enums, *settings, FUNCTIONS]))
    return ffi
