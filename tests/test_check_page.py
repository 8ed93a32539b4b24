"""The page of `penumbra check`: says what the terminal says and no more, offline, on any screen.

Pictures are made by the library of mistakes, of the lab's scene in a small size; which verdict they
get is other tests' business, so where a page needs one that pictures seldom get, it is put in.
"""

from __future__ import annotations

import html as escapes
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Dialog, Page

from penumbra.compare.check import explanation
from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.checking import Checked, check, verdict_json
from penumbra.compare.check.diagnosis import FreeLight
from penumbra.compare.check.expected import mistaken_picture, right_picture, unexplained
from penumbra.compare.check.explanation import observations
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.mistaken import render
from penumbra.compare.check.verdict import UNKNOWN
from penumbra.compare.check.view import lead_of
from penumbra.compare.check.words import WORDS
from penumbra.compare.exact.image import shade
from penumbra.compare.scene import read_scene
from penumbra.report.check_page import write_page
from tests import section
from tests.conftest import ROOT, built

SCENE = ROOT / "scenes" / "tp3.json"
SHAPE = 160, 240
WRONG = Variant(weight="no_light_cosine")
MARKS = {"right": "✓", "wrong": "✕", "cannot tell": "?"}
HOSTILE = "<b onclick=alert(1)>&'n016.png"


def picture(file: Path, variant: Variant, n: int, seed: int = 1, **grid: float) -> Path:
    """As the lab writes it."""
    given = {"position": (0.5, 0.5)} | grid
    radiance = render(SCENE, variant, SHAPE, n, 1, seed, **given)  # type: ignore[arg-type]
    Image.fromarray((np.clip(radiance, 0, 1) * 255).astype(np.uint8)).save(file)
    return file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    built("lib/libmistakes.so")
    return tmp_path_factory.mktemp("check")


@pytest.fixture(scope="module")
def right(folder: Path) -> Checked:
    return check([picture(folder / "right_n016.png", Variant(), 16)], SCENE)


@pytest.fixture(scope="module")
def wrong(folder: Path) -> Checked:
    files = [picture(folder / HOSTILE, WRONG, 16), picture(folder / "n064.png", WRONG, 64, 2)]
    return check(files, SCENE)


@pytest.fixture(scope="module")
def unknown(folder: Path) -> Checked:
    """Samples on one diagonal, as though the catalogue had no such entry."""
    checked = check([picture(folder / "odd_n016.png", Variant(domain="diagonal"), 16)], SCENE)
    strange = replace(checked.verdict, verdict="wrong", mistakes=(UNKNOWN,), loose=0.05,
                      perhaps=WRONG.mistakes, alike=(), several=False)  # fmt: skip
    light = checked.diagnosis.light or _some_light()
    return replace(checked, verdict=strange, diagnosis=replace(checked.diagnosis, light=light))


def _some_light() -> FreeLight:
    along = np.linspace(0, 1, 5)
    return FreeLight(1.0, np.stack([along, along], axis=1), np.ones(5), 1.0)


@pytest.fixture(scope="module")
def undecided(right: Checked) -> Checked:
    settle = (WORDS["settle_n"], WORDS["settle_scene"].format(scene="tp3_sheared.json"))
    return replace(right, verdict=replace(right.verdict, verdict="cannot tell", settle=settle))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


def html_of(folder: Path, checked: Checked, hint: int = 3) -> str:
    file = folder / "page.html"
    write_page(file, checked, hint)
    return file.read_text()


def opened(browser: Browser, file: Path, width: int, complaints: list[str]) -> Page:
    tab = browser.new_page(viewport={"width": width, "height": 900})
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))

    def dismiss(dialog: Dialog) -> None:
        complaints.append("dialog")
        dialog.dismiss()

    tab.on("dialog", dismiss)
    own = ("data:", "blob:", file.as_uri())
    tab.on("request", lambda r: None if r.url.startswith(own) else complaints.append(r.url[:80]))
    tab.goto(file.as_uri())
    tab.locator("#comparer[data-drawn]:not([data-drawn='0'])").wait_for()
    return tab


@pytest.mark.parametrize("name", ["right", "wrong", "unknown", "undecided"])
def test_page_is_whole_offline_and_fits_phone_and_desk(
    name: str, folder: Path, browser: Browser, request: pytest.FixtureRequest
) -> None:
    checked: Checked = request.getfixturevalue(name)
    html_of(folder, checked)
    complaints: list[str] = []
    for width in (1280, 390):
        tab = opened(browser, folder / "page.html", width, complaints)
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        assert section.barriers(tab) == []
        headline = tab.inner_text("h1")
        assert WORDS[checked.verdict.verdict] in headline
        assert headline[0] == MARKS[checked.verdict.verdict]
        assert tab.locator("#comparer select").first.locator("option").count() == (
            3 if checked.verdict.verdict == "wrong" else 2
        )
        tab.close()
    assert complaints == []
    assert (folder / "page.html").stat().st_size < 3e6


def test_wrong_is_explained_in_four_parts(folder: Path, wrong: Checked) -> None:
    """Observed, cause, formula and the handout's step, how to see it; then what else it may be."""
    assert wrong.verdict.mistakes == WRONG.mistakes
    said = _plain(html_of(folder, wrong))
    mistake = catalogue().mistakes[wrong.verdict.mistakes[0]]
    for text in (*observations(wrong.verdict), mistake.title, mistake.cause, mistake.wrong,
                 mistake.right, mistake.step, mistake.look, wrong.verdict.command):  # fmt: skip
        assert _plain(text) in said, text
    for names, _ in wrong.verdict.runners_up:
        assert all(_plain(catalogue().mistakes[n].title) in said for n in names)
    for view in wrong.diagnosis.views:
        assert Path(view.picture.name).name in said


