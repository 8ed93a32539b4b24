"""The class page and the students' sheets: they say what grades.json says, to whom it may be said,
to every reader and on every screen and paper. The class is made up (tests/made_up.py)."""

from __future__ import annotations

import html as escapes
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from playwright.sync_api import Browser, BrowserContext, Dialog, Page, expect

from penumbra.compare.check.catalogue import catalogue
from penumbra.compare.check.explanation import observations, title
from penumbra.compare.check.words import WORDS
from penumbra.report.class_page import file_names, write_class
from tests import made_up, section
from tests.made_up import PROBLEM, found, grades, submission

COUNT = 40
OBSERVED = observations(found("wrong", ("area_omitted",)))
WIDTHS = (1280, 375, 320)
HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "line\nbreak\ttab",
    "\u202egnp.exe",
    "../../etc/passwd",
    "{{ 7 * 7 }}",
    "x" * 255,
    "👩\u200d🔬 Zoë 🙂",
    "زينب",
    "&amp;lt;",
    "\udc80 not UTF-8",
    "CON",
)
SIGNS = {"shown": "✓", "refuted": "✕", "cannot tell": "?", "missing": "–"}
CONTRAST = """() => {
  const canvas = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });
  const rgb = (colour) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1);
    return canvas.getImageData(0, 0, 1, 1).data;
  };
  const luminance = (colour) => [0.2126, 0.7152, 0.0722].reduce((sum, weight, i) => {
    const c = rgb(colour)[i] / 255;
    return sum + weight * (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  }, 0);
  const backed = (e) => {
    while (e && rgb(getComputedStyle(e).backgroundColor)[3] < 255) e = e.parentElement;
    return e ? getComputedStyle(e).backgroundColor : 'white';
  };
  const worst = {};
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.checkVisibility() || e.closest('option, noscript, script')) continue;
    const [a, b] = [luminance(getComputedStyle(e).color), luminance(backed(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) worst[e.className + ': ' + e.textContent.slice(0, 40)] = ratio;
  }
  return worst;
}"""
"""WCAG 2.2, 1.4.3: text whose contrast with what is behind it is below 4.5"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with section.browser() as started:
        yield started


@pytest.fixture(scope="module")
def room() -> dict[str, Any]:
    """With two that handed in the same"""
    last = submission("Zimmermann Ève", failed=True)
    made = grades([*made_up.students(COUNT - 1), last])
    first, second = (s for s in made["submissions"][:2])
    first["same_as"], second["same_as"] = [second["id"]], [first["id"]]
    return made


@pytest.fixture(scope="module")
def folder(room: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("class")
    write_class(out, room)
    return out


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a whole class has names like these, and pictures and problems too."""
    out = tmp_path_factory.mktemp("hostile") / "out"
    made = [submission(name, ("area_omitted",), pictures=(name,)) for name in HOSTILE]
    made[0]["problem"], made[0]["status"] = {"code": "crashed", "text": HOSTILE[1]}, "failed"
    made[1]["facts"], made[1]["text"] = [HOSTILE[0]], f"WRONG\n\n{HOSTILE[0]}\n"
    for claim in made[2]["claims"]:
        claim["why"] = HOSTILE[1]
    write_class(out, grades(made))
    return out


@pytest.fixture
def page(browser: Browser, folder: Path) -> Iterator[Page]:
    with_complaints: list[str] = []
    tab = opened(
        browser.new_context(viewport={"width": 1280, "height": 900}), folder, with_complaints
    )
    yield tab
    tab.context.close()
    assert with_complaints == []


def opened(
    context: BrowserContext, folder: Path, complaints: list[str], name: str = "index.html"
) -> Page:
    """A page in a tab of its own; complaints, requests and dialogs are noted."""
    tab = context.new_page()
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))

    def dismiss(dialog: Dialog) -> None:
        complaints.append("dialog")
        dialog.dismiss()

    tab.on("dialog", dismiss)
    file = folder / name
    own = ("data:", file.as_uri())
    tab.on("request", lambda r: None if r.url.startswith(own) else complaints.append(r.url[:80]))
    tab.goto(file.as_uri())
    return tab


def shown(tab: Page) -> list[str]:
    """Names in the rows that are not filtered out, as they stand."""
    return tab.locator("#class tbody:not([hidden]) th bdi").all_inner_texts()


def sheet_of(folder: Path, name: str) -> str:
    return (folder / "sheets" / file_names([name])[name]).read_text()


def body(page: str) -> str:
    return page[page.index("<body") :]


