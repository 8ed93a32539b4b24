"""Is a difference noise or bias? Tests whose false-alarm rates are what they say.

Two kinds. A region's bias is tested through its mean, which sums over enough pixels to be
normal. A single pixel is not: a pixel of the penumbra that saw 64 shadow rays may by accident
have met no occluder, so its sample variance is 0 and any z is infinite. Pixels are therefore
tested through what a sample can be at all (`range_test`), and through their scatter
(`scatter_test`) only where it may be pooled with the neighbours'. docs/statistics.md says what
each test proves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, special, stats

from penumbra.compare.measure.image import Image
from penumbra.compare.measure.metrics import luminance
from penumbra.language import N_

CONFIDENCE = 0.99
"""Of intervals and verdicts, and the power that a detectable bias is stated at."""
MIN_TILES = 10
"""Fewer tiles do not tell how far their mean scatters: with 10 the relative error of the standard
error is already 1 / sqrt(2 * 9) = 24%."""
TOO_FEW_TILES = N_(
    "{pixels} pixels without a variance make {tiles} tiles of {size}, and {least} are needed: "
    "noise cannot be told from bias"
)
TILE = 8
"""Side of a tile [pixels]: a JPEG's block, and wider than any anti-aliasing filter."""
POOL_RADIUS = 2
"""Variance is pooled over 5 x 5 pixels."""


class StatisticsError(ValueError):
    """Data that cannot be tested; the text says why."""


@dataclass(frozen=True)
class Estimate:
    """An image as statistics sees it: y = (R + G + B) / 3 of every pixel, and how sure it is."""

    mean: np.ndarray
    """(H, W) [W m^-2 sr^-1]"""
    variance: np.ndarray | None
    """(H, W) variance of each mean; None where nothing tells it"""
    dof: float
    """degrees of freedom of each variance; infinite where it is known"""
    count: int
    """independent samples behind each mean; 0 where that is not known"""
    error_bound: np.ndarray
    """(H, W) what may be off beyond noise: rounding, the exact solution's own bound"""

    @staticmethod
    def known(radiance: np.ndarray, error_bound: np.ndarray) -> Estimate:
        """No estimate at all: the exact solution."""
        mean = luminance(radiance)
        return Estimate(mean, np.zeros_like(mean), math.inf, 0, error_bound)

    @property
    def is_known(self) -> bool:
        """Whether nothing about it is random."""
        return self.variance is not None and math.isinf(self.dof)

    def at(self, mask: np.ndarray) -> Estimate:
        """Those pixels alone, as (n,) arrays."""
        variance = None if self.variance is None else self.variance[mask]
        return Estimate(self.mean[mask], variance, self.dof, self.count, self.error_bound[mask])


def estimate(image: Image, error_bound: np.ndarray | float = 0.0) -> Estimate:
    """What an image's channels and header tell.

    The variances of R, G and B come without their covariances, but the three share their
    samples, so they are taken as fully correlated: sd(y) = (sd(R) + sd(G) + sd(B)) / 3. That
    is exact where the lights differ in power only, and an upper bound otherwise.

    A pixel's independent samples are its light samples, or, if there are several places in the
    pixel, those: light samples of one place share it. Independent parts (Cycles) give
    parts - 1 degrees of freedom, samples their number - 1, and a header that tells neither 1.
    """
    mean = luminance(image.radiance)
    light_samples = _positive(image, "lightSamples")
    pixel_samples = _positive(image, "pixelSamples") or 1
    count = light_samples if pixel_samples == 1 else pixel_samples
    dof = max(1.0, (_positive(image, "parts") or count) - 1.0)
    variance = None
    if image.variance is not None:
        variance = np.sqrt(image.variance).mean(axis=-1) ** 2
        if not variance.any():
            dof = math.inf  # nothing was random
    return Estimate(mean, variance, dof, count, np.broadcast_to(error_bound, mean.shape))


