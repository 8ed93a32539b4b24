"""Irradiance from a uniform quad, triangle, disk or sphere light behind spheres and planes, in
closed form.

docs/exact.md derives it. Everything here is a projected solid angle [sr]: the irradiance
[W m^-2] over the light's radiance [W m^-2 sr^-1].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from penumbra.compare.exact.curves import EPS, Cap, Great, Rim
from penumbra.compare.exact.outline import BLUR, ROUNDING, Cut, Part, Region, Within, visible_part
from penumbra.compare.exact.polygon import TOUCH, Caps, Polygon, beside_caps, distance, unoccluded
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.exact.vectors import cross, dot, norm, unit
from penumbra.compare.scene import DiskLight, QuadLight, Scene, Sphere, SphereLight, TriangleLight

SurfaceLight = QuadLight | DiskLight | TriangleLight | SphereLight
CHUNK = 1 << 20
"""Numbers in one temporary array: 8 MiB."""
NOTHING, EDGE, CONE, CUT, AROUND, BEFORE = KINDS = range(6)
"""What an object is to a receiver and a light. EDGE: a plane (or the horizon) through a flat light,
the horizon through a sphere light. CONE: a ball that hides its whole cone. CUT: one that cuts the
light and hides some of it. AROUND: one that shows what it leaves of the light: the receiver
is in it, or it cuts a sphere light beyond its outline. BEFORE: a plane through a sphere light."""


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


def light_view(scene: Scene, light: SurfaceLight, receivers: Receivers) -> LightView:
    """What the receivers see of a light, other objects' shadows included."""
    if isinstance(light, SphereLight):
        return _sphere_view(scene, light, receivers)
    if isinstance(light, DiskLight):
        return _disk_view(scene, light, receivers)
    return _polygon_view(scene, light, receivers)


class _Views:
    """A LightView in the making: hidden everywhere."""

    def __init__(self, n: int) -> None:
        self.value, self.error = np.zeros(n), np.zeros(n)
        self.whole, self.hidden = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)

    def see(self, i: np.ndarray, value: np.ndarray, blocked: np.ndarray) -> None:
        """Receivers i see at most this much, or nothing."""
        self.value[i] = np.where(blocked, 0, value)
        self.whole[i], self.hidden[i] = ~blocked, blocked

    def take(
        self, i: np.ndarray, part: Part, outline: np.ndarray, error: np.ndarray | float = 0
    ) -> None:
        """Receivers i see this part of what they would see. outline: the whole light's [rad];
        error: of it, which a shadow that it all but fills may be off by."""
        least = TOUCH * outline
        dark = part.length <= least
        value = np.clip(part.value, 0, self.value[i])
        self.value[i] = np.where(dark, 0, value)
        self.error[i] += part.error + np.where(dark, value + error, 0)
        self.whole[i] &= part.lost <= least
        self.hidden[i] = dark

    def done(self) -> LightView:
        dark = ~self.hidden & (self.value <= self.error)
        error = self.error + np.where(dark, self.value, 0)
        hidden = self.hidden | dark
        value = np.where(hidden, 0, self.value)
        return LightView(value, error, self.whole & ~hidden, hidden)


# ---------------------------------------------------------------------------------- polygons


