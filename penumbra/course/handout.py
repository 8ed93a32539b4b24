"""What a teacher hands out: the exercise and the notes as PDF/UA-1, figures, scenes, a notebook."""

from __future__ import annotations

import json
import shutil
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from penumbra.compare.check.catalogue import Variant
from penumbra.compare.check.mistaken import render
from penumbra.compare.cpp import cpp_scene
from penumbra.compare.exact.image import exact_image, regions, shade
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.measure.image import Image, write_display
from penumbra.compare.measure.metrics import relative_rmse, rmse
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import ROOT, VERSION
from penumbra.compare.scene import Plane, Scene, read_scene
from penumbra.course.figures import LIGHT_SAMPLES, ONE, SOFT, Picture, commands, write_figures
from penumbra.grading.rubric import read_rubric
from penumbra.language import LANGUAGES, N_, _, speaking

SOURCES = Path(__file__).resolve().parent / "handout"
NOTEBOOK = Path(__file__).resolve().parent / "notebook" / "penumbra.ipynb"
SERIES, SEEDS = (1, 4, 16, 64, 256), 8
"""Light samples of the notebook's images, and how many there are of each"""
SCENES = ROOT / "scenes"
DOCUMENTS = ("handout", "notes")
FIGURES = ("1", "2", "3", "4")
HANDED_OUT = (
    ("handout-{language}.pdf", N_("The exercise, to print")),
    ("notes-{language}.pdf", N_("Notes for the teacher")),
    ("notebook/penumbra.ipynb", N_("A notebook: compare two images, fit a slope")),
)
"""Files for people beside the lesson, as its page links to them, and what they are"""
PLACES = ((-1.0, -2.0, 2.0), (1.3, -2.0, 3.0), (0.0, -2.0, 1.8), (0.0, -2.0, 3.0))
"""On tp3's floor [m]: lit, twice in the penumbra, in the umbra"""
LATENT = (
    ("area_by_norms", "scale", "area_by_norms", "tp3_sheared"),
    ("divided_inside_light_loop", "lights", "divided_inside_light_loop", "tp3_two_quads"),
    ("quad_parametrisation_wrong", "domain", "diagonal", "check_low"),
)
"""Mistakes that hardly show in tp3, each with its module and choice, and a scene that shows it"""
SEEN = (
    ("cos_of_cos", "weight", "cos_of_cos_light"),
    ("pdf_times_cos", "weight", "pdf_times_cos"),
)
"""Mistakes, each with its module and choice, of which the notes say how bright tp3 becomes"""
CHANGED = 4 / 255
"""By more than that a mistake changes the mean of a pixel that it changes"""
EQUAL_RAYS = ((4, 1), (4, 16), (64, 1))
"""Light and pixel samples that answer the question about anti-aliasing"""


def handouts(build_dir: Path) -> dict[str, Any]:
    """What the page's template finds under `handouts`: of each file its name and title, by
    language."""
    files = []
    for file, title in HANDED_OUT:
        one = {}
        for chosen in LANGUAGES:
            with speaking(chosen):
                one[chosen] = {"name": file.format(language=chosen), "title": _(title)}
        files.append(one)
    return {"files": files}


def write_handouts(out: Path) -> None:
    """Everything beside the page into the folder `out`, each file whole.

    Raises MissingProgramError where the renderer is not built; ImportError without Typst.
    """
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        # Typst reads nothing outside of this folder, nor names it in what it writes.
        shutil.copytree(SOURCES, work, dirs_exist_ok=True)
        images = work / "images"
        images.mkdir()
        rendered = write_figures(work / "figures", images)
        computed = numbers(rendered, images)
        for language in LANGUAGES:
            data = computed | {"language": language}
            for name in DOCUMENTS:
                made = compiled(work / f"{name}-{language}.typ", data)
                _write(out / f"{name}-{language}.pdf", made)
            for number in FIGURES:
                made = compiled(work / "figure.typ", data, figure=number)
                _write(out / "figures" / f"figure-{number}-{language}.pdf", made)
        for file in sorted((work / "figures").iterdir()):
            _write(out / "figures" / file.name, file.read_bytes())
    for name, scene in scenes().items():
        _write(out / "scenes" / f"{name}.json", (SCENES / f"{name}.json").read_bytes())
        _write(out / "scenes" / f"{name}.txt", cpp_scene(scene).encode())
    write_notebook(out / "notebook")


def compiled(source: Path, data: Mapping[str, Any], **inputs: str) -> bytes:
    """A PDF of a Typst file: PDF/UA-1, so that what lacks an alternative text is an error, and of
    Typst's own fonts and without a date, so that it is the same bytes everywhere. data: what
    style.typ finds as `data`. Raises typst.TypstError."""
    import typst

    made = typst.compile(
        str(source),
        root=str(source.parent),
        format="pdf",
        pdf_standards=["ua-1"],
        ignore_system_fonts=True,
        sys_inputs={"data": json.dumps(data), **inputs},
    )
    assert isinstance(made, bytes)
    return made


