"""The catalogue of mistakes, and what a renderer is to it: one choice in each module.

The entries stand in c_renderer/mistakes/catalogue.def, which says what each field is; the library
of mistakes compiles the same text.
"""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from types import CodeType
from typing import Any

import numpy as np

from penumbra.compare.run.provenance import ROOT
from penumbra.language import _

FILE = ROOT / "c_renderer" / "mistakes" / "catalogue.def"
MODULES = ("domain", "visibility", "weight", "scale", "lights", "average", "clamp", "output",
           "colour", "generator")  # fmt: skip
"""In the order of C's enum Module"""
STUDENTS = 27
"""Public repositories of the lab that were built, rendered and read to count mistakes"""
TEXTS = ("title", "cause", "wrong", "right", "step", "look")
"""Fields of a Mistake that are translated"""
RIGHT = "std"
SPLIT = "SPLIT"
_ENTRY = re.compile(r"^([A-Z]+)\(", re.M)
_FUNCTIONS: dict[str, Any] = {
    **{"where": np.where, "pow": np.power, "cos": np.cos, "exp": np.exp, "sqrt": np.sqrt},
    **{"fmax": np.maximum, "fmin": np.minimum, "floor": np.floor, "fabs": np.abs, "PI": math.pi},
}


@dataclass(frozen=True)
class Mistake:
    """What is said of a mistake: its MISTAKE entry, in English until it is spoken()."""

    name: str
    title: str
    cause: str
    wrong: str
    right: str
    step: str
    """place in the handout"""
    look: str
    """the question that finds it"""
    seen: int
    """how many of STUDENTS programs had it; 0: none, or not known"""

    def spoken(self) -> Mistake:
        """Its texts in the language that is spoken."""
        texts: dict[str, Any] = {field: _(getattr(self, field)) for field in TEXTS}
        return replace(self, **texts)

    @property
    def anchor(self) -> str:
        """Of its exhibit in the museum of the course's page."""
        return f"mistake-{self.name}"

    @property
    def usual(self) -> bool:
        """Most had it."""
        return self.seen > STUDENTS / 2


@dataclass(frozen=True)
class Choice:
    """One entry of a module."""

    module: str
    name: str
    arguments: tuple[str, ...]
    """as they stand in the catalogue"""
    mistake: str
    """the name that it goes under; "" of what is sound"""
    macro: str

    def field(self, name: str) -> float:
        """Of a VISIBILITY or OUTPUT entry; 0 where it does not say."""
        for argument in self.arguments:
            key, _, value = argument.partition("=")
            if key.strip() == f".{name}":
                return float(value)
        return 0.0

    def evaluate(self, argument: int, **values: Any) -> Any:
        """One of its expressions."""
        return evaluate(self.arguments[argument], values)


@dataclass(frozen=True)
class Catalogue:
    mistakes: dict[str, Mistake]
    choices: dict[tuple[str, str], Choice]
    """by module and name, in the file's order"""

    def of_module(self, module: str) -> list[Choice]:
        return [choice for choice in self.choices.values() if choice.module == module]


@dataclass(frozen=True)
class Variant:
    """A renderer: a choice in each module, and an unexplained constant factor.

    >>> Variant(weight="pdf_times_cos").mistakes
    ('pdf_times_cos',)
    >>> Variant(visibility="offset_0_01").mistakes
    ()
    """

    domain: str = RIGHT
    visibility: str = RIGHT
    weight: str = RIGHT
    scale: str = RIGHT
    lights: str = RIGHT
    average: str = RIGHT
    clamp: str = RIGHT
    output: str = RIGHT
    colour: str = RIGHT
    generator: str = RIGHT
    factor: float = 1.0

    @cached_property
    def choices(self) -> tuple[Choice, ...]:
        """One of each module"""
        table = catalogue().choices
        return tuple(table[module, getattr(self, module)] for module in MODULES)

    @cached_property
    def wrong(self) -> tuple[Choice, ...]:
        """Those that are mistakes"""
        return tuple(choice for choice in self.choices if choice.mistake)

    @cached_property
    def mistakes(self) -> tuple[str, ...]:
        """Their names, each once, sorted"""
        return tuple(sorted({choice.mistake for choice in self.wrong}))

    def __getitem__(self, module: str) -> Choice:
        return catalogue().choices[module, getattr(self, module)]

    def replaced(self, choice: Choice) -> Variant:
        return replace(self, **{choice.module: choice.name})  # type: ignore[arg-type]

    def __str__(self) -> str:
        return " + ".join(c.name for c in self.wrong) or "right"


assert tuple(f.name for f in fields(Variant))[:-1] == MODULES


@cache
def catalogue() -> Catalogue:
    """The file, read. Raises ValueError for an entry that it cannot hold."""
    text = re.sub(r"/\*[\s\S]*?\*/", "", FILE.read_text())
    mistakes: dict[str, Mistake] = {}
    choices: dict[tuple[str, str], Choice] = {}
    under = ""
    for match in _ENTRY.finditer(text):
        macro, arguments = match.group(1), _arguments(text, match.end())
        if macro == "MISTAKE":
            name, *said = arguments
            mistakes[name] = Mistake(name, *(ast.literal_eval(f"({part})") for part in said))
            under = name
        else:
            module = "average" if macro == SPLIT else macro.lower()
            name, *rest = arguments
            if module not in MODULES or (module, name) in choices:
                raise ValueError(f"{FILE}: {macro}({name}, ...): unknown, or there already")
            choices[module, name] = Choice(module, name, tuple(rest), under, macro)
    return Catalogue(mistakes, choices)


def _arguments(text: str, start: int) -> list[str]:
    """What stands between the parenthesis that ends at `start` and the one that closes it."""
    depth, quoted, part, found = 1, False, "", []
    for character in text[start:]:
        if character == '"':
            quoted = not quoted
        if not quoted:
            depth += (character == "(") - (character == ")")
            if depth == 0:
                break
            if depth == 1 and character == ",":
                found.append(part.strip())
                part = ""
                continue
        part += character
    return [*found, part.strip()]


def evaluate(expression: str, values: dict[str, Any]) -> Any:
    """An expression of the catalogue, of numbers or arrays."""
    return eval(_compiled(expression), {"__builtins__": {}}, {**_FUNCTIONS, **values})


@cache
def _compiled(expression: str) -> CodeType:
    return compile(expression, str(FILE), "eval")
