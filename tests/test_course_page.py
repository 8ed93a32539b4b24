"""The lesson's page: one offline file that renders while it is read, in two languages, for all.

One browser, a tab for each claim. Where only a control's effect matters, events move it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from penumbra.course.lesson import (
    SCENES,
    TEXTS,
    check_same,
    cpp_lines,
    mathml,
    pictures,
    read_lesson,
    scene_of,
)
from penumbra.language import LANGUAGES
from tests import section
from tests.firefox import firefox

LIMIT = 2_000_000  # bytes, of the lesson's page
STEPS = tuple(pictures())
PATIENCE = 30_000  # [ms] for a frame, on a machine with other work

MOVE = """([figure, name, to]) => {
  const f = document.getElementById(figure);
  const inputs = [...f.querySelectorAll(`[data-name="${name}"]`)];
  const radio = inputs[0].type === "radio" && inputs.find((i) => i.value === to);
  if (radio && radio.checked) return;
  delete f.dataset.rested;
  if (radio) radio.click();
  else {
    inputs[0].value = to;
    inputs[0].dispatchEvent(new Event("input"));
  }
}"""
SHOWN = """(figure) => [...document.querySelectorAll(`#${figure} canvas`)]
  .map((c) => c.toDataURL()).join()
  + document.querySelector(`#${figure}`).innerText"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


@pytest.fixture
def opened(course_page: Path, browser: Browser) -> Iterator[Callable[..., Page]]:
    """opened(language, width, ...) is a tab with the page; any complaint of the page, and any
    request for what is not in it, fails at the end."""
    complaints: list[str] = []
    contexts = []

    def open_(language: str = "en", width: int = 1280, **context: Any) -> Page:
        contexts.append(browser.new_context(viewport={"width": width, "height": 900}, **context))
        tab = contexts[-1].new_page()
        tab.set_default_timeout(PATIENCE)
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        own = ("data:", "blob:", course_page.as_uri())
        tab.on("request", lambda r: None if r.url.startswith(own) else complaints.append(r.url))
        tab.goto(f"{course_page.as_uri()}?lang={language}")
        return tab

    yield open_
    for context in contexts:
        context.close()
    assert complaints == []


def see(tab: Page, step: str) -> str:
    """Scrolls to a step's figure and waits for its picture; its id."""
    figure = f"figure-{step}"
    tab.evaluate(f"document.getElementById('{figure}').scrollIntoView({{behavior: 'instant'}})")
    tab.wait_for_selector(f"#{figure}[data-rested]")
    return figure


def move(tab: Page, figure: str, name: str, to: str | float) -> None:
    tab.evaluate(MOVE, [figure, name, to])
    tab.wait_for_selector(f"#{figure}[data-rested]")


# ---------------------------------------------------------------- texts


def test_both_languages_have_the_same_steps_and_say_the_same_numbers() -> None:
    texts = {name: read_lesson(TEXTS / f"{name}.md", name) for name in LANGUAGES}
    check_same(texts)
    assert tuple(step.anchor for step in texts["en"].steps) == STEPS
    assert sum(len(step.numbers) for step in texts["en"].steps) > 100


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("### Question\n\nThe light", "The light", "step hard-and-soft lacks ### Question"),
        ("## One shadow ray {#one-ray}", "## One shadow ray", "a step begins with"),
        ("(average)", "(umbra)", "a figure is"),
        ("ends at 1.00 m", "ends at 1.01 m", "1.01 is said in en alone"),
        ("{#umbra}", "{#shadow}", "steps differ"),
    ],
)
def test_a_text_that_lacks_something_is_refused_with_its_line(
    old: str, new: str, complaint: str, tmp_path: Path
) -> None:
    text = (TEXTS / "en.md").read_text()
    assert old in text
    changed = tmp_path / "en.md"
    picture = ("](umbra)", "](shadow)") if new == "{#shadow}" else ("", "")
    changed.write_text(text.replace(old, new).replace(*picture))
    with pytest.raises(ValueError, match=re.escape(complaint)) as refused:
        texts = {"en": read_lesson(changed, "en"), "fr": read_lesson(TEXTS / "fr.md", "fr")}
        check_same(texts)
    line = text[: text.index(old)].count("\n") + 1
    found = re.search(r"en\.md:(\d+):", str(refused.value))
    assert complaint == "steps differ" or (found and abs(int(found[1]) - line) < 8)


