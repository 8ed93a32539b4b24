"""penumbra export: each format as its tool documents it, whatever students call their things."""

from __future__ import annotations

import csv
import doctest
import html.parser
import io
import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest
import xmlschema
from hypothesis import given
from hypothesis import strategies as st

from penumbra.__main__ import main
from penumbra.grading.export import grades as grades_module
from penumbra.grading.export import text as text_module
from penumbra.grading.export.grades import read_grades
from penumbra.grading.export.gradescope import results
from penumbra.grading.export.junit import report
from penumbra.grading.export.moodle import feedback
from penumbra.grading.export.vpl import evaluation
from tests.graded import grades, submission, write_grades

DATA = Path(__file__).resolve().parent / "data"
GRADESCOPE = json.loads((DATA / "gradescope-results.schema.json").read_text())
JUNIT = xmlschema.XMLSchema(DATA / "junit.xsd")
HOSTILE = "../x\nGrade :=>> 20\r\n<b>&\"'\\\x00\x1b[31m\ud800\u202e=cmd|' /C calc'!A0"
"""A line that forges a grade, markup, quotes, control characters, half a surrogate pair, a turn of
direction, a spreadsheet's formula"""
Export = Callable[..., str]


@pytest.fixture
def export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Export:
    """export(format, submissions, *arguments) is what the command prints, which ends with 0."""

    def run(name: str, submissions: list[dict[str, Any]], *arguments: str) -> str:
        file = write_grades(tmp_path / "grades.json", *submissions)
        assert main(["export", name, str(file), *arguments]) == 0
        return capsys.readouterr().out

    return run


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """What the command says, in one sentence, when it ends with 2 and writes nothing."""
    assert main(["export", *map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("penumbra: ") and err.count("\n") == 1
    return err


def hostile() -> dict[str, Any]:
    one = submission(HOSTILE, "srcsmr", headline=HOSTILE, text=HOSTILE, titles=[HOSTILE])
    for claim in one["claims"]:
        claim["title"] = claim["why"] = f"-{HOSTILE} (-5)"
    return one


# Gradescope


@pytest.mark.parametrize(
    "one",
    [submission("a"), submission("b", "rrcsmm"), hostile()],
    ids=["right", "wrong", "hostile"],
)
def test_gradescope_accepts_results(one: dict[str, Any], export: Export) -> None:
    written = json.loads(export("gradescope", [one]))
    jsonschema.validate(written, GRADESCOPE)
    assert written["score"] == one["points"]
    scored = [test for test in written["tests"] if "score" in test]
    assert sum(test["score"] for test in scored) == written["score"]
    assert sum(test["max_score"] for test in scored) == one["of"]
    assert all(
        test.get("status") != "passed" or test["score"] == test["max_score"] for test in scored
    )


def test_gradescope_shows_no_markup_and_no_output_of_a_submission(export: Export) -> None:
    written = json.loads(export("gradescope", [hostile()]))
    for key in ("output_format", "test_output_format", "test_name_format"):
        assert written[key] == "text"
    assert written["stdout_visibility"] == "hidden"
    assert not any("output_format" in test or "name_format" in test for test in written["tests"])


def test_gradescope_tells_only_the_instructor_which_mistake_it_is(export: Export) -> None:
    """The hint level says what a student may read; the mistake's name is in a hidden test."""
    one = submission("a", "rsssss", text="WRONG\n")
    written = json.loads(export("gradescope", [one], "--visibility", "after_published"))
    secret = written["tests"].pop()
    assert secret["visibility"] == "hidden" and "score" not in secret
    assert "No cosine at the light" in secret["output"]
    assert "osine" not in json.dumps(written)
    assert written["visibility"] == "after_published"


def test_what_cannot_be_told_has_its_points_and_no_status(export: Export) -> None:
    tests = json.loads(export("gradescope", [submission("a", "sssscc")]))["tests"]
    assert [test.get("status") for test in tests] == ["passed"] * 4 + [None] * 3
    assert tests[4]["score"] == tests[4]["max_score"] == 2
    assert tests[4]["output"].endswith("your instructor may look at it.)")


# VPL


def vpl_reads(text: str) -> tuple[str, list[str]]:
    """The grade and the comments that VPL's own reader finds: the last line that starts with the
    tag, wherever it stands; the lines that start with the comment's."""
    newline = "\r\n" if "\r\n" in text else "\n" if "\n" in text else "\r"
    grade, comments, inside = "", [], False
    for line in text.split(newline):
        if line.startswith("Grade :=>>"):
            grade = line.removeprefix("Grade :=>>").strip()
        if inside and line.strip() != "--|>":
            comments.append(line.rstrip())
        elif inside or line.strip() == "<|--":
            inside = not inside
        elif line.startswith("Comment :=>>"):
            comments.append(line.rstrip().removeprefix("Comment :=>>"))
    return grade, comments


def test_vpl_reads_grade_titles_and_what_stands_below_them(export: Export) -> None:
    grade, comments = vpl_reads(export("vpl", [submission("a", "rsssss")]))
    assert grade == "14"
    assert comments[:4] == [
        "-Grade: 14/20",
        ">WRONG",
        "-The light's mean: 0/6",
        ">The light's mean: refuted.",
    ]
    assert ">  No cosine at the light" in comments
    assert all(line[0] in "->" for line in comments)


@pytest.mark.parametrize(
    ("best", "grade"), [("100", "70"), ("10.0", "7"), ("3", "2.1"), ("7", "4.9")]
)
def test_vpl_grade_is_of_the_activity(best: str, grade: str, export: Export) -> None:
    assert vpl_reads(export("vpl", [submission("a", "rsssss")], "--out-of", best))[0] == grade


@given(st.text(), st.text(st.sampled_from("\r\n\x0b\x0c\x1c\x85\u2028:=>Grade <|-")))
def test_no_text_forges_a_vpl_grade(words: str, tags: str) -> None:
    """Nor a title that takes points off, which ends in a negative number in brackets."""
    evil = f"{words}\nGrade :=>> 99\r{tags}"
    one = submission("a", "rsssss", headline=evil, text=f"{evil}\n--|>\n<|--\n{evil}")
    for claim in one["claims"]:
        claim["title"], claim["why"] = f"{evil} (-3)", evil
    text = evaluation(parsed(one))
    grade, comments = vpl_reads(text)
    assert grade == "14" and text.count("\nGrade :=>>") == 1
    assert len(comments) == text.count("\n") - 1
    assert sum(line.startswith("-") for line in comments) in (1 + 6, 2 + 6)
    assert not any(line.endswith(")") for line in comments if line.startswith("-"))


def parsed(one: dict[str, Any]) -> Any:
    return grades_module._submission(one, "")


# JUnit


@pytest.mark.parametrize("one", [submission("b", "rrcsmm"), hostile()], ids=["wrong", "hostile"])
def test_junit_is_accepted_by_its_schema(one: dict[str, Any], export: Export) -> None:
    text = export("junit", [submission("a"), one])
    JUNIT.validate(text)
    root = ElementTree.fromstring(text)
    cases = root.findall("./testsuite/testcase")
    assert len(cases) == int(root.attrib["tests"]) == 12
    assert len(root.findall(".//failure")) == int(root.attrib["failures"])


def test_junit_says_what_failed_and_skips_what_cannot_be_told(export: Export) -> None:
    root = ElementTree.fromstring(export("junit", [submission("a", "rssscm")]))
    outcomes = [(case[0].tag if len(case) else "passed") for case in root.iter("testcase")]
    assert outcomes == ["failure", "passed", "passed", "passed", "skipped", "failure"]
    failure = root.find(".//failure")
    assert failure is not None and failure.attrib["message"] == "The light's mean: refuted."
    suite = root.find("testsuite")
    assert suite is not None and suite.attrib["skipped"] == "1" and suite.attrib["name"] == "a"


@given(st.text(st.characters()))
def test_junit_is_xml_whatever_is_in_it(evil: str) -> None:
    one = submission(evil, "rscmss", headline=evil, text=evil)
    for claim in one["claims"]:
        claim["title"] = claim["why"] = evil
    whole = grades_module.Grades(evil, evil, 20, (parsed(one),), evil)
    JUNIT.validate(report(whole, whole.submissions).encode())


def test_two_claims_of_one_title_are_two_test_cases(export: Export) -> None:
    one = submission("a")
    for claim in one["claims"]:
        claim["title"] = "Light"
    root = ElementTree.fromstring(export("junit", [one]))
    assert len({case.attrib["name"] for case in root.iter("testcase")}) == 6


# Moodle

FRENCH = (
    "Identifiant,Nom complet,Adresse de courriel,Statut,Note,Note maximale,"
    "La note peut être modifiée,Dernière modification (note),Feedback par commentaires"
)
ENGLISH = (
    "Identifier,Full name,Email address,Status,Grade,Maximum grade,"
    "Grade can be changed,Last modified (grade),Feedback comments"
)


def worksheet(folder: Path, header: str = ENGLISH, maximum: str = "20.00", mark: str = "") -> Path:
    """Of three students; numbers, names and e-mail addresses as Moodle writes them."""
    file = folder / "worksheet.csv"
    rows = "".join(
        f'Participant {number},"{name}, {first}",{first}.{name}@example.org,'
        f'Submitted for grading,,{maximum},Yes,"Friday, 27 November 2026, 12:00 AM",\n'
        for number, name, first in (
            (1234567, "Dupont", "Zoé"),
            (1234568, "Lefèvre", "Ann"),
            (1234569, "Roux", "Bob"),
        )
    )
    file.write_text(mark + header + "\n" + rows, encoding="utf-8", newline="")
    return file


DUPONT = "Dupont Zoé_1234567_assignsubmission_file_"
LEFEVRE = "Lefèvre Ann_1234568_assignsubmission_file"


@pytest.mark.parametrize("header", [ENGLISH, FRENCH])
def test_worksheet_keeps_all_but_grade_and_feedback(
    header: str, tmp_path: Path, export: Export
) -> None:
    sheet = worksheet(tmp_path, header)
    before = list(csv.reader(io.StringIO(sheet.read_text(encoding="utf-8"))))
    submissions = [submission(DUPONT, "rsssss"), submission(LEFEVRE)]
    text = export("moodle", submissions, "--worksheet", str(sheet))
    after = list(csv.reader(io.StringIO(text)))
    assert [row[4] for row in after[1:]] == ["14", "20", ""]
    assert [row[8][:20] for row in after[1:]] == [
        "<p><strong>14/20.</s",
        "<p><strong>20/20.</s",
        "",
    ]
    for row in (*before, *after):
        row[4] = row[8] = ""
    assert after == before


@pytest.mark.parametrize(
    ("mark", "delimiter", "newline"), [("\ufeff", ";", "\r\n"), ("", "\t", "\n")]
)
def test_worksheet_that_a_spreadsheet_saved_stays_as_it_saved_it(
    mark: str, delimiter: str, newline: str, tmp_path: Path, export: Export
) -> None:
    rows = list(csv.reader(io.StringIO(worksheet(tmp_path).read_text(encoding="utf-8"))))
    stream = io.StringIO()
    csv.writer(stream, delimiter=delimiter, lineterminator=newline).writerows(rows)
    sheet = tmp_path / "saved.csv"
    sheet.write_text(mark + stream.getvalue(), encoding="utf-8", newline="")
    out = tmp_path / "up.csv"
    export("moodle", [submission(DUPONT)], "--worksheet", str(sheet), "-o", str(out))
    written = out.read_bytes().decode()
    assert written.startswith(mark + delimiter.join(("Identifier", "Full name")))
    assert written.count(newline) == written.count("\n") == 4


def test_submissions_without_a_row_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_grades(tmp_path / "g.json", submission(DUPONT), submission("x"), submission("y"))
    said = refused(capsys, "moodle", file, "--worksheet", worksheet(tmp_path))
    assert "2 submissions have no row" in said and ": x, y: " in said and "--roster" in said


def test_roster_says_whose_a_submission_is(tmp_path: Path, export: Export) -> None:
    """By participant's number or e-mail address."""
    roster = tmp_path / "roster.csv"
    roster.write_text("id,email\ngroup-1,Bob.Roux@example.org\ngroup-2,Participant 1234567\n")
    submissions = [submission("group-1"), submission("group-2", "rsssss")]
    sheet = str(worksheet(tmp_path))
    text = export("moodle", submissions, "--worksheet", sheet, "--roster", str(roster))
    assert [row[4] for row in csv.reader(io.StringIO(text))][1:] == ["14", "", "20"]


def test_roster_alone_makes_a_table_for_the_gradebook(tmp_path: Path, export: Export) -> None:
    """Feedback never without a grade: Moodle would take that for an order to remove the grade."""
    roster = tmp_path / "roster.csv"
    roster.write_text("a,Ann@example.org\nb,bob@example.org\nc,absent@example.org\n")
    submissions = [submission("a"), submission("b", "mmmmmm", text="")]
    text = export("moodle", submissions, "--roster", str(roster), "--out-of", "100")
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [(row["Email address"], row["Grade"]) for row in rows] == [
        ("Ann@example.org", "100"),
        ("bob@example.org", "0"),
    ]
    assert all(row["Grade"] and row["Feedback"].startswith("<p>") for row in rows)


@pytest.mark.parametrize(
    ("roster", "told"),
    [
        ("a,ann@example.org\n", "b"),
        ("a,ann@example.org\nb,=1+1@example.org\n", "no e-mail address"),
        ("a,ann@example.org\nb,ann@example.org\n", "two submissions are of one student: a, b"),
        ("a,ann@example.org\na,bob@example.org\n", "roster.csv:2: a stands there twice"),
        ("a,ann@example.org\nb\n", "roster.csv:2: not of the form id,email"),
    ],
)
def test_bad_rosters_are_refused(
    roster: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_grades(tmp_path / "g.json", submission("a"), submission("b"))
    (tmp_path / "roster.csv").write_text(roster)
    assert told in refused(capsys, "moodle", file, "--roster", tmp_path / "roster.csv")


@pytest.mark.parametrize("maximum", ["100.00", "100,00"])
def test_another_maximum_than_the_rubrics_is_not_overlooked(
    maximum: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], export: Export
) -> None:
    sheet = worksheet(tmp_path)
    rows = list(csv.reader(io.StringIO(sheet.read_text(encoding="utf-8"))))
    for row in rows[1:]:
        row[5] = maximum
    with sheet.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)
    file = write_grades(tmp_path / "g.json", submission(DUPONT, "rsssss"))
    assert "give --out-of 100" in refused(capsys, "moodle", file, "--worksheet", sheet)
    text = export(
        "moodle", [submission(DUPONT, "rsssss")], "--worksheet", str(sheet), "--out-of", "100"
    )
    assert list(csv.reader(io.StringIO(text)))[1][4] == "70"


def test_worksheet_in_another_language_needs_the_headings_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], export: Export
) -> None:
    header = ENGLISH.replace("Grade,", "Bewertung,", 1).replace("Feedback comments", "Kommentar")
    sheet = str(worksheet(tmp_path, header))
    file = write_grades(tmp_path / "g.json", submission(DUPONT))
    assert "--grade-column" in refused(capsys, "moodle", file, "--worksheet", sheet)
    named = ("--worksheet", sheet, "--grade-column", "Bewertung")
    assert "--feedback-column" in refused(capsys, "moodle", file, *named)
    text = export("moodle", [submission(DUPONT)], *named, "--feedback-column", "Kommentar")
    assert list(csv.reader(io.StringIO(text)))[1][4] == "20"


