"""JUnit XML, what CI systems show: a submission is a suite, a claim of the rubric a test case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from xml.etree import ElementTree

from penumbra.grading.export.grades import CANNOT_TELL, MISSING, REFUTED, Claim, Grades, Submission
from penumbra.grading.export.text import lines, one_line
from penumbra.language import say


def report(grades: Grades, submissions: Sequence[Submission]) -> str:
    """The file's text. What is refuted, or was not handed in, failed; what cannot be told was
    skipped. Without times, which grades.json has not."""
    root = ElementTree.Element("testsuites", name=f"penumbra: {one_line(grades.scene)}")
    for submission in submissions:
        _suite(root, grades, submission)
    cases = [claim for one in submissions for claim in one.claims]
    root.attrib |= {"tests": str(len(cases)), "failures": str(_failures(cases)), "errors": "0"}
    ElementTree.indent(root, " ")
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _suite(root: ElementTree.Element, grades: Grades, submission: Submission) -> None:
    name = one_line(submission.id)
    suite = ElementTree.SubElement(
        root,
        "testsuite",
        name=name,
        tests=str(len(submission.claims)),
        failures=str(_failures(submission.claims)),
        errors="0",
        skipped=str(sum(claim.state == CANNOT_TELL for claim in submission.claims)),
    )
    properties = ElementTree.SubElement(suite, "properties")
    for key, value in {
        "points": str(submission.points),
        "of": str(submission.of),
        "verdict": submission.verdict,
        "penumbra": one_line(grades.version),
    }.items():
        ElementTree.SubElement(properties, "property", name=key, value=value)
    used: Counter[str] = Counter()
    for claim in submission.claims:
        title = one_line(claim.title)
        used[title] += 1
        if used[title] > 1:  # a CI system takes two of one name for two runs of one
            title += f" ({used[title]})"
        case = ElementTree.SubElement(suite, "testcase", classname=name, name=title)
        _outcome(case, claim)
    out = ElementTree.SubElement(suite, "system-out")
    out.text = "\n".join(lines(f"{submission.headline}\n\n{submission.details}"))


def _outcome(case: ElementTree.Element, claim: Claim) -> None:
    why = one_line(claim.reason)
    if claim.state in (REFUTED, MISSING):
        failure = ElementTree.SubElement(case, "failure", type=claim.state, message=why)
        failure.text = say(
            "{points} of {of} points\n", points=claim.points, of=claim.of
        ) + "\n".join(lines(claim.reason))
    elif claim.state == CANNOT_TELL:
        ElementTree.SubElement(case, "skipped", type=claim.state, message=why)


def _failures(claims: Sequence[Claim]) -> int:
    return sum(claim.state in (REFUTED, MISSING) for claim in claims)
