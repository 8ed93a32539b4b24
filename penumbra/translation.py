"""What is translated, for those who translate: `make words`. docs/translating.md explains it.

The texts of code, templates, scripts and the catalogue of mistakes are gathered into the .po file,
which holds their French. Lesson, handouts and README are whole files a language: which of their
sections say the same is noted in agreed.json. Needs Babel, which nobody does who only uses
Penumbra.
"""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from hashlib import sha256
from html import unescape
from pathlib import Path
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
HEADING = re.compile(r"#{1,6} |=+ ")
ANCHOR = re.compile(r"\{#([\w-]+)\}")
AGREED = LOCALE / "fr" / "agreed.json"
CHANCE = re.compile(rb'^"(?!Language:|Plural|MIME|Content)[A-Z][A-Za-z-]+:.*\n', re.M)
"""Lines of the header that would say nothing, or something else each time"""
ALIKE = 0.85
"""Texts that differ by less are thought to be one, reworded"""
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
    """Bring the .po file up to date: texts that are gone leave; a new one comes without French, or,
    if one that is gone is much like it, with the French of that, marked `fuzzy`."""
    whole = translated()
    whole.update(found(), no_fuzzy_matching=True)
    gone = {str(message.id): message.string for message in whole.obsolete.values()}
    for message in whole:
        for like in (
            get_close_matches(str(message.id), gone, 1, ALIKE) if not message.string else ()
        ):
            message.string = gone[like]
            message.flags.add("fuzzy")
    whole.header_comment = "# What Penumbra says in French: docs/translating.md."
    text = io.BytesIO()
    write_po(text, whole, width=0, sort_by_file=True, ignore_obsolete=True, include_lineno=False)
    header, _, entries = text.getvalue().partition(b"\n\n")
    PO.write_bytes(CHANCE.sub(b"", header) + b"\n\n" + entries)


# ---------------------------------------------------------------- whole texts


@dataclass(frozen=True)
class Pair:
    """A text that is a file a language."""

    english: Path
    french: Path

    @property
    def name(self) -> str:
        return str(self.french.relative_to(ROOT))

    def sections(self) -> dict[str, tuple[str, str]]:
        """The English and the French of each, by its anchor or number. Raises ValueError where they
        do not have the same ones."""
        english, french = (
            sections(file.read_text("utf-8")) for file in (self.english, self.french)
        )
        if list(english) != list(french):
            raise ValueError(
                f"{self.english} has the sections {', '.join(english)}, "
                f"{self.french} {', '.join(french)}"
            )
        return {name: (english[name], french[name]) for name in english}


def pairs() -> list[Pair]:
    """All that there are."""
    files = [
        (ROOT / "README.md", ROOT / "README.fr.md"),
        (ROOT / "penumbra/course/lesson/en.md", ROOT / "penumbra/course/lesson/fr.md"),
    ]
    for english in sorted((ROOT / "penumbra/course/handout").glob("*-en.typ")):
        files.append((english, english.with_name(english.name.replace("-en.", "-fr."))))
    return [Pair(*both) for both in files if all(file.is_file() for file in both)]


def sections(text: str) -> dict[str, str]:
    """What stands under each heading of Markdown or Typst, by the heading's {#anchor}, else by its
    number; what comes before is 0.

    >>> list(sections("# A\\na\\n## B {#b}\\nb"))
    ['0', '1', 'b']
    """
    found = {"0": ""}
    fenced = False
    for line in text.splitlines(keepends=True):
        fenced ^= line.startswith("```")
        if HEADING.match(line) and not fenced:
            anchor = ANCHOR.search(line)
            found[anchor[1] if anchor else str(len(found))] = ""
        found[next(reversed(found))] += line
    return found


def agreed() -> dict[str, dict[str, str]]:
    """Of each pair's sections, digests of the English and the French that say the same."""
    return dict(json.loads(AGREED.read_text())) if AGREED.is_file() else {}


def digests(english: str, french: str) -> str:
    """Of a section's words, however they are broken into lines."""
    return " ".join(
        sha256(" ".join(text.split()).encode()).hexdigest()[:12] for text in (english, french)
    )


def stale(name: str, english: str, french: str, known: str | None) -> str:
    """What is wrong with a section, whose digests were `known`; nothing if all is well."""
    now = digests(english, french)
    if now == known:
        return ""
    if _both_changed(now, known):
        return f"{name}: new in both languages: `make words` notes that they agree"
    changed, other = "English", "French"
    if now.split()[0] == str(known).split()[0]:
        changed, other = other, changed
    return (
        f"{name}: the {changed} has changed and the {other} has not: change it too, then "
        f"`make words`; or, if it still says the same, `make words SAME={name}`"
    )


def _both_changed(now: str, known: str | None) -> bool:
    return known is None or all(a != b for a, b in zip(now.split(), known.split(), strict=True))


def agree(same: Sequence[str] = ()) -> None:
    """Note that sections agree of which both languages have changed, and those named."""
    before = agreed()
    now: dict[str, dict[str, str]] = {}
    for pair in pairs():
        now[pair.name] = {}
        for section, (english, french) in pair.sections().items():
            name, known = f"{pair.name}#{section}", before.get(pair.name, {}).get(section)
            found = digests(english, french)
            renewed = known is None or _both_changed(found, known) or name in same
            now[pair.name][section] = found if renewed else str(known)
    AGREED.write_text(json.dumps(now, indent=1) + "\n")


if __name__ == "__main__":
    update()
    agree(sys.argv[1:])
