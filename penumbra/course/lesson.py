"""The lesson: its texts, a Markdown file a language, and the pictures that stand where no script
runs.

A file is a title and an introduction, then steps. A step is

    ## Its title {#its-anchor}
    text
    ### Handout      where in the handout
    ### Question     to answer before anything is moved
    ### Figure       the picture's alt text, as ![alt](its-anchor), and a caption
    ### Answer

in this order, the headings in the file's language. Formulas stand between $ or, alone in a
paragraph, between $$, in LaTeX.
"""

from __future__ import annotations

import base64
import copy
import io
import json
import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import latex2mathml.converter
import numpy as np
from markdown_it import MarkdownIt
from markdown_it.rules_block import StateBlock
from markdown_it.rules_inline import StateInline
from markdown_it.token import Token
from markupsafe import Markup
from PIL import Image as PillowImage

from penumbra.compare.cpp import cpp_scene
from penumbra.compare.measure.image import read_image
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import read_scene
from penumbra.language import LANGUAGES, NO_BREAK

TEXTS = Path(__file__).resolve().parent / "lesson"
PARTS = {
    "en": ("Handout", "Question", "Figure", "Answer"),
    "fr": ("Énoncé", "Question", "Figure", "Réponse"),
}
"""The headings of a step's parts."""
SIZE = 600, 400
"""Of the pictures [px]."""
QUALITY = 72
"""Of WebP: what noise looks like can be seen, and a picture of it takes 20 to 60 KB."""
FUNCTIONS = "cos|sin|log|max"


@dataclass(frozen=True)
class Step:
    """In one language; texts are HTML."""

    anchor: str
    title: Markup
    text: Markup
    place: Markup
    question: Markup
    alt: str
    caption: Markup
    answer: Markup
    line: int
    """where it begins in its file"""
    numbers: tuple[tuple[str, int], ...]
    """those that are said, as English writes them, and the lines of their paragraphs"""


@dataclass(frozen=True)
class Lesson:
    title: Markup
    introduction: Markup
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Strip:
    """A part of a picture, from top to bottom: a scene, and the options of penumbra-render."""

    scene: str
    options: tuple[str, ...] = ("--estimator", "exact")
    changes: dict[str, Any] = field(default_factory=dict)
    """of the scene's top-level keys"""
    coarse: int = 1
    """how many times larger than a pixel is shown"""


def sampled(n: int, *more: str) -> tuple[str, ...]:
    return ("--light-samples", str(n), *more)


WHOLE = {"position": [0, 0.6, -3], "look_at": [0, -0.9, 3], "up": [0, 1, 0], "fov_y_deg": 42}
"""Looks down on the shadow, of which the lab's own camera sees the upper edge alone."""
CLOSE = {"position": [0, 1.6, -3], "look_at": [0, -2, 2.7], "up": [0, 1, 0], "fov_y_deg": 24}
"""Fills the picture with the shadow."""
MIDDLE = [0, 10, 3]
"""Of the quad."""
POINT = {"name": "point", "position": MIDDLE, "color": [1, 1, 1], "power": 160}
BULB = {"name": "bulb", "center": MIDDLE, "radius": 1, "color": [1, 1, 1], "power": 160 / np.pi}
"""They bring the floor below them as much as the quad of 4 m² and power 40."""
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "whole": ("tp3", {"camera": WHOLE}),
    "close": ("tp3", {"camera": CLOSE}),
    "point": ("tp3_point", {"camera": WHOLE, "point_lights": [POINT]}),
    "disk": ("tp3_disk", {"camera": CLOSE}),
    "triangle": ("tp3_triangle", {"camera": CLOSE}),
    "sphere": ("tp3_sphere", {"camera": CLOSE, "sphere_lights": [BULB]}),
}
"""What the figures show: a file of scenes/, and what is changed in it."""


def far(metres: float) -> dict[str, Any]:
    """What moves the scene along x; its camera goes along."""
    moved = scene_of("close")
    for key in ("position", "look_at"):
        moved["camera"][key][0] += metres
    moved["spheres"][0]["center"][0] += metres
    moved["quad_lights"][0]["position"][0] += metres
    return {key: moved[key] for key in ("camera", "spheres", "quad_lights")}


