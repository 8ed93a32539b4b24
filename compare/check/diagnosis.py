"""Which renderer made these pictures: the right one, one of the catalogue's, or neither.

Every hypothesis (a Variant, or two mistakes at once, or an unexplained brightness) foretells mean
and noise of every cell of every picture; they are compared by likelihood, with a price on each
mistake that is what keeps correct renderers from being accused (docs/check.md, `make calibrate`).
First coarsely, on part of the cells, then the best ones on all.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compare.check.catalogue import MODULES, RIGHT, SPLIT, Choice, Variant, catalogue
from compare.check.grid import Grid, fit_grid
from compare.check.picture import Picture
from compare.check.prediction import key_of, one_place, surface_lights
from compare.check.view import Statistics, View
from compare.scene import Scene

TEMPER = 0.5
"""Cells are not quite independent of each other: what a log-likelihood counts"""
PRICE_ONE, PRICE_TWO, PRICE_FACTOR = 10.0, 40.0, 45.0
"""Of one mistake, of two, of an unexplained brightness, in units of the tempered log-likelihood"""
PRICE_PICTURE_ONE, PRICE_PICTURE_TWO = 5.0, 25.0
"""More for every picture beyond the first"""
ACCUSED = 15.0
"""Gain over `right` from which a picture is called wrong: with the price, odds of e^-25"""
POOR = 3.0
"""Mean squared misfit above which a hypothesis does not explain the picture"""
PARTS = 6
COARSE_GRID, FINE_GRID = 8, 12
FINALISTS = 16
SEEDS = 8
WEIGHTS_WITH_DOMAIN = ("std", "pdf_times_cos", "no_light_cosine", "no_receiver_cosine",
                       "cos_of_cos_receiver", "distance_not_squared", "distance_omitted")  # fmt: skip
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
    unknown: float
    """score of "something, but nothing of the catalogue" """
    misfit: float
    """mean squared misfit of the best"""
    light: FreeLight | None = None


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


def look(
    pictures: Sequence[Picture], scene: Scene, scene_file: Path
) -> tuple[list[View], list[tuple[Grid, int]]]:
    """The pictures on their grids; those with one grid share what is computed for it."""
    fitted: list[tuple[Grid, int]] = []
    views: list[View] = []
    single = next((p for p in pictures if p.samples_per_pixel == 1), None)
    first = fit_grid(single, scene) if single else None
    for picture in pictures:
        grid, miss = (
            first if picture is single and first else _fit_like(picture, scene, first)
        )
        fitted.append((grid, miss))
        twin = next(
            (
                view
                for view in views
                if replace(view.grid, jittered=False) == replace(grid, jittered=False)
                and view.picture.values.shape == picture.values.shape
            ),
            None,
        )
        views.append(twin.of(picture, grid) if twin else View(picture, grid, scene, scene_file, FINE_GRID))
    return views, fitted


def _fit_like(
    picture: Picture, scene: Scene, first: tuple[Grid, int] | None
) -> tuple[Grid, int]:
    """A further picture's grid: the first one's, if both take one ray a pixel."""
    if first and picture.samples_per_pixel == 1:
        return first
    return fit_grid(picture, scene)


def diagnose(views: Sequence[View]) -> Diagnosis:
    """Raises MissingProgramError."""
    search = _Search(views)
    search.coarse()
    return search.fine()


class _Search:
    def __init__(self, views: Sequence[View]) -> None:
        self.views = list(views)
        self.many = any(view.picture.samples_per_pixel > 1 for view in views)
        parts: dict[int, View] = {}
        self.parts = []
        for view in views:
            key = id(view.around)
            if key not in parts:
                parts[key] = view.part(PARTS, COARSE_GRID)
            self.parts.append(parts[key].of(view.picture, view.grid))
        self.shares = _shares(self.views)
        self.scored: dict[Variant, float] = {}

    # -- scores

    def score(self, views: list[View], variant: Variant) -> float:
        total = sum(
            share * view.loglik(variant, spared_noise=not variant.mistakes)
            for share, view in zip(self.shares, views, strict=True)
        )
        return TEMPER * total - self.price(variant)

    def price(self, variant: Variant) -> float:
        number, more = len(variant.mistakes), len(self.views) - 1
        price = 0.0
        if number == 1:
            price = PRICE_ONE + PRICE_PICTURE_ONE * more
        elif number:
            price = PRICE_TWO + PRICE_PICTURE_TWO * more
        if variant.factor != 1:
            price += PRICE_FACTOR if number else PRICE_ONE
        return price

    def try_all(self, variants: Iterable[Variant]) -> None:
        for variant in variants:
            if variant not in self.scored:
                self.scored[variant] = self.score(self.parts, variant)

    def with_factor(self, variant: Variant) -> Variant:
        lead = self.parts[self.lead]
        return replace(variant, factor=lead.best_factor(variant))

    @property
    def lead(self) -> int:
        """The picture whose noise says most."""
        return min(
            range(len(self.views)),
            key=lambda i: (
                self.views[i].picture.samples_per_pixel > 1,
                abs(math.log2(self.views[i].picture.nb_light_samples) - 4),
            ),
        )

    # -- search

    def coarse(self) -> None:
        scene = self.views[0].scene
        for view in {id(view.around): view for view in self.parts}.values():
            view.prepare(every_key(scene))
        ones = singles(scene, self.many)
        self.try_all([Variant(), *ones])
        shapes = [v for v in ones if any(c.module in ("domain", "visibility", "weight") for c in v.wrong)]
        shapes += [Variant(average=a) for a in ("n_no_effect", "running_half")]
        self.try_all(self.with_factor(v) for v in (Variant(), *shapes))
        ordered = sorted(self.scored, key=self.scored.__getitem__, reverse=True)
        seeds = list(dict.fromkeys(replace(v, factor=1.0) for v in ordered if v.mistakes))[:SEEDS]
        if ordered[0].mistakes or self.misfit(self.parts, ordered[0]) > 1:
            for seed in seeds:
                self.try_all(pairs(seed, scene, self.many))

    def fine(self) -> Diagnosis:
        ordered = sorted(self.scored, key=self.scored.__getitem__, reverse=True)
        best = self.scored[ordered[0]]
        near = [v for v in ordered if self.scored[v] > best - 120 or not v.mistakes]
        finalists = near[:FINALISTS]
        finalists += [v for v in (Variant(), self.with_factor(Variant())) if v not in finalists]
        for view in {id(view.around): view for view in self.views}.values():
            view.prepare(keys_of(finalists))
        found = [Hypothesis(v, self.score(self.views, v)) for v in finalists]
        found.sort(key=lambda h: -h.score)
        ranking: dict[tuple[Any, ...], Hypothesis] = {}
        for hypothesis in found:
            v = hypothesis.variant
            ranking.setdefault((v.mistakes, bool(v.mistakes) and v.factor != 1), hypothesis)
        right = max((h for h in found if not h.variant.mistakes), key=lambda h: h.score)
        top = found[0]
        return Diagnosis(
            tuple(self.views),
            tuple(ranking.values()),
            right,
            top,
            self.unknown(),
            self.misfit(self.views, top.variant),
        )

    def misfit(self, views: list[View], variant: Variant) -> float:
        values = [view.statistics(view.predict(variant)).misfit for view in views]
        return float(np.mean([np.minimum(v, 25).mean() for v in values]))

    def unknown(self) -> float:
        """The score of a renderer of which only is known that it lights what is lit: its mean may
        be off by a third, its noise by a factor."""
        total = 0.0
        for share, view in zip(self.shares, self.views, strict=True):
            found = view.statistics(view.predict(Variant()))
            wide = replace(
                found,
                residual_variance=found.residual_variance + (0.3 * found.mean + 0.03) ** 2,
                noise_variance=found.noise_variance + 1.0,
            )
            total += share * float(view.loglik_of(wide).sum())
        return TEMPER * total - PRICE_TWO - PRICE_PICTURE_TWO * (len(self.views) - 1)


# ---------------------------------------------------------------- hypotheses


def keys_of(variants: Iterable[Variant]) -> list[tuple[str, str, str]]:
    """The moments that they need."""
    keys: dict[tuple[str, str, str], None] = {}
    for variant in variants:
        keys[key_of(variant)] = None
        ray, average = variant["visibility"], variant["average"]
        if ray.field("target") or average.macro == SPLIT and average.arguments[0] in ("APART", "FIRST"):
            keys[variant.domain, "none", variant.weight] = None
    return list(keys)


def every_key(scene: Scene) -> list[tuple[str, str, str]]:
    """The moments that any pair of mistakes needs."""
    names = {m: [c.name for c in catalogue().of_module(m)] for m in ("domain", "visibility", "weight")}
    keys = [(RIGHT, ray, weight) for ray in names["visibility"] for weight in names["weight"]]
    keys += [
        (domain, ray, weight)
        for domain in names["domain"]
        if domain != RIGHT
        for ray in (RIGHT, "none")
        for weight in WEIGHTS_WITH_DOMAIN
    ]
    return keys


def _usable(choice: Choice, scene: Scene, many: bool) -> bool:
    """Whether it can differ from what is right in such pictures. many: some have several pixel
    samples, without which an early clamp is the output's clamp."""
    if choice.arguments == ("PIXEL",):
        return many
    if choice.module == "lights":
        return len(surface_lights(scene)) > 1
    return True


