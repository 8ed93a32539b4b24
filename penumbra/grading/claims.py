"""What a submission is to show, claim by claim: shown, refuted, or not to be told from it.

One fault costs the claims that it refutes, and no others: which these are follows from where in the
estimator it stands (refuted_by), not from what else it does to the picture. docs/grading.md says it
for instructors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from penumbra.compare.check.catalogue import SPLIT, Choice, catalogue
from penumbra.compare.check.checking import Checked
from penumbra.compare.check.explanation import title
from penumbra.compare.check.prediction import surface_lights
from penumbra.compare.check.program import times_as_fast
from penumbra.compare.check.verdict import CANNOT_TELL, RIGHT_, UNKNOWN, Region, Verdict
from penumbra.compare.check.words import WORDS
from penumbra.compare.run.provenance import ROOT
from penumbra.compare.scene import QuadLight, Scene, read_scene
from penumbra.language import N_, _, say

LIGHT_MEAN, PENUMBRA, NOISE_LAW, N_HAS_EFFECT, THREADS, OTHER_LIGHTS = CLAIMS = (
    "light_mean", "penumbra", "noise_law", "n_has_effect", "threads", "other_lights",
)  # fmt: skip
TITLES = {
    LIGHT_MEAN: N_("The light's mean"),
    PENUMBRA: N_("Shadows and penumbra"),
    NOISE_LAW: N_("Noise falls as 1 / N"),
    N_HAS_EFFECT: N_("N has an effect"),
    THREADS: N_("Threads speed it up, and change no light"),
    OTHER_LIGHTS: N_("Several lights, and others than the lab's"),
}
SHOWN, REFUTED, UNTOLD, MISSING = "shown", "refuted", "cannot tell", "missing"
HINTS = 4
"""Levels of hints, 0 to 3"""
OFF, OFF_PENUMBRA, LOUD = 0.02, 0.05, 1.5
"""Relative error of the mean of lit parts, of penumbrae beside lit parts, and times the variance of
N samples, from which what no mistake of the catalogue explains is held against a claim"""
ENOUGH = 4
"""Light samples from which a picture may show what N does"""
SPEED_UP = 1.3
"""Times as fast as one thread from which several are said to speed a program up"""
MODULES = {
    "domain": (PENUMBRA,),
    "visibility": (PENUMBRA,),
    "weight": (LIGHT_MEAN,),
    "scale": (LIGHT_MEAN,),
    "lights": (OTHER_LIGHTS,),
    "clamp": (LIGHT_MEAN,),
    "output": (LIGHT_MEAN,),
    "colour": (LIGHT_MEAN,),
    "generator": (PENUMBRA,),
}
"""The claims that a mistake in each module refutes; of an average see _of_average"""


@dataclass(frozen=True)
class State:
    """Of one claim."""

    state: str
    """SHOWN, REFUTED, UNTOLD or MISSING"""
    why: tuple[str, ...]
    """a sentence for each of the HINTS levels"""


# ---------------------------------------------------------------- which mistake refutes what


@cache
def refuted_by(name: str) -> frozenset[str]:
    """The claims that a mistake of the catalogue refutes.

    >>> sorted(refuted_by("n_no_effect"))
    ['n_has_effect', 'noise_law']
    >>> sorted(refuted_by("not_divided_by_n")), sorted(refuted_by("no_shadow"))
    (['light_mean'], ['penumbra'])
    """
    choices = [c for c in catalogue().choices.values() if c.mistake == name]
    return frozenset(claim for choice in choices for claim in _of_choice(choice))


def _of_choice(choice: Choice) -> Iterable[str]:
    if choice.module == "average":
        return _of_average(choice)
    if choice.module == "scale" and choice.arguments == ("0",):  # black shows nothing at all
        return LIGHT_MEAN, PENUMBRA, NOISE_LAW, N_HAS_EFFECT
    if choice.field("lost"):  # by threads that overwrite each other's sums
        return LIGHT_MEAN, THREADS
    if choice.field("acne"):  # a shadow ray that starts at the wrong place
        return (PENUMBRA,)
    return MODULES[choice.module]


def _of_average(choice: Choice) -> list[str]:
    """From its weights a_i: the mean is right if they sum to 1, the noise if sum a_i^2 over that
    sum squared is 1/N, and N has an effect if it falls with N. Those that ask which samples see the
    light are wrong where some do not."""
    if choice.macro == SPLIT:
        return [PENUMBRA]
    found = []
    totals, noises = zip(*(_weights(choice, n) for n in (16, 64)), strict=True)
    if abs(totals[0] - 1) > 1e-3:
        found.append(LIGHT_MEAN)
    if 16 * noises[0] > 1.1:
        found.append(NOISE_LAW)
    if noises[1] > 0.9 * noises[0]:
        found.append(N_HAS_EFFECT)
    return found


def _weights(choice: Choice, n: int) -> tuple[float, float]:
    """The sum of the weights, and the relative variance that they leave."""
    drawn = np.arange(int(choice.evaluate(0, n=float(n))), dtype=float)
    weights = np.broadcast_to(choice.evaluate(1, n=float(n), i=drawn), drawn.shape).astype(float)
    total = float(weights.sum())
    return total, float((weights**2).sum()) / total**2


@cache
def mistakes_against(claim: str) -> frozenset[str]:
    """The catalogue's mistakes that refute a claim."""
    return frozenset(name for name in catalogue().mistakes if claim in refuted_by(name))


