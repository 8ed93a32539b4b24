"""How much noise images have, by what differs between two that only their seeds tell apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from penumbra.compare.measure.image import Image

STEPS = 4.0
"""Noise counts if its square is this many times that of a file's rounding, as for slopes"""


class NoiseError(ValueError):
    """Images whose noise cannot be measured; the text says why."""


def noise_of_pairs(series: Sequence[Sequence[Image]]) -> tuple[np.ndarray, float]:
    """(n, K // 2) mean squared noise [(W m^-2 sr^-1)^2] of n settings' K images each, and how much
    of it the files' rounding may account for.

    Two images x, y of one expectation and independent noise have E[(x - y)^2] = 2 variance, so
    (x - y)^2 / 2 of images 1 and 2, 3 and 4, ... are independent measurements of it that no bias
    enters. Pixels that are clipped in any image are left out with their neighbours, whose noise may
    be cut too; the rounding of values by steps 2h adds h^2 / 3.
    Raises NoiseError for fewer than two images or other numbers of them, other sizes, NaN, and if
    all pixels are clipped.
    """
    if len({len(images) for images in series}) != 1 or len(series[0]) < 2:
        raise NoiseError(
            "of each number of light samples as many images are needed, and two or more"
        )
    every = [image for images in series for image in images]
    if len({image.shape for image in every}) != 1:
        sizes = sorted({f"{image.shape[1]} x {image.shape[0]}" for image in every})
        raise NoiseError(f"the images are of several sizes: {', '.join(sizes)}")
    if not all(np.isfinite(image.radiance).all() for image in every):
        raise NoiseError("an image holds NaN or infinite values")
    cut = np.zeros(every[0].shape, dtype=bool)
    for image in every:
        if image.clipped:
            cut |= (image.radiance >= 1 - np.expand_dims(image.rounding, -1)).any(axis=-1)
    kept = ~ndimage.binary_dilation(cut, np.ones((3, 3)))
    if not kept.any():
        raise NoiseError("every pixel is clipped: the pictures are too bright")
    rounding = max(float(np.mean(np.asarray(image.rounding) ** 2)) / 3 for image in every)
    squares = [
        [
            float(np.mean((one.radiance - other.radiance)[kept] ** 2)) / 2
            for one, other in zip(images[::2], images[1::2], strict=False)
        ]
        for images in series
    ]
    return np.array(squares), rounding
