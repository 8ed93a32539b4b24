"""The projected solid angle of what is visible of any light, from the definition, to 18 digits.

Half-planes through the receiver and an axis cut the scene into segments and circles. In each
of them the light's visible angles are the intervals, between all places where anything can begin
or end, in whose middles a shadow ray gets through; the integral over them is elementary. Over the
half-planes Gauss's rule runs between the places, found by bisection, where other places become
the ends. It shares no formula with compare/exact, and none of its floating-point numbers either:
all is in the 64 bits of x86's long double, where that is what numpy calls longdouble.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from penumbra.compare.exact.irradiance import SurfaceLight
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.scene import DiskLight, Scene, SphereLight, TriangleLight

Real = np.longdouble
PI = np.arctan2(Real(0), Real(-1))
NODES, MOST = (12, 20), 1000
"""Gauss's nodes in a panel; panels at once, more of which are noise."""


def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on [-1, 1], numpy's polished to all of Real's digits by Newton's method."""
    x = np.polynomial.legendre.leggauss(n)[0].astype(Real)
    for _ in range(3):
        before, value = np.ones(n, Real), x.copy()
        for k in range(2, n + 1):
            before, value = value, ((2 * k - 1) * x * value - (k - 1) * before) / Real(k)
        slope = n * (x * value - before) / (x * x - 1)
        x = x - value / slope
    return x, 2 / ((1 - x * x) * slope * slope)


RULES = [_gauss(n) for n in NODES]


def _real(v) -> np.ndarray:
    return np.asarray(v, dtype=float).astype(Real)


def _norm(v: np.ndarray) -> np.ndarray:
    return np.sqrt((v * v).sum(axis=-1))


