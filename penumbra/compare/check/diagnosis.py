"""Which renderer made these pictures: the right one, one of the catalogue's, or neither.

Every hypothesis (a Variant, or two mistakes at once, or an unexplained brightness) foretells mean
and noise of every cell of every picture; they are compared by likelihood, with a price on each
mistake that is what keeps correct renderers from being accused (docs/check.md, `make calibrate`).
First coarsely, on part of the cells, then the best ones on all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from penumbra.compare.check.catalogue import RIGHT, SPLIT, Choice, Variant, catalogue
from penumbra.compare.check.moments import Key
from penumbra.compare.check.prediction import brightness, key_of, one_place, surface_lights
from penumbra.compare.check.view import Statistics, View, lead_of
from penumbra.compare.scene import QuadLight, Scene

TEMPER = 0.5
"""Cells are not quite independent of each other: what a log-likelihood counts"""
PRICE_ONE, PRICE_TWO, PRICE_MORE, PRICE_FACTOR = 25.0, 60.0, 25.0, 45.0
"""Of one mistake, of two, of every further one, of an unexplained brightness beside a mistake, in
units of the tempered log-likelihood"""
PRICE_DIFFUSE = 60.0
"""More for random numbers that pixels share, which explain nearly any mean, and for unclamped
cosines, which change next to nothing and may pass for a better sampler"""
PRICE_PICTURE_ONE, PRICE_PICTURE_TWO = 5.0, 25.0
"""More for every picture beyond the first"""
ACCUSED = 15.0
"""Gain over `right` from which a picture is called wrong: with the price, odds of e^-40"""
LOOSE = (0.005, 0.01, 0.02, 0.05, 0.1, 0.3)
"""How far, relative, the mean may be off where no hypothesis holds"""
POWERS = (0.5, 2.0)
"""Brightnesses that a scene of half or twice the power has, where the power is not known"""
POWER_OR = ("area_halved", "light_twice")
"""Mistakes that are no more than that"""
KNOWN, KNOWN_AT_ONE = 0.008, 0.03
"""A brightness as near as this, relative, to a known mistake's is that mistake; where one light
sample is taken, whose noise hides as much"""
PARTS = 6
COARSE_GRID, FINE_GRID = 8, 12
FEW_CELLS = 0.03
"""Of the cells that may be anything, where it is asked whether a hypothesis explains all of them"""
LOCAL = 30.0
"""Gain of that from which it does not: those that hold stay below 15 or so"""
FINALISTS, FAR_BEHIND = 12, 80.0
SEEDS = 8
MOST_MISTAKES = 4
PLACES = np.arange(-1.5, 2.51, 0.25)
"""Of a free light: shares of the edges"""
WEIGHTS_WITH_DOMAIN = (
    *("std", "pdf_times_cos", "no_light_cosine", "no_receiver_cosine"),
    *("cos_of_cos_receiver", "distance_not_squared", "distance_omitted"),
)
"""What is tried together with samples that fall beside the light"""


@dataclass(frozen=True)
class Hypothesis:
    variant: Variant
    score: float
    """tempered log-likelihood less its price"""


@dataclass(frozen=True)
class Diagnosis:
    """What the pictures say."""

    views: tuple[View, ...]
    ranking: tuple[Hypothesis, ...]
    """best first, one of each set of names"""
    right: Hypothesis
    """the best that holds no mistake: the right renderer, perhaps of another power"""
    best: Hypothesis
    loose: float
    """relative error of the mean that the best leaves unexplained; 0: it explains the pictures"""
    unexplained: float
    """gain in score of saying so"""
    sure: tuple[str, ...]
    """of the best's mistakes, those without which it would be clearly worse"""
    alike: tuple[tuple[str, ...], ...]
    """other names that foretell the very same pictures"""
    hidden: tuple[str, ...]
    """mistakes that would not show in these pictures"""
    excluded: tuple[str, ...]
    """mistakes that would have shown, alone or beside the best, and did not"""
    shares: tuple[float, ...]
    """how much each picture counts: less where others hold the same random numbers"""
    light: FreeLight | None = None
    local: float = 0.0
    """gain in score of letting a few cells be anything"""


