"""Random numbers: the published generator, uniform, and independent where they must be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tests.core import library


def uniforms(count: int, **fixed: int) -> np.ndarray:
    """(count, 2) numbers of one stream's consecutive samples."""
    stream = {"seed": fixed.get("seed", 1), "pixel": fixed.get("pixel", 2), "pixel_sample": 0}
    rows = []
    for sample in range(count):
        pair = library().rng_uniform2(stream, sample, fixed.get("dimension", 1))
        rows.append((pair.x, pair.y))
    return np.array(rows)


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ("00000000 00000000 00000000 00000000", "00000000 00000000 00000000 00000000",
         "531c7e4f 39491ee5 2c855a92 3d6abf9a"),
        ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff ffffffff ffffffff",
         "c4189358 1c9cc83a d5881c67 6a0a89e0"),
        ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0 082efa98 ec4e6c89",
         "4aa71d8f 734738c2 431fc6a8 ae6debf1"),
    ],
)  # fmt: skip
def test_threefry_gives_the_known_answers_of_its_authors(
    counter: str, key: str, expected: str
) -> None:
    """The three vectors for threefry4x32, 13 rounds, in Random123's kat_vectors."""

    def words(text: str) -> list[int]:
        return [int(w, 16) for w in text.split()]

    block = library().rng_threefry4x32({"word": words(counter)}, {"word": words(key)})
    assert list(block.word) == words(expected)


def test_marginals_are_uniform() -> None:
    """Chi-square over 64 cells, 20,000 numbers each; fixed seed, p > 1e-3 for both."""
    for column in uniforms(20_000).T:
        counts, _ = np.histogram(column, bins=64, range=(0, 1))
        assert stats.chisquare(counts).pvalue > 1e-3


def test_pairs_fill_the_square_uniformly() -> None:
    """Chi-square over 16 x 16 cells: u and v are independent. A quad drawn with the same number
    for u and v, as two students did, is a diagonal and fails by hundreds of cells."""
    xy = uniforms(20_000)
    counts, _, _ = np.histogram2d(*xy.T, bins=16, range=[(0, 1), (0, 1)])
    assert stats.chisquare(counts.ravel()).pvalue > 1e-3


@pytest.mark.parametrize(
    "other",
    [{"seed": 2}, {"seed": 1 | 1 << 32}, {"seed": 2**64 - 1}, {"pixel": 3}, {"dimension": 2}],
)
def test_neighbouring_streams_are_uncorrelated(other: dict[str, int]) -> None:
    """Correlation of n = 20,000 pairs has a standard error of n^-1/2; 4 of them allowed."""
    n = 20_000
    correlation = np.corrcoef(uniforms(n)[:, 0], uniforms(n, **other)[:, 0])[0, 1]
    assert abs(correlation) < 4 / np.sqrt(n)


def test_numbers_stay_below_one() -> None:
    """u32 * 2^-32 in float rounds to 1.0 for 0xffffff80 and up; the top 24 bits do not."""
    values = uniforms(50_000)
    assert values.min() >= 0
    assert values.max() < 1
    assert np.all(values * 2**24 == np.round(values * 2**24))
