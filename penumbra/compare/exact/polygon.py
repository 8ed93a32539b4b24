"""Convex polygons seen by many receivers at once: Lambert's sum, clipping, and caps beside.

docs/exact.md derives it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from penumbra.compare.exact.curves import EPS
from penumbra.compare.exact.vectors import cross, dot, frame, norm, unit
from penumbra.compare.scene import Scene

TOUCH = 1e-12
"""Lengths relative to the distances that they are differences of, and angles [rad], below
which rounding decides: a light that lies in a plane is not behind it, a light that stands on
the receiver's plane is not below its horizon, a sliver that thin hides or shows nothing."""


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
        side = unit(cross(vertex, edge))
        return Polygon(vertex, side, np.zeros(len(vertex), dtype=bool))

    def __getitem__(self, which: np.ndarray) -> Polygon:
        return Polygon(self.vertex[which], self.side[which], self.empty[which])

    @cached_property
    def middle(self) -> np.ndarray:
        """(n, 3) unit vectors to somewhere amid each polygon"""
        return unit(unit(self.vertex).sum(axis=1))

    @cached_property
    def angle(self) -> np.ndarray:
        """(n, K) the angle that each edge subtends [rad]"""
        after = np.roll(self.vertex, -1, axis=1)
        moment = cross(self.vertex, after - self.vertex)
        return np.arctan2(np.sqrt(dot(moment, moment)), dot(self.vertex, after))

    @cached_property
    def pole(self) -> np.ndarray:
        """(n, K, 3) as `side`, but of the corners as they are: with any other pole than that of
        the corners whose angle it multiplies the edges' sum would be off by the ratio of a light's
        distance to its width."""
        return unit(cross(self.vertex, np.roll(self.vertex, -1, axis=1) - self.vertex))

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """(n,) the most that the projected solid angle changes with the outline's places [m^-1]:
        the integral of |dr| / |X|, at most that of |dX| / X^2, theta over each line's distance."""
        edge = np.roll(self.vertex, -1, axis=1) - self.vertex
        moment = cross(self.vertex, edge)
        sine = np.sqrt(dot(moment, moment))
        length, angle = np.sqrt(dot(edge, edge)), self.angle
        after = np.roll(self.vertex, -1, axis=1)
        product = np.sqrt(dot(self.vertex, self.vertex) * dot(after, after))
        # an edge that points at the receiver: theta / sin(theta) = 1
        ratio = np.where(sine > EPS * product, angle / np.maximum(sine, EPS * product), 1 / product)
        return np.asarray((length * ratio).sum(axis=1))

    def clipped(
        self, normal: np.ndarray, offset: np.ndarray, light_normal: np.ndarray
    ) -> tuple[Polygon, np.ndarray, np.ndarray]:
        """The parts where normal . x + offset >= 0 (Sutherland-Hodgman, all at once), which
        polygons lost something, and how wide a sliver counted as none [rad]. normal: (n, 3);
        offset: (n,) >= 0.
        """
        height = np.einsum("nki,ni->nk", self.vertex, normal) + offset[:, None]
        distance = norm(self.vertex)
        near = np.abs(height) <= TOUCH * (distance + offset[:, None])
        # what is that low over the horizon lights by its cosine, so by the square
        ignored = np.where(near, np.abs(height) / distance, 0).max(axis=1) * (offset > 0)
        height[near] = 0
        lost = (height < 0).any(axis=1)
        gone = lost & ~(height > 0).any(axis=1)
        crosses = np.flatnonzero(lost & ~gone & ~self.empty)
        if not len(crosses):
            return Polygon(self.vertex, self.side, self.empty | gone), lost, ignored

        part, height = self[crosses], height[crosses]
        after, height_after = np.roll(part.vertex, -1, axis=1), np.roll(height, -1, axis=1)
        inside, inside_after = height >= 0, height_after >= 0
        crossing = inside != inside_after
        fraction = height / np.where(crossing, height - height_after, 1)
        cut = part.vertex + fraction[..., None] * (after - part.vertex)
        through_receiver = (offset[crosses] == 0)[:, None, None]
        along = np.cross(normal[crosses], light_normal)[:, None]
        new_side = np.where(through_receiver, normal[crosses, None], unit(cross(cut, along)))

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
        return Polygon(result.vertex, result.side, self.empty | gone), lost, ignored

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
    sensitivity: np.ndarray
    """(n, m) bound on how much a projected solid angle changes with the places, for each radian
    of the circles [m^-1]"""

    @staticmethod
    def of_spheres(scene: Scene, point: np.ndarray, sphere: np.ndarray) -> Caps:
        """sphere: (n, m) indices into scene.spheres."""
        centre = np.array([s.center for s in scene.spheres])[sphere]
        radius = np.array([s.radius for s in scene.spheres])[sphere]
        axis = centre - point[:, None]
        distance = np.sqrt(dot(axis, axis))
        tangent = np.sqrt(np.maximum((distance - radius) * (distance + radius), 0))
        sine, near = radius / distance, np.maximum(tangent, EPS * distance) * distance
        return Caps(
            axis=axis / distance[..., None],
            sine=sine,
            cosine=tangent / distance,
            sensitivity=(tangent + radius) / near,
        )


def unoccluded(polygon: Polygon, normal: np.ndarray) -> np.ndarray:
    """Lambert: 1/2 sum_k theta_k (gamma_k . n)"""
    cosine = np.einsum("nki,ni->nk", polygon.pole, normal)
    return np.maximum(0.5 * (polygon.angle * cosine).sum(axis=1), 0)


