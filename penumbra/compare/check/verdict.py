"""The word that a student gets: right, wrong or cannot tell, why, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from penumbra.compare.check.catalogue import RIGHT, Variant
from penumbra.compare.check.diagnosis import (
    ACCUSED,
    LOCAL,
    PRICE_ONE,
    TEMPER,
    Diagnosis,
    FreeLight,
    constant,
)
from penumbra.compare.check.grid import Grid
from penumbra.compare.check.prediction import surface_lights
from penumbra.compare.check.view import NU, View, lead_of
from penumbra.compare.check.words import WORDS, with_object
from penumbra.compare.run.provenance import typed
from penumbra.compare.scene import Plane, Sphere
from penumbra.language import _, numbers, say

RIGHT_, WRONG, CANNOT_TELL = "right", "wrong", "cannot tell"
UNKNOWN = "unknown"
"""The name of what is wrong in no way of the catalogue"""
STRANGE = 0.3
"""Unexplained pixels per pixel of outline from which a picture shows another scene"""
DESPITE = 300.0
"""Gain from which a mistake is named even so: what another scene does to the light is less"""
BLIND = 0.1
"""A check that would miss a brightness off by so much says nothing"""
WELL = 0.4
"""A free light explains a picture if it leaves so little of the misfit"""
NEAR = 0.02
"""Brightness that no mistake explains, within which a picture may still be right"""
HOPELESS = 1e6
"""Odds against from which another explanation is not worth a word"""
SURE = 0.9
"""A picture of which less is sure is not called right"""
POINTLIKE, BESIDE = 0.15, 0.1
"""Of a free light: standard deviation, in edges, of one that is a point; share that is off the
light of one that is elsewhere"""
BLACK = 1.5 / 255
COLOURLESS = "flat_colour_missing"
"""The mistake that colours show, and no brightness"""
SLIGHT = 0.01
"""Relative error of the mean below which a framework's own habits may be the reason"""
UNNAMED = 60.0
"""Gain from which a picture is called wrong though no mistake explains it"""
REGIONS = ("lit", "penumbra", "shadow")
FEW = 60


@dataclass(frozen=True)
class Region:
    """A part of the picture against what is right."""

    name: str
    """in words"""
    kind: str
    """of REGIONS"""
    ratio: float
    """observed over right; of a shadow observed [0, 1]"""
    standard_error: float
    noise: float
    """observed variance within cells over what N samples have; 0: not known"""
    trend: float
    """how the ratio goes with the distance from the light: its slope against log distance"""
    pixels: int


@dataclass(frozen=True)
class Verdict:
    verdict: str
    """right, wrong, cannot tell"""
    confidence: float
    """posterior odds' share of the hypotheses behind it, at even odds before"""
    mistakes: tuple[str, ...]
    """names it is sure of, the gravest first; "unknown" for what the catalogue does not hold"""
    perhaps: tuple[str, ...]
    """further ones that would explain a little more"""
    several: bool
    alike: tuple[tuple[str, ...], ...]
    """what these pictures cannot tell from the mistakes"""
    facts: tuple[tuple[str, str], ...]
    """(code, text): of the picture, no faults of the light"""
    regions: tuple[Region, ...]
    effective_samples: float
    """the number of light samples that its noise is that of"""
    detectable_brightness: float
    """relative: the smallest error that it would have shown"""
    detectable_samples: float
    """the largest number of light samples, below N, whose noise it would have told from N's"""
    runners_up: tuple[tuple[tuple[str, ...], float], ...]
    """(names, odds against)"""
    hidden: tuple[str, ...]
    """mistakes that would not show in these pictures"""
    settle: tuple[str, ...]
    """what would settle it, or show more"""
    loose: float
    """relative error that nothing explains"""
    beside: float
    """share of the light that seems to come from places that are not the light's"""
    variant: Variant
    """the renderer that explains the pictures best"""
    scene: str
    command: str
    nb_light_samples: int
    """of the picture that says most"""