# The page


def test_page_says_which_mistakes_the_class_makes_and_how_often(
    page: Page, room: dict[str, Any]
) -> None:
    bars = page.locator(".bars button")
    wanted = [(m["title"], str(len(m["submissions"]))) for m in room["mistakes"]]
    renamed = [(t.replace("unknown", "not in the catalogue"), n) for t, n in wanted]
    page.eval_on_selector_all("main > details", "all => all.forEach(d => d.open = true)")
    assert [tuple(b.inner_text().split("\n")) for b in bars.all()] == renamed
    counts = Counter(
        "failed" if s["status"] == "failed" else s["verdict"] for s in room["submissions"]
    )
    assert len(counts) == 4
    tiles = dict(t.inner_text().split("\n")[::-1] for t in page.locator(".tiles button").all())
    assert {k.split(" ", 1)[1].strip(): int(v) for k, v in tiles.items()} == counts


def test_page_lists_what_the_instructor_must_look_at(page: Page, room: dict[str, Any]) -> None:
    """Who could not be judged, who handed in the same, and what cannot be told of whom."""
    page.eval_on_selector_all("#look details", "all => all.forEach(d => d.open = true)")
    text = page.inner_text("#look")
    failed = [s for s in room["submissions"] if s["status"] == "failed"]
    assert failed
    for s in failed:
        assert f"{s['id']}: {PROBLEM['text']}" in text
    assert "The very same bytes" in text
    groups = page.locator("#look details").all()
    said = [g.locator("summary").inner_text() for g in groups]
    wanted: dict[tuple[str, ...], list[str]] = {}
    judged = [s for s in room["submissions"] if s not in failed]
    for claim in room["rubric"]["claims"]:
        names = tuple(s["id"] for s in judged if claim["id"] in s["for_instructor"])
        wanted.setdefault(names, []).append(claim["title"])
    assert said == [f"{len(names)}: {'; '.join(titles)}" for names, titles in wanted.items()]
    assert [tuple(g.locator("bdi").all_inner_texts()) for g in groups] == list(wanted)


def test_a_row_opens_to_what_its_verdict_rests_on(page: Page, room: dict[str, Any]) -> None:
    s = next(s for s in room["submissions"] if s["mistakes"] and s["mistakes"] != ["unknown"])
    row = page.locator("#class tbody", has=page.locator("bdi", has_text=s["id"])).first
    assert not row.locator(".evidence").is_visible()
    closed = row.inner_text()
    for said in (s["id"], "wrong", *s["titles"], f"{s['points']} of {s['of']}"):
        assert said in closed
    claims = row.locator("td.claim")
    assert claims.all_inner_texts() == [f"{SIGNS[c['state']]} {c['points']}" for c in s["claims"]]
    said = [c.locator("[role=img]").get_attribute("aria-label") for c in claims.all()]
    assert said == [c["state"] for c in s["claims"]]
    assert row.locator("img").count() == len(s["pictures"])
    row.locator("summary").click()
    opened = row.locator(".evidence").inner_text()
    runner = title("area_halved")
    for said in (s["headline"], *OBSERVED, runner, *s["facts"], *(c["why"] for c in s["claims"])):
        assert said in opened
    link = row.locator(".evidence a").get_attribute("href")
    assert link is not None and unquote(link) == f"sheets/{file_names([s['id']])[s['id']]}"


def test_every_column_sorts_both_ways_and_says_so(page: Page) -> None:
    heads = page.locator("#class thead th")
    assert heads.count() == 5 + len(made_up.RUBRIC)
    for column in range(heads.count()):
        keys = []
        for direction in ("ascending", "descending"):
            heads.nth(column).locator("button").click()
            sorts = [h.get_attribute("aria-sort") for h in heads.all()]
            assert sorts == [direction if i == column else None for i in range(len(sorts))]
            title = heads.nth(column).inner_text().replace("\n", " ").strip()
            assert page.inner_text("#state").endswith(f", by {title}, {direction}")
            keys.append(
                page.eval_on_selector_all(
                    "#class tbody", f"all => all.map(b => b.rows[0].cells[{column}].dataset.key)"
                )
            )
        if heads.nth(column).get_attribute("data-numeric") is not None:
            assert [float(k) for k in keys[0]] == sorted(float(k) for k in keys[0])
            assert [float(k) for k in keys[1]] == sorted((float(k) for k in keys[1]), reverse=True)
        else:
            there = [[_folded(k) for k in each if k] for each in keys]
            assert there[0] == sorted(there[0]) and there[1] == sorted(there[1], reverse=True)
            assert all(k == "" for each in keys for k in each[len(there[0]) :])  # these come last
        assert len(set(keys[0])) > 1 or column > 4 or column == 3