def _polygon_view(
    scene: Scene, light: QuadLight | TriangleLight, receivers: Receivers
) -> LightView:
    views = _Views(len(receivers))
    edge_u, edge_v = np.asarray(light.edge_u), np.asarray(light.edge_v)
    ends = [0 * edge_u, edge_u, edge_u + edge_v, edge_v]
    if isinstance(light, TriangleLight):
        del ends[2]
    to_corner = np.asarray(light.corner) - receivers.point
    reach = norm(to_corner) + float(norm(edge_u) + norm(edge_v))
    blur = BLUR * (norm(receivers.point) + reach)
    normal = np.asarray(light.normal)
    facing = np.flatnonzero(to_corner @ normal > TOUCH * reach)
    near = receivers[facing]
    polygon = Polygon.of_corners(to_corner[facing, None] + np.stack(ends))
    perimeter = polygon.angle.sum(axis=1)
    cut = np.zeros(len(near), dtype=bool)
    for towards, offset in _half_spaces(scene, near):
        polygon, was_cut, ignored = polygon.clipped(towards, offset, normal)
        cut |= was_cut
        views.error[facing] += ignored * perimeter
    seen = ~polygon.empty
    index, near, polygon, cut = facing[seen], near[seen], polygon[seen], cut[seen]
    angle = polygon.angle.sum(axis=1)
    views.error[index] += ROUNDING * angle + blur[index] * polygon.sensitivity

    length = norm(polygon.vertex)
    middle = polygon.middle
    cosine = (np.einsum("nki,ni->nk", polygon.vertex, middle) / length).min(axis=1, initial=1)
    flat = _Flat(normal, np.asarray(light.corner), polygon.vertex[:, 0], middle, cosine, polygon)
    state, blocked = _balls(scene, near, flat)
    views.see(index, unoccluded(polygon, near.normal), blocked)
    views.whole[index] &= ~cut
    closed = (state != CUT) & (state != AROUND)
    simple = closed.all(axis=1)
    for which, sphere in _groups(state * simple[:, None], polygon.vertex.shape[1]):
        caps = Caps.of_spheres(scene, near.point[which], sphere[CONE])
        beside = beside_caps(polygon[which], near.normal[which], caps)
        i = index[which]
        error = ROUNDING * (beside.length + beside.lost) + EPS * beside.ends
        error += blur[i] * beside.sensitivity
        views.take(i, Part(beside.value, error, beside.length, beside.lost), angle[which])
    for which, sphere in _groups(state * ~simple[:, None], 4 * polygon.vertex.shape[1]):
        part = _flat_part(
            scene, near[which], sphere, flat[which], blur[index[which]], _edges(polygon[which])
        )
        views.take(index[which], part, angle[which])
    return views.done()


def _edges(polygon: Polygon) -> list[Within]:
    """A polygon's edges as arcs of great circles about their middles."""
    direction, angle, pole = unit(polygon.vertex), polygon.angle, polygon.pole
    middle = direction + np.roll(direction, -1, axis=1)
    far = np.full(len(angle), np.inf)  # the polygon's own sensitivity is counted already
    return [
        Within(Great(polygon.side[:, k], middle[:, k], far, 0.5 * angle[:, k], pole[:, k]))
        for k in range(angle.shape[1])
    ]


def _half_spaces(scene: Scene, receivers: Receivers) -> list[tuple[np.ndarray, np.ndarray]]:
    """(normal, offset) of what the planes and, last, the receivers' horizon leave to be seen:
    normal . x + offset >= 0 for x from the receiver."""
    result = []
    for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
        normal, offset = np.asarray(plane.normal), receivers.point - np.asarray(plane.point)
        height = offset @ normal
        own = receivers.object_id == i
        own |= np.abs(height) <= TOUCH * norm(offset)
        towards = np.where(own[:, None], receivers.normal, np.copysign(1, height)[:, None] * normal)
        result.append((towards, np.where(own, 0, np.abs(height))))
    return [*result, (receivers.normal, np.zeros(len(receivers)))]


# -------------------------------------------------------------------------------- flat lights