def test_formulas_are_words_and_numbers_to_a_screen_reader() -> None:
    said = mathml(r"\frac{d^2}{\cos\theta_y} \cdot 0{,}5", "block")
    assert "<mi>cos</mi><mo" in said and "&#x2061;" in said
    assert "<mn>0,5</mn>" in said and 'display="block"' in said


# ---------------------------------------------------------------- the page


def as_floats(cpp: str) -> str:
    """Its numbers as C++ reads them: a float has 9 digits."""
    return re.sub(r"-?\d+\.?\d*(?:e-?\d+)?f", lambda found: f"{float(found[0][:-1]):.9g}f", cpp)


def test_page_is_one_small_file_without_network(
    course_page: Path, opened: Callable[..., Page]
) -> None:
    assert course_page.stat().st_size < LIMIT
    html = course_page.read_text()
    assert not re.search(r"""(?:src|href)=["']?(?:https?:|//|\w+\.)""", html)
    tab = opened()
    see(tab, STEPS[0])
    broken = """[...document.querySelectorAll('a[href^="#"]')].map((a) => a.hash.slice(1))
      .filter((id) => !document.getElementById(id))"""
    assert tab.evaluate(broken) == []


def test_every_control_of_every_figure_changes_what_is_shown(opened: Callable[..., Page]) -> None:
    tab = opened()
    for step in STEPS:
        figure = see(tab, step)
        names = tab.evaluate(
            f"""[...new Map([...document.querySelectorAll('#{figure} [data-name]')].map((i) =>
                [i.dataset.name, i.type === 'radio'
                  ? [...document.querySelectorAll(`#{figure} [data-name="${{i.dataset.name}}"]`)]
                    .find((r) => !r.checked).value
                  : i.value === i.max ? i.min : i.max]))]"""
        )
        assert names, step
        for name, to in names:
            before = tab.evaluate(SHOWN, figure)
            # The radio buttons of a view that is not rendered anew are still redrawn.
            tab.evaluate(MOVE, [figure, name, to])
            for _ in range(PATIENCE // 50):
                if tab.evaluate(SHOWN, figure) != before:
                    break
                tab.wait_for_timeout(50)
            else:
                pytest.fail(f"{step}: {name} = {to} changes nothing")
        tab.click(f"#{figure} .reset")
        assert tab.inner_text(f"#{figure} .message") == ""


def test_texts_say_what_their_figures_measure(opened: Callable[..., Page]) -> None:
    """Same seeds, same numbers, on every machine."""
    tab = opened()
    tab.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")

    def said(step: str) -> str:
        return tab.inner_text(f"#{step} .answer").replace("\u00a0", " ")

    def read(figure: str) -> list[str]:
        text = [dd.inner_text() for dd in tab.locator(f"#{figure} dd").all()]
        return [t.replace("\u00a0", " ") for t in text]

    figure = see(tab, "hard-and-soft")
    for side, ends in ((2, ("1.00 m", "1.42 m")), (4, ("0.81 m", "1.65 m")), (0, ("1.21 m",))):
        move(tab, figure, "side", side)
        assert all(end in read(figure) and end in said("hard-and-soft") for end in ends)
    figure = see(tab, "average")
    for power in (0, 2, 4, 6):
        move(tab, figure, "n", power)
        assert f"{read(figure)[0]} with" in said("average")
    figure = see(tab, "umbra")
    assert read(figure)[0] == "0%"
    assert all(f"{noise} in the" in said("umbra") for noise in read(figure)[1:3])
    figure = see(tab, "antialiasing")
    without, with_ = read(figure)[0], read(figure)[3]
    assert f"{with_} with anti-aliasing, {without} without" in said("antialiasing")
    move(tab, figure, "m", 0)
    assert f"{read(figure)[0]} without it at 4" in said("antialiasing")
    figure = see(tab, "trade")
    for method, n in (("independent", 4), ("independent", 6), ("sobol", 4)):
        move(tab, figure, "method", method)
        move(tab, figure, "n", n)
        assert read(figure)[0] in said("trade")
    figure = see(tab, "floats")
    for distance in (7, 8):
        move(tab, figure, "far", distance)
        assert read(figure)[0] in said("floats")
    figure = see(tab, "other-lights")
    for shape, side, above in (("quad", 2, 12), ("quad", 6, 5), ("sphere", 2, 12)):
        for estimator in ("area", "solid-angle"):
            for name, to in (
                ("shape", shape), ("side", side), ("above", above), ("estimator", estimator)
            ):  # fmt: skip
                move(tab, figure, name, to)
            at = 0 if side == 6 else 1
            assert f"{read(figure)[at]}" in said("other-lights")


def test_the_cpp_under_a_figure_is_the_scene_on_the_screen(opened: Callable[..., Page]) -> None:
    tab = opened()
    for step, (scene, _) in pictures().items():
        see(tab, step)
        shown = tab.text_content(f"#{step} .cpp code") or ""
        assert as_floats(shown) == as_floats(cpp_lines(scene)), step
    move(tab, see(tab, "hard-and-soft"), "side", 4)
    lines = tab.text_content("#hard-and-soft .cpp code") or ""
    assert (
        "_addLight( new QuadLight( Vec3f( 2.f, 10.f, 1.f ), Vec3f( -4.f, 0.f, 0.f ), "
        "Vec3f( 0.f, 0.f, 4.f ), WHITE, 10.f ) );" in lines
    )


def test_errors_of_frames_accumulate_along_the_law(opened: Callable[..., Page]) -> None:
    """4,096 samples: the error is sigma / 64, where sigma is that of one sample; within the 95%
    band of this picture, which is narrower than 10%."""
    tab = opened()
    figure = see(tab, "square-root")
    first = tab.inner_text(f"#{figure} dd >> nth=1")
    tab.click(f"#{figure} .buttons button >> nth=0")
    for _ in range(200):
        tab.wait_for_timeout(100)
        if "4,096" in tab.inner_text(f"#{figure} .readouts"):
            break
    n, error, slope = (dd.inner_text() for dd in tab.locator(f"#{figure} dd").all())
    assert n == "4,096"
    assert float(error.rstrip("%")) == pytest.approx(float(first.rstrip("%")) / 64, rel=0.1)
    assert slope in ("−0.49", "−0.50", "−0.51")


def test_language_switch_keeps_the_readers_place(opened: Callable[..., Page]) -> None:
    tab = opened("en")
    see(tab, "average")
    top = "document.querySelector('#umbra h2').getBoundingClientRect().top"
    tab.evaluate(f"scrollBy({{top: {top} - 250, behavior: 'instant'}})")
    before = tab.evaluate(top)
    box = tab.locator("label[for=language-fr]").bounding_box()  # click() would scroll
    assert box
    tab.mouse.click(box["x"] + 5, box["y"] + 5)
    assert tab.evaluate("document.documentElement.lang") == "fr"
    assert abs(tab.evaluate(top) - before) < 60
    assert "Pourquoi" in tab.inner_text("#umbra h2")
    tab.reload()
    assert tab.evaluate("document.documentElement.lang") == "en"  # the address asks for it
    tab.goto(tab.url.split("?")[0])
    assert tab.evaluate("document.documentElement.lang") == "fr"  # remembered


def test_without_scripts_the_lesson_reads(opened: Callable[..., Page]) -> None:
    tab = opened(java_script_enabled=False)
    assert tab.locator("section.step").count() == len(STEPS)
    assert "Pourquoi" in tab.inner_text("#umbra h2")
    assert tab.locator("#lesson input:visible, #lesson button:visible").count() == 0
    for step in STEPS:
        picture = tab.locator(f"#figure-{step} img")
        assert picture.is_visible() and picture.get_attribute("alt")
    tab.click("label[for=language-en]")
    assert tab.inner_text("#umbra h2").endswith("Why is there no noise in the umbra?")
    tab.click("#umbra .answer summary")
    assert "Largest where half" in tab.inner_text("#umbra .answer")


def test_without_webassembly_figures_stay_pictures(opened: Callable[..., Page]) -> None:
    tab = opened("en")
    tab.add_init_script("delete window.WebAssembly")
    tab.reload()
    tab.wait_for_selector("figure.live.still")
    assert tab.locator("figure.live.still img").count() == len(STEPS)
    assert tab.locator("#lesson input:visible, #lesson .panel").count() == 0
    assert tab.locator(".opening .without").is_visible()


def test_keyboard_alone_reaches_and_moves_every_control(opened: Callable[..., Page]) -> None:
    tab = opened()
    for step in STEPS:
        see(tab, step)
    wanted = tab.evaluate(
        """[...document.querySelectorAll('#lesson input, #lesson button, #lesson summary')]
          .filter((e) => e.checkVisibility()).filter((e) => e.type !== 'radio' || e.checked)
          .map((e, i) => { e.dataset.stop = i; return i; })"""
    )
    assert len(wanted) > 50
    tab.evaluate("document.querySelector('#lesson h1').scrollIntoView({behavior: 'instant'})")
    tab.focus("#language-en")
    reached = set()
    for _ in range(2 * len(wanted)):
        tab.keyboard.press("Tab")
        stop, kind, before = tab.evaluate(
            """(() => { const e = document.activeElement;
              return [e.dataset.stop, e.type, e.value]; })()"""
        )
        if stop is None:
            continue
        reached.add(int(stop))
        if kind in ("range", "radio"):
            tab.keyboard.press("ArrowRight")
            after = tab.evaluate("document.activeElement.value")
            if after == before:
                tab.keyboard.press("ArrowLeft")
                after = tab.evaluate("document.activeElement.value")
            assert after != before, stop
        if len(reached) == len(wanted):
            break
    assert sorted(reached) == wanted


@pytest.mark.parametrize("width", [320, 1280])
def test_axe_finds_nothing_and_nothing_is_cut(width: int, opened: Callable[..., Page]) -> None:
    """In both languages, answers open, and the colours in the dark scheme too; the page's own
    policy would keep axe out."""
    tab = opened(width=width, bypass_csp=True)
    for step in STEPS:
        see(tab, step)
    tab.evaluate("document.querySelectorAll('#lesson details').forEach((d) => { d.open = true; })")
    for language in LANGUAGES:
        tab.evaluate(f"document.getElementById('language-{language}').click()")
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        for scheme, rules in (("light", section.WCAG), ("dark", ["color-contrast"])):
            tab.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            assert section.barriers(tab, rules=rules) == []


def test_firefox_renders_the_lesson(course_page: Path) -> None:
    with firefox() as tab:
        tab.size(1280, 900)
        tab.open(f"{course_page.as_uri()}?lang=fr")
        assert tab.evaluate("document.documentElement.lang") == "fr"
        shown = tab.evaluate(
            """new Promise((done) => {
              const figure = document.getElementById("figure-average");
              figure.scrollIntoView({ block: "center" });
              const look = () => figure.dataset.rested
                ? done([figure.querySelectorAll("canvas").length, figure.innerText])
                : setTimeout(look, 50);
              look();
            })"""
        )
        assert shown[0] > 0 and re.search(r"\d,\d", shown[1])


def test_reduced_motion_means_steps(opened: Callable[..., Page]) -> None:
    """No frame is asked for unless a button is pressed, and then one."""
    tab = opened(reduced_motion="reduce")
    figure = see(tab, "square-root")
    tab.evaluate(
        """(() => { window.asked = 0; const real = requestAnimationFrame;
          window.requestAnimationFrame = (f) => { window.asked++; return real(f); }; })()"""
    )
    number = f"#{figure} dd >> nth=0"
    assert tab.inner_text(number) == "1"
    for expected in ("2", "3", "4", "6"):
        tab.click(f"#{figure} .buttons button >> nth=0")
        for _ in range(100):
            if tab.inner_text(number) == expected:
                break
            tab.wait_for_timeout(50)
        assert tab.inner_text(number) == expected
    asked = tab.evaluate("window.asked")
    assert asked <= 8
    started = time.monotonic()
    tab.wait_for_timeout(700)
    assert time.monotonic() - started > 0.6 and tab.evaluate("window.asked") == asked


def test_scenes_in_the_page_are_scenes() -> None:
    """As the schema has them: what the page renders, the renderer and Blender can."""
    for name in SCENES:
        assert scene_of(name)["camera"]["fov_y_deg"] < 60
        assert "_addLight" in cpp_lines(name)
