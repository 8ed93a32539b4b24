"""Arrays of 3-vectors along the last axis."""

from __future__ import annotations

import numpy as np


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross, several times as fast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def norm(v: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(dot(v, v)))


def unit(v: np.ndarray) -> np.ndarray:
    """Zero stays zero."""
    length = norm(v)[..., None]
    return np.asarray(v / np.where(length > 0, length, 1))


def frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """b1, b2 with (axis, b1, b2) right-handed and orthonormal (Duff et al., Building an
    Orthonormal Basis, Revisited, JCGT 6(1), 2017)."""
    x, y, z = np.moveaxis(axis, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    b1 = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    b2 = np.stack([b, sign + y * y * a, -y], axis=-1)
    return b1, b2


def frame_towards(axis: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As frame, b1 on the side of `direction` where that is not the axis itself."""
    across = direction - dot(direction, axis)[..., None] * axis
    clear = norm(across) > 1e-6 * norm(direction)
    b1 = unit(np.where(clear[..., None], across, frame(axis)[0]))
    b1 = unit(b1 - dot(b1, axis)[..., None] * axis)
    return b1, cross(axis, b1)