def distance(point: np.ndarray, polygon: Polygon, normal: np.ndarray) -> np.ndarray:
    """From points (n, 3) to polygons with that normal [m]."""
    edge = np.roll(polygon.vertex, -1, axis=1) - polygon.vertex
    offset = point[:, None] - polygon.vertex
    over = (dot(cross(normal, edge), offset) >= 0).all(axis=1)
    squared = dot(edge, edge)
    t = np.clip(dot(offset, edge) / np.where(squared > 0, squared, 1), 0, 1)
    to_edge = offset - t[..., None] * edge
    return np.where(over, np.abs(offset[:, 0] @ normal), np.sqrt(dot(to_edge, to_edge)).min(axis=1))


@dataclass(frozen=True)
class Beside:
    """The parts of n polygons outside of caps."""

    value: np.ndarray
    """(n,) projected solid angle [sr]"""
    length: np.ndarray
    """(n,) of the outline [rad]"""
    lost: np.ndarray
    """(n,) the most that a cap hides of each edge, plus the caps' arcs [rad]"""
    ends: np.ndarray
    """(n,) how many pieces of the outline end at a crossing"""
    sensitivity: np.ndarray
    """(n,) the caps' part in how the value changes with the places [m^-1]"""


def beside_caps(polygon: Polygon, normal: np.ndarray, caps: Caps) -> Beside:
    """The part of each polygon outside m caps.

    Stokes: 1/2 n . integral of r x dr over what the caps leave of the edges and, turning the
    other way, over what the polygon and the other caps leave of each cap's circle.
    """
    shown, hidden, cuts = _edges_outside(polygon, caps)
    arcs, arc_length, pieces = _arcs_inside(polygon, normal, caps)
    cosine = np.einsum("nki,ni->nk", polygon.pole, normal)
    edges = 0.5 * (shown * cosine).sum(axis=1)
    drawn = arc_length.sum(axis=1)
    return Beside(
        value=edges - arcs,
        length=shown.sum(axis=1) + drawn,
        lost=hidden.sum(axis=1) + drawn,
        ends=cuts + pieces,
        sensitivity=(caps.sensitivity * arc_length).sum(axis=1),
    )


def _edges_outside(polygon: Polygon, caps: Caps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, K) how much of each edge the caps leave, and the most that one of them hides [rad];
    (n,) how many pieces are cut."""
    half = 0.5 * polygon.angle[:, :, None]
    direction = unit(polygon.vertex)
    middle = direction + np.roll(direction, -1, axis=1)
    side, axis = polygon.side[:, :, None], caps.axis[:, None]
    across = dot(side, axis)
    # A great circle with pole gamma meets the cap iff root > 0; the same root serves the
    # circle's own crossings below, so that the two always agree on whether there are any.
    root = _root(caps.sine[:, None], across)
    reach = np.arctan2(root, caps.cosine[:, None])
    centre = np.arctan2(dot(middle[:, :, None], cross(axis, side)), dot(middle[:, :, None], axis))
    start = np.clip(np.where(root > 0, centre - reach, half), -half, half)
    end = np.clip(np.where(root > 0, centre + reach, half), -half, half)
    before, after = _gaps(start, end, -half, half)
    hidden = np.maximum(end - start, 0).max(axis=2)
    cuts = ((after > before) & (hidden > 0)[:, :, None]).sum(axis=(1, 2))
    return (after - before).sum(axis=2), hidden, cuts


def _arcs_inside(
    polygon: Polygon, normal: np.ndarray, caps: Caps
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is left of the caps' circles inside the polygon and outside the other caps:
    1/2 n . integral of r x dr, (n,), its length [rad], (n, m), and how many arcs it is, (n,).

    With r(phi) = cos(alpha) a + sin(alpha) (cos(phi) b1 + sin(phi) b2).
    """
    axis, sine, cosine = caps.axis, caps.sine[..., None], caps.cosine[..., None]
    b1, b2 = frame(axis)
    side = polygon.side[:, None]
    across = dot(side, axis[:, :, None])
    half = np.arctan2(_root(sine, across), cosine * across)
    middle = np.arctan2(-dot(side, b2[:, :, None]), -dot(side, b1[:, :, None]))
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
    along, n1, n2 = (dot(n, v)[..., None] for v in (axis, b1, b2))
    mean = 0.5 * (before + after)
    # (sin phi1 - sin phi0, cos phi0 - cos phi1) = 2 sin(arc / 2) (cos mean, sin mean)
    chord = 2 * np.sin(0.5 * arc) * (np.cos(mean) * n1 + np.sin(mean) * n2)
    integral = 0.5 * sine * (sine * along * arc - cosine * chord)
    return integral.sum(axis=(1, 2)), (sine * arc).sum(axis=2), (arc > 0).sum(axis=(1, 2))


def _other_caps(caps: Caps, b1: np.ndarray, b2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, m, m) middle and half-width of the part of circle i that cap j covers [rad].

    The half-width is an angle of the spherical triangle with the sides alpha_i, alpha_j and the
    angle between the axes; from the half-angle formula it keeps its digits in small triangles,
    and is 0 or pi where there is no triangle.
    """
    axis_i, axis_j = caps.axis[:, :, None], caps.axis[:, None]
    normal = cross(axis_i, axis_j)
    apart = np.arctan2(np.sqrt(dot(normal, normal)), dot(axis_i, axis_j))
    angle = np.arctan2(caps.sine, caps.cosine)
    angle_i, angle_j = angle[:, :, None], angle[:, None]
    s = 0.5 * (apart + angle_i + angle_j)
    sin_s, sin_apart, sin_i, sin_j = (
        np.sin(np.maximum(x, 0)) for x in (s, s - apart, s - angle_i, s - angle_j)
    )
    half = 2 * np.arctan2(np.sqrt(sin_apart * sin_i), np.sqrt(sin_s * sin_j))
    middle = np.arctan2(dot(axis_j, b2[:, :, None]), dot(axis_j, b1[:, :, None]))

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
