"""The museum of mistakes: each of the catalogue's, rendered and measured by the library that the
check foretells them with, and a switch on the page's live renderer."""

from __future__ import annotations

import base64
import ctypes
import hashlib
import io
import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image

from penumbra.compare.check import mistaken
from penumbra.compare.check.catalogue import (
    FILE,
    MODULES,
    STUDENTS,
    Choice,
    Mistake,
    Variant,
    catalogue,
)
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import ROOT
from penumbra.language import LANGUAGES, N_, _, say, speaking

N = 16
"""Light samples of the pictures and of the numbers"""
SHAPE, MEASURED, THUMBNAIL = (200, 300), (120, 180), (64, 96)
"""Rows and columns of an exhibit's picture, of those that are measured, of a closed exhibit's"""
SEEDS = 6
"""Pictures that are measured"""
QUALITY = 80
"""Of WebP"""
VISIBLE_SAMPLES = 64
"""Shadow rays by which lit is told from penumbra and shadow, here and by the live renderer"""
FEWEST_PIXELS = 30
"""Of a part of the picture, for it to have a number"""
SHOWS, SHOWS_NOISE, BLACK = 0.02, 1.3, 1.5 / 255
"""A mistake shows if a part is off by so much, its noise by that factor, or shadows are brighter"""
BLOCK, MOVED, SURE = 6, 2 / 255, 4.0
"""It shows too if blocks of so many pixels a side are off by more than these levels, by standard
errors; two of them, since there are hundreds"""
MOST_EFFECTIVE = 100 * N
"""Light samples whose noise nobody sees"""
SCENES = ("tp3_statement", "tp3_sheared", "tp3_two_quads", "check_low")
"""The lab's from the handout's camera, then those that show what it hides; a mistake is shown in
the first where it shows"""
CAMERA = ("tp3_sheared", "tp3_two_quads")
"""Seen from the handout's camera too, which shows the whole shadow"""
PIXEL_SAMPLES = {"clamp_before_pixel_average": 16}
"""Rays a pixel, where one does not show the mistake; with one light sample each"""
PARTS = ("floor", "sphere", "penumbra")
GROUPS = {
    "before": N_("Section 1, and the lab before"),
    "attributes": N_("Section 2: the attributes _n and _area"),
    "a": N_("Section 2, step (a): a random place on the quad"),
    "b": N_("Section 2, step (b): the direction and the shadow ray"),
    "c": N_("Section 2, step (c): the pdf"),
    "d": N_("Section 2, step (d): the radiance"),
    "loop": N_("Section 3: the mean of N light samples"),
}
"""The handout's places, in its order"""


def museum(build_dir: Path) -> dict[str, Any]:
    """What the template shows. What is rendered and measured is kept in build_dir, and made again
    if anything that it rests on has changed. Raises OSError, MissingProgramError."""
    made = _made(build_dir / "museum.json")
    known = sorted(catalogue().mistakes.values(), key=lambda mistake: -mistake.seen)
    groups: dict[str, list[dict[str, Any]]] = {group: [] for group in GROUPS}
    for mistake in known:
        groups[group_of(mistake)].append(_exhibit(mistake, made["exhibits"][mistake.name]))
    return {
        "groups": [
            {"name": group, "title": both(title), "exhibits": groups[group]}
            for group, title in GROUPS.items()
        ],
        "rights": [
            {"name": name, "picture": right, "alt": _alt_of_right(name)}
            for name, right in made["rights"].items()
        ],
        "live": {
            "scenes": made["scenes"],
            "exhibits": {
                name: {k: exhibit[k] for k in ("scene", "n", "m", "chosen")}
                | {"forms": [[form["module"], form["name"]] for form in exhibit["forms"]]}
                for name, exhibit in made["exhibits"].items()
            },
        },
    }


def group_of(mistake: Mistake) -> str:
    """Of GROUPS: the first place of the handout that its step names."""
    letter = re.search(r"steps? \(([a-d])\)", mistake.step)
    if "attribute" in mistake.step:
        return "attributes"
    if letter:
        return letter[1]
    return "loop" if "section 3" in mistake.step else "before"


# What is rendered and measured


@dataclass(frozen=True)
class Measured:
    """What a mistake does to the pictures of a scene."""

    floor: float | None
    """its lit part: how many times as bright as it should be; None: the scene has none"""
    sphere: float | None
    penumbra: float | None
    shadow: float
    """the mean of what should be black, as saved [0, 1]"""
    effective_samples: float | None
    """the number of light samples that the penumbra's noise is that of; None: it has none"""
    shows: bool


