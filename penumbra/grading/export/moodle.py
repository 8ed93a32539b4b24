"""Moodle's two ways to take grades from a file: an assignment's worksheet, the gradebook's import.

A worksheet ("Download grading worksheet") is filled in: its columns, their order and language, its
other cells and rows stay. Without one, a table of e-mail addresses is made for the gradebook.
Either way a row has grade and feedback, since the gradebook takes a feedback without a grade for
an order to remove the grade.
"""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TypeVar

from penumbra.grading.export.grades import INTERNAL, Grades, GradesError, Submission, scaled
from penumbra.grading.export.text import lines, one_line
from penumbra.language import _, say

GRADE = ("Grade", "Note")
FEEDBACK = ("Feedback comments", "Feedback par commentaires")
MAXIMUM = ("Maximum grade", "Note maximale")
"""A worksheet's columns, in English and French; of others the instructor says the names"""
DOWNLOADED = re.compile(r"_(\d+)_assignsubmission_")
"""In the names of what "Download all submissions" gives: Surname Firstname_1234567_assignsubmission
_file_, and behind it the participant's number"""
EMAIL = re.compile(r"\w[^\s@\"',;]*@[^\s@\"',;]+")
DELIMITERS = ",;\t"
"""Moodle writes the first; a spreadsheet of another language may have saved it with another"""
MOST_NAMED = 20
Place = TypeVar("Place", int, str)


@dataclass(frozen=True)
class Filled:
    text: str
    """the CSV file's"""
    notes: tuple[str, ...]
    """what the instructor might not expect"""


def gradebook(grades: Grades, roster: Mapping[str, str], out_of: Fraction | None = None) -> Filled:
    """For "Import > CSV file" in the gradebook: e-mail address, grade, feedback.

    roster: id -> e-mail address, as Moodle has it: it tells small letters from capitals. out_of:
    the grade item's maximum; None: the rubric's total. Raises GradesError for submissions without
    an address.
    """
    found = _matched(
        grades.submissions,
        lambda one: roster.get(one.id) if EMAIL.fullmatch(roster.get(one.id, "")) else None,
        _("have no e-mail address in the roster"),
    )
    rows = [[address, scaled(one.points, one.of, out_of), feedback(one)] for one, address in found]
    notes = _failed_to_judge(grades)
    return Filled(_csv([["Email address", "Grade", "Feedback"], *rows], ",", "\n"), tuple(notes))


def fill_worksheet(
    worksheet: Path,
    grades: Grades,
    roster: Mapping[str, str] | None = None,
    out_of: Fraction | None = None,
    grade_column: str | None = None,
    feedback_column: str | None = None,
) -> Filled:
    """The worksheet with the grades in it.

    A submission's row is that of the participant's number in its name, which Moodle's downloads
    have, or of what the roster says of its id: a participant's number or an e-mail address.
    grade_column, feedback_column: their headings, where Moodle speaks neither English nor French.
    Raises OSError; GradesError for a file that is no worksheet, submissions without a row, two
    with one row, and a maximum grade that is not out_of.
    """
    raw = worksheet.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise GradesError(
            say("{worksheet}: not UTF-8: save it as “CSV UTF-8”", worksheet=worksheet)
        ) from None
    rows, delimiter = _read_worksheet(worksheet, text, grade_column)
    header, body = rows[0], rows[1:]
    at_grade = _column(worksheet, header, GRADE, grade_column, "--grade-column")
    at_feedback = _column(worksheet, header, FEEDBACK, feedback_column, "--feedback-column")
    places = _places(body)
    found = _matched(
        grades.submissions,
        lambda one: places.get(_key(one, roster or {})),
        say("have no row in {worksheet}", worksheet=worksheet),
    )
    notes = _failed_to_judge(grades)
    for one, place in found:
        row = body[place]
        _check_maximum(worksheet, header, row, grades.total if out_of is None else out_of)
        grade = scaled(one.points, one.of, out_of)
        if row[at_grade].strip() and _number(row[at_grade]) != Fraction(grade):
            notes.append(
                say(
                    "{id}: had {before}, now {grade}",
                    id=one_line(one.id),
                    before=row[at_grade].strip(),
                    grade=grade,
                )
            )
        row[at_grade], row[at_feedback] = grade, feedback(one)
    empty = len(body) - len(found)
    if empty:
        notes.append(
            say(
                "{empty} of {count} rows have no submission, and stay as they are",
                empty=empty,
                count=len(body),
            )
        )
    mark = "\ufeff" if raw.startswith(b"\xef\xbb\xbf") else ""
    newline = "\r\n" if b"\r\n" in raw else "\n"
    return Filled(mark + _csv(rows, delimiter, newline), tuple(notes))


def read_roster(file: Path) -> dict[str, str]:
    """A CSV file of two columns, a submission's id and what Moodle calls its student; a first line
    `id,email` is a heading. Raises OSError; GradesError, which names file and line."""
    roster: dict[str, str] = {}
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise GradesError(say("{file}: not UTF-8: save it as “CSV UTF-8”", file=file)) from None
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_likeliest(text))
    for row in reader:
        cells = [cell.strip() for cell in row]
        if not any(cells) or (reader.line_num == 1 and cells[0].lower() == "id"):
            continue
        if len(cells) < 2 or not cells[0] or not cells[1]:
            raise GradesError(
                say("{file}:{line}: not of the form id,email", file=file, line=reader.line_num)
            )
        if cells[0] in roster:
            raise GradesError(
                say(
                    "{file}:{line}: {id} stands there twice",
                    file=file,
                    line=reader.line_num,
                    id=cells[0],
                )
            )
        roster[cells[0]] = cells[1]
    return roster


