"""penumbra export: grades in the format of Gradescope, Moodle, VPL or a CI system."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from penumbra.cli.arguments import Subcommands, add_language, add_subcommand, help_format
from penumbra.cli.exit import PASS, UsageError
from penumbra.compare.run.output import named
from penumbra.language import _, speaking

if TYPE_CHECKING:
    from penumbra.grading.export.grades import Grades


def add(subcommands: Subcommands) -> None:
    parser = subcommands.add_parser(
        "export",
        help="Grades in the format of Gradescope, Moodle, VPL or a CI system",
        description="Write what `penumbra grade` found in the format of another tool, to standard "
        "output unless -o says where.\ndocs/course-tools/ has an example of each.",
        epilog="example: penumbra export moodle grades.json --worksheet Grades-TP3.csv -o up.csv",
        formatter_class=help_format,
    )
    formats = parser.add_subparsers(required=True, metavar="FORMAT")
    gradescope = _add_format(
        formats,
        "gradescope",
        _gradescope,
        (".json",),
        "Gradescope's results.json of one submission. Claims are its tests; what only the "
        "instructor may read is a hidden one.",
        "grades.json -o /autograder/results/results.json",
    )
    _add_submission(gradescope)
    gradescope.add_argument(
        "--visibility", default="visible",
        choices=("visible", "after_due_date", "after_published", "hidden"),
        help="when students see it [visible]",
    )  # fmt: skip
    moodle = _add_format(
        formats,
        "moodle",
        _moodle,
        (".csv",),
        "Grades and feedback for Moodle. With --worksheet an assignment's grading worksheet is "
        "filled in; with --roster alone, a table for the gradebook's import is made.",
        "grades.json --worksheet Grades-TP3.csv -o upload.csv",
    )
    moodle.add_argument(
        "--worksheet", type=Path, metavar="FILE", help="as Moodle lets you download it"
    )
    moodle.add_argument(
        "--roster", type=Path, metavar="FILE",
        help="lines `id,email`: whose each submission is, where its name does not have Moodle's "
        "number (Surname Firstname_1234567_assignsubmission_file_)",
    )  # fmt: skip
    moodle.add_argument("--grade-column", metavar="NAME", help="its heading [Grade, Note]")
    moodle.add_argument(
        "--feedback-column", metavar="NAME",
        help="its heading [Feedback comments, Feedback par commentaires]",
    )  # fmt: skip
    _add_out_of(moodle, "the assignment's maximum grade")
    vpl = _add_format(
        formats,
        "vpl",
        _vpl,
        (".txt",),
        "The lines `Comment :=>>` and `Grade :=>>` of one submission, for vpl_evaluate.sh.",
        'grades.json --out-of "$VPL_GRADEMAX"',
    )
    _add_submission(vpl)
    _add_out_of(vpl, "the activity's maximum grade")
    junit = _add_format(
        formats,
        "junit",
        _junit,
        (".xml",),
        "JUnit XML: a suite a submission, a test case a claim; what cannot be told is skipped.",
        "grades.json -o grades.xml",
    )
    _add_submission(junit, "only this one")


def _add_format(
    formats: Subcommands,
    name: str,
    text: Callable[[Grades, argparse.Namespace], str],
    endings: tuple[str, ...],
    description: str,
    example: str,
) -> argparse.ArgumentParser:
    def run(options: argparse.Namespace) -> int:
        from penumbra.grading.export.grades import read_grades

        grades = read_grades(options.grades)
        with speaking(options.lang or grades.language):
            said = text(grades, options)
        return _write(said, options.out)

    parser = add_subcommand(formats, name, run, description, f"penumbra export {name} {example}")
    parser.add_argument(
        "grades", type=named(".json"), metavar="GRADES", help="grades.json of `penumbra grade`"
    )
    parser.add_argument(
        "-o", "--out", type=named(*endings), metavar=f"OUT{endings[0]}", help="[standard output]"
    )
    add_language(parser, "the grades'")
    return parser


def _add_submission(parser: argparse.ArgumentParser, which: str = "which, if several") -> None:
    parser.add_argument("--submission", metavar="ID", help=which)


def _add_out_of(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--out-of", type=_best, metavar="MAX", help=f"{what} [the rubric's own total]"
    )


def _best(text: str) -> Fraction:
    try:
        value = Fraction(text)
    except (ValueError, ZeroDivisionError):
        value = Fraction(0)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number above 0')
    return value


def _gradescope(grades: Grades, options: argparse.Namespace) -> str:
    from penumbra.grading.export.gradescope import results

    return results(grades, grades.one(options.submission), options.visibility)


def _moodle(grades: Grades, options: argparse.Namespace) -> str:
    from penumbra.grading.export.moodle import fill_worksheet, gradebook, read_roster

    roster = read_roster(options.roster) if options.roster else {}
    if options.worksheet:
        filled = fill_worksheet(
            options.worksheet,
            grades,
            roster,
            options.out_of,
            options.grade_column,
            options.feedback_column,
        )
    elif options.roster:
        filled = gradebook(grades, roster, options.out_of)
    else:
        raise UsageError(
            _(
                "moodle: give --worksheet FILE, the assignment's grading worksheet, or --roster "
                "FILE, lines `id,email`"
            )
        )
    for note in filled.notes:
        print(f"penumbra: {note}", file=sys.stderr)
    return filled.text


def _vpl(grades: Grades, options: argparse.Namespace) -> str:
    from penumbra.grading.export.vpl import evaluation

    return evaluation(grades.one(options.submission), options.out_of)


def _junit(grades: Grades, options: argparse.Namespace) -> str:
    from penumbra.grading.export.junit import report

    chosen = grades.submissions if options.submission is None else [grades.one(options.submission)]
    return report(grades, chosen)


def _write(text: str, file: Path | None) -> int:
    """UTF-8, whatever the locale: that is what the tools read."""
    from penumbra.compare.run.output import write_whole

    data = text.encode("utf-8")
    if file is None:
        sys.stdout.flush()
        sys.stdout.buffer.write(data)
    else:
        write_whole(file, lambda part: part.write_bytes(data))
    return PASS
