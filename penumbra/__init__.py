"""Soft shadows, rendered, referenced, compared and explained: a course toolkit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from penumbra.assertions import (
        CannotTell,
        NotShown,
        Refuted,
        assert_agrees,
        assert_noise_falls,
        assert_right,
    )

__all__ = [
    "CannotTell",
    "NotShown",
    "Refuted",
    "assert_agrees",
    "assert_noise_falls",
    "assert_right",
]


def __getattr__(name: str) -> Any:
    """The assertions, loaded when they are asked for: `import penumbra` costs nothing."""
    if name in __all__:
        from penumbra import assertions

        return getattr(assertions, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
