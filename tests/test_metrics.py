"""The metrics against hand-made values, and against input that would fool or kill them."""

from __future__ import annotations

import doctest
import math

import numpy as np
import pytest

from penumbra.compare.measure import metrics
from penumbra.compare.measure.metrics import (
    MAPS,
    NUMBERS,
    MetricError,
    bias,
    delta_e_2000,
    hdr_flip,
    mae,
    measure,
    measure_regions,
    mse,
    rel_mse,
    relative_bias,
    relative_rmse,
    rmse,
)

BLACK = np.zeros((12, 16, 3))
GREY = np.full((12, 16, 3), 0.5)


def noisy(seed: int = 1, scale: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    reference = generator.random((40, 60, 3)) + 0.1
    return reference + scale * generator.standard_normal(reference.shape), reference


def test_each_metric_equals_its_formula_on_a_two_pixel_image() -> None:
    """Errors of one channel: +1 on a reference of 2, and -0.5 on 0; the other four are exact.

    bias (1 - 0.5)/6; mse (1 + 0.25)/6; mae 1.5/6; the reference's sum is 2 and its norm 2;
    rel_mse (1/(4 + 0.01) + 0.25/0.01)/6.
    """
    reference = np.zeros((1, 2, 3))
    reference[0, 0, 0] = 2
    image = np.zeros((1, 2, 3))
    image[0, 0, 0], image[0, 1, 1] = 3, -0.5
    assert bias(image, reference) == pytest.approx(0.5 / 6)
    assert relative_bias(image, reference) == pytest.approx(0.25)
    assert mse(image, reference) == pytest.approx(1.25 / 6)
    assert rmse(image, reference) == pytest.approx(math.sqrt(1.25 / 6))
    assert relative_rmse(image, reference) == pytest.approx(math.sqrt(1.25) / 2)
    assert mae(image, reference) == pytest.approx(0.25)
    assert rel_mse(image, reference) == pytest.approx((1 / 4.01 + 25) / 6)


@pytest.mark.parametrize("name", [*NUMBERS, *MAPS])
def test_an_image_has_no_error_against_itself(name: str) -> None:
    _, reference = noisy()
    assert measure(reference, reference, perceptual=True)[name] == 0


@pytest.mark.parametrize("name", sorted({*NUMBERS, *MAPS} - {"bias", "relative_bias"}))
def test_light_in_a_black_region_is_never_reported_as_no_error(name: str) -> None:
    """A leak into the umbra must show in every metric, the relative ones included."""
    leak = BLACK.copy()
    leak[3, 4] = 0.01
    assert measure(leak, BLACK, perceptual=True)[name] > 0


@pytest.mark.parametrize("name", ["relative_bias", "relative_rmse"])
def test_a_ratio_to_a_black_reference_is_infinite_not_zero(name: str) -> None:
    assert measure(GREY, BLACK)[name] == math.inf
    assert measure(BLACK, BLACK)[name] == 0
    assert relative_bias(-GREY, BLACK) == -math.inf


@pytest.mark.parametrize("epsilon", [0.0, -1.0, math.nan])
def test_rel_mse_refuses_an_epsilon_that_lets_it_divide_by_zero(epsilon: float) -> None:
    with pytest.raises(MetricError, match="epsilon"):
        rel_mse(GREY, BLACK, epsilon=epsilon)


def test_masked_pixels_alone_count() -> None:
    """+1 in the left half, +3 in the right: the biases are 1, 3 and, of all, 2."""
    image = GREY + np.where(np.arange(16) < 8, 1.0, 3.0)[None, :, None]
    left = np.broadcast_to(np.arange(16) < 8, (12, 16))
    by_region = measure_regions(image, GREY, {"left": left, "right": ~left})
    assert by_region["left"]["bias"] == pytest.approx(1)
    assert by_region["right"]["bias"] == pytest.approx(3)
    assert measure(image, GREY)["bias"] == pytest.approx(2)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("swap", [False, True])
def test_nan_and_infinity_are_refused_by_every_metric(bad: float, swap: bool) -> None:
    """flip-evaluator, for one, gives NaN an error near 0."""
    broken = GREY.copy()
    broken[2, 3, 1] = bad
    pair = (GREY, broken) if swap else (broken, GREY)
    for metric in (*NUMBERS.values(), *MAPS.values()):
        with pytest.raises(MetricError, match="NaN or infinite"):
            metric(*pair)  # type: ignore[operator]


@pytest.mark.parametrize(
    "image",
    [GREY[:-1], GREY[:, :-1], GREY[..., :2], GREY[..., 0], np.zeros((0, 16, 3))],
    ids=["fewer rows", "fewer columns", "two channels", "one channel", "empty"],
)
def test_other_shapes_are_refused_by_every_metric(image: np.ndarray) -> None:
    for metric in (*NUMBERS.values(), *MAPS.values()):
        with pytest.raises(MetricError, match="shape"):
            metric(image, GREY)  # type: ignore[operator]


@pytest.mark.parametrize(
    "mask",
    [np.zeros((12, 16), bool), np.ones((16, 12), bool), np.ones((12, 16), np.uint8)],
    ids=["selects nothing", "transposed", "numbers"],
)
def test_a_mask_that_cannot_select_is_refused(mask: np.ndarray) -> None:
    with pytest.raises(MetricError, match="mask"):
        measure(GREY, GREY, mask)


def test_flip_equals_its_authors_default_where_that_works() -> None:
    """The exposures are computed here, to spare the process; the result must not change.

    The library does that in float32, so its exposures differ by about 1e-6 stops and the mean
    error by as much: 1e-5 is ten times that.
    """
    import flip_evaluator

    image, reference = noisy()
    image = np.maximum(image, 0)
    arrays = [a.astype(np.float32) for a in (reference, image)]
    _, mean, _ = flip_evaluator.evaluate(*arrays, "HDR", applyMagma=False)
    assert hdr_flip(image, reference).mean() == pytest.approx(mean, rel=1e-5)


def test_flip_does_not_depend_on_the_unit_of_radiance() -> None:
    """Its exposures follow the reference, so a common factor cancels (float32: to 1e-5).

    Unguarded, the library ends the process at a factor of 1e-30.
    """
    image, reference = noisy()
    expected = hdr_flip(image, reference).mean()
    for factor in (1e-30, 1e-3, 1e30):
        measured = hdr_flip(factor * image, factor * reference).mean()
        assert measured == pytest.approx(expected, rel=1e-5)


def test_flip_survives_references_that_end_the_librarys_process() -> None:
    """All black, mostly black (median 0) and uniform references; a flash of white on black is
    nearly the largest error there is, and black on black is none."""
    mostly_black = BLACK.copy()
    mostly_black[:3] = 0.5
    assert hdr_flip(BLACK, BLACK).max() == 0
    assert hdr_flip(BLACK + 1, BLACK).min() > 0.9
    assert 0 < hdr_flip(GREY, mostly_black).mean() <= 1
    assert hdr_flip(1.1 * GREY, GREY).min() > 0


def test_negative_radiance_shows_as_black() -> None:
    """A screen cannot show less than nothing; but the linear metrics do see it."""
    for metric in MAPS.values():
        assert metric(BLACK - 0.2, BLACK).max() == 0
        assert metric(BLACK - 0.2, GREY) == pytest.approx(metric(BLACK, GREY))
    assert measure(BLACK - 0.2, BLACK)["bias"] == pytest.approx(-0.2)


def test_delta_e_compares_the_clamped_radiance_read_as_srgb() -> None:
    """sRGB white is L* = 100, black 0: at C* = 0, Delta E 2000 is |dL| / S_L with
    S_L = 1 + 0.015 (50 - 50)^2 / sqrt(20 + 0) = 1 at the mean L* of 50, so 100. Above 1 all is
    white. (D65 of sRGB's matrix and of CIE L*a*b* differ by 1e-4, which leaves a chroma of
    8e-3, so the equality holds to about 0.01.)
    """
    white = BLACK + 1
    assert delta_e_2000(white, BLACK) == pytest.approx(np.full((12, 16), 100), abs=0.01)
    assert delta_e_2000(7 * white, white).max() == 0


def test_delta_e_reads_half_as_srgb_and_not_as_linear() -> None:
    """sRGB 0.5 decodes to ((0.5 + 0.055)/1.055)^2.4 = 0.21404, so L* = 116 * 0.21404^(1/3) - 16
    = 53.39; linear 0.5 would be L* = 76.07. Against black, S_L at the mean L* of 26.69 is
    1 + 0.015 * 23.31^2 / sqrt(20 + 23.31^2) = 1.3431, hence 39.75.
    """
    assert delta_e_2000(GREY, BLACK) == pytest.approx(np.full((12, 16), 39.75), abs=0.02)


def test_the_examples_in_the_docstrings_hold() -> None:
    tried = doctest.testmod(metrics)
    assert tried.attempted > 0 and tried.failed == 0