@dataclass
class View:
    """The scene as one receiver sees it: all places from the receiver."""

    normal: np.ndarray
    balls: list[tuple[np.ndarray, np.ndarray, bool]]
    """centre, radius, whether the receiver is in it; not the own one from outside"""
    planes: list[tuple[np.ndarray, np.ndarray]]
    """(N, o), o > 0: opaque where N . x + o = 0"""
    corners: np.ndarray | None
    """(K, 3) of a polygon"""
    disk: tuple[np.ndarray, np.ndarray] | None
    """centre, radius"""
    sphere: tuple[np.ndarray, np.ndarray] | None
    plane: np.ndarray
    """a flat light's normal"""
    height: np.ndarray

    @staticmethod
    def of(scene: Scene, light: SurfaceLight, receivers: Receivers, i: int) -> View:
        point, which = _real(receivers.point[i]), receivers.object_id[i]
        balls, planes = [], []
        for j, ball in enumerate(scene.spheres):
            centre, radius = _real(ball.center) - point, Real(ball.radius)
            within = bool(receivers.inside[i]) if which == j else bool(_norm(centre) < radius)
            if within or which != j:
                balls.append((centre, radius, within))
        for j, plane in enumerate(scene.planes, start=len(scene.spheres)):
            n = _real(plane.normal)
            offset = n @ (point - _real(plane.point))
            if j != which and abs(offset) > 1e-12 * _norm(point - _real(plane.point)):
                planes.append((n * np.sign(offset), abs(offset)))
        normal = _real(receivers.normal[i])
        corners = disk = sphere = None
        m, height = np.zeros(3, Real), Real(0)
        if isinstance(light, SphereLight):
            sphere = (_real(light.center) - point, Real(light.radius))
        elif isinstance(light, DiskLight):
            disk = (_real(light.center) - point, Real(light.radius))
            m = _real(light.normal)
            m = m / _norm(m)
            height = m @ disk[0]
        else:
            u, v, corner = _real(light.edge_u), _real(light.edge_v), _real(light.corner) - point
            ends = [corner, corner + u, corner + u + v, corner + v]
            if isinstance(light, TriangleLight):
                del ends[2]
            corners = np.stack(ends)
            m = np.cross(u, v)
            m = m / _norm(m)
            height = m @ corner
        return View(normal, balls, planes, corners, disk, sphere, m, height)

    @property
    def middle(self) -> np.ndarray:
        if self.sphere is not None:
            return self.sphere[0]
        return self.disk[0] if self.disk is not None else self.corners.mean(axis=0)

    def visible(self, w: np.ndarray) -> np.ndarray:
        """Whether a ray of unit direction w (..., 3) reaches the light's lit side: (...,) bool."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.sphere is not None:
                centre, radius = self.sphere
                along = w @ centre
                across = _norm(centre - along[..., None] * w)
                hit = (along > 0) & (across < radius)
                t = along - np.sqrt(np.maximum(radius**2 - across**2, 0))
            else:
                slope = w @ self.plane
                hit = slope > 0
                t = np.where(hit, self.height / slope, 1)
                x = t[..., None] * w
                if self.disk is not None:
                    hit &= _norm(x - self.disk[0]) < self.disk[1]
                else:
                    for k in range(len(self.corners)):
                        side = np.cross(self.corners[k - 1], self.corners[k])
                        hit &= w @ side > 0
        hit &= w @ self.normal > 0
        x = t[..., None] * w
        for n, offset in self.planes:
            hit &= x @ n + offset > 0
        for centre, radius, within in self.balls:
            if within:
                hit &= _norm(x - centre) < radius
                continue
            along = w @ centre
            across = _norm(centre - along[..., None] * w)
            enters = along - np.sqrt(np.maximum(radius**2 - across**2, 0))
            hit &= ~((across < radius) & (along > 0) & (enters < t))
        return hit


class Slices:
    """Half-planes through an axis a and e = cos(phi) e1 + sin(phi) e2."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.a = view.middle / _norm(view.middle)
        other = np.eye(3, dtype=Real)[np.argmin(np.abs(self.a))]
        self.e1 = np.cross(self.a, other)
        self.e1 = self.e1 / _norm(self.e1)
        self.e2 = np.cross(self.a, self.e1)

    def at(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The integral over each half-plane's visible angles, and which places are their ends."""
        view, a = self.view, self.a
        e = np.cos(phi)[:, None] * self.e1 + np.sin(phi)[:, None] * self.e2
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.stack(self._places(e), axis=1)
        found = np.where((found >= 0) & (found <= PI), found, 0)
        order = np.argsort(found, axis=1, kind="stable")
        theta = np.take_along_axis(found, order, axis=1)
        ends = np.full((len(phi), 1), PI)
        low, high = theta, np.concatenate([theta[:, 1:], ends], axis=1)
        middle = (low + high) / 2
        w = np.cos(middle)[..., None] * a + np.sin(middle)[..., None] * e[:, None]
        visible = view.visible(w) & (high > low)
        change = np.diff(visible.astype(int), axis=1, prepend=0) != 0
        names = np.random.default_rng(0).integers(1, 1 << 40, found.shape[1])
        signature = (np.where(change, names[order], 0) * np.where(visible, 3, 5)).sum(axis=1)
        width, total = high - low, high + low
        along = (view.normal @ a) * np.sin(width) * np.sin(total) / 2
        across = (e @ view.normal)[:, None] * (width - np.sin(width) * np.cos(total)) / 2
        return np.where(visible, along + across, 0).sum(axis=1), signature

    def _places(self, e: np.ndarray) -> list[np.ndarray]:
        """All theta where something may begin or end, NaN where it does not."""
        view, a = self.view, self.a
        found = [np.zeros(len(e), Real)]
        side = np.cross(a, e)

        def through(pole: np.ndarray) -> None:
            theta = np.arctan2(-(pole @ a), e @ pole)
            found.append(np.where(theta < 0, theta + PI, theta))

        def flat(centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return centre @ a, e @ centre, (side @ centre) ** 2

        def tangents(centre: np.ndarray, radius: np.ndarray) -> None:
            x, y, aside2 = flat(centre)
            r = np.sqrt(radius**2 - aside2)
            distance = np.hypot(x, y)
            for sign in (-1, 1):
                found.append(np.arctan2(y, x) + sign * np.arcsin(r / distance))

        def on_line(m, height, centre, radius) -> None:  # type: ignore[no-untyped-def]
            """m . x = height meets a ball"""
            x, y, aside2 = flat(centre)
            mx, my = m @ a, e @ m
            size = np.hypot(mx, my)
            off = (height - mx * x - my * y) / size
            half = np.sqrt(radius**2 - aside2 - off**2)
            for sign in (-1, 1):
                px = x + (off * mx - sign * half * my) / size
                py = y + (off * my + sign * half * mx) / size
                found.append(np.where(py >= 0, np.arctan2(py, px), np.nan))

        through(view.normal)
        for centre, radius, within in view.balls:
            if not within:
                tangents(centre, radius)
        if view.sphere is not None:
            light, big = view.sphere
            tangents(light, big)
            for n, offset in view.planes:
                on_line(n, -offset, light, big)
            for centre, radius, _ in view.balls:
                # where both |x - O| = R and |x - L| = R_l: in a plane
                axis = light - centre
                level = (big**2 - light @ light - radius**2 + centre @ centre) / -2
                on_line(axis, level, light, big)
            return found
        for n, offset in view.planes:
            through(view.height * n + offset * view.plane)
        for centre, radius, _ in view.balls:
            on_line(view.plane, view.height, centre, radius)
        if view.disk is not None:
            on_line(view.plane, view.height, *view.disk)
        else:
            for k in range(len(view.corners)):
                through(np.cross(view.corners[k - 1], view.corners[k]))
        return found


def by_slices(
    scene: Scene, light: SurfaceLight, receivers: Receivers, tolerance: float, start: int
) -> tuple[np.ndarray, np.ndarray]:
    """Projected solid angle [sr] and how far two of Gauss's rules are apart: (n,) each. start:
    half-planes looked at first; what begins and ends between two of them is overlooked."""
    results = [_one(scene, light, receivers, i, tolerance, start) for i in range(len(receivers))]
    return np.array([r[0] for r in results]), np.array([r[1] for r in results], dtype=float)


def _one(
    scene: Scene, light: SurfaceLight, receivers: Receivers, i: int, tolerance: float, start: int
) -> tuple[np.ndarray, float]:
    view = View.of(scene, light, receivers, i)
    if view.sphere is not None:
        if _norm(view.sphere[0]) <= view.sphere[1]:
            return Real(0), 0.0
    elif view.height <= 1e-12 * _norm(view.middle):
        return Real(0), 0.0
    slices = Slices(view)
    ends = np.linspace(-PI, PI, start + 1, dtype=Real) + Real(0.0123)
    low, high = _parted(slices, ends[:-1], ends[1:])
    value, error = Real(0), 0.0
    for _ in range(40):
        sums = []
        for x, weight in RULES:
            phi, slope = _panel(low, high, x)
            integral = slices.at(phi.ravel())[0]
            sums.append((integral.reshape(phi.shape) * slope) @ weight)
        off = np.abs(sums[1] - sums[0])
        again = (off > tolerance) & (high - low > 1e-17) & (len(low) < MOST)
        value += sums[1][~again].sum()
        error += float(off[~again].sum())
        if not again.any():
            break
        low, high = low[again], high[again]
        middle = (low + high) / 2
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        low, high = _parted(slices, low, high)
    return value, error


def _panel(low: np.ndarray, high: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """phi and d phi / dx; the sine makes square roots at the ends smooth."""
    half, middle = (high - low)[:, None] / 2, (high + low)[:, None] / 2
    return middle + half * np.sin(PI * x / 2), half * PI / 2 * np.cos(PI * x / 2)


def _parted(slices: Slices, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The panels, parted where the visible intervals' ends change their names."""
    a, b = slices.at(low)[1], slices.at(high)[1]
    keep = a != b
    left, right, a, b = low[keep], high[keep], a[keep], b[keep]
    for _ in range(66 if len(left) else 0):
        middle = (left + right) / 2
        m = slices.at(middle)[1]
        third = (m != a) & (m != b) & (len(left) < 64)
        more = middle[third], right[third], m[third], b[third]
        first = m == a
        left, right = np.where(first, middle, left), np.where(first, right, middle)
        b = np.where(third, m, b)
        left, right, a, b = (
            np.concatenate(pair) for pair in zip((left, right, a, b), more, strict=True)
        )
    places = np.unique((left + right) / 2)
    return np.sort(np.concatenate([low, places])), np.sort(np.concatenate([high, places]))
