"""Irradiance from a uniform quad light behind spheres and planes, in closed form.

docs/exact.md derives it. Everything here is a projected solid angle [sr]: the irradiance
[W m^-2] over the light's radiance [W m^-2 sr^-1].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from compare.exact.receivers import Receivers
from compare.scene import QuadLight, Scene

TOUCH = 1e-12
"""Lengths relative to the distances that they are differences of, and angles [rad], below
which rounding decides: a light that lies in a plane is not behind it, a light that stands on
the receiver's plane is not below its horizon, a sliver that thin hides or shows nothing."""
EPS = float(np.finfo(np.float64).eps)
ROUNDING = 16 * EPS
"""Bound on the rounding error per radian of outline: over ten times the largest that was
measured (docs/exact.md)."""
BLUR = 4 * EPS
"""Coordinates count as known to this, relatively: what rounding the receiver's own and the
differences from it may shift an outline by."""
CHUNK = 1 << 20
"""Numbers in one temporary array: 8 MiB."""


@dataclass(frozen=True)
class LightView:
    """What n receivers see of one light."""

    projected_solid_angle: np.ndarray
    """(n,) [sr], the visible part"""
    error_bound: np.ndarray
    """(n,) [sr]"""
    whole: np.ndarray
    """(n,) bool: wholly visible"""
    hidden: np.ndarray
    """(n,) bool: no part visible"""
    unsolved: np.ndarray
    """(n,) bool: no closed form (a ball cuts the light, or the receiver and part of the light
    are inside one): projected_solid_angle is then an upper bound, without those balls"""


def quad_view(scene: Scene, light: QuadLight, receivers: Receivers) -> LightView:
    """What the receivers see of a quad light, other objects' shadows included."""
    n = len(receivers)
    value, error = np.zeros(n), np.zeros(n)
    whole, hidden = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    unsolved = np.zeros(n, dtype=bool)

    corner, edge_u, edge_v = (np.asarray(v) for v in (light.corner, light.edge_u, light.edge_v))
    to_corner = corner - receivers.point
    reach = np.sqrt(_dot(to_corner, to_corner)) + np.linalg.norm(edge_u) + np.linalg.norm(edge_v)
    facing = np.flatnonzero(to_corner @ np.asarray(light.normal) > TOUCH * reach)
    near = receivers[facing]
    corners = np.stack([0 * edge_u, edge_u, edge_u + edge_v, edge_v])
    polygon = Polygon.of_corners(to_corner[facing, None] + corners)
    error[facing] = ROUNDING * polygon.angle.sum(axis=1)
    far = np.sqrt(_dot(receivers.point, receivers.point)) + reach
    error[facing] += BLUR * far[facing] * polygon.sensitivity
    cut = np.zeros(len(near), dtype=bool)
    for half_space in _half_spaces(scene, near):
        polygon, was_cut = polygon.clipped(*half_space, np.asarray(light.normal))
        cut |= was_cut
    seen = ~polygon.empty
    index, near, polygon, cut = facing[seen], near[seen], polygon[seen], cut[seen]

    caps, blocked, mixed = _sphere_shadows(scene, light, near, polygon)
    view = _unoccluded(polygon, near.normal)
    value[index] = np.where(blocked, 0, view)
    whole[index] = ~(cut | blocked | mixed)
    hidden[index] = blocked
    unsolved[index] = mixed & ~blocked

    for which, sphere in _groups(caps & ~blocked[:, None], polygon.vertex.shape[1]):
        cap = Caps.of_spheres(scene, near.point[which], sphere)
        shown, length, lost = _beside_caps(polygon[which], near.normal[which], cap)
        i, least = index[which], TOUCH * polygon[which].angle.sum(axis=1)
        dark = length <= least
        value[i] = np.where(dark, 0, np.clip(shown, 0, value[i]))
        error[i] += ROUNDING * (length + lost)
        whole[i] &= lost <= least
        hidden[i] = dark
        unsolved[i] &= ~dark
    hidden[index] |= ~unsolved[index] & (value[index] <= error[index])
    value[hidden] = 0
    return LightView(value, error, whole, hidden, unsolved)