class Stage:
    """A scene, its parts, and the right pictures of it."""

    def __init__(self, name: str, folder: Path) -> None:
        """folder: for files of its own"""
        self.name = name
        self.scene = json.loads((ROOT / "scenes" / f"{name}.json").read_text())
        if name in CAMERA:
            first = json.loads((ROOT / "scenes" / f"{SCENES[0]}.json").read_text())
            self.scene["camera"] = first["camera"]
        self.file = _written(folder / f"{name}.json", self.scene)
        self.parts = parts_of(_written(folder / f"{name}_parts.json", marked(self.scene)), MEASURED)
        self._right: dict[tuple[int, int], np.ndarray] = {}

    def pictures(self, variant: Variant, n: int, m: int) -> np.ndarray:
        """(SEEDS, rows, columns): the sum of the colours"""
        made = [picture(self.file, variant, MEASURED, n, m, seed) for seed in range(SEEDS)]
        return np.stack(made).sum(axis=3, dtype=float)

    def measured(self, variant: Variant, n: int, m: int) -> Measured:
        """Against the right renderer with the same random numbers: what both share cancels."""
        alone = Variant(**{k: getattr(variant, k) for k in MODULES if k != "generator"})
        if (n, m) not in self._right:
            self._right[n, m] = self.pictures(Variant(), n, m)
        found, right = self.pictures(alone, n, m), self._right[n, m]
        dark = self.parts["shadow"]
        shadow = float(np.clip(found[:, dark], 0, 1).mean()) if dark.any() else 0.0
        moved = _moved(np.clip(found, 0, 1), np.clip(right, 0, 1))
        if as_saved(variant):
            found, right = np.clip(found, 0, 1), np.clip(right, 0, 1)
        ratio: dict[str, float | None] = dict.fromkeys(PARTS)
        for part in PARTS:
            mask = self.parts[part]
            if mask.sum() >= FEWEST_PIXELS:
                ratio[part] = float(found[:, mask].sum() / right[:, mask].sum())
        mask = self.parts["penumbra"]
        noise, usual = (float(x[:, mask].var(axis=0, ddof=1).sum()) for x in (found, right))
        lit = (ratio["penumbra"] or 0) ** 2
        effective = n * m * lit * usual / noise if noise > 0 else np.inf
        quiet = effective > MOST_EFFECTIVE
        off = max(abs(r - 1) for r in ratio.values() if r is not None)
        loud = max(effective / (n * m), n * m / max(effective, 1e-9)) > SHOWS_NOISE
        patterned = variant["generator"].mistake != ""
        shows = off > SHOWS or shadow > BLACK or loud or moved or patterned
        return Measured(**ratio, shadow=shadow, effective_samples=None if quiet or lit == 0 else
                        effective, shows=bool(shows))  # fmt: skip