@dataclass(frozen=True)
class FreeLight:
    """Where the light seems to be: points in its plane that explain the mean."""

    misfit: float
    points: np.ndarray
    """(k, 2) of the light's edges: s, t"""
    weights: np.ndarray
    """(k,)"""
    inside: float
    """share of the weight on the light"""


def diagnose(views: Sequence[View], power_known: bool = False, without: str = "") -> Diagnosis:
    """power_known: the scene's power is what the program was given, so that a wrong brightness is a
    fault; without: a mistake that is not looked for, so that calibration can tell what becomes of
    one that the catalogue lacks. Raises MissingProgramError."""
    search = Search(power_known, without=without)
    search.add(views)
    search.coarse()
    return search.fine()


class Search:
    """The hypotheses, and what the pictures so far, of one scene or several, say of each. Further
    pictures can be added, and coarse() and fine() asked again."""

    def __init__(self, power_known: bool, many: bool = False, without: str = "") -> None:
        """many: pictures with several pixel samples may yet come; without: see diagnose."""
        self.power_known, self.many, self.without = power_known, many, without
        self.views: list[View] = []
        self.parts: list[View] = []
        """part() of each"""
        self.scenes: list[Scene] = []
        self.shares: list[float] = []
        self.known: list[float] = []
        self.scored: dict[Variant, float] = {}
        self._parts: dict[int, tuple[View, View]] = {}
        self._found: dict[tuple[int, Variant], Statistics] = {}
        self._said: dict[tuple[int, Variant, float], float] = {}

    def add(self, views: Sequence[View]) -> None:
        """Raises MissingProgramError."""
        self.views += views
        self.parts += [self.part(view) for view in views]
        self.scenes = list({id(view.scene): view.scene for view in self.views}.values())
        self.many |= any(view.picture.samples_per_pixel > 1 for view in self.views)
        self.shares = _shares(self.views)
        self.known = self._known()
        self.scored = {}

    def part(self, view: View) -> View:
        """Every PARTS-th cell; views of the same rays share what is computed for it."""
        key = id(view.around)
        if key not in self._parts:
            self._parts[key] = view, view.part(PARTS, COARSE_GRID)
        return self._parts[key][1].of(view.picture, view.grid)

    # -- scores

    def score(self, views: list[View], variant: Variant, loose: float = 0.0) -> float:
        total = sum(
            share * self._loglik(view, variant, loose)
            for share, view in zip(self.shares, views, strict=True)
        )
        return TEMPER * total - self.price(variant)

    def _loglik(self, view: View, variant: Variant, loose: float) -> float:
        key = id(view), variant, loose
        if key not in self._said:
            found = self.found(view, variant)
            found = found.loosened(loose) if loose else found
            self._said[key] = float(view.loglik_of(found, _may_be_quiet(variant)).sum())
        return self._said[key]

    def found(self, view: View, variant: Variant) -> Statistics:
        """Of the view's cells, held against the variant; kept."""
        key = id(view), variant
        if key not in self._found:
            self._found[key] = view.held_against(variant)
        return self._found[key]

    def price(self, variant: Variant) -> float:
        number, more = len(variant.mistakes), len(self.views) - 1
        price = 0.0
        if number == 1:
            price = PRICE_ONE + PRICE_PICTURE_ONE * more
            if (
                variant.generator != RIGHT
                or variant["weight"].mistake == "receiver_cosine_unclamped"
            ):
                price += PRICE_DIFFUSE
        elif number:
            price = PRICE_TWO + PRICE_PICTURE_TWO * more + PRICE_MORE * (number - 2)
        if variant.factor != 1:
            cheap = not number or any(abs(variant.factor / p - 1) < KNOWN for p in POWERS)
            price += PRICE_ONE if cheap and not self.power_known else PRICE_FACTOR
        return price

    def try_all(self, variants: Iterable[Variant]) -> None:
        new = [v for v in dict.fromkeys(variants) if v not in self.scored and not self._is_power(v)]
        for view in {id(view.around): view for view in self.parts}.values():
            view.prepare(keys_of(new))
        for variant in new:
            # what all cells would say
            said = self.score(self.parts, variant) + self.price(variant)
            self.scored[variant] = PARTS * said - self.price(variant)

    def _is_power(self, variant: Variant) -> bool:
        """Whether it is no more than half or twice the power, where that is not known."""
        if self.power_known or len(variant.wrong) != 1:
            return not self.power_known and variant.scale in POWER_OR
        light = self.scenes[0].lights[surface_lights(self.scenes[0])[0]]
        factors = [constant(variant, light, v.picture.nb_light_samples) for v in self.views]
        return variant.scale in POWER_OR or any(
            all(k is not None and abs(k / power - 1) < KNOWN for k in factors) for power in POWERS
        )

    def with_factor(self, variant: Variant) -> Variant:
        """With the brightness that fits best, unless a known mistake has that one."""
        lead = self.parts[self.lead]
        factor, drawn = lead.best_factor(variant), lead.picture
        near = max(
            KNOWN, KNOWN_AT_ONE / math.sqrt(drawn.nb_light_samples * drawn.samples_per_pixel)
        )
        if drawn.law != "float":  # a dim picture has few levels
            near = max(near, 0.5 / 255 / max(np.quantile(lead.mean(lead.value), 0.9), 1 / 255))
        if any(abs(factor / known - 1) < near for known in self.known):
            return variant
        return replace(variant, factor=factor)

    def _known(self) -> list[float]:
        """The constant factors of the catalogue, for these pictures."""
        lead = self.views[self.lead]
        lights = surface_lights(lead.scene)
        light, n = lead.scene.lights[lights[0]], lead.picture.nb_light_samples
        own = [v for v in singles(self.scenes, self.many, self.without)
               if v.wrong and not self._is_power(v)]  # fmt: skip
        found = [k for v in own if (k := constant(v, light, n)) is not None and k > 0]
        return [*found, 1 / len(lights)] if len(lights) > 1 else found

    @property
    def lead(self) -> int:
        """Which picture's noise says most."""
        return self.views.index(lead_of(self.views))

    # -- search

    def coarse(self) -> None:
        ones = singles(self.scenes, self.many, self.without)
        self.try_all([Variant(), *ones])
        self.try_all([self.with_factor(Variant())])
        best = self.ordered()[0]
        if self.looseness(self.parts, best)[1] > 0:
            shapes = [v for v in ones if (v.domain, v.visibility, v.weight) != (RIGHT,) * 3]
            shapes += [Variant(average=a) for a in ("n_no_effect", "running_half")]
            self.try_all([self.with_factor(v) for v in shapes])
            seeds = list(
                dict.fromkeys(replace(v, factor=1.0) for v in self.ordered() if v.mistakes)
            )
            for seed in seeds[:SEEDS]:
                self.try_all(pairs(seed, self.scenes, self.many, self.without))
        elif best.mistakes:
            alone = replace(best, factor=1.0)
            self.try_all(pairs(alone, self.scenes, self.many, self.without))
        best = self.ordered()[0]
        while len(best.mistakes) > 1 and self.looseness(self.parts, best)[1] > ACCUSED / PARTS:
            self.try_all(pairs(best, self.scenes, self.many, self.without))
            better = self.ordered()[0]
            if better == best or len(better.mistakes) > MOST_MISTAKES:
                break
            best = better

    def ordered(self) -> list[Variant]:
        return sorted(self.scored, key=self.scored.__getitem__, reverse=True)

    def looseness(self, views: list[View], variant: Variant) -> tuple[float, float]:
        """The relative error of its mean that fits best, and what saying so gains in score."""
        own = self.score(views, variant)
        gain, loose = max((self.score(views, variant, loose) - own, loose) for loose in LOOSE)
        return (loose, gain) if gain > 0 else (0.0, gain)

    def local(self, variant: Variant) -> float:
        """What it gains in score if a few cells may be anything."""
        total = 0.0
        for share, view in zip(self.shares, self.views, strict=True):
            found = self.found(view, variant)
            own = view.loglik_of(found, _may_be_quiet(variant))
            free = view.loglik_of(
                replace(
                    found,
                    residual_variance=found.residual_variance + 0.1**2,
                    noise_variance=found.noise_variance + 4,
                )
            )
            mixed = np.logaddexp(own + math.log(1 - FEW_CELLS), free + math.log(FEW_CELLS))
            total += share * (mixed - own).sum()
        return TEMPER * float(total)

    def fine(self) -> Diagnosis:
        ordered = self.ordered()
        best = self.scored[ordered[0]]
        finalists = [v for v in ordered[:FINALISTS] if self.scored[v] > best - FAR_BEHIND]
        finalists += [
            v
            for v in (Variant(), *[v for v in ordered if not v.mistakes][:2])
            if v not in finalists
        ]
        for view in {id(view.around): view for view in self.views}.values():
            view.prepare(keys_of(finalists))
        found = {v: self.score(self.views, v) for v in finalists}
        top = max(found, key=found.__getitem__)
        losses: dict[str, float] = {}
        for choice in top.wrong:
            less = replace(top, **{choice.module: RIGHT})  # type: ignore[arg-type]
            if less not in found:
                found[less] = self.score(self.views, less)
            losses[choice.mistake] = found[top] - found[less]
        sure = [
            name for name, loss in sorted(losses.items(), key=lambda x: -x[1]) if loss > ACCUSED
        ]
        hypotheses = sorted((Hypothesis(v, s) for v, s in found.items()), key=lambda h: -h.score)
        ranking: dict[tuple[Any, ...], Hypothesis] = {}
        for h in hypotheses:
            named = (h.variant.mistakes, bool(h.variant.mistakes) and h.variant.factor != 1)
            ranking.setdefault(named, h)
        loose, unexplained = self.looseness(self.views, top)
        light = self.free_light() if unexplained > 0 else None
        return Diagnosis(
            tuple(self.views),
            tuple(ranking.values()),
            next(h for h in hypotheses if not h.variant.mistakes),
            hypotheses[0],
            loose,
            unexplained,
            tuple(sure),
            self._alike(top),
            self._hidden(top),
            self.excluded(top),
            tuple(self.shares),
            light,
            self.local(top),
        )

    def free_light(self) -> FreeLight | None:
        """Where a light seems to be whose samples are none of the catalogue's: weights of points in
        its plane that explain the mean. None where there are several lights, or it is no quad."""
        from scipy.optimize import nnls  # half a second, seldom needed

        view = self.views[self.lead]
        lights = surface_lights(view.scene)
        light = view.scene.lights[lights[0]]
        if len(lights) > 1 or not isinstance(light, QuadLight):
            return None
        s, t = (a.ravel() for a in np.meshgrid(PLACES, PLACES))
        gain = view.around.flat_colour * view.around.radiance[0]
        places = view.around.moments[0].places(s, t) * gain
        cells = np.stack([view.mean(np.minimum(row, 1e6)) for row in places], axis=1)
        found = view.held_against(Variant())
        seen = view.mean(view.value)
        variance = found.noise / view.count + (0.004 * seen) ** 2 + (0.25 / 255) ** 2
        use = (seen < 0.93) & (view.count >= 8)
        if use.sum() < 50:
            return None
        sd = np.sqrt(variance[use])
        weights, _ = nnls(cells[use] / sd[:, None], seen[use] / sd)
        misfit = np.minimum(((cells[use] @ weights - seen[use]) / sd) ** 2, 25).mean()
        inside = (np.abs(s - 0.5) <= 0.65) & (np.abs(t - 0.5) <= 0.65)
        total = max(float(weights.sum()), 1e-9)
        return FreeLight(
            float(misfit), np.stack([s, t], axis=1), weights, float(weights[inside].sum() / total)
        )

    def _alike(self, top: Variant) -> tuple[tuple[str, ...], ...]:
        """Names of those that foretell what the best one foretells."""
        same = [
            v
            for v, score in self.scored.items()
            if len(v.mistakes) == len(top.mistakes) and v.factor == top.factor
            and v.mistakes != top.mistakes and abs(score - self.scored[top]) < PARTS
            and self.apart(v, top) < 1
        ] if top in self.scored else []  # fmt: skip
        return tuple(dict.fromkeys(v.mistakes for v in same if v.mistakes))

    def _hidden(self, top: Variant) -> tuple[str, ...]:
        """Names, none of whose choices would show as an addition to the best one."""
        shown: dict[str, bool] = {}
        for variant in singles(self.scenes, True, self.without) if not top.mistakes else ():
            for choice in variant.wrong:
                seen = _usable(choice, self.scenes, self.many) and self.apart(variant, top) > (
                    ACCUSED + PRICE_ONE
                )
                shown[choice.mistake] = shown.get(choice.mistake, False) or seen
        return tuple(name for name, seen in shown.items() if not seen)

    def excluded(self, top: Variant) -> tuple[str, ...]:
        """Names of mistakes that would have shown beside the top's."""
        names: dict[str, None] = {}
        plain = Variant()
        for choice in top.wrong:
            plain = plain.replaced(choice)
        for variant in pairs(plain, self.scenes, self.many, self.without):
            new = set(variant.mistakes) - set(plain.mistakes) - set(names)
            if new and self.apart(variant, plain) > ACCUSED + PRICE_ONE:
                names.update(dict.fromkeys(sorted(new)))
        return tuple(names)

    def apart(self, a: Variant, b: Variant) -> float:
        """How far, on average, the one's score is above the other's where it is the truth."""
        return TEMPER * sum(
            share * view.apart(self.found(view, a), self.found(view, b)) * PARTS
            for share, view in zip(self.shares, self.parts, strict=True)
        )


