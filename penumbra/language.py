"""The language that a person is spoken to in: English, or French by the catalogue in locale/.

Texts stand in the code in English, in `_(...)` where they are said and `N_(...)` where they are
only listed; locale/fr/LC_MESSAGES/penumbra.po has the French. What a program reads (names, codes,
keys of JSON) is in no language.
"""

from __future__ import annotations

import gettext
import os
import string
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any

LANGUAGES = ("en", "fr")
LOCALE = Path(__file__).resolve().parent / "locale"
NO_BREAK = "\u00a0"
"""What French puts before : ; ! ? % and inside « »"""
_spoken = ContextVar("spoken", default="en")


def language() -> str:
    """The one that is spoken now, of LANGUAGES."""
    return _spoken.get()


def of_environment(environment: Mapping[str, str] = os.environ) -> str:
    """What the variables LANGUAGE, LC_ALL, LC_MESSAGES and LANG ask for, of LANGUAGES.

    >>> of_environment({"LANG": "fr_CA.UTF-8"}), of_environment({"LANG": "de_DE"})
    ('fr', 'en')
    """
    for name in ("LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"):
        if value := environment.get(name):
            return next((w[:2] for w in value.split(":") if w[:2] in LANGUAGES), "en")
    return "en"


@contextmanager
def speaking(chosen: str) -> Iterator[None]:
    """In this language, of LANGUAGES, in this thread: others, of a worker that is asked by several
    people, may speak another."""
    before = _spoken.set(chosen)
    try:
        yield
    finally:
        _spoken.reset(before)


def _(text: str) -> str:
    """The text in the language that is spoken now; as it is where nobody has translated it."""
    return _catalogue(language()).gettext(text) if text else text


def N_(text: str) -> str:
    """Marks a text to be translated where it is said."""
    return text


@cache
def _catalogue(chosen: str) -> gettext.NullTranslations:
    if chosen == "en":
        return gettext.NullTranslations()
    return gettext.translation("penumbra", LOCALE, [chosen], fallback=True)


class _Numbers(string.Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        text = str(format(value, format_spec))
        return localised(text) if isinstance(value, Real) else text


def say(text: str, /, **values: Any) -> str:
    """The text in the language that is spoken now, its {name:format} filled, numbers written as the
    language writes them.

    >>> with speaking("fr"):
    ...     say("{share:.1%}", share=0.256)
    '25,6\\xa0%'
    """
    return _Numbers().vformat(_(text), (), values)


def numbers(values: Iterable[float], unit: float = 1, form: str = ".2g") -> str:
    """Several, each over the unit, in a list whose commas are no decimal ones.

    >>> numbers((51, 0, 25.5), 255)
    '0.2, 0, 0.1'
    """
    return _(", ").join(localised(format(value / unit, form)) for value in values)


def localised(number: str) -> str:
    """A number as the language that is spoken now writes it: a decimal comma in French.

    >>> with speaking("fr"):
    ...     localised("1.5"), localised("20%")
    ('1,5', '20\\xa0%')
    """
    if language() != "fr":
        return number
    number = number.replace(",", NO_BREAK).replace(".", ",")
    return number.replace("%", NO_BREAK + "%")
