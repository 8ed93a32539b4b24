"""From one sample's moments to a pixel: its mean and its noise for any N, M, clamp and output.

A pixel sample is a product of what is visible and what is shaded. With p the chance that a sample
sees the light, and w its value where it does, of mean m and variance s2, every average of the
catalogue has

    mean = A(p) m,    mean square = B(p) m^2 + C(p) s2,

where A, B and C are those of a sum with weights a_i (A = p sum a_i, C = p sum a_i^2,
B = A^2 + p (1 - p) sum a_i^2) or of a value f of k visible samples (A = E f, B = E f^2,
C = E f^2 / the number of shaded ones). Clamps act on a normal distribution or, for few samples, on
the mixture over k.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtr, xlog1py, xlogy

from penumbra.compare.check.catalogue import SPLIT, Variant, evaluate
from penumbra.compare.check.moments import Key, Moments
from penumbra.compare.scene import PointLight, QuadLight, Scene

MIXTURE = 16
"""Up to so many samples a clamp acts on each number of visible ones apart."""
MOST_PARTS = 81
"""Of a mixture over the visible samples of several lights or pixel samples"""
P_GRID = np.linspace(0, 1, 257)
TOP = 256 / 255
"""What wraps to 0"""


@dataclass(frozen=True)
class Law:
    """Of n pixels' values: linear, before they become 8 bits."""

    mean: np.ndarray
    variance: np.ndarray
    correlation: str = "NONE"
    """which pixels share their random numbers: NONE, ALL, or those of a ROW"""
    rare: float = 0.0
    """the share of the pixels that most of the variance is of, if it is small; else 0"""


@dataclass(frozen=True)
class Surroundings:
    """What a pixel's value depends on beside the light samples, (n,) each."""

    moments: tuple[Moments, ...]
    """of each surface light"""
    scene: Scene
    flat_colour: np.ndarray
    """of the channel that is looked at"""
    radiance: tuple[np.ndarray, ...]
    """of each surface light, of that channel"""
    background: np.ndarray
    """of that channel"""
    distance: np.ndarray
    """from the camera [m]"""
    slope: np.ndarray
    """relative variance of the irradiance over the pixel"""


def key_of(variant: Variant) -> Key:
    return variant.domain, variant.visibility, variant.weight


def surface_lights(scene: Scene) -> list[int]:
    """Their positions in scene.lights."""
    return [i for i, light in enumerate(scene.lights) if not isinstance(light, PointLight)]


def predict(
    around: Surroundings, variant: Variant, n: int, m: int, jittered: bool, quick: bool = False
) -> Law:
    """Mean and variance of every pixel.

    n: light samples; m: pixel samples; jittered: pixel samples are at random places of the pixel;
    quick: clamps act on normal distributions only.
    """
    lights = surface_lights(around.scene)
    total, spread, between = (np.zeros_like(around.distance) for _ in range(3))
    parts = []
    colour = np.asarray(variant["colour"].evaluate(0, c=around.flat_colour), float)
    if colour.ndim == 0:
        colour = np.full_like(around.flat_colour, float(colour))
    for index, (light, moments, radiance) in enumerate(
        zip(lights, around.moments, around.radiance, strict=True)
    ):
        factor = brightness(around.scene.lights[light], variant, n)
        factor *= float(variant["lights"].evaluate(0, l=index, nl=len(lights), n=float(n)))
        gain = colour * radiance
        p, shaded, variance, fixed = _sample(moments, variant)
        shaded, variance = shaded * gain, variance * gain**2
        if variant["clamp"].arguments == ("LIGHT",):
            shaded, variance = clipped(shaded, variance)
        shaded, variance = shaded * factor, variance * factor**2
        a, b, c = _average(variant, n, p, fixed)
        mean = a * shaded
        total = total + mean
        spread = spread + np.maximum(b * shaded**2 + c * variance - mean**2, 0)
        if not fixed:  # the moments' own error: jittered points
            spread = spread + (0.35 / moments.grid**1.5 * shaded) ** 2 * np.minimum(
                1, 16 * p * (1 - p)
            )
        between = between + mean
        parts.append((p, shaded, variance, fixed))
    mean, var = total, spread
    if "unclamped" in variant.weight:
        mean, var = np.maximum(mean, 0), np.where(mean > 0, var, 0)
    across = around.slope * between**2 if jittered else np.zeros_like(mean)
    left = np.exp(-variant["output"].field("fog") * around.distance)
    extra = left * variant["output"].field("ambient") * colour + (1 - left) * around.background
    mean, var, across = left * mean + extra, left**2 * var, left**2 * across
    pixel = variant["clamp"].arguments == ("PIXEL",)
    within = 1 if pixel else m
    mixture: list[Part] = []
    where = np.zeros(0, dtype=int)
    if not quick and not any(fixed for _, _, _, fixed in parts):
        most = _most(variant, n)
        brightest = extra + left * most * sum(shaded for _, shaded, _, _ in parts)
        partly = np.any([(p > 0) & (p < 1) for p, _, _, _ in parts], axis=0)
        where = np.flatnonzero(partly & ((brightest > 0.9) | (mean + 4 * np.sqrt(var) > 1)))
        mixture = [(np.ones(len(where)), np.zeros(len(where)), np.zeros(len(where)))]
        dim = left[where]
        for p, shaded, variance, _ in parts:
            w, s2 = dim * shaded[where], dim**2 * variance[where]
            mixture = _sums(mixture, _parts(variant, n, within, p[where], w, s2))
        slope = around.slope[where] / within if jittered else 0.0
        mixture = [(c, extra[where] + one, two + slope * one**2) for c, one, two in mixture]
    end = wrapped if variant["output"].field("wrap") and not pixel else clipped
    mean, var = _through(end, mean, (var + across) / within, mixture, where)
    if pixel:
        var = var / m
    acne = variant["output"].field("acne")
    if acne:  # a part of the pixels black, the same for all samples
        kept = 1 - acne
        mean, var = kept * mean, kept * (var + mean**2) - (kept * mean) ** 2
    return Law(mean, var, variant["generator"].arguments[0], acne)