@dataclass(frozen=True)
class BiasTest:
    """What is known of the bias of a region's mean [W m^-2 sr^-1]."""

    bias: float
    low: float
    high: float
    """the interval that holds the true bias at `confidence`"""
    confidence: float
    standard_error: float
    dof: float
    error_bound: float
    """what the interval was widened by on both sides"""
    p_value: float
    """of the hypothesis that there is no bias (beyond error_bound)"""

    @property
    def detectable(self) -> float:
        """The smallest bias that this test finds with probability `confidence` (its power),
        when a p-value below 1 - `confidence` counts as found."""
        quantiles = _t_quantile(0.5 + self.confidence / 2, self.dof) + _t_quantile(
            self.confidence, self.dof
        )
        return quantiles * self.standard_error + self.error_bound

    def p_beyond(self, limit: float) -> float:
        """p-value of the hypothesis that |bias| <= limit."""
        excess = abs(self.bias) - self.error_bound - limit
        return float(_two_sided_p(excess, self.standard_error, self.dof))


def bias_test(
    image: Estimate, reference: Estimate, mask: np.ndarray, confidence: float = CONFIDENCE
) -> BiasTest:
    """Welch's test of a region's mean difference, pixels independent.

    standard error^2 = sum of the pixels' variances / n^2, both images. Degrees of freedom by
    Welch and Satterthwaite: (sum v_i)^2 / sum(v_i^2 / dof_i), pixel by pixel.

    Raises StatisticsError if a variance is not known (see `bias_test_from_scatter`), or where
    no sample of the region differed from another but the means do: that may be an accident.
    """
    n = _count(mask)
    bias = float((image.mean[mask] - reference.mean[mask]).mean())
    bound = _mean_bound(image, reference, mask)
    total = squares = 0.0
    for one in (image, reference):
        if one.variance is None:
            raise StatisticsError(N_("there is no variance: noise cannot be told from bias"))
        if not one.is_known:
            variance = one.variance[mask] / n**2
            total += float(variance.sum())
            squares += float((variance**2 / _pixel_dof(one.at(mask))).sum())
    random = not (image.is_known and reference.is_known)
    dof = total**2 / squares if squares > 0 else math.inf
    # Light is not negative: where the reference is known to be black, nothing may scatter.
    is_black = reference.is_known and not reference.mean[mask].any()
    if random and total == 0 and abs(bias) > bound and not is_black:
        raise StatisticsError(N_("too few samples: none differs, so nothing tells the noise"))
    return _bias_test(bias, math.sqrt(total), dof, bound, confidence)


def bias_test_from_scatter(
    image: Estimate,
    reference: Estimate,
    mask: np.ndarray,
    confidence: float = CONFIDENCE,
    tile: int = TILE,
) -> BiasTest:
    """The same from the differences' own scatter, for images without variance.

    The noise of a region's mean is read from how the sums of its tiles, tile x tile pixels,
    scatter about it (the sandwich estimate of clustered data; Liang, Zeger 1986):
    se^2 = sum_t (sum of (difference - mean) in t)^2 / n^2 * T / (T - 1). Noise may be correlated
    within a tile. A bias that varies over the region counts as noise too, so the interval is
    wide rather than wrong. T = (sum n_t)^2 / sum n_t^2 is the effective number of tiles;
    raises StatisticsError for less than MIN_TILES.
    """
    n = _count(mask)
    difference = image.mean - reference.mean
    rows, columns = np.nonzero(mask)
    label = rows // tile * (mask.shape[1] // tile + 1) + columns // tile
    bias = float(difference[mask].mean())
    sizes = np.bincount(label)
    sums = np.bincount(label, weights=difference[mask] - bias)
    tiles = n**2 / float((sizes.astype(float) ** 2).sum())
    if tiles < MIN_TILES:
        size = f"{tile} x {tile}"
        raise StatisticsError(
            TOO_FEW_TILES.format(pixels=n, tiles=f"{tiles:.1f}", size=size, least=MIN_TILES)
        )
    variance = float((sums**2).sum()) / n**2 * tiles / (tiles - 1)
    bound = _mean_bound(image, reference, mask)
    return _bias_test(bias, math.sqrt(variance), tiles - 1, bound, confidence)