def _folded(text: str) -> str:
    """As a dictionary sorts: accents and case do not matter."""
    letters = unicodedata.normalize("NFD", text)
    return "".join(c for c in letters if not unicodedata.combining(c)).casefold()


def test_a_tie_keeps_the_order_of_the_sort_before(page: Page, room: dict[str, Any]) -> None:
    page.get_by_role("button", name="Points").click()
    page.get_by_role("button", name="Verdict", exact=True).click()
    order = ["wrong", "failed", "cannot tell", "right"]
    by_id = {s["id"]: s for s in room["submissions"]}
    keys = [
        (order.index("failed" if s["status"] == "failed" else s["verdict"]), s["points"])
        for s in (by_id[name] for name in shown(page))
    ]
    assert keys == sorted(keys) and len(keys) == COUNT


def test_filters_by_mistake_verdict_and_name_work_together(
    page: Page, room: dict[str, Any]
) -> None:
    common = room["mistakes"][0]
    bar = page.locator(f'.bars [data-mistake="{common["name"]}"]')
    bar.click()
    assert shown(page) == common["submissions"]
    assert page.inner_text("#state") == (
        f"{len(common['submissions'])} of {COUNT} submissions: {common['title']}"
    )
    assert bar.get_attribute("aria-pressed") == "true"
    bar.click()
    assert len(shown(page)) == COUNT and bar.get_attribute("aria-pressed") == "false"

    page.locator('.tiles [data-verdict="right"]').click()
    right = [s["id"] for s in room["submissions"] if s["verdict"] == "right"]
    assert shown(page) == right and page.input_value("[name=verdict]") == "right"

    page.fill("[name=text]", "ELISE ")  # Élise
    found = [name for name in right if "Élise" in name]
    assert found and shown(page) == found
    page.fill("[name=text]", "nobody")
    assert shown(page) == [] and page.inner_text("#state").startswith(f"0 of {COUNT}")
    page.get_by_role("button", name="Show all").click()
    expect(page.locator("#class tbody:not([hidden])")).to_have_count(COUNT)
    assert page.inner_text("#state") == f"{COUNT} of {COUNT} submissions"
    assert page.get_attribute("#state", "role") == "status"


def test_a_link_shows_the_row_though_it_was_filtered_out(page: Page, room: dict[str, Any]) -> None:
    name = next(s["id"] for s in room["submissions"] if s["status"] == "failed")
    page.locator('.tiles [data-verdict="right"]').click()
    assert name not in shown(page)
    page.locator(".todo a", has_text=name).first.click()
    row = page.locator("#class tbody", has=page.locator("bdi", has_text=name)).first
    row.locator(".evidence").wait_for(state="visible")
    assert PROBLEM["text"] in row.inner_text()


def test_the_keyboard_alone_sorts_filters_and_opens_and_shows_where_it_is(
    page: Page, room: dict[str, Any]
) -> None:
    def tab_to(wanted: str) -> None:
        for _ in range(400):
            page.keyboard.press("Tab")
            if page.evaluate(f"document.activeElement.matches({wanted!r})"):
                break
        else:
            pytest.fail(f"no Tab leads to {wanted}")
        style = page.evaluate("getComputedStyle(document.activeElement).outline")
        assert "solid" in style and "3px" in style, wanted

    tab_to('.tiles [data-verdict="wrong"]')
    page.keyboard.press("Enter")
    wrong = [s["id"] for s in room["submissions"] if s["verdict"] == "wrong"]
    assert shown(page) == wrong
    tab_to("[name=text]")
    page.keyboard.type("a")
    assert shown(page) == [name for name in wrong if "a" in _folded(name)]
    tab_to("#class thead th:nth-child(1) button")
    page.keyboard.press("Space")
    page.keyboard.press("Enter")
    assert page.get_attribute("#class thead th", "aria-sort") == "descending"
    tab_to("#class tbody summary")
    page.keyboard.press("Enter")
    assert page.locator(".evidence:visible").count() == 1
    tab_to(".evidence a")


