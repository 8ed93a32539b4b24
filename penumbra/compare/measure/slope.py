"""How fast an error falls with the number of light samples: slopes and their intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

RESAMPLES = 4000
"""Bootstrap resamples: their own noise on a 95% limit is about 2% of the interval's width."""
RESOLVED = 3.0
"""Standard errors that a noise-subtracted MSE must lie above zero to be used."""


@dataclass(frozen=True)
class Slope:
    """d log(RMSE) / d log(N)"""

    slope: float
    low: float | None
    """None: the seeds make no difference, so nothing tells how sure the slope is"""
    high: float | None
    light_samples: tuple[int, ...]
    """the N that were used"""


def fit_slope(
    light_samples: np.ndarray,
    mse: np.ndarray,
    offset_error: float = 0.0,
    floor: float = 0.0,
    confidence: float = 0.95,
) -> Slope | None:
    """Weighted least squares of log RMSE against log N, with a bootstrap interval.

    light_samples: (n,) N; mse: (n, K) the region's MSE in K images, whose seeds are
    independent and differ between one N and another; offset_error: standard error of a
    constant that all of mse have in common (the noise of a reference, once its variance is
    subtracted); floor: an MSE too small to mean anything. RMSE_N is the root of the mean over
    the K images.

    N are used up to the first whose mean MSE is not above floor and above RESOLVED times
    offset_error. None if fewer than three are left.

    Weights are 1 / (v + (offset_error / MSE_N)^2), where v, the relative variance of a mean
    over K images, is pooled over N: the MSE over a region's P pixels has a relative variance
    of about 2 / P whatever N is, and K images are too few to weigh each N by its own.

    The interval resamples images, within each N. The image is the unit because nothing
    smaller is known to be independent: a renderer's pixels may share random numbers. N is
    not resampled, since it was chosen. Resampling K values shows (K - 1) / K of their
    variance, and the normal's quantile is too near when the variance is known from few
    images, so deviations are widened by sqrt(K / (K - 1)) and by t over normal quantiles,
    with Welch-Satterthwaite degrees of freedom for equal relative variances,
    (K - 1) (sum a^2)^2 / sum a^4, where slope = sum a_N log RMSE_N.
    """
    light_samples = np.asarray(light_samples, dtype=np.float64)
    mse = np.asarray(mse, dtype=np.float64)
    mean = mse.mean(axis=1)
    resolved = mean > max(floor, RESOLVED * offset_error)
    n = len(mean) if resolved.all() else int(np.argmin(resolved))
    if n < 3:
        return None
    light_samples, mse, mean = light_samples[:n], mse[:n], mean[:n]
    used = tuple(int(x) for x in light_samples)
    coefficients = _least_squares(np.log(light_samples), _weights(mse, offset_error))
    slope = float(coefficients @ np.log(mean)) / 2

    k = mse.shape[1]
    if k < 2 or np.all(np.ptp(mse, axis=1) <= 1e-12 * mean):
        return Slope(slope, None, None, used)

    random = np.random.default_rng(0)
    chosen = random.integers(k, size=(RESAMPLES, n, k))
    means = np.take_along_axis(mse[None], chosen, axis=2).mean(axis=2)
    means += offset_error * random.standard_normal((RESAMPLES, 1))
    # A resample of nothing but lucky images must not send the logarithm to minus infinity.
    logs = np.log(np.maximum(means, mean / 20))
    deviations = logs @ coefficients / 2 - slope

    squares = coefficients**2
    freedom = (k - 1) * squares.sum() ** 2 / (squares**2).sum()
    tail = (1 - confidence) / 2
    widened = np.sqrt(k / (k - 1)) * stats.t.ppf(tail, freedom) / stats.norm.ppf(tail)
    low, high = slope + widened * np.quantile(deviations, [tail, 1 - tail])
    return Slope(slope, float(low), float(high), used)


def rmse_interval(mse: np.ndarray, confidence: float = 0.95) -> tuple[float, float, float]:
    """RMSE over K images' MSE, and its interval: Student's t on log(mean MSE), delta method.

    mse: (K,), mean above zero. With one image, or equal ones, both limits are the RMSE.
    """
    mean, k = float(np.mean(mse)), len(mse)
    if k < 2:
        return mean**0.5, mean**0.5, mean**0.5
    relative_error = float(np.std(mse, ddof=1)) / (mean * k**0.5)
    half = float(stats.t.ppf((1 + confidence) / 2, k - 1)) * relative_error / 2
    return mean**0.5, mean**0.5 * np.exp(-half), mean**0.5 * np.exp(half)


def _weights(mse: np.ndarray, offset_error: float) -> np.ndarray:
    """(n,) inverse variances of log mean MSE, up to a factor."""
    mean, k = mse.mean(axis=1), mse.shape[1]
    if k < 2 or offset_error == 0:
        return np.ones(len(mean))
    pooled = np.mean(mse.var(axis=1, ddof=1) / (k * mean**2))
    return np.asarray(1 / (pooled + (offset_error / mean) ** 2))


def _least_squares(x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """a with slope = sum a y, for y = constant + slope x of the given weights."""
    centred = x - np.average(x, weights=weights)
    return np.asarray(weights * centred / (weights * centred**2).sum())
