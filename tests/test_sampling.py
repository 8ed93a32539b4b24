"""Point sets: uniform, stratified, and with the slopes that follow from that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tests.core import ffi, library

SAMPLERS = ("INDEPENDENT", "JITTERED", "SOBOL")


@contextmanager
def point_set(sampler: str, count: int, seed: int = 1) -> Iterator[Any]:
    points = ffi.new("PointSet *")
    assert library().point_set_create(points, getattr(library(), f"SAMPLER_{sampler}"), count, seed)
    yield points
    library().point_set_free(points)


def draw(sampler: str, count: int, pixels: int, seed: int = 1, dimension: int = 1) -> np.ndarray:
    """(pixels, count, 2)"""
    with point_set(sampler, count, seed) as points:
        get = library().point_set_get
        return np.array(
            [
                [
                    (p.x, p.y)
                    for p in (
                        get(points, {"seed": seed, "pixel": k, "pixel_sample": 0}, i, dimension)
                        for i in range(count)
                    )
                ]
                for k in range(pixels)
            ]
        )


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_point_of_the_set_is_uniform(sampler: str) -> None:
    """Point k mod 9 of pixel k, over 4,500 pixels: chi-square over 8 x 8 cells. This is what makes
    every sampler unbiased. Fixed seeds, p > 1e-3."""
    xy = draw(sampler, 9, 4500)[np.arange(4500), np.arange(4500) % 9]
    counts, _, _ = np.histogram2d(*xy.T, bins=8, range=[(0, 1), (0, 1)])
    assert stats.chisquare(counts.ravel()).pvalue > 1e-3
    assert xy.min() >= 0
    assert xy.max() < 1


@pytest.mark.parametrize("count", [16, 64, 256])
def test_sobol_puts_one_point_in_each_box_of_every_elementary_partition(count: int) -> None:
    """A (0, m, 2)-net in base 2: of 2^m points exactly one lies in each of the 2^m boxes
    2^-a x 2^-(m - a), for every a. Owen's scramble and the digital shift keep that."""
    m = count.bit_length() - 1
    for seed in (1, 2):
        for pixel_points in draw("SOBOL", count, 3, seed):
            for a in range(m + 1):
                boxes = np.floor(pixel_points * [2**a, 2 ** (m - a)]).astype(int)
                assert len({(x, y) for x, y in boxes}) == count


@pytest.mark.parametrize(("count", "grid"), [(16, (4, 4)), (32, (8, 4)), (12, (4, 3)), (7, (7, 1))])
def test_jittered_puts_one_point_in_each_cell(count: int, grid: tuple[int, int]) -> None:
    for points in draw("JITTERED", count, 5):
        cells = {(int(x), int(y)) for x, y in points * grid}
        assert len(cells) == count


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("other", [{"seed": 2}, {"dimension": 2}])
def test_sets_of_other_seeds_and_lights_are_uncorrelated(
    sampler: str, other: dict[str, int]
) -> None:
    """The mean of a set over 400 pixels against that of another: correlation 0 with standard
    error 400^-1/2; 4 allowed. Were two lights to share points, it would be 1."""
    first = draw(sampler, 4, 400).mean(axis=1)[:, 0]
    second = draw(sampler, 4, 400, **other).mean(axis=1)[:, 0]
    assert abs(np.corrcoef(first, second)[0, 1]) < 4 / np.sqrt(400)


# Slopes of log RMSE against log N: theory for the smooth integrand, and for one with an edge that
# is not aligned with the axes (Mitchell: variance N^-3/2). Owen (1997): variance N^-3 log N of a
# smooth integrand, which over N = 4..256 reads as -1.4 or so.
SLOPES = {
    ("INDEPENDENT", "smooth"): -0.5, ("INDEPENDENT", "edge"): -0.5,
    ("JITTERED", "smooth"): -1.0, ("JITTERED", "edge"): -0.75,
    ("SOBOL", "smooth"): -1.45, ("SOBOL", "edge"): -0.75,
}  # fmt: skip


@pytest.mark.parametrize(("sampler", "kind"), list(SLOPES))
def test_slope_is_that_of_theory(sampler: str, kind: str) -> None:
    """RMSE over 300 pixels at N = 4, 16, 64, 256. Each log RMSE has a standard error of
    (2 * 300)^-1/2 = 0.041 (Gaussian errors), so the slope over log 64 of 4 points has
    0.041 / (log 4 * sqrt(5)) = 0.013: 4 of them, and 0.05 for what is not yet asymptotic."""
    sizes = (4, 16, 64, 256)
    rmse = []
    for count in sizes:
        x, y = np.moveaxis(draw(sampler, count, 300, seed=count), -1, 0)
        if kind == "smooth":
            values, truth = np.exp(x + 0.5 * y), (np.e - 1) * (np.exp(0.5) - 1) / 0.5
        else:
            values, truth = 1.0 * (0.8 * x + 0.6 * y < 0.65), None
        if truth is None:  # area of the square below 0.8 x + 0.6 y = 0.65: y from 0 to 1
            fine = (np.arange(100_000) + 0.5) / 100_000
            truth = np.clip((0.65 - 0.6 * fine) / 0.8, 0, 1).mean()
        rmse.append(np.sqrt(np.mean((values.mean(axis=-1) - truth) ** 2)))
    slope = np.polyfit(np.log(sizes), np.log(rmse), 1)[0]
    assert slope == pytest.approx(SLOPES[sampler, kind], abs=4 * 0.013 + 0.05)