# ---------------------------------------------------------------- hypotheses


def keys_of(variants: Iterable[Variant]) -> list[Key]:
    """The moments that they need."""
    keys: dict[Key, None] = {}
    for variant in variants:
        keys[key_of(variant)] = None
        ray, average = variant["visibility"], variant["average"]
        apart = average.macro == SPLIT and average.arguments[0] in ("APART", "FIRST")
        if ray.field("target") or apart:
            keys[variant.domain, "none", variant.weight] = None
    return list(keys)


def _usable(choice: Choice, scenes: Sequence[Scene], many: bool) -> bool:
    """Whether it can differ from what is right in such pictures. many: some have several pixel
    samples, without which an early clamp is the output's clamp."""
    if choice.arguments == ("PIXEL",):
        return many
    if choice.module == "lights":
        return any(len(surface_lights(scene)) > 1 for scene in scenes)
    return True


def _widened(variant: Variant) -> list[Variant]:
    """Where the chance of a visible sample matters by itself, so does the small offset."""
    if (
        variant["average"].macro == SPLIT
        and variant.visibility == RIGHT
        and variant.domain == RIGHT
    ):
        return [replace(variant, visibility=v) for v in (RIGHT, "offset_0", "offset_0_01")]
    return [variant]


def singles(scenes: Sequence[Scene], many: bool = True, without: str = "") -> list[Variant]:
    """One choice of the catalogue each, sound ones included."""
    return [
        variant
        for choice in catalogue().choices.values()
        if choice.name != RIGHT
        and (not without or choice.mistake != without)
        and _usable(choice, scenes, many)
        for variant in _widened(Variant().replaced(choice))
    ]