def scene_of(name: str) -> dict[str, Any]:
    """The JSON of a scene of SCENES."""
    file, changes = SCENES[name]
    return copy.deepcopy(_scene(file) | changes)


def _scene(file: str) -> dict[str, Any]:
    scene: dict[str, Any] = json.loads((ROOT / "scenes" / f"{file}.json").read_text())
    return scene


CAMERAS = {"lab": "tp3", "handout": "tp3_statement"}
"""Those that a figure offers beside its own, and the scenes that have them"""
OPENING = (Strip("whole"),)
"""The picture beside the title, which says nothing that the lesson does not"""


def pictures() -> dict[str, tuple[str, tuple[Strip, ...]]]:
    """Of each step: the scene whose C++ lines stand below it, and the picture's strips from left to
    right."""
    return {
        "hard-and-soft": ("whole", (Strip("point"), Strip("whole"))),
        "one-ray": ("whole", (Strip("whole", sampled(1)),)),
        "average": ("close", tuple(Strip("close", sampled(n)) for n in (1, 4, 16, 64))),
        "umbra": ("close", (Strip("close", sampled(4)),)),
        "square-root": ("close", tuple(Strip("close", sampled(n)) for n in (1, 16, 256))),
        "antialiasing": (
            "whole",
            (
                Strip("whole", sampled(4), coarse=4),
                Strip("whole", sampled(4, "--pixel-samples", "16"), coarse=4),
            ),
        ),
        "trade": (
            "close",
            tuple(
                Strip("close", options)
                for options in (
                    sampled(16),
                    sampled(16, "--sampler", "sobol"),
                    ("--estimator", "exact"),
                )
            ),
        ),
        "floats": (
            "close",
            tuple(
                Strip("close", sampled(64, "--sampler", "sobol"), changes)
                for changes in ({}, far(1e6), far(1e7))
            ),
        ),
        "other-lights": (
            "disk",
            tuple(Strip(name) for name in ("close", "disk", "triangle", "sphere")),
        ),
    }


def lesson(build_dir: Path) -> dict[str, Any]:
    """What lesson.html.j2 finds. Raises OSError, ValueError."""
    texts = {name: read_lesson(TEXTS / f"{name}.md", name) for name in LANGUAGES}
    check_same(texts)
    drawn = pictures()
    renderer = build_dir / "bin" / "penumbra-render"
    steps = []
    for i, step in enumerate(texts["en"].steps):
        if step.anchor not in drawn:
            raise ValueError(f"{TEXTS / 'en.md'}:{step.line}: no picture is made for {step.anchor}")
        scene, strips = drawn[step.anchor]
        steps.append(
            {
                "anchor": step.anchor,
                "said": {name: texts[name].steps[i] for name in LANGUAGES},
                "picture": data_uri(composed(renderer, strips)),
                "cpp": cpp_lines(scene),
            }
        )
    return {
        "opening": data_uri(composed(renderer, OPENING)),
        "steps": steps,
        "said": texts,
        "scenes": {name: scene_of(name) for name in SCENES},
        "cameras": {name: _scene(file)["camera"] for name, file in CAMERAS.items()},
        "size": SIZE,
    }


# ---------------------------------------------------------------- texts


