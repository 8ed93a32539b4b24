"""Circles in space as a receiver sees them: what every outline and every shadow's edge is made of.

n receivers at once, each at its own origin. A curve is X(phi) = P + Q cos(phi) + W sin(phi), with
its region on its left. docs/exact.md derives the integrals.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from penumbra.compare.exact.vectors import cross, dot, frame_towards, norm

EPS = float(np.finfo(np.float64).eps)
COINCIDE = 8 * EPS
"""Curves that are nowhere farther apart than this [rad] count as one."""


class Curve(ABC):
    """n circles."""

    p: np.ndarray
    """(n, 3), as q and w"""
    q: np.ndarray
    w: np.ndarray
    half: np.ndarray
    """(n,) the curve is phi from -half to half: pi, or an edge's half-angle"""

    def at(self, phi: np.ndarray) -> np.ndarray:
        """(n, k) -> (n, k, 3)"""
        cosine, sine = np.cos(phi)[..., None], np.sin(phi)[..., None]
        return self.p[:, None] + self.q[:, None] * cosine + self.w[:, None] * sine

    def param(self, x: np.ndarray) -> np.ndarray:
        """phi of points on the curve: (n, k, 3) -> (n, k)"""
        y = x - self.p[:, None]
        return np.arctan2(dot(y, self.w[:, None]), dot(y, self.q[:, None]))

    @abstractmethod
    def side(self, x: np.ndarray) -> np.ndarray:
        """> 0 where directions (n, k, 3) are in the region, about the angle to its edge [rad]"""

    @abstractmethod
    def integral(self, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """1/2 n . integral of r x dr from phi = low to high, (n, k)"""

    @abstractmethod
    def length(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(n, k) at least the length of r from low to high [rad]"""

    @abstractmethod
    def shift(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(n, k) at least the integral of |dr| / |X|: how much the projected solid angle changes
        with the places that the curve comes from [m^-1]"""


class Great(Curve):
    """The directions on a plane through the receiver; the region is where pole . r > 0."""

    def __init__(
        self,
        pole: np.ndarray,
        towards: np.ndarray,
        distance: np.ndarray,
        half: np.ndarray | None = None,
        moment: np.ndarray | None = None,
    ) -> None:
        """distance: (n,) of the line in space that is seen as the circle, inf for the horizon.
        moment: the integral's pole, where corners tell it otherwise than crossings need."""
        self.pole = pole
        self.moment = pole if moment is None else moment
        self.p = np.zeros_like(pole)
        self.q, self.w = frame_towards(pole, towards)
        self.half = np.full(len(pole), np.pi) if half is None else half
        self.distance = distance

    def param(self, x: np.ndarray) -> np.ndarray:
        return np.arctan2(dot(x, self.w[:, None]), dot(x, self.q[:, None]))

    def side(self, x: np.ndarray) -> np.ndarray:
        return dot(self.pole[:, None], x) / norm(x)

    def integral(self, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.asarray(0.5 * (high - low) * dot(self.moment, normal)[:, None])

    def length(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return high - low

    def shift(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.asarray((high - low) / self.distance[:, None])


class Cap(Curve):
    """The outline of a ball seen from outside it; the region is its cone of directions."""

    def __init__(
        self, centre: np.ndarray, radius: np.ndarray, towards: np.ndarray, on_light: bool = False
    ) -> None:
        """on_light: the outline of a sphere light."""
        self.centre, self.radius, self.on_light = centre, radius, on_light
        distance = norm(centre)
        self.tangent = np.sqrt(np.maximum((distance - radius) * (distance + radius), 0))
        self.distance = distance
        self.axis = centre / distance[:, None]
        self.sine, self.cosine = radius / distance, self.tangent / distance
        self.b1, self.b2 = frame_towards(self.axis, towards)
        self.p = self.cosine[:, None] * self.axis
        self.q, self.w = self.sine[:, None] * self.b1, self.sine[:, None] * self.b2
        self.half = np.full(len(radius), np.pi)
        near = np.maximum(self.tangent, EPS * distance) * distance
        self.shift_length = (self.tangent + radius) / near

    def param(self, x: np.ndarray) -> np.ndarray:
        return np.arctan2(dot(x, self.b2[:, None]), dot(x, self.b1[:, None]))

    def side(self, x: np.ndarray) -> np.ndarray:
        """sin(alpha - theta) = (R x.O - tau |x cross O|) / (|x| D^2): neither small cones nor
        those of almost 90 degrees lose digits, and the one behind the receiver is not in it."""
        axis = self.axis[:, None]
        across = self.cosine[:, None] * norm(cross(x, axis))
        return np.asarray((self.sine[:, None] * dot(x, axis) - across) / norm(x))

    def form(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The cone's equation as a bilinear form, of unit size: (x.a)(y.a) - cos^2 alpha x.y, for
        narrow cones sin^2 alpha x.y - (x cross a).(y cross a), (n,)."""
        narrow = self.sine**2 * dot(x, y) - dot(cross(x, self.axis), cross(y, self.axis))
        wide = dot(x, self.axis) * dot(y, self.axis) - self.cosine**2 * dot(x, y)
        return np.where(self.sine < 0.7, narrow, wide)

    def integral(self, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        along, n1, n2 = (dot(normal, v)[:, None] for v in (self.axis, self.b1, self.b2))
        mean, arc = 0.5 * (low + high), high - low
        # (sin phi1 - sin phi0, cos phi0 - cos phi1) = 2 sin(arc / 2) (cos mean, sin mean)
        chord = 2 * np.sin(0.5 * arc) * (np.cos(mean) * n1 + np.sin(mean) * n2)
        sine, cosine = self.sine[:, None], self.cosine[:, None]
        return np.asarray(0.5 * sine * (sine * along * arc - cosine * chord))

    def length(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.asarray(self.sine[:, None] * (high - low))

    def shift(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.asarray(self.shift_length[:, None] * self.length(low, high))


class Rim(Curve):
    """A circle in a plane before the receiver, counterclockwise about the plane's normal m, which
    points away; the region is the cone over the disc. phi = 0 is the place nearest to the receiver,
    the only one about which digits could get lost.

    Rims of one light lie on its surface: in a flat light's plane or on a sphere light's front.
    """

    def __init__(self, centre: np.ndarray, normal: np.ndarray, radius: np.ndarray, flat: bool):
        self.p, self.normal, self.radius, self.flat = centre, normal, radius, flat
        self.height = np.maximum(dot(centre, normal), 0)
        foot = self.height[:, None] * normal - centre
        foot -= dot(foot, normal)[:, None] * normal
        self.u, self.v = frame_towards(normal, foot)
        # The frame's direction is arbitrary only where the foot is as good as the centre.
        self.aside = np.maximum(dot(foot, self.u), 0)
        a, h2, aside = radius, self.height**2, self.aside
        self.q, self.w = a[:, None] * self.u, a[:, None] * self.v
        self.half = np.full(len(radius), np.pi)
        self.near = h2 + (aside - a) ** 2
        self.apart = np.sqrt(self.near * (h2 + (aside + a) ** 2))  # w in docs/exact.md
        self.apart = np.maximum(self.apart, np.finfo(float).tiny)
        square = h2 + aside**2 + a**2
        self.square, self.twice = square, 2 * a * aside
        self.k = self.twice / (square + self.apart)
        self.rest = (self.near + self.apart) / (square + self.apart)  # 1 - k
        g = (a - aside) * (a + aside) - h2
        self.g = g / self.apart
        with np.errstate(divide="ignore", invalid="ignore"):
            small = 4 * a**2 * h2 / (self.apart * (self.apart - g))
        self.one_g = np.where(g >= 0, 1 + self.g, small)

    def __getitem__(self, which: np.ndarray) -> Rim:
        return Rim(self.p[which], self.normal[which], self.radius[which], self.flat)

    def side(self, x: np.ndarray) -> np.ndarray:
        along = dot(x, self.normal[:, None])
        off = self.height[:, None, None] * x - self.p[:, None] * along[..., None]
        size = (norm(self.p) + self.radius)[:, None] * norm(x)
        return np.asarray((self.radius[:, None] * along - norm(off)) / size)

    def integral(self, normal: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        k, rest, twice = self.k[:, None], self.rest[:, None], self.twice[:, None]
        half, mean, arc = 0.5 * (high - low), 0.5 * (high + low), high - low
        s0, s1 = np.sin(0.5 * low), np.sin(0.5 * high)
        sine, chord = np.sin(half), np.sin(mean) * np.sin(half)
        across = (rest + 2 * k * s0 * s0) * (rest + 2 * k * s1 * s1)
        across += k * k * np.sin(low) * np.sin(high)
        lean = 2 * sine * (rest * np.cos(half) - 2 * s0 * s1)
        turned = np.arctan2(k * lean, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            turned_k = np.where(k > 1e-150, turned / k, 2 * np.cos(mean) * sine)
            before = self.near[:, None] + 2 * twice * s0 * s0
            after = self.near[:, None] + 2 * twice * s1 * s1
            rise = 2 * chord / before
            growth = twice * rise
            log = np.where(
                np.abs(growth) < 0.5, np.log1p(np.maximum(growth, -0.5)), np.log(after / before)
            )
            log = np.where(np.abs(growth) < 1e-150, rise, log / twice)
        h = self.height[:, None]
        tilt = h * (self.radius / self.apart)[:, None]
        n_m, n_u, n_v = (dot(normal, e)[:, None] for e in (self.normal, self.u, self.v))
        total = n_m * (0.5 * self.one_g[:, None] * arc + self.g[:, None] * turned)
        total -= n_u * tilt * ((1 + k * k) * turned_k + k * arc)
        total -= n_v * h * self.radius[:, None] * log
        return np.asarray(0.5 * total)

    def whole(self, normal: np.ndarray) -> np.ndarray:
        """The integral all around, (n,)."""
        tilt = self.height * self.radius / self.apart
        level = dot(normal, self.normal) * self.one_g
        return np.asarray(0.5 * np.pi * (level - 2 * self.k * tilt * dot(normal, self.u)))

    def length(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        near = np.sqrt(np.maximum(self.near, np.finfo(float).tiny))
        return np.asarray(np.minimum(2 * np.pi, (self.radius / near)[:, None] * (high - low)))

    def shift(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        # |dr| / |X| <= a dphi / |X|^2, whose integral around the rim is 2 pi a / w
        near = np.maximum(self.near, np.finfo(float).tiny)
        around = np.minimum(2 * np.pi / self.apart[:, None], (high - low) / near[:, None])
        return np.asarray(self.radius[:, None] * around)


# ------------------------------------------------------------------------ one curve along another


@dataclass(frozen=True)
class Side:
    """Where along n curves a region is: changes by `sign` at phi, from `start` at phi = -pi."""

    phi: np.ndarray
    """(n, k)"""
    sign: np.ndarray
    """(n, k) 1 into the region, -1 out of it, 0 no crossing"""
    start: np.ndarray
    """(n,) 1 in the region, 0 outside"""

    def inside(self, phi: np.ndarray) -> np.ndarray:
        """(n, m) -> (n, m) bool"""
        passed = phi[:, :, None] > self.phi[:, None]
        return np.asarray(self.start[:, None] + (passed * self.sign[:, None]).sum(axis=2) > 0)

    @property
    def opposite(self) -> Side:
        return Side(self.phi, -self.sign, 1 - self.start)

    @staticmethod
    def everywhere(n: int, inside: bool) -> Side:
        none = np.zeros((n, 0))
        return Side(none, none, np.full(n, int(inside)))

    @staticmethod
    def settled(
        phi: np.ndarray, sign: np.ndarray, value: Callable[[np.ndarray], np.ndarray]
    ) -> Side:
        """The start from the middle of the longest part without a crossing, where `value` of
        phi (n, 1) > 0 tells."""
        phi = np.where(sign == 0, -np.pi, phi)
        if phi.shape[1] == 0:
            return Side(phi, sign, (value(np.zeros((len(phi), 1)))[:, 0] > 0).astype(int))
        order = np.sort(phi, axis=1)
        gap = np.diff(order, axis=1, append=order[:, :1] + 2 * np.pi)
        longest = gap.argmax(axis=1)[:, None]
        middle = np.take_along_axis(order, longest, 1) + 0.5 * np.take_along_axis(gap, longest, 1)
        middle = np.where(middle > np.pi, middle - 2 * np.pi, middle)
        passed = ((middle > phi) * sign).sum(axis=1)
        return Side(phi, sign, ((value(middle)[:, 0] > 0) - passed).astype(int))


def sides(one: Curve, two: Curve) -> tuple[Side, Side]:
    """Where `two`'s region is along `one`, and `one`'s along `two`. Every crossing is found on
    one of them and carried over to the other: whatever rounding does the pieces that are
    left make closed outlines."""
    if isinstance(one, Cap) and isinstance(two, Cap):
        return _two_caps(one, two)
    finders = (Great, Cap, Rim)
    if finders.index(type(one)) < finders.index(type(two)):
        second, first = sides(two, one)
        return first, second
    along_one, along_two = _values(one, two), _values(two, one)
    if isinstance(two, Great):
        if isinstance(one, Great):
            phi, sign = _two_greats(one, two)
        else:
            pole = two.pole
            phi, sign = linear_roots(dot(pole, one.p), dot(pole, one.q), dot(pole, one.w))
    elif isinstance(two, Rim):
        assert isinstance(one, Rim)
        phi, sign = linear_roots(*_level(one, two))
    else:
        assert isinstance(one, Rim) and isinstance(two, Cap)
        phi, sign = _rim_and_cap(one, two)
    first = Side.settled(phi, sign, along_one)
    second = Side.settled(two.param(one.at(phi)), -sign, along_two)
    return _apart(first, second, along_one, along_two)


def _values(curve: Curve, other: Curve) -> Callable[[np.ndarray], np.ndarray]:
    """Of phi on `curve`: positive in `other`'s region."""
    if isinstance(curve, Rim) and isinstance(other, Rim):
        k, q, w = (x[:, None] for x in _level(curve, other))
        scale = np.maximum(np.abs(k) + np.hypot(q, w), 1e-300)
        return lambda phi: (k + q * np.cos(phi) + w * np.sin(phi)) / scale
    return lambda phi: other.side(curve.at(phi))


def _apart(
    first: Side,
    second: Side,
    along_one: Callable[[np.ndarray], np.ndarray],
    along_two: Callable[[np.ndarray], np.ndarray],
) -> tuple[Side, Side]:
    """Where there is no crossing, the place that is farthest from the other curve tells; of two
    curves that coincide the first one is in the second's region and not the other way round."""
    none = ~first.sign.any(axis=1)
    if not none.any():
        return first, second
    places = np.tile([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi], (len(none), 1))
    starts = []
    clear = np.zeros(len(none), dtype=bool)
    for along in (along_one, along_two):
        value = along(places)
        farthest = np.take_along_axis(value, np.abs(value).argmax(axis=1)[:, None], 1)[:, 0]
        clear |= np.abs(farthest) > COINCIDE
        starts.append((farthest > 0).astype(int))
    one = np.where(clear, starts[0], 1)
    two = np.where(clear, starts[1], 0)
    return (
        Side(first.phi, first.sign, np.where(none, one, first.start)),
        Side(second.phi, second.sign, np.where(none, two, second.start)),
    )


def linear_roots(k: np.ndarray, q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where k + q cos(phi) + w sin(phi) becomes positive and where negative: phi and sign, (n, 2)
    in [-pi, pi]."""
    size = np.hypot(q, w)
    root = np.sqrt(np.maximum((size - k) * (size + k), 0))
    middle, half = np.arctan2(w, q), np.arctan2(root, -k)
    phi = np.stack([middle - half, middle + half], axis=1)
    phi = np.where(phi > np.pi, phi - 2 * np.pi, np.where(phi < -np.pi, phi + 2 * np.pi, phi))
    return phi, np.where((root > 0)[:, None], [1, -1], 0)


def _two_greats(one: Great, two: Great) -> tuple[np.ndarray, np.ndarray]:
    axis = cross(one.pole, two.pole)
    phi = one.param(np.stack([-axis, axis], axis=1))
    return phi, np.where((norm(axis) > COINCIDE)[:, None], [1, -1], 0)


def _level(rim: Rim, other: Rim) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """k, q, w with k + q cos(phi) + w sin(phi) > 0 where `rim` is in the other's disc, or on the
    near side of its plane: both are on one surface, so that no cone is needed."""
    if rim.flat:
        apart = other.p - rim.p
        distance = norm(apart)
        k = (other.radius - distance) * (other.radius + distance) - rim.radius**2
        return k, 2 * dot(apart, rim.q), 2 * dot(apart, rim.w)
    m = other.normal
    return dot(m, other.p - rim.p), -dot(m, rim.q), -dot(m, rim.w)


def _two_caps(one: Cap, two: Cap) -> tuple[Side, Side]:
    """The half-width of what one circle loses to the other is an angle of the spherical triangle
    of both half-angles and the angle between the axes; from the half-angle formula it keeps its
    digits in small triangles, and is 0 or pi where there is no triangle."""
    normal = cross(one.axis, two.axis)
    apart = np.arctan2(norm(normal), dot(one.axis, two.axis))
    a, b = np.arctan2(one.sine, one.cosine), np.arctan2(two.sine, two.cosine)
    s = 0.5 * (apart + a + b)
    sin_s, sin_apart, sin_a, sin_b = (
        np.sin(np.maximum(x, 0)) for x in (s, s - apart, s - a, s - b)
    )
    within_two = apart + a <= b + COINCIDE
    within_one = (apart + b <= a + COINCIDE) & ~within_two
    result = []
    for cap, other, sin_cap, sin_other, inside, around in (
        (one, two, sin_a, sin_b, within_two, within_one),
        (two, one, sin_b, sin_a, within_one, within_two),
    ):
        half = 2 * np.arctan2(np.sqrt(sin_apart * sin_cap), np.sqrt(sin_s * sin_other))
        half = np.where(inside, np.pi, np.where(around, 0, half))
        middle = np.arctan2(dot(other.axis, cap.b2), dot(other.axis, cap.b1))
        phi = np.stack([middle - half, middle + half], axis=1)
        phi = np.where(phi > np.pi, phi - 2 * np.pi, np.where(phi < -np.pi, phi + 2 * np.pi, phi))
        crosses = (half > 0) & (half < np.pi)
        start = np.where(crosses, np.pi - np.abs(middle) < half, half > 0).astype(int)
        result.append(Side(phi, np.where(crosses[:, None], [1, -1], 0), start))
    return result[0], result[1]


def _rim_and_cap(rim: Rim, cap: Cap) -> tuple[np.ndarray, np.ndarray]:
    """Along a rim the cone's equation is a trigonometric polynomial of degree 2. It cuts the
    circle at its extrema into at most one root each; the roots are those of cap.side, which knows
    the nappe and keeps its digits."""
    places = np.sort(_extrema(*_coefficients(rim, cap)), axis=1)
    places = np.concatenate([places, places[:, :1] + 2 * np.pi], axis=1)
    value = cap.side(rim.at(places[:, :-1]))
    value = np.where(np.abs(value) <= EPS, 0, value)
    value = np.concatenate([value, value[:, :1]], axis=1)
    changes = (value[:, 1:] > 0) != (value[:, :-1] > 0)
    row, piece = np.nonzero(changes)
    n, most = len(places), int(changes.sum(axis=1).max(initial=0))
    phi, sign = np.full((n, most), -np.pi), np.zeros((n, most))
    if len(row):
        p, q, w = rim.p[row], rim.q[row], rim.w[row]
        axis, sine, cosine = cap.axis[row], cap.sine[row], cap.cosine[row]

        def side(t: np.ndarray) -> np.ndarray:
            x = p + np.cos(t)[:, None] * q + np.sin(t)[:, None] * w
            return np.asarray((sine * dot(x, axis) - cosine * norm(cross(x, axis))) / norm(x))

        root = bracketed(side, places[row, piece], places[row, piece + 1])
        slot = (np.cumsum(changes, axis=1) - 1)[row, piece]
        phi[row, slot] = np.where(root > np.pi, root - 2 * np.pi, root)
        sign[row, slot] = np.where(value[row, piece + 1] > 0, 1, -1)
    return phi, sign


def _coefficients(rim: Rim, cap: Cap) -> tuple[np.ndarray, ...]:
    """a + b1 cos + b2 sin + c1 cos 2 phi + c2 sin 2 phi: the cone's form along the rim."""
    p, q, w = rim.p, rim.q, rim.w
    qq, ww = cap.form(q, q), cap.form(w, w)
    return (
        cap.form(p, p) + 0.5 * (qq + ww),
        2 * cap.form(p, q),
        2 * cap.form(p, w),
        0.5 * (qq - ww),
        cap.form(q, w),
    )


def _extrema(
    a: np.ndarray, b1: np.ndarray, b2: np.ndarray, c1: np.ndarray, c2: np.ndarray
) -> np.ndarray:
    """(n, 10) phi in [-pi, pi], among them all extrema of a + b1 cos + ... (n,) each.

    On each half circle phi = phi0 + 2 atan(t), t in [-1, 1], times (1 + t^2)^2 it is a quartic p.
    The roots of p'' in closed form bracket those of p', and these are the extrema of p.
    """
    places = []
    for start, s in ((0.0, 1.0), (np.pi, -1.0)):
        d0, d1 = 2 * s * b2 + 4 * c2, 2 * (2 * a - 6 * c1)
        d2, d3 = 3 * (2 * s * b2 - 4 * c2), 4 * (a - s * b1 + c1)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(np.maximum(d2 * d2 - 3 * d1 * d3, 0))
            q = -(d2 + np.copysign(root, d2))
            cuts = np.stack([q / (3 * d3), d1 / q], axis=1)
        cuts = np.sort(np.clip(np.nan_to_num(cuts, nan=1.0), -1, 1), axis=1)
        ends = np.full((len(a), 1), 1.0)
        cuts = np.concatenate([-ends, cuts, ends], axis=1)
        low, high = cuts[:, :-1], cuts[:, 1:]
        d = [x[:, None] for x in (d0, d1, d2, d3)]
        rising = _cubic(d, low) <= 0
        for _ in range(40):
            t = 0.5 * (low + high)
            below = (_cubic(d, t) <= 0) == rising
            low, high = np.where(below, t, low), np.where(below, high, t)
        t = np.concatenate([cuts[:, :1], 0.5 * (low + high), ends], axis=1)
        places.append(start + 2 * np.arctan(t))
    phi = np.concatenate(places, axis=1)
    return np.where(phi > np.pi, phi - 2 * np.pi, phi)


def _cubic(d: list[np.ndarray], t: np.ndarray) -> np.ndarray:
    return np.asarray(d[0] + t * (d[1] + t * (d[2] + t * d[3])))


def bracketed(
    function: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """One root of each of n functions between low and high, where they change sign: inverse
    quadratic interpolation or halving (Chandrupatla, Advances in Engineering Software 28, 1997)."""
    a, b = high.copy(), low.copy()
    fa, fb = function(a), function(b)
    c, fc = a, fa
    t = np.full(len(a), 0.5)
    for _ in range(100):
        x = a + t * (b - a)
        f = function(x)
        same = np.sign(f) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = x, f
        best = np.where(np.abs(fa) < np.abs(fb), a, b)
        width = np.abs(b - a)
        limit = EPS * np.maximum(np.abs(best), 1e-300) + 1e-300
        done = (width <= 2 * limit) | (fa == 0)
        if done.all():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            xi, shape = (a - b) / (c - b), (fa - fb) / (fc - fb)
            inverse = fa / (fb - fa) * fc / (fb - fc)
            inverse += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
            fits = (shape**2 < xi) & ((1 - shape) ** 2 < 1 - xi) & np.isfinite(inverse)
            least = np.minimum(limit / width, 0.5)
        t = np.clip(np.where(fits, inverse, 0.5), least, 1 - least)
        t = np.where(done, 0, t)
    return best