def _moved(found: np.ndarray, right: np.ndarray) -> bool:
    """Whether some blocks of the pictures are off, noise apart."""
    difference = found - right
    seeds, height, width = difference.shape
    blocks = difference.reshape(seeds, height // BLOCK, BLOCK, width // BLOCK, BLOCK)
    each = blocks.mean(axis=(2, 4))
    error = each.std(axis=0, ddof=1) / np.sqrt(seeds)
    return int((np.abs(each.mean(axis=0)) > MOVED + SURE * error).sum()) > 1


def marked(scene: dict[str, Any]) -> dict[str, Any]:
    """Its spheres blue and its planes red on black: a colour says what a pixel shows."""
    colours = {"spheres": [0, 0, 1], "planes": [1, 0, 0]}
    changed = {
        kind: [thing | {"color": colour} for thing in scene.get(kind, [])]
        for kind, colour in colours.items()
    }
    return scene | changed | {"background": [0, 0, 0]}


def parts_of(marked_file: Path, shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Masks (H, W) of the PARTS: floor and sphere where they see every light whole, the penumbra,
    and "shadow". From the same samples, with shadow rays and without."""
    visible, every = (
        mistaken.render(marked_file, Variant(visibility=ray), shape, VISIBLE_SAMPLES, 1, 0)
        for ray in ("std", "none")
    )
    seen, there = visible.sum(axis=2), every.sum(axis=2)
    whole = (there > 0) & (seen == there)
    return {
        "floor": whole & (every[..., 0] > 0),
        "sphere": whole & (every[..., 2] > 0),
        "penumbra": (seen > 0) & (seen != there),
        "shadow": (there > 0) & (seen == 0),
    }


def as_saved(variant: Variant) -> bool:
    """Whether only what is cut at 1 shows it."""
    return bool(variant["output"].field("wrap")) or variant["clamp"].mistake != ""


def picture(
    file: Path, variant: Variant, shape: tuple[int, int], n: int, m: int, seed: int
) -> np.ndarray:
    """(H, W, 3), linear; wrapped at 1, where the mistake is that."""
    position = (0.5, 0.5) if m == 1 else None
    radiance = mistaken.render(file, variant, shape, n, m, seed, position)
    return radiance % np.float32(256 / 255) if variant["output"].field("wrap") else radiance


def _written(file: Path, scene: dict[str, Any]) -> Path:
    file.write_text(json.dumps(scene))
    return file


def _made(kept: Path) -> dict[str, Any]:
    """Pictures and numbers of all mistakes, from the file if nothing has changed since."""
    of = [FILE, mistaken.LIBRARY, Path(__file__), *(ROOT / "scenes" / f"{s}.json" for s in SCENES)]
    key = hashlib.sha256(b"".join(f.read_bytes() for f in of if f.is_file())).hexdigest()
    if kept.is_file():
        before: dict[str, Any] = json.loads(kept.read_text())
        if before["key"] == key:
            return before
    with tempfile.TemporaryDirectory() as folder, _one_thread():
        stages = [Stage(name, Path(folder)) for name in SCENES]
        made = {
            "key": key,
            "scenes": {stage.name: stage.scene for stage in stages},
            "rights": {s.name: _webp(_eight_bits(s, Variant(), N, 1)) for s in stages},
            "exhibits": {name: _rendered(name, stages) for name in catalogue().mistakes},
        }
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_whole(kept, lambda part: part.write_text(json.dumps(made)))
    return made


@contextmanager
def _one_thread() -> Iterator[None]:
    """Pictures are so small that a second thread costs more than it brings."""
    threads = ctypes.CDLL("libgomp.so.1")
    before = threads.omp_get_max_threads()
    threads.omp_set_num_threads(1)
    try:
        yield
    finally:
        threads.omp_set_num_threads(before)


def forms_of(name: str) -> list[Choice]:
    """The choices that go under a mistake's name."""
    return [choice for choice in catalogue().choices.values() if choice.mistake == name]


def typical(forms: Sequence[Choice]) -> int:
    """The one to show first: the first, or the middle one where they differ in a number only."""
    fields = {tuple(a.partition("=")[0] for a in form.arguments) for form in forms}
    graded = len(fields) == 1 and forms[0].module in ("visibility", "output")
    return len(forms) // 2 if graded else 0


def _rendered(name: str, stages: Sequence[Stage]) -> dict[str, Any]:
    """A mistake's exhibit: in the first scene where its typical form shows."""
    m = PIXEL_SAMPLES.get(name, 1)
    n = N if m == 1 else 1
    forms = forms_of(name)
    chosen = typical(forms)
    variant = Variant().replaced(forms[chosen])
    shown = (s for s in stages if s.measured(variant, n, m).shows)
    stage = next(shown, None)
    hidden = stage is None
    stage = stage or stages[0]
    image = _eight_bits(stage, variant, n, m)
    return {
        "scene": stage.name,
        "hidden": hidden,
        "n": n,
        "m": m,
        "chosen": chosen,
        "picture": _webp(image),
        "thumbnail": _webp(image.resize(THUMBNAIL[::-1], Image.Resampling.BOX)),
        "forms": [
            {"module": form.module, "name": form.name, "code": code(form)}
            | asdict(stage.measured(Variant().replaced(form), n, m))
            for form in forms
        ],
    }


def _eight_bits(stage: Stage, variant: Variant, n: int, m: int) -> Image.Image:
    radiance = picture(stage.file, variant, SHAPE, n, m, SEEDS)
    return Image.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8))