def brightness(light: object, variant: Variant, n: int) -> float:
    """The constant on every sample of a light."""
    area = float(light.area)  # type: ignore[attr-defined]
    norms = area
    if isinstance(light, QuadLight):
        norms = math.hypot(*light.edge_u) * math.hypot(*light.edge_v)
    scale = variant["scale"].evaluate(0, n=float(n), area=area, norms=norms)
    return float(scale) * variant.factor


def _sample(moments: Moments, variant: Variant) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """p, mean and variance of w where the light is seen, and whether p is a part of the pixel."""
    ray = variant["visibility"]
    p, first, second = moments[key_of(variant)].astype(float)
    if ray.field("apart") or ray.field("target"):  # w is not that of the visible samples
        if ray.field("target"):
            _, first, second = moments[variant.domain, "none", variant.weight].astype(float)
        mean, square = first, second
    else:
        seen = np.where(p > 0, p, 1)
        mean, square = first / seen, second / seen
    if variant["average"].macro == SPLIT and variant["average"].arguments[0] in ("APART", "FIRST"):
        _, mean, square = moments[variant.domain, "none", variant.weight].astype(float)
    p = p * (1 - ray.field("lost"))
    fixed = bool(ray.field("target")) or one_place(variant)
    return p, mean, np.maximum(square - mean**2, 0), fixed


def one_place(variant: Variant) -> bool:
    """Whether all samples of a light are one point of it."""
    a, b = np.array([0.1, 0.7]), np.array([0.2, 0.5])
    places = [np.asarray(variant["domain"].evaluate(i, a=a, b=b)) for i in (0, 1)]
    return all(np.ptp(place) == 0 for place in places)


def _weights(variant: Variant, n: int) -> np.ndarray:
    """Of each sample that is drawn."""
    average = variant["average"]
    drawn = int(average.evaluate(0, n=float(n)))
    weights = average.evaluate(1, n=float(n), i=np.arange(drawn, dtype=float))
    return np.broadcast_to(np.asarray(weights, float), (drawn,))


def _most(variant: Variant, n: int) -> float:
    """How often the mean of a visible sample is counted where all of them are visible."""
    average = variant["average"]
    if average.macro == SPLIT:
        return float(_split(average.arguments, n, np.ones((1, 1)))[1].max())
    return float(_weights(variant, n).sum())


