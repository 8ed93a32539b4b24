"""From the pipeline's files to one offline HTML page."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import VERSION
from penumbra.language import _, language
from penumbra.report.header import INPUTS as HEADER_INPUTS
from penumbra.report.header import header
from penumbra.report.inputs import Data, Input, ReportError, read_inputs, unusable
from penumbra.report.pictures import ENLARGED
from penumbra.report.sections import SECTIONS, Section, inputs_of

TEMPLATES = Path(__file__).resolve().parent / "template"


def build(build_dir: Path, out: Path, scenes_dir: Path) -> None:
    """Write the page `out`, in the language that is spoken, from the files of SECTIONS' inputs in
    build_dir.

    Raises ReportError for an input that is missing or unusable (naming it and the command
    that makes it), SceneError, and OSError if `out` cannot be written.
    """
    data = read_inputs(inputs_of(SECTIONS), build_dir, scenes_dir)
    styles = ("page.css", *(f"{s.name}.css" for s in SECTIONS))
    template = environment().get_template("page.html.j2")
    html = template.render(
        header=_built(header, HEADER_INPUTS, data),
        sections=(shown := rendered(SECTIONS, data)),
        words=spoken(*(s.script for s in shown)),
        css=Markup("").join(map(asset, styles)),
    )
    write_whole(out, lambda part: part.write_text(html, encoding="utf-8"))


@dataclass(frozen=True)
class Rendered:
    """A section as the page holds it."""

    name: str
    title: str
    html: Markup
    script: Markup


def rendered(sections: Sequence[Section], data: Data) -> list[Rendered]:
    """Those sections whose inputs are there. Raises ReportError for an input that lacks
    something."""
    templates = environment()

    def html(s: Section) -> Markup:
        template = templates.get_template(f"{s.name}.html.j2")
        return Markup(template.render({s.name: _built(s.build, s.inputs, data)}))

    there = [s for s in sections if _is_there(s, data)]
    return [Rendered(s.name, _(s.title), html(s), asset(f"{s.name}.js")) for s in there]


def _is_there(section: Section, data: Data) -> bool:
    """Whether to show it. Raises ReportError if but a part of what it needs is there."""
    missing = [i for i in section.inputs if i.needed and not data.has(i)]
    if section.optional and len(missing) == len(section.inputs):
        return False
    for item in missing:
        raise unusable(item, data.build_dir, "no such file")
    return True


def _built(
    build: Callable[[Data], dict[str, Any]], inputs: Sequence[Input], data: Data
) -> dict[str, Any]:
    try:
        return build(data)
    except (LookupError, TypeError, ValueError, OSError) as error:
        reason = repr(error) if isinstance(error, LookupError | TypeError) else str(error)
        if len({i.command for i in inputs}) == 1:
            what, how = str(inputs[0].path(data.build_dir)), f"make it with: {inputs[0].command}"
        else:
            what = "an input lacks what the page needs"
            how = "`make clean` and `make report` make all of them anew"
        raise ReportError(f"{what}: {reason}; {how}") from error


def environment() -> jinja2.Environment:
    """That of every page, in the language that is spoken when it is filled."""
    templates = jinja2.Environment(
        autoescape=True,
        extensions=["jinja2.ext.i18n"],
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.globals |= {
        "version": VERSION, "enlarged": ENLARGED, "gettext": _, "language": language,
    }  # fmt: skip
    return templates


def spoken(*scripts: str) -> Markup:
    """What these scripts say, in the language that is spoken, and how: a script before them."""
    said = dict.fromkeys(re.findall(r'\bsay\("([^"]+)"', "".join(scripts)))
    words = htmlsafe_json_dumps({text: _(text) for text in said}, ensure_ascii=False)
    return Markup("const WORDS = {};\n").format(words) + asset("words.js")


def asset(name: str) -> Markup:
    """A style or script; nothing where there is none."""
    file = TEMPLATES / name
    return Markup(file.read_text() if file.is_file() else "")
