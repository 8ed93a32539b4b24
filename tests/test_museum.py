"""The museum of mistakes: an exhibit for each of the catalogue, what it says is so, and its switch
works; every verdict's link leads to one."""

from __future__ import annotations

import base64
import html as escapes
import io
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.explanation import exhibits
from penumbra.compare.exact.image import exact_image
from penumbra.compare.scene import Plane, read_scene
from penumbra.course.museum import GROUPS, PARTS, _made, as_saved, group_of, picture
from penumbra.language import LANGUAGES
from tests import section
from tests.conftest import ROOT

MISTAKES = tuple(catalogue().mistakes)
LIMIT = 500_000
"""Bytes of all pictures, as base64"""
SHAPE, SEEDS = (100, 150), range(100, 104)
"""Of the pictures by which the shown ratios are held against the exact image"""
SHARP = 0.04
"""Of a ratio: parts told by 64 samples, against those of the closed form in other pixels"""
STEEP, EDGE = ("loop_left_early", "one_hidden_hides_all", "divided_by_visible_count"), 0.08
"""The same of what changes most where the penumbra ends"""
ROUGH = 0.9
"""Share from which a place on a ball is lit: without shadows, light has noise at its terminator"""
HALF_SEEN = 1 - 0.5 ** (1 / 64)
"""A share of the light that 64 samples tell from none in one of two cases"""
PATIENCE = 30_000  # [ms] for a frame, on a machine with other work
PIXELS = "() => document.getElementById('museum-canvas').toDataURL()"


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    """What was rendered and measured"""
    return _made(ROOT / "build" / "museum.json")


@pytest.fixture(scope="module")
def html(course_page: Path) -> str:
    """The museum's part of the page"""
    (found,) = re.findall(r'<article id="museum"[\s\S]*?</article>', course_page.read_text())
    return str(found)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


@pytest.fixture
def opened(course_page: Path, browser: Browser) -> Iterator[Callable[..., Page]]:
    """opened(hash, language, width, ...) is a tab with the page; any complaint fails at the end."""
    complaints: list[str] = []
    contexts = []

    def open_(fragment: str = "", language: str = "en", width: int = 1280, **context: Any) -> Page:
        contexts.append(browser.new_context(viewport={"width": width, "height": 900}, **context))
        tab = contexts[-1].new_page()
        tab.set_default_timeout(PATIENCE)
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(f"{course_page.as_uri()}?lang={language}{fragment}")
        return tab

    yield open_
    for context in contexts:
        context.close()
    assert complaints == []


def settled(tab: Page) -> list[str]:
    """Once the picture is measured: the column of what is measured now, its head first."""
    tab.wait_for_selector("#museum-live[data-measured]")
    return tab.locator(".exhibit:has(#museum-live) .measured .now").all_inner_texts()


def act(tab: Page, name: str, value: str | int | None = None) -> list[str]:
    """A control of the live renderer is set, or clicked; what is measured then."""
    tab.evaluate("delete document.getElementById('museum-live').dataset.measured")
    if value is None:
        tab.click(f"#museum-{name}")
    else:
        tab.evaluate(
            """([id, value]) => { const e = document.getElementById(id); e.value = value;
               e.dispatchEvent(new Event("input")); }""",
            [f"museum-{name}", str(value)],
        )
    return settled(tab)


def number(text: str) -> float:
    return float(re.sub(r"[^\d.]", "", text.replace(",", ".")) or "nan")


# ---------------------------------------------------------------- what is there


def test_every_mistake_has_an_exhibit_with_all_that_is_said_of_it(html: str) -> None:
    """In both languages: title, cause, both formulas, place, question; a picture with its text."""
    cards = re.findall(r'<details class="exhibit"[\s\S]*?<div class="body" id="([^"]*)"', html)
    assert sorted(cards) == sorted(m.anchor for m in catalogue().mistakes.values())
    assert all(html.count(f'id="{anchor}"') == 1 for anchor in cards)
    for name, mistake in catalogue().mistakes.items():
        card = next(c for c in html.split('<details class="exhibit"')[1:] if f'"{name}"' in c)
        said = escapes.unescape(card).lower()
        for text in (mistake.title, mistake.cause, mistake.wrong, mistake.right, mistake.step,
                     mistake.look):  # fmt: skip
            assert f'<span lang="en">{text.lower()}</span>' in said, text
            assert said.count('<span lang="fr">') == said.count('<span lang="en">')
        (image,) = re.findall(r'<img [^>]*width="300"[^>]*>', card)
        for language in LANGUAGES:
            (alt,) = re.findall(f'data-alt-{language}="([^"]+)"', image)
            assert len(alt) > 40
        assert re.search(r"alt=\"[^\"]+\"", image) and "data:image/webp;base64," in image
        seen = mistake.seen and ("in most of 27" if mistake.usual else f"in {mistake.seen} of 27")
        assert seen in card if seen else "of 27" not in card