def feedback(submission: Submission) -> str:
    """One line of HTML, which is what Moodle takes feedback for.

    It starts with "<", so that a spreadsheet takes it for no formula, and has no backslash, which
    escapes quotes in PHP's CSV.
    """
    items = "".join(
        f"<li>{_escaped(claim.title)}: {claim.points}/{claim.of}. {_escaped(claim.reason)}</li>"
        for claim in submission.claims
    )
    said = "<br>".join(_escaped(line) for line in lines(submission.details))
    return (
        f"<p><strong>{submission.points}/{submission.of}.</strong> "
        f"{_escaped(submission.headline)}</p><ul>{items}</ul>" + (f"<p>{said}</p>" if said else "")
    )


def _failed_to_judge(grades: Grades) -> list[str]:
    return [
        say(
            "{id}: not judged, by a fault of Penumbra's: full points, look at it",
            id=one_line(one.id),
        )
        for one in grades.submissions
        if one.problem == INTERNAL
    ]


def _escaped(text: str) -> str:
    return html.escape(one_line(text)).replace("\\", "&#92;")


def _key(submission: Submission, roster: Mapping[str, str]) -> str:
    if submission.id in roster:
        return _participant(roster[submission.id])
    number = DOWNLOADED.search(submission.id)
    return number[1] if number else ""


def _participant(cell: str) -> str:
    """The number of "Participant 1234567", in any language; an e-mail address as it is."""
    number = re.search(r"\d+$", cell.strip())
    return number[0] if number and "@" not in cell else cell.strip()


def _places(body: Sequence[Sequence[str]]) -> dict[str, int]:
    """What a student is called -> row: the number in the first column, e-mail addresses."""
    places = {}
    for place, row in enumerate(body):
        places[_participant(row[0])] = place
        places |= {cell.strip(): place for cell in row if EMAIL.fullmatch(cell.strip())}
    places.pop("", None)
    return places


def _read_worksheet(file: Path, text: str, grade_column: str | None) -> tuple[list[list[str]], str]:
    """Its rows, the heading first, and what parts its cells."""
    names = (grade_column,) if grade_column else GRADE
    for delimiter in DELIMITERS:
        rows = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter))
        rows = [row for row in rows if row]
        if rows and set(names) & set(rows[0]):
            break
    else:
        raise GradesError(
            say(
                "{file}: no column {names}: give the grading worksheet that Moodle lets you "
                "download, and --grade-column NAME where it speaks another language",
                file=file,
                names=_(" or ").join(names),
            )
        )
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise GradesError(
                say(
                    "{file}: row {number} has {cells} cells, the heading {columns}",
                    file=file,
                    number=number,
                    cells=len(row),
                    columns=len(rows[0]),
                )
            )
    return rows, delimiter


def _column(
    file: Path, header: Sequence[str], known: Sequence[str], given: str | None, option: str
) -> int:
    names = (given,) if given else known
    found = [i for i, name in enumerate(header) if name in names]
    if len(found) != 1:
        raise GradesError(
            say(
                "{file}: {count} columns {names}: enable “Feedback comments” in the assignment and "
                "download its worksheet anew, or give {option} NAME, one of {headings}",
                file=file,
                count=len(found),
                names=_(" or ").join(names),
                option=option,
                headings=", ".join(header),
            )
        )
    return found[0]


def _check_maximum(
    file: Path, header: Sequence[str], row: Sequence[str], best: Fraction | int
) -> None:
    for name, cell in zip(header, row, strict=True):
        if name.casefold() in map(str.casefold, MAXIMUM):
            maximum = _number(cell)
            if maximum is not None and maximum != best:
                raise GradesError(
                    say(
                        "{file}: {name} is {cell}, and the grades are out of {best:g}: give "
                        "--out-of {maximum:g}",
                        file=file,
                        name=name,
                        cell=cell.strip(),
                        best=float(best),
                        maximum=float(maximum),
                    )
                )


def _number(cell: str) -> Fraction | None:
    try:
        return Fraction(cell.strip().replace(",", "."))
    except (ValueError, ZeroDivisionError):
        return None


def _matched(
    submissions: Sequence[Submission], place: Callable[[Submission], Place | None], why: str
) -> list[tuple[Submission, Place]]:
    """Each with its place. Raises GradesError for those without one, and two with the same."""
    found = [(one, place(one)) for one in submissions]
    lost = [one for one, where in found if where is None]
    if lost:
        raise GradesError(
            say(
                "{count} submissions {why}: {names}: name them in --roster FILE, a line `id,email` "
                "each (Moodle tells small letters from capitals)",
                count=len(lost),
                why=why,
                names=_names(lost),
            )
        )
    first: dict[Place, Submission] = {}
    matched = []
    for one, where in found:
        assert where is not None
        if where in first:
            raise GradesError(
                say(
                    "two submissions are of one student: {names}", names=_names([first[where], one])
                )
            )
        first[where] = one
        matched.append((one, where))
    return matched


def _names(submissions: Sequence[Submission]) -> str:
    said = ", ".join(one_line(one.id) for one in submissions[:MOST_NAMED])
    return said + (", ..." if len(submissions) > MOST_NAMED else "")


def _likeliest(text: str) -> str:
    first = text.partition("\n")[0]
    return max(DELIMITERS, key=first.count)


def _csv(rows: Sequence[Sequence[str]], delimiter: str, newline: str) -> str:
    stream = io.StringIO()
    csv.writer(stream, delimiter=delimiter, lineterminator=newline).writerows(rows)
    return stream.getvalue()
