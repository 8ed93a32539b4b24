"""The lesson's page: one offline file in two languages, the C core in it."""

from __future__ import annotations

import base64
import gzip
import html as escapes
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import VERSION
from penumbra.course.drop import drop
from penumbra.course.handout import handouts
from penumbra.course.lesson import lesson
from penumbra.course.museum import museum
from penumbra.language import LANGUAGES, _, speaking

TEMPLATES = Path(__file__).resolve().parent / "template"
SCRIPTS = ("language.js", "core.js", "figure.js", "lesson.js", "museum.js", "drop.js")
"""In this order, all in one scope; worker.js is what their workers run"""


@dataclass(frozen=True)
class Part:
    name: str
    """its anchor, and its files in template/: NAME.html.j2, and NAME.css and NAME.js if any"""
    build: Callable[[Path], dict[str, Any]]
    """makes from the build folder what its template finds under the part's name"""


PARTS = (
    Part("lesson", lesson),
    Part("museum", museum),
    Part("drop", drop),
    Part("handouts", handouts),
)


def write_page(build_dir: Path, out: Path) -> None:
    """build_dir has wasm/core.wasm and wasm/mistakes.wasm. Raises OSError, and ValueError for a
    lesson that lacks something."""
    templates = environment()
    parts = {
        part.name: Markup(
            templates.get_template(f"{part.name}.html.j2").render(
                {part.name: part.build(build_dir)}
            )
        )
        for part in PARTS
    }
    scripts = [asset(name) for name in SCRIPTS]
    html = templates.get_template("index.html.j2").render(
        parts=parts,
        css=Markup("").join(asset(f"{name}.css") for name in ("index", *(p.name for p in PARTS))),
        scripts=scripts,
        messages=messages(Markup("").join([*parts.values(), *scripts])),
        worker=asset("worker.js"),
        modules={
            name: packed((build_dir / "wasm" / f"{name}.wasm").read_bytes())
            for name in ("core", "mistakes")
        },
    )
    write_whole(out, lambda part: part.write_text(html, encoding="utf-8"))


def environment() -> jinja2.Environment:
    templates = jinja2.Environment(
        autoescape=True,
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.globals |= {"version": VERSION, "both": both, "json": embedded}
    return templates


def both(text: str) -> Markup:
    """A text in both languages, of which the page shows one."""
    said = []
    for chosen in LANGUAGES:
        with speaking(chosen):
            said.append(Markup('<span lang="{}">{}</span>').format(chosen, _(text)))
    return Markup("").join(said)


SAID = re.compile(r"""\bsay\(\s*("(?:[^"\\]|\\.)*")|\bdata-label="([^"]*)\"""")
"""A text of a script, a literal of JavaScript and so of JSON; a label of a template"""


def messages(page: str) -> dict[str, str]:
    """The French of what scripts say and of the labels that they set; where there is none yet, they
    find none, and say the English."""
    texts = {
        json.loads(literal) if literal else escapes.unescape(label)
        for literal, label in SAID.findall(page)
    }
    with speaking("fr"):
        return {text: french for text in sorted(texts) if (french := _(text)) != text}


def packed(data: bytes) -> str:
    """Base64 of gzip, as DecompressionStream reads it; the same bytes every time."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


def embedded(value: Any) -> Markup:
    """JSON for a <script type="application/json">."""
    return Markup(json.dumps(value, ensure_ascii=False).replace("<", "\\u003c"))


def asset(name: str) -> Markup:
    """A style or script; nothing where there is none."""
    file = TEMPLATES / name
    return Markup(file.read_text(encoding="utf-8") if file.is_file() else "")
