"""The report's section on how often a check is right: there if it was measured, and escaped."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from penumbra.report.check import CALIBRATION, check
from penumbra.report.inputs import ReportError
from tests.section import data_of, rendered_section, section_page

NAME = "<b>cos & sin"
MEASURED = {
    "origin": {},
    "settings": {"scenes": ["tp3", "tp3_sheared"], "light_samples": [1, 16]},
    "correct": {"n": 500, "accused": 0, "cannot_tell": 12, "upper": 0.00591},
    "detected": {"n": 200, "found": 199, "low": 0.972, "high": 0.9999},
    "named": {"n": 199, "first": 193, "low": 0.936, "high": 0.988},
    "confusion": {"rows": [NAME, "b"], "columns": [NAME, "b"], "counts": [[9, 1], [0, 10]]},
    "alike": [[NAME, "b", "tp3_sheared"]],
    "unknown": {"n": 30, "unknown": 25, "nearest": 5},
}


@pytest.fixture
def build_dir(tmp_path: Path) -> Path:
    (tmp_path / "calibration.json").write_text(json.dumps(MEASURED))
    return tmp_path


@pytest.mark.parametrize("width", [1200, 390])
def test_rates_and_names_are_shown(build_dir: Path, width: int) -> None:
    with section_page("check", build_dir, build_dir) as tab:
        tab.set_viewport_size({"width": width, "height": 900})
        for summary in tab.locator("summary").all():
            summary.click()
        text = tab.inner_text("#check")
        for said in ("Of 500 correct ones none was accused", "0.6 %", "199 of 200", "99.5 %",
                     "[93.6 %, 98.8 %]", "25 of 30", NAME, "scenes: tp3, tp3_sheared"):  # fmt: skip
            assert said in text, said
        assert tab.evaluate("document.documentElement.scrollWidth") <= width


def test_confusion_lists_the_most_frequent_first(build_dir: Path) -> None:
    rows = check(data_of("check", build_dir))["confusion"]
    assert [c["count"] for c in rows[0]["called"]] == [9, 1]
    assert rows[0]["called"][0]["share"] == 90 and rows[0]["called"][0]["right"]


def test_absent_unless_measured_or_shipped_and_refused_if_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("penumbra.report.inputs.ROOT", tmp_path / "elsewhere")
    assert rendered_section("check", tmp_path) is None
    shipped = tmp_path / "elsewhere" / "docs" / "calibration.json"
    shipped.parent.mkdir(parents=True)
    shipped.write_text(json.dumps(MEASURED))
    assert rendered_section("check", tmp_path) is not None
    assert replace(CALIBRATION, shipped="").path(tmp_path) == tmp_path / "calibration.json"
    (tmp_path / "calibration.json").write_text("{}")
    with pytest.raises(ReportError, match="make calibrate"):
        rendered_section("check", tmp_path)