def verdict(
    diagnosis: Diagnosis,
    grids: Sequence[tuple[Grid, int]],
    scene_file: Path,
    power_known: bool = False,
    lead: View | None = None,
) -> Verdict:
    """grids: of the pictures, with how many pixels of outline each leaves unexplained; lead: the
    picture to speak of, the one whose noise says most unless it is given."""
    lead = lead or lead_of(diagnosis.views)
    top = diagnosis.best.variant
    regions = tuple(_regions(lead, _base(top, lead)))
    strange = _strange(lead, grids)
    brightness, samples = detectable(lead, diagnosis.right.variant)
    n = lead.picture.nb_light_samples
    word, names, perhaps, several = _decide(diagnosis, lead, strange, brightness, power_known)
    facts = _facts(diagnosis, lead, grids, strange, word, scene_file)
    effective = effective_samples(lead, diagnosis)
    shown = {COLOURLESS} if coloured(lead) else set()
    hidden = tuple(n for n in diagnosis.hidden if n not in shown) if word == RIGHT_ else ()
    # of what colours show, the hypotheses, which are of brightness, know nothing
    sure_of_it = 1.0 if names == (COLOURLESS,) else _confidence(diagnosis, word)
    if word == RIGHT_ and sure_of_it < SURE:
        word = CANNOT_TELL
    return Verdict(
        word,
        sure_of_it,
        names,
        perhaps,
        several,
        diagnosis.alike if word == WRONG and UNKNOWN not in names else (),
        facts,
        regions,
        effective,
        brightness,
        samples * n,
        _runners_up(diagnosis),
        hidden,
        _settle(word, lead, diagnosis, strange, brightness, hidden, scene_file),
        diagnosis.loose,
        _beside(diagnosis, names),
        top,
        lead.scene.name,
        f"penumbra exact {typed(scene_file)} -o exact.exr && penumbra png exact.exr -o exact.png",
        n,
    )


def _decide(
    diagnosis: Diagnosis, lead: View, strange: bool, brightness: float, power_known: bool
) -> tuple[str, tuple[str, ...], tuple[str, ...], bool]:
    """verdict, sure names, perhaps, several"""
    top = diagnosis.best.variant
    gain = diagnosis.best.score - diagnosis.right.score
    coarse = lead.picture.jpeg == "coarse"
    named = bool(top.mistakes) and gain > ACCUSED
    unexplained = diagnosis.unexplained > ACCUSED
    if named:
        off = diagnosis.unexplained > ACCUSED / 3 and diagnosis.loose >= SLIGHT
        unexplained = off or diagnosis.unexplained > 3 * ACCUSED or diagnosis.local > LOCAL
    light = diagnosis.light
    if strange and not (named and not unexplained and gain > DESPITE):
        return CANNOT_TELL, (), (), False
    if max(float(view.value.max()) for view in diagnosis.views) < BLACK:
        return WRONG, ("black",), (), False
    if unexplained:
        off = named or diagnosis.loose >= NEAR
        # and not by being only a darker or brighter light
        dimmed = Variant(factor=lead.best_factor(Variant()))
        well = WELL * max(min(_misfit(lead, top), _misfit(lead, dimmed)), 1e-9)
        if off and light is not None and light.misfit < min(3, well):
            name = _of_light(light, lead)
            if name:
                return WRONG, (name,), (), False
        if coarse:
            return CANNOT_TELL, (), (), False
        if named and len(diagnosis.sure) > 1:
            return WRONG, (*diagnosis.sure, UNKNOWN), _rest(diagnosis), True
        if named:
            return WRONG, (UNKNOWN,), top.mistakes, False
        if diagnosis.loose >= NEAR and diagnosis.unexplained > UNNAMED:
            return WRONG, (UNKNOWN,), (), False
        return CANNOT_TELL, (), (), False
    if named:
        sure = diagnosis.sure or top.mistakes
        return WRONG, sure, _rest(diagnosis) if diagnosis.sure else (), len(sure) > 2
    if brightness > BLIND:
        return CANNOT_TELL, (), (), False
    if all(_whitened(view) for view in diagnosis.views):
        return WRONG, (COLOURLESS,), (), False
    factor = diagnosis.right.variant.factor
    if factor != 1 and (power_known or not _plausible_power(lead, factor)):
        return (WRONG, (UNKNOWN,), (), False) if power_known else (CANNOT_TELL, (), (), False)
    return RIGHT_, (), (), False


