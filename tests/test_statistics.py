"""The tests of bias against simulated renderers whose bias is known, most often to be 0.

A simulated pixel of the penumbra sees the light with probability p: a mean of N samples is a
binomial share k / N, and its variance is estimated from the same k, as a renderer does. Rates of
false alarms are held to the 99.9% binomial interval of what they should be.
"""

from __future__ import annotations

import doctest
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import special, stats

from penumbra.compare.measure import statistics
from penumbra.compare.measure.image import Image
from penumbra.compare.measure.statistics import (
    BiasTest,
    Estimate,
    StatisticsError,
    benjamini_hochberg,
    bias_test,
    bias_test_from_scatter,
    binomial_interval,
    estimate,
    holm,
    range_test,
    scatter_test,
)

Simulated = tuple[Estimate, Estimate]


def known(mean: np.ndarray) -> Estimate:
    return Estimate(mean, np.zeros_like(mean), math.inf, 0, np.zeros_like(mean))


def penumbra(generator: np.random.Generator, p: np.ndarray, count: int) -> Estimate:
    """Means of `count` samples that are 1 with probability p, else 0."""
    share = generator.binomial(count, p) / count
    variance = share * (1 - share) / (count - 1)
    return Estimate(share, variance, count - 1.0, count, np.zeros_like(p))