@dataclass(frozen=True)
class _Flat:
    """A flat light before n receivers."""

    normal: np.ndarray
    """(3,)"""
    point: np.ndarray
    """(3,) somewhere in its plane: a disk's centre [m]"""
    place: np.ndarray
    """(n, 3) the same or another one, from the receiver [m]"""
    middle: np.ndarray
    """(n, 3) unit vectors to amid it"""
    spread: np.ndarray
    """(n,) cosine of the angle from there within which it is; 0 or less where that is no use"""
    polygon: Polygon | None
    """its corners, of a polygon"""
    radius: float = 0.0
    """of a disk about `point`"""

    def __getitem__(self, which: np.ndarray) -> _Flat:
        polygon = None if self.polygon is None else self.polygon[which]
        place, middle, spread = self.place[which], self.middle[which], self.spread[which]
        return _Flat(self.normal, self.point, place, middle, spread, polygon, self.radius)

    def apart(self, i: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of the light's nearest and farthest place from points, (n, 3) from receivers
        i [m]."""
        if self.polygon is not None:
            polygon = self.polygon[i]
            corners = norm(polygon.vertex - centre[:, None])
            return distance(centre, polygon, self.normal), corners.max(axis=1)
        offset = centre - self.place[i]
        above = offset @ self.normal
        aside = norm(offset - above[:, None] * self.normal)
        nearest = np.hypot(above, np.maximum(aside - self.radius, 0))
        return nearest, np.hypot(above, aside + self.radius)


def _balls(scene: Scene, receivers: Receivers, light: _Flat) -> tuple[np.ndarray, np.ndarray]:
    """What each sphere is to each receiver, (n, spheres); which receivers it hides all from."""
    n = len(receivers)
    state = np.zeros((n, len(scene.spheres)), dtype=np.int8)
    blocked = np.zeros(n, dtype=bool)
    if not n:
        return state, blocked
    sine_spread = np.sqrt(np.maximum(1 - light.spread**2, 0))
    for j, sphere in enumerate(scene.spheres):
        centre, radius = np.asarray(sphere.center), sphere.radius
        to_centre = centre - receivers.point
        apart = norm(to_centre)
        own = receivers.object_id == j
        within = np.where(own, receivers.inside, apart < radius)
        beyond = float(light.normal @ (centre - light.point))
        slack = TOUCH * radius
        if beyond < radius - slack:
            sine = radius / np.maximum(apart, radius)
            cosine = np.sqrt(1 - sine**2)
            # angle(axis, middle) <= half-angle + spread; the 1e-7 covers the square roots above.
            # A wider light than a hemisphere's cap need not be where its corners are.
            reach = cosine * light.spread - sine * sine_spread - 1e-7
            reach = np.where(light.spread > 0, reach, -1)
            i = np.flatnonzero(~own & ~within & (dot(to_centre, light.middle) >= apart * reach))
            if light.polygon is not None:
                sides = light.polygon.side[i]
                i = i[np.einsum("nki,ni->nk", sides, to_centre[i]).min(axis=1) > -radius]
            if beyond <= -radius + slack:
                state[i, j] = CONE
            else:
                state[i, j] = _cut_by(radius, to_centre[i], i, light)
        i = np.flatnonzero(within)
        if len(i):
            from_centre = to_centre[i]
            nearest, farthest = light.apart(i, from_centre)
            blocked[i] |= nearest >= radius
            state[i, j] = np.where(farthest > radius * (1 + TOUCH), AROUND, NOTHING)
    state[blocked] = NOTHING
    return state, blocked


def _cut_by(radius: float, centre: np.ndarray, i: np.ndarray, light: _Flat) -> np.ndarray:
    """What a ball that cuts the light's plane is to receivers i.

    Behind the plane of its tangent circle (centre . x = D^2 - R^2) it hides its whole cone;
    before that plane it hides only what is in it.
    """
    if light.polygon is None:
        return np.full(len(i), CUT)
    ahead = np.einsum("nki,ni->nk", light.polygon.vertex[i], centre)
    polar = (dot(centre, centre) - radius**2)[:, None]
    behind, before = (ahead >= polar).all(axis=1), (ahead <= polar).all(axis=1)
    clear = before & (light.apart(i, centre)[0] >= radius)
    return np.where(behind, CONE, np.where(clear, NOTHING, CUT))


def _groups(state: np.ndarray, curves: int) -> Iterator[tuple[np.ndarray, dict[int, np.ndarray]]]:
    """(which, objects): receivers to which equally many objects are the same, and by what they are
    those objects' columns, (k, m) each; in parts that keep the temporary arrays small."""
    count = np.stack([(state == kind).sum(axis=1) for kind in KINDS[1:]], axis=1)
    for counts in np.unique(count[count.any(axis=1)], axis=0):
        group = np.flatnonzero((count == counts).all(axis=1))
        total = int(counts.sum())
        step = max(1, CHUNK // (6 * total * (curves + total)))
        for start in range(0, len(group), step):
            which = group[start : start + step]
            yield (
                which,
                {
                    kind: np.nonzero(state[which] == kind)[1].reshape(len(which), m)
                    for kind, m in zip(KINDS[1:], counts, strict=True)
                },
            )


def _flat_part(
    scene: Scene,
    receivers: Receivers,
    objects: dict[int, np.ndarray],
    light: _Flat,
    blur: np.ndarray,
    outline: list[Within],
) -> Part:
    """What is left of a flat light's outline. objects: columns of `_balls`, then planes, then the
    horizon."""
    n = len(receivers)
    normal = np.tile(light.normal, (n, 1))
    height = light.place @ light.normal
    windows: list[Region] = []
    shadows: list[Region] = []
    for towards, offset in _picked_planes(scene, receivers, objects[EDGE]):
        # In the light's plane towards . x + offset >= 0 is a half-space through the receiver.
        pole = towards + (offset / height)[:, None] * normal
        slope = dot(towards, normal)
        across = np.maximum(1 - slope**2, TOUCH)
        line = np.sqrt((offset**2 + height**2 + 2 * offset * height * slope) / across)
        windows.append(Within(Great(unit(pole), light.middle, np.where(offset > 0, line, np.inf))))
    for kind in (CONE, CUT, AROUND):
        for centre, radius in _picked_spheres(scene, receivers, objects[kind]):
            above = height - centre @ light.normal
            level = np.sqrt(np.maximum((radius - above) * (radius + above), 0))
            rim = Rim(centre + above[:, None] * normal, normal, level, True)
            if kind == AROUND:
                windows.append(Within(rim))
                continue
            cap = Cap(centre, radius, light.middle)
            shadows.append(Within(cap) if kind == CONE else Cut(cap, rim, False, light.middle))
    return visible_part(receivers.normal, blur, outline, windows, shadows)


def _picked_spheres(
    scene: Scene, receivers: Receivers, columns: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(centre from the receiver, radius) of each receiver's m-th sphere."""
    centres = np.array([s.center for s in scene.spheres]).reshape(-1, 3)
    radii = np.array([s.radius for s in scene.spheres])
    for column in columns.T:
        yield centres[column] - receivers.point, radii[column]


def _picked_planes(
    scene: Scene, receivers: Receivers, columns: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(normal, offset) of each receiver's m-th plane or horizon."""
    towards, offset = (np.stack(a) for a in zip(*_half_spaces(scene, receivers), strict=True))
    every = np.arange(len(receivers))
    for column in (columns - len(scene.spheres)).T:
        yield towards[column, every], offset[column, every]


def _disk_view(scene: Scene, light: DiskLight, receivers: Receivers) -> LightView:
    views = _Views(len(receivers))
    normal, radius = np.asarray(light.normal), light.radius
    centre = np.asarray(light.center) - receivers.point
    reach = norm(centre) + radius
    index = np.flatnonzero(centre @ normal > TOUCH * reach)
    near, centre, reach = receivers[index], centre[index], reach[index]
    blur = BLUR * (norm(near.point) + reach)
    rim = Rim(centre, np.tile(normal, (len(near), 1)), np.full(len(near), radius), True)
    apart = norm(centre)
    sine = radius / np.maximum(apart, radius)
    spread = np.sqrt(1 - sine**2)
    flat = _Flat(normal, np.asarray(light.center), centre, unit(centre), spread, None, radius)
    balls, blocked = _balls(scene, near, flat)
    planes = np.zeros((len(near), len(scene.planes) + 1), dtype=np.int8)
    around = np.tile([-np.pi, np.pi], (len(near), 1))
    low, high = around[:, :1], around[:, 1:]
    outline = rim.length(low, high)[:, 0]
    for i, (towards, offset) in enumerate(_half_spaces(scene, near)):
        height = dot(towards, centre) + offset
        lean = radius * norm(cross(towards, rim.normal))
        touch = TOUCH * (reach + offset)
        counts = (offset > 0) | (i == len(scene.planes))  # else it is the horizon once more
        cuts = height - lean < -touch
        blocked |= counts & cuts & (height + lean <= touch)
        planes[:, i] = np.where(counts & cuts, EDGE, NOTHING)
        ignored = np.where((offset > 0) & ~cuts, np.maximum(lean - height, 0), 0)
        views.error[index] += ignored * rim.shift(low, high)[:, 0]
    state = np.concatenate([balls, planes], axis=1)
    state[blocked] = NOTHING
    # of a disk that the horizon cuts the whole one's integral is no upper bound
    most = np.where((planes == EDGE).any(axis=1), np.pi, rim.whole(near.normal))
    views.see(index, np.maximum(most, 0), blocked)
    alone = (state == NOTHING).all(axis=1) & ~blocked
    error = ROUNDING * outline + blur * rim.shift(low, high)[:, 0]
    views.error[index] += np.where(alone, error, 0)
    for which, objects in _groups(state, 6):
        circle = [Within(rim[which])]
        part = _flat_part(scene, near[which], objects, flat[which], blur[which], circle)
        views.take(index[which], part, outline[which], error[which])
    return views.done()


# ------------------------------------------------------------------------------ sphere lights


def _sphere_view(scene: Scene, light: SphereLight, receivers: Receivers) -> LightView:
    views = _Views(len(receivers))
    radius = light.radius
    centre = np.asarray(light.center) - receivers.point
    index = np.flatnonzero(norm(centre) > radius)
    near, centre = receivers[index], centre[index]
    reach = norm(centre) + radius
    blur = BLUR * (norm(near.point) + reach)
    cap = Cap(centre, np.full(len(near), radius), near.normal, True)
    blocked = np.zeros(len(near), dtype=bool)
    states = []
    for j, sphere in enumerate(scene.spheres):
        state, hides = _ball_and_ball(light, sphere, near, near.object_id == j, cap)
        states.append(state)
        blocked |= hides
    outline = 2 * np.pi * cap.sine
    shift = cap.shift_length * outline
    for i, (towards, offset) in enumerate(_half_spaces(scene, near)):
        height = dot(towards, centre) + offset
        touch = TOUCH * (reach + offset)
        horizon = i == len(scene.planes)
        counts = (offset > 0) | horizon  # else it is the horizon once more
        cuts = height < radius - touch
        blocked |= counts & (height <= touch - radius)
        states.append(np.where(counts & cuts, EDGE if horizon else BEFORE, NOTHING))
        ignored = np.where((offset > 0) & ~cuts, np.maximum(radius - height, 0), 0)
        views.error[index] += ignored * shift
    state = np.stack(states, axis=1)
    state[blocked] = NOTHING
    whole = np.pi * cap.sine**2 * dot(cap.axis, near.normal)
    most = np.where((state == EDGE).any(axis=1), np.pi, whole)
    views.see(index, np.maximum(most, 0), blocked)
    alone = (state == NOTHING).all(axis=1) & ~blocked
    error = ROUNDING * outline + blur * shift
    views.error[index] += np.where(alone, error, 0)
    for which, objects in _groups(state, 6):
        part = _sphere_part(scene, light, near[which], objects, blur[which])
        views.take(index[which], part, outline[which], error[which])
    return views.done()


def _tangent2(centre: np.ndarray, radius: float | np.ndarray) -> np.ndarray:
    """Squared length of the tangents from the receiver to a ball; negative in it [m^2]."""
    apart = norm(centre)
    return np.asarray((apart - radius) * (apart + radius))


def _ball_and_ball(
    light: SphereLight, sphere: Sphere, receivers: Receivers, own: np.ndarray, cap: Cap
) -> tuple[np.ndarray, np.ndarray]:
    """What a sphere is to each receiver of a sphere light, and whether it hides all of it.
    cap: the light's outline."""
    nothing, never = np.full(len(own), NOTHING), np.zeros(len(own), dtype=bool)
    radius, big = sphere.radius, light.radius
    centre = np.asarray(sphere.center) - receivers.point
    gap = float(norm(np.asarray(sphere.center) - np.asarray(light.center)))
    apart = norm(centre)
    within = np.where(own, receivers.inside, apart < radius)
    slack = TOUCH * (radius + big)
    if gap + big <= radius + slack:  # the light is in the ball
        return nothing, ~within
    if gap + radius <= big + slack:  # the ball is in the light
        return nothing, never
    nearer = _tangent2(centre, radius) < _tangent2(cap.centre, big)
    sine = radius / np.maximum(apart, radius)
    cosine = np.sqrt(1 - sine**2)
    # angle between the axes <= both half-angles; the 1e-7 covers the square roots above
    reach = np.maximum(cosine * cap.cosine - sine * cap.sine - 1e-7, -1)
    meets = ~own & ~within & (dot(centre, cap.axis) >= apart * reach)
    if gap >= radius + big - slack:  # beside it
        return np.where(meets & nearer, CONE, NOTHING), within
    return np.where(within | meets & ~nearer, AROUND, np.where(meets, CUT, NOTHING)), never


def _sphere_part(
    scene: Scene,
    light: SphereLight,
    receivers: Receivers,
    objects: dict[int, np.ndarray],
    blur: np.ndarray,
) -> Part:
    """What is left of a sphere light's outline. objects: columns of the spheres, then the planes,
    then the horizon."""
    n = len(receivers)
    to_light = np.asarray(light.center) - receivers.point
    radius = np.full(n, light.radius)
    middle = unit(to_light)
    outline = Cap(to_light, radius, receivers.normal, True)
    windows: list[Region] = []
    shadows: list[Region] = []
    for towards, _ in _picked_planes(scene, receivers, objects[EDGE]):
        windows.append(Within(Great(towards, middle, np.full(n, np.inf))))
    for towards, offset in _picked_planes(scene, receivers, objects[BEFORE]):
        height = dot(towards, to_light) + offset
        level = np.sqrt(np.maximum((radius - height) * (radius + height), 0))
        rim = Rim(to_light - height[:, None] * towards, -towards, level, False)
        windows.append(Cut(outline, rim, True, middle))
    for kind in (CONE, CUT, AROUND):
        for centre, other in _picked_spheres(scene, receivers, objects[kind]):
            cap = Cap(centre, other, middle) if kind != AROUND else outline
            if kind == CONE:
                shadows.append(Within(cap))
                continue
            # The surfaces meet where |X|^2 - 2 X . O + tau_o^2 = |X|^2 - 2 X . L + tau_l^2.
            axis = to_light - centre
            gap = norm(axis)
            axis /= gap[:, None]
            along = 0.5 * (gap + (other - radius) * (other + radius) / gap)
            level = np.sqrt(np.maximum((other - along) * (other + along), 0))
            nearer = _tangent2(centre, other) < _tangent2(to_light, radius)
            away = np.where(nearer, 1, -1)[:, None] * axis
            rim = Rim(centre + along[:, None] * axis, away, level, False)
            if kind == AROUND:
                windows.append(Cut(outline, rim, True, middle))
            else:
                shadows.append(Cut(cap, rim, False, middle))
    return visible_part(receivers.normal, blur, [Within(outline)], windows, shadows)
