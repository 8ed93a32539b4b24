"""Texts that students had a hand in, made harmless for formats that live by lines."""

from __future__ import annotations

import re

UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
"""Control characters, and what breaks a line somewhere"""
DECEIVING = re.compile("[\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff]")
"""They turn the direction of what follows: 41 that reads 14"""
NOT_IN_XML = re.compile("[\ud800-\udfff\ufffe\uffff]")
"""Beside control characters, what XML 1.0 forbids; lone surrogates stand for bytes of a file's name
that are no UTF-8"""


def one_line(text: str) -> str:
    """
    >>> one_line("mine\\nGrade :=>> 20\\r")
    'mine Grade :=>> 20'
    """
    text = DECEIVING.sub("", UNPRINTABLE.sub(" ", text))
    return NOT_IN_XML.sub("\ufffd", text).strip()


def lines(text: str) -> list[str]:
    """Its lines, whatever ends them, each as harmless as one_line's but with its indentation.

    >>> lines("a\\r\\n  b\\x00c\\u2028d\\n")
    ['a', '  b c', 'd']
    """
    split = (UNPRINTABLE.sub(" ", line) for line in text.splitlines())
    return [NOT_IN_XML.sub("\ufffd", DECEIVING.sub("", line)).rstrip() for line in split]
