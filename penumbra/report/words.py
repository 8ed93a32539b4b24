"""Numbers and names as the page writes them, in the language that is spoken."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import Any

from penumbra.language import N_, NO_BREAK, _, language, localised, say

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
REGIONS = {
    "all": N_("all objects"),
    "lit": N_("lit"),
    "penumbra": N_("penumbra"),
    "umbra": N_("umbra"),
    "silhouette": N_("silhouette"),
    "floor": N_("floor"),
    "sphere": N_("sphere"),
}
"""Those of the studies, and the lab's objects. Any other object is named as its scene names it"""


def region_title(region: str) -> str:
    """
    >>> region_title("all"), region_title("floor:penumbra"), region_title("teapot")
    ('all objects', 'floor, penumbra', 'teapot')
    """
    return ", ".join(_(REGIONS.get(part, part)) for part in region.split(":"))


def region_word(region: str) -> str:
    """In a table, where all objects are but "all"."""
    return _("all") if region == "all" else region_title(region)


def against(first: str, second: str) -> str:
    """Of two images that are compared."""
    return say("{first} against {second}", first=first, second=second)


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
        return plain(f"{rounded:.{decimals}f}")
    mantissa, exponent = f"{value:.{significant - 1}e}".split("e")
    return f"{plain(mantissa)} × {_ten_to(int(exponent))}"


def plain(number: str) -> str:
    """A formatted number with the language's decimal mark, and a minus sign.

    >>> plain("-1.5")
    '−1.5'
    """
    return localised(number).replace("-", "−")


def _ten_to(exponent: int) -> str:
    return "10" + str(exponent).translate(SUPERSCRIPT)


def power(value: float) -> str:
    """
    >>> power(0.0), power(1.0), power(1e-6), power(20.0)
    ('0', '1', '10⁻⁶', '20')
    """
    if value == 0 or value == 1 or not math.log10(value).is_integer():
        return localised(f"{value:g}")
    return _ten_to(round(math.log10(value)))


def signed_power(value: float) -> str:
    """
    >>> signed_power(-1e-7), signed_power(2e-9), signed_power(0.0), signed_power(31000.0)
    ('−10⁻⁷', '2·10⁻⁹', '0', '3.1·10⁴')
    """
    sign, size = ("−" if value < 0 else ""), abs(value)
    if size == 0 or 0.01 <= size < 1000:
        return sign + localised(f"{size:g}")
    mantissa, _mark, exponent = f"{size:.1e}".partition("e")
    scale = power(float(f"1e{exponent}"))
    return sign + (
        scale if float(mantissa) == 1 else localised(f"{float(mantissa):g}") + f"·{scale}"
    )


def fixed(value: float | None, decimals: int = 3) -> str:
    return "–" if value is None else plain(f"{value:.{decimals}f}")


def signed_percent(value: float | None) -> str:
    """
    >>> signed_percent(-0.000123), signed_percent(1.2e-9), signed_percent(None)
    ('−0.0123', '0.0000', '–')
    """
    if value is None:
        return "–"
    text = f"{100 * value:+.4f}"
    return plain("0.0000" if float(text) == 0 else text)


def percent(value: float) -> str:
    """
    >>> percent(0.0005)
    '0.05 %'
    """
    return localised(f"{100 * value:.4g}") + (NO_BREAK if language() == "fr" else " ") + "%"


def times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def interval(low: float | None, high: float | None, text: Callable[[float], str]) -> str:
    return "–" if low is None or high is None else f"[{listed([text(low), text(high)])}]"


def phrases(texts: Iterable[str]) -> str:
    """Side by side, with semicolons.

    >>> phrases(["one", "two"])
    'one; two'
    """
    return (NO_BREAK + "; " if language() == "fr" else "; ").join(texts)


def all_of(texts: Sequence[str]) -> str:
    """
    >>> all_of(["one", "two"])
    'one and two'
    """
    return reduce(lambda a, b: say("{first} and {second}", first=a, second=b), texts)


def any_of(texts: Sequence[str]) -> str:
    """
    >>> any_of(["one", "two"])
    'one or two'
    """
    return reduce(lambda a, b: say("{first} or {second}", first=a, second=b), texts)


def listed(numbers: Iterable[str]) -> str:
    """Side by side, told apart from a decimal comma.

    >>> listed(["1.5", "2"])
    '1.5, 2'
    """
    return (NO_BREAK + "; " if language() == "fr" else ", ").join(numbers)
