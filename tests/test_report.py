"""The page: whole, offline, escaped, and its comparer shows what the images hold.

The inputs are made by the commands that report.inputs names, on the repository's scenes at
48x32 pixels; only the Cycles references stand in as exact images plus noise.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from penumbra.__main__ import main
from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import Image, read_image, write_exr
from penumbra.compare.scene import read_scene
from penumbra.course.lesson import TEXTS, read_lesson
from penumbra.language import LANGUAGES, of_environment, speaking
from penumbra.report import figures
from penumbra.report.build import TEMPLATES, build
from penumbra.report.inputs import IMAGES, LIGHT_SAMPLES, SCENES, ReportError, image_file
from penumbra.report.sections import SECTIONS, inputs_of
from penumbra.translation import translated
from tests import section
from tests.conftest import ROOT

INPUTS = inputs_of([s for s in SECTIONS if not s.optional])
WIDTH, HEIGHT = 48, 32
LESSON = "../course/index.html"
HALF = 2.0**-11
"""largest relative rounding error of a half float"""
HOSTILE = '</script><script>document.title="owned"</script><img src=x onerror=alert(1)> & "$x_1$"'

HOSTILE_LABEL = '<i onclick=alert(1)>&"$x$'


# Inputs


@pytest.fixture(scope="session")
def small_scenes(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for name in SCENES:
        data = json.loads((scenes / f"{name}.json").read_text())
        data["image"] = {"width": WIDTH, "height": HEIGHT}
        data["description"] = HOSTILE
        (folder / f"{name}.json").write_text(json.dumps(data, indent=1))
    return folder


@pytest.fixture(scope="session")
def inputs(renderer: Path, small_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A build folder with everything that the page needs."""
    folder = tmp_path_factory.mktemp("build")
    for item in INPUTS:
        path = item.path(folder)
        path.parent.mkdir(exist_ok=True)
        if path.exists():
            continue
        if item.file.startswith("reference/"):
            _write_reference(path, small_scenes / f"{item.scene}.json")
            continue
        command = item.command.replace("build/bin/penumbra-render", str(renderer))
        command = command.replace(" build/", f" {folder}/").replace(" scenes/", f" {small_scenes}/")
        command = command.replace(" --width 270 --height 180", "")  # all are of the scenes' size
        if not item.file.endswith("tp3_c_exact.json"):
            command = command.replace(" --perceptual", "")  # slow; one shows it
        program, *arguments = shlex.split(command)
        if program == "penumbra":
            assert main([*arguments, *_cheaper(arguments[0], arguments)]) in (
                0,
                1,
            )
        else:
            subprocess.run([program, *arguments], check=True, timeout=60)
    return folder


def _cheaper(subcommand: str, arguments: list[str]) -> list[str]:
    """Options after which the command costs little; Cycles is left out."""
    if subcommand == "converge":
        cycles = arguments.index("--cycles")
        del arguments[cycles : cycles + 2]
        return ["--light-samples", "1..64", "--seeds", "2", "--pixel-grid", "2"]
    return ["--repeats", "2", "--light-samples", "4"] if subcommand == "speedup" else []


def _write_reference(path: Path, scene_file: Path) -> None:
    scene = read_scene(scene_file)
    exact = exact_image(scene)
    parts = 8
    noise = np.random.default_rng(1).standard_normal((parts, HEIGHT, WIDTH, 1))
    images = exact.radiance * (1 + 1e-3 * noise)
    attributes: dict[str, str | int | float] = {
        "sceneName": scene.name, "sceneHash": scene.hash, "lightSamples": 64, "pixelSamples": 1,
        "seed": "0", "threads": 2, "sampler": "sobol", "software": f"Blender {HOSTILE}",
        "renderSeconds": 1.5, "parts": parts, "settings": json.dumps({"bounces": HOSTILE}),
    }  # fmt: skip
    write_exr(path, Image(images.mean(axis=0), images.var(axis=0, ddof=1) / parts, attributes))