def test_without_javascript_every_row_is_there_and_opens(
    browser: Browser, folder: Path, room: dict[str, Any]
) -> None:
    complaints: list[str] = []
    context = browser.new_context(java_script_enabled=False)
    tab = opened(context, folder, complaints)
    assert shown(tab) == [s["id"] for s in room["submissions"]]
    assert not tab.locator("#filters").is_visible()
    assert tab.locator("button:enabled:visible").count() == 0
    assert tab.get_by_text("need JavaScript").is_visible()
    tab.locator("#class summary").nth(3).click()
    assert tab.locator(".evidence:visible").count() == 1
    context.close()
    assert complaints == []


def test_three_hundred_rows_sort_and_filter_quickly(browser: Browser, tmp_path: Path) -> None:
    """In less than a second of the processor each, which a busy machine does not change."""
    write_class(tmp_path, grades(made_up.students(300)))
    complaints: list[str] = []
    tab = opened(browser.new_context(viewport={"width": 1280, "height": 900}), tmp_path, complaints)
    session = tab.context.new_cdp_session(tab)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent() -> float:
        metrics = session.send("Performance.getMetrics")["metrics"]
        return next(m["value"] for m in metrics if m["name"] == "ThreadTime")

    def act(script: str) -> float:
        before = spent()
        tab.evaluate(f"() => {{ {script}; return document.body.offsetHeight; }}")
        return spent() - before

    sort = "document.querySelectorAll('#class thead button')[%d].click()"
    write = (
        "const f = document.getElementById('filters');"
        "f.text.value = '%s'; f.dispatchEvent(new Event('input'))"
    )
    seconds = [act(sort % column) for column in (0, 2, 4)] + [act(write % t) for t in ("ab", "")]
    assert len(shown(tab)) == 300
    assert max(seconds) < 1 and sum(seconds) > 0
    tab.context.close()
    assert complaints == []


# Everybody's eyes and screens


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_contrast_in_light_and_dark(scheme: Any, browser: Browser, folder: Path) -> None:
    complaints: list[str] = []
    context = browser.new_context(color_scheme=scheme, reduced_motion="reduce")
    for name in ("index.html", "sheets.html"):
        tab = opened(context, folder, complaints, name)
        tab.eval_on_selector_all("details", "all => all.slice(0, 60).forEach(d => d.open = true)")
        assert tab.evaluate(CONTRAST) == {}
        paper = tab.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (int(re.findall(r"\d+", paper)[0]) < 128) == (scheme == "dark")
        assert tab.evaluate("getComputedStyle(document.documentElement).scrollBehavior") == "auto"
    context.close()
    assert complaints == []


def test_axe_finds_nothing(browser: Browser, folder: Path) -> None:
    context = browser.new_context(bypass_csp=True)
    for name in ("index.html", "sheets.html"):
        tab = opened(context, folder, [], name)
        tab.eval_on_selector_all("details", "all => all.slice(0, 20).forEach(d => d.open = true)")
        assert section.barriers(tab) == [], name
    context.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_pages_fit_phone_and_desk(
    width: int, browser: Browser, folder: Path, hostile: Path
) -> None:
    """With every row open, and names of 255 letters."""
    context = browser.new_context(viewport={"width": width, "height": 800})
    for where in (folder, hostile):
        for name in ("index.html", "sheets.html"):
            tab = opened(context, where, [], name)
            tab.eval_on_selector_all("details", "all => all.forEach(d => d.open = true)")
            assert tab.evaluate("document.documentElement.scrollWidth") <= width, (where, name)
            tab.close()
    context.close()


def test_signs_are_words_and_symbols_and_not_colours_alone(page: Page) -> None:
    """Of claims, symbols that have a name for who hears them."""
    for text in page.locator("#class td:nth-child(2)").all_inner_texts():
        assert re.fullmatch(r"[✕!?✓]\s+(wrong|failed|cannot tell|right)", text)
    for text in page.locator("#class td.claim").all_inner_texts():
        assert re.fullmatch(r"[✕–?✓] \d+", text)
    signs = page.eval_on_selector_all(
        "#class td.claim [role=img]", "all => all.map(e => [e.ariaLabel, e.textContent])"
    )
    assert len(signs) == COUNT * len(made_up.RUBRIC) and {tuple(s) for s in signs} == set(
        SIGNS.items()
    )
    assert page.locator("img:not([alt])").count() == 0


# Names that are meant to harm


