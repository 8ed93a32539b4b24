"""Gradescope's results.json of one submission.

Documented at gradescope-autograders.readthedocs.io, "Autograder Specifications". Everything is of
the format "text", which Gradescope shows as it is: no student's word becomes HTML or Markdown.
"""

from __future__ import annotations

import json
from typing import Any

from penumbra.grading.export.grades import CANNOT_TELL, SHOWN, Claim, Grades, Submission
from penumbra.grading.export.text import lines, one_line
from penumbra.language import _, say

VISIBILITIES = ("visible", "after_due_date", "after_published", "hidden")


def results(grades: Grades, submission: Submission, visibility: str = "visible") -> str:
    """The file's text. visibility: of claims and explanation, one of VISIBILITIES.

    What only the instructor may read is a test that is hidden and has no points.
    """
    whole = {
        "score": submission.points,
        "output": "\n".join(lines(f"{submission.headline}\n\n{submission.details}")),
        "output_format": "text",
        "test_output_format": "text",
        "test_name_format": "text",
        "visibility": visibility,
        "stdout_visibility": "hidden",
        "tests": [
            *(_test(number, claim) for number, claim in enumerate(submission.claims, start=1)),
            _for_instructor(submission),
        ],
        "extra_data": {
            "scene": grades.scene,
            "rubric": grades.title,
            "verdict": submission.verdict,
            "penumbra": grades.version,
        },
    }
    return json.dumps(whole, indent=1) + "\n"


def _test(number: int, claim: Claim) -> dict[str, Any]:
    test = {
        "number": str(number),
        "name": one_line(claim.title),
        "score": claim.points,
        "max_score": claim.of,
        "output": "\n".join(lines(claim.reason)),
        "tags": [claim.state.replace(" ", "_")],
    }
    if claim.state != CANNOT_TELL:  # Gradescope then goes by the points
        test["status"] = "passed" if claim.state == SHOWN else "failed"
    return test


def _for_instructor(submission: Submission) -> dict[str, Any]:
    said = [
        say("submission: {id}", id=one_line(submission.id)),
        say("verdict: {verdict}", verdict=submission.verdict),
    ]
    said += [say("mistake: {title}", title=one_line(title)) for title in submission.mistakes]
    said += [say("cannot tell, look at it: {t}", t=one_line(t)) for t in submission.for_instructor]
    return {"name": _("For the instructor"), "output": "\n".join(said), "visibility": "hidden"}
