"""How far an image is from its reference: one number, or one map, a metric.

Arrays are linear radiance, (H, W, 3) float; a mask is (H, W) bool and says which pixels count.
The metrics take one image at its word; what of it is noise is the business of statistics.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

REL_MSE_EPSILON = 1e-2
"""Added to the squared reference in rel_mse [(W m^-2 sr^-1)^2].

The value of Rousselle, Knaus, Zwicker, "Adaptive sampling and reconstruction using greedy
error minimization" (2011). It weighs an error in the dark as if it sat on a radiance of 0.1.
"""


class MetricError(ValueError):
    """Two arrays that cannot be measured against each other; the text says why."""


def luminance(radiance: np.ndarray) -> np.ndarray:
    """y = (R + G + B) / 3, (H, W): the scalar of every test of bias.

    The plain mean, not the eye's: the scenes' surfaces have one primary colour each, and no
    region should weigh less for being blue.
    """
    return np.asarray(radiance, dtype=np.float64).mean(axis=-1)


def bias(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """mean(image - reference) over pixels and channels [W m^-2 sr^-1]. Raises MetricError.

    >>> bias(np.full((2, 2, 3), 0.75), np.full((2, 2, 3), 0.5))
    0.25
    """
    x, r = _pixels(image, reference, mask)
    return float((x - r).mean())


def relative_bias(
    image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None
) -> float:
    """bias / mean(reference). Over a black reference 0 for a black image, else infinite."""
    x, r = _pixels(image, reference, mask)
    return _ratio(float((x - r).mean()), float(r.mean()))


def mse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """mean((image - reference)^2) over pixels and channels."""
    x, r = _pixels(image, reference, mask)
    return float(((x - r) ** 2).mean())


def rmse(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """sqrt(mse) [W m^-2 sr^-1]."""
    return float(np.sqrt(mse(image, reference, mask)))


def relative_rmse(
    image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None
) -> float:
    """||image - reference||_2 / ||reference||_2; over a black reference 0 or infinite."""
    x, r = _pixels(image, reference, mask)
    return _ratio(float(np.linalg.norm(x - r)), float(np.linalg.norm(r)))


def rel_mse(
    image: np.ndarray,
    reference: np.ndarray,
    mask: np.ndarray | None = None,
    epsilon: float = REL_MSE_EPSILON,
) -> float:
    """mean((image - reference)^2 / (reference^2 + epsilon)) over pixels and channels.

    Where the reference is 0 the image's square counts, over epsilon: light that leaks into
    the umbra is seen. Raises MetricError if epsilon is not above 0.

    >>> rel_mse(np.full((1, 1, 3), 0.5), np.zeros((1, 1, 3)), epsilon=0.25)
    1.0
    """
    if not epsilon > 0:
        raise MetricError(f"epsilon must be above 0, not {epsilon}: it keeps rel_mse finite")
    x, r = _pixels(image, reference, mask)
    return float(((x - r) ** 2 / (r**2 + epsilon)).mean())


def mae(image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None = None) -> float:
    """mean(|image - reference|) over pixels and channels [W m^-2 sr^-1]."""
    x, r = _pixels(image, reference, mask)
    return float(np.abs(x - r).mean())


def hdr_flip(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """HDR-FLIP error map, (H, W) in [0, 1]: what an eye sees at 67 pixels a degree.

    Andersson et al., "Visualizing errors in rendered high dynamic range images" (2021), by
    its authors' flip-evaluator. Negative radiance counts as black, as a screen shows it. The
    map belongs to the whole image: mask it afterwards, the filters need the neighbours.
    Raises MetricError.

    The exposures are the paper's, but of the median of the lit pixels where most are black,
    and one exposure of 0 stops where all are: there the library ends the Python process.
    """
    x, r = _checked(image, reference)
    import flip_evaluator  # slow to load, and only needed here

    start, stop = _flip_exposures(np.maximum(r, 0))
    arguments = [np.maximum(a, 0).astype(np.float32) for a in (r, x)]
    error, _, _ = flip_evaluator.evaluate(
        *arguments,
        "HDR",
        applyMagma=False,
        computeMeanError=False,
        parameters={"startExposure": start, "stopExposure": stop},
    )
    return np.asarray(error, dtype=np.float64)[..., 0]


def delta_e_2000(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """CIE Delta E 2000 of the two images as the lab displays them, (H, W). 1 is about the
    smallest difference that an eye tells, side by side.

    The lab writes min(max(radiance, 0), 1) * 255 without gamma, and a screen takes that file
    as sRGB: the clamped radiance *is* the sRGB value. It is compared before it is cut to 8
    bits, so that no small bias is hidden or made up. sRGB to XYZ to CIE L*a*b* (D65) by
    colour-science. Raises MetricError.
    """
    x, r = _checked(image, reference)
    import colour  # takes seconds to load

    lab = [colour.XYZ_to_Lab(colour.sRGB_to_XYZ(np.clip(a, 0, 1))) for a in (r, x)]
    return np.asarray(colour.delta_E(*lab, method="CIE 2000"), dtype=np.float64)


NUMBERS: Mapping[str, Callable[[np.ndarray, np.ndarray, np.ndarray | None], float]] = {
    "bias": bias,
    "relative_bias": relative_bias,
    "mse": mse,
    "rmse": rmse,
    "relative_rmse": relative_rmse,
    "rel_mse": rel_mse,
    "mae": mae,
}
"""The metrics that are a number at once."""

MAPS: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "flip": hdr_flip,
    "delta_e": delta_e_2000,
}
"""The metrics that are a map of the whole image first. Slow: about a second for 600x400."""


def measure(
    image: np.ndarray,
    reference: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    perceptual: bool = False,
) -> dict[str, float]:
    """Every metric by its name; "flip" and "delta_e", means of their maps, only if perceptual.

    Raises MetricError for arrays of other or different shapes, NaN or infinite values, or a
    mask that selects nothing.
    """
    mask = np.ones(np.shape(image)[:2], dtype=bool) if mask is None else mask
    return measure_regions(image, reference, {"": mask}, perceptual=perceptual)[""]


def measure_regions(
    image: np.ndarray,
    reference: np.ndarray,
    masks: Mapping[str, np.ndarray],
    *,
    perceptual: bool = False,
) -> dict[str, dict[str, float]]:
    """`measure` for each region of masks (as from compare.exact.regions), maps made once."""
    maps = {name: f(image, reference) for name, f in MAPS.items()} if perceptual else {}
    return {
        region: {name: f(image, reference, mask) for name, f in NUMBERS.items()}
        | {name: float(values[mask].mean()) for name, values in maps.items()}
        for region, mask in masks.items()
    }


def _checked(image: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, r = np.asarray(image, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    for name, a in (("image", x), ("reference", r)):
        if a.ndim != 3 or a.shape[-1] != 3 or a.size == 0:
            raise MetricError(f"the {name} has shape {a.shape}, not (height, width, 3)")
        if not np.isfinite(a).all():
            raise MetricError(f"the {name} holds NaN or infinite values")
    if x.shape != r.shape:
        raise MetricError(f"the image has shape {x.shape}, the reference {r.shape}")
    return x, r


def _pixels(
    image: np.ndarray, reference: np.ndarray, mask: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """The (pixels, 3) values that the mask selects."""
    x, r = _checked(image, reference)
    if mask is None:
        return x.reshape(-1, 3), r.reshape(-1, 3)
    if np.shape(mask) != x.shape[:2] or np.asarray(mask).dtype != bool:
        raise MetricError(f"the mask is not a bool array of shape {x.shape[:2]}")
    if not mask.any():
        raise MetricError("the mask selects no pixel")
    return x[mask], r[mask]


def _ratio(numerator: float, denominator: float) -> float:
    if denominator != 0:
        return numerator / denominator
    return 0.0 if numerator == 0 else float(np.copysign(np.inf, numerator))


def _flip_exposures(reference: np.ndarray) -> tuple[float, float]:
    """Where the reference's brightest and median luminance reach 0.85 after the ACES curve
    (HDR-FLIP paper, section 2.1) [stops]."""
    y = reference @ np.array([0.2126, 0.7152, 0.0722])
    lit = y[y > 0]
    if lit.size == 0:
        return 0.0, 0.0
    median = np.median(y) or np.median(lit)
    # ACES: (2.51 v^2 + 0.03 v) / (2.43 v^2 + 0.59 v + 0.14), v = 0.6 x, solved for 0.85
    a, b, c = 2.51 - 0.85 * 2.43, 0.03 - 0.85 * 0.59, -0.85 * 0.14
    x = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a) / 0.6
    start, stop = np.log2(x / lit.max()), np.log2(x / median)
    return float(start), float(max(start, stop))
