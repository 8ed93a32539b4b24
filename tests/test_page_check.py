"""The course's page checks a picture in the browser, and says what `penumbra check` says of it.

Pictures are made by renderers whose mistake, or whose want of one, is known. PENUMBRA_STRESS=n
(2 and more) takes 80 n, of all mistakes and nuisances, by another draw.
"""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from playwright.sync_api import Browser, Page

from penumbra.compare.check.calibration import SIZES, draw
from penumbra.compare.check.catalogue import Variant, catalogue
from penumbra.compare.check.checking import Checker, check
from penumbra.compare.check.explanation import text
from penumbra.compare.check.picture import counts_in_name
from penumbra.compare.check.specimens import Specimen
from penumbra.compare.check.words import WORDS
from penumbra.course.drop import PARAMETERS, SCENES, catalogue_script, javascript
from tests import section
from tests.conftest import ROOT, STRESS, built
from tests.firefox import firefox

SCENE = ROOT / "scenes" / "tp3.json"
OPPOSITE = {"right", "wrong"}
CHECK = """async ([content, name, options]) => {
  const bytes = Uint8Array.from(atob(content), (character) => character.charCodeAt(0));
  try {
    return await checkPicture(new File([bytes], name), options);
  } catch (error) {
    return { refused: error.code || String(error) };
  }
}"""


@pytest.fixture(scope="module")
def window() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


@pytest.fixture(scope="module")
def tab(course_page: Path, window: Browser) -> Iterator[Page]:
    """The page in English, in which nothing complains and which asks for nothing."""
    heard: list[str] = []
    page = opened(window, course_page, "en", 1100)
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.on("request", lambda request: heard.append(request.url))
    page.reload()
    page.wait_for_selector("#drop-form:not([hidden])")
    yield page
    outside = [what for what in heard if what.partition(":")[0] not in ("file", "data", "blob")]
    assert outside == []


def opened(window: Browser, course_page: Path, language: str, width: int) -> Page:
    page = window.new_page(viewport={"width": width, "height": 900})
    page.set_default_timeout(120_000)
    page.goto(f"{course_page.as_uri()}?lang={language}#drop")
    page.wait_for_selector("#drop-form:not([hidden])")
    return page


def specimen(variant: Variant, n: int = 16, m: int = 1, **nuisances: Any) -> Specimen:
    kind = "single" if variant.mistakes else "correct"
    given = {"shape": SIZES[0], "seed": 5} | nuisances
    return Specimen(
        kind, given.pop("scene", "tp3"), ("mistakes",), variant, given.pop("shape"), ((n, m),),
        **given,
    )  # fmt: skip


FEW = [
    specimen(Variant()),
    specimen(Variant(), n=64, position=(0.0, 0.0), divisor=1, file="jpg 100"),
    specimen(Variant(), n=4, scene="tp3_statement", position=None),
    specimen(Variant(), n=16, fov_y_deg=70.0, encoding="sRGB"),
    specimen(Variant(), n=1, power=1.5, offset="offset_0_01"),
    specimen(Variant(), n=4, m=4, file="bmp", ray_max_distance=1000.0),
    specimen(Variant(), n=16, file="jpg 90", position=(1.5, 0.5)),
    specimen(Variant(domain="diagonal"), scene="tp3_statement"),
    specimen(Variant(domain="corner")),
    specimen(Variant(visibility="to_centre"), position=(0.0, 0.0)),
    specimen(Variant(visibility="offset_0_3"), n=64),
    specimen(Variant(weight="pdf_times_cos"), file="jpg 100"),
    specimen(Variant(weight="no_light_cosine"), n=1),
    specimen(Variant(scale="area_3"), encoding="rounded"),
    specimen(Variant(average="n_no_effect")),
    specimen(Variant(average="break_first"), position=None),
    specimen(Variant(clamp="per_light_sample")),
    specimen(Variant(output="ambient_0_1"), scene="tp3_statement"),
    specimen(Variant(generator="same_everywhere")),
    specimen(Variant(weight="cos_of_cos_receiver", average="not_divided_by_n"), n=4),
]