def test_exhibits_stand_by_the_handouts_places_the_commonest_first(html: str) -> None:
    assert re.findall(r'data-group="(\w+)"', html) == list(GROUPS)
    for part in html.split('<section class="group"')[1:]:
        (group,) = re.findall(r'data-group="(\w+)"', part)
        names = re.findall(r'data-name="(\w+)"', part)
        assert names and {group_of(catalogue().mistakes[n]) for n in names} == {group}
        seen = [catalogue().mistakes[n].seen for n in names]
        assert seen == sorted(seen, reverse=True)


def test_all_pictures_together_are_small(html: str) -> None:
    assert sum(map(len, re.findall(r'src="data:image/webp;base64,([^"]*)"', html))) < LIMIT


def test_pictures_differ_from_the_right_ones_unless_it_is_said(
    made: dict[str, Any],
) -> None:
    """Clearly (by 16 levels) at 20 pixels and more, or by no more than WebP does."""
    for name, exhibit in made["exhibits"].items():
        right, shown = pixels(made["rights"][exhibit["scene"]]), pixels(exhibit["picture"])
        clear = int((np.abs(right - shown).max(axis=2) > 16).sum())
        assert (clear < 20) == exhibit["hidden"], (name, clear)
        elsewhere = exhibit["scene"] != "tp3_statement"
        assert not (elsewhere and exhibit["hidden"])
    scenes = {name: exhibit["scene"] for name, exhibit in made["exhibits"].items()}
    assert scenes["area_by_norms"] == "tp3_sheared"
    assert scenes["divided_inside_light_loop"] == "tp3_two_quads"


def pixels(uri: str) -> np.ndarray:
    data = base64.b64decode(uri.partition(",")[2])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=int)


def test_shown_ratios_are_those_to_the_exact_image(made: dict[str, Any], tmp_path: Path) -> None:
    """Of the form that is shown first, in other pixels, by other random numbers, against the closed
    form, which tells the parts too."""
    found, stages = [], {}
    for name, scene in made["scenes"].items():
        file = tmp_path / f"{name}.json"
        file.write_text(json.dumps(scene))
        read = read_scene(file)
        exact = exact_image(read, SHAPE[1], SHAPE[0])
        planes = [i for i, thing in enumerate(read.objects) if isinstance(thing, Plane)]
        floor = np.isin(exact.object_id, planes)
        whole = picture(file, Variant(visibility="none"), SHAPE, 1024, 1, 0).sum(axis=2)
        there = (exact.object_id >= 0) & (whole > 0)
        share = np.where(there, exact.radiance.sum(axis=2) / np.maximum(whole, 1e-9), 0)
        lit, seen = share > 1 - HALF_SEEN, share > HALF_SEEN
        ball = there & ~floor & (share > ROUGH)
        masks = {"floor": floor & lit, "sphere": ball, "penumbra": seen & ~lit & ~ball}
        stages[name] = file, exact.radiance, masks
    for name, exhibit in made["exhibits"].items():
        file, right, masks = stages[exhibit["scene"]]
        form = exhibit["forms"][exhibit["chosen"]]
        variant = Variant(**{form["module"]: form["name"]})
        alone = Variant() if form["module"] == "generator" else variant
        counts = exhibit["n"], exhibit["m"]
        made_up = np.stack([picture(file, alone, SHAPE, *counts, s) for s in SEEDS]).sum(axis=3)
        usual = right.sum(axis=2)
        if as_saved(variant):
            made_up, usual = np.clip(made_up, 0, 1), np.clip(usual, 0, 1)
        for part in PARTS:
            each = made_up[:, masks[part]].sum(axis=1) / usual[masks[part]].sum()
            error = each.std(ddof=1) / np.sqrt(len(each))
            sharp = EDGE if part == "penumbra" and name in STEEP else SHARP
            allowed = sharp * max(form[part], 0.1) + 5 * error
            if abs(each.mean() - form[part]) >= allowed:
                found.append((name, part, float(each.mean()), form[part]))
    assert not found


