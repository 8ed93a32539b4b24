"""A light's irradiance to 25 digits, from the definition: the witness of closed forms.

All curves that may bound what is seen (edges, the horizon, silhouettes, rings) are circles in
space. Each is cut where it meets any other one; a piece counts if the light is seen on just one
side of it, by shadow rays; and the pieces' integrals (Stokes) are taken numerically. No interval
is subtracted from any other, and no integral is known in advance.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from mpmath import mp, mpf

DIGITS = 40
BESIDE = mpf(10) ** -19
"""From a curve to the rays on either side of it, in sizes of the light."""

Vector = tuple[Any, Any, Any]


def vector(values: Any) -> Vector:
    x, y, z = (v if isinstance(v, mpf) else mpf(float(v)) for v in values)
    return x, y, z


def dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def along(a: Vector, b: Vector, t: Any) -> Vector:
    """a + t b"""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


def times(a: Vector, t: Any) -> Vector:
    return a[0] * t, a[1] * t, a[2] * t


def unit(a: Vector) -> Vector:
    return times(a, 1 / mp.sqrt(dot(a, a)))


def across(axis: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors, right-handed with the axis, of no particular direction."""
    u = unit(cross(axis, (mpf("0.3"), mpf("-0.7"), mpf("0.55"))))
    return u, cross(unit(axis), u)


@dataclass(frozen=True)
class Circle:
    """center + radius (cos u + sin v), and the quadratic form that is 0 on its cone."""

    center: Vector
    u: Vector
    v: Vector
    radius: Any

    def at(self, angle: Any) -> Vector:
        x = along(self.center, self.u, self.radius * mp.cos(angle))
        return along(x, self.v, self.radius * mp.sin(angle))

    def slope(self, angle: Any) -> Vector:
        x = times(self.u, -self.radius * mp.sin(angle))
        return along(x, self.v, self.radius * mp.cos(angle))

    def form(self, x: Vector) -> Any:
        axis = cross(self.u, self.v)
        height, ahead = dot(axis, self.center), dot(axis, x)
        if height == 0 and dot(self.center, self.center) == 0:
            return ahead
        rest = dot(self.center, self.center) - self.radius**2
        return (
            height**2 * dot(x, x) - 2 * height * ahead * dot(x, self.center) + rest * ahead**2
        ) / (dot(self.center, self.center) + self.radius**2) ** 2


def great(pole: Vector) -> Circle:
    pole = unit(pole)
    return Circle((mpf(0),) * 3, *across(pole), mpf(1))


def silhouette(center: Vector, radius: Any) -> Circle:
    squared = dot(center, center)
    tangent = squared - radius**2
    if tangent == 0:
        return great(center)
    return Circle(
        times(center, tangent / squared), *across(center), radius * mp.sqrt(tangent / squared)
    )


def ring(center: Vector, radius: Any, normal: Vector, offset: Any) -> list[Circle]:
    """Where a sphere meets the plane normal . x = offset, if it does."""
    away = offset - dot(normal, center)
    squared = radius**2 - away**2 / dot(normal, normal)
    if squared <= 0:
        return []
    middle = along(center, normal, away / dot(normal, normal))
    return [Circle(middle, *across(normal), mp.sqrt(squared))]


@dataclass(frozen=True)
class Ball:
    center: Vector
    radius: Any
    own: bool
    within: bool
    """The point is inside."""