def pairs(
    variant: Variant, scenes: Sequence[Scene], many: bool = True, without: str = ""
) -> list[Variant]:
    """With one mistake more, of another module."""
    return [
        widened
        for choice in catalogue().choices.values()
        if choice.mistake
        and choice.mistake != without
        and getattr(variant, choice.module) in (RIGHT, "offset_0", "offset_0_01")
        and _usable(choice, scenes, many)
        and _sensible(two := variant.replaced(choice))
        for widened in _widened(two)
    ]


def _may_be_quiet(variant: Variant) -> bool:
    """Whether noise that is lower than foretold by one factor is only a better sampler's: unless
    what it gets wrong is the noise itself."""
    ray = variant["visibility"]
    loud = ray.field("lost") or ray.field("apart") or variant["output"].field("acne")
    return variant.average == RIGHT and variant.generator == RIGHT and not loud


def constant(variant: Variant, light: Any, n: int) -> float | None:
    """The factor by which a mistake changes all brightness, if that is all it does to the mean."""
    if len(variant.wrong) != 1 or variant.wrong[0].module not in ("scale", "average"):
        return None
    scale = brightness(light, variant, n)
    average = variant["average"]
    if average.macro == SPLIT:
        return None
    drawn = np.arange(int(average.evaluate(0, n=float(n))), dtype=float)
    weights = np.broadcast_to(
        np.asarray(average.evaluate(1, n=float(n), i=drawn), float), drawn.shape
    )
    return scale * float(weights.sum())


