"""The page's check of a student's picture: its scripts, scenes and texts."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

from markupsafe import Markup

from penumbra.compare.check.catalogue import SPLIT, TEXTS, Choice, catalogue
from penumbra.compare.check.picture import NAMES
from penumbra.compare.check.words import OBJECTS, WORDS
from penumbra.compare.run.provenance import ROOT
from penumbra.language import _, speaking

TEMPLATES = Path(__file__).resolve().parent / "template" / "check"
SCRIPTS = ("numbers", "picture", "grid", "view", "prediction", "diagnosis", "light", "verdict",
           "check")  # fmt: skip
"""What the check's worker runs, in this order, after the catalogue"""
SCENES = ("tp3", "tp3_statement")
PARAMETERS = {"domain": "a, b", "scale": "n, area, norms", "average": "n, i", "colour": "c"}
"""Of the modules whose expressions the page evaluates; the library of mistakes has the others"""
_FUNCTIONS = {"where": "where", "pow": "Math.pow", "cos": "Math.cos", "exp": "Math.exp",
              "sqrt": "Math.sqrt", "fmax": "Math.max", "fmin": "Math.min", "floor": "Math.floor",
              "fabs": "Math.abs"}  # fmt: skip
_OPERATORS: dict[type, str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.USub: "-"},
    **{ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "===", ast.NotEq: "!=="},
}


def worker() -> str:
    """The script of the check's worker."""
    sources = [(TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS]
    return "\n".join(['"use strict";', catalogue_script(), *sources])


def catalogue_script() -> str:
    """The choices of the catalogue, but for those of several lights: the lab's scene has one."""
    choices = [choice for choice in catalogue().choices.values() if choice.module != "lights"]
    return (
        "const CATALOGUE = [\n" + "".join(f"  {_entry(choice)},\n" for choice in choices) + "];\n"
    )


def _entry(choice: Choice) -> str:
    fields, functions, kind = {}, [], ""
    if choice.module in ("visibility", "output"):
        names = [a.partition("=")[0].strip().lstrip(".") for a in choice.arguments]
        fields = {name: choice.field(name) for name in names}
    elif choice.module in ("clamp", "generator"):
        kind = choice.arguments[0]
    elif choice.module in PARAMETERS:
        parameters, expressions = PARAMETERS[choice.module], choice.arguments
        if choice.macro == SPLIT:
            kind, *expressions = choice.arguments  # type: ignore[assignment]
            parameters = "n, k"
        functions = [f"({parameters}) => {javascript(e)}" for e in expressions]
    said = {"module": choice.module, "name": choice.name, "mistake": choice.mistake,
            "macro": choice.macro, "kind": kind, "fields": fields}  # fmt: skip
    return json.dumps(said)[:-1] + f', "functions": [{", ".join(functions)}]}}'


def javascript(expression: str) -> str:
    """An expression of the catalogue, which C and Python read too. Raises ValueError.

    >>> javascript("where(i == 0, pow(0.5, n - 1), 1 / PI)")
    '((i === 0) ? Math.pow(0.5, (n - 1)) : (1 / Math.PI))'
    """
    return _translated(ast.parse(expression, mode="eval").body)


def _translated(node: ast.expr) -> str:
    match node:
        case ast.Constant(value=int() | float() as value):
            return repr(value)
        case ast.Name(id="PI"):
            return "Math.PI"
        case ast.Name(id=name):
            return name
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return f"(-{_translated(operand)})"
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return f"({_translated(left)} {_OPERATORS[type(op)]} {_translated(right)})"
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _OPERATORS:
            return f"({_translated(left)} {_OPERATORS[type(op)]} {_translated(right)})"
        case ast.Call(func=ast.Name(id="where"), args=[condition, yes, no]):
            return f"({_translated(condition)} ? {_translated(yes)} : {_translated(no)})"
        case ast.Call(func=ast.Name(id=name), args=arguments) if name in _FUNCTIONS:
            return f"{_FUNCTIONS[name]}({', '.join(map(_translated, arguments))})"
    raise ValueError(f"{ast.unparse(node)}: not an expression that the page can evaluate")


def texts() -> list[str]:
    """What a verdict may hold: the words of `penumbra check`, and what is said of each mistake."""
    mistakes = catalogue().mistakes.values()
    objects = [text for pair in OBJECTS.values() for text in pair]
    said = [getattr(mistake, field) for mistake in mistakes for field in TEXTS]
    return [*WORDS.values(), *objects, *NAMES, *said]


def drop(build_dir: Path) -> dict[str, Any]:
    """What the template finds under `drop`."""
    scenes = {name: json.loads((ROOT / "scenes" / f"{name}.json").read_text()) for name in SCENES}
    mistakes = {
        name: {key: getattr(mistake, key) for key in TEXTS}
        for name, mistake in catalogue().mistakes.items()
    }
    with speaking("fr"):
        messages = {text: french for text in texts() if (french := _(text)) != text}
    return {
        "data": {
            "scenes": scenes,
            "words": WORDS,
            "objects": OBJECTS,
            "mistakes": mistakes,
            "messages": messages,
        },
        "worker": Markup(worker()),
    }
