"""The outline of what n receivers see of a light, walked around by Stokes' theorem.

The visible part is what all windows leave (the light's own outline, horizon, planes, a ball around
the receiver) without the shadows. Each region's boundary is made of curves; of each curve
counts what every other region leaves of it. docs/exact.md derives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from penumbra.compare.exact.curves import EPS, Cap, Curve, Great, Rim, Side, linear_roots, sides
from penumbra.compare.exact.vectors import dot, unit

ROUNDING = 16 * EPS
"""Bound on the rounding error per radian of outline; to each piece that ends where curves cross
EPS are added. Over ten times the largest error that was measured (docs/exact.md)."""
BLUR = 2 * EPS
"""Coordinates count as known to this, relatively: what rounding the receiver's own and the
differences from it may shift an outline by."""


class Test(Protocol):
    """Where along a curve a region is."""

    @property
    def phi(self) -> np.ndarray:
        """(n, k) where that may change"""

    def inside(self, phi: np.ndarray) -> np.ndarray:
        """(n, m) -> (n, m) bool"""


@dataclass(frozen=True)
class _Choice:
    """`one` where `which`, else `two`."""

    which: Side
    one: Side
    two: Side

    @property
    def phi(self) -> np.ndarray:
        return np.concatenate([self.which.phi, self.one.phi, self.two.phi], axis=1)

    def inside(self, phi: np.ndarray) -> np.ndarray:
        return np.where(self.which.inside(phi), self.one.inside(phi), self.two.inside(phi))


class Crossings:
    """Which curve's region is where along which other curve: each pair is looked at once."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, int], Side] = {}

    def know(self, along: Curve, region: Curve, side: Side) -> None:
        self._known[id(along), id(region)] = side

    def side(self, along: Curve, region: Curve) -> Side:
        if (id(along), id(region)) not in self._known:
            one, two = sides(along, region)
            self.know(along, region, one)
            self.know(region, along, two)
        return self._known[id(along), id(region)]


class Region(Protocol):
    """Directions bounded by curves."""

    def pieces(self, crossings: Crossings) -> Sequence[tuple[Curve, Side | None]]:
        """The curves, and where along them they are the boundary (None: all along)."""

    def along(self, curve: Curve, crossings: Crossings) -> Test:
        """Where another region's curve is in this one."""


@dataclass(frozen=True)
class Within:
    """The region of one curve."""

    curve: Curve

    def pieces(self, crossings: Crossings) -> Sequence[tuple[Curve, Side | None]]:
        return [(self.curve, None)]

    def along(self, curve: Curve, crossings: Crossings) -> Test:
        if isinstance(self.curve, Cap) and self.curve.on_light and isinstance(curve, Rim):
            return Side.everywhere(len(curve.p), True)  # which it only touches, from within
        return crossings.side(curve, self.curve)


class Cut:
    """What of a surface a ball hides that the surface cuts: the part in the ball, seen as a disc,
    and where the surface is beyond the ball's outline the ball's whole cone.

    `shown`: instead the part of a sphere light on this side of a plane; `cap` is then the
    light's outline, which is a window of its own.
    """

    def __init__(self, cap: Cap, rim: Rim, shown: bool, towards: np.ndarray) -> None:
        self.cap, self.rim, self.shown = cap, rim, shown
        tangent2 = cap.tangent**2
        m, h = rim.normal, rim.height
        pole = h[:, None] * cap.centre - tangent2[:, None] * m
        self.beyond = Great(unit(pole), towards, np.full(len(h), np.inf))
        # |X| < tau on the rim, where X is on the ball: X . O < tau^2
        k = tangent2 - dot(cap.centre, rim.p)
        phi, sign = linear_roots(k, -dot(cap.centre, rim.q), -dot(cap.centre, rim.w))
        x = rim.at(phi)
        self.near = Side.settled(
            phi, sign, lambda t: tangent2[:, None] - dot(cap.centre[:, None], rim.at(t))
        )
        crosses = sign.any(axis=1)
        far = Side.settled(cap.param(x), -sign, lambda t: self.beyond.side(cap.at(t)))
        start = np.where(crosses, far.start, 1 - self.near.start)
        self.far = Side(far.phi, far.sign, start)

    def pieces(self, crossings: Crossings) -> Sequence[tuple[Curve, Side | None]]:
        rim = (self.rim, self.near)
        return [rim] if self.shown else [(self.cap, self.far), rim]

    def along(self, curve: Curve, crossings: Crossings) -> Test:
        n = len(curve.p)
        if curve is self.cap:
            return self.far
        cap = Side.everywhere(n, True) if self.shown else crossings.side(curve, self.cap)
        if isinstance(curve, Cap) and curve.on_light:
            disc = Side.everywhere(n, False)  # the light's outline only touches rims on the light
        else:
            disc = crossings.side(curve, self.rim)
        return _Choice(crossings.side(curve, self.beyond), cap, disc)


@dataclass(frozen=True)
class Part:
    """What is visible, of n receivers."""

    value: np.ndarray
    """(n,) projected solid angle [sr]"""
    error: np.ndarray
    """(n,) bound on its error"""
    length: np.ndarray
    """(n,) of its outline [rad]"""
    lost: np.ndarray
    """(n,) what is lost of the light's outline plus what is added to it [rad]"""


def visible_part(
    normal: np.ndarray,
    blur: np.ndarray,
    outline: Sequence[Within],
    windows: Sequence[Region],
    shadows: Sequence[Region],
) -> Part:
    """normal: (n, 3). blur: (n,) how far places may be off [m]. outline: the light's, one closed
    curve or a polygon's edges, which know their own ends."""
    n = len(normal)
    value, error, length, lost = (np.zeros(n) for _ in range(4))
    crossings = Crossings()
    regions: list[tuple[Region, bool]] = [(r, True) for r in [*outline, *windows]]
    regions += [(r, False) for r in shadows]
    for region, shows in regions:
        own = region in outline
        for curve, boundary in region.pieces(crossings):
            tests: list[tuple[Test, bool]] = [] if boundary is None else [(boundary, True)]
            for other, other_shows in regions:
                if other is not region and not (own and other in outline):
                    tests.append((other.along(curve, crossings), other_shows))
            low, high = -curve.half[:, None], curve.half[:, None]
            breaks = np.concatenate([low, high, *(test.phi for test, _ in tests)], axis=1)
            breaks = np.sort(np.clip(breaks, low, high), axis=1)
            before, after = breaks[:, :-1], breaks[:, 1:]
            middle = 0.5 * (before + after)
            kept = after > before
            for test, wanted in tests:
                kept &= test.inside(middle) == wanted
            arcs = np.where(kept, curve.integral(normal, before, after), 0)
            value += arcs.sum(axis=1) if shows else -arcs.sum(axis=1)
            piece = np.where(kept, curve.length(before, after), 0)
            total = piece.sum(axis=1)
            length += total
            if own:
                whole = curve.length(before, after)
                lost += np.where(kept, 0, whole).sum(axis=1)
            else:
                lost += total
            ends = (kept & ~(after - before >= 2 * curve.half[:, None])).sum(axis=1)
            error += ROUNDING * total + EPS * ends
            error += blur * np.where(kept, curve.shift(before, after), 0).sum(axis=1)
    return Part(value, error, length, lost)