@dataclass(frozen=True)
class Polygon:
    """n convex polygons of up to K corners in one plane, seen from n points.

    They turn counterclockwise about the light's normal, which points away from the receiver.
    Unused places hold the first corner again: edges of length 0.
    """

    vertex: np.ndarray
    """(n, K, 3) from the receiver [m]"""
    side: np.ndarray
    """(n, K, 3) unit normals of the planes through the receiver and each edge (from corner k
    to corner k + 1), pointing inwards. Kept through clipping, since a short edge's corners
    do not tell its direction: for crossings, not for the integral (`pole`)."""
    empty: np.ndarray
    """(n,) bool"""

    @staticmethod
    def of_corners(vertex: np.ndarray) -> Polygon:
        edge = np.roll(vertex, -1, axis=1) - vertex
        side = _unit(_cross(vertex, edge))
        return Polygon(vertex, side, np.zeros(len(vertex), dtype=bool))

    def __getitem__(self, which: np.ndarray) -> Polygon:
        return Polygon(self.vertex[which], self.side[which], self.empty[which])

    @property
    def middle(self) -> np.ndarray:
        """(n, 3) unit vectors to somewhere amid each polygon"""
        return _unit(_unit(self.vertex).sum(axis=1))

    @property
    def angle(self) -> np.ndarray:
        """(n, K) the angle that each edge subtends [rad]"""
        after = np.roll(self.vertex, -1, axis=1)
        moment = _cross(self.vertex, after - self.vertex)
        return np.arctan2(np.sqrt(_dot(moment, moment)), _dot(self.vertex, after))

    @property
    def pole(self) -> np.ndarray:
        """(n, K, 3) as `side`, but of the corners as they are: with any other pole than that of
        the corners whose angle it multiplies the edges' sum would be off by the ratio of a light's
        distance to its width."""
        return _unit(_cross(self.vertex, np.roll(self.vertex, -1, axis=1) - self.vertex))

    @property
    def sensitivity(self) -> np.ndarray:
        """(n,) the most that the projected solid angle changes with the outline's places [m^-1]:
        the integral of |dr| / |X|, at most that of |dX| / X^2, theta over each line's distance."""
        edge = np.roll(self.vertex, -1, axis=1) - self.vertex
        moment = _cross(self.vertex, edge)
        sine = np.sqrt(_dot(moment, moment))
        length, angle = np.sqrt(_dot(edge, edge)), self.angle
        after = np.roll(self.vertex, -1, axis=1)
        product = np.sqrt(_dot(self.vertex, self.vertex) * _dot(after, after))
        # an edge that points at the receiver: theta / sin(theta) = 1
        ratio = np.where(sine > EPS * product, angle / np.maximum(sine, EPS * product), 1 / product)
        return np.asarray((length * ratio).sum(axis=1))

    def clipped(
        self, normal: np.ndarray, offset: np.ndarray, light_normal: np.ndarray
    ) -> tuple[Polygon, np.ndarray]:
        """The parts where normal . x + offset >= 0 (Sutherland-Hodgman, all at once),
        and which polygons lost something. normal: (n, 3); offset: (n,) >= 0.
        """
        height = np.einsum("nki,ni->nk", self.vertex, normal) + offset[:, None]
        touch = TOUCH * (np.sqrt(_dot(self.vertex, self.vertex)) + offset[:, None])
        height[np.abs(height) <= touch] = 0
        lost = (height < 0).any(axis=1)
        gone = lost & ~(height > 0).any(axis=1)
        crosses = np.flatnonzero(lost & ~gone & ~self.empty)
        if not len(crosses):
            return Polygon(self.vertex, self.side, self.empty | gone), lost

        part, height = self[crosses], height[crosses]
        after, height_after = np.roll(part.vertex, -1, axis=1), np.roll(height, -1, axis=1)
        inside, inside_after = height >= 0, height_after >= 0
        crossing = inside != inside_after
        fraction = height / np.where(crossing, height - height_after, 1)
        cut = part.vertex + fraction[..., None] * (after - part.vertex)
        through_receiver = (offset[crosses] == 0)[:, None, None]
        along = np.cross(normal[crosses], light_normal)[:, None]
        new_side = np.where(through_receiver, normal[crosses, None], _unit(_cross(cut, along)))

        # Each edge's first corner if it is inside, then the cut if there is one; in that order
        # the corners kept go around the new polygon.
        vertex = _interleaved(part.vertex, cut)
        side = _interleaved(part.side, np.where(inside[..., None], new_side, part.side))
        kept = np.stack([inside, crossing], axis=2).reshape(len(crosses), -1)
        order = np.argsort(~kept, axis=1, kind="stable")
        size = max(self.vertex.shape[1], int(kept.sum(axis=1).max()))
        order = order[:, :size, None]
        used = np.take_along_axis(kept[..., None], order, axis=1)
        vertex, side = (np.take_along_axis(a, order, axis=1) for a in (vertex, side))
        result = self._padded(size, light_normal)
        result.vertex[crosses] = np.where(used, vertex, vertex[:, :1])
        result.side[crosses] = np.where(used, side, light_normal)
        return Polygon(result.vertex, result.side, self.empty | gone), lost

    def _padded(self, size: int, light_normal: np.ndarray) -> Polygon:
        """A copy with room for `size` corners. The light is before the plane with its own normal
        through the receiver: as a side of an edge of length 0 that plane excludes nothing."""
        more = size - self.vertex.shape[1]
        corners = np.repeat(self.vertex[:, :1], more, axis=1)
        sides = np.broadcast_to(light_normal, (len(self.vertex), more, 3))
        vertex = np.concatenate([self.vertex, corners], axis=1)
        return Polygon(vertex, np.concatenate([self.side, sides], axis=1), self.empty)