# ---------------------------------------------------------------- what a verdict says of each


def missing() -> dict[str, State]:
    """Of what holds nothing that can be judged."""
    said = _("Nothing that can be judged was handed in.")
    return {claim: State(MISSING, (said,) * HINTS) for claim in CLAIMS}


def untold(reason: str) -> dict[str, State]:
    """Nothing can be said, through no fault of the submission's."""
    return {claim: State(UNTOLD, (reason,) * HINTS) for claim in CLAIMS}


def states(first: Checked, others: Sequence[tuple[str, Checked]] = ()) -> dict[str, State]:
    """Of every claim. first: the pictures of the lab's scene, or a program; others: pictures of
    other scenes, with their names."""
    found = {claim: _state(claim, first) for claim in CLAIMS[:4]}
    found[THREADS] = _threads(first)
    found[OTHER_LIGHTS] = _other_lights(first, others)
    return found


def _state(claim: str, checked: Checked) -> State:
    found = checked.verdict
    if found.verdict == CANNOT_TELL:
        return _untold(_("From these pictures nothing can be told for certain."))
    sure = [name for name in found.mistakes if name != UNKNOWN]
    guilty = [name for name in sure if claim in refuted_by(name)]
    if guilty:
        others = [names for names in found.alike if not any(claim in refuted_by(n) for n in names)]
        if not others:
            return _refuted(claim, found, guilty)
        return _untold(_("These pictures do not tell which of several mistakes it is."))
    if UNKNOWN in found.mistakes:
        return _unexplained(claim, found)
    if any(claim in refuted_by(name) for names in found.alike for name in names):
        return _untold(_("These pictures do not tell which of several mistakes it is."))
    if _would_show(claim, checked) or _shown_by_average(claim, checked, sure):
        return _shown(claim, checked)
    if sure:
        return _untold(_("What is wrong with the light hides it."))
    return _untold(_("These pictures cannot show it: a mistake here would look the same."))


def _would_show(claim: str, checked: Checked) -> bool:
    """Whether most of the mistakes against a claim would have shown, and did not. Those that change
    the mean as well (a black picture) show anyway, and tell nothing of another claim."""
    telling = mistakes_against(claim)
    if claim != LIGHT_MEAN:
        telling -= mistakes_against(LIGHT_MEAN)
    return 2 * len(telling & set(checked.diagnosis.excluded)) > len(telling)


def _shown_by_average(claim: str, checked: Checked, sure: Sequence[str]) -> bool:
    """A picture whose samples are summed in a way that is known, though wrong, shows what that way
    does to the noise: no second mistake of the average is asked for beside it."""
    if claim not in (NOISE_LAW, N_HAS_EFFECT) or _most_samples(checked) < ENOUGH:
        return False
    average = checked.diagnosis.best.variant["average"]
    return average.macro != SPLIT and average.mistake in sure


