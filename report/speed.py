"""How fast the renderers are, as bench measured it. The page does without where it did not."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from bench.page import Table, about, all_tables
from report.inputs import Input, ReportError

BENCH = Input("bench/bench.json", "make bench", "tp3", needed=False)


def speed(build_dir: Path) -> dict[str, Any]:
    """The section on speed; {"speed": None} where it was not measured.

    Raises ReportError for a broken file.
    """
    file = BENCH.path(build_dir)
    if not file.is_file():
        return {"speed": None}
    try:
        measured = json.loads(file.read_text())
        section = {
            "about": _html(about(measured)),
            "tables": [_table(t) for t in all_tables(measured)],
            "command": BENCH.command,
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ReportError(f"{file}: {error!r}; make it with: {BENCH.command}") from error
    return {"speed": section}


def _table(table: Table) -> dict[str, Any]:
    return {
        "title": _html(table.title),
        "head": table.head,
        "rows": [_cells(row) for row in table.rows],
    }


def _cells(row: Sequence[str]) -> list[Any]:
    return [_html(cell.replace("**", "")) for cell in row]


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
