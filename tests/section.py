"""One section of the report alone: its data, and a page of it in a browser."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from penumbra.report.build import TEMPLATES, Rendered, rendered, spoken
from penumbra.report.inputs import Data, read_inputs
from penumbra.report.sections import SECTIONS, Section, inputs_of
from tests.conftest import ROOT


def section(name: str) -> Section:
    return next(s for s in SECTIONS if s.name == name)


def data_of(name: str, build_dir: Path) -> Data:
    return read_inputs(inputs_of([section(name)]), build_dir, ROOT / "scenes")


def rendered_section(name: str, build_dir: Path) -> Rendered | None:
    """None: left out."""
    found = rendered([section(name)], data_of(name, build_dir))
    return found[0] if found else None


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