class View:
    """All that matters, from the point.

    light: {"corners": (k, 3)} counterclockwise about the normal, which points away from what is
    lit, or {"center", "normal", "radius"}, or {"center", "radius"}; balls: (centre, radius);
    planes: (point, normal); own: the object's number, balls first.
    """

    def __init__(
        self, light: dict[str, Any], point: Any, normal: Any, balls: Any, planes: Any, own: int
    ) -> None:
        origin = vector(point)
        self.normal = vector(normal)

        def seen(place: Any) -> Vector:
            return along(vector(place), origin, -1)

        self.balls = []
        for k, (center, radius) in enumerate(balls):
            c, r = seen(center), mpf(float(radius))
            inside = dot(self.normal, c) > 0 if k == own else dot(c, c) < r**2
            self.balls.append(Ball(c, r, k == own, inside))
        self.planes = [
            (vector(n), dot(vector(n), seen(p)))
            for k, (p, n) in enumerate(planes)
            if len(balls) + k != own
        ]
        self.corners: list[Vector] = []
        if "corners" in light:
            # the edges are what the scene knows, and not the corners
            self.corners = [seen(c) for c in light["corners"]]
            self.m = unit(cross(*(along(self.corners[k], self.corners[0], -1) for k in (1, -1))))
            self.size = mp.sqrt(dot(*[along(self.corners[1], self.corners[0], -1)] * 2))
            self.h = dot(self.m, self.corners[0])
        else:
            self.center, self.size = seen(light["center"]), mpf(float(light["radius"]))
            self.m = unit(vector(light["normal"])) if "normal" in light else (mpf(0),) * 3
            self.h = dot(self.m, self.center)
        self.flat = any(self.m)

    def distance(self, r: Vector) -> Any:
        """Along r to the light's bright side; 0 where there is none."""
        if not self.flat:
            power, ahead = dot(self.center, self.center) - self.size**2, dot(self.center, r)
            under = ahead**2 - power
            return ahead - mp.sqrt(under) if power > 0 and under > 0 and ahead > 0 else mpf(0)
        ahead = dot(self.m, r)
        if self.h <= 0 or ahead <= 0:
            return mpf(0)
        x = times(r, self.h / ahead)
        if self.corners:
            ends = zip(self.corners, self.corners[1:] + self.corners[:1], strict=True)
            on = all(dot(self.m, cross(along(b, a, -1), along(x, a, -1))) > 0 for a, b in ends)
        else:
            offset = along(x, self.center, -1)
            on = dot(offset, offset) < self.size**2
        return self.h / ahead if on else mpf(0)

    def sees(self, r: Vector) -> bool:
        r = unit(r)
        distance = self.distance(r)
        if dot(self.normal, r) <= 0 or distance <= 0:
            return False
        for ball in self.balls:
            ahead, power = dot(ball.center, r), dot(ball.center, ball.center) - ball.radius**2
            under = ahead**2 - power
            if ball.within:
                offset = along(times(r, distance), ball.center, -1)
                if dot(offset, offset) > ball.radius**2:
                    return False
            elif not ball.own and under > 0 and ahead > 0 and ahead - mp.sqrt(under) < distance:
                return False
        return not any(o * (o - distance * dot(n, r)) < 0 for n, o in self.planes)

    def circles(self) -> list[Circle]:
        found = [great(self.normal)]
        if self.corners:
            ends = zip(self.corners, self.corners[1:] + self.corners[:1], strict=True)
            found += [great(cross(a, along(b, a, -1))) for a, b in ends]
        elif self.flat:
            found.append(Circle(self.center, *across(self.m), self.size))
        else:
            found.append(silhouette(self.center, self.size))
        for n, o in self.planes:
            if self.flat:
                pole = along(n, self.m, -o / self.h)
                found += [great(pole)] if dot(pole, pole) > mpf(10) ** -30 else []
            else:
                found += ring(self.center, self.size, n, o)
        for ball in self.balls:
            if not ball.within and not ball.own:
                found.append(silhouette(ball.center, ball.radius))
            if self.flat:
                found += ring(ball.center, ball.radius, self.m, self.h)
            else:
                between = along(ball.center, self.center, -1)
                powers = [
                    dot(c, c) - r**2
                    for c, r in ((ball.center, ball.radius), (self.center, self.size))
                ]
                if any(between):
                    found += ring(self.center, self.size, between, (powers[0] - powers[1]) / 2)
        return found

    def irradiance(self) -> Any:
        """[sr]"""
        if self.flat and self.h <= 0:
            return mpf(0)
        if not self.flat and dot(self.center, self.center) <= self.size**2:
            return mpf(0)
        circles, total = distinct(self.circles()), mpf(0)
        beside = BESIDE * self.size
        for circle in circles:
            cuts = sorted(
                angle
                for other in circles
                if other is not circle
                for angle in crossings(circle, other)
            ) or [mpf(0)]
            for start, end in itertools.pairwise([*cuts, cuts[0] + 2 * mp.pi]):
                if end - start < mpf(10) ** -15:
                    continue
                middle = (start + end) / 2
                x = circle.at(middle)
                side = times(unit(cross(x, circle.slope(middle))), beside)
                sign = self.sees(along(x, side, 1)) - self.sees(along(x, side, -1))
                if sign:
                    total += sign * self.integral(circle, start, end)
        return total

    def integral(self, circle: Circle, start: Any, end: Any) -> Any:
        """1/2 n . integral of r x dr"""

        def integrand(angle: Any) -> Any:
            x = circle.at(angle)
            return dot(self.normal, cross(x, circle.slope(angle))) / dot(x, x) / 2

        near = nearest(circle)
        width = mp.sqrt(dot(circle.at(near), circle.at(near))) / circle.radius
        ends = {start, end}
        for turn, sign, k in itertools.product((0, 1, -1), (1, -1), range(12)):
            # the nearest place is a peak: finer there
            ends.add(near + 2 * mp.pi * turn + sign * (width * 2**k if k else 0))
        ends |= {start + (end - start) * mpf(k) / 8 for k in range(8)}
        inner = sorted(e for e in ends if start <= e <= end)
        return mp.fsum(gauss(integrand, a, b) for a, b in itertools.pairwise(inner))


