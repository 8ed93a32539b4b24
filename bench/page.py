"""The tables of docs/performance.md, between its two markers; the words around them are written
by hand. The report shows them too, in the language that is spoken there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.law import seconds_of
from bench.results import FAST
from penumbra.compare.run.output import write_whole
from penumbra.language import _, localised, say

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
    english: Sequence[int] = ()
    """columns that bench.results worded, in English"""


def all_tables(result: Result) -> list[Table]:
    """Ratios first."""
    return [
        _targets(result),
        _compared(
            result, say("Render time at equal N, as a multiple of `{fast}`", fast=FAST), ratios=True
        ),
        _compared(result, _("Render time at equal N [ms]"), ratios=False),
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
        return localised(f"{rounded:,.0f}")
    if abs(rounded) < 1e-4:
        return localised(f"{rounded:.1e}")
    whole = len(str(int(abs(rounded)))) if abs(rounded) >= 1 else 0
    leading = 0
    while abs(rounded) * 10**leading < 0.1 and whole == 0:
        leading += 1
    return localised(f"{rounded:.{digits - whole + leading}f}")


def _ms(seconds: float | None) -> str:
    return number(None if seconds is None else 1e3 * seconds)


def about(result: Result) -> str:
    """Machine, versions and how it was measured."""
    machine, versions = result["machine"], result["versions"]
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    size = f"{result['width']}×{result['height']}"
    return say(
        "{processor}, {threads} cores used, {system}; {date}. {versions}. {scene} at {size}, "
        "{threads} threads, medians of {rounds} interleaved rounds. Load average before the "
        "start: {load:.2f} (0 is a machine at rest). Stolen by a virtual machine's host: "
        "{stolen:.1%} of the cores' time. Whole run: {minutes:.1f} minutes. Command: `make bench`.",
        processor=machine["processor"],
        system=machine["system"],
        versions=listed,
        size=size,
        **{
            key: result[key]
            for key in ("threads", "date", "scene", "rounds", "load", "stolen", "minutes")
        },
    )


def _targets(result: Result) -> Table:
    def value(row: Result, key: str) -> str:
        if row[key] is None:
            return "–"
        unit = row["unit"]
        return number(row[key]) + localised({"×": " ×", "%": "%", "": ""}.get(unit, f" {unit}"))

    def verdict(row: Result) -> str:
        return {True: _("yes"), False: "**" + _("no") + "**", None: _("not measured")}[row["met"]]

    return Table(
        _("Targets"),
        [_("what"), _("at least"), _("stretch"), _("reached"), _("met"), _("bound by")],
        [
            [row["what"], *(value(row, k) for k in ("at_least", "stretch", "reached")),
             verdict(row), row["bound_by"]]
            for row in result["targets"]
        ],
        words=2,
        english=(0, 5),
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
    return Table(title, [_("system"), *(f"N = {n}" for n in result["compared"])], rows)


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
                localised(f"{row['light_samples']:,.0f}"),
                number(row["relative_rmse"]),
                _("measured") if row["measured"]
                else _("extrapolated") if row["beyond"] else _("interpolated"),
            ]
            for row in found
        ]  # fmt: skip
        head = [_("system"), _("ratio"), "ms", "N", _("error at that N"), _("time is")]
        title = say("Time to a relative error of {target:.1%}", target=target)
        parts.append(Table(title, head, rows, words=1))
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
    head = [_("system"), _("slope, all"), _("slope, lit"), *(f"N = {n}" for n in counts)]
    return Table(_("Error against N"), head, rows)


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
    head = say("1 thread / {threads} threads", threads=result["threads"])
    return Table(_("Threads"), [head, *(f"N = {n}" for n in result["compared"])], rows)


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
    head = say("ns a pixel, N = {samples}", samples=samples)
    return Table(_("Image size"), [head, *(f"{w}×{h}" for w, h in sizes)], rows)


def _processes(result: Result) -> Table:
    found = [r for r in result["medians"] if r["experiment"] == "process"]
    found.sort(key=lambda r: float(r["seconds"]))
    rows = [[r["system"], _ms(r["seconds"]), _ms(r["low"]), _ms(r["high"])] for r in found]
    samples = found[0]["light_samples"] if found else 0
    head = [say("process, N = {samples}", samples=samples), "ms", _("smallest"), _("largest")]
    return Table(_("Whole processes"), head, rows)


def _peak(result: Result) -> Table:
    rows = [
        [
            str(p["threads"]),
            number(2e-9 * p["fma_per_second"]),
            number(1e-9 * p["divisions_per_second"]),
            localised(f"{p['light_samples']:,}"),
            number(1e-9 * p["samples_per_second"]),
            localised(f"{p['fma_share']:.0%}"),
            localised(f"{p['division_share']:.0%}"),
        ]
        for p in result["peak"]
    ]
    head = [
        _("threads"), _("FMA peak [GFLOP/s]"), _("division peak [G/s]"), "N",
        say("samples of `{fast}` [G/s]", fast=FAST), _("share of FMA peak"),
        _("share of division peak"),
    ]  # fmt: skip
    return Table(_("Peak"), head, rows)