def _of_light(light: FreeLight, lead: View) -> str:
    """The name of the mistake that a free light shows, if it does."""
    middle = (light.weights @ light.points) / max(float(light.weights.sum()), 1e-9)
    spread = np.sqrt(light.weights @ (light.points - middle) ** 2 / max(light.weights.sum(), 1e-9))
    if (spread < POINTLIKE).all():
        return "light_point_fixed"
    if light.inside < 1 - BESIDE:
        return "quad_parametrisation_wrong"
    quiet = [r.noise for r in _regions(lead, Variant()) if r.noise > 0]
    return "same_samples_everywhere" if max(quiet, default=1.0) < 0.3 else ""


def coloured(view: View) -> list[Sphere | Plane]:
    """The scene's objects that are clearly not grey or white."""
    return [thing for thing in view.scene.objects if min(thing.brdf) < 0.75 * max(thing.brdf)]


def _whitened(view: View) -> bool:
    """Whether all of these are white in the picture."""
    seen = [view.recoloured.get(thing.name) for thing in coloured(view)]
    return bool(seen) and all(colour is not None and min(colour) > 0.9 for colour in seen)


def _base(top: Variant, lead: View) -> Variant:
    """What the picture is held against: what is right, in another power if that is all; where only
    the noise is wrong, with that noise, since a clamp turns it into brightness."""
    if not top.mistakes:
        return top
    light = lead.scene.lights[surface_lights(lead.scene)[0]]
    factor = constant(top, light, lead.picture.nb_light_samples)
    return top if factor == 1 else Variant()


def _beside(diagnosis: Diagnosis, names: tuple[str, ...]) -> float:
    """The share of a free light that is not on the light, where it gives the mistake its name."""
    if names != ("quad_parametrisation_wrong",) or diagnosis.light is None:
        return 0.0
    return 1 - diagnosis.light.inside


def _rest(diagnosis: Diagnosis) -> tuple[str, ...]:
    return tuple(name for name in diagnosis.best.variant.mistakes if name not in diagnosis.sure)


def _plausible_power(lead: View, factor: float) -> bool:
    """Whether somebody would type such a power (or of several lights such a factor): a number of
    one or two digits, but for the fit's own error."""
    lights = [lead.scene.lights[i] for i in surface_lights(lead.scene)]
    own = float(np.max(lights[0].radiance)) if len(lights) == 1 else 1.0  # type: ignore[union-attr]
    power = factor * own
    digits = 10 ** (math.floor(math.log10(power)) - 1)
    near = 0.012 if lead.picture.jpeg else 0.006
    return abs(power / digits - round(power / digits)) * digits < near * power


def _misfit(view: View, variant: Variant) -> float:
    return float(np.minimum(view.held_against(variant).misfit, 25).mean())


def _strange(lead: View, grids: Sequence[tuple[Grid, int]]) -> bool:
    """Whether the picture's outline is not the scene's."""
    background = lead.picture.background
    edge = int(np.count_nonzero(background[1:] != background[:-1]))
    edge += int(np.count_nonzero(background[:, 1:] != background[:, :-1]))
    miss = min(miss for _, miss in grids)
    return miss > STRANGE * max(edge, 1) + 20


def detectable(view: View, variant: Variant) -> tuple[float, float]:
    """The relative error of the mean, and the share of the light samples, whose expected gain is
    just what an accusation takes."""
    found = view.held_against(variant)
    wanted = (ACCUSED + PRICE_ONE) / TEMPER

    def gain(delta: float) -> float:
        shift = (delta * found.mean) ** 2 * (found.mean < 0.95) / found.residual_variance
        return float((0.5 * (NU + 1) * np.log1p(shift / NU)).sum())

    def gain_of_noise(ratio: float) -> float:
        loud = found.foretold_noise > 4 * max(view.picture.quantisation_variance, 1e-9)
        spread = np.where(loud, math.log(ratio) ** 2 / found.noise_variance, 0.0)
        return float((0.5 * (NU + 1) * np.log1p(spread / NU)).sum())

    def smallest(function: Any, low: float, high: float) -> float:
        if function(high) < wanted:
            return high
        for _step in range(40):
            middle = math.sqrt(low * high)
            low, high = (low, middle) if function(middle) > wanted else (middle, high)
        return high

    return smallest(gain, 1e-5, 1.0), 1 / smallest(gain_of_noise, 1.0001, 1e4)


