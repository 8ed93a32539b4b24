"""Irradiance from a quad light by adaptive quadrature, for what has no closed form.

It shares nothing with compare/exact/irradiance.py, which it checks in tests/test_exact.py. Across
the light along u everything is exact: a line meets each shadow in one interval, because the
points that a ball hides from one point form a convex set, and between the shadows the
integrand has an antiderivative. Along v Gauss-Kronrod panels are halved until they agree.
Everything is a projected solid angle [sr]: irradiance over radiance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from compare.exact.receivers import Receivers
from compare.scene import QuadLight, Scene

TOUCH = 1e-12
"""A light that lies in a plane is not behind it, one whose plane holds the receiver lights it
not: relative to the distances compared."""
DEPTH = 50
"""Halvings of one panel; 2^-50 of it cannot matter."""
MOST = 500
"""Panels of one receiver still to be halved: more of them at once are noise, not shape."""
CAUTION = 10
"""Times the difference of the two rules is what counts as the error: beside a kink both are
off alike, and the difference alone has been seen 2.6 times too small."""
ROUNDING = 1e-11
"""Relative error of a converged integral: shadows that just touch an edge keep no more.
A small light keeps fewer digits of s and t: 16 ulp times distance over width are added."""
PIXELS, PANELS = 1024, 4096
"""Receivers and panels worked on at once: bounds the memory."""

# Gauss-Kronrod (7, 15): QUADPACK, qk15 (Piessens et al., 1983).
_NODES = np.array(
    [
        0.991455371120812639206854697526329,
        0.949107912342758524526189684047851,
        0.864864423359769072789712788640926,
        0.741531185599394439863864773280788,
        0.586087235467691130294144691693810,
        0.405845151377397166906606412076961,
        0.207784955007898467600689403773245,
        0.0,
    ]
)
_KRONROD = np.array(
    [
        0.022935322010529224963732008058970,
        0.063092092629978553290700663189204,
        0.104790010322250183839876322541518,
        0.140653259715525918745189590510238,
        0.169004726639267902826583426598550,
        0.190350578064785409913256402421014,
        0.204432940075298892414161999234649,
        0.209482141084727828012999174891714,
    ]
)
NODES = np.concatenate([-_NODES, _NODES[-2::-1]])
KRONROD = np.concatenate([_KRONROD, _KRONROD[-2::-1]])
GAUSS = np.zeros(15)
GAUSS[1::2] = np.polynomial.legendre.leggauss(7)[1]  # type: ignore[no-untyped-call]


def integrate_light(
    scene: Scene, light: QuadLight, receivers: Receivers, tolerance: float = 1e-10
) -> tuple[np.ndarray, np.ndarray]:
    """Projected solid angle [sr] of the visible part of the light, and a bound on its error.

    tolerance: of each panel, relative to the whole. The bound is the sum over the panels of
    10 |Kronrod - Gauss|, and rounding. |Kronrod - Gauss| is the error of the coarser of the two
    rules, far above the finer one's where the integrand is smooth; no proof, but it held in
    every case of tests/test_exact.py.
    """
    value, error = np.zeros(len(receivers)), np.zeros(len(receivers))
    to_corner = np.asarray(light.corner) - receivers.point
    size = np.linalg.norm(light.edge_u) + np.linalg.norm(light.edge_v)
    least = TOUCH * (np.linalg.norm(to_corner, axis=1) + size)
    index = np.flatnonzero(to_corner @ np.asarray(light.normal) > least)
    for start in range(0, len(index), PIXELS):
        part = index[start : start + PIXELS]
        lines = _Lines.of(scene, light, receivers[part])
        value[part], error[part] = _integrate(lines, tolerance)
    return value, error


@dataclass(frozen=True)
class _Lines:
    """The light as seen from n receivers: x(s, t) = corner + s u + t v, from the receiver.

    Of its points those with offset + normal . x >= 0 for all H half-spaces can be seen, but
    not those behind a ball from outside, nor those outside a ball around the receiver.
    """

    corner: np.ndarray
    """(n, 3)"""
    u: np.ndarray
    v: np.ndarray
    area: float
    height: np.ndarray
    """(n,) from the receiver to the light's plane"""
    normal: np.ndarray
    """(n, H, 3), the first one the receiver's own: its horizon"""
    offset: np.ndarray
    """(n, H)"""
    centre: np.ndarray
    """(n, S, 3)"""
    radius: np.ndarray
    """(n, S), 0 for a ball that cannot matter"""
    within: np.ndarray
    """(n, S) bool"""

    @staticmethod
    def of(scene: Scene, light: QuadLight, receivers: Receivers) -> _Lines:
        n = len(receivers)
        corner = np.asarray(light.corner) - receivers.point
        u, v = np.asarray(light.edge_u), np.asarray(light.edge_v)
        normals, offsets = [receivers.normal], [np.zeros(n)]
        corners = np.asarray(light.corner) + np.stack([0 * u, u, v, u + v])
        for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
            point, normal = np.asarray(plane.point), np.asarray(plane.normal)
            height = (receivers.point - point) @ normal
            least = TOUCH * np.linalg.norm(receivers.point - point, axis=1)
            height[(receivers.object_id == i) | (np.abs(height) <= least)] = 0
            if np.all(np.abs((corners - point) @ normal) <= TOUCH * np.abs(corners).max()):
                height[:] = 0
            normals.append(np.sign(height)[:, None] * normal)
            offsets.append(np.abs(height))
        centre = np.array([s.center for s in scene.spheres]).reshape(-1, 3)
        centre = centre - receivers.point[:, None]
        radius = np.broadcast_to([s.radius for s in scene.spheres], centre.shape[:2])
        own = receivers.object_id[:, None] == np.arange(len(scene.spheres))
        distance = np.linalg.norm(centre, axis=2)
        within = np.where(own, receivers.inside[:, None], distance < radius)
        matters = _may_hide(corner, u, v, centre, radius) & ~own | within
        order = np.argsort(~matters, axis=1, kind="stable")
        order = order[:, : int(matters.sum(axis=1).max(initial=0))]
        pick = np.take_along_axis
        return _Lines(
            corner=corner,
            u=u,
            v=v,
            area=light.area,
            height=corner @ np.asarray(light.normal),
            normal=np.stack(normals, axis=1),
            offset=np.stack(offsets, axis=1),
            centre=pick(centre, order[..., None], axis=1),
            radius=pick(np.where(matters, radius, 0), order, axis=1),
            within=pick(within, order, axis=1),
        )

    def t_of(self, x: np.ndarray) -> np.ndarray:
        """t of points (n, k, 3) of the light's plane."""
        across = _cross(_cross(self.u, self.v), self.u)
        return np.asarray(((x - self.corner[:, None]) @ across) / (across @ self.v))


