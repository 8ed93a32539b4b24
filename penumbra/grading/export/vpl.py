"""The lines that VPL, Moodle's Virtual Programming Lab, reads from an evaluation.

`Grade :=>>` proposes a grade, `Comment :=>>` says something; a comment that starts with `-` is a
title, one with `>` is shown as it is. Every line is a comment of its own: VPL looks for the grade
in each line that there is, those between `<|--` and `--|>` included, and takes the last.
"""

from __future__ import annotations

from fractions import Fraction

from penumbra.grading.export.grades import Submission, scaled
from penumbra.grading.export.text import lines, one_line
from penumbra.language import _, say

COMMENT, GRADE = "Comment :=>>", "Grade :=>>"


def evaluation(submission: Submission, out_of: Fraction | None = None) -> str:
    """The lines of one submission. out_of: the activity's best grade, $VPL_GRADEMAX."""
    said = [
        _title(say("Grade: {points}/{of}", points=submission.points, of=submission.of)),
        *_shown(submission.headline),
    ]
    for claim in submission.claims:
        said.append(_title(f"{claim.title}: {claim.points}/{claim.of}"))
        said += _shown(claim.reason)
    if submission.details:
        said += [_title(_("Details")), *_shown(submission.details)]
    grade = scaled(submission.points, submission.of, out_of)
    return "\n".join([*(COMMENT + one for one in said), f"{GRADE} {grade}"]) + "\n"


def _title(text: str) -> str:
    """One that ends in ")" might be read as points to take off; these end in points."""
    return f"-{one_line(text)}"


def _shown(text: str) -> list[str]:
    return [f">{line}" for line in lines(text)]