def _most_samples(checked: Checked) -> int:
    return max(view.picture.nb_light_samples for view in checked.diagnosis.views)


def _refuted(claim: str, found: Verdict, names: Sequence[str]) -> State:
    seen = _seen(claim, found) if not _fine(claim, found) else _("It is not as it should be.")
    said = _sentence(_(" and ").join(title(name) for name in names))
    return State(REFUTED, (_("It is not as it should be."), seen, said, said))


def _unexplained(claim: str, found: Verdict) -> State:
    """Something is wrong that is no mistake of the catalogue: what the picture's parts say."""
    if _fine(claim, found):
        return _untold(_("Something is wrong that no known mistake explains: look at it."))
    seen = _seen(claim, found)
    return State(REFUTED, (_("It is not as it should be."), seen, seen, seen))


def _fine(claim: str, found: Verdict) -> bool:
    """Whether the parts of the picture that a claim is about are as they should be, or say
    nothing."""
    if claim == LIGHT_MEAN:
        return all(abs(r.ratio - 1) <= _allowed(r, OFF) for r in _parts(found, "lit"))
    if claim == PENUMBRA:
        lit = _lit(found)
        parts = _parts(found, "penumbra")
        return lit <= 0 or all(abs(r.ratio / lit - 1) <= _allowed(r, OFF_PENUMBRA) for r in parts)
    n = found.nb_light_samples
    return n == 1 or found.effective_samples * LOUD >= n


def _seen(claim: str, found: Verdict) -> str:
    """What the picture shows of it, with its number."""
    kind = {LIGHT_MEAN: "lit", PENUMBRA: "penumbra"}.get(claim)
    if kind is None:
        n, effective = found.nb_light_samples, max(found.effective_samples, 1)
        return _sentence(say(WORDS["noise_of"], n=n, effective=effective))
    parts = _parts(found, kind)
    if not parts:
        return _("No mistake that would change it is in these pictures.")
    lit = _lit(found) if kind == "penumbra" else 1.0
    beside = abs(lit - 1) > OFF
    lit = lit if beside and lit > 0 else 1.0
    worst = max(parts, key=lambda r: abs(r.ratio / lit - 1))
    said = say(
        N_("beside what is lit, {name} is {ratio:.3f} times as bright as it should be")
        if beside
        else N_("{name} is {ratio:.3f} times as bright as it should be"),
        name=worst.name,
        ratio=worst.ratio / lit,
    )
    return _sentence(said)


def _shown(claim: str, checked: Checked) -> State:
    found = checked.verdict
    said = _seen(claim, found) if _fine(claim, found) else (
        _("But for what else is wrong, it is as it should be.")
    )  # fmt: skip
    if claim == N_HAS_EFFECT:
        counts = sorted({view.picture.nb_light_samples for view in checked.diagnosis.views})
        drawn = ", ".join(str(n) for n in counts)
        said = say("The noise is that of N samples, not of one, at N = {drawn}.", drawn=drawn)
    return State(SHOWN, (_("It is as it should be."), *(said,) * (HINTS - 1)))


def _threads(checked: Checked) -> State:
    if any(THREADS in refuted_by(name) for name in checked.verdict.mistakes if name != UNKNOWN):
        said = _sentence(title("samples_lost"))
        return State(REFUTED, (_("Threads do harm."), _("Threads do harm."), said, said))
    if checked.examined is None:
        return _untold(_("Pictures do not show how fast they were made: only a program does."))
    race = dict(checked.examined.facts).get("race")
    if race:
        seen = _sentence(race.partition(":")[0].rstrip())
        return State(REFUTED, (_("Threads do harm."), seen, _sentence(race), _sentence(race)))
    return _untold(_("Several threads do no harm; whether they are faster was not timed."))