def many() -> list[Specimen]:
    """80 for each unit of STRESS, of a draw as calibration makes it, what the page takes: one
    picture, of the lab's scene, in 8 bits."""
    found = []
    for i, s in enumerate(draw(1, 25 * STRESS, 100 + STRESS)):
        if s.kind == "left out" or s.variant.lights != "std" or s.variant.scale == "area_by_norms":
            continue
        scene = s.scene if s.scene in SCENES else SCENES[i % 2]
        file = "png" if s.file == "exr" else s.file
        found.append(replace(s, scene=scene, file=file, counts=s.counts[-1:]))
    order = np.random.default_rng(STRESS).permutation(len(found))
    return [found[i] for i in order[: 80 * STRESS]]


def checked_by_page(tab: Page, file: Path, s: Specimen) -> dict[str, Any]:
    n, m = s.counts[0]
    content = base64.b64encode(file.read_bytes()).decode()
    options = {"scene": s.scene, "lightSamples": n, "pixelSamples": m}
    found: dict[str, Any] = tab.evaluate(CHECK, [content, file.name, options])
    return found


def test_page_says_what_the_command_says(tab: Page, tmp_path: Path) -> None:
    """The same verdict, the same mistakes in the same order, the same facts, the same score; and
    so no correct renderer is accused."""
    checker = Checker()
    tally: dict[str, int] = {}
    failures = []
    for s in FEW if STRESS == 1 else many():
        file = s.files(tmp_path)[0]
        mine = check([file], s.scene_file, *s.counts[0], checker)
        verdict, ours = mine.verdict, checked_by_page(tab, file, s)
        said = ours.get("verdict", ours.get("refused"))
        gain = mine.diagnosis.best.score - mine.diagnosis.right.score
        near = 1e-3 * max(abs(gain), 1)
        same = said == verdict.verdict and tuple(ours["mistakes"]) == verdict.mistakes
        agrees = same and abs(ours["gain"] - gain) < near
        agrees = agrees and [f["code"] for f in ours["facts"]] == [c for c, _ in verdict.facts]
        opposite = {said, verdict.verdict} == OPPOSITE
        for name, holds in {
            "pictures": True,
            "same verdict": said == verdict.verdict,
            "same mistakes": same,
            "page cannot tell": said == "cannot tell" != verdict.verdict,
            "opposite": opposite,
        }.items():
            tally[f"{s.kind}: {name}"] = tally.get(f"{s.kind}: {name}", 0) + holds
        accused = s.kind == "correct" and said == "wrong"
        if accused or opposite or not agrees:
            failures.append((s.variant, s, verdict.verdict, verdict.mistakes, ours))
    print(json.dumps(tally, indent=1))
    assert failures == []


# ---------------------------------------------------------------- what it shows


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    built("lib/libmistakes.so")
    return tmp_path_factory.mktemp("pictures")


def saved(folder: Path, name: str, variant: Variant, n: int) -> Path:
    return specimen(variant, n).files(folder)[0].rename(folder / name)


@pytest.fixture(scope="module")
def wrong(folder: Path) -> Path:
    return saved(folder, "no_cosine_n016_aa01.png", Variant(weight="no_light_cosine"), 16)


@pytest.fixture(scope="module")
def right(folder: Path) -> Path:
    return saved(folder, "N=4.png", Variant(), 4)


def given(tab: Page, file: Path, hint: int = 3, language: str = "en") -> str:
    """What the page says of a file."""
    tab.click(f"label[for=language-{language}]")
    tab.select_option("#drop-hint", str(hint))
    tab.set_input_files("#drop-file", [])
    tab.set_input_files("#drop-file", file)
    tab.wait_for_selector("#drop-progress", state="hidden")
    return tab.inner_text("#drop-status") + "\n" + tab.inner_text("#drop-result")


def plain(said: str) -> str:
    return re.sub(r"\s+", " ", said)