def scatter_test(
    image: Estimate, reference: Estimate, classes: np.ndarray, radius: int = POOL_RADIUS
) -> np.ndarray:
    """Welch's t test of every pixel, variances pooled; p-values, (H, W).

    A pixel's variance is averaged over the pixels of its class (classes: (H, W) int) within
    radius, whose degrees of freedom add up: 25 pixels of N = 4 have 75, where a pixel alone
    would have 3. Its own counts where it is larger: Cycles has pixels where one sample in
    thousands lies far off. So the false-alarm rate is at most what it says, where the variance
    is smooth within a class and a mean of `count` samples is otherwise normal: where the light
    is wholly visible. Raises StatisticsError if there is no variance.
    """
    total, squares = np.zeros(classes.shape), np.zeros(classes.shape)
    for one in (image, reference):
        if one.variance is None:
            raise StatisticsError("there is no variance to test a pixel with")
        pooled, pixels = _pooled(one.variance, classes, radius)
        pooled = np.maximum(pooled, one.variance)
        total += pooled
        squares += pooled**2 / (one.dof * pixels)
    with np.errstate(invalid="ignore", divide="ignore"):
        dof = np.where(squares > 0, total**2 / squares, np.inf)
    excess = np.abs(image.mean - reference.mean) - image.error_bound - reference.error_bound
    return _two_sided_p(excess, np.sqrt(total), dof)