def timed(timing: Mapping[str, Any]) -> State:
    """Of threads, once a program was timed (timing.py): never refuted by a clock alone."""
    if "ratio" not in timing:
        return _untold(
            _sentence(say("It could not be timed: {problem}", problem=timing["problem"]))
        )
    said = times_as_fast(timing["threads"], timing["ratio"])
    if timing["ratio"] >= SPEED_UP:
        return State(SHOWN, (_sentence(said),) * HINTS)
    return _untold(_sentence(say("{said}: is the loop over the pixels parallel?", said=said)))


def _other_lights(first: Checked, others: Sequence[tuple[str, Checked]]) -> State:
    """Wrong on another scene and right on the first: that is what is wrong."""
    every = [(first.verdict.scene, first), *others]
    names = set(first.verdict.mistakes)
    for scene, checked in every:
        guilty = [n for n in checked.verdict.mistakes if OTHER_LIGHTS in _refuted_by(n)]
        new = [n for n in checked.verdict.mistakes if n not in names] if checked != first else []
        if guilty or new:
            said = _sentence(f"{scene}: {_(' and ').join(title(n) for n in guilty or new)}")
            seen = say("{scene}: it is not as it should be.", scene=scene)
            return State(REFUTED, (seen, seen, said, said))
    shown = [
        view.scene.name
        for _, checked in every if _shows_other_lights(checked)
        for view in checked.diagnosis.views if _other(view.scene)
    ]  # fmt: skip
    if shown:
        scenes = ", ".join(dict.fromkeys(shown))
        return State(SHOWN, (say("It is as it should be: {scenes}.", scenes=scenes),) * HINTS)
    if failed := _failed_on_others(first):
        seen = _("It fails on a scene of several lights.")
        return State(REFUTED, (seen, seen, failed, failed))
    if any(_other(view.scene) for _, checked in every for view in checked.diagnosis.views):
        return _untold(_("These pictures do not show it: something else is wrong, or hides it."))
    return _untold(
        _("No picture of several lights, or of another light than the lab's, to tell by.")
    )


def _failed_on_others(checked: Checked) -> str:
    """What is said of a program that makes no picture of several lights."""
    for code, said in checked.examined.facts if checked.examined else ():
        scene = ROOT / "scenes" / f"{code.removeprefix('fails_')}.json"
        if code.startswith("fails_") and scene.is_file() and _other(read_scene(scene)):
            return _sentence(said)
    return ""


def _refuted_by(name: str) -> frozenset[str]:
    return refuted_by(name) if name != UNKNOWN else frozenset()


def _shows_other_lights(checked: Checked) -> bool:
    """Whether several lights were seen to be added, or another shape to be right."""
    scenes = [view.scene for view in checked.diagnosis.views]
    if UNKNOWN in checked.verdict.mistakes or checked.verdict.verdict == CANNOT_TELL:
        return False
    if any(len(surface_lights(scene)) > 1 for scene in scenes):
        return _would_show(OTHER_LIGHTS, checked)
    return checked.verdict.verdict == RIGHT_ and any(_other(scene) for scene in scenes)


def _other(scene: Scene) -> bool:
    lights = [scene.lights[i] for i in surface_lights(scene)]
    return len(lights) > 1 or not isinstance(lights[0], QuadLight)


def _untold(reason: str) -> State:
    return State(UNTOLD, (reason,) * HINTS)


def _parts(found: Verdict, kind: str) -> list[Region]:
    return [region for region in found.regions if region.kind == kind]


def _lit(found: Verdict) -> float:
    """How bright lit parts are, of what they should be: their median."""
    ratios = [region.ratio for region in _parts(found, "lit")]
    return float(np.median(ratios)) if ratios else 1.0


def _allowed(region: Region, least: float) -> float:
    return max(4 * region.standard_error, least)


def _sentence(text: str) -> str:
    """
    >>> _sentence("it ends early"), _sentence("nbLightSamples has no effect")
    ('It ends early.', 'nbLightSamples has no effect.')
    """
    named = text.split(" ")[0] != text.split(" ")[0].lower()  # as in the code
    text = text if named else text[:1].upper() + text[1:]
    return text if text.endswith("?") else text.rstrip(".") + "."
