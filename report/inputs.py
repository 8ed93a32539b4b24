"""The files that the page is made of: which, what makes each, and reading them.

Everything lies under the build folder. Images are named SCENE_nN_mM.exr: N light samples,
M pixel samples, seed 1, the scene's own size.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compare.exact.image import ExactImage, exact_image
from compare.measure.image import Image, ImageError, read_image
from compare.scene import Scene, read_scene

SCENES = ("tp3", "tp3_statement", "tp3_point")
LIGHT_SAMPLES = (4, 16, 64, 256)
"""figure 4 of the handout"""
FEW, PIXEL_SAMPLES = 4, 16
"""N and M of the anti-aliasing question, which is asked at equal N and at equal N * M"""
MOST_LIGHT_SAMPLES = {"tp3": 32768, "tp3_statement": 32768, "tp3_point": 1}
"""N of the images that agreement is tested on and that the error maps show. At 32768 the 99%
interval of tp3's floor penumbra is +-0.012%, a quarter of the bias that still agrees."""
SEED = 1


class ReportError(ValueError):
    """An input that is missing or cannot be used; the text names it and what makes it."""


@dataclass(frozen=True)
class Input:
    file: str
    """path inside the build folder, with forward slashes"""
    command: str
    """run from the repository's root, where the build folder is `build`"""
    scene: str
    needed: bool = True
    """False: the page does without"""

    def path(self, build_dir: Path) -> Path:
        return build_dir / self.file


def image_file(scene: str, light_samples: int, pixel_samples: int = 1) -> str:
    """
    >>> image_file("tp3", 64)
    'images/tp3_n64_m1.exr'
    """
    return f"images/{scene}_n{light_samples}_m{pixel_samples}.exr"


def best_image_file(scene: str) -> str:
    """The C renderer's least noisy image."""
    return image_file(scene, MOST_LIGHT_SAMPLES[scene])


def reference_file(scene: str) -> str:
    """
    >>> reference_file("tp3")
    'reference/tp3.exr'
    """
    return f"reference/{scene}.exr"


def _render(scene: str, light_samples: int, pixel_samples: int = 1) -> Input:
    file = image_file(scene, light_samples, pixel_samples)
    command = (
        f"build/bin/penumbra-render scenes/{scene}.json --light-samples {light_samples} "
        f"--pixel-samples {pixel_samples} --seed {SEED} -o build/{file}"
    )
    return Input(file, command, scene)


def _reference(scene: str) -> Input:
    file = reference_file(scene)
    return Input(file, f"penumbra reference scenes/{scene}.json -o build/{file}", scene)


def _comparisons(scene: str) -> Iterator[Input]:
    """C and Cycles against exact; C against Cycles where the two are of one size."""
    files = {"c": best_image_file(scene), "cycles": reference_file(scene)}
    for image, reference in (("c", "exact"), ("cycles", "exact"), ("c", "cycles")):
        file = f"agreement/{scene}_{image}_{reference}.json"
        against = f"build/{files[reference]}" if reference in files else reference
        perceptual = " --perceptual" if scene == "tp3" else ""
        command = (
            f"penumbra compare build/{files[image]} {against} --scene scenes/{scene}.json"
            f"{perceptual} --json build/{file}"
        )
        yield Input(file, command, scene, needed=reference == "exact")


IMAGES: tuple[Input, ...] = (
    _render("tp3", FEW),
    _render("tp3", FEW, PIXEL_SAMPLES),
    _render("tp3", FEW * PIXEL_SAMPLES),
    _render("tp3_statement", 1),
    *(_render("tp3_statement", n) for n in LIGHT_SAMPLES),
    *(_render(scene, MOST_LIGHT_SAMPLES[scene]) for scene in SCENES),
    *(_reference(scene) for scene in SCENES),
)
COMPARISONS: tuple[Input, ...] = tuple(c for scene in SCENES for c in _comparisons(scene))
"""The command exits with 1, its file written, where anything does not agree."""