@pytest.fixture(scope="session")
def page_file(inputs: Path, small_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page, of inputs in which a renderer and a region have hostile names too."""
    folder = tmp_path_factory.mktemp("report") / "build"
    shutil.copytree(inputs, folder)
    file = folder / "convergence" / "tp3.json"
    convergence = json.loads(file.read_text())
    for kind in ("curves", "slopes"):
        plain = next(
            row
            for row in convergence[kind]
            if (row["region"], row["pixel_samples"], row["against"]) == ("all", 1, "exact")
        )
        convergence[kind] += [plain | {"renderer": HOSTILE_LABEL}, plain | {"region": HOSTILE}]
    convergence["command"] = f"penumbra converge {HOSTILE}"
    file.write_text(json.dumps(convergence))
    out = folder / "report" / "index.html"
    build(folder, out, small_scenes)
    return out


@pytest.fixture(scope="session")
def french_file(page_file: Path, small_scenes: Path) -> Path:
    """The same in French."""
    out = page_file.with_name("fr.html")
    with speaking("fr"):
        build(page_file.parent.parent, out, small_scenes)
    return out


# The browser


@pytest.fixture(scope="module")  # two of Playwright's cannot live in one process
def browser() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


@pytest.fixture
def page(browser: Browser, page_file: Path) -> Iterator[Page]:
    """The page in a fresh tab; any complaint, request or dialog fails the test at its end."""
    tab = browser.new_page(viewport={"width": 1440, "height": 900})
    complaints: list[str] = []
    tab.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("dialog", lambda dialog: (complaints.append("dialog"), dialog.dismiss()))
    tab.on(
        "request",
        lambda request: (
            request.url.startswith(("data:", "blob:"))
            or request.url == page_file.as_uri()
            or complaints.append(f"request for {request.url[:80]}")
        ),
    )
    tab.goto(page_file.as_uri())
    _drawn(tab, 1)
    yield tab
    tab.close()
    assert complaints == []


def _drawn(tab: Page, at_least: int) -> None:
    """wait_for_function() would ask again by eval, which the page's policy forbids."""
    tab.evaluate(
        """n => new Promise(done => {
            const comparer = document.getElementById("comparer");
            const look = () => Number(comparer.dataset.drawn || 0) >= n
                ? done() : requestAnimationFrame(look);
            look();
        })""",
        at_least,
    )


def _act(tab: Page, action: Callable[[], Any]) -> None:
    """Do something to the comparer and wait until it is drawn anew."""
    before = int(tab.get_attribute("#comparer", "data-drawn") or 0)
    action()
    _drawn(tab, before + 1)


def _part(name: str) -> str:
    return f'#comparer [data-part="{name}"]'


def _choose(tab: Page, which: str, scene: str, label: str) -> None:
    group = f'{_part(which)} optgroup[label="scene {scene}"] option'
    options = tab.locator(group).all()
    value = next(o.get_attribute("value") for o in options if o.inner_text() == label)
    _act(tab, lambda: tab.select_option(_part(which), value))


def _key(tab: Page, key: str) -> None:
    tab.focus(_part("canvas"))
    _act(tab, lambda: tab.keyboard.press(key))


def _canvas(tab: Page) -> np.ndarray:
    """What the canvas shows, one value an image pixel at zoom 1. (H, W, 3) int."""
    size, data = tab.evaluate(
        """selector => {
            const c = document.querySelector(selector);
            const copy = new OffscreenCanvas(c.width, c.height);
            const context = copy.getContext('2d', { willReadFrequently: true });
            context.drawImage(c, 0, 0);
            const d = context.getImageData(0, 0, c.width, c.height).data;
            return [[c.height, c.width], Array.from(d)];
        }""",
        _part("canvas"),
    )
    pixels = np.array(data, dtype=int).reshape(*size, 4)[..., :3]
    each = size[0] // HEIGHT
    return pixels[each // 2 :: each, each // 2 :: each]


def _canvas_box(tab: Page) -> dict[str, float]:
    """Where the canvas is in the window, once it is scrolled there."""
    tab.locator(_part("canvas")).scroll_into_view_if_needed()
    box = tab.locator(_part("canvas")).bounding_box()
    assert box is not None
    return dict(box)


def _readout(tab: Page) -> np.ndarray:
    """The linear R, G, B of A, B and A - B. (3, 3)"""
    return np.array(
        [
            [float(tab.get_attribute(_part(f"{row}-{c}"), "data-value") or "nan") for c in "RGB"]
            for row in "abd"
        ]
    )


def _displayed(radiance: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """What the lab's output formula makes of half floats: min(1, max(0, x)) * 255, truncated."""
    halves = radiance.astype(np.float16).astype(np.float64)
    return np.floor(255 * np.clip(halves * exposure, 0, 1)).astype(int)


# The page as a document


class _Document(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.styles = ""
        self._in_style = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._in_style = tag == "style"

    def handle_data(self, data: str) -> None:
        self.styles += data if self._in_style else ""

    def handle_endtag(self, tag: str) -> None:
        self._in_style = False


def test_page_loads_nothing_from_elsewhere(page_file: Path) -> None:
    """Every src, href, url() and @import is a data: address or a place in the page itself."""
    document = _Document(page_file.read_text())
    loads = [
        value or ""
        for _, attributes in document.tags
        for name, value in attributes.items()
        if name in ("src", "srcset", "href", "xlink:href", "action", "poster", "data")
    ]
    loads += re.findall(r"url\(([^)]*)\)", document.styles)
    styles = [a.get("style") or "" for _, a in document.tags]
    loads += [url for style in styles for url in re.findall(r"url\(([^)]*)\)", style)]
    assert loads
    assert [x[:60] for x in loads if not x.startswith(("#", "data:", LESSON))] == []
    assert {tag for tag, a in document.tags if (a.get("href") or "").startswith(LESSON)} == {"a"}
    assert "@import" not in document.styles


def test_contents_are_the_sections_in_their_order(page_file: Path) -> None:
    """Those that are not optional, or whose input is shipped; each of the list has a template, and
    each template is one of the list's, of a page, or included."""
    tags = _Document(page_file.read_text()).tags
    shown = [str(a["id"]) for tag, a in tags if tag == "section"]
    kept = [s.name for s in SECTIONS if not s.optional or any(i.shipped for i in s.inputs)]
    assert shown == kept
    links = [str(a["href"])[1:] for tag, a in tags if tag == "a"]
    first = links.index(shown[0])
    assert links[first : first + len(shown)] == shown
    templates = {file.name.partition(".")[0] for file in TEMPLATES.glob("*.html.j2")}
    parts = {"page", "macros", "frame", "comparer", "check_page", "class_page", "class_sheet"}
    assert templates == {s.name for s in SECTIONS} | parts


def test_every_picture_has_a_text_alternative(page_file: Path) -> None:
    document = _Document(page_file.read_text())
    images = [a for tag, a in document.tags if tag == "img"]
    drawings = [a for tag, a in document.tags if tag == "svg"]
    assert images
    assert drawings
    assert [a for a in images if not a.get("alt")] == []
    named = ("aria-label", "aria-labelledby")
    assert [a for a in drawings if a.get("role") != "img" or not any(a.get(n) for n in named)] == []


def test_ids_are_unique_and_links_lead_to_them(page_file: Path) -> None:
    document = _Document(page_file.read_text())
    ids = [a["id"] for _, a in document.tags if a.get("id")]
    assert len(ids) == len(set(ids))
    targets = [
        str(value)[1:]
        for _, a in document.tags
        for name, value in a.items()
        if name in ("href", "xlink:href") and str(value).startswith("#")
    ]
    targets += [i for _, a in document.tags for i in (a.get("aria-labelledby") or "").split()]
    assert set(targets) <= set(ids)


def test_hostile_names_are_shown_and_not_run(page: Page) -> None:
    """The name closes a script element, starts another and holds an image that would run code:
    in a scene file, a program's version, Cycles' settings, a renderer, a region, a command."""
    assert page.title().startswith("Soft shadows")
    assert page.locator('img[src="x"]').count() == 0
    assert page.locator("script").count() == 3  # the comparer's images, the words, the viewer
    text = page.evaluate("document.body.textContent")
    assert text.count(HOSTILE) > 5
    assert HOSTILE_LABEL in text
    assert page.locator("i[onclick]").count() == 0


def test_page_states_the_numbers_of_its_inputs(page: Page, inputs: Path) -> None:
    """Slope, bias and speed-up on the page are those of the JSON files, rounded."""
    text = page.evaluate("document.body.textContent").replace("−", "-")
    convergence = json.loads((inputs / "convergence" / "tp3.json").read_text())
    slope = next(
        s
        for s in convergence["slopes"]
        if (s["region"], s["pixel_samples"], s["against"]) == ("all", 1, "exact")
    )
    assert f"{slope['slope']:.3f} [{slope['low']:.3f}, {slope['high']:.3f}]" in text
    agreement = json.loads((inputs / "agreement" / "tp3_c_exact.json").read_text())
    row = next(r for r in agreement["rows"] if r["region"] == "penumbra")
    low, high = 100 * row["relative_low"], 100 * row["relative_high"]
    assert f"{100 * row['relative_bias']:+.4f} [{low:+.4f}, {high:+.4f}]" in text
    for command in (convergence["command"], agreement["command"]):
        assert command.split()[-1] in text
    figure_4 = [image_file("tp3_statement", n) for n in LIGHT_SAMPLES]
    for item in [i for i in IMAGES if i.file in figure_4]:
        assert item.command in text
    speedup = json.loads((inputs / "speedup.json").read_text())
    assert f"{speedup['rows'][-1]['speedup']:#.3g}" in text


@pytest.mark.parametrize("lang", LANGUAGES)
def test_everyone_can_read_the_page(
    lang: str, page_file: Path, french_file: Path, browser: Browser
) -> None:
    """WCAG 2.2 AA as far as axe can tell, with everything unfolded, which the page's own policy
    would keep out; and only tables and commands scroll sideways, each in a box of its own."""
    file = {"en": page_file, "fr": french_file}[lang]
    context = browser.new_context(bypass_csp=True)
    tab = context.new_page()
    tab.goto(file.as_uri())
    _drawn(tab, 1)
    tab.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    for width in (320, 390, 1440):
        tab.set_viewport_size({"width": width, "height": 844})
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert section.barriers(tab) == []
    context.close()


def test_page_is_shorter_than_eighteen_screens(page: Page) -> None:
    """At 1280 x 1000: what explains is in the lesson, and what is long is folded."""
    page.set_viewport_size({"width": 1280, "height": 1000})
    assert page.evaluate("document.documentElement.scrollHeight") < 18_000


# In French


def test_every_text_of_the_report_is_translated() -> None:
    known = {m.id if isinstance(m.id, str) else m.id[0] for m in translated() if m.string}
    assert len(section.texts()) > 400
    assert sorted(section.texts() - known) == []


def test_the_french_page_says_nothing_in_english(page_file: Path, french_file: Path) -> None:
    """No piece of more than three words of any text; while the English page says many."""
    assert section.english_left(french_file.read_text()) == []
    assert len(section.english_left(page_file.read_text())) > 50
    assert '<html lang="fr">' in french_file.read_text()
    assert '<html lang="en">' in page_file.read_text()


def test_both_languages_state_the_same_numbers(page_file: Path, french_file: Path) -> None:
    """Every number of the text, of tables, captions and charts, once the decimal comma is undone;
    in tables in the same order."""

    def numbers(text: str) -> list[str]:
        return re.findall(r"\d+(?:\.\d+)?", re.sub(r"(?<=\d),(?=\d)", ".", text))

    english, french = (
        re.sub(r"<pre.*?</pre>", "", file.read_text(), flags=re.DOTALL)
        for file in (page_file, french_file)
    )
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", page, re.DOTALL) for page in (english, french)]
    shown = [[numbers(section.words_of(cell)) for cell in page] for page in cells]
    assert len(shown[0]) > 1000
    assert shown[0] == shown[1]


def test_french_numbers_have_a_decimal_comma(french_file: Path) -> None:
    """But for versions, and what is code."""
    page = re.sub(r'<(pre|code|dl class="plain").*?</(pre|code|dl)>', "", french_file.read_text())
    said = section.words_of(re.sub(r"<pre.*?</pre>", "", page, flags=re.DOTALL))
    told = [m.group() for m in re.finditer(r">[^<>]*<", said)]
    dotted = [text for text in told if re.search(r"(?<![\d.])\d+\.\d+(?![\d.])", text)]
    assert dotted == []
    assert sum(bool(re.search(r"\d,\d", text)) for text in told) > 500


def test_the_comparer_speaks_french(browser: Browser, french_file: Path) -> None:
    tab = browser.new_page()
    tab.goto(french_file.as_uri())
    _drawn(tab, 1)
    _key(tab, "ArrowRight")
    spoken = str(tab.text_content(_part("spoken")))
    assert re.search(r"pixel \(\d+, \d+\)\xa0: A .*\d,\d.*\xa0; B ", spoken)
    assert tab.inner_text(_part("split-value")) == "50\xa0%"
    assert str(tab.get_attribute(_part("canvas"), "aria-label")).endswith("côte à côte")
    _act(tab, lambda: tab.focus(_part("exposure")) or tab.keyboard.press("ArrowRight"))
    assert tab.inner_text(_part("exposure-value")) == "+0,5 IL (×1,41)"
    tab.close()


def test_links_to_the_lesson_lead_to_its_steps(page_file: Path, french_file: Path) -> None:
    """In the page's language; each step that something here is explained by."""
    for lang, file in (("en", page_file), ("fr", french_file)):
        steps = {step.anchor for step in read_lesson(TEXTS / f"{lang}.md", lang).steps}
        links = [str(a["href"]) for tag, a in _Document(file.read_text()).tags if tag == "a"]
        led = {link for link in links if not link.startswith("#")}
        assert led <= {f"{LESSON}?lang={lang}#{step}" for step in steps}
        assert len(led) >= 7


def test_lang_chooses_the_language_of_the_page(
    page_file: Path, small_scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scenes").symlink_to(small_scenes)
    monkeypatch.setattr("penumbra.cli.report.ROOT", tmp_path)
    out = tmp_path / "index.html"
    command = ["report", "--build", str(page_file.parent.parent), "-o", str(out)]
    assert main([*command, "--lang", "fr"]) == 0
    assert '<html lang="fr">' in out.read_text()


@pytest.mark.parametrize(
    "environment",
    [
        {"LANG": "fr_FR.UTF-8"},
        {"LANG": "de_DE.UTF-8"},
        {"LC_ALL": "C", "LANG": "fr"},
        {"LANGUAGE": "fr", "LC_ALL": "C"},
        {},
    ],
)
def test_make_speaks_as_the_program_does(environment: dict[str, str]) -> None:
    variables = ("LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG")
    others = {k: v for k, v in os.environ.items() if k not in (*variables, "MAKEFLAGS")}
    done = subprocess.run(
        ["make", "--print-data-base", "--question", "help"],
        cwd=ROOT, env=others | environment, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert f"SPOKEN := {of_environment(environment)}\n" in done.stdout


# The comparer


def test_flip_shows_a_then_b_as_the_lab_displays_them(page: Page, inputs: Path) -> None:
    """Each is its EXR clamped, times 255, truncated; the two differ by noise."""
    _choose(page, "a", "tp3_statement", "C, N = 4")
    _choose(page, "b", "tp3_statement", "C, N = 256")
    a, b = (read_image(inputs / image_file("tp3_statement", n)).radiance for n in (4, 256))
    _act(page, lambda: page.click(_part("flip")))
    assert np.array_equal(_canvas(page), _displayed(a))
    _act(page, lambda: page.click(_part("flip")))
    assert np.array_equal(_canvas(page), _displayed(b))
    assert not np.array_equal(_displayed(a), _displayed(b))


def test_split_follows_the_keyboard(page: Page, inputs: Path) -> None:
    """The slider, reached with Tab, goes from 50% to 61%: A is left of the line and B right.

    The canvas has three pixels a pixel of the image, so the line is at round(0.61 * 3 * 48)."""
    _choose(page, "a", "tp3_point", "C, N = 1")
    _choose(page, "b", "tp3_statement", "exact")
    a = read_image(inputs / image_file("tp3_point", 1)).radiance
    before = _canvas(page)
    page.focus('input[name="mode"]:checked')
    page.keyboard.press("Tab")  # the flip button
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.part") == "split"
    for key in ("ArrowRight", "PageUp"):
        _act(page, lambda key=key: page.keyboard.press(key))
    assert page.inner_text(_part("split-value")) == "61 %"
    after = _canvas(page)
    is_a = 3 * np.arange(WIDTH) + 1 < round(0.61 * 3 * WIDTH)
    assert np.array_equal(after[:, is_a], _displayed(a)[:, is_a])
    assert np.array_equal(after[:, ~is_a], before[:, ~is_a])
    assert not np.array_equal(after, before)


def test_dragging_moves_the_split(page: Page) -> None:
    box = _canvas_box(page)
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    _act(
        page,
        lambda: page.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 2),
    )
    page.mouse.up()
    assert page.input_value(_part("split")) == "25"


def test_values_under_the_pointer_are_the_images(page: Page, inputs: Path) -> None:
    """Within the rounding of a half float, and A - B is the difference of what is shown."""
    _choose(page, "a", "tp3", "C, N = 64")
    _choose(page, "b", "tp3", "Cycles")
    a = read_image(inputs / image_file("tp3", 64)).radiance
    b = read_image(inputs / "reference" / "tp3.exr").radiance
    box = _canvas_box(page)
    for x, y in ((3, 30), (24, 10), (40, 25), (47, 31)):
        px = box["x"] + (x + 0.5) / WIDTH * box["width"]
        py = box["y"] + (y + 0.5) / HEIGHT * box["height"]
        page.mouse.move(box["x"] + 1, box["y"] + 1)
        _act(page, lambda px=px, py=py: page.mouse.move(px, py))
        assert page.inner_text(_part("pixel")) == f"pixel ({x}, {y})"
        shown = _readout(page)
        assert np.allclose(shown[0], a[y, x], rtol=HALF, atol=1e-7)
        assert np.allclose(shown[1], b[y, x], rtol=HALF, atol=1e-7)
        assert np.allclose(shown[2], shown[0] - shown[1], rtol=0, atol=1e-12)


def test_arrow_keys_move_the_inspected_pixel_and_are_spoken(page: Page) -> None:
    """Right, down, then ten left; at the right and lower edge nothing moves further."""
    x, y = (int(v) for v in re.findall(r"\d+", page.inner_text(_part("pixel"))))
    for key in ("ArrowRight", "ArrowDown", "Shift+ArrowLeft"):
        _key(page, key)
    moved = f"pixel ({min(x + 1, WIDTH - 1) - 10}, {min(y + 1, HEIGHT - 1)})"
    assert page.inner_text(_part("pixel")) == moved
    assert f"{moved}: A " in (page.text_content(_part("spoken")) or "")


def test_one_stop_of_exposure_doubles(page: Page, inputs: Path) -> None:
    """A stop is two steps of the slider."""
    _choose(page, "a", "tp3", "C, N = 64")
    _key(page, "a")
    page.focus(_part("exposure"))
    for _ in range(2):
        _act(page, lambda: page.keyboard.press("ArrowLeft"))
    radiance = read_image(inputs / image_file("tp3", 64)).radiance
    assert np.array_equal(_canvas(page), _displayed(radiance, 0.5))
    for _ in range(4):
        _act(page, lambda: page.keyboard.press("ArrowRight"))
    assert np.array_equal(_canvas(page), _displayed(radiance, 2.0))
    assert "×2)" in page.inner_text(_part("exposure-value"))


def test_difference_of_equal_images_is_black_and_of_others_is_not(page: Page) -> None:
    _choose(page, "a", "tp3", "exact")
    _choose(page, "b", "tp3", "exact")
    _key(page, "d")
    assert not _canvas(page).any()
    _choose(page, "a", "tp3", "C, N = 4")
    assert _canvas(page).any()


def test_difference_is_orange_where_a_is_brighter_and_scaled_by_the_gain(
    page: Page, inputs: Path
) -> None:
    """min(1, gain * |mean over channels of A - B|) of the colour, orange or blue."""
    _choose(page, "a", "tp3", "C, N = 4")
    _choose(page, "b", "tp3", "C, N = 64")
    _key(page, "d")
    page.focus(_part("gain"))
    _act(page, lambda: page.keyboard.press("ArrowLeft"))
    a, b = (
        read_image(inputs / image_file("tp3", n)).radiance.astype(np.float16).astype(np.float64)
        for n in (4, 64)
    )
    difference = 8 * (a - b).mean(axis=-1, keepdims=True)
    colour = np.where(difference > 0, [255, 160, 40], [90, 150, 255])
    expected = colour * np.minimum(1, np.abs(difference))
    assert np.abs(_canvas(page) - expected).max() <= 0.5 + 1e-3  # rounded to a level
    assert "×8" in page.inner_text(_part("gain-value"))


def test_zoom_keeps_pixels_sharp_and_the_inspected_one_in_place(page: Page, inputs: Path) -> None:
    """Zoom 2 about pixel (24, 16) of 48x32: the view would start at 24.5 - 24.5 / 2 = 12.25 and
    16.5 - 16.5 / 2 = 8.25, and starts on the next half, 12.5 and 8.5, where screen pixels are."""
    box = _canvas_box(page)
    _act(
        page,
        lambda: page.mouse.click(
            box["x"] + box["width"] * 24.5 / WIDTH, box["y"] + box["height"] * 16.5 / HEIGHT
        ),
    )
    _choose(page, "a", "tp3", "C, N = 64")
    _key(page, "a")
    whole = _canvas(page)
    _key(page, "+")
    assert page.inner_text(_part("zoom-value")) == "×2"
    zoomed = _canvas(page)
    columns = np.floor(12.5 + (np.arange(WIDTH) + 0.5) / 2).astype(int)
    rows = np.floor(8.5 + (np.arange(HEIGHT) + 0.5) / 2).astype(int)
    assert np.array_equal(zoomed, whole[rows][:, columns])
    _key(page, "-")
    assert np.array_equal(_canvas(page), whole)


def test_links_in_the_text_open_their_pair(page: Page) -> None:
    _act(page, lambda: page.click("#figure-1 a.compare"))
    assert "C, N = 1" in page.inner_text(f"{_part('a')} option:checked")
    assert page.evaluate("document.activeElement.dataset.part") == "canvas"
    assert page.is_checked('input[name="mode"][value="a"]')


def test_every_control_is_reached_with_tab_and_shows_its_focus(page: Page) -> None:
    """From A's list to the zoom buttons; each, or what stands for it, is outlined."""
    wanted = {"a", "swap", "b", "canvas", "flip", "split", "exposure", "zoom-out", "zoom-in"}
    page.focus(_part("a"))
    page.keyboard.press("Shift+Tab")
    seen, outlined = set(), True
    for _ in range(14):
        page.keyboard.press("Tab")
        part, visible = page.evaluate(
            """() => {
                const e = document.activeElement;
                const near = [e, e.nextElementSibling, e.closest('.stage')].filter(Boolean);
                return [e.dataset.part || e.name || '',
                        near.some((n) => getComputedStyle(n).outlineStyle === 'solid')];
            }"""
        )
        if part in wanted | {"mode"}:
            seen.add(part)
            outlined = outlined and visible
    assert wanted | {"mode"} <= seen
    assert outlined


def test_images_of_two_sizes_flip_but_do_not_split(
    inputs: Path, small_scenes: Path, browser: Browser, tmp_path: Path
) -> None:
    """A Cycles reference of half the size, as the repository ships: the page is made, and the
    comparer says why it does not split."""
    folder = tmp_path / "build"
    shutil.copytree(inputs, folder)
    image = read_image(folder / "reference" / "tp3.exr")
    assert image.variance is not None
    half = Image(image.radiance[::2, ::2], image.variance[::2, ::2], image.attributes)
    write_exr(folder / "reference" / "tp3.exr", half)
    (folder / "agreement" / "tp3_c_cycles.json").unlink()
    build(folder, tmp_path / "index.html", small_scenes)
    tab = browser.new_page()
    tab.goto((tmp_path / "index.html").as_uri())
    _drawn(tab, 1)
    _choose(tab, "a", "tp3", "C, N = 4")
    _choose(tab, "b", "tp3", "Cycles")
    assert tab.is_disabled('input[name="mode"][value="split"]')
    assert "differ in size" in tab.inner_text(_part("note"))
    tab.close()


# Inputs that cannot be used


@pytest.mark.parametrize("file", [i.file for i in INPUTS if i.needed])
def test_missing_input_is_named_with_the_command_that_makes_it(
    file: str, inputs: Path, small_scenes: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "build"
    shutil.copytree(inputs, folder, copy_function=os.link)
    (folder / file).unlink()
    command = next(i.command for i in INPUTS if i.file == file)
    with pytest.raises(ReportError) as caught:
        build(folder, folder / "index.html", small_scenes)
    assert str(folder / file) in str(caught.value)
    assert command in str(caught.value)
    assert not (folder / "index.html").exists()


@pytest.mark.parametrize(
    "file", ["convergence/tp3.json", "agreement/tp3_c_exact.json", "images/tp3_n64_m1.exr"]
)
@pytest.mark.parametrize("content", [b"", b"{}", b"[1, 2", b"\x00\xff\xfe"])
def test_broken_input_is_named(
    file: str, content: bytes, inputs: Path, small_scenes: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "build"
    shutil.copytree(inputs, folder)
    (folder / file).write_bytes(content)
    with pytest.raises(ReportError, match=re.escape(file)):
        build(folder, folder / "index.html", small_scenes)


def test_image_of_another_scene_is_refused(
    inputs: Path, small_scenes: Path, tmp_path: Path
) -> None:
    """The point light's image under the quad light's name."""
    folder = tmp_path / "build"
    shutil.copytree(inputs, folder)
    shutil.copy(folder / image_file("tp3_point", 1), folder / image_file("tp3", 64))
    with pytest.raises(ReportError, match=r"tp3_n64_m1\.exr: shows a scene of hash"):
        build(folder, folder / "index.html", small_scenes)


def test_command_line_reports_a_missing_input_with_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", "--build", str(tmp_path)]) == 2
    assert IMAGES[0].command in capsys.readouterr().err


# Pictures


def test_crop_holds_the_most_of_what_matters() -> None:
    """A 3x2 blob in a 20x10 image: a 4x3 window covers all of it."""
    interest = np.zeros((10, 20))
    interest[4:6, 11:14] = 1
    crop = figures.crop_around(interest, 4, 3)
    assert (crop.width, crop.height) == (4, 3)
    assert crop.of(interest).sum() == 6


def test_crop_never_leaves_the_image() -> None:
    for x, y in ((0, 0), (19, 9), (0, 9), (19, 0)):
        interest = np.zeros((10, 20))
        interest[y, x] = 1
        crop = figures.crop_around(interest, 5, 4)
        assert crop.of(interest).shape == (4, 5)
        assert crop.of(interest).sum() == 1


def test_light_in_the_umbra_is_an_infinite_relative_difference() -> None:
    """0 against 0 is 0; anything against 0 is infinite, and is drawn in the end colour."""
    reference = np.array([[[0.0] * 3, [0.0] * 3, [1.0] * 3]])
    image = np.array([[[0.0] * 3, [0.1] * 3, [1.5] * 3]])
    values = figures.relative_difference(image, reference)
    assert values.tolist() == [[0.0, np.inf, 0.5]]
    colours = figures.diverging_map(values, 0.5, np.zeros((1, 3), dtype=bool))
    assert np.array_equal(colours[0, 1], colours[0, 2])
    assert not np.array_equal(colours[0, 0], colours[0, 1])


def test_chart_text_is_escaped_and_without_mathematics() -> None:
    series = figures.Series("<b>$a_1$</b>", "mine", [1, 2, 4], [1.0, 0.7, 0.5])
    svg = figures.convergence_chart("c", 'a "b" <c>', [series], figures.styles(["mine"]), "N", 2)
    assert "&lt;b&gt;$a_1$&lt;/b&gt;" in svg
    assert 'aria-label="a &#34;b&#34; &lt;c&gt;"' in svg
    assert "<b>" not in svg
