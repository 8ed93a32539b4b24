"""How fast the renderers are, as bench measured it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from penumbra.language import language
from penumbra.report.inputs import Data, Input

if TYPE_CHECKING:
    from bench.page import Table

BENCH = Input("bench/bench.json", "make bench", "tp3")


def speed(data: Data) -> dict[str, Any]:
    """What bench says of its run, and its tables."""
    from bench.page import about, all_tables  # in the repository only, as what it measures is

    measured = data[BENCH]
    return {
        "about": _html(about(measured)),
        "tables": [_table(t) for t in all_tables(measured)],
        "command": BENCH.command,
    }


def _table(table: Table) -> dict[str, Any]:
    return {
        "title": _html(table.title),
        "head": table.head,
        "rows": [_cells(row, table.english) for row in table.rows],
    }


def _cells(row: Sequence[str], english: Sequence[int]) -> list[Any]:
    cells = [_html(cell.replace("**", "")) for cell in row]
    if language() == "en":
        return cells
    return [
        Markup('<span lang="en">{}</span>').format(cell) if i in english else cell
        for i, cell in enumerate(cells)
    ]


def _html(markdown: str) -> Markup:
    """
    >>> _html("a `b` < c")
    Markup('a <code>b</code> &lt; c')
    """
    parts = markdown.split("`")
    marked = [
        Markup("<code>{}</code>").format(p) if i % 2 else escape(p) for i, p in enumerate(parts)
    ]
    return Markup("").join(marked)
