"""The page of `penumbra check`: the verdict on a student's pictures, and what it rests on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from penumbra.compare.check.catalogue import Mistake, Variant
from penumbra.compare.check.checking import Checked
from penumbra.compare.check.expected import mistaken_picture, right_picture, unexplained
from penumbra.compare.check.explanation import (
    confidence,
    detection,
    exhibits,
    explained,
    headline,
    noise_only,
    observations,
    rounded_odds,
    titles,
    unknown,
)
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, WRONG, effective_samples
from penumbra.compare.check.view import View
from penumbra.compare.check.words import WORDS
from penumbra.compare.run.output import write_whole
from penumbra.compare.run.provenance import origin
from penumbra.language import N_, _, localised, say
from penumbra.report import figures
from penumbra.report.build import asset, environment, spoken
from penumbra.report.words import plain

WHERE, NAME, ALL = 1, 2, 3
"""Hints, as of compare.check.verdict.text: from which one a part of the page is shown"""
TONES = {RIGHT_: "agrees", WRONG: "differs", CANNOT_TELL: "undecided"}
"""As the report's pages colour and mark them"""
LIMIT = 5.0
"""Of the map's colours [standard errors]"""
MOST_PIXELS = 300_000
"""Of a picture in the comparer: three of them keep the page below 3 MB"""
LAWS = {
    "float": N_("float"),
    "truncated": N_("8 bits, truncated"),
    "rounded": N_("8 bits, rounded"),
    "truncated 256": N_("8 bits, truncated after times 256"),
    "gamma 2.2": N_("8 bits, gamma 2.2"),
    "sRGB": N_("8 bits, sRGB"),
    "square root": N_("8 bits, square root"),
    "gamma twice": N_("8 bits, gamma twice"),
}
"""How values became numbers, of check.picture"""


def write_page(file: Path, checked: Checked, hint: int, course: str = "") -> None:
    """One file that needs no network. hint: 0 the verdict, 1 where to look, 2 the mistake's name,
    3 all of it; course: address of the course's page, if any. Raises OSError, MissingProgramError.
    """
    page = environment().get_template("check_page.html.j2")
    script = asset("compare.js")
    html = page.render(
        css=Markup("").join(map(asset, ("page.css", "check_page.css"))),
        words=spoken(script),
        script=script,
        **_content(checked, hint, course),
    )
    write_whole(file, lambda part: part.write_text(html, encoding="utf-8"))


def _content(checked: Checked, hint: int, course: str) -> dict[str, Any]:
    found, diagnosis = checked.verdict, checked.diagnosis
    lead = checked.lead
    wrong = found.verdict == WRONG
    seen = hint >= (NAME if wrong else WHERE) and "geometry" not in dict(found.facts)
    explains = wrong and hint >= NAME
    return {
        "tone": TONES[found.verdict],
        "headline": headline(found),
        "confidence": "" if found.verdict == CANNOT_TELL else confidence(found),
        "scene": found.scene,
        "look": _look(checked) if wrong and hint == WHERE else None,
        "observed": observations(found) if seen and found.verdict != RIGHT_ else [],
        "causes": _causes(checked, hint, course) if explains else [],
        "several": _(WORDS["several"]) if explains and found.several else "",
        "alike": [titles(names) for names in found.alike] if wrong and hint >= ALL else [],
        "runners": _runners(checked) if wrong and hint >= ALL else [],
        "command": found.command if hint >= WHERE else "",
        "facts": [text for _, text in found.facts],
        "detection": detection(found) if found.verdict == RIGHT_ and hint >= WHERE else "",
        "hidden": [titles([n]) for n in found.hidden] if hint >= NAME else [],
        "settle": [_with_command(text) for text in found.settle]
        if hint >= WHERE and not wrong
        else [],
        "compare": _compare(checked, lead, hint) if hint >= WHERE else None,
        "map": _map(checked, lead) if hint >= ALL else None,
        "light": _light(checked) if wrong and hint >= ALL else None,
        "pictures": [_row(view, checked, hint) for view in diagnosis.views],
        "noise": seen,
        "scene_file": checked.scene_file.name,
        "origin": origin(),
    }


def _look(checked: Checked) -> dict[str, Any]:
    """Where to look, without a name."""
    found = checked.verdict
    what = _(WORDS["hint_noise" if noise_only(found) else "hint_mean"])
    steps = [explained(name).step for name in found.mistakes if name != UNKNOWN]
    return {"text": say(WORDS["hint"], where=what), "steps": list(dict.fromkeys(steps))}


def _causes(checked: Checked, hint: int, course: str) -> list[dict[str, Any]]:
    found = checked.verdict
    causes = [_cause(name, checked, hint, course) for name in found.mistakes]
    if found.perhaps and UNKNOWN not in found.mistakes:
        causes += [
            _cause(name, checked, hint, course)
            | {"title": f"{_(WORDS['perhaps'])} {explained(name).title}"}
            for name in found.perhaps
        ]
    return causes


