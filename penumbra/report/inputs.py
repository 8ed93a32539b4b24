"""The files that the page is made of: what makes each, and reading them. Those of one section
alone stand in its module.

Everything lies under the build folder. Images are named SCENE_nN_mM.exr: N light samples,
M pixel samples, seed 1, the scene's own size.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from penumbra.compare.exact.image import ExactImage, exact_image
from penumbra.compare.measure.image import Image, ImageError, read_image
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import Scene, read_scene
from penumbra.language import N_

LIGHTS = {
    "tp3": N_("square"),
    "tp3_sheared": N_("parallelogram"),
    "tp3_disk": N_("disk"),
    "tp3_triangle": N_("triangle"),
    "tp3_sphere": N_("sphere"),
    "tp3_two_lights": N_("square and point"),
}
"""The lights of the lab's scene and its variants: scene -> what shines"""
OTHER_LIGHTS = tuple(name for name in LIGHTS if name != "tp3")
SCENES = ("tp3", "tp3_statement", "tp3_point", *OTHER_LIGHTS)
LIGHT_SAMPLES = (4, 16, 64, 256)
"""figure 4 of the handout"""
FEW, PIXEL_SAMPLES = 4, 16
"""N and M of the anti-aliasing question, which is asked at equal N and at equal N * M"""
MOST_LIGHT_SAMPLES = dict.fromkeys(SCENES, 1024) | {
    "tp3": 32768,
    "tp3_statement": 32768,
    "tp3_point": 1,
}
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
    """False: its section does without"""
    keys: tuple[str, ...] = ()
    """that a JSON file must have"""
    shipped: str = ""
    """path in the repository of what is read where the build folder has none"""

    def path(self, build_dir: Path) -> Path:
        own = build_dir / self.file
        kept = ROOT / self.shipped
        return kept if self.shipped and not own.is_file() and kept.is_file() else own


def image_file(scene: str, light_samples: int, pixel_samples: int = 1) -> str:
    """
    >>> image_file("tp3", 64)
    'images/tp3_n64_m1.exr'
    """
    return f"images/{scene}_n{light_samples}_m{pixel_samples}.exr"


def best_image_file(scene: str) -> str:
    """The C renderer's least noisy image."""
    return image_file(scene, MOST_LIGHT_SAMPLES[scene])


def small_image_file(scene: str) -> str:
    """Ours, of the size of the reference."""
    return f"images/{scene}_small.exr" if scene in OTHER_LIGHTS else best_image_file(scene)


def reference_file(scene: str) -> str:
    """
    >>> reference_file("tp3")
    'reference/tp3.exr'
    """
    return f"reference/{scene}.exr"


def _how(scene: str) -> str:
    """The other lights have well-spread samples, a sphere's over the cone that is seen of it."""
    spread = "--estimator solid-angle " if scene == "tp3_sphere" else ""
    return f"--sampler sobol {spread}" if scene in OTHER_LIGHTS else ""


def _size(scene: str) -> str:
    """Of the reference."""
    return " --width 270 --height 180" if scene in OTHER_LIGHTS else ""


def image_input(scene: str, light_samples: int, pixel_samples: int = 1) -> Input:
    file = image_file(scene, light_samples, pixel_samples)
    command = (
        f"build/bin/penumbra-render scenes/{scene}.json --light-samples {light_samples} "
        f"--pixel-samples {pixel_samples} --seed {SEED} {_how(scene)}-o build/{file}"
    )
    return Input(file, command, scene)


def small_image_input(scene: str) -> Input:
    file = small_image_file(scene)
    command = (
        f"build/bin/penumbra-render scenes/{scene}.json --light-samples 4096 --seed {SEED} "
        f"{_how(scene).rstrip()}{_size(scene)} -o build/{file}"
    )
    return Input(file, command, scene)


def reference_input(scene: str) -> Input:
    file = reference_file(scene)
    command = f"penumbra reference scenes/{scene}.json -o build/{file}{_size(scene)}"
    return Input(file, command, scene)


def comparison_inputs(scene: str) -> Iterator[Input]:
    """C and Cycles against exact; C against Cycles where the two are of one size."""
    ours, small, cycles = best_image_file(scene), small_image_file(scene), reference_file(scene)
    for name, image, reference in (
        ("c_exact", ours, "exact"),
        ("cycles_exact", cycles, "exact"),
        ("c_cycles", small, f"build/{cycles}"),
    ):
        file = f"agreement/{scene}_{name}.json"
        perceptual = " --perceptual" if scene == "tp3" else ""
        command = (
            f"penumbra compare build/{image} {reference} --scene scenes/{scene}.json"
            f"{perceptual} --json build/{file}"
        )
        keys = ("rows", "metrics", "command")
        yield Input(file, command, scene, needed=reference == "exact", keys=keys)


