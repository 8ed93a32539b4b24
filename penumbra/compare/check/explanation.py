"""A verdict in words: for a terminal, and the sentences of its page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from penumbra.compare.check.catalogue import Mistake, catalogue
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, WRONG, Verdict
from penumbra.compare.check.words import WORDS
from penumbra.language import _, localised, say

NO_EFFECT = "n_no_effect"
"""The commonest mistake, which only noise shows"""


def explained(name: str) -> Mistake:
    """In the language that is spoken."""
    return catalogue().mistakes[name].spoken()


def title(name: str) -> str:
    """What a mistake is called to a student."""
    return explained(name).title if name != UNKNOWN else _("unknown")


def titles(names: Sequence[str]) -> str:
    return " + ".join(title(name) for name in names) or _("no mistake")


def exhibits(names: Sequence[str], course: str = "") -> dict[str, str]:
    """Where the museum of mistakes shows them, by name; course: address of the course's page, from
    which these are relative if it is not known."""
    known = catalogue().mistakes
    return {name: f"{course}#{known[name].anchor}" for name in names if name in known}


def observations(found: Verdict) -> list[str]:
    """What the picture shows, in the student's terms: the parts that are off, the worst first."""
    said: list[tuple[float, str]] = []
    for region in found.regions:
        if region.kind == "shadow":
            if region.ratio > 1.5 / 255:
                text = say(WORDS["region_not_black"], region=region.name, value=255 * region.ratio)
                said.append((region.ratio * 10, text))
            continue
        off = abs(region.ratio - 1)
        if off > max(4 * region.standard_error, 0.006):
            key = "region_bright" if region.ratio > 1 else "region_dark"
            text = say(WORDS[key], region=region.name, ratio=region.ratio)
            if abs(region.trend) > 0.1 and off > 0.03:
                grows = (region.trend > 0) == (region.ratio > 1)
                text += _(WORDS["farther_more" if grows else "farther_less"])
            said.append((off, text))
    if found.beside > 0.05:
        said.append((2.0, say(WORDS["free_light"], outside=found.beside)))
    n, effective = found.nb_light_samples, found.effective_samples
    if effective < 0.7 * n and n > 1:
        said.append((1.0, say(WORDS["noise_of"], n=n, effective=max(effective, 1))))
    return [text for _, text in sorted(said, key=lambda s: -s[0])[:4]]


def confidence(found: Verdict) -> str:
    share = found.confidence
    return _(WORDS["sure"]) if share > 0.999 else say(WORDS["confidence"], share=share)


def rounded_odds(odds: float) -> str:
    """
    >>> rounded_odds(12.3), rounded_odds(2e7)
    ('12', '10^7')
    """
    return f"{odds:.0f}" if odds < 1e4 else f"10^{math.log10(odds):.0f}"


def text(found: Verdict, hint: int = 3, course: str = "") -> str:
    """The verdict for a terminal. hint: 0 verdict, 1 where to look, 2 the handout's step and the
    mistake's name, 3 the formula and the evidence. course: address of the course's page, if any."""
    lines = [headline(found)]
    if found.verdict != CANNOT_TELL:
        lines[0] += f" ({confidence(found)})"
    if hint == 0:
        return "\n".join(lines) + "\n"
    seen = observations(found)
    if found.verdict == WRONG:
        if hint == 1:
            what = "hint_noise" if noise_only(found) else "hint_mean"
            lines += ["", say(WORDS["hint"], where=_(WORDS[what]))]
            lines += [f"  {step}" for step in dict.fromkeys(
                explained(name).step for name in found.mistakes if name != UNKNOWN)]  # fmt: skip
        else:
            lines += _explanation(found, hint, seen, course)
    elif seen and found.verdict == CANNOT_TELL and "geometry" not in dict(found.facts):
        lines += ["", _(WORDS["observed"]), *(f"  {line}" for line in seen)]
    if found.facts:
        lines += ["", _(WORDS["picture"]), *(f"  {said}" for _, said in found.facts)]
    if found.verdict == RIGHT_:
        lines += ["", detection(found)]
        if found.hidden and hint >= 2:
            lines.append(say(WORDS["hidden"], mistakes=listed(map(title, found.hidden))))
    if found.settle and found.verdict != WRONG:
        key = "more" if found.verdict == RIGHT_ else "settle"
        lines += ["", say(WORDS[key], what=_("; or ").join(found.settle))]
    return "\n".join(lines) + "\n"


def headline(found: Verdict) -> str:
    """The verdict in a sentence"""
    mute = found.verdict == RIGHT_ and NO_EFFECT in found.hidden
    return _(WORDS["right in brightness" if mute else found.verdict])


def listed(texts: Iterable[str]) -> str:
    """Texts that have commas of their own."""
    return _("; ").join(texts)


def noise_only(found: Verdict) -> bool:
    return all(abs(r.ratio - 1) < 0.01 for r in found.regions if r.kind == "lit")


def detection(found: Verdict) -> str:
    brightness = localised(f"{100 * found.detectable_brightness:.2g}%")
    if found.nb_light_samples == 1 or found.detectable_samples < 1:
        return say(WORDS["detectable_mean"], brightness=brightness)
    return say(
        WORDS["detectable"],
        brightness=brightness,
        samples=math.ceil(found.detectable_samples),
        n=found.nb_light_samples,
    )


def unknown(found: Verdict) -> str:
    """What is said of what the catalogue does not hold."""
    where = "unknown" if found.loose >= 0.005 else "unknown_places"
    return say(WORDS[where], loose=found.loose)


def _explanation(found: Verdict, hint: int, seen: list[str], course: str) -> list[str]:
    shown = exhibits(found.mistakes, course) if course else {}
    lines = ["", _(WORDS["observed"]), *(f"  {line}" for line in seen)] if seen else []
    lines += ["", _(WORDS["several" if found.several else "cause"])]
    for name in found.mistakes:
        if name == UNKNOWN:
            lines.append("  " + unknown(found))
            if found.perhaps and not found.several:
                lines.append("  " + say(WORDS["nearest"], title=titles(found.perhaps)))
            continue
        mistake = explained(name)
        lines += [f"  {mistake.title}", f"    {mistake.cause}"]
        if hint >= 3:
            labels = [_(WORDS["yours"]), _(WORDS["ours"])]
            wide = max(map(len, labels)) + 1
            formulas = mistake.wrong, mistake.right
            lines += [
                f"    {label:{wide}}{formula}"
                for label, formula in zip(labels, formulas, strict=True)
            ]
        lines.append(f"    {say(WORDS['reread'], step=mistake.step)}")
        if hint >= 3:
            lines.append(f"    {say(WORDS['look'], look=mistake.look)}")
        if name in shown:
            lines.append(f"    {say(WORDS['exhibit'], address=shown[name])}")
    if found.perhaps and UNKNOWN not in found.mistakes:
        lines += ["", f"{_(WORDS['perhaps'])} {titles(found.perhaps)}"]
    if hint >= 3:
        if found.alike:
            lines += ["", say(WORDS["alike"], titles=listed(map(titles, found.alike)))]
        if found.runners_up and UNKNOWN not in found.mistakes:
            lines += ["", _(WORDS["runners"])]
            lines += [
                "  " + say(WORDS["odds"], odds=rounded_odds(odds), titles=titles(names))
                for names, odds in found.runners_up
            ]
        lines += ["", say(WORDS["command"], command=found.command)]
    return lines
