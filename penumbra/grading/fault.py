"""What is wrong with a submission before its pictures can be judged."""

from __future__ import annotations

from typing import Literal

from penumbra.compare.run.renderers import RendererError

Code = Literal[
    "time_limit", "memory_limit", "process_limit", "file_limit", "disk_limit", "output_limit",
    "forbidden", "crashed", "no_image", "bad_image", "build_failed", "manifest", "archive",
]  # fmt: skip


class SubmissionFault(RendererError):
    """A limit that was reached, a misdeed, or something that does not work; the text is a sentence
    for the student, the same on every machine."""

    def __init__(self, code: Code, text: str, printed: str = "") -> None:
        super().__init__(text)
        self.code: Code = code
        self.text = text
        self.printed = printed
        """the end of what the program or its build printed, harmless to a terminal; it may differ
        from run to run"""

    def __reduce__(self) -> tuple[type[SubmissionFault], tuple[str, str, str]]:
        return type(self), (self.code, self.text, self.printed)