def _widened(variant: Variant) -> list[Variant]:
    """Where the chance of a visible sample matters by itself, so does the small offset."""
    if variant["average"].macro == SPLIT and variant.visibility == RIGHT and variant.domain == RIGHT:
        return [replace(variant, visibility=v) for v in (RIGHT, "offset_0", "offset_0_01")]
    return [variant]


def singles(scene: Scene, many: bool = True) -> list[Variant]:
    """One choice of the catalogue each, sound ones included."""
    return [
        variant
        for choice in catalogue().choices.values()
        if choice.name != RIGHT and _usable(choice, scene, many)
        for variant in _widened(Variant().replaced(choice))
    ]


def pairs(variant: Variant, scene: Scene, many: bool = True) -> list[Variant]:
    """With one mistake more, of another module."""
    return [
        widened
        for choice in catalogue().choices.values()
        if choice.mistake and getattr(variant, choice.module) in (RIGHT, "offset_0", "offset_0_01")
        and _usable(choice, scene, many)
        and _sensible(two := variant.replaced(choice))
        for widened in _widened(two)
    ]


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
            average.macro == SPLIT or variant.average in ("n_no_effect", "running_half")
            or variant.clamp == "per_light_sample" or variant.generator != RIGHT
        ):
            return False
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
            & (mean[1:] > 0.05) & (mean[1:] < 0.9) & (view.value[1:] < 0.95) & (view.value[1:] > 0.03)
        )  # fmt: skip
        step = np.diff(view.value - mean)[beside]
        high.append((view.row[beside].astype(int) * 100_000 + view.column[beside], step))
    same = np.eye(len(views))
    for i, j in itertools.combinations(range(len(views)), 2):
        _, a, b = np.intersect1d(high[i][0], high[j][0], return_indices=True)
        if len(a) > 300 and high[i][1][a].std() > 0 and high[j][1][b].std() > 0:
            rho = float(np.corrcoef(high[i][1][a], high[j][1][b])[0, 1])
            same[i, j] = same[j, i] = rho**2 if rho > 0.2 else 0.0
    return [float(s) for s in 1 / same.sum(axis=1)]
