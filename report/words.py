"""Numbers as the page writes them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any


def size_of(values: dict[str, Any]) -> str:
    return f"{values['width']} × {values['height']}"


def digits(value: float | None, significant: int = 3) -> str:
    """
    >>> digits(0.0123456), digits(-12345.0), digits(0.0), digits(None)
    ('0.0123', '−12300', '0', '–')
    """
    if value is None:
        return "–"
    if value == 0 or not math.isfinite(value):
        return {0: "0", math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    rounded = float(f"{value:.{significant}g}")
    if 1e-3 <= abs(rounded) < 1e6:
        decimals = max(0, significant - 1 - math.floor(math.log10(abs(rounded))))
        return f"{rounded:.{decimals}f}".replace("-", "−")
    mantissa, exponent = f"{value:.{significant - 1}e}".split("e")
    superscript = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{mantissa} × 10{superscript}".replace("-", "−")


def fixed(value: float | None, decimals: int = 3) -> str:
    return "–" if value is None else f"{value:.{decimals}f}".replace("-", "−")


def signed_percent(value: float | None) -> str:
    """
    >>> signed_percent(-0.000123), signed_percent(1.2e-9), signed_percent(None)
    ('−0.0123', '0.0000', '–')
    """
    if value is None:
        return "–"
    text = f"{100 * value:+.4f}"
    return "0.0000" if float(text) == 0 else text.replace("-", "−")


def percent(value: float) -> str:
    return f"{100 * value:.4g} %"


def times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def interval(low: float | None, high: float | None, text: Callable[[float], str]) -> str:
    return "–" if low is None or high is None else f"[{text(low)}, {text(high)}]"