def _regions(view: View, right: Variant) -> list[Region]:
    """Each object's lit part, penumbra and shadow."""
    law = view.predict(right)
    chance = np.ones(len(view.row))
    dark = np.ones(len(view.row), dtype=bool)
    whole = np.ones(len(view.row), dtype=bool)
    for moments in view.around.moments:
        p, first, _ = moments[RIGHT, RIGHT, RIGHT]
        chance = np.minimum(chance, p)
        dark &= (p < 0.001) | (first <= 0)
        whole &= p > 0.999
    light = view.scene.lights[0]
    middle = np.asarray(getattr(light, "corner", getattr(light, "center", (0, 0, 0))), float)
    distance = np.linalg.norm(view.sites.receivers.point - middle, axis=1)
    found = []
    for i, thing in enumerate(view.scene.objects):
        on = view.object_id == i
        kinds = {"lit": whole & ~dark, "penumbra": ~whole & ~dark, "shadow": dark}
        for kind, mask in kinds.items():
            use = on & mask
            if kind != "shadow":
                use = use & (law.mean > 0.02) & (law.mean < 0.93)
            if use.sum() < FEW:
                continue
            name = with_object(f"region_{kind}", thing.name)
            x, mean = view.value[use], law.mean[use]
            variance = law.variance[use] + view.picture.quantisation_variance
            if kind == "shadow":
                found.append(Region(name, kind, float(x.mean()), 0.0, 0.0, 0.0, int(use.sum())))
                continue
            ratio = float(x.sum() / mean.sum())
            error = math.sqrt(float(variance.sum())) / float(mean.sum())
            trend = 0.0
            far = np.log(distance[use])
            if np.ptp(far) > 0.2 and ratio > 0:
                each = np.clip(x / mean, 0, 10)
                trend = float(np.polyfit(far, each, 1, w=np.sqrt(mean))[0]) / ratio
            found.append(
                Region(name, kind, ratio, error, _noise(view, use, x - mean, variance), trend,
                       int(use.sum()))
            )  # fmt: skip
    return found


def _noise(view: View, use: np.ndarray, residual: np.ndarray, variance: np.ndarray) -> float:
    """Observed over foretold variance within cells; 0 where there is none to speak of."""
    cell = view.cell[use]
    count = np.bincount(cell).astype(float)
    full = count >= 6
    if not full.any() or variance.mean() < 4 * view.picture.quantisation_variance:
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.bincount(cell, residual) / count
        within = (np.bincount(cell, residual**2) / count - mean**2) * count / (count - 1)
        foretold = np.bincount(cell, variance) / count
    return float(within[full].sum() / foretold[full].sum())


def effective_samples(lead: View, diagnosis: Diagnosis) -> float:
    """The number of light samples that the noise is that of, by the penumbrae."""
    n = lead.picture.nb_light_samples
    top = diagnosis.best.variant
    regions = _regions(lead, Variant(factor=top.factor if not top.mistakes else 1.0))
    found = [
        n * r.ratio**2 / r.noise for r in regions if r.kind == "penumbra" and r.noise > 0 < r.ratio
    ]
    return float(np.median(found)) if found else float(n)


def _confidence(diagnosis: Diagnosis, word: str) -> float:
    """Of the hypotheses that were compared, the share of those that say the same word."""
    best = diagnosis.best.score
    same = other = 0.0
    for hypothesis in diagnosis.ranking:
        weight = math.exp(max(hypothesis.score - best, -700))
        if bool(hypothesis.variant.mistakes) == (word == WRONG):
            same += weight
        else:
            other += weight
    loose = math.exp(min(diagnosis.unexplained, 700)) if diagnosis.unexplained > -700 else 0.0
    if word == WRONG:
        same += loose
    else:
        other += loose
    if word == CANNOT_TELL:
        return 0.5
    return same / (same + other)