def _cause(name: str, checked: Checked, hint: int, course: str) -> dict[str, Any]:
    found = checked.verdict
    if name == UNKNOWN:
        text = unknown(found)
        nearest = say(WORDS["nearest"], title=titles(found.perhaps)) if found.perhaps else ""
        return {
            "title": _("Not in the catalogue"),
            "text": f"{text[0].upper()}{text[1:]}.",
            "nearest": f"{nearest[:1].upper()}{nearest[1:]}",
            "formula": None,
            "reread": "",
            "look": "",
            "exhibit": "",
        }
    mistake = explained(name)
    return {
        "title": mistake.title,
        "text": mistake.cause,
        "nearest": "",
        "formula": _formula(mistake) if hint >= ALL else None,
        "reread": mistake.step,
        "look": mistake.look if hint >= ALL else "",
        "exhibit": exhibits([name], course)[name] if course else "",
    }


def _formula(mistake: Mistake) -> dict[str, str]:
    return {"yours": mistake.wrong, "right": mistake.right}


def _runners(checked: Checked) -> list[dict[str, str]]:
    found = checked.verdict
    if UNKNOWN in found.mistakes:
        return []
    return [{"titles": titles(names), "odds": _odds(odds)} for names, odds in found.runners_up]


def _odds(odds: float) -> str:
    return rounded_odds(odds) if odds < 1e4 else f"10{_superscript(round(math.log10(odds)))}"


def _with_command(text: str) -> dict[str, str]:
    """What is said, and the command that follows its colon."""
    said, colon, command = text.rpartition(": ")
    return {"text": said.rstrip() or command, "command": command if colon else ""}


def _row(view: View, checked: Checked, hint: int) -> dict[str, Any]:
    picture = view.picture
    law = _(LAWS.get(picture.law, picture.law))
    height, width = picture.values.shape[:2]
    effective = effective_samples(view, checked.diagnosis)
    return {
        "name": Path(picture.name).name,
        "size": f"{width} × {height}",
        "light_samples": picture.nb_light_samples,
        "pixel_samples": picture.samples_per_pixel,
        "law": f"{law}, JPEG" if picture.jpeg else law,
        "noise": localised(f"{max(effective, 1):.2g}"),
    }


# Pictures


def _compare(checked: Checked, lead: View, hint: int) -> dict[str, Any]:
    """The comparer's images; what is shown first; how many pixels of a picture it leaves out."""
    found, diagnosis = checked.verdict, checked.diagnosis
    factor = diagnosis.right.variant.factor if found.verdict == RIGHT_ else 1.0
    shown = [
        (say("yours: {name}", name=Path(lead.picture.name).name), lead.picture.values),
        (_("right, without noise"), right_picture(lead, factor)),
    ]
    best = diagnosis.best.variant
    if found.verdict == WRONG and hint >= NAME and best.mistakes and not found.beside:
        named = set(best.mistakes) == {*found.mistakes, *found.perhaps} - {UNKNOWN}
        label = (
            _("with the mistake")
            if named and UNKNOWN not in found.mistakes
            else _("with the nearest")
        )
        shown.append((label, mistaken_picture(lead, checked.scene_file, best)))
    height, width = lead.picture.values.shape[:2]
    every = max(1, math.ceil(math.sqrt(height * width / MOST_PIXELS)))
    kept = [(label, radiance[::every, ::every]) for label, radiance in shown]
    height, width = kept[0][1].shape[:2]
    noisiest = int(np.argmax(lead.predict(Variant()).variance))
    return {
        "images": [
            {
                "label": label,
                "group": say("scene {name}", name=lead.scene.name),
                "width": width,
                "height": height,
                "data": figures.packed_halves(radiance),
            }
            for label, radiance in kept
        ],
        "start": {
            "a": 0,
            "b": 1,
            "x": int(lead.column[noisiest]) // every,
            "y": int(lead.row[noisiest]) // every,
        },
        "every": every,
        "expected": titles(best.mistakes) if len(shown) > 2 else "",
    }


def _map(checked: Checked, lead: View) -> dict[str, Any]:
    found, diagnosis = checked.verdict, checked.diagnosis
    named = found.verdict == WRONG and not found.beside
    best = (diagnosis.best if named else diagnosis.right).variant
    excess = unexplained(lead, checked.scene_file, best)
    dark = np.isnan(excess)
    excess[dark] = 0
    worst = float(excess.ravel()[np.argmax(np.abs(excess))])
    height, width = excess.shape
    what = _("the right light")
    if best.mistakes:
        what = say("“{titles}”", titles=titles(best.mistakes))
    return {
        "png": figures.png_uri(figures.diverging_map(excess, LIMIT, dark)),
        "width": width,
        "height": height,
        "stops": ", ".join(figures.diverging_stops()),
        "limit": f"{LIMIT:g}",
        "worst": plain(f"{worst:+.1f}"),
        "what": what,
        "alt": say(
            "Map of your picture less what {what} foretells; the farthest cell is {worst} standard "
            "errors off",
            what=what,
            worst=plain(f"{worst:+.1f}"),
        ),
        "unknown": UNKNOWN in found.mistakes,
    }


def _light(checked: Checked) -> Markup | None:
    """Where the light seems to be, if no mistake explains the picture."""
    light = checked.diagnosis.light
    if light is None:
        return None
    return figures.places_chart(
        "check-light",
        say(
            "Places in the light's plane that the picture's light seems to come from; "
            "{inside:.0%} of it from the quad itself",
            inside=light.inside,
        ),
        light.points,
        light.weights,
    )


def _superscript(value: int) -> str:
    return str(value).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