def range_test(
    image: Estimate, reference: Estimate, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Test of every pixel from the range of its samples alone; p-values.

    Each of `count` independent samples lies in [low, high], arrays of the means' shape. Of all
    samples with mean m, those that are only ever low or high scatter most, so the mean's
    tails are at most those of a binomial: exp(-n KL) (Hoeffding 1963, theorem 1) and
    e * P(binomial) (Bentkus, "On Hoeffding's inequalities", Annals of Probability 32, 2004);
    the smaller holds. No variance, no normality: the false-alarm rate is at most what it says
    for any `count`, 1 included. Where all samples are alike it is far below.

    Where the reference is an estimate too, the p-value is the largest, over every possible
    true mean, of the two images' Bonferroni-combined ones. Samples that repel each other
    (Cycles' Sobol points) scatter less than independent ones, so their p-values err on the
    same side. Raises StatisticsError if a count is not known.
    """
    exact = reference.is_known
    if (image.count < 1 and not image.is_known) or (reference.count < 1 and not exact):
        raise StatisticsError("the number of samples is not known: a pixel cannot be tested")
    slack = image.error_bound + reference.error_bound
    # Rounding may have moved either mean: bring the two together by that much.
    x = image.mean + np.clip(reference.mean - image.mean, -slack, slack)
    if exact:
        return _range_p(x, reference.mean, image.count, low, high, slack)

    # Between the two means one p-value falls and the other rises: where they meet is the worst.
    near, far = x.copy(), reference.mean.copy()
    for _ in range(30):
        middle = (near + far) / 2
        p_image = _range_p(x, middle, image.count, low, high, slack)
        p_reference = _range_p(reference.mean, middle, reference.count, low, high, slack)
        move_away = p_image > p_reference
        near, far = np.where(move_away, middle, near), np.where(move_away, far, middle)
    return np.minimum(1, 2 * np.maximum(p_image, p_reference))


def holm(p: np.ndarray) -> np.ndarray:
    """Adjusted p-values: rejecting those <= alpha makes one false alarm or more, in the whole
    family, with probability alpha at most, however the tests depend on each other (Holm 1979).

    >>> holm(np.array([0.01, 0.04, 0.02])).tolist()
    [0.03, 0.04, 0.04]
    """
    p = np.asarray(p, dtype=np.float64)
    order = np.argsort(p)
    stepped = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(stepped, 1)
    return adjusted


def benjamini_hochberg(p: np.ndarray) -> np.ndarray:
    """Adjusted p-values: rejecting those <= q, an expected share q at most of the rejected are
    false alarms, for independent tests (Benjamini, Hochberg 1995); and if nothing at all is
    wrong, anything is rejected with probability q at most.

    >>> benjamini_hochberg(np.array([0.01, 0.04, 0.02])).tolist()
    [0.03, 0.04, 0.03]
    """
    p = np.asarray(p, dtype=np.float64)
    return stats.false_discovery_control(p) if p.size else p


def binomial_interval(trials: int, rate: float, confidence: float = CONFIDENCE) -> tuple[int, int]:
    """How often something of probability `rate` happens in `trials`, at `confidence`, ends
    included.

    >>> binomial_interval(1000, 0.01)
    (3, 19)
    """
    low, high = stats.binom.interval(confidence, trials, rate)
    return int(low), int(high)


def _positive(image: Image, attribute: str) -> int:
    value = image.attributes.get(attribute, 0)
    return value if isinstance(value, int) and value > 0 else 0


def _count(mask: np.ndarray) -> int:
    n = int(mask.sum())
    if n == 0:
        raise StatisticsError("the region is empty")
    return n


def _pixel_dof(one: Estimate) -> np.ndarray:
    """Degrees of freedom of each pixel's variance, from 1 to `dof`.

    Not samples - 1: where light is rare the variance rests on the few samples that met it.
    Samples that are all or nothing, seen with probability p, have a sample variance of relative
    variance (1 - 4 pq) / (pq N) + 2 / (N (N - 1)) = 2 / dof; mean and variance tell
    pq = m^2 s^2 / (m^2 + s^2)^2. Where they are not all or nothing that errs towards 1.
    """
    assert one.variance is not None
    n = one.dof + 1
    square, scatter = one.mean**2, one.variance * n
    pq = square * scatter / np.maximum((square + scatter) ** 2, np.finfo(float).tiny)
    relative = (1 - 4 * pq) / np.maximum(pq * n, np.finfo(float).tiny) + 2 / (n * (n - 1))
    return np.clip(2 / np.maximum(relative, np.finfo(float).tiny), 1, one.dof)


def _mean_bound(image: Estimate, reference: Estimate, mask: np.ndarray) -> float:
    return float((image.error_bound[mask] + reference.error_bound[mask]).mean())


def _bias_test(
    bias: float, standard_error: float, dof: float, bound: float, confidence: float
) -> BiasTest:
    half_width = _t_quantile(0.5 + confidence / 2, dof) * standard_error + bound
    p_value = float(_two_sided_p(abs(bias) - bound, standard_error, dof))
    return BiasTest(
        bias, bias - half_width, bias + half_width, confidence, standard_error, dof, bound, p_value
    )


def _two_sided_p(
    excess: np.ndarray | float, standard_error: np.ndarray | float, dof: np.ndarray | float
) -> np.ndarray:
    """p of a deviation that exceeds its allowance by `excess`; certain where nothing is random."""
    excess, standard_error = np.asarray(excess), np.asarray(standard_error)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(standard_error > 0, excess / standard_error, np.inf)
    return np.where(excess > 0, 2 * special.stdtr(dof, -t), 1.0)


def _t_quantile(probability: float, dof: float) -> float:
    return float(special.stdtrit(dof, probability))


def _pooled(
    variance: np.ndarray, classes: np.ndarray, radius: int
) -> tuple[np.ndarray, np.ndarray]:
    """The mean variance of a pixel's class around it, and of how many pixels."""
    size = 2 * radius + 1
    pooled, pixels = np.zeros(classes.shape), np.ones(classes.shape)
    for one in np.unique(classes):
        inside = classes == one
        # uniform_filter: a mean over the window; zeros outside the class and the image
        share = ndimage.uniform_filter(inside.astype(float), size, mode="constant")
        mean = ndimage.uniform_filter(np.where(inside, variance, 0), size, mode="constant")
        pooled[inside] = mean[inside] / share[inside]
        pixels[inside] = np.round(share[inside] * size**2)
    return pooled, pixels


def _range_p(
    x: np.ndarray,
    mean: np.ndarray,
    count: int,
    low: np.ndarray,
    high: np.ndarray,
    slack: np.ndarray,
) -> np.ndarray:
    """Bound on P(a mean of `count` samples in [low, high] is as far from `mean` as x).

    0 where x or mean lies out of [low, high] by more than slack.
    """
    possible = (np.minimum(x, mean) >= low - slack) & (np.maximum(x, mean) <= high + slack)
    width = np.where(high > low, high - low, 1.0)
    p, share = (np.clip((a - low) / width, 0, 1) for a in (mean, x))
    is_above = x > mean
    # P(k successes or more) = betainc(k, n - k + 1, p); P(k or less) is that of the failures
    p, share = np.where(is_above, p, 1 - p), np.where(is_above, share, 1 - share)
    k = np.floor(count * share)
    binomial = np.where(k > 0, special.betainc(np.maximum(k, 1), count - k + 1, p), 1.0)
    hoeffding = np.exp(-count * (special.rel_entr(share, p) + special.rel_entr(1 - share, 1 - p)))
    bound = np.where(possible, np.minimum(hoeffding, math.e * binomial), 0.0)
    return np.where(x == mean, 1.0, np.minimum(1, 2 * bound))
