"""Numbers as the page writes them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def region_title(region: str) -> str:
    return "all objects" if region == "all" else region


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
    return f"{mantissa} × {_ten_to(int(exponent))}".replace("-", "−")


def _ten_to(exponent: int) -> str:
    return "10" + str(exponent).translate(SUPERSCRIPT)


def power(value: float) -> str:
    """
    >>> power(0.0), power(1.0), power(1e-6), power(20.0)
    ('0', '1', '10⁻⁶', '20')
    """
    if value == 0 or value == 1 or not math.log10(value).is_integer():
        return f"{value:g}"
    return _ten_to(round(math.log10(value)))


def signed_power(value: float) -> str:
    """
    >>> signed_power(-1e-7), signed_power(2e-9), signed_power(0.0), signed_power(31000.0)
    ('−10⁻⁷', '2·10⁻⁹', '0', '3.1·10⁴')
    """
    sign, size = ("−" if value < 0 else ""), abs(value)
    if size == 0 or 0.01 <= size < 1000:
        return sign + f"{size:g}"
    mantissa, _, exponent = f"{size:.1e}".partition("e")
    scale = power(float(f"1e{exponent}"))
    return sign + (scale if float(mantissa) == 1 else f"{float(mantissa):g}·{scale}")


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
