"""The page's sections, in order. A new one is an entry here, its module, and its template."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from penumbra.language import N_
from penumbra.report.agreement import agreement
from penumbra.report.antialiasing import antialiasing
from penumbra.report.check import CALIBRATION, check
from penumbra.report.comparer import compare
from penumbra.report.convergence import convergence
from penumbra.report.inputs import COMPARISONS, CONVERGENCE, CONVERGENCE_CSV, IMAGES, Data, Input
from penumbra.report.lights import PROFILE, lights
from penumbra.report.remake import remake
from penumbra.report.self_shadow import SELF_SHADOW, SELF_SHADOW_CSV, self_shadow
from penumbra.report.shadows import samples, shadows
from penumbra.report.speed import BENCH, speed
from penumbra.report.stability import STABILITY, stability
from penumbra.report.threads import SPEEDUP, threads
from penumbra.report.trade import TRADE, trade


def nothing(data: Data) -> dict[str, Any]:
    """Of a section that says the same whatever was measured."""
    return {}


@dataclass(frozen=True)
class Section:
    name: str
    """its anchor, and its files in template/: NAME.html.j2, and NAME.css and NAME.js if any"""
    title: str
    inputs: Sequence[Input]
    build: Callable[[Data], dict[str, Any]]
    """makes what its template shows, and finds there under the section's name"""
    optional: bool = False
    """left out where none of its inputs is there"""


SECTIONS = (
    Section("shadows", N_("Hard and soft shadows"), IMAGES, shadows),
    Section("samples", N_("More shadow rays"), IMAGES, samples),
    Section("compare", N_("Compare any two images"), IMAGES, compare),
    Section("agreement", N_("Is it right?"), (*IMAGES, *COMPARISONS), agreement),
    Section(
        "convergence",
        N_("How fast does it converge?"),
        (CONVERGENCE_CSV, CONVERGENCE),
        convergence,
    ),
    Section(
        "antialiasing",
        N_("Why is there less noise in the shadow?"),
        (*IMAGES, CONVERGENCE_CSV, CONVERGENCE),
        antialiasing,
    ),
    Section("threads", N_("Threads"), (SPEEDUP,), threads),
    Section("trade", N_("What does a millisecond buy?"), (TRADE,), trade, optional=True),
    Section("speed", N_("How fast is that?"), (BENCH,), speed, optional=True),
    Section(
        "self_shadow",
        N_("Where should a shadow ray start?"),
        (SELF_SHADOW, SELF_SHADOW_CSV),
        self_shadow,
        optional=True,
    ),
    Section("stability", N_("Where do floats break?"), (STABILITY,), stability, optional=True),
    Section("check", N_("How often is a check right?"), (CALIBRATION,), check, optional=True),
    Section("lights", N_("Other lights"), (*IMAGES, *COMPARISONS, PROFILE), lights),
    Section("remake", N_("What was rendered, and how to remake it"), IMAGES, remake),
    Section("glossary", N_("Glossary"), (), nothing),
)
"""Images of the sections' inputs are also in the comparer, and listed in the section remake"""


def inputs_of(sections: Sequence[Section]) -> tuple[Input, ...]:
    """Each once. What only an optional section needs is not needed."""
    needed = {i for s in sections if not s.optional for i in s.inputs}
    every = dict.fromkeys(i for s in sections for i in s.inputs)
    return tuple(i if i in needed else replace(i, needed=False) for i in every)
