"""The report's section on floats: drawn for what was measured, and safe whatever it says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from penumbra.compare.studies.stability import study
from penumbra.report.inputs import ReportError
from penumbra.report.stability import CAUSES
from penumbra.report.words import digits, power, signed_power
from tests.section import assert_french, barriers, rendered_section, section_page

HOSTILE = "<script>alert('no')</script>&\"'"


@pytest.fixture(scope="module")
def build_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small study, with a hostile machine and command."""
    folder = tmp_path_factory.mktemp("build")
    out = folder / "stability" / "stability"
    changed = study(out, "small") | {"command": HOSTILE}
    changed["machine"] |= {"processor": HOSTILE}
    out.with_suffix(".json").write_text(json.dumps(changed))
    return folder


@pytest.fixture(scope="module")
def measured(build_dir: Path) -> dict[str, Any]:
    return dict(json.loads((build_dir / "stability" / "stability.json").read_text()))


@pytest.fixture(scope="module")
def page(build_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The section alone, in headless Chromium."""
    folder = tmp_path_factory.mktemp("section")
    with section_page("stability", build_dir, folder) as tab:
        yield tab


def told(tab: Page) -> dict[str, str]:
    script = """() => Object.fromEntries([...document.querySelectorAll(
        '#stability-map [data-part="readout"] dt')].map(
            (dt) => [dt.textContent, dt.nextElementSibling.textContent]))"""
    return dict(tab.evaluate(script))


def test_map_has_a_cell_for_each_scene_and_arrow_keys_walk_over_it(
    page: Page, measured: dict[str, Any]
) -> None:
    assert page.locator("#stability-map .cell").count() == len(measured["map"])
    ratios = sorted({cell["ratio"] for cell in measured["map"]})
    moves = sorted({cell["translation"] for cell in measured["map"]})
    assert told(page)["side / distance"] == power(ratios[len(ratios) // 2])
    page.focus('#stability-map [data-part="plot"]')
    for key in ("ArrowRight", "ArrowUp"):
        page.keyboard.press(key)
    x, y = len(ratios) // 2 + 1, 1
    cell = next(
        c for c in measured["map"] if (c["ratio"], c["translation"]) == (ratios[x], moves[y])
    )
    found = told(page)
    assert found["side / distance"] == power(cell["ratio"])
    assert found["translation"] == f"{power(cell['translation'])} m"
    for precision in ("float32", "float64"):
        assert found[precision] == digits(cell[precision], 2)
    assert f"float32 {found['float32']}" in page.inner_text('#stability-map [data-part="spoken"]')


def test_lines_are_drawn_where_the_error_passes_a_limit(
    page: Page, measured: dict[str, Any]
) -> None:
    """Between two neighbouring cells wherever a different number of limits is passed."""
    for precision in ("float32", "float64"):
        page.select_option('#stability-map [data-part="precision"]', precision)
        passed = {
            (c["ratio"], c["translation"]): sum(c[precision] > x for x in measured["limits"])
            for c in measured["map"]
        }
        ratios, moves = (sorted({key[i] for key in passed}) for i in (0, 1))
        lines = sum(
            passed[r, moves[j]] != passed[r, moves[j + 1]]
            for r in ratios
            for j in range(len(moves) - 1)
        ) + sum(
            passed[ratios[i], m] != passed[ratios[i + 1], m]
            for m in moves
            for i in range(len(ratios) - 1)
        )
        assert page.locator("#stability-map .boundary").count() == lines
        assert (lines > 0) == (precision == "float32")
    page.select_option('#stability-map [data-part="precision"]', "float32")


def test_every_sweep_has_a_chart_an_example_and_a_paragraph_on_its_cause(
    page: Page, measured: dict[str, Any]
) -> None:
    for sweep in measured["sweeps"]:
        cell = page.locator(f"#sweep-{sweep['name']}")
        assert cell.locator("svg").count() == 1
        example = cell.locator("details pre")
        assert json.loads(str(example.nth(1).text_content())) == sweep["example"]["scene"]
        for command in sweep["example"]["commands"]:
            assert command in str(example.first.text_content())
    for cause, (title, text) in CAUSES.items():
        fold = page.locator(f"#stability-{cause}")
        assert str(fold.locator("summary").first.text_content()).startswith(title)
        assert fold.locator("> p").text_content() == text


def test_the_section_says_nothing_in_english_on_a_french_page(build_dir: Path) -> None:
    assert_french("stability", build_dir)


def test_everyone_can_read_the_section(page: Page) -> None:
    """WCAG 2.2 AA as far as axe can tell, with everything unfolded."""
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert barriers(page) == []


def test_hostile_words_are_shown_and_not_run(page: Page) -> None:
    assert HOSTILE in page.inner_text("#figure-stability-sums .made")


@pytest.mark.parametrize("width", [1200, 390])
def test_section_fits_the_window(page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_page_does_without_and_refuses_what_is_broken(tmp_path: Path) -> None:
    assert rendered_section("stability", tmp_path) is None
    (tmp_path / "stability").mkdir()
    (tmp_path / "stability" / "stability.json").write_text("{}")
    with pytest.raises(ReportError, match=r"penumbra stability -o"):
        rendered_section("stability", tmp_path)


def test_powers_are_written_out() -> None:
    assert signed_power(-1e-7) == "−10⁻⁷"
    assert signed_power(2e-9) == "2·10⁻⁹"
    assert [signed_power(v) for v in (0.0, 0.1, 999.0)] == ["0", "0.1", "999"]