def read_lesson(file: Path, language: str) -> Lesson:
    """Raises OSError, and ValueError that names file and line."""
    markdown = _markdown(language)
    tokens = markdown.parse(file.read_text(encoding="utf-8"))

    def fail(line: int, reason: str) -> ValueError:
        return ValueError(f"{file}:{line}: {reason}")

    def html(part: Sequence[Token]) -> Markup:
        said = markdown.renderer.render(list(part), markdown.options, {})
        said = re.sub(r"(\d) (m|cm)\b", rf"\1{NO_BREAK}\2", said)
        # No line begins with the full stop of a formula.
        unbroken = r'(<math[^>]*display="inline">(?:(?!</math>).)*</math>\u00a0?[.,;:?!)]+)'
        return Markup(re.sub(unbroken, r'<span class="unbroken">\1</span>', said))

    sections = _sections(tokens)
    if not sections or sections[0][0] != 1:
        raise fail(1, "a lesson begins with its title, # ...")
    _, title, line, opening = sections[0]
    if not opening:
        raise fail(line, "a lesson has an introduction")
    steps: list[Step] = []
    rest = sections[1:]
    while rest:
        level, heading, line, text = rest.pop(0)
        named = re.fullmatch(r"(.*\S)\s*\{#([a-z-]+)\}", heading)
        if level != 2 or not named:
            raise fail(line, f"a step begins with ## Title {{#anchor}}, not with {heading}")
        parts: dict[str, Sequence[Token]] = {}
        said = [*text]
        for name in PARTS[language]:
            if not rest or rest[0][:2] != (3, name):
                where = rest[0][2] if rest else line
                raise fail(where, f"step {named[2]} lacks ### {name}, or has it elsewhere")
            _, _, where, parts[name] = rest.pop(0)
            said += parts[name]
            if not parts[name]:
                raise fail(where, f"### {name} of step {named[2]} is empty")
        place, question, figure, answer = parts.values()
        pictured = [t for t in figure[1].children or () if t.type == "image"]
        if len(pictured) != 1 or pictured[0].attrs["src"] != named[2] or len(figure) < 4:
            raise fail(where, f"a figure is ![alt]({named[2]}), a blank line, a caption")
        steps.append(
            Step(
                named[2],
                Markup(markdown.renderInline(named[1])),
                html(text),
                html(place),
                html(question),
                pictured[0].content,
                html(figure[3:]),
                html(answer),
                line,
                tuple(_numbers(said, language)),
            )
        )
    return Lesson(Markup(markdown.renderInline(title)), html(opening), tuple(steps))


def check_same(texts: dict[str, Lesson]) -> None:
    """Raises ValueError unless the languages have the same steps, and say the same numbers in
    each."""
    first, *others = LANGUAGES
    for other in others:
        anchors = [[step.anchor for step in texts[name].steps] for name in (first, other)]
        if anchors[0] != anchors[1]:
            raise ValueError(f"{TEXTS}: steps differ: {first} {anchors[0]}, {other} {anchors[1]}")
        for a, b in zip(texts[first].steps, texts[other].steps, strict=True):
            numbers = [sorted(number for number, _ in step.numbers) for step in (a, b)]
            if numbers[0] == numbers[1]:
                continue
            for name, step, twin in ((first, a, b), (other, b, a)):
                left = [number for number, _ in twin.numbers]
                for number, line in step.numbers:
                    if number not in left:
                        raise ValueError(
                            f"{TEXTS / name}.md:{line}: {number} is said in {name} alone"
                        )
                    left.remove(number)


def _sections(tokens: Sequence[Token]) -> list[tuple[int, str, int, Sequence[Token]]]:
    """Of each heading: level, text, line, and the tokens up to the next."""
    starts = [i for i, token in enumerate(tokens) if token.type == "heading_open"]
    ends = [*starts[1:], len(tokens)]
    return [
        (
            int(tokens[start].tag[1:]),
            tokens[start + 1].content,
            (tokens[start].map or [0])[0] + 1,
            tokens[start + 3 : end],
        )
        for start, end in zip(starts, ends, strict=True)
    ]


def _numbers(tokens: Sequence[Token], language: str) -> list[tuple[str, int]]:
    """What digits are said, as English writes them without separators; not those of code, which is
    in no language."""
    found = []
    for token in tokens:
        if token.type not in ("inline", "math_block"):
            continue
        line = (token.map or [0])[0] + 1
        text = re.sub(r"`[^`]*`|\]\([^)]*\)", " ", token.content).replace("{,}", ",")
        if language == "fr":
            text = re.sub(r"(?<=\d)[\u00a0\u202f](?=\d{3})", "", text)
            text = re.sub(r"(?<=\d),(?=\d)", ".", text)
        else:
            text = re.sub(r"(?<=\d),(?=\d{3})", "", text)
        found += [(number, line) for number in re.findall(r"\d+(?:\.\d+)?", text)]
    return found