def _may_hide(
    corner: np.ndarray, u: np.ndarray, v: np.ndarray, centre: np.ndarray, radius: np.ndarray
) -> np.ndarray:
    """(n, S) Whether a ball touches the segments from the receiver to a ball around the light."""
    middle = corner + 0.5 * (u + v)
    around = 0.5 * (np.linalg.norm(u) + np.linalg.norm(v))
    t = _dot(centre, middle[:, None]) / _dot(middle, middle)[:, None]
    gap = centre - np.clip(t, 0, 1)[..., None] * middle[:, None]
    return np.asarray(np.linalg.norm(gap, axis=2) <= radius + around)


def _integrate(lines: _Lines, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    n = len(lines.corner)
    value, error, scale = np.zeros(n), np.zeros(n), np.zeros(n)
    breaks = _breaks(lines)
    pixel, piece = np.nonzero(breaks[:, 1:] > breaks[:, :-1])
    work = _Panels(
        pixel,
        breaks[pixel, piece],
        breaks[pixel, piece + 1],
        np.full(len(pixel), -1.0),
        np.full(len(pixel), 1.0),
    )
    for depth in range(DEPTH):
        results = [_panel_sums(lines, part) for part in work.parts()]
        kronrod, difference = (np.concatenate([r[k] for r in results]) for k in (0, 1))
        if depth == 0:
            scale += np.bincount(work.pixel, np.abs(kronrod) + difference, minlength=n)
        done = difference <= tolerance * scale[work.pixel]
        crowded = np.bincount(work.pixel[~done], minlength=n) > MOST
        done |= crowded[work.pixel] | (depth == DEPTH - 1)
        value += np.bincount(work.pixel[done], kronrod[done], minlength=n)
        error += np.bincount(work.pixel[done], difference[done], minlength=n)
        if done.all():
            break
        work = work.halved(~done)
    width = lines.area / max(np.linalg.norm(lines.u), np.linalg.norm(lines.v))
    ulp = np.finfo(np.float64).eps * (1 + np.linalg.norm(lines.corner, axis=1) / width)
    return value, error + (ROUNDING + 16 * ulp) * value


@dataclass(frozen=True)
class _Panels:
    """Pieces of the range of t, for t = mean + half-width * sin(pi x / 2), x from `low` to
    `high` in [-1, 1]: a shadow that begins like sqrt(t - t0) is smooth in x."""

    pixel: np.ndarray
    first: np.ndarray
    last: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __getitem__(self, which: np.ndarray | slice) -> _Panels:
        return _Panels(
            self.pixel[which],
            self.first[which],
            self.last[which],
            self.low[which],
            self.high[which],
        )

    def parts(self) -> Iterator[_Panels]:
        for start in range(0, max(len(self.pixel), 1), PANELS):
            yield self[start : start + PANELS]

    def halved(self, which: np.ndarray) -> _Panels:
        todo = self[which]
        middle = 0.5 * (todo.low + todo.high)
        pixel, first, last = (np.tile(a, 2) for a in (todo.pixel, todo.first, todo.last))
        low, high = np.concatenate([todo.low, middle]), np.concatenate([middle, todo.high])
        return _Panels(pixel, first, last, low, high)


def _panel_sums(lines: _Lines, panels: _Panels) -> tuple[np.ndarray, np.ndarray]:
    """Each panel's integral, and how far the two rules differ."""
    half = 0.5 * (panels.high - panels.low)[:, None]
    x = panels.low[:, None] + half * (1 + NODES)
    width = 0.5 * (panels.last - panels.first)[:, None]
    t = panels.first[:, None] + width * (1 + np.sin(0.5 * np.pi * x))
    slope = 0.5 * np.pi * np.cos(0.5 * np.pi * x) * width * half
    integrand = slope * _line_integral(lines, panels.pixel, t)
    return integrand @ KRONROD, CAUTION * np.abs(integrand @ (KRONROD - GAUSS))


def _breaks(lines: _Lines) -> np.ndarray:
    """(n, B) sorted values of t between which the line integral is smooth: the rule's nodes
    would miss what begins right beside a panel's end."""
    n = len(lines.corner)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = _tangents(lines) + _edge_crossings(lines) + _cone_crossings(lines)
    breaks = np.concatenate([np.zeros((n, 1)), np.ones((n, 1)), *found], axis=1)
    return np.sort(np.where((breaks > 0) & (breaks < 1), breaks, breaks >= 1), axis=1)


def _tangents(lines: _Lines) -> list[np.ndarray]:
    """Where a line of constant t touches a shadow's cone, or the ball itself."""
    u, r, c, r2 = lines.u, lines.corner[:, None], lines.centre, lines.radius**2
    start, slope = _cross(u, r), _cross(u, lines.v)
    # start + t slope is normal to the plane through the receiver and the line.
    c_start, c_slope = _dot(start, c), c @ slope
    offset = start - _cross(u, c)
    return [
        *_roots(
            c_slope**2 - r2 * (slope @ slope),
            c_slope * c_start - r2 * (start @ slope),
            c_start**2 - r2 * _dot(start, start),
        ),
        *_roots(
            np.full(r2.shape, slope @ slope), offset @ slope, _dot(offset, offset) - r2 * (u @ u)
        ),
    ]


def _edge_crossings(lines: _Lines) -> list[np.ndarray]:
    """Where s = 0, s = 1 and the half-spaces' edges cross each other and the shadows' outlines."""
    corner, normal, offset = lines.corner, lines.normal, lines.offset
    light_normal = _cross(lines.u, lines.v) / lines.area
    edges = [(corner, lines.v[None]), (corner + lines.u, lines.v[None])]
    foot = lines.height[:, None] * light_normal
    for h in range(offset.shape[1]):
        level = normal[:, h] - (normal[:, h] @ light_normal)[:, None] * light_normal
        away = (_dot(normal[:, h], foot) + offset[:, h]) / _dot(level, level)
        edges.append((foot - away[:, None] * level, _cross(normal[:, h], light_normal)))
    found = []
    for start, along in edges:
        x, e = start[:, None], along[:, None]
        ball = lines.centre, lines.radius
        crossings = [-(offset + _dot(x, normal)) / _dot(e, normal)]
        crossings += [*_in_ball(x, e, *ball), *_behind_ball(x, e, *ball)]
        found += [lines.t_of(x + p[..., None] * e) for p in crossings]
    return found


def _cone_crossings(lines: _Lines) -> list[np.ndarray]:
    """Where the outlines of two balls cross: unit w with w . a = cos alpha for both."""
    light_normal = _cross(lines.u, lines.v) / lines.area
    distance = np.sqrt(_dot(lines.centre, lines.centre))
    axis = lines.centre / distance[..., None]
    cosine = np.sqrt((distance - lines.radius) * (distance + lines.radius)) / distance
    found = []
    for i in range(distance.shape[1]):
        others = slice(i + 1, None)
        a, b, cos_a, cos_b = (
            axis[:, i, None],
            axis[:, others],
            cosine[:, i, None],
            cosine[:, others],
        )
        g = _dot(a, b)
        x, y = (cos_a - g * cos_b) / (1 - g * g), (cos_b - g * cos_a) / (1 - g * g)
        z = np.sqrt((1 - x * cos_a - y * cos_b) / (1 - g * g))
        for sign in (-1, 1):
            w = x[..., None] * a + y[..., None] * b + sign * z[..., None] * _cross(a, b)
            found.append(lines.t_of(w * (lines.height[:, None] / (w @ light_normal))[..., None]))
    return found


def _roots(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> list[np.ndarray]:
    """a t^2 + 2 b t + c = 0; NaN where there is none."""
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    return [q / a, c / q]


def _line_integral(lines: _Lines, pixel: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The integral over the visible s in [0, 1] of area cos cos / d^2, for pixel (p,), t (p, q).

    The integrand is (start + slope s) height area / |x|^4.
    """
    u = lines.u
    x = lines.corner[pixel, None] + t[..., None] * lines.v  # at s = 0
    low, high = np.zeros_like(t), np.ones_like(t)
    for h in range(lines.offset.shape[1]):
        normal, offset = lines.normal[pixel, h], lines.offset[pixel, h, None]
        start = offset + _dot(x, normal[:, None])
        low, high = _clip(low, high, start, (normal @ u)[:, None])
    hidden_low, hidden_high = [], []
    for j in range(lines.radius.shape[1]):
        ball = lines.centre[pixel, j, None], lines.radius[pixel, j, None]
        within = lines.within[pixel, j, None]
        ball_low, ball_high = _in_ball(x, u, *ball)
        low = np.where(within, np.clip(ball_low, low, high), low)
        high = np.where(within, np.clip(ball_high, low, high), high)
        cone_low, cone_high = _behind_ball(x, u, *ball)
        none = within | (ball[1] == 0)
        hidden_low.append(np.where(none, np.inf, np.minimum(ball_low, cone_low)))
        hidden_high.append(np.where(none, -np.inf, np.maximum(ball_high, cone_high)))
    high = np.maximum(high, low)
    if not hidden_low:
        pieces_low, pieces_high = low[None], high[None]
    else:
        starts, ends = np.stack(hidden_low), np.stack(hidden_high)
        ends[starts == np.inf] = np.inf  # an empty interval hides nothing, beyond the end
        order = np.argsort(starts, axis=0)
        starts = np.clip(np.take_along_axis(starts, order, axis=0), low, high)
        ends = np.clip(np.take_along_axis(ends, order, axis=0), low, high)
        ends = np.maximum.accumulate(ends, axis=0)
        pieces_low = np.concatenate([low[None], ends])
        pieces_high = np.maximum(np.concatenate([starts, high[None]]), pieces_low)
    horizon = lines.normal[pixel, 0]
    start, slope = _dot(x, horizon[:, None]), (horizon @ u)[:, None]
    total = _antiderivative(x, u, start, slope, pieces_low, pieces_high).sum(axis=0)
    return np.asarray(total * lines.area * lines.height[pixel, None])


def _antiderivative(
    x: np.ndarray,
    u: np.ndarray,
    start: np.ndarray,
    slope: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """The integral of (start + slope s) / |x + s u|^4 from low to high.

    With y = s + x.u / u.u, |x + s u|^2 = u.u (y^2 + k^2).
    """
    uu = float(u @ u)
    shift = (x @ u) / uu
    across = x - shift[..., None] * u
    k2 = _dot(across, across) / uu
    k = np.sqrt(k2)
    y0, y1 = low + shift, high + shift
    p = start - slope * shift
    q0, q1 = y0**2 + k2, y1**2 + k2
    width = high - low
    angle = np.arctan2(width * k, k2 + y0 * y1)
    rational = width * (k2 - y0 * y1) / (q0 * q1)  # y1 / q1 - y0 / q0
    linear = width * (y0 + y1) / (q0 * q1)  # 1 / q0 - 1 / q1
    return np.asarray((p * (rational + angle / k) / (2 * k2) + 0.5 * slope * linear) / uu**2)


def _clip(
    low: np.ndarray, high: np.ndarray, start: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of [low, high] where start + slope s >= 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -start / slope
    low = np.where(slope > 0, np.maximum(low, at), low)
    high = np.where(slope < 0, np.minimum(high, at), high)
    return low, np.where((slope == 0) & (start < 0), low, high)


def _in_ball(
    x: np.ndarray, u: np.ndarray, centre: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The interval of s with |x + s u - centre| <= radius; (inf, -inf) where there is none."""
    uu = _dot(u, u)
    to_centre = centre - x
    middle = _dot(to_centre, u) / uu
    across = to_centre - middle[..., None] * u
    half2 = (radius**2 - _dot(across, across)) / uu
    half = np.where(half2 > 0, np.sqrt(np.maximum(half2, 0)), -np.inf)
    return middle - half, middle + half


def _behind_ball(
    x: np.ndarray, u: np.ndarray, centre: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The interval of s with x + s u in the tangent cone, behind the tangent circle's plane:
    |c x x| <= r |x| and c.x >= c.c - r^2; (inf, -inf) where there is none."""
    cx, cu = _dot(centre, x), _dot(centre, u)
    across_x, across_u, r2 = _cross(centre, x), _cross(centre, u), radius**2
    polar = _dot(centre, centre) - r2
    a = r2 * _dot(u, u) - _dot(across_u, across_u)
    b = r2 * _dot(x, u) - _dot(across_x, across_u)
    c = r2 * _dot(x, x) - _dot(across_x, across_x)
    discriminant = b * b - a * c
    none = (discriminant < 0) & (a < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -(b + np.copysign(np.sqrt(np.maximum(discriminant, 0)), b))
        one, two = q / a, c / q
    first, second = np.fmin(one, two), np.fmax(one, two)
    # A line steeper than the cone (a > 0) is inside it before or after both crossings.
    low = np.where(a < 0, first, np.where(cu > 0, second, -np.inf))
    high = np.where(a < 0, second, np.where(cu > 0, np.inf, first))
    low, high = _clip(low, high, cx - polar, cu)
    none |= ~(low < high)
    return np.where(none, np.inf, low), np.where(none, -np.inf, high)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross, several times as fast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
