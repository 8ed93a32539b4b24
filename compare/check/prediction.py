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
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtr

from compare.check.catalogue import RIGHT, SPLIT, Variant
from compare.check.moments import Key, Moments
from compare.scene import PointLight, QuadLight, Scene

MIXTURE = 16
"""Up to so many samples a clamp acts on each number of visible ones apart."""
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
    total, spread, between = np.zeros_like(around.distance), 0.0, 0.0
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
    mean, var = total, np.asarray(spread)
    if "unclamped" in variant.weight:
        mean, var = np.maximum(mean, 0), np.where(mean > 0, var, 0)
    extra = variant["output"].field("ambient") * colour
    mean = mean + extra
    across = around.slope * between**2 if jittered else 0.0
    fog = variant["output"].field("fog")
    if fog:
        left = np.exp(-fog * around.distance)
        mean, var = left * mean + (1 - left) * around.background, left**2 * var
    alone = parts[0] if len(parts) == 1 and not fog else None
    plain = not quick and alone is not None and not alone[3] and variant["average"].macro != SPLIT
    if variant["clamp"].arguments == ("PIXEL",):
        samples = _drawn(variant, n)
        mean, var = _clamped(mean, var + across, alone if plain else None, samples, extra, variant, n)
        var = var / m
    else:
        var = (var + across) / m
        if variant["output"].field("wrap"):
            return Law(*_wrapped(mean, var), variant["generator"].arguments[0])
        mean, var = _clamped(mean, var, alone if plain else None, _drawn(variant, n) * m, extra,
                             variant, n)  # fmt: skip
    acne = variant["output"].field("acne")
    if acne:  # a part of the pixels black, the same for all samples
        kept = 1 - acne
        mean, var = kept * mean, kept * (var + mean**2) - (kept * mean) ** 2
    return Law(mean, var, variant["generator"].arguments[0])


def brightness(light: object, variant: Variant, n: int) -> float:
    """The constant on every sample of a light."""
    area = float(light.area)  # type: ignore[attr-defined]
    norms = area
    if isinstance(light, QuadLight):
        norms = math.hypot(*light.edge_u) * math.hypot(*light.edge_v)
    scale = variant["scale"].evaluate(0, n=float(n), area=area, norms=norms)
    return float(scale) * variant.factor


def _sample(
    moments: Moments, variant: Variant
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
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


def _drawn(variant: Variant, n: int) -> int:
    if variant["average"].macro == SPLIT:
        return n
    return int(variant["average"].evaluate(0, n=float(n)))


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
    drawn = _drawn(variant, n)
    index = np.arange(drawn, dtype=float)
    weights = np.broadcast_to(np.asarray(average.evaluate(1, n=float(n), i=index), float), (drawn,))
    one, two = float(weights.sum()), float((weights**2).sum())
    a = p * one
    if fixed:  # p is the share of the pixel that sees it: of a ray, all or nothing
        return a, a * a + 0.5 * p * (1 - p) * one**2, p * two
    return a, a * a + p * (1 - p) * two, p * two


_SPLITS: dict[tuple[tuple[str, ...], int], np.ndarray] = {}


def _split_table(arguments: tuple[str, ...], n: int) -> np.ndarray:
    """(3, len(P_GRID)): A, B and C of a value of k visible samples of n."""
    if (arguments, n) not in _SPLITS:
        kind, value, shaded = arguments
        k = np.arange(n + 1.0)
        p = P_GRID[:, None]
        if kind == "RUN":
            chance = np.where(k < n, p**k * (1 - p), p**n)
        elif kind == "FIRST":
            chance = np.where(k == 1, p, np.where(k == 0, 1 - p, 0.0))
        else:
            log = gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)
            with np.errstate(divide="ignore", invalid="ignore"):
                log = log + np.where(k > 0, k * np.log(p), 0)
                log = log + np.where(k < n, (n - k) * np.log1p(-p), 0)
            chance = np.exp(log)
        from compare.check.catalogue import _compiled  # the same evaluator

        values = {"n": float(n), "k": k}
        f = np.broadcast_to(np.asarray(_compiled(value)(values), float), k.shape)
        h = np.broadcast_to(np.asarray(_compiled(shaded)(values), float), k.shape)
        over = np.where(h > 0, f * f / np.maximum(h, 1), 0)
        _SPLITS[arguments, n] = np.stack([chance @ f, chance @ (f * f), chance @ over])
    return _SPLITS[arguments, n]


# ---------------------------------------------------------------- clamps


def clipped(mean: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of min(X, 1), X normal (and all but surely above 0)."""
    sd = np.sqrt(np.maximum(variance, 1e-14))
    a = (1 - mean) / sd
    density = np.exp(-0.5 * np.minimum(a * a, 1400)) / math.sqrt(2 * math.pi)
    below = ndtr(a)
    first = mean * below - sd * density + (1 - below)
    second = (mean * mean + sd * sd) * below - sd * (mean + 1) * density + (1 - below)
    return first, np.maximum(second - first * first, 0)


def _clamped(
    mean: np.ndarray,
    variance: np.ndarray,
    alone: tuple[np.ndarray, np.ndarray, np.ndarray, bool] | None,
    samples: int,
    extra: np.ndarray,
    variant: Variant,
    n: int,
) -> tuple[np.ndarray, np.ndarray]:
    """min(X, 1). alone: the one light's sample, where X is a mixture over its visible ones."""
    out_mean, out_variance = mean.copy(), variance.copy()
    hot = mean + 4 * np.sqrt(variance) > 1
    mixed = np.zeros_like(hot)
    if alone is not None and samples <= MIXTURE:
        p = alone[0]
        mixed = hot & (p > 1e-3) & (p < 1 - 1e-3)
    plain = hot & ~mixed
    out_mean[plain], out_variance[plain] = clipped(mean[plain], variance[plain])
    if mixed.any() and alone is not None:
        p, w, s2 = (v[mixed] for v in alone[:3])
        a, b, _ = _average(variant, n, np.ones(1), False)
        one = float(a[0])  # sum of the weights
        first, second = np.zeros_like(p), np.zeros_like(p)
        for k in range(samples + 1):
            log = gammaln(samples + 1) - gammaln(k + 1) - gammaln(samples - k + 1)
            chance = np.exp(log + k * np.log(p) + (samples - k) * np.log1p(-p))
            mu, var = clipped(
                one * w * k / samples + extra[mixed], one**2 * s2 * k / samples**2
            )
            first += chance * mu
            second += chance * (var + mu * mu)
        out_mean[mixed], out_variance[mixed] = first, np.maximum(second - first * first, 0)
    return out_mean, out_variance


def _wrapped(mean: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