def _markdown(language: str) -> MarkdownIt:
    markdown = MarkdownIt("commonmark", {"typographer": False}).enable("table")
    markdown.inline.ruler.before("escape", "math", _math_inline)
    markdown.block.ruler.before("paragraph", "math_block", _math_block)

    def rendered(display: str) -> Any:
        def render(tokens: Sequence[Token], i: int, *_: Any) -> str:
            return mathml(tokens[i].content, display)

        return render

    markdown.renderer.rules["math"] = rendered("inline")  # type: ignore[attr-defined]
    markdown.renderer.rules["math_block"] = rendered("block")  # type: ignore[attr-defined]
    return markdown


def _math_inline(state: StateInline, silent: bool) -> bool:
    found = re.compile(r"\$([^$\n]+)\$").match(state.src, state.pos)
    if not found:
        return False
    if not silent:
        state.push("math", "math", 0).content = found[1]
    state.pos = found.end()
    return True


def _math_block(state: StateBlock, line: int, end: int, silent: bool) -> bool:
    text = state.getLines(line, line + 1, state.blkIndent, False).strip()
    if len(text) < 5 or not (text.startswith("$$") and text.endswith("$$")):
        return False
    if not silent:
        token = state.push("math_block", "math", 0)
        token.content, token.map = text[2:-2], [line, line + 1]
        state.line = line + 1
    return True


def mathml(latex: str, display: str = "inline") -> str:
    """A formula for screen and screen reader: a function's name is one word and applied to what
    follows, a number with a decimal comma (LaTeX: 0{,}5) is one number.

    >>> mathml("0{,}5").split("mrow>")[1]
    '<mn>0,5</mn></'
    """
    text = latex2mathml.converter.convert(latex, display=display)
    comma = r"<mn>(\d+)</mn><mrow><mo>&#x0002C;</mo></mrow><mn>(\d+)</mn>"
    text = re.sub(comma, r"<mn>\1,\2</mn>", text)
    applied = r'\1<mo lspace="0" rspace="0.17em">&#x2061;</mo>'
    return re.sub(rf"(<mi>(?:{FUNCTIONS})</mi>)", applied, text)


# ---------------------------------------------------------------- pictures


def composed(renderer: Path, strips: Sequence[Strip]) -> PillowImage.Image:
    """As the lab saves them, side by side, each the same part of the view: its middle, or about the
    shadow's right edge where it is seen from close by; white lines between.

    Raises OSError; ValueError where the renderer says no.
    """
    width, height = SIZE
    picture = np.zeros((height, width, 3), dtype=np.uint8)
    edges = [round(i * width / len(strips)) for i in range(len(strips) + 1)]
    with tempfile.TemporaryDirectory() as folder:
        scene, image = Path(folder) / "scene.json", Path(folder) / "image.exr"
        for strip, left, right in zip(strips, edges, edges[1:], strict=False):
            changed = scene_of(strip.scene) | strip.changes
            scene.write_text(json.dumps({k: v for k, v in changed.items() if v is not None}))
            command = [str(renderer), str(scene), "-o", str(image), *strip.options]
            command += ["--width", str(width // strip.coarse)]
            command += ["--height", str(height // strip.coarse)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise ValueError(f"{renderer}: {done.stderr.strip()}")
            shown = (np.clip(read_image(image).radiance, 0, 1) * 255).astype(np.uint8)
            shown = shown.repeat(strip.coarse, axis=0).repeat(strip.coarse, axis=1)
            middle = width // 2 if changed["camera"]["fov_y_deg"] > 30 else round(0.78 * width)
            first = min(max(0, middle - (right - left) // 2), width - (right - left))
            picture[:, left:right] = shown[:, first : first + right - left]
            if left:
                picture[:, left - 1 : left + 1] = 255
    return PillowImage.fromarray(picture)


def data_uri(picture: PillowImage.Image) -> str:
    file = io.BytesIO()
    picture.save(file, "WEBP", quality=QUALITY, method=6)
    return f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}"


def cpp_lines(name: str) -> str:
    """What builds a scene of SCENES in the lab's framework."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.json"
        file.write_text(json.dumps(scene_of(name)))
        return cpp_scene(read_scene(file))
