"""The tables of docs/performance.md, between its two markers; the words around them are written
by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.law import seconds_of
from bench.results import FAST
from penumbra.compare.run.output import write_whole

BEGIN = "<!-- measured by `make bench`: begin -->"
END = "<!-- measured by `make bench`: end -->"

Result = dict[str, Any]


class PageError(ValueError):
    """A page without its markers."""


def write_page(page: Path, result: Result) -> None:
    """Put the tables in their place. Raises PageError, OSError."""
    text = page.read_text()
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise PageError(f"{page}: the tables' place is not marked by one {BEGIN} and one {END}")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    write_whole(
        page, lambda part: part.write_text(f"{before}{BEGIN}\n\n{tables(result)}\n{END}{after}")
    )


@dataclass(frozen=True)
class Table:
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    """Markdown"""
    words: int = 0
    """so many columns at the end are words, as the first is; the others are numbers"""


def all_tables(result: Result) -> list[Table]:
    """Ratios first."""
    return [
        _targets(result),
        _compared(result, f"Render time at equal N, as a multiple of `{FAST}`", ratios=True),
        _compared(result, "Render time at equal N [ms]", ratios=False),
        *_times_to_error(result),
        _errors(result),
        _threads(result),
        _sizes(result),
        _processes(result),
        _peak(result),
    ]


def tables(result: Result) -> str:
    """All of them, as Markdown."""
    parts = [about(result) + "\n"]
    parts += [f"### {t.title}\n\n" + table(t.head, t.rows, t.words) for t in all_tables(result)]
    if result["absent"]:
        lines = [f"- {name}: {why}" for name, why in sorted(result["absent"].items())]
        parts.append("### Not measured\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 0) -> str:
    """Markdown; numbers to the right, the first column and the last `words` to the left.

    >>> print(table(["a", "b"], [["x", "1"]]), end="")
    | a | b |
    | --- | ---: |
    | x | 1 |
    """
    numbers = len(head) - 1 - words
    lines = [list(head), ["---"] + ["---:"] * numbers + ["---"] * words, *map(list, rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def number(value: float | None, digits: int = 3) -> str:
    """
    >>> number(12345.6), number(0.01234), number(7.0), number(None), number(-0.7512)
    ('12,300', '0.0123', '7.00', '–', '-0.751')
    """
    if value is None:
        return "–"
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) >= 10 ** (digits - 1):
        return f"{rounded:,.0f}"
    if abs(rounded) < 1e-4:
        return f"{rounded:.1e}"
    whole = len(str(int(abs(rounded)))) if abs(rounded) >= 1 else 0
    leading = 0
    while abs(rounded) * 10**leading < 0.1 and whole == 0:
        leading += 1
    return f"{rounded:.{digits - whole + leading}f}"


def _ms(seconds: float | None) -> str:
    return number(None if seconds is None else 1e3 * seconds)


def about(result: Result) -> str:
    """Machine, versions and how it was measured."""
    machine, versions = result["machine"], result["versions"]
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        f"{machine['processor']}, {result['threads']} cores used, {machine['system']}; "
        f"{result['date']}. {listed}. {result['scene']} at {result['width']}×{result['height']}, "
        f"{result['threads']} threads, medians of {result['rounds']} interleaved rounds. Load "
        f"average before the start: {result['load']:.2f} (0 is a machine at rest). Stolen "
        f"by a virtual machine's host: {100 * result['stolen']:.1f}% of the cores' time. "
        f"Whole run: {result['minutes']:.1f} minutes. Command: `make bench`."
    )


def _targets(result: Result) -> Table:
    def value(row: Result, key: str) -> str:
        if row[key] is None:
            return "–"
        unit = row["unit"]
        return number(row[key]) + ({"×": " ×", "%": "%", "": ""}.get(unit, f" {unit}"))

    def verdict(row: Result) -> str:
        return {True: "yes", False: "**no**", None: "not measured"}[row["met"]]

    return Table(
        "Targets",
        ["what", "at least", "stretch", "reached", "met", "bound by"],
        [
            [row["what"], *(value(row, k) for k in ("at_least", "stretch", "reached")),
             verdict(row), row["bound_by"]]
            for row in result["targets"]
        ],
        words=2,
    )  # fmt: skip


def _compared(result: Result, title: str, ratios: bool) -> Table:
    rows = []
    for name in result["systems"]:
        cells = []
        for count in result["compared"]:
            seconds, fast = (
                seconds_of(result["medians"], system, light_samples=count,
                           threads=result["threads"])
                for system in (name, FAST)
            )  # fmt: skip
            if ratios:
                cells.append(number(seconds / fast if seconds and fast else None))
            else:
                cells.append(_ms(seconds))
        rows.append([f"`{name}`", *cells])
    return Table(title, ["system", *(f"N = {n}" for n in result["compared"])], rows)


def _times_to_error(result: Result) -> list[Table]:
    parts = []
    for target in sorted({row["target"] for row in result["times_to_error"]}, reverse=True):
        found = [row for row in result["times_to_error"] if row["target"] == target]
        found.sort(key=lambda row: float(row["seconds"]))
        best = found[0]["seconds"]
        rows = [
            [
                f"`{row['system']}`",
                number(row["seconds"] / best),
                _ms(row["seconds"]),
                f"{row['light_samples']:,.0f}",
                number(row["relative_rmse"]),
                "measured" if row["measured"]
                else "extrapolated" if row["beyond"] else "interpolated",
            ]
            for row in found
        ]  # fmt: skip
        head = ["system", "ratio", "ms", "N", "error at that N", "time is"]
        parts.append(Table(f"Time to a relative error of {target:.1%}", head, rows, words=1))
    return parts


def _errors(result: Result) -> Table:
    counts = sorted({r["light_samples"] for r in result["medians"] if r["experiment"] == "samples"})
    rows = []
    for name in result["systems"]:
        errors = {
            r["light_samples"]: r["relative_rmse_all"]
            for r in result["medians"]
            if r["experiment"] == "samples" and r["system"] == name and r["relative_rmse_all"]
        }
        slope = result["slopes"][name]
        cells = [number(errors.get(n)) for n in counts]
        rows.append([f"`{name}`", number(slope["all"]), number(slope["lit"]), *cells])
    head = ["system", "slope, all", "slope, lit", *(f"N = {n}" for n in counts)]
    return Table("Error against N", head, rows)


def _threads(result: Result) -> Table:
    rows = []
    for name in result["systems"]:
        cells = []
        for count in result["compared"]:
            one, many = (
                seconds_of(result["medians"], name, light_samples=count, threads=threads)
                for threads in (1, result["threads"])
            )
            cells.append(number(one / many if one and many else None))
        if any(cell != "–" for cell in cells):
            rows.append([f"`{name}`", *cells])
    head = f"1 thread / {result['threads']} threads"
    return Table("Threads", [head, *(f"N = {n}" for n in result["compared"])], rows)


def _sizes(result: Result) -> Table:
    measured = [r for r in result["medians"] if r["experiment"] == "size"]
    sizes = sorted({(r["width"], r["height"]) for r in measured})
    rows = []
    for name in result["systems"]:
        cells = []
        for size in sizes:
            found = [
                r for r in measured if r["system"] == name and (r["width"], r["height"]) == size
            ]
            each = 1e9 * found[0]["seconds"] / (size[0] * size[1]) if found else None
            cells.append(number(each))
        if any(cell != "–" for cell in cells):
            rows.append([f"`{name}`", *cells])
    samples = measured[0]["light_samples"] if measured else 0
    head = f"ns a pixel, N = {samples}"
    return Table("Image size", [head, *(f"{w}×{h}" for w, h in sizes)], rows)


def _processes(result: Result) -> Table:
    found = [r for r in result["medians"] if r["experiment"] == "process"]
    found.sort(key=lambda r: float(r["seconds"]))
    rows = [[r["system"], _ms(r["seconds"]), _ms(r["low"]), _ms(r["high"])] for r in found]
    samples = found[0]["light_samples"] if found else 0
    return Table("Whole processes", [f"process, N = {samples}", "ms", "smallest", "largest"], rows)


def _peak(result: Result) -> Table:
    rows = [
        [
            str(p["threads"]),
            number(2e-9 * p["fma_per_second"]),
            number(1e-9 * p["divisions_per_second"]),
            f"{p['light_samples']:,}",
            number(1e-9 * p["samples_per_second"]),
            f"{p['fma_share']:.0%}",
            f"{p['division_share']:.0%}",
        ]
        for p in result["peak"]
    ]
    head = [
        "threads", "FMA peak [GFLOP/s]", "division peak [G/s]", "N",
        f"samples of `{FAST}` [G/s]", "share of FMA peak", "share of division peak",
    ]  # fmt: skip
    return Table("Peak", head, rows)