def test_hostile_names_are_shown_and_not_run(browser: Browser, hostile: Path) -> None:
    complaints: list[str] = []
    context = browser.new_context()
    for name in ("index.html", "sheets.html"):
        tab = opened(context, hostile, complaints, name)
        scripts = tab.locator("script").count()
        assert scripts == (1 if name == "index.html" else 0)
        assert tab.locator("img[src=x], [onerror]").count() == 0
        names = tab.locator("th bdi, h1 bdi").all_inner_texts()
        assert len(set(names)) == len(HOSTILE)
        for plain in (HOSTILE[0], HOSTILE[1], HOSTILE[4], HOSTILE[5], HOSTILE[6], HOSTILE[8]):
            assert plain in names
        assert {"line⟨U+000A⟩break⟨U+0009⟩tab", "⟨U+202E⟩gnp.exe"} <= set(names)
        assert not [n for n in names if "\u202e" in n]
        tab.close()
    context.close()
    assert complaints == []


def test_a_script_that_got_into_the_page_would_not_run(
    browser: Browser, folder: Path, tmp_path: Path
) -> None:
    """The policy allows the page's own script by its hash, and none in a sheet."""
    for name in ("index.html", "sheets.html"):
        page = (folder / name).read_text()
        attack = '<body onload="document.title=1"><script>document.title = "owned"</script>'
        (tmp_path / name).write_text(page.replace("<body>", attack))
        context = browser.new_context()
        tab = opened(context, tmp_path, [], name)
        assert "Soft shadows" in tab.title()
        context.close()


def test_every_student_has_a_file_inside_the_folder(hostile: Path) -> None:
    files = sorted((hostile / "sheets").iterdir())
    assert len(files) == len(HOSTILE) and all(f.is_file() for f in files)
    assert sorted(f.name for f in hostile.iterdir()) == ["index.html", "sheets", "sheets.html"]
    assert sorted(f.name for f in hostile.parent.iterdir()) == ["out"]
    for file in files:
        assert re.fullmatch(r"[\w-][\w.-]*\.html", file.name)
        assert len(file.name.encode()) < 200


def test_names_that_come_to_the_same_file_are_told_apart() -> None:
    """Also by who chooses a name that looks like another's file, or differs in case alone."""
    first = ["a b", "a/b", "A_B", "é", "e\u0301", "", "..", "x" * 300, "x" * 301]
    taken = [Path(name).stem for name in file_names(first).values()]
    ids = [*first, *taken, "con", "Con.txt"]
    names = file_names(ids)
    assert len({name.casefold() for name in names.values()}) == len(ids)
    assert not [n for n in names.values() if re.match(r"con\.", n, re.IGNORECASE)]
    assert names == file_names(ids[::-1])


# The sheets


def test_a_sheet_with_hint_0_says_points_and_results_only(tmp_path: Path) -> None:
    """Not even in what is not seen; with the highest hint the same student reads all of it."""
    mistakes = ("no_light_cosine", "area_omitted")
    for hint in (0, 3):
        made = [submission("Marie", mistakes, 3), submission("Jean", ("black",), 3)]
        write_class(tmp_path, grades(made, hint))
        whole = sheet_of(tmp_path, "Marie")
        sheet = escapes.unescape(body(whole))
        assert WORDS["wrong"] in sheet and "10 of 20" in re.sub(r"</?b>", "", sheet)
        known = [catalogue().mistakes[name] for name in mistakes]
        told = [m.title for m in known] + [m.cause for m in known] + OBSERVED
        told += [made_up.FACT, "Your pictures show"]
        for said in told:
            assert (said in sheet) == (hint == 3), said
        assert not [name for name in mistakes if name in whole]
        assert (
            "<!--" not in whole
            and not re.search(r"\shidden|data-", sheet)
            and "<script" not in whole
        )
        assert "Jean" not in whole and "Marie" in whole
        if hint == 0:
            assert not [m.title for m in catalogue().mistakes.values() if m.title in sheet]
            every = escapes.unescape(body((tmp_path / "sheets.html").read_text()))
            assert not [said for said in told if said in every]


def test_a_sheet_with_hint_1_says_where_to_look_and_no_mistake(folder: Path, room: Any) -> None:
    wrong = [s for s in room["submissions"] if s["verdict"] == "wrong"]
    assert wrong
    for s in wrong:
        whole = sheet_of(folder, s["id"])
        sheet = escapes.unescape(body(whole))
        for line in s["text"].split("\n"):
            assert line.strip() in sheet
        assert not [m.title for m in catalogue().mistakes.values() if m.title in sheet]
        assert not [said for said in OBSERVED if said in sheet]
        others = [o["id"] for o in room["submissions"] if o["id"] != s["id"]]
        assert not [name for name in others if name in whole]