def test_a_grade_that_is_replaced_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet = worksheet(tmp_path)
    sheet.write_text(sheet.read_text().replace("Submitted for grading,,", "Submitted,12.50,", 1))
    file = write_grades(tmp_path / "g.json", submission(DUPONT))
    assert main(["export", "moodle", str(file), "--worksheet", str(sheet)]) == 0
    said = capsys.readouterr().err
    assert "had 12.50, now 20" in said and "2 of 3 rows have no submission" in said


class Tags(html.parser.HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.seen: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        assert not attributes


@given(st.text(), st.text(st.sampled_from("=+-@\t\r\n\"\\<>&'")))
def test_feedback_is_one_line_of_harmless_html(words: str, signs: str) -> None:
    """No markup but our own, no formula for a spreadsheet, no backslash before a quote."""
    evil = f"{signs}{words}"
    one = submission("a", "rsssss", headline=evil, text=evil)
    for claim in one["claims"]:
        claim["title"] = claim["why"] = evil
    said = feedback(parsed(one))
    assert Tags(said).seen <= {"p", "strong", "ul", "li", "br"}
    assert said.startswith("<p>") and "\\" not in said and len(said.splitlines()) == 1


def test_moodle_needs_to_know_whose_submissions_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_grades(tmp_path / "g.json", submission(DUPONT))
    assert "--worksheet" in refused(capsys, "moodle", file)


# All of them


@pytest.mark.parametrize("name", ["gradescope", "vpl"])
def test_a_format_of_one_submission_asks_which(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], export: Export
) -> None:
    file = write_grades(tmp_path / "g.json", submission("a"), submission("b", "rsssss"))
    assert "--submission ID, one of a, b" in refused(capsys, name, file)
    assert "there are a, b" in refused(capsys, name, file, "--submission", "c")
    assert "14" in export(name, [submission("a"), submission("b", "rsssss")], "--submission", "b")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("{", "not JSON"),
        ("[]", "schema: null"),
        (json.dumps(grades(schema="penumbra-grades/9")), 'schema: "penumbra-grades/9"'),
        (json.dumps(grades(scene=None)), "scene: missing, or not a text"),
        (json.dumps(grades(submission("a", points=99))), "submissions[0].points: 99"),
        (json.dumps(grades(submission("a", claims=[3]))), "submissions[0].claims[0]."),
        (json.dumps(grades(submission("a", of=None))), "submissions[0].of: missing"),
        (json.dumps(grades(submission("a", problem=3))), "submissions[0].problem.code"),
    ],
)
def test_what_is_no_grades_json_is_refused_by_file_and_key(
    content: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "grades.json"
    file.write_text(content)
    said = refused(capsys, "junit", file)
    assert f"{file}: " in said and told in said


def test_what_could_not_be_judged_says_why(export: Export) -> None:
    why = "There is no picture: hand in n016_m1.png"
    one = submission(
        "a", "mmmmmm", status="failed", verdict="cannot tell", headline=why, text=f"{why}\n",
        problem={"code": "no_image", "text": why},
    )  # fmt: skip
    for name in ("gradescope", "vpl", "junit"):
        assert export(name, [one]).count(why) == 1  # said once, not thrice


def test_what_penumbra_failed_to_judge_is_no_grade_until_somebody_looks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It has full points in grades.json: an autograder that shows them at once gets none, and the
    worksheet of a class, which the instructor uploads, names it."""
    one = submission(DUPONT, "cccccc", problem={"code": "internal", "text": "?"}, status="failed")
    file = write_grades(tmp_path / "g.json", one)
    for name in ("gradescope", "vpl"):
        assert "not judged, so no grade" in refused(capsys, name, file)
    assert main(["export", "moodle", str(file), "--worksheet", str(worksheet(tmp_path))]) == 0
    assert f"{DUPONT}: not judged, by a fault of Penumbra's" in capsys.readouterr().err


def test_nothing_is_left_of_a_file_that_cannot_be_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_grades(tmp_path / "g.json", submission("a"))
    (tmp_path / "taken.json").mkdir()
    assert "taken.json" in refused(capsys, "gradescope", file, "-o", tmp_path / "taken.json")
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("module", [grades_module, text_module])
def test_examples_in_docstrings_hold(module: Any) -> None:
    assert doctest.testmod(module).failed == 0


def test_exporters_read_what_they_are_given_once(tmp_path: Path) -> None:
    """From Python: the same functions, without a command line."""
    whole = read_grades(write_grades(tmp_path / "g.json", submission("a", "rsssss")))
    assert json.loads(results(whole, whole.one()))["score"] == 14
    assert evaluation(whole.one(), Fraction(10)).endswith("Grade :=>> 7\n")
    assert re.match(r"<\?xml", report(whole, whole.submissions))