def _sensible(variant: Variant) -> bool:
    """Not a pair that equals one of its mistakes."""
    ray, average = variant["visibility"], variant["average"]
    blind = bool(ray.field("target") or ray.field("ignored"))
    if average.macro == SPLIT and (blind or ray.field("apart")):
        return False
    if variant.domain != RIGHT:
        if variant.visibility not in (RIGHT, "none") or variant.weight not in WEIGHTS_WITH_DOMAIN:
            return False
        if one_place(variant) and (
            average.macro == SPLIT
            or variant.average in ("n_no_effect", "running_half")
            or variant.clamp == "per_light_sample"
            or variant.generator != RIGHT
        ):
            return False
    if variant.generator != RIGHT:  # with another mistake nearly every picture would be possible
        return len(variant.wrong) == 1
    if variant.scale == "normal_reversed":
        return len(variant.wrong) == 1
    return True


def _shares(views: list[View]) -> list[float]:
    """1 / how many of the pictures have this one's noise: a program whose N does nothing, or with
    one seed, gives one picture again and again, and it counts once."""
    high = []
    for view in views:
        mean = view.predict(Variant()).mean
        beside = np.flatnonzero(
            (np.diff(view.column) == 1) & (np.diff(view.row) == 0)
            & (mean[1:] > 0.05) & (mean[1:] < 0.9)
            & (view.value[1:] < 0.95) & (view.value[1:] > 0.03)
        )  # fmt: skip
        step = np.diff(view.value - mean)[beside]
        high.append((view.row[beside].astype(int) * 100_000 + view.column[beside], step))
    same = np.eye(len(views))
    for i, j in itertools.combinations(range(len(views)), 2):
        if views[i].scene is not views[j].scene:
            continue
        _, a, b = np.intersect1d(high[i][0], high[j][0], return_indices=True)
        if len(a) > 300 and high[i][1][a].std() > 0 and high[j][1][b].std() > 0:
            rho = float(np.corrcoef(high[i][1][a], high[j][1][b])[0, 1])
            same[i, j] = same[j, i] = rho**2 if rho > 0.2 else 0.0
    return [float(s) for s in 1 / same.sum(axis=1)]