@dataclass(frozen=True)
class Caps:
    """The circular cones of directions that m spheres hide from each of n points."""

    axis: np.ndarray
    """(n, m, 3) unit vectors"""
    sine: np.ndarray
    """(n, m) of the half-angle"""
    cosine: np.ndarray
    """(n, m)"""

    @staticmethod
    def of_spheres(scene: Scene, point: np.ndarray, sphere: np.ndarray) -> Caps:
        """sphere: (n, m) indices into scene.spheres."""
        centre = np.array([s.center for s in scene.spheres])[sphere]
        radius = np.array([s.radius for s in scene.spheres])[sphere]
        axis = centre - point[:, None]
        distance = np.sqrt(_dot(axis, axis))
        tangent = np.sqrt(np.maximum((distance - radius) * (distance + radius), 0))
        return Caps(axis / distance[..., None], radius / distance, tangent / distance)


def _unoccluded(polygon: Polygon, normal: np.ndarray) -> np.ndarray:
    """Lambert: 1/2 sum_k theta_k (gamma_k . n)"""
    cosine = np.einsum("nki,ni->nk", polygon.pole, normal)
    return np.maximum(0.5 * (polygon.angle * cosine).sum(axis=1), 0)


def _half_spaces(scene: Scene, receivers: Receivers) -> list[tuple[np.ndarray, np.ndarray]]:
    """(normal, offset) of what the receivers' horizon and the planes leave to be seen:
    normal . x + offset >= 0 for x from the receiver."""
    result = [(receivers.normal, np.zeros(len(receivers)))]
    for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
        normal, offset = np.asarray(plane.normal), receivers.point - np.asarray(plane.point)
        height = offset @ normal
        own = receivers.object_id == i
        own |= np.abs(height) <= TOUCH * np.sqrt(_dot(offset, offset))
        towards = np.where(own[:, None], receivers.normal, np.copysign(1, height)[:, None] * normal)
        result.append((towards, np.where(own, 0, np.abs(height))))
    return result