def nearest(circle: Circle) -> Any:
    """The angle of the place that is nearest to the point."""
    return mp.atan2(-dot(circle.center, circle.v), -dot(circle.center, circle.u))


@cache
def gauss_nodes(count: int) -> list[tuple[Any, Any]]:
    """Gauss and Legendre's, from numpy's by Newton's steps."""
    nodes = []
    for x in (mpf(float(x)) for x in np.polynomial.legendre.leggauss(count)[0]):
        for _ in range(4):
            before, value = mpf(1), x
            for k in range(2, count + 1):
                before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / k
            slope = count * (x * value - before) / (x * x - 1)
            x -= value / slope
        nodes.append((x, 2 / ((1 - x * x) * slope**2)))
    return nodes


def gauss(integrand: Callable[[Any], Any], start: Any, end: Any) -> Any:
    half, middle = (end - start) / 2, (end + start) / 2
    return half * mp.fsum(w * integrand(middle + half * x) for x, w in gauss_nodes(20))


def distinct(circles: list[Circle]) -> list[Circle]:
    """Without those that another one, which comes before, lies on."""

    def lie_on(a: Circle, b: Circle) -> bool:
        return all(abs(b.form(a.at(mpf(k)))) < mpf(10) ** -30 for k in range(5))

    return [a for k, a in enumerate(circles) if not any(lie_on(a, b) for b in circles[:k])]


def crossings(circle: Circle, other: Circle) -> list[Any]:
    """Where the other's form is 0 on the circle: roots of a trigonometric polynomial of degree 2.
    A place too many does no harm."""
    value = [other.form(circle.at(2 * mp.pi * k / 5)) for k in range(5)]
    largest = max(abs(v) for v in value)
    if largest < mpf(10) ** -30:
        return []
    coefficient = [
        sum(v * mp.expjpi(mpf(-2) * k * j / 5) for j, v in enumerate(value)) / 5 / largest
        for k in (2, 1, 0, -1, -2)
    ]
    while coefficient and abs(coefficient[0]) < mpf(10) ** -30:
        coefficient = coefficient[1:-1]
    if len(coefficient) < 2:
        return []
    return [mp.arg(z) for z in roots(coefficient) if abs(abs(z) - 1) < mpf(10) ** -8]


def roots(coefficient: list[Any]) -> list[Any]:
    """Of a polynomial, highest power first. numpy's, and Newton's steps from there; what lies so
    close together that it may need them all is left to mpmath, which is slow."""
    start = np.roots([complex(c) for c in coefficient])
    if any(abs(a - b) < 1e-3 for a, b in itertools.combinations(start, 2)):
        return list(mp.polyroots(coefficient[::-1], maxsteps=500, extraprec=300, asc=True))
    found = []
    for z in (mp.mpmathify(complex(z)) for z in start):
        for _ in range(6):
            value, slope = mp.polyval(coefficient[::-1], z, derivative=True, asc=True)
            z -= value / slope
        found.append(z)
    return found


def irradiance(
    light: dict[str, Any],
    point: Any,
    normal: Any,
    balls: Any = (),
    planes: Any = (),
    own: int = -1,
) -> Any:
    """[sr] to 25 digits or more; View says what is what."""
    with mp.workdps(DIGITS):
        return +View(light, point, normal, balls, planes, own).irradiance()
