"""One section of the report alone: its data, and a page of it in a browser; what is left in English
on a page in French."""

from __future__ import annotations

import html
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright

from penumbra.language import speaking
from penumbra.report.build import TEMPLATES, Rendered, rendered, spoken
from penumbra.report.inputs import Data, read_inputs
from penumbra.report.sections import SECTIONS, Section, inputs_of
from penumbra.translation import found
from tests.conftest import ROOT

WCAG = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa")
"""What axe calls the rules of WCAG 2.2 AA"""
WORDED = ("penumbra/report/", "penumbra/compare/studies/", "penumbra/compare/measure/", "bench/")
"""Where it stands what the report says"""
INLINE = re.compile(r"</?(?:a|b|code|dfn|em|i|kbd|small|span|sub|sup)\b[^>]*>")


@cache
def texts() -> frozenset[str]:
    """Every text that the report can say, in English."""
    messages = [m for m in found() if any(file.startswith(WORDED) for file, _ in m.locations)]
    return frozenset(m.id if isinstance(m.id, str) else m.id[0] for m in messages)


def words_of(page: str) -> str:
    """What a page says, in its text and in attributes; no code, and no texts of scripts' own."""
    shown = re.sub(r"<(script|style)>.*?</\1>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(INLINE.sub("", shown)).replace('\\"', '"'))


def english_left(page: str) -> list[str]:
    """The pieces of more than three words of texts() that a page says."""
    said = words_of(page)
    pieces = {
        piece.strip()
        for text in texts()
        for piece in re.split(r"%\(\w+\)s|\{[^}]*\}", words_of(text.replace("%%", "%")))
    }
    long = [piece for piece in pieces if len(re.findall(r"[A-Za-z]{2,}", piece)) > 3]
    return sorted(piece for piece in long if piece in said)


def section(name: str) -> Section:
    return next(s for s in SECTIONS if s.name == name)


def data_of(name: str, build_dir: Path) -> Data:
    return read_inputs(inputs_of([section(name)]), build_dir, ROOT / "scenes")


def rendered_section(name: str, build_dir: Path) -> Rendered | None:
    """None: left out."""
    shown = rendered([section(name)], data_of(name, build_dir))
    return shown[0] if shown else None


def barriers(
    page: Page, context: str | None = None, rules: Sequence[str] = WCAG
) -> list[tuple[str, str]]:
    """What axe finds, of the whole page or of a selector: the rule, and the first element that
    breaks it. Where the page's own policy allows no script but its own, it must be bypassed."""
    options = {"runOnly": list(rules), "resultTypes": ["violations"]}
    found = Axe().run(page, context=context, options=options).response["violations"]
    return [(rule["id"], rule["nodes"][0]["html"][:200]) for rule in found]


def assert_french(name: str, folder: Path) -> None:
    """A section of the French page has no English left, and decimal commas."""
    with speaking("fr"):
        shown = rendered_section(name, folder)
    assert shown is not None
    assert english_left(shown.html) == []
    assert len(re.findall(r"\d,\d", shown.html)) > 20


@contextmanager
def browser() -> Iterator[Browser]:
    """Headless Chromium."""
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next((path for path in map(shutil.which, names) if path), None)
    if program is None:
        pytest.fail(f"none of {', '.join(names)} is installed: run ./setup.sh")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=program, args=["--no-sandbox", "--disable-gpu"]
        )
        yield started
        started.close()


@contextmanager
def section_page(name: str, build_dir: Path, folder: Path) -> Iterator[Page]:
    """The section in a page of its own, with every style. Any complaint fails at its end."""
    shown = rendered_section(name, build_dir)
    assert shown is not None
    css = "".join(file.read_text() for file in TEMPLATES.glob("*.css"))
    file = folder / "index.html"
    file.write_text(
        f'<!doctype html><html lang="en"><meta charset="utf-8"><link rel="icon" href="data:,">'
        f"<title>t</title><style>{css}</style><main>{shown.html}</main>"
        f"<script>{spoken(shown.script)}</script><script>{shown.script}</script></html>"
    )
    complaints: list[str] = []
    with browser() as started:
        tab = started.new_page(viewport={"width": 1200, "height": 900})
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("dialog", lambda dialog: (complaints.append("dialog"), dialog.dismiss()))
        tab.goto(file.as_uri())
        yield tab
    assert complaints == []