def test_unknown_says_so_and_draws_where_the_light_seems_to_be(
    folder: Path, unknown: Checked
) -> None:
    html = html_of(folder, unknown)
    assert "Not in the catalogue" in html
    assert catalogue().mistakes[WRONG.mistakes[0]].title in _plain(html)
    assert "<svg" in html[html.index('id="light"') :]


@pytest.mark.parametrize("hint", [0, 1, 2])
def test_a_lower_hint_hides_what_the_terminal_hides(
    hint: int, folder: Path, wrong: Checked
) -> None:
    """0: no more than the verdict; 1: no name, nor a picture or number that gives it away; 2: no
    formula."""
    html = html_of(folder, wrong, hint)
    said, found = _plain(html), wrong.verdict
    mistake = catalogue().mistakes[found.mistakes[0]]
    assert ("#comparer" in html and 'id="comparer"' in html) == (hint >= 1)
    assert (mistake.title in said) == (mistake.cause in said) == (hint >= 2)
    assert (mistake.step in said) == (hint >= 1)
    assert _plain(mistake.wrong) not in said and mistake.look not in said
    assert 'id="unexplained"' not in html and "odds" not in said
    assert ("with the mistake" in html) == (hint >= 2)
    for text in observations(found):
        assert (_plain(text) in said) == (hint >= 2)
    if hint < 2:
        assert not [m.title for m in catalogue().mistakes.values() if m.title in said]
        assert mistake.name not in html


@pytest.mark.parametrize("hint", range(4))
def test_a_verdict_links_to_the_museum_where_it_names_the_mistake(
    hint: int, folder: Path, wrong: Checked
) -> None:
    """Page, text and JSON, if it is known where the course is."""
    course = "https://example.org/course/"
    (name,) = wrong.verdict.mistakes
    link = f"{course}#mistake-{name}"
    file = folder / "linked.html"
    write_page(file, wrong, hint, course)
    said = explanation.text(wrong.verdict, hint, course)
    found = verdict_json(wrong, hint, course)
    assert (f'href="{link}"' in file.read_text()) == (link in said.split()) == (hint >= 2)
    shown = {n: f"{course}#mistake-{n}" for n in (name, *wrong.verdict.perhaps)}
    assert found.get("exhibits") == (shown if hint >= 2 else None)
    if hint < 2:
        assert name not in said + file.read_text() + str(found)
    assert "mistake-" not in html_of(folder, wrong, hint) + explanation.text(wrong.verdict, hint)


def test_who_is_not_accused_is_not_named(folder: Path, wrong: Checked) -> None:
    """Not by what the map is held against either."""
    held = replace(wrong.verdict, verdict="cannot tell", mistakes=(), alike=(), runners_up=())
    said = _plain(html_of(folder, replace(wrong, verdict=held)))
    assert catalogue().mistakes[WRONG.mistakes[0]].title not in said


def test_hostile_names_are_shown_and_not_run(
    folder: Path, wrong: Checked, browser: Browser
) -> None:
    html = html_of(folder, wrong)
    assert "<b onclick" not in html
    complaints: list[str] = []
    tab = opened(browser, folder / "page.html", 1280, complaints)
    assert HOSTILE in tab.inner_text("header table")
    assert HOSTILE in tab.inner_text('#comparer [data-part="label-a"]')
    tab.close()
    assert complaints == []


def test_expected_pictures_go_through_the_students_own_rays() -> None:
    """Flips, shifts, another camera and place in the pixel: at N = 4096 the renderer's picture is
    the exact one but for silhouettes (another side of the edge at 1 pixel in 500) and noise (a
    penumbra's 0.5 / 64 at most, times 5)."""
    built("lib/libmistakes.so")
    grids = [
        Grid(60.0, 0.0),
        Grid(60.0, divisor=1, flip_x=True, shift_x=2.0),
        Grid(70.0, flip_y=True, shift_y=-1.5, aspect=1.2),
        Grid(60.0, moved=-2.0, cut=50.0),
    ]
    scene = read_scene(SCENE)
    shape = 60, 90
    for grid in grids:
        row, column = (a.ravel() for a in np.mgrid[0 : shape[0], 0 : shape[1]])
        exact = shade(scene, grid.hits(scene, column, row, shape[1], shape[0]))[0]
        shown = render(SCENE, Variant(), shape, 4096, 1, 1, grid=grid).reshape(-1, 3)
        off = np.abs(np.minimum(shown, 1) - np.minimum(exact, 1)).max(axis=1)
        assert np.mean(off > 5 * 0.5 / 64) < 1 / 500, grid


def test_right_picture_and_map_agree_with_a_right_renderer(right: Checked) -> None:
    lead = lead_of(right.diagnosis.views)
    exact = right_picture(lead)
    assert np.abs(exact - lead.picture.values).mean() < 0.01
    excess = unexplained(lead, SCENE, Variant())
    there = excess[np.isfinite(excess)]
    assert len(there) > 0.4 * excess.size
    assert np.mean(np.abs(there) > 3) < 0.02
    brighter = mistaken_picture(lead, SCENE, WRONG) - exact  # on the floor, where it is not white
    assert brighter[(exact > 0.1) & (exact < 0.4) & (exact != 0.5)].mean() > 0.02


def _plain(page: str) -> str:
    """Its text as the reader sees it."""
    text = re.sub(r"<(script|style)[\s\S]*?</\1>|<[^>]*>", "", page) if "<html" in page else page
    return " ".join(escapes.unescape(text).split())
