"""Exit codes."""

from __future__ import annotations

PASS, FAIL, USAGE, MISSING, CANNOT_TELL, SIGNALLED = 0, 1, 2, 3, 4, 128
"""Done; a check failed; wrong usage, bad input or unwritable output; a program or library is
missing; a check cannot tell; SIGNALLED + n: ended by signal n, as a shell says it (130 is
Ctrl-C)."""


EXTRA_OF = {
    "bpy": "cycles",
    **dict.fromkeys(("colour", "flip_evaluator"), "perceptual"),
    **dict.fromkeys(("cryptography", "dask", "distributed"), "class"),
    **dict.fromkeys(("latex2mathml", "markdown_it", "typst"), "course"),
    **dict.fromkeys(("jinja2", "markupsafe", "matplotlib"), "report"),
}
"""Modules that do not come with every use, and the extra of pyproject.toml that brings them"""


class UsageError(ValueError):
    """Options that do not go together; the text says which."""