def _average(
    variant: Variant, n: int, p: np.ndarray, fixed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and C of the module's text."""
    average = variant["average"]
    if average.macro == SPLIT:
        table = _split_table(average.arguments, n)
        if fixed:  # all samples or none
            table = table[:, :1] + (table[:, -1:] - table[:, :1]) * P_GRID
        a, b, c = (np.interp(p, P_GRID, row) for row in table)
        return a, b, c
    weights = _weights(variant, n)
    one, two = float(weights.sum()), float((weights**2).sum())
    a = p * one
    if fixed:  # p is the share of the pixel that sees it: of a ray, all or nothing
        return a, a * a + 0.5 * p * (1 - p) * one**2, p * two
    return a, a * a + p * (1 - p) * two, p * two


_SPLITS: dict[tuple[tuple[str, ...], int], np.ndarray] = {}


def _split_table(arguments: tuple[str, ...], n: int) -> np.ndarray:
    """(3, len(P_GRID)): A, B and C of a value of k visible samples of n."""
    if (arguments, n) not in _SPLITS:
        chance, f, h = _split(arguments, n, P_GRID[:, None])
        over = np.where(h > 0, f * f / np.maximum(h, 1), 0)
        _SPLITS[arguments, n] = np.stack([chance @ f, chance @ (f * f), chance @ over])
    return _SPLITS[arguments, n]


def _split(
    arguments: tuple[str, ...], n: int, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of k = 0 to n visible samples of n: the chance of each where a sample is visible with p,
    (len(p), n + 1) of p's (len(p), 1); the value, and how many are shaded, (n + 1,)."""
    kind, value, shaded = arguments
    k = np.arange(n + 1.0)
    if kind == "RUN":
        chance = np.where(k < n, p**k * (1 - p), p**n)
    elif kind == "FIRST":
        chance = np.where(k == 1, p, np.where(k == 0, 1 - p, 0.0))
    else:
        chance = _binomial(n, k, p)
    values = {"n": float(n), "k": k}
    f = np.broadcast_to(np.asarray(evaluate(value, values), float), k.shape)
    h = np.broadcast_to(np.asarray(evaluate(shaded, values), float), k.shape)
    return chance, f, h


def _binomial(n: int, k: np.ndarray, p: np.ndarray) -> np.ndarray:
    """The chance of k of n."""
    log = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
    return np.exp(log + xlogy(k, p) + xlog1py(n - k, -p))


# ---------------------------------------------------------------- clamps

Part = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of a mixture of normal distributions: the chance of one, its mean and its variance"""


def _parts(
    variant: Variant, n: int, m: int, p: np.ndarray, w: np.ndarray, s2: np.ndarray
) -> list[Part]:
    """The average of m pixel samples of one light, apart for each number of visible light samples;
    empty where these are too many to tell. w, s2: mean and variance of a visible sample."""
    average = variant["average"]
    if average.macro == SPLIT:
        chance, f, h = _split(average.arguments, n, p[:, None])
        one_of_m = [
            (chance[:, k], f[k] * w / m, f[k] ** 2 * s2 / max(h[k], 1) / m**2)
            for k in range(n + 1)
            if chance[:, k].any()
        ]
        found = one_of_m
        for _ in range(m - 1):
            found = _sums(found, one_of_m)
        return found if n <= MIXTURE else []
    weights = _weights(variant, n)
    one, two = float(weights.sum()), float((weights**2).sum())
    samples = round(one**2 / two) * m if two > 0 else 0  # of equal weight, as good as these
    if samples > MIXTURE:
        return []
    return [
        (_binomial(samples, np.asarray(float(k)), p), one * w * k / max(samples, 1),
         one**2 * s2 * k / max(samples, 1) ** 2)
        for k in range(samples + 1)
    ]  # fmt: skip


def _sums(one: list[Part], other: list[Part]) -> list[Part]:
    """The mixture of X + Y; empty where it has too many parts."""
    if len(one) * len(other) > MOST_PARTS:
        return []
    return [(c * d, x + y, s + t) for c, x, s in one for d, y, t in other]


Moved = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From the mean and the variance of a normal distribution to those of a function of it"""


def _through(
    end: Moved, mean: np.ndarray, variance: np.ndarray, mixture: list[Part], where: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of end(X), X normal, or at the pixels `where` a mixture of normal
    distributions, unless that is empty."""
    hot = mean + 4 * np.sqrt(variance) > 1
    mean, variance = mean.copy(), variance.copy()
    mean[hot], variance[hot] = end(mean[hot], variance[hot])
    if mixture:
        one, two = np.zeros(len(where)), np.zeros(len(where))
        for chance, first, second in mixture:
            mu, var = end(first, second)
            one += chance * mu
            two += chance * (var + mu * mu)
        mean[where], variance[where] = one, np.maximum(two - one * one, 0)
    return mean, variance


def clipped(mean: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of X clamped to [0, 1], X normal."""
    sd = np.sqrt(np.maximum(variance, 1e-14))
    one, one_square = _at_most(1.0, mean, sd)
    zero, zero_square = _at_most(0.0, mean, sd)
    first, second = one - zero, one_square - zero_square
    return first, np.maximum(second - first * first, 0)


def _at_most(top: float, mean: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of min(X, top) and of its square, X normal."""
    a = (top - mean) / sd
    density = np.exp(-0.5 * np.minimum(a * a, 1400)) / math.sqrt(2 * math.pi)
    below = ndtr(a)
    first = mean * below - sd * density + top * (1 - below)
    second = (mean**2 + sd**2) * below - sd * (mean + top) * density + top**2 * (1 - below)
    return first, second


def wrapped(mean: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of X mod TOP, X normal."""
    sd = np.sqrt(np.maximum(variance, 1e-12))
    first, second = mean.copy(), mean**2 + variance
    for j in range(1, 9):
        a = (j * TOP - mean) / sd
        tail = 1 - ndtr(a)
        density = np.exp(-0.5 * np.minimum(a * a, 1400)) / math.sqrt(2 * math.pi)
        part = mean * tail + sd * density
        first -= TOP * tail
        second -= 2 * TOP * part - (2 * j - 1) * TOP**2 * tail
    return first, np.maximum(second - first**2, 0)