# ---------------------------------------------------------------- the switch


def test_the_switch_changes_the_picture_and_what_is_measured(
    opened: Callable[..., Page], made: dict[str, Any]
) -> None:
    """On: the library's numbers, by the page's own measurement. Off: right. Half: each its half."""
    tab = opened("#mistake-normal_not_normalised")
    on = settled(tab)
    assert [number(text) for text in on[1:4]] == [4, 4, 4] and number(on[5]) == 16
    wrong = tab.evaluate(PIXELS)
    off = act(tab, "mistake")
    right = tab.evaluate(PIXELS)
    assert right != wrong and off[0] != on[0]
    assert [number(text) for text in off[1:4]] == [1, 1, 1]
    act(tab, "mistake")
    assert tab.evaluate(PIXELS) == wrong
    act(tab, "half")
    both = tab.evaluate(PIXELS)
    assert both not in (wrong, right)
    columns = [picture_of(uri) for uri in (wrong, right, both)]
    middle = columns[0].shape[1] // 2
    assert (columns[2][:, :middle] == columns[0][:, :middle]).all()
    assert (columns[2][:, middle:] == columns[1][:, middle:]).all()


def picture_of(uri: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


@pytest.mark.parametrize("name", ["n_no_effect", "shadow_offset_too_big", "only_one_light",
                                  "clamp_before_pixel_average", "no_output_clamp"])  # fmt: skip
def test_what_the_page_measures_is_what_was_measured(
    name: str, opened: Callable[..., Page], made: dict[str, Any]
) -> None:
    """Of two pictures of 300 x 200 where six of 180 x 120 were looked at: ratios to 4%, noise to
    30%; and N changes what it should."""
    tab = opened(f"#mistake-{name}")
    exhibit = made["exhibits"][name]
    form = exhibit["forms"][exhibit["chosen"]]
    found = settled(tab)
    for part, text in zip(PARTS, found[1:4], strict=True):
        assert number(text) == pytest.approx(form[part], rel=0.04), part
    assert number(found[5]) == pytest.approx(form["effective_samples"], rel=0.3)
    if name == "n_no_effect":
        assert number(act(tab, "n", 6)[5]) == pytest.approx(1, rel=0.3)
        act(tab, "mistake")
        assert number(act(tab, "n", 6)[5]) == pytest.approx(64, rel=0.01)


def test_each_form_and_scene_can_be_chosen(opened: Callable[..., Page]) -> None:
    tab = opened("#mistake-quad_parametrisation_wrong")
    settled(tab)
    seen = {tab.evaluate(PIXELS)}
    count = tab.locator("#museum-form option").count()
    for form in (1, count - 1):
        act(tab, "form", form)
        seen.add(tab.evaluate(PIXELS))
    for scene in ("tp3_sheared", "check_low"):
        act(tab, "scene", scene)
        seen.add(tab.evaluate(PIXELS))
    act(tab, "again")
    seen.add(tab.evaluate(PIXELS))
    assert len(seen) == 6


def test_nothing_is_rendered_out_of_sight(opened: Callable[..., Page]) -> None:
    tab = opened("#mistake-black")
    settled(tab)
    tab.mouse.wheel(0, -1)
    tab.evaluate("scrollTo({top: 0, behavior: 'instant'})")
    tab.wait_for_timeout(300)
    frames = "() => document.getElementById('museum-live').dataset.frames"
    before = tab.evaluate(frames)
    tab.evaluate(
        "() => { const e = document.getElementById('museum-n'); e.value = 2;"
        " e.dispatchEvent(new Event('input')); }"
    )
    tab.wait_for_timeout(500)
    assert tab.evaluate(frames) == before
    tab.evaluate("document.getElementById('museum-live').scrollIntoView({behavior: 'instant'})")
    tab.wait_for_selector(f"#museum-live:not([data-frames='{before}'])")


# ---------------------------------------------------------------- links


@pytest.mark.parametrize("width", [390, 1280])
def test_a_link_opens_its_exhibit_and_only_that(width: int, opened: Callable[..., Page]) -> None:
    """Also where figures above it grow as the page opens; and another link on the open page."""
    tab = opened("#mistake-shadow_acne", width=width)
    settled(tab)
    for name in ("shadow_acne", "no_shadow"):
        card = f".exhibit[data-name='{name}']"
        tab.wait_for_timeout(500)
        top = tab.locator(card).bounding_box()
        assert top is not None and 0 <= top["y"] < 300
        assert tab.locator(f"{card}[open] #museum-live").is_visible()
        tab.evaluate("location.hash = '#mistake-no_shadow'")
        tab.wait_for_selector(".exhibit[data-name='no_shadow'] #museum-live")
    tab.fill("#museum-search", "no such mistake")
    assert tab.locator(".exhibit:visible").count() == 0
    tab.evaluate("location.hash = '#mistake-black'")
    tab.wait_for_selector(".exhibit[data-name='black'] #museum-live", state="visible")


def test_the_address_of_a_verdict_is_an_anchor_of_the_page(html: str) -> None:
    anchors = set(re.findall(r'id="(mistake-[^"]*)"', html))
    linked = exhibits([*MISTAKES, "unknown"], "https://example.org/course/")
    assert {address.partition("#")[2] for address in linked.values()} == anchors
    assert list(linked) == list(MISTAKES)


# ---------------------------------------------------------------- for everyone


def test_it_reads_without_scripts(opened: Callable[..., Page]) -> None:
    """All exhibits can be opened, with their pictures, words and numbers; no dead controls."""
    tab = opened(java_script_enabled=False)
    assert tab.locator(".exhibit").count() == len(MISTAKES)
    assert not tab.locator("#museum-filter").is_visible()
    assert not tab.locator("#museum-live").is_visible()
    card = tab.locator(".exhibit[data-name='pdf_times_cos']")
    card.locator("summary").first.click()
    for what in ("figure img", ".formulas", ".ask", ".measured"):
        assert card.locator(what).is_visible()
    assert not card.locator(".now").first.is_visible()


def test_the_filter_finds_by_words_place_and_students(opened: Callable[..., Page]) -> None:
    tab = opened()
    shown = tab.locator(".exhibit:visible")
    tab.fill("#museum-search", "NORMALISED")
    assert shown.evaluate_all("all => all.map((e) => e.dataset.name)") == ["normal_not_normalised"]
    tab.fill("#museum-search", "")
    tab.select_option("#museum-group", "c")
    count = sum(group_of(m) == "c" for m in catalogue().mistakes.values())
    assert shown.count() == count and f"{count} of {len(MISTAKES)}" in tab.inner_text(
        "#museum-found"
    )
    tab.select_option("#museum-group", "")
    tab.check("#museum-seen")
    assert shown.count() == sum(m.seen > 0 for m in catalogue().mistakes.values())


def test_the_keyboard_is_enough(opened: Callable[..., Page]) -> None:
    """From the filter to an exhibit, its switch and its slider."""
    tab = opened()
    tab.wait_for_selector("#museum.alive")
    tab.focus("#museum-seen")
    tab.keyboard.press("Tab")
    tab.keyboard.press("Enter")
    tab.locator(".exhibit[open] #museum-live").wait_for(state="attached")
    for stop in ("mistake", "half", "form", "n"):
        tab.keyboard.press("Tab")
        assert tab.evaluate("document.activeElement.id") == f"museum-{stop}"
        if stop == "mistake":
            first = settled(tab)  # it opens below what is seen, perhaps; its switch is seen now
            tab.evaluate("delete document.getElementById('museum-live').dataset.measured")
            tab.keyboard.press("Space")
            assert settled(tab) != first
    tab.keyboard.press("ArrowRight")
    assert tab.inner_text("#museum-n-shown") == "32"


@pytest.mark.parametrize("width", [320, 1280])
def test_axe_finds_nothing_and_nothing_is_cut_off(width: int, opened: Callable[..., Page]) -> None:
    """In both languages, light and dark, with exhibits open; the page's own policy would keep axe
    out."""
    tab = opened("#mistake-quad_parametrisation_wrong", width=width, bypass_csp=True)
    settled(tab)
    tab.evaluate(
        "document.querySelectorAll('.rights, .exhibit[open] .forms, [data-name=black]')"
        ".forEach((d) => { d.open = true; })"
    )
    for language in LANGUAGES:
        tab.evaluate(f"document.getElementById('language-{language}').click()")
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        for scheme in ("light", "dark"):
            tab.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            assert section.barriers(tab, "#museum") == []