def numbers(rendered: Mapping[str, Image], images: Path) -> dict[str, Any]:
    """All that the documents say in numbers, but for their language.

    rendered: the figures' images. images: where further ones are rendered.
    """
    scene = read_scene(SCENES / f"{SOFT.scene}.json")
    places = regions(scene, exact_image(scene))
    penumbra, lit = places["floor:penumbra"], places["floor:lit"]
    exact = rendered[SOFT.name].radiance

    def error(n: int) -> dict[str, Any]:
        image = rendered[ONE.name if n == 1 else f"figure-4-n{n}"].radiance
        return {
            "n": n,
            "penumbra": relative_rmse(image, exact, penumbra),
            "lit": relative_rmse(image, exact, lit),
        }

    def noise(n: int, m: int) -> float:
        """Relative as error's, by what differs between two seeds."""
        options = f"--light-samples {n} --pixel-samples {m} --seed"
        one, other = (
            Picture(f"n{n}_m{m}_s{seed}", SOFT.scene, f"{options} {seed}").render(images).radiance
            for seed in (1, 2)
        )
        return rmse(one, other, penumbra) / 2**0.5 / rmse(exact, np.zeros_like(exact), penumbra)

    rubric = read_rubric()
    return {
        "version": VERSION,
        "light_samples": LIGHT_SAMPLES,
        "commands": commands(),
        "errors": [error(n) for n in (1, *LIGHT_SAMPLES)],
        "equal_rays": [{"n": n, "m": m, "noise": noise(n, m)} for n, m in EQUAL_RAYS],
        "places": floor_radiance(read_scene(SCENES / "tp3.json")),
        "saturated": float((exact[lit].max(axis=-1) > 1).mean()),
        "frequencies": frequencies(),
        "seen": {name: brightness(module, choice) for name, module, choice in SEEN},
        "latent": {
            name: {
                "scene": scene_name,
                "of_tp3": changed("tp3", module, choice),
                "of_scene": changed(scene_name, module, choice),
            }
            for name, module, choice, scene_name in LATENT
        },
        "rubric": {
            "points": {criterion.claim: criterion.points for criterion in rubric.criteria},
            "total": rubric.total,
        },
        "scene": cpp_scene(read_scene(SCENES / "tp3.json")),
        "other_scenes": other_scenes(),
    }


def floor_radiance(scene: Scene) -> list[dict[str, Any]]:
    """What PLACES on the floor must tend to: the red channel's radiance [W m^-2 sr^-1]."""
    index = next(i for i, thing in enumerate(scene.objects) if isinstance(thing, Plane))
    n = len(PLACES)
    hits = Receivers(
        object_id=np.full(n, index),
        point=np.array(PLACES),
        normal=np.tile((0.0, 1.0, 0.0), (n, 1)),
        inside=np.zeros(n, dtype=bool),
    )
    radiance = shade(scene, hits)[0]
    return [
        {"place": place, "radiance": float(value[0])}
        for place, value in zip(PLACES, radiance, strict=True)
    ]


def brightness(module: str, choice: str) -> dict[str, float]:
    """How many times as bright a mistake makes what is lit of tp3's floor and sphere. Raises
    MissingProgramError."""
    file, shape = SCENES / "tp3.json", (100, 150)
    scene = read_scene(file)
    exact = exact_image(scene, shape[1], shape[0])
    mistaken = replace(Variant(), **{module: choice})  # type: ignore[arg-type]
    radiance = render(file, mistaken, shape, 256, 1, seed=1)
    return {
        name: float(radiance[lit].sum() / exact.radiance[lit].sum())
        for name in ("floor", "sphere")
        for lit in [regions(scene, exact)[f"{name}:lit"]]
    }


def changed(scene: str, module: str, choice: str) -> float:
    """The share of the scene's pixels that a mistake changes, by means of 8192 light samples, which
    leave a noise of less than half of CHANGED. Raises MissingProgramError."""

    def shown(variant: Variant) -> np.ndarray:
        images = (render(SCENES / f"{scene}.json", variant, (40, 60), 1024, 1, s) for s in range(8))
        return np.clip(np.mean(list(images), axis=0), 0, 1)

    mistaken = replace(Variant(), **{module: choice})  # type: ignore[arg-type]
    off = np.abs(shown(mistaken) - shown(Variant())).max(axis=-1)
    return float((off > CHANGED).mean())


@cache
def frequencies() -> dict[str, Any]:
    """frequencies.toml"""
    return tomllib.loads((SOURCES / "frequencies.toml").read_text(encoding="utf-8"))


def scenes() -> dict[str, Scene]:
    """Name -> each of Penumbra's."""
    files = sorted(f for f in SCENES.glob("*.json") if "schema" not in f.name)
    return {file.stem: read_scene(file) for file in files}


def other_scenes() -> list[dict[str, str]]:
    """The lab's scene under other lights: of the lines that make each those that tp3 has not."""
    of_tp3 = cpp_scene(read_scene(SCENES / "tp3.json")).splitlines()
    return [
        {
            "name": name,
            "lines": "\n".join(
                line for line in cpp_scene(scene).splitlines()[1:] if line not in of_tp3
            ),
        }
        for name, scene in scenes().items()
        if name.startswith("tp3_")
    ]


def write_notebook(folder: Path) -> None:
    """The notebook, and in images/ what it reads. Raises MissingProgramError, OSError."""
    _write(folder / NOTEBOOK.name, NOTEBOOK.read_bytes())
    images = folder / "images"
    (images / "series").mkdir(parents=True, exist_ok=True)
    for n in (16, 256):
        options = f"--light-samples {n} --seed 1 --width 300 --height 200"
        Picture(f"n{n}", SOFT.scene, options).render(images)
    for n in SERIES:
        for seed in range(1, SEEDS + 1):
            # A seed of its own for each: images of two N that share one are not independent.
            options = f"--light-samples {n} --seed {1000 * n + seed} --width 90 --height 60"
            Picture(f"n{n}_s{seed}", SOFT.scene, options).render(images / "series")
    tp3 = SCENES / "tp3.json"
    wrong = replace(Variant(), weight="cos_of_cos_receiver")
    for name, variant in (("right", Variant()), ("wrong", wrong)):
        radiance = render(tp3, variant, (200, 300), 16, 1, seed=1)
        write_display(images / name / "n16_m1.png", radiance)


def _write(file: Path, data: bytes) -> None:
    write_whole(file, lambda part: part.write_bytes(data))
