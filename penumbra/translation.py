"""What is translated, for those who translate: `make words`. docs/translating.md explains it.

The texts of code, templates, scripts and the catalogue of mistakes are gathered into the .po file,
which holds their French. Needs Babel, as making the .mo file of it does, and nobody who only uses
Penumbra.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from html import unescape
from typing import Any, TypeAlias

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po, write_po
from jinja2.ext import babel_extract

from penumbra.compare.check.catalogue import TEXTS, catalogue
from penumbra.language import LOCALE

ROOT = LOCALE.parent.parent
FOLDERS = ("penumbra", "bench")
PO = LOCALE / "fr" / "LC_MESSAGES" / "penumbra.po"
CATALOGUE = "c_renderer/mistakes/catalogue.def"
KEYWORDS: dict[str, Any] = dict.fromkeys(("_", "N_", "say", "both", "gettext"))
METHODS = [
    ("**.py", "python"),
    ("**/template/**.js", "javascript"),
    ("**/template/**.j2", "penumbra.translation:of_template"),
]
LABEL = re.compile(r'\bdata-label="([^"{]+)"')
"""Of a template, which a script translates (course/template/language.js)"""
Message: TypeAlias = tuple[int, str | None, Any, list[str]]


def of_template(
    stream: io.BufferedIOBase, keywords: Any, comment_tags: Any, options: dict[str, Any]
) -> Iterator[Message]:
    """Babel's extractor of a page's template: what it says, and its labels."""
    data = stream.read()
    yield from babel_extract(io.BytesIO(data), keywords, comment_tags, options)
    for label in LABEL.findall(data.decode()):
        yield 1, None, unescape(label), []


def found() -> Catalog:
    """All texts, without their French."""
    texts = Catalog(locale="fr", project="Penumbra", fuzzy=False)
    for folder in FOLDERS:
        for file, _line, text, _comments, _context in extract_from_dir(
            ROOT / folder, METHODS, {"**.j2": {"silent": "false"}}, KEYWORDS
        ):
            texts.add(text, locations=[(f"{folder}/{file}", 0)])
    for mistake in catalogue().mistakes.values():
        for field in TEXTS:
            texts.add(getattr(mistake, field), locations=[(CATALOGUE, 0)])
    return texts


def translated() -> Catalog:
    """The .po file."""
    with PO.open("rb") as stream:
        return read_po(stream, locale="fr")


def update() -> None:
    """Bring the .po file up to date: texts that are gone leave, new ones come without French, or
    marked `fuzzy` with that of one much like it."""
    whole = translated()
    whole.update(found())
    with PO.open("wb") as stream:
        write_po(stream, whole, width=0, sort_by_file=True, ignore_obsolete=True,
                 include_lineno=False, omit_header=False)  # fmt: skip


if __name__ == "__main__":
    update()