def _webp(image: Image.Image) -> str:
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=QUALITY, method=6)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def code(choice: Choice) -> str:
    """A choice as the catalogue has it.

    >>> code(forms_of("quad_parametrisation_wrong")[0])
    's = a, t = a'
    >>> code(forms_of("shadow_offset_too_big")[0])
    'offset = 0.05'
    """
    if choice.module == "domain":
        return "s = {}, t = {}".format(*choice.arguments)
    return ", ".join(argument.lstrip(".") for argument in choice.arguments)


# What is said


def both(text: str, sentence: bool = False, **values: Any) -> Markup:
    """A text in both languages, of which the page shows one; sentence: with a capital."""
    said = {}
    for chosen in LANGUAGES:
        with speaking(chosen):
            said[chosen] = say(text, **values) if values else _(text)
    if sentence:
        said = {chosen: capitalised(text) for chosen, text in said.items()}
    if len(set(said.values())) == 1 and not re.search("[a-zA-Z]", said["en"]):
        return Markup("{}").format(said["en"])
    spans = (Markup('<span lang="{}">{}</span>').format(*item) for item in said.items())
    return Markup("").join(spans)


def capitalised(text: str) -> str:
    """With a capital, but if it begins with a name of a program.

    >>> capitalised("the light"), capitalised("nbLightSamples has no effect")
    ('The light', 'nbLightSamples has no effect')
    """
    word = re.match(r"[^\W\d_]*(?![\w(])", text)
    return text[:1].upper() + text[1:] if word and word[0].islower() else text


def _exhibit(mistake: Mistake, made: dict[str, Any]) -> dict[str, Any]:
    forms = [form | {"cells": _cells(form)} for form in made["forms"]]
    shown = forms[made["chosen"]]
    return {
        "name": mistake.name,
        "anchor": mistake.anchor,
        "seen": mistake.seen,
        "title": both(mistake.title, sentence=True),
        "cause": both(mistake.cause),
        "wrong": both(mistake.wrong),
        "right": both(mistake.right),
        "step": both(mistake.step, sentence=True),
        "question": both(mistake.look, sentence=True),
        "seen_in": _seen_in(mistake),
        "scene": made["scene"],
        "hidden": made["hidden"],
        "elsewhere": made["scene"] != SCENES[0],
        "counts": both("At N = {n}, {m} rays a pixel", n=made["n"], m=made["m"])
        if made["m"] > 1
        else both("At N = {n}", n=made["n"]),
        "picture": made["picture"],
        "thumbnail": made["thumbnail"],
        "alt": _alt(mistake, shown),
        "cells": shown["cells"],
        "forms": forms,
        "forms_title": both("Its {count} forms, each measured", count=len(forms)),
    }


def _seen_in(mistake: Mistake) -> Markup | None:
    if mistake.usual:
        return both("in most of {of} students’ programs", of=STUDENTS)
    if mistake.seen:
        return both("in {count} of {of} students’ programs", count=mistake.seen, of=STUDENTS)
    return None


def _cells(form: dict[str, Any]) -> list[Markup]:
    """What is measured: the three parts, the shadow, the noise."""
    parts = [times(form[part]) for part in PARTS]
    noise = form["effective_samples"]
    return [
        *parts,
        both("{value:.0f} of 255", value=255 * form["shadow"]),
        both("none") if noise is None else both("{n:.2g}", n=max(noise, 0.1)),
    ]


def times(ratio: float | None) -> Markup:
    if ratio is None:
        return Markup("–")
    if 0.1 <= ratio < 10:
        return both("× {ratio:.2f}", ratio=ratio)
    return both("× {ratio:.2g}", ratio=ratio)


def _alt(mistake: Mistake, form: dict[str, Any]) -> dict[str, str]:
    said = {}
    for chosen in LANGUAGES:
        with speaking(chosen):
            parts = [
                say(text, ratio=form[part])
                for part, text in (
                    ("floor", N_("lit floor × {ratio:.2g}")),
                    ("sphere", N_("lit sphere × {ratio:.2g}")),
                    ("penumbra", N_("penumbra × {ratio:.2g}")),
                )
                if form[part] is not None
            ]
            said[chosen] = say(
                "Picture with this mistake: {title}. Against the right one: {parts}.",
                title=_(mistake.title),
                parts=", ".join(parts),
            )
    return said


def _alt_of_right(name: str) -> dict[str, str]:
    said = {}
    for chosen in LANGUAGES:
        with speaking(chosen):
            said[chosen] = say("The right picture of the scene {scene}", scene=name)
    return said
