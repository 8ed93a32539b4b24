"""The pytest plug-in: what a failed assertion of Penumbra's adds to the report.

With --penumbra-report FOLDER each failure has its page, which shows the picture beside the right
one. It is loaded by every pytest of an environment that has Penumbra, so that it imports nothing
until an assertion has failed.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from penumbra.assertions import NotShown

SECTION = "penumbra"
"""Of a report: after the failure's own text"""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("penumbra").addoption(
        "--penumbra-report",
        type=Path,
        metavar="FOLDER",
        help="write a page for each of Penumbra's assertions that fails",
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    error = _not_shown(call)
    if error is not None:
        said = {"verdict": error.sentence}
        said |= {"picture": str(error.picture)} if error.picture else {}
        said |= {"command": error.command} if error.command else {}
        folder = item.config.getoption("--penumbra-report")
        if folder is not None and error.write_page is not None:
            said["page"] = _page(error, folder / f"{_file_name(report)}.html")
        report.sections.append((SECTION, "\n".join(f"{k}: {v}" for k, v in said.items())))
        # of the item: the JUnit report takes them from what comes after the failure
        item.user_properties += [(f"penumbra_{k}", v) for k, v in said.items()]
    return report


def _not_shown(call: pytest.CallInfo[None]) -> NotShown | None:
    """The assertion that failed, if it is one of ours: their module is loaded then."""
    assertions = sys.modules.get("penumbra.assertions")
    if assertions is None or call.excinfo is None:
        return None
    value = call.excinfo.value
    return value if isinstance(value, assertions.NotShown) else None


def _page(error: NotShown, file: Path) -> str:
    """Where the page is, or why there is none: a report must not fail for it."""
    from penumbra.language import of_environment, say, speaking

    assert error.write_page is not None
    with speaking(of_environment()):
        try:
            error.write_page(file.absolute())
        except (ImportError, OSError, ValueError, RuntimeError) as why:
            return say("none: {why}", why=why)
    return str(file)


def _file_name(report: Any) -> str:
    """tests/test_a.py::test_b[c] -> tests-test_a.py-test_b-c"""
    return re.sub(r"[^\w.]+", "-", report.nodeid).strip("-.")[-120:]