IMAGES: tuple[Input, ...] = (
    image_input("tp3", FEW),
    image_input("tp3", FEW, PIXEL_SAMPLES),
    image_input("tp3", FEW * PIXEL_SAMPLES),
    image_input("tp3_statement", 1),
    *(image_input("tp3_statement", n) for n in LIGHT_SAMPLES),
    *(image_input(scene, MOST_LIGHT_SAMPLES[scene]) for scene in SCENES),
    *(small_image_input(scene) for scene in OTHER_LIGHTS),
    *(reference_input(scene) for scene in SCENES),
)
COMPARISONS: tuple[Input, ...] = tuple(c for scene in SCENES for c in comparison_inputs(scene))
"""The command exits with 1, its file written, where anything does not agree."""

_CONVERGE = (
    "penumbra converge scenes/tp3.json -o build/convergence/tp3 "
    f"--pixel-samples 1,{PIXEL_SAMPLES} --cycles 1..64"
)
CONVERGENCE_CSV = Input("convergence/tp3.csv", _CONVERGE, "tp3")
CONVERGENCE = Input(
    "convergence/tp3.json", _CONVERGE, "tp3", keys=("scene", "slopes", "curves", "command")
)


@dataclass(frozen=True)
class Data:
    """The inputs that are there, read."""

    build_dir: Path
    inputs: dict[str, Input]
    """by Input.file, as are images and tables"""
    scenes: dict[str, Scene]
    """by Input.scene, as are scene_texts"""
    scene_texts: dict[str, str]
    images: dict[str, Image]
    tables: dict[str, Any]
    """what JSON and CSV files hold"""
    _solved: dict[tuple[str, int, int], ExactImage] = field(default_factory=dict)

    def __getitem__(self, item: Input) -> Any:
        """What a JSON file holds, or a CSV file's rows: a dict each."""
        return self.tables[item.file]

    def has(self, item: Input) -> bool:
        return item.file in self.inputs

    def scene(self, file: str) -> Scene:
        """The scene of the image of that Input.file."""
        return self.scenes[self.inputs[file].scene]

    def truth(self, file: str) -> ExactImage:
        """The exact image of the same scene and size as the image of that Input.file."""
        height, width = self.images[file].shape
        return self.exact(self.inputs[file].scene, width, height)

    def exact(self, scene: str, width: int, height: int) -> ExactImage:
        """The exact image of the scene of that Input.scene, solved once."""
        key = scene, width, height
        if key not in self._solved:
            self._solved[key] = exact_image(self.scenes[scene], width, height)
        return self._solved[key]


def read_inputs(inputs: Sequence[Input], build_dir: Path, scenes_dir: Path) -> Data:
    """Read and check all that are there.

    Raises ReportError for files that are missing though needed, or for one that is broken or of
    another scene than scenes_dir's, naming it and the command that makes it; SceneError.
    """
    there = {i.file: i for i in inputs if i.path(build_dir).is_file()}
    missing = [i for i in inputs if i.needed and i.file not in there]
    if missing:
        raise ReportError("\n".join(str(unusable(i, build_dir, "no such file")) for i in missing))
    files = {i.scene: scenes_dir / f"{i.scene}.json" for i in inputs}
    scenes = {name: read_scene(file) for name, file in files.items()}
    read = {i.file: _read(i, build_dir) for i in there.values()}
    images = {file: value for file, value in read.items() if isinstance(value, Image)}
    for file, image in images.items():
        _check_scene(there[file], build_dir, image, scenes[there[file].scene])
    return Data(
        build_dir,
        there,
        scenes,
        {name: file.read_text() for name, file in files.items()},
        images,
        {file: value for file, value in read.items() if file not in images},
    )


def unusable(item: Input, build_dir: Path, reason: object) -> ReportError:
    return ReportError(f"{item.path(build_dir)}: {reason}; make it with: {item.command}")


def _read(item: Input, build_dir: Path) -> Any:
    """An image, a JSON object that has the input's keys, or a CSV file's rows."""
    path = item.path(build_dir)
    try:
        value = READERS[path.suffix](path)
    except ImageError as error:  # names the file itself
        raise ReportError(f"{error}; make it with: {item.command}") from error
    except (OSError, ValueError, csv.Error) as error:
        raise unusable(item, build_dir, error) from error
    missing = [k for k in item.keys if not isinstance(value, dict) or k not in value]
    if missing:
        raise unusable(item, build_dir, f"has no {', '.join(missing)}")
    return value


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


READERS: dict[str, Callable[[Path], Any]] = {".exr": read_image, ".json": _json, ".csv": _rows}


def _check_scene(item: Input, build_dir: Path, image: Image, scene: Scene) -> None:
    shown = image.attributes.get("sceneHash")
    if shown != scene.hash:
        reason = f"shows a scene of hash {shown}, but {scene.name} is now {scene.hash}"
        raise unusable(item, build_dir, reason)