def in_parts(generator: np.random.Generator, p: np.ndarray, count: int, parts: int) -> Estimate:
    """The same in independent parts, the variance from how they scatter."""
    shares = generator.binomial(count // parts, np.broadcast_to(p, (parts, *p.shape)))
    shares = shares / (count // parts)
    variance = shares.var(axis=0, ddof=1) / parts
    return Estimate(shares.mean(axis=0), variance, parts - 1.0, count, np.zeros_like(p))


def p_values(simulate: Callable[[np.random.Generator], Simulated], trials: int) -> np.ndarray:
    generator = np.random.default_rng(20)
    values = []
    for _ in range(trials):
        image, reference = simulate(generator)
        everywhere = np.ones(image.mean.shape, dtype=bool)
        values.append(bias_test(image, reference, everywhere).p_value)
    return np.array(values)


def assert_false_alarms_match(p: np.ndarray, *alphas: float) -> None:
    for alpha in alphas:
        low, high = binomial_interval(p.size, alpha, 0.999)
        assert low <= (p < alpha).sum() <= high, alpha


WIDE = np.linspace(0, 1, 150)[:, None]
"""every visibility once, as across a penumbra"""


# ---------------------------------------------------------------- a region's bias


@pytest.mark.parametrize("count", [8, 64, 1024])
def test_false_alarm_rate_against_exact_is_alpha(count: int) -> None:
    p = p_values(lambda g: (penumbra(g, WIDE, count), known(WIDE)), 2000)
    assert_false_alarms_match(p, 0.05, 0.01)


@pytest.mark.parametrize(("samples", "parts"), [(64, 8), (512, 4)])
def test_false_alarm_rate_against_a_noisy_reference_is_alpha(samples: int, parts: int) -> None:
    p = p_values(lambda g: (penumbra(g, WIDE, 16), in_parts(g, WIDE, samples, parts)), 2000)
    assert_false_alarms_match(p, 0.05, 0.01)


@pytest.mark.parametrize(
    ("pixels", "visibility", "count"),
    [(50, 0.01, 16), (50, 0.97, 16), (12, 0.5, 64), (200, 0.5, 2)],
)
def test_false_alarms_stay_rare_where_few_samples_decide(
    pixels: int, visibility: float, count: int
) -> None:
    """Eight visible samples in a region (50 * 0.01 * 16) are no normal mean: the test must call
    the region undecided or stay below alpha, never above it (99.9% binomial limit)."""
    true = np.full((pixels, 1), visibility)
    generator = np.random.default_rng(21)
    found = []
    for _ in range(2000):
        try:
            test = bias_test(penumbra(generator, true, count), known(true), true > 0)
            found.append(test.p_value < 0.01)
        except StatisticsError:
            found.append(False)
    assert sum(found) <= binomial_interval(2000, 0.01, 0.998)[1]


def test_interval_holds_the_true_bias_as_often_as_it_says() -> None:
    """Biased on purpose by 0.03; 99% of the intervals must hold 0.03."""
    generator = np.random.default_rng(22)
    held = 0
    for _ in range(2000):
        test = bias_test(penumbra(generator, 0.5 * WIDE + 0.03, 64), known(0.5 * WIDE), WIDE >= 0)
        held += test.low <= 0.03 <= test.high
    low, high = binomial_interval(2000, 0.99, 0.999)
    assert low <= held <= high


def test_detectable_bias_is_found_with_the_stated_power() -> None:
    """A bias as large as `detectable` says, 2.6 + 2.3 standard errors, is found in 99% of
    trials. Visibility near 1/2, so that the bias does not change the variance: p (1 - p) is
    flat there (0.5 -> 0.53: by 0.4%)."""
    true = np.full((100, 1), 0.5)
    generator = np.random.default_rng(23)
    size = bias_test(penumbra(generator, true, 64), known(true), true > 0).detectable
    found = [
        bias_test(penumbra(generator, true + size, 64), known(true), true > 0).p_value < 0.01
        for _ in range(2000)
    ]
    low, high = binomial_interval(2000, 0.99, 0.999)
    assert low <= sum(found) <= high


def test_detectable_bias_and_interval_follow_students_t() -> None:
    """16 pixels whose variance 0.04 comes from 2 samples each, so 1 degree of freedom each:
    se = sqrt(16 * 0.04) / 16 = 0.05, dof = 16, t(0.995) = 2.9208, t(0.99) = 2.5835; a bias of
    0.1 is t = 2."""
    mean = np.full((4, 4), 0.5)
    image = Estimate(mean + 0.1, np.full((4, 4), 0.04), 1.0, 2, np.zeros((4, 4)))
    test = bias_test(image, known(mean), mean > 0)
    assert test.dof == pytest.approx(16)
    assert test.standard_error == pytest.approx(0.05)
    assert test.high - test.bias == pytest.approx(2.9208 * 0.05, rel=1e-4)
    assert test.detectable == pytest.approx((2.9208 + 2.5835) * 0.05, rel=1e-4)
    assert test.p_value == pytest.approx(2 * stats.t.sf(2, 16))


def test_degrees_of_freedom_count_what_was_seen_and_not_what_was_drawn() -> None:
    """1000 samples that are all or nothing, the light met by 4 of them in each of 25 pixels:
    p = 0.004, sample variance 1000/999 p (1 - p), whose own relative variance is
    (1 - 4 pq) / (pq N) = 0.247 (and 2e-6 more), so 2 / 0.247 = 8.1 degrees of freedom and not
    999; 25 times that in all."""
    mean = np.full((5, 5), 0.004)
    image = Estimate(mean, mean * (1 - mean) / 999, 999.0, 1000, np.zeros((5, 5)))
    pq = 0.004 * 0.996
    expected = 25 * 2 / ((1 - 4 * pq) / (1000 * pq))
    assert bias_test(image, known(mean), mean > 0).dof == pytest.approx(expected, rel=0.01)


def test_error_bounds_widen_the_interval_and_are_no_evidence_of_bias() -> None:
    """A difference within the two bounds has p = 1 even where nothing is random."""
    mean = np.full((4, 4), 0.5)
    bound = np.full((4, 4), 0.01)
    image = Estimate(mean + 0.015, np.zeros((4, 4)), math.inf, 1, bound)
    reference = Estimate(mean, np.zeros((4, 4)), math.inf, 0, bound)
    test = bias_test(image, reference, mean > 0)
    assert (test.p_value, test.standard_error) == (1, 0)
    assert (test.low, test.high) == pytest.approx((-0.005, 0.035))
    assert test.p_beyond(0.0) == 1
    beyond = Estimate(mean + 0.03, np.zeros((4, 4)), math.inf, 1, bound)
    assert bias_test(beyond, reference, mean > 0).p_value == 0


def test_p_beyond_tests_the_excess_over_the_limit() -> None:
    """bias 5, limit 2, bound 1, standard error 1: two standard errors are left."""
    test = BiasTest(5.0, 0.0, 0.0, 0.99, 1.0, math.inf, 1.0, 0.0)
    assert test.p_beyond(2.0) == pytest.approx(2 * stats.norm.sf(2))
    assert test.p_beyond(6.0) == 1


def test_no_scatter_by_accident_is_not_certainty() -> None:
    """All 4 samples of all pixels hidden where the light is seen once in a thousand: the sample
    variance is 0 and z infinite, though that happens in 0.999^40 = 96% of images."""
    true = np.full((10, 1), 0.001)
    image = Estimate(0 * true, 0 * true, 3.0, 4, 0 * true)
    with pytest.raises(StatisticsError, match="too few samples"):
        bias_test(image, known(true), true > 0)


def test_light_in_a_black_region_is_certain_bias() -> None:
    """There nothing may scatter: radiance is not negative, so a mean of 0 has no variance."""
    leak = Estimate(np.full((3, 3), 0.1), np.zeros((3, 3)), 15.0, 16, np.zeros((3, 3)))
    test = bias_test(leak, known(np.zeros((3, 3))), np.ones((3, 3), bool))
    assert test.p_value == 0


def test_without_variance_or_pixels_there_is_no_test() -> None:
    mean = np.ones((3, 3))
    blind = Estimate(mean, None, 1.0, 0, 0 * mean)
    with pytest.raises(StatisticsError, match="no variance"):
        bias_test(blind, known(mean), mean > 0)
    with pytest.raises(StatisticsError, match="no variance"):
        scatter_test(blind, known(mean), np.ones((3, 3), int))
    with pytest.raises(StatisticsError, match="empty"):
        bias_test(known(mean), known(mean), mean > 1)
    with pytest.raises(StatisticsError, match="empty"):
        bias_test_from_scatter(blind, known(mean), mean > 1)


# ---------------------------------------------------------------- bias without a variance


def test_false_alarm_rate_from_scatter_is_alpha_for_independent_pixels() -> None:
    generator = np.random.default_rng(24)
    p = []
    for _ in range(2000):
        noise = generator.standard_normal((64, 64))
        image = Estimate(noise, None, 1.0, 0, np.zeros((64, 64)))
        test = bias_test_from_scatter(image, known(0 * noise), np.ones((64, 64), bool))
        p.append(test.p_value)
    assert_false_alarms_match(np.array(p), 0.05, 0.01)


def test_false_alarms_from_scatter_stay_rare_when_neighbours_share_noise() -> None:
    """A 3 x 3 box filter, as anti-aliasing makes, correlates neighbours: pixels counted as
    independent would make the standard error 3 times too small and find bias in 40% of images.
    A tile's sum weighs the white noise of its 8 + 2 columns by 1/3, 2/3, 1 (6 times), 2/3, 1/3:
    squares of 7.11 in all where 8 is the truth, in two dimensions 0.79. So alpha grows from 1%
    to P(|z| > 2.576 * sqrt(0.79)) = 2.2%: held to 2.5%.
    """
    generator = np.random.default_rng(25)
    found = 0
    for _ in range(2000):
        white = generator.standard_normal((66, 66))
        windows = np.lib.stride_tricks.sliding_window_view(white, (3, 3))
        image = Estimate(windows.mean(axis=(2, 3)), None, 1.0, 0, np.zeros((64, 64)))
        test = bias_test_from_scatter(image, known(np.zeros((64, 64))), np.ones((64, 64), bool))
        found += test.p_value < 0.01
    assert found <= binomial_interval(2000, 0.025, 0.998)[1]


def test_too_few_tiles_are_refused() -> None:
    mean = np.ones((16, 16))
    with pytest.raises(StatisticsError, match=r"4\.0 tiles"):
        bias_test_from_scatter(known(mean), known(mean), mean > 0)


# ---------------------------------------------------------------- single pixels


def false_alarm_rate_of_range_test(p: float, count: int, alpha: float) -> float:
    """Exactly: the sum of the binomial probabilities of all k that are called inconsistent."""
    k = np.arange(count + 1)
    image = Estimate(k / count, None, 1.0, count, np.zeros(count + 1))
    found = range_test(image, known(np.full(count + 1, p)), np.zeros(1), np.ones(1)) <= alpha
    return float(stats.binom.pmf(k[found], count, p).sum())


@pytest.mark.parametrize("count", [1, 2, 4, 16, 64, 1000])
def test_range_test_never_exceeds_its_alpha(count: int) -> None:
    """Computed, not simulated, for visibilities down to 1e-4 and alphas to 1e-7, with samples
    that are all or nothing: of all samples in a range the ones that scatter most."""
    for p in (1e-4, 0.003, 0.05, 0.3, 0.5, 0.9, 0.9999):
        for alpha in (0.5, 0.05, 0.01, 1e-4, 1e-7):
            assert false_alarm_rate_of_range_test(p, count, alpha) <= alpha


def test_z_test_of_single_pixels_cries_wolf_where_range_test_does_not() -> None:
    """What the range test is for. 150 visibilities, 16 samples: the z test from the pixels' own
    variance, at a level of 1e-6, calls pixels inconsistent that are not, by the hundred."""
    generator = np.random.default_rng(26)
    true = np.tile(WIDE, (1, 100))
    image = penumbra(generator, true, 16)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.abs(image.mean - true) / np.sqrt(image.variance)
    assert (2 * stats.norm.sf(z) < 1e-6).sum() > 500
    p = range_test(image, known(true), np.zeros_like(true), np.ones_like(true))
    assert not (benjamini_hochberg(p.ravel()) < 0.01).any()


@pytest.mark.parametrize("name", ["uniform", "late", "early"])
def test_range_test_holds_for_samples_of_any_shape(name: str) -> None:
    """Samples in [2, 5] of three beta distributions, 5 to a pixel, 200,000 pixels: at most a
    share alpha below alpha (99.9% limit)."""
    a, b = {"uniform": (1.0, 1.0), "late": (4.0, 0.2), "early": (0.05, 2.0)}[name]
    generator = np.random.default_rng(27)
    mean = 2 + 3 * generator.beta(a, b, (200_000, 5)).mean(axis=1)
    true = np.full_like(mean, 2 + 3 * a / (a + b))
    image = Estimate(mean, None, 1.0, 5, np.zeros_like(mean))
    p = range_test(image, known(true), np.full_like(mean, 2), np.full_like(mean, 5))
    for alpha in (0.1, 0.01, 1e-3):
        assert (p <= alpha).sum() <= binomial_interval(p.size, alpha, 0.998)[1]


def test_range_test_of_two_noisy_images_never_exceeds_its_alpha() -> None:
    """Computed over all pairs of counts of 12 and 30 samples."""
    k, m = (a.ravel() for a in np.meshgrid(np.arange(13), np.arange(31), indexing="ij"))
    image = Estimate(k / 12, None, 1.0, 12, np.zeros(k.size))
    reference = Estimate(m / 30, np.ones(k.size), 1.0, 30, np.zeros(k.size))
    p = range_test(image, reference, np.zeros(k.size), np.ones(k.size))
    for visibility in (0.01, 0.2, 0.5, 0.95):
        chance = stats.binom.pmf(k, 12, visibility) * stats.binom.pmf(m, 30, visibility)
        for alpha in (0.2, 0.05, 0.01, 1e-4):
            assert chance[p <= alpha].sum() <= alpha


def test_range_test_finds_what_cannot_be() -> None:
    """Values out of the range of samples have p = 0; so does light where there is none; and 400
    samples of a pixel seen half the time do not come out at 0.8: 12 standard deviations."""
    mean = np.array([0.0, 1.5, 0.8, 0.5])
    true = np.array([0.5, 0.5, 0.5, 0.0])
    image = Estimate(mean, None, 1.0, 400, np.zeros(4))
    p = range_test(image, known(true), np.array([0.1, 0, 0, 0]), np.ones(4))
    assert (p[[0, 1, 3]] == 0).all()
    assert 0 < p[2] < 1e-30


def test_range_test_forgives_rounding_and_nothing_more() -> None:
    """A hard shadow's pixel is 0.3 without scatter; 1e-7 beside it is allowed by the bound."""
    true = np.full(2, 0.3)
    image = Estimate(true + np.array([0.9e-6, 1e-3]), None, 1.0, 1, np.full(2, 1e-6))
    assert list(range_test(image, known(true), true - 1e-6, true + 1e-6)) == [1, 0]


def test_range_test_needs_the_number_of_samples() -> None:
    true = np.full(2, 0.3)
    unknown = Estimate(true, None, 1.0, 0, 0 * true)
    with pytest.raises(StatisticsError, match="number of samples"):
        range_test(unknown, known(true), 0 * true, true + 1)
    with pytest.raises(StatisticsError, match="number of samples"):
        range_test(Estimate(true, None, 1.0, 4, 0 * true), unknown, 0 * true, true + 1)


def lit_pixels(generator: np.random.Generator, shape: tuple[int, int], count: int) -> Estimate:
    """Means of samples (1 + u (2^(1/4) - 1))^4, u uniform: within a factor of 2 of each other
    and skewed as 1 / d^4 is. Shifted to a true mean of 0."""
    step = 2**0.25 - 1
    true = (2**1.25 - 1) / (5 * step)
    samples = (1 + step * generator.random((count, *shape))) ** 4
    variance = samples.var(axis=0, ddof=1) / count
    return Estimate(samples.mean(axis=0) - true, variance, count - 1.0, count, np.zeros(shape))


def test_scatter_test_never_exceeds_its_alpha_far_into_the_tail() -> None:
    """A million lit pixels at N = 16, the least it is used for: no more false alarms than alpha
    down to 1e-5, where 10 are expected (99.9% limits). There are fewer, because samples between
    1 and 2 have lighter tails than a normal distribution and because the larger variance
    counts, but more than half at 5%."""
    generator = np.random.default_rng(28)
    image = lit_pixels(generator, (1000, 1000), 16)
    p = scatter_test(image, known(np.zeros((1000, 1000))), np.zeros((1000, 1000), int))
    for alpha in (0.05, 1e-2, 1e-3, 1e-4, 1e-5):
        assert (p < alpha).sum() <= binomial_interval(p.size, alpha, 0.998)[1]
    assert (p < 0.05).mean() > 0.025


def test_one_part_that_lies_far_off_is_noise() -> None:
    """Seven of eight parts without scatter and one off by 8: the mean is off by 1, its standard
    error 1 too (found in Cycles, once in hundreds of pixels). Pooled with its quiet neighbours
    alone it would be 5 standard errors."""
    mean, variance = np.zeros((9, 9)), np.zeros((9, 9))
    mean[4, 4] = variance[4, 4] = 1
    image = Estimate(mean, variance, 7.0, 512, np.zeros((9, 9)))
    assert scatter_test(image, known(np.zeros((9, 9))), np.zeros((9, 9), int))[4, 4] > 0.3


def test_scatter_test_pools_within_a_class_only() -> None:
    """Left half of variance 1, right half of 100, one class each: at the border, too, 3 is 3
    standard deviations on the left and 0.3 on the right. Inside, 25 pixels of 3 degrees of
    freedom each are 75; in a corner of the image 9 pixels are 27."""
    right = np.broadcast_to(np.arange(20) >= 10, (12, 20))
    variance = np.where(right, 100.0, 1.0)
    image = Estimate(np.full((12, 20), 3.0), variance, 3.0, 4, np.zeros((12, 20)))
    p = scatter_test(image, known(np.zeros((12, 20))), right.astype(int))
    assert p[6, 5] == pytest.approx(2 * stats.t.sf(3, 75))
    assert p[6, 9] == pytest.approx(2 * stats.t.sf(3, 45))
    assert p[6, 10] == pytest.approx(2 * stats.t.sf(0.3, 45))
    assert p[0, 0] == pytest.approx(2 * stats.t.sf(3, 27))


# ---------------------------------------------------------------- many tests at once


def test_holm_steps_down_and_benjamini_hochberg_steps_up() -> None:
    """Holm: 4*0.01, 3*0.02, 2*0.03, 1*0.5; Benjamini-Hochberg: 4*0.01/1, 4*0.02/2, 4*0.03/3."""
    p = np.array([0.5, 0.01, 0.03, 0.02])
    assert holm(p) == pytest.approx([0.5, 0.04, 0.06, 0.06])
    assert benjamini_hochberg(p) == pytest.approx([0.5, 0.04, 0.04, 0.04])
    assert holm(np.array([])).size == benjamini_hochberg(np.array([])).size == 0
    assert list(holm(np.array([0.9, 0.8]))) == [1, 1]


@pytest.mark.parametrize("adjust", [holm, benjamini_hochberg])
def test_a_family_without_bias_raises_an_alarm_as_rarely_as_one_test(
    adjust: Callable[[np.ndarray], np.ndarray],
) -> None:
    """1000 uniform p-values: any alarm in at most 5% of 2000 families (and in not much less)."""
    generator = np.random.default_rng(29)
    alarms = sum((adjust(generator.random(1000)) <= 0.05).any() for _ in range(2000))
    low, high = binomial_interval(2000, 0.05, 0.999)
    assert low <= alarms <= high


# ---------------------------------------------------------------- what a header tells


def image_with(variance: float | None, **attributes: int) -> Image:
    shape = (2, 2, 3)
    values = None if variance is None else np.full(shape, variance)
    return Image(np.full(shape, 0.5), values, dict(attributes))


def test_the_variance_of_y_takes_channels_as_fully_correlated() -> None:
    """Variances 1, 4, 9 of R, G, B: sd(y) = (1 + 2 + 3) / 3 = 2. For one random number X seen by
    the three as X, 2 X, 3 X that is exact."""
    image = Image(np.zeros((1, 1, 3)), np.array([[[1.0, 4.0, 9.0]]]), {"lightSamples": 16})
    found = estimate(image).variance
    assert found is not None
    assert found == pytest.approx(np.array([[4.0]]))


@pytest.mark.parametrize(
    ("attributes", "count", "dof"),
    [
        ({"lightSamples": 64, "pixelSamples": 1}, 64, 63),
        ({"lightSamples": 4, "pixelSamples": 16}, 16, 15),
        ({"lightSamples": 1024, "pixelSamples": 1, "parts": 8}, 1024, 7),
        ({}, 0, 1),
    ],
)
def test_counts_and_degrees_of_freedom_come_from_the_header(
    attributes: dict[str, int], count: int, dof: float
) -> None:
    found = estimate(image_with(0.1, **attributes))
    assert (found.count, found.dof, found.is_known) == (count, dof, False)


def test_an_image_whose_every_variance_is_zero_is_known() -> None:
    """A point light leaves nothing to chance."""
    assert estimate(image_with(0.0, lightSamples=1)).is_known
    assert not estimate(image_with(None, lightSamples=1)).is_known


def test_a_hostile_header_does_not_pass_for_a_count() -> None:
    for value in (-4, 0, "64", 64.0):
        image = Image(np.zeros((1, 1, 3)), None, {"lightSamples": value})
        assert estimate(image).count == 0


def test_betainc_is_the_binomial_tail_that_range_test_takes_it_for() -> None:
    """P(k or more of n) = I_p(k, n - k + 1): the identity that the code relies on."""
    k = np.arange(1, 21)
    assert special.betainc(k, 20 - k + 1, 0.3) == pytest.approx(stats.binom.sf(k - 1, 20, 0.3))


def test_the_examples_in_the_docstrings_hold() -> None:
    tried = doctest.testmod(statistics)
    assert tried.attempted > 0 and tried.failed == 0