def _runners_up(diagnosis: Diagnosis) -> tuple[tuple[tuple[str, ...], float], ...]:
    best = diagnosis.best
    found = []
    for h in diagnosis.ranking:
        if h.variant.mistakes == best.variant.mistakes:
            continue
        if not set(h.variant.mistakes) >= set(best.variant.mistakes) or not best.variant.mistakes:
            found.append((h.variant.mistakes, math.exp(min(best.score - h.score, 700))))
    return tuple((names, odds) for names, odds in found[:3] if odds < HOPELESS)


def _facts(
    diagnosis: Diagnosis,
    lead: View,
    grids: Sequence[tuple[Grid, int]],
    strange: bool,
    word: str,
    scene_file: Path,
) -> tuple[tuple[str, str], ...]:
    facts: dict[str, str] = {}
    for (grid, miss), view in zip(grids, diagnosis.views, strict=True):
        for code, text in (*grid.facts(view.scene), *view.picture.facts):
            facts.setdefault(code, text)
        if strange:
            facts.setdefault("geometry", say(WORDS["geometry"], miss=miss))
        for thing in view.scene.objects:
            if thing.name in view.recoloured:
                colour, stated = (
                    numbers(rgb, max(max(rgb), 1e-9))
                    for rgb in (view.recoloured[thing.name], thing.brdf)
                )
                said = with_object("colours", thing.name, colour=colour, stated=stated)
                facts.setdefault(f"colours {thing.name}", said)
        if view.picture.jpeg:
            facts.setdefault("jpeg", _(WORDS["jpeg"]))
    again = [share for share in diagnosis.shares if share < 0.75]
    if again:
        facts["once"] = say(WORDS["once"], count=len(again))
    shown = diagnosis.right.variant if word == RIGHT_ else diagnosis.best.variant
    if shown.factor != 1 and word != CANNOT_TELL:
        lights = [light for light in lead.scene.lights if hasattr(light, "radiance")]
        if len(lights) == 1:
            own = max(lights[0].radiance)
            power = own * shown.factor
            close = float(f"{power:.2g}")
            power = close if abs(power / close - 1) < 0.006 else power
            facts["power"] = say(WORDS["power"], power=power, stated=own)
        else:
            facts["power"] = say(WORDS["power_several"], factor=shown.factor)
    if word == RIGHT_:
        n = lead.picture.nb_light_samples
        times = effective_samples(lead, diagnosis) / n
        if times > 1.5:
            facts["better_sampler"] = say(WORDS["better_sampler"], times=times)
    clipped = (lead.value >= 1).mean()
    if clipped > 0.05:
        facts["saturated"] = say(WORDS["saturated"], share=clipped)
    return tuple(facts.items())


def _settle(
    word: str,
    lead: View,
    diagnosis: Diagnosis,
    strange: bool,
    brightness: float,
    hidden: tuple[str, ...],
    scene_file: Path,
) -> tuple[str, ...]:
    said = []
    if strange:
        said.append(say(WORDS["settle_camera"], scene=typed(scene_file)))
    if word == CANNOT_TELL and lead.picture.jpeg:
        said.append(_(WORDS["settle_png"]))
    if word == CANNOT_TELL and brightness > BLIND:
        said.append(_(WORDS["settle_size"]))
    if max(view.picture.nb_light_samples for view in diagnosis.views) < 16:
        said.append(_(WORDS["settle_n"]))
    for scene, shows in SHOWN_BY.items():
        if any(name in hidden for name in shows):
            said.append(say(WORDS["settle_scene"], scene=scene))
    return tuple(said)


SHOWN_BY = {
    "tp3_sheared.json": ("area_by_norms",),
    "tp3_two_quads.json": (
        "divided_inside_light_loop",
        "averaged_over_lights",
        "only_one_light",
        "flat_colour_squared",
    ),
}
"""Scenes that show what the lab's does not"""