_CONVERGE = (
    "penumbra converge scenes/tp3.json -o build/convergence/tp3 "
    f"--pixel-samples 1,{PIXEL_SAMPLES} --cycles 1..64"
)
CONVERGENCE_CSV = Input("convergence/tp3.csv", _CONVERGE, "tp3")
CONVERGENCE = Input("convergence/tp3.json", _CONVERGE, "tp3")
SPEEDUP = Input("speedup.json", "penumbra speedup scenes/tp3.json -o build/speedup.csv", "tp3")

INPUTS: tuple[Input, ...] = (*IMAGES, *COMPARISONS, CONVERGENCE_CSV, CONVERGENCE, SPEEDUP)


@dataclass(frozen=True)
class Data:
    """All inputs, read."""

    scenes: dict[str, Scene]
    scene_texts: dict[str, str]
    images: dict[str, Image]
    """by Input.file"""
    exact: dict[tuple[str, int, int], ExactImage]
    """by scene, height and width: for each image"""
    comparisons: dict[str, dict[str, Any]]
    """what `penumbra compare` wrote, by Input.file"""
    convergence: dict[str, Any]
    convergence_rows: list[dict[str, str]]
    speedup: dict[str, Any]

    def scene(self, file: str) -> Scene:
        """The scene of the image of that Input.file."""
        return self.scenes[next(i.scene for i in IMAGES if i.file == file)]

    def truth(self, file: str) -> ExactImage:
        """The exact image of the same scene and size as the image of that Input.file."""
        name = next(i.scene for i in IMAGES if i.file == file)
        return self.exact[name, *self.images[file].shape]


def read_inputs(build_dir: Path, scenes_dir: Path) -> Data:
    """Read and check everything.

    Raises ReportError for a file that is missing, broken, or of another scene than
    scenes_dir's, naming it and the command that makes it; SceneError.
    """
    _check_present(build_dir)
    files = {name: scenes_dir / f"{name}.json" for name in SCENES}
    scenes = {name: read_scene(file) for name, file in files.items()}
    images = {i.file: _image(i, build_dir, scenes[i.scene]) for i in IMAGES}
    sizes = {(i.scene, *images[i.file].shape) for i in IMAGES}
    sizes |= {(name, scene.height, scene.width) for name, scene in scenes.items()}
    return Data(
        scenes,
        {name: file.read_text() for name, file in files.items()},
        images,
        {(scene, h, w): exact_image(scenes[scene], w, h) for scene, h, w in sizes},
        {
            i.file: _read_json(i, build_dir, "rows", "metrics", "command")
            for i in COMPARISONS
            if i.path(build_dir).is_file()
        },
        _read_json(CONVERGENCE, build_dir, "scene", "slopes", "curves", "command"),
        _read(CONVERGENCE_CSV, build_dir, _rows),
        _read_json(SPEEDUP, build_dir, "rows", "command"),
    )


def _check_present(build_dir: Path) -> None:
    missing = [i for i in INPUTS if i.needed and not i.path(build_dir).is_file()]
    if missing:
        raise ReportError("\n".join(str(_unusable(i, build_dir, "no such file")) for i in missing))


def _unusable(item: Input, build_dir: Path, reason: object) -> ReportError:
    return ReportError(f"{item.path(build_dir)}: {reason}; make it with: {item.command}")


def _read(item: Input, build_dir: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(item.path(build_dir))
    except ImageError as error:  # names the file itself
        raise ReportError(f"{error}; make it with: {item.command}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise _unusable(item, build_dir, error) from error


def _read_json(item: Input, build_dir: Path, *keys: str) -> dict[str, Any]:
    """A JSON object that has the keys."""
    value = _read(item, build_dir, lambda path: json.loads(path.read_text()))
    missing = [k for k in keys if not isinstance(value, dict) or k not in value]
    if missing:
        raise _unusable(item, build_dir, f"has no {', '.join(missing)}")
    return dict(value)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def _image(item: Input, build_dir: Path, scene: Scene) -> Image:
    image: Image = _read(item, build_dir, read_image)
    shown = image.attributes.get("sceneHash")
    if shown != scene.hash:
        reason = f"shows a scene of hash {shown}, but {scene.name} is now {scene.hash}"
        raise _unusable(item, build_dir, reason)
    return image
