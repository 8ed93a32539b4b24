"""Our side of the process that has Blender in it (render.py is the other side)."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from penumbra.compare.measure.image import Image, read_image
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import INSTALLED, file_hash, how_to_install
from penumbra.compare.scene import Scene, read_scene

PACKAGE = Path(__file__).resolve().parent
LOG_TAIL = 2000
"""How much of what Blender printed is repeated when it fails [characters]."""
SYSTEM_LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1"
"""Debian's packages that bpy is linked with."""


class MissingBlender(ImportError):
    """bpy cannot be imported here; the text says why and what to do."""

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"Cycles cannot run: {reason} (Python {platform.python_version()}, "
            f"{platform.system()} {platform.machine()}). bpy needs Python 3.11 (bpy 4.5) or "
            "3.13 (bpy 5.2), and there is none for Linux on Arm; with one of these, "
            f"{how_to_install('cycles')}"
            + ("" if INSTALLED else ". Without it, use the references in blender_ref/shipped.")
        )


class CyclesError(RuntimeError):
    """Cycles cannot render this scene identically, or failed; the text says why."""


class Cycles:
    """A process with Blender in it, which renders one scene as often as it is asked to.

    width, height: pixels, instead of the scene's own. antialias: uniform positions in the
    pixel instead of its centre. A context manager; the process ends with the block, and by
    itself if we are killed. Raises SceneError, MissingBlender, CyclesError.

    The image is a function of scene, size, antialias, samples and seed alone. Images of
    different seeds are independent.
    """

    def __init__(
        self,
        scene_file: str | Path,
        width: int | None = None,
        height: int | None = None,
        antialias: bool = False,
    ) -> None:
        self.scene: Scene = read_scene(scene_file)
        self.width, self.height = width or self.scene.width, height or self.scene.height
        self.antialias = antialias
        self.version = blender_version()
        self._folder = Path(tempfile.mkdtemp(prefix="penumbra-cycles-"))
        self._process: subprocess.Popen[str] | None = None
        try:
            self._process = _start(self._folder)
            ready = self._ask(
                scene_file=str(Path(scene_file).absolute()),
                scene_hash=self.scene.hash,
                width=self.width,
                height=self.height,
                antialias=antialias,
            )
        except BaseException:
            self.close()
            raise
        self._settings: dict[str, Any] = ready["settings"]
        self._sampler = str(ready["sampler"])
        self._threads = int(ready["threads"])

    def render(self, samples: int, *seed: int) -> Image:
        """One image of `samples` light samples per pixel, with no variance.

        seed: one or more integers >= 0, for instance a seed and the number of a part.
        Raises CyclesError, ImageError (NaN or infinite pixels).
        """
        raw = self._folder / "raw.exr"
        drawn = cycles_seed(*seed)
        done = self._ask(samples=samples, seed=drawn, out=str(raw))
        image = read_image(raw)
        raw.unlink()
        if image.shape != (self.height, self.width):
            raise CyclesError(f"Cycles made {image.shape}, not {(self.height, self.width)} pixels")
        attributes: dict[str, str | int | float] = {
            "sceneName": self.scene.name,
            "sceneHash": self.scene.hash,
            "lightSamples": samples,
            "pixelSamples": samples if self.antialias else 1,
            "threads": self._threads,
            "seed": " ".join(map(str, seed)),
            "sampler": self._sampler,
            "software": software(self.version),
            "settings": json.dumps(
                {**self._settings, "cycles.samples": samples, "cycles.seed": drawn}
            ),
            "renderSeconds": float(done["seconds"]),
        }
        return Image(image.radiance, None, attributes)

    def save_blend(self, file: str | Path, samples: int, *seed: int) -> None:
        """Save the scene for people to open in Blender; whole or not at all.

        F12 there renders `samples` light samples. Raises CyclesError.
        """
        path = Path(file).absolute()
        drawn = cycles_seed(*seed)
        try:
            write_whole(path, lambda p: self._ask(blend=str(p), samples=samples, seed=drawn))
        except OSError as error:
            raise CyclesError(f"{file}: cannot be written: {error.strerror}") from error

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    with contextlib.suppress(BrokenPipeError):
                        stream.close()
            self._process = None
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Cycles:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _ask(self, **request: Any) -> dict[str, Any]:
        """Send one request as a line of JSON and wait for the answer."""
        if self._process is None or self._process.stdin is None or self._process.stdout is None:
            raise CyclesError("this Cycles process is closed")
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            code = self._process.wait()
            raise CyclesError(f"Blender ended by itself with {code}; it printed:\n{self._log()}")
        answer: dict[str, Any] = json.loads(line)
        if "missing" in answer:
            raise MissingBlender(f"{answer['missing']}; on Debian it also needs {SYSTEM_LIBRARIES}")
        if "unsupported" in answer:
            raise CyclesError(f"{request['scene_file']}: {answer['unsupported']}")
        if "failed" in answer:
            raise CyclesError(f"{answer['failed']}; Blender printed:\n{self._log()}")
        return answer

    def _log(self) -> str:
        text = (self._folder / "log").read_text(errors="replace")[-LOG_TAIL:]
        return "".join(c if c.isprintable() or c == "\n" else "?" for c in text).strip()


def blender_version() -> str:
    """Version of the bpy that is installed, as "4.5.15". Raises MissingBlender."""
    try:
        return metadata.version("bpy")
    except metadata.PackageNotFoundError as error:
        raise MissingBlender("bpy is not installed") from error


def software(version: str) -> str:
    return f"Cycles (bpy {version})"


def fingerprint() -> str:
    """Changes whenever the images may: Blender's version and the files that make the scene.

    Raises MissingBlender.
    """
    files = ("build_scene.py", "cycles_settings.py", "render.py", "process.py")
    return f"{software(blender_version())} {file_hash(*(PACKAGE / name for name in files))}"


def cycles_seed(*seed: int) -> int:
    """31 bits for Cycles from any number of integers >= 0, as numpy mixes seeds.

    >>> cycles_seed(0, 1) == cycles_seed(0, 2)
    False
    """
    return int(np.random.SeedSequence(seed).generate_state(1)[0] >> 1)


def _start(folder: Path) -> subprocess.Popen[str]:
    """Start render.py with nothing of the user's Blender, and `folder` for all that it writes."""
    foreign = ("BLENDER_", "CYCLES_", "OCIO")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    search = [str(PACKAGE.parents[1]), environment.get("PYTHONPATH", "")]
    user = folder / "user"
    user.mkdir()
    environment |= {
        "BLENDER_USER_RESOURCES": str(user),
        "PYTHONPATH": os.pathsep.join(filter(None, search)),
        "TMPDIR": str(folder),
    }
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "penumbra.blender_ref.render", str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment,
            start_new_session=True,  # Ctrl-C is ours alone: we then end the process
        )