def _sphere_shadows(
    scene: Scene, light: QuadLight, receivers: Receivers, polygon: Polygon
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which spheres hide a whole cone of each polygon: (n, number of spheres) bool;
    which polygons a sphere hides for sure, and which a sphere hides without a closed form:
    (n,) bool."""
    n = len(receivers)
    caps = np.zeros((n, len(scene.spheres)), dtype=bool)
    blocked, mixed = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    if not n:
        return caps, blocked, mixed
    length = np.sqrt(_dot(polygon.vertex, polygon.vertex))
    direction = polygon.vertex / length[..., None]
    middle = polygon.middle
    cosine_spread = np.einsum("nki,ni->nk", direction, middle).min(axis=1)
    sine_spread = np.sqrt(np.maximum(1 - cosine_spread**2, 0))
    normal = np.asarray(light.normal)
    for j, sphere in enumerate(scene.spheres):
        to_centre = np.asarray(sphere.center) - receivers.point
        distance = np.sqrt(_dot(to_centre, to_centre))
        own = receivers.object_id == j
        within = np.where(own, receivers.inside, distance < sphere.radius)
        beyond = float(normal @ (np.asarray(sphere.center) - np.asarray(light.corner)))
        slack = TOUCH * sphere.radius
        if beyond < sphere.radius - slack:
            sine = sphere.radius / np.maximum(distance, sphere.radius)
            cosine = np.sqrt(1 - sine**2)
            # angle(axis, middle) <= half-angle + spread; the 1e-7 covers the square roots above.
            # A wider light than a hemisphere's cap need not be where its corners are.
            reach = cosine * cosine_spread - sine * sine_spread - 1e-7
            reach = np.where(cosine_spread > 0, reach, -1)
            maybe = ~own & ~within & (_dot(to_centre, middle) >= distance * reach)
            i = np.flatnonzero(maybe)
            depth = np.einsum("nki,ni->nk", polygon.side[i], to_centre[i]).min(axis=1)
            i = i[depth > -sphere.radius]
            if beyond <= -sphere.radius + slack:
                caps[i, j] = True
            else:
                _cut_light(sphere.radius, to_centre, polygon, i, normal, caps[:, j], mixed)
        i = np.flatnonzero(within)
        if len(i):
            _from_inside(sphere.radius, to_centre, polygon, i, normal, blocked, mixed)
    return caps, blocked, mixed


def _cut_light(
    radius: float,
    to_centre: np.ndarray,
    polygon: Polygon,
    i: np.ndarray,
    normal: np.ndarray,
    caps: np.ndarray,
    mixed: np.ndarray,
) -> None:
    """A ball that cuts the light's plane, in front of the polygons i.

    Behind the plane of its tangent circle (centre . x = D^2 - R^2) it hides its whole cone;
    before that plane it hides only what is in it.
    """
    centre, vertex = to_centre[i], polygon.vertex[i]
    ahead = np.einsum("nki,ni->nk", vertex, centre)
    polar = _dot(centre, centre) - radius**2
    apart = _distance(centre, polygon[i], normal) >= radius
    behind = (ahead >= polar[:, None]).all(axis=1)
    before = (ahead <= polar[:, None]).all(axis=1)
    caps[i[behind]] = True
    mixed[i[~behind & ~(before & apart)]] = True


def _from_inside(
    radius: float,
    to_centre: np.ndarray,
    polygon: Polygon,
    i: np.ndarray,
    normal: np.ndarray,
    blocked: np.ndarray,
    mixed: np.ndarray,
) -> None:
    """Receivers i inside a ball see only what is in it as well."""
    from_centre = polygon.vertex[i] - to_centre[i, None]
    farthest = np.sqrt(_dot(from_centre, from_centre)).max(axis=1)
    outside = _distance(to_centre[i], polygon[i], normal) >= radius
    blocked[i[outside]] = True
    mixed[i[~outside & (farthest > radius * (1 + TOUCH))]] = True


def _distance(point: np.ndarray, polygon: Polygon, normal: np.ndarray) -> np.ndarray:
    """From points (n, 3) to polygons with that normal [m]."""
    edge = np.roll(polygon.vertex, -1, axis=1) - polygon.vertex
    offset = point[:, None] - polygon.vertex
    over = (_dot(_cross(normal, edge), offset) >= 0).all(axis=1)
    squared = _dot(edge, edge)
    t = np.clip(_dot(offset, edge) / np.where(squared > 0, squared, 1), 0, 1)
    to_edge = offset - t[..., None] * edge
    return np.where(
        over, np.abs(offset[:, 0] @ normal), np.sqrt(_dot(to_edge, to_edge)).min(axis=1)
    )


def _groups(caps: np.ndarray, edges: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(which, sphere): polygons that equally many caps meet, and those caps' spheres, (k,) and
    (k, m), in parts that keep the temporary arrays small. caps: (n, number of spheres) bool."""
    count = caps.sum(axis=1)
    for m in np.unique(count[count > 0]):
        group = np.flatnonzero(count == m)
        step = max(1, CHUNK // (6 * m * (edges + m)))
        for start in range(0, len(group), step):
            which = group[start : start + step]
            yield which, np.nonzero(caps[which])[1].reshape(-1, m)


def _beside_caps(
    polygon: Polygon, normal: np.ndarray, caps: Caps
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of each polygon outside m caps: its projected solid angle, the length of its
    boundary, and the length of what the caps hide of the polygon's plus what they add [rad].

    Stokes: 1/2 n . integral of r x dr over what the caps leave of the edges and, turning the
    other way, over what the polygon and the other caps leave of each cap's circle.
    """
    shown, hidden = _edges_outside(polygon, caps)
    arcs, arc_length = _arcs_inside(polygon, normal, caps)
    cosine = np.einsum("nki,ni->nk", polygon.pole, normal)
    edges = 0.5 * (shown * cosine).sum(axis=1)
    return edges - arcs, shown.sum(axis=1) + arc_length, hidden.sum(axis=1) + arc_length


def _edges_outside(polygon: Polygon, caps: Caps) -> tuple[np.ndarray, np.ndarray]:
    """(n, K) how much of each edge the caps leave, and the most that one of them hides [rad]."""
    half = 0.5 * polygon.angle[:, :, None]
    direction = _unit(polygon.vertex)
    middle = direction + np.roll(direction, -1, axis=1)
    side, axis = polygon.side[:, :, None], caps.axis[:, None]
    across = _dot(side, axis)
    # A great circle with pole gamma meets the cap iff root > 0; the same root serves the
    # circle's own crossings below, so that the two always agree on whether there are any.
    root = _root(caps.sine[:, None], across)
    reach = np.arctan2(root, caps.cosine[:, None])
    centre = np.arctan2(
        _dot(middle[:, :, None], _cross(axis, side)), _dot(middle[:, :, None], axis)
    )
    start = np.clip(np.where(root > 0, centre - reach, half), -half, half)
    end = np.clip(np.where(root > 0, centre + reach, half), -half, half)
    before, after = _gaps(start, end, -half, half)
    return (after - before).sum(axis=2), np.maximum(end - start, 0).max(axis=2)


def _arcs_inside(polygon: Polygon, normal: np.ndarray, caps: Caps) -> tuple[np.ndarray, np.ndarray]:
    """What is left of the caps' circles inside the polygon and outside the other caps:
    1/2 n . integral of r x dr, and the length [rad], (n,) each.

    With r(phi) = cos(alpha) a + sin(alpha) (cos(phi) b1 + sin(phi) b2).
    """
    axis, sine, cosine = caps.axis, caps.sine[..., None], caps.cosine[..., None]
    b1, b2 = _frame(axis)
    side = polygon.side[:, None]
    across = _dot(side, axis[:, :, None])
    half = np.arctan2(_root(sine, across), cosine * across)
    middle = np.arctan2(-_dot(side, b2[:, :, None]), -_dot(side, b1[:, :, None]))
    if axis.shape[1] > 1:
        other_middle, other_half = _other_caps(caps, b1, b2)
        middle = np.concatenate([middle, other_middle], axis=2)
        half = np.concatenate([half, other_half], axis=2)

    turn = 2 * np.pi
    start = np.mod(middle - half, turn)
    start = np.concatenate([start, start - turn], axis=2)
    end = start + 2 * np.concatenate([half, half], axis=2)
    zero = np.zeros((*axis.shape[:2], 1))
    before, after = _gaps(np.clip(start, 0, turn), np.clip(end, 0, turn), zero, zero + turn)
    arc = after - before

    n = normal[:, None]
    along, n1, n2 = (_dot(n, v)[..., None] for v in (axis, b1, b2))
    mean = 0.5 * (before + after)
    # (sin phi1 - sin phi0, cos phi0 - cos phi1) = 2 sin(arc / 2) (cos mean, sin mean)
    chord = 2 * np.sin(0.5 * arc) * (np.cos(mean) * n1 + np.sin(mean) * n2)
    integral = 0.5 * sine * (sine * along * arc - cosine * chord)
    return integral.sum(axis=(1, 2)), (sine * arc).sum(axis=(1, 2))


def _other_caps(caps: Caps, b1: np.ndarray, b2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, m, m) middle and half-width of the part of circle i that cap j covers [rad].

    The half-width is an angle of the spherical triangle with the sides alpha_i, alpha_j and the
    angle between the axes; from the half-angle formula it keeps its digits in small triangles,
    and is 0 or pi where there is no triangle.
    """
    axis_i, axis_j = caps.axis[:, :, None], caps.axis[:, None]
    normal = _cross(axis_i, axis_j)
    apart = np.arctan2(np.sqrt(_dot(normal, normal)), _dot(axis_i, axis_j))
    angle = np.arctan2(caps.sine, caps.cosine)
    angle_i, angle_j = angle[:, :, None], angle[:, None]
    s = 0.5 * (apart + angle_i + angle_j)
    sin_s, sin_apart, sin_i, sin_j = (
        np.sin(np.maximum(x, 0)) for x in (s, s - apart, s - angle_i, s - angle_j)
    )
    half = 2 * np.arctan2(np.sqrt(sin_apart * sin_i), np.sqrt(sin_s * sin_j))
    middle = np.arctan2(_dot(axis_j, b2[:, :, None]), _dot(axis_j, b1[:, :, None]))

    m = angle.shape[1]
    within = apart + angle_i <= angle_j * (1 + TOUCH)
    later = np.arange(m)[:, None] > np.arange(m)
    within &= later | ~np.swapaxes(within, 1, 2)  # of two equal caps the first one counts
    half = np.where(within, np.pi, np.where(np.swapaxes(within, 1, 2), 0, half))
    half[:, np.arange(m), np.arange(m)] = 0
    return middle, half


def _gaps(
    start: np.ndarray, end: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the k intervals along the last axis leave free of [low, high]: the k + 1 gaps'
    starts and ends, some of length 0."""
    order = np.argsort(start, axis=-1)
    start = np.take_along_axis(start, order, axis=-1)
    reached = np.maximum.accumulate(np.take_along_axis(end, order, axis=-1), axis=-1)
    before = np.concatenate([low, reached], axis=-1)
    return before, np.maximum(np.concatenate([start, high], axis=-1), before)


def _interleaved(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, k, 3) twice -> (n, 2 k, 3): a0, b0, a1, b1, ..."""
    return np.stack([a, b], axis=2).reshape(len(a), -1, 3)


def _root(sine: np.ndarray, across: np.ndarray) -> np.ndarray:
    """sqrt(sin^2 alpha - (gamma . a)^2), 0 where they do not meet."""
    return np.sqrt(np.maximum((sine - across) * (sine + across), 0))


def _frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """b1, b2 with (axis, b1, b2) right-handed and orthonormal (Duff et al., Building an
    Orthonormal Basis, Revisited, JCGT 6(1), 2017)."""
    x, y, z = np.moveaxis(axis, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    b1 = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    b2 = np.stack([b, sign + y * y * a, -y], axis=-1)
    return b1, b2


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """np.cross, several times as fast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.sqrt(_dot(v, v))[..., None]
    return v / np.where(length > 0, length, 1)