@pytest.mark.parametrize("hint", range(4))
def test_the_museum_of_mistakes_is_linked_to_whom_it_may_be(hint: int, tmp_path: Path) -> None:
    """The instructor's page always, a sheet where it names the mistake; none if it is nowhere."""
    mistakes = ("no_light_cosine", "area_omitted")
    made = [submission("Marie", mistakes, hint), submission("Jean", ("unknown",), hint)]
    course = "https://example.org/course/"
    write_class(tmp_path, grades(made, hint), course)
    links = {f'href="{course}#mistake-{name}"' for name in mistakes}
    pages = {f: f.read_text() for f in tmp_path.rglob("*.html")}
    for file, html in pages.items():
        told = file.name == "index.html" or (hint >= 2 and file.name != "Jean.html")
        linked = set(re.findall(r'href="[^"]*#mistake-[^"]*"', html))
        assert linked == (links if told else set()), file
        assert course in html or not told
    write_class(tmp_path, grades(made, hint))
    assert not [f for f in pages if "#mistake-" in f.read_text()]


def test_a_sheets_points_are_a_sum_that_can_be_read(folder: Path, room: dict[str, Any]) -> None:
    for s in room["submissions"]:
        sheet = escapes.unescape(re.sub(r"<[^>]*>", "", body(sheet_of(folder, s["id"]))))
        points = [c["points"] for c in s["claims"]]
        assert f"{' + '.join(map(str, points))} ={s['points']} of {s['of']}" in sheet
        assert sum(points) == s["points"]
        for claim in s["claims"]:
            assert claim["title"] in sheet and f"{claim['points']} of {claim['of']}" in sheet
        if s["status"] == "failed":
            assert sheet.count(PROBLEM["text"]) == 1


def test_what_a_program_printed_is_shown_to_both(tmp_path: Path) -> None:
    """Line by line; of a sheet the last ones only, that it stays a page."""
    made = submission("crashed", failed=True)
    lines = [f"main.c:{i}: error: '{HOSTILE[0]}'" for i in range(100)]
    made["problem"] = {
        "code": "build_failed",
        "text": "Its build failed.",
        "printed": "\n".join(lines),
    }
    write_class(tmp_path, grades([made], 0))
    for page, first in (
        ((tmp_path / "index.html").read_text(), 0),
        (sheet_of(tmp_path, "crashed"), 80),
    ):
        printed = re.search(r"<pre[^>]*>(.*?)</pre>", page, re.DOTALL)
        assert printed is not None
        assert escapes.unescape(printed[1]).split("\n") == lines[first:]


def test_a_sheet_is_one_page_of_a4(browser: Browser, tmp_path: Path) -> None:
    """Also with two mistakes told in full and a dozen pictures; all sheets have a page each."""
    pictures = tuple(f"n{4**i:03d}_m{m}.png" for i in range(6) for m in (1, 4))
    made = [
        submission("long", ("no_light_cosine", "area_omitted"), 3, pictures=pictures),
        submission("short", (), 3),
        submission("failed", failed=True),
    ]
    write_class(tmp_path, grades(made, 3))
    context = browser.new_context(color_scheme="dark")
    for name, pages in (("sheets/long.html", 1), ("sheets.html", 3)):
        tab = opened(context, tmp_path, [], name)
        printed = tab.pdf(prefer_css_page_size=True)
        assert len(re.findall(rb"/Type\s*/Page\b", printed)) == pages
        size = re.search(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", printed)
        assert size is not None
        assert [round(float(n) * 25.4 / 72) for n in size.groups()] == [210, 297]
        tab.emulate_media(media="print")
        assert (
            tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        )
    context.close()


def test_sheets_of_an_earlier_run_go_and_other_files_stay(tmp_path: Path) -> None:
    write_class(tmp_path, grades([submission("stays"), submission("leaves")]))
    other = tmp_path / "sheets" / "notes.html"
    other.write_text("<p>my notes")
    write_class(tmp_path, grades([submission("stays")]))
    names = {f.name for f in (tmp_path / "sheets").iterdir()}
    assert names == {"stays.html", "notes.html"}


def test_a_class_of_nobody_is_a_page_too(browser: Browser, tmp_path: Path) -> None:
    write_class(tmp_path, grades([]))
    complaints: list[str] = []
    context = browser.new_context()
    tab = opened(context, tmp_path, complaints)
    assert tab.inner_text("#state") == "0 of 0 submissions"
    assert "No mistake was named." in tab.inner_text("main")
    context.close()
    assert complaints == []