SAID = {
    "wrong": specimen(Variant(weight="no_light_cosine")),
    "right": specimen(Variant(), n=4),
    "another camera": specimen(
        Variant(), n=64, fov_y_deg=70.0, encoding="sRGB", position=(0.0, 0.0), divisor=1, power=1.5
    ),
    "two, shifted": specimen(
        Variant(scale="area_3", output="ambient_0_1"), position=(1.5, 0.5), ray_max_distance=1000.0,
        file="jpg 90",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SAID)
def test_page_says_it_in_the_sentences_of_the_command(tab: Page, name: str, folder: Path) -> None:
    """At every level of hints each line of the command's is there, and at lower ones no mistake's
    name, no formula and no right picture."""
    made = SAID[name].files(folder)[0]
    file = made.rename(folder / f"{name}_n{SAID[name].counts[0][0]}{made.suffix}")
    checked = check([file], SCENE)
    whole = given(tab, file)
    for hint in range(4):
        tab.select_option("#drop-hint", str(hint))
        shown = plain(tab.inner_text("#drop-status") + " " + tab.inner_text("#drop-result"))
        for line in text(checked.verdict, hint).splitlines():
            command = line.startswith(WORDS["command"].partition("{")[0])
            formula = re.sub(r"^ *(yours|right) +", "", line).strip()
            assert command or plain(formula) in shown, (hint, line)
        for mistake in checked.verdict.mistakes:
            told = catalogue().mistakes[mistake]
            assert (told.title in shown) == (hint >= 2)
            assert (plain(told.right) in shown) == (hint >= 3)
            assert tab.locator(f'#drop-result a[href="#mistake-{mistake}"]').count() == (hint >= 2)
        panes = 2 + bool(checked.verdict.mistakes)
        assert tab.locator("#drop-result canvas").count() == (panes if hint == 3 else 0)
    assert WORDS[checked.verdict.verdict] in whole


def test_right_picture_beside_theirs_is_the_scene_s(tab: Page, right: Path) -> None:
    """In their size, and away from its noise theirs: the mean of all pixels is within one level."""
    given(tab, right)
    pixels = """() => [...document.querySelectorAll("#drop-result canvas")].map((canvas) =>
      [...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data])"""
    yours, ours = (
        np.array(levels).reshape(*SIZES[0], 4)[..., :3].astype(float)
        for levels in tab.evaluate(pixels)
    )
    assert np.abs(yours.mean(axis=(0, 1)) - ours.mean(axis=(0, 1))).max() < 1
    assert np.array_equal(yours, np.asarray(Image.open(right).convert("RGB"), float))


def test_light_samples_are_those_of_the_name_or_asked_for(
    tab: Page, folder: Path, wrong: Path
) -> None:
    tab.click("label[for=language-en]")
    nameless = folder / "picture.png"
    shutil.copy(wrong, nameless)
    tab.set_input_files("#drop-file", nameless)
    assert "How many light samples" in tab.inner_text("#drop-status")
    assert tab.evaluate("document.activeElement.id") == "drop-n"
    tab.keyboard.type("16")
    tab.keyboard.press("Enter")
    tab.wait_for_selector("#drop-progress", state="hidden")
    assert WORDS["wrong"] in tab.inner_text("#drop-status")


NAMES = ("n016_aa01.png", "tp3_N64.png", "n16m4.png", "nbLightSamples=9.jpg", "scene_7.png",
         "n4_n8.png", "a_64spp.png", "n4_16spp.png", "light_samples_32 spp 2.bmp", "n1.5.png",
         "N=4.png", "image", "n016_m04.png", "pixel-samples 3 n2.png", "n0.png")  # fmt: skip


def test_names_are_read_as_the_command_reads_them(tab: Page) -> None:
    read = tab.evaluate("(names) => names.map(countsInName)", list(NAMES))
    assert [tuple(counts) for counts in read] == [counts_in_name(name) for name in NAMES]


def test_every_mistake_has_the_exhibit_that_a_verdict_links_to(tab: Page) -> None:
    missing = tab.evaluate(
        "(names) => names.filter((name) => !document.getElementById(`mistake-${name}`))",
        list(catalogue().mistakes),
    )
    assert missing == []


def png(folder: Path, name: str, **how: Any) -> Path:
    file = folder / name
    Image.fromarray(how.pop("pixels")).save(file, **how)
    return file


def test_what_cannot_be_checked_is_refused_in_plain_words(tab: Page, folder: Path) -> None:
    text_file, exr = folder / "n16.png", folder / "n16.exr"
    text_file.write_text("no picture")
    exr.write_bytes(b"\x76\x2f\x31\x01" + bytes(100))
    grey = np.full((40, 60), 7, np.uint16)
    clear = np.zeros((40, 60, 4), np.uint8)
    tiny = np.zeros((9, 9, 3), np.uint8)
    cut = folder / "n16_cut.png"
    whole = io.BytesIO()
    Image.fromarray(tiny).save(whole, "PNG")
    cut.write_bytes(whole.getvalue()[:40])
    for file, expected in {
        text_file: "no picture that the page can read",
        exr: "no picture that the page can read",
        cut: "no picture that the page can read",
        png(folder, "deep_n16.png", pixels=grey): "8 bits",
        png(folder, "clear_n16.png", pixels=clear): "transparent",
        png(folder, "tiny_n16.png", pixels=tiny): "9 x 9 pixels are too few",
        png(folder, "small_n16.png", pixels=np.zeros((20, 30, 3), np.uint8)): "too few",
    }.items():
        assert expected in given(tab, file), file
        assert tab.is_hidden("#drop-result")


def test_numbers_of_the_file_are_taken_whatever_profile_it_claims(tab: Page, wrong: Path) -> None:
    """A gamma or colour space in the file changes nothing, here as there."""
    claims = PngImagePlugin.PngInfo()
    claims.add(b"gAMA", (100_000).to_bytes(4, "big"))
    file = wrong.with_name("claims_n016.png")
    Image.open(wrong).save(file, pnginfo=claims)
    found = [checked_by_page(tab, f, FEW[0]) for f in (wrong, file)]
    assert found[0]["gain"] == found[1]["gain"]


def test_greyscale_and_palette_pictures_get_the_command_s_verdict(
    tab: Page, right: Path, folder: Path
) -> None:
    for mode in ("L", "P"):
        file = folder / f"{mode}_n004.png"
        Image.open(right).convert(mode).save(file)
        assert checked_by_page(tab, file, replace(FEW[0], counts=((4, 1),)))["verdict"] == (
            check([file], SCENE).verdict.verdict
        )


def test_keyboard_alone_checks_a_picture(tab: Page, wrong: Path) -> None:
    # Before anything else: expect_file_chooser() may be heard after the key that follows it.
    tab.on("filechooser", lambda chooser: chooser.set_files(wrong))
    tab.click("label[for=language-en]")
    tab.focus("#drop-file")
    tab.keyboard.press("Enter")
    tab.wait_for_selector("#drop-progress:not([hidden])", state="visible")
    tab.wait_for_selector("#drop-progress", state="hidden")
    visited = []
    tab.focus("#drop-file")
    while len(visited) < 5:
        tab.keyboard.press("Tab")
        visited.append(tab.evaluate("document.activeElement.id"))
    assert visited == ["drop-n", "drop-m", "drop-scene", "drop-hint", "drop-check"]
    tab.keyboard.press("Enter")
    tab.wait_for_selector("#drop-progress:not([hidden])", state="visible")
    tab.wait_for_selector("#drop-progress", state="hidden")
    assert WORDS["wrong"] in tab.inner_text("#drop-status")


def test_picture_that_is_dropped_or_pasted_is_checked(tab: Page, wrong: Path) -> None:
    content = base64.b64encode(wrong.read_bytes()).decode()
    for event in ("drop", "paste"):
        tab.set_input_files("#drop-file", [])
        tab.fill("#drop-n", "")
        tab.evaluate(
            """([content, name, type]) => {
              const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
              const carried = new DataTransfer(), how = { bubbles: true, cancelable: true };
              carried.items.add(new File([bytes], name));
              const event = type === "drop" ? new DragEvent(type, { dataTransfer: carried, ...how })
                : new ClipboardEvent(type, { clipboardData: carried, ...how });
              document.getElementById("drop-zone").dispatchEvent(event);
            }""",
            [content, wrong.name, event],
        )
        assert tab.input_value("#drop-n") == "16"
        tab.wait_for_selector("#drop-progress", state="hidden")
        assert WORDS["wrong"] in tab.inner_text("#drop-status")


def test_last_picture_given_is_the_one_that_is_spoken_of(
    tab: Page, wrong: Path, right: Path
) -> None:
    tab.set_input_files("#drop-file", wrong)
    assert WORDS["right"].partition(":")[0] in given(tab, right)


def test_verdict_follows_the_language(tab: Page, wrong: Path) -> None:
    """Numbers with a comma, once the reader changes to French, without checking again."""
    said = given(tab, wrong)
    assert re.search(r"\d\.\d", said)
    tab.click("label[for=language-fr]")
    french = tab.inner_text("#drop-result")
    observed = french.partition("_n")[0]
    assert re.search(r"\d,\d", observed) and not re.search(r"\d\.\d\d", observed)
    tab.click("label[for=language-en]")
    assert tab.inner_text("#drop-result") in said


@pytest.mark.parametrize(("language", "width"), [("en", 1100), ("fr", 320)])
def test_axe_finds_nothing_in_any_state(
    window: Browser, course_page: Path, right: Path, wrong: Path, language: str, width: int
) -> None:
    page = opened(window, course_page, language, width)

    def clean() -> None:
        assert section.barriers(page, "#drop") == []
        assert page.evaluate("document.getElementById('drop').scrollWidth") <= width

    clean()
    given(page, wrong, 3, language)
    clean()
    given(page, right, 0, language)
    clean()
    given(page, ROOT / "Makefile", 0, language)
    clean()
    # a check that never ends
    page.evaluate("coreReady.then((core) => { core.moments = () => new Promise(() => {}); })")
    page.set_input_files("#drop-file", wrong)
    page.wait_for_selector("#drop-progress:not([hidden])")
    clean()
    page.close()


def test_firefox_says_the_same(course_page: Path, wrong: Path, right: Path) -> None:
    with firefox() as tab:
        tab.open(f"{course_page.as_uri()}?lang=en")
        for file, n in ((wrong, 16), (right, 4)):
            content = base64.b64encode(file.read_bytes()).decode()
            given = json.dumps([content, file.name, {"lightSamples": n}])
            found = tab.evaluate(f"({CHECK})({given})")
            mine = check([file], SCENE, n, 1)
            gain = mine.diagnosis.best.score - mine.diagnosis.right.score
            assert found.get("verdict") == mine.verdict.verdict, found
            assert tuple(found["mistakes"]) == mine.verdict.mistakes
            assert found["gain"] == pytest.approx(gain, rel=1e-6, abs=1e-6)


def test_page_without_scripts_says_what_to_do_instead(window: Browser, course_page: Path) -> None:
    page = window.new_context(java_script_enabled=False).new_page()
    page.goto(course_page.as_uri())
    assert page.is_hidden("#drop-form")
    assert "penumbra check" in page.inner_text("#drop-without")
    page.close()


# ---------------------------------------------------------------- the catalogue's expressions


def test_expressions_are_worth_the_same_in_javascript(window: Browser) -> None:
    """Every function of every choice, at a few places."""
    values = {"a": 0.3, "b": 0.8, "n": 5.0, "i": 2.0, "k": 3.0, "area": 4.0, "norms": 5.5, "c": 0.6}
    page = window.new_page()
    worth = page.evaluate(
        f"(at) => {{ {catalogue_script()}"
        "return CATALOGUE.map(({ functions }) => functions.map((f) => f("
        "...String(f).split(')')[0].slice(1).split(', ').map((name) => at[name])))); }",
        values,
    )
    page.close()
    choices = [c for c in catalogue().choices.values() if c.module != "lights"]
    for choice, found in zip(choices, worth, strict=True):
        first = 1 if choice.macro == "SPLIT" else 0
        expected = [float(choice.evaluate(first + j, **values)) for j in range(len(found))]
        assert found == pytest.approx(expected), choice
        assert bool(found) == (choice.module in PARAMETERS)


def test_expression_that_the_page_cannot_evaluate_is_refused() -> None:
    for hostile in ("alert(1)", "a.b", "a[0]", "'text'", "a if b else a", "1 < a < 2"):
        with pytest.raises(ValueError, match="not an expression"):
            javascript(hostile)
