"""The exact image is right: against published values, other formulas, and the definition.

Quantities are projected solid angles [sr], irradiance over radiance, unless they say otherwise.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

from penumbra.compare.exact.image import (
    BACKGROUND,
    LIT,
    PENUMBRA,
    UMBRA,
    ExactImage,
    exact_image,
    regions,
)
from penumbra.compare.exact.irradiance import LightView, light_view
from penumbra.compare.exact.receivers import Receivers, camera_hits
from penumbra.compare.scene import Camera, Plane, PointLight, QuadLight, Scene, Sphere, read_scene
from tests.slices import by_slices

SCENES = Path(__file__).resolve().parent.parent / "scenes"
WHITE = (1.0, 1.0, 1.0)
UP = np.array([0.0, 1.0, 0.0])
FLOOR = ((0, -1, 0), (0, 1, 0))
"""point, normal"""


def quad(corner, edge_u, edge_v) -> QuadLight:
    corner, edge_u, edge_v = (np.asarray(v, dtype=float) for v in (corner, edge_u, edge_v))
    normal = np.cross(edge_u, edge_v)
    area = float(np.linalg.norm(normal))
    vectors = (tuple(map(float, v)) for v in (corner, edge_u, edge_v, normal / area))
    return QuadLight("quad", *vectors, area, WHITE)


def scene_of(spheres=(), planes=(), quads=(), points=()) -> Scene:
    """spheres: (center, radius) pairs; planes: (point, normal) pairs. Camera as in tp3."""
    return Scene(
        name="made",
        width=60,
        height=40,
        camera=Camera((0, 0, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), 60.0),
        background_radiance=(0.5, 0.25, 0.125),
        ray_max_distance=100.0,
        spheres=tuple(
            Sphere(f"s{i}", tuple(map(float, c)), float(r), WHITE)
            for i, (c, r) in enumerate(spheres)
        ),
        planes=tuple(
            Plane(f"p{i}", tuple(map(float, p)), tuple(np.asarray(n) / np.linalg.norm(n)), WHITE)
            for i, (p, n) in enumerate(planes)
        ),
        point_lights=tuple(points),
        quad_lights=tuple(quads),
    )


def on_floor(scene: Scene, points) -> Receivers:
    """Receivers looking up on the scene's first plane."""
    points = np.asarray(points, dtype=float)
    n = len(points)
    return Receivers(
        np.full(n, len(scene.spheres)),
        points,
        np.tile([0.0, 1.0, 0.0], (n, 1)),
        np.zeros(n, dtype=bool),
    )


def view_of(scene: Scene, receivers: Receivers) -> LightView:
    return light_view(scene, scene.quad_lights[0], receivers)


# ---------------------------------------------------------------- published and derived values


def test_irradiance_under_tp3_matches_the_published_table():
    """Irradiance times brdf 1 under tp3's quad (radiance 40) at eight floor points (x, -2, z),
    from the integral of cos cos / d^2 with 4 million points each, then from Stokes' theorem by
    another program; given to eight digits, so to 0.5e-8."""
    table = {
        (0, 1.8): 0.54903358,
        (0.3, 1.7): 0.89020111,
        (-1, 2): 1.01930774,
        (1.3, 3): 0.79775183,
        (0.2, 4.3): 0.83866906,
        (3, 3): 0.97721693,
        (0, 3): 0.0,
        (-0.7, 4.1): 0.84399234,
    }
    scene = read_scene(SCENES / "tp3.json")
    view = view_of(scene, on_floor(scene, [(x, -2, z) for x, z in table]))
    np.testing.assert_allclose(40 * view.projected_solid_angle, list(table.values()), atol=0.5e-8)


def test_penumbra_of_tp3_matches_thirty_digits():
    """The floor under tp3, integrated with mpmath: with x the distance along the light from the
    receiver, z across it and h = 12 the height, the integrand is h^2 / (x^2 + z^2 + h^2)^2. Each
    line of constant z is integrated exactly outside the roots of the sphere's quadratic; across,
    tanh-sinh between the places where the quadratic's roots meet each other or the light's ends.
    """
    scene = read_scene(SCENES / "tp3.json")
    points = [(0.3, -2, 1.7), (1.3, -2, 3.0), (-0.7, -2, 4.1)]
    view = view_of(scene, on_floor(scene, points))
    for point, value, bound in zip(
        points, view.projected_solid_angle, view.error_bound, strict=True
    ):
        assert abs(value - _tp3_floor(point)) <= bound < 3e-14


def _tp3_floor(point) -> mp.mpf:
    with mp.workdps(30):
        x0, _, z0 = (mp.mpf(c) for c in point)
        h, left, right, front, back = mp.mpf(12), -1 - x0, 1 - x0, 2 - z0, 4 - z0
        cx, cy, cz = -x0, mp.mpf(2), 3 - z0  # the sphere's centre from the receiver, radius 1
        polar = cx**2 + cy**2 + cz**2 - 1

        # (c.p)^2 - polar p.p >= 0 for p = (x, h, z): a x^2 + 2 b(z) x + c(z)
        a = cx**2 - polar

        def roots(z):
            dot = cy * h + cz * z
            b, c = cx * dot, dot**2 - polar * (h**2 + z**2)
            square = b**2 - a * c
            return (
                sorted([(-b - mp.sqrt(square)) / a, (-b + mp.sqrt(square)) / a])
                if (square > 0)
                else None
            )

        def line(z):
            k = mp.sqrt(z**2 + h**2)

            def part(low, high):
                def primitive(x):
                    return x / (2 * k**2 * (x**2 + k**2)) + mp.atan(x / k) / (2 * k**3)

                return primitive(high) - primitive(low) if high > low else mp.mpf(0)

            shadow = roots(z)
            if shadow is None:
                return part(left, right)
            return part(left, min(right, shadow[0])) + part(max(left, shadow[1]), right)

        # The discriminant in z, and the cone's equation at x = left and right, are quadratics.
        def zeros(f):
            c, p, m = f(mp.mpf(0)), f(mp.mpf(1)), f(mp.mpf(-1))
            a, b = (p + m) / 2 - c, (p - m) / 4
            return [(-b + s * mp.sqrt(b**2 - a * c)) / a for s in (-1, 1)] if b**2 > a * c else []

        def discriminant(z):
            dot = cy * h + cz * z
            return (cx * dot) ** 2 - a * (dot**2 - polar * (h**2 + z**2))

        ends = {front, back}
        for f in (
            discriminant,
            lambda z: (cx * left + cy * h + cz * z) ** 2 - polar * (left**2 + h**2 + z**2),
            lambda z: (cx * right + cy * h + cz * z) ** 2 - polar * (right**2 + h**2 + z**2),
        ):
            ends |= {z for z in zeros(f) if front < z < back}
        return h**2 * mp.quad(line, sorted(ends))


@pytest.mark.parametrize("below", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("distance", [10.0, 1.0, 1e-2, 1e-5])
def test_upright_light_matches_the_perpendicular_view_factor(distance, below):
    """A rectangle of height a and width b in the plane x = c, upright on the floor, seen from a
    floor element opposite its lower corner: E = 1/2 [atan(b / c) - c / r atan(b / r)], r^2 =
    a^2 + c^2 (Howell's catalogue of view factors, times pi). What the light has below the floor
    (`below`) is below the horizon and adds nothing."""
    a, b, c = 1.5, 0.7, distance
    light = quad((c, -1 - below, 0), (0, a + below, 0), (0, 0, b))
    scene = scene_of(planes=[FLOOR], quads=[light])
    view = view_of(scene, on_floor(scene, [(0, -1, 0)]))
    r = math.hypot(a, c)
    expected = 0.5 * (math.atan(b / c) - c / r * math.atan(b / r))
    assert abs(view.projected_solid_angle[0] - expected) <= view.error_bound[0] + 1e-15
    assert view.whole[0] == (below == 0)


def test_light_that_fills_the_sky_gives_pi():
    """A square of half-side s at height 1 misses less than pi / s^2 of the hemisphere's pi: what
    is outside the inscribed disc, pi / (1 + s^2)."""
    light = quad((1e4, 0, -1e4), (-2e4, 0, 0), (0, 0, 2e4))
    scene = scene_of(planes=[FLOOR], quads=[light])
    view = view_of(scene, on_floor(scene, [(0, -1, 0)]))
    assert math.pi * (1 - 1e-8) < view.projected_solid_angle[0] < math.pi


@pytest.mark.parametrize("radius", [1e-6, 1e-3, 0.3])
def test_small_sphere_amid_a_wide_light_hides_its_own_cone(radius):
    """The circle lies inside the polygon: what is hidden is the cone's projected solid angle,
    pi sin(alpha)^2 cos(axis, normal), sin(alpha) = R / D."""
    light = quad((10, 9, -10), (-20, 0, 0), (0, 0, 20))
    centre = np.array([0.3, 4.0, 0.2])
    free, shaded = scene_of([], [FLOOR], [light]), scene_of([(centre, radius)], [FLOOR], [light])
    points = [(0, -1, 0)]
    before, after = view_of(free, on_floor(free, points)), view_of(shaded, on_floor(shaded, points))
    to_centre = centre - points[0]
    distance = np.linalg.norm(to_centre)
    hidden = math.pi * (radius / distance) ** 2 * to_centre[1] / distance
    difference = before.projected_solid_angle - after.projected_solid_angle
    assert abs(difference[0] - hidden) <= before.error_bound[0] + after.error_bound[0]
    assert before.whole[0] and not after.whole[0]


@pytest.mark.parametrize("radius", [0.01, 0.5, 2.9])
def test_half_sunk_sphere_hides_a_circular_segment(radius):
    """A sphere centred at the receiver's level, before a wall of light: the upper half of its cone
    of half-angle alpha is hidden. Seen from above the half-cap covers the segment x >= cos(alpha)
    of the unit disc: alpha - sin(alpha) cos(alpha)."""
    light = quad((20, -500, -500), (0, 1000, 0), (0, 0, 1000))
    free, shaded = (
        scene_of([], [FLOOR], [light]),
        scene_of([((3, -1, 0), radius)], [FLOOR], [light]),
    )
    points = [(0, -1, 0)]
    before, after = view_of(free, on_floor(free, points)), view_of(shaded, on_floor(shaded, points))
    alpha = math.asin(radius / 3)
    difference = before.projected_solid_angle - after.projected_solid_angle
    expected = alpha - math.sin(alpha) * math.cos(alpha)
    bound = before.error_bound[0] + after.error_bound[0]
    assert abs(difference[0] - expected) <= bound + 1e-15


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6, 1e-9])
def test_small_lights_keep_their_digits(size):
    """A square of side s at height 1 straight above: Lambert's formula for its four edges is
    E = 4 (s/2) / sqrt(1 + s^2/4) atan((s/2) / sqrt(1 + s^2/4)), here without any difference of
    nearby numbers. The bound is 3.6e-15 of the perimeter 4 s, and 4.4e-16 of it for each metre of
    the coordinates, here up to 4: under 2.5e-14 / s of E = s^2."""
    light = quad((size / 2, 0, -size / 2), (-size, 0, 0), (0, 0, size))
    scene = scene_of(planes=[FLOOR], quads=[light])
    view = view_of(scene, on_floor(scene, [(0, -1, 0)]))
    q = (size / 2) / math.sqrt(1 + size**2 / 4)
    assert abs(view.projected_solid_angle[0] - 4 * q * math.atan(q)) <= view.error_bound[0]
    assert view.error_bound[0] < 2.5e-14 * size
    assert view.whole[0] and not view.hidden[0]


# ---------------------------------------------------------------- random and adversarial scenes


def receivers_on(rng: np.random.Generator, scene: Scene, n: int) -> Receivers:
    """n random points on the scene's objects; one in ten on a sphere is on its inside."""
    objects = rng.integers(0, len(scene.objects), n)
    point, normal, inside = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, dtype=bool)
    for i, which in enumerate(objects):
        thing = scene.objects[which]
        if isinstance(thing, Sphere):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            inside[i] = rng.random() < 0.1
            point[i] = thing.center + thing.radius * direction
            normal[i] = -direction if inside[i] else direction
        else:
            across = 3 * rng.normal(size=3)
            n_plane = np.asarray(thing.normal)
            point[i] = thing.point + across - n_plane * (n_plane @ across)
            normal[i] = n_plane if rng.random() < 0.8 else -n_plane
    return Receivers(objects, point, normal, inside)


def random_case(rng):
    """Up to 15 spheres of 0.06 to 2 m, sheared lights of 0.1 to 5 m, up to three planes."""
    n = rng.integers(0, 7) if rng.random() < 0.8 else rng.integers(7, 16)
    spheres = [(2 * rng.normal(size=3) + UP, 10 ** rng.uniform(-1.2, 0.3)) for _ in range(n)]
    planes = [FLOOR]
    planes += [(2 * rng.normal(size=3), rng.normal(size=3)) for _ in range(rng.integers(0, 3))]
    size = 10 ** rng.uniform(-1, 0.7)
    light = quad(
        2 * rng.normal(size=3) + 3 * UP, size * rng.normal(size=3), size * rng.normal(size=3)
    )
    scene = scene_of(spheres, planes, [light])
    return scene, receivers_on(rng, scene, 100)


def lattice_case(rng):
    """Everything on small whole or half numbers: tangencies, coplanar lights and planes, lights
    standing on the floor, equal and touching spheres happen exactly."""

    def lattice(n=3):
        return rng.integers(-3, 4, n).astype(float)

    spheres = [(lattice() + UP, rng.integers(1, 4) / 2) for _ in range(rng.integers(1, 6))]
    planes = [FLOOR, ((0, 4, 0), (0, 1, 0))][: rng.integers(1, 3)]
    edge_u, edge_v = (-2.0, 0, 0), (0, 0, 2.0)
    corner = lattice() + 4 * UP
    if rng.random() < 0.3:
        corner[1] = 4
    elif rng.random() < 0.3:
        edge_u, corner[1] = (0, 2.0, 0), -1
    scene = scene_of(spheres, planes, [quad(corner, edge_u, edge_v)])
    receivers = receivers_on(rng, scene, 100)
    point, normal = receivers.point, receivers.normal
    for i, which in enumerate(receivers.object_id):
        thing = scene.objects[which]
        if isinstance(thing, Sphere):
            directions = [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, 0.8, 0), (0, 0.6, -0.8)]
            direction = np.array(directions[rng.integers(5)]) * rng.choice([-1.0, 1.0])
            point[i] = thing.center + thing.radius * direction
            normal[i] = -direction if receivers.inside[i] else direction
        else:
            point[i] = (rng.integers(-6, 7) / 2, thing.point[1], rng.integers(-6, 7) / 2)
    return scene, receivers


def contact_case(rng):
    """A sphere on the floor; receivers on both within 1e-6 radii of where they touch."""
    radius = 10 ** rng.uniform(-2, 1)
    light = quad(3 * rng.normal(size=3) + 4 * UP, rng.normal(size=3), rng.normal(size=3))
    scene = scene_of([((0, radius - 1, 0), radius)], [FLOOR], [light])
    receivers = receivers_on(rng, scene, 100)
    for i in range(100):
        angle, turn = 10 ** rng.uniform(-6, 0), rng.uniform(0, 2 * np.pi)
        around = np.array([np.cos(turn), 0, np.sin(turn)])
        if receivers.object_id[i]:
            receivers.point[i] = radius * angle * around - UP
            receivers.normal[i] = (0, 1, 0)
        else:
            direction = np.sin(angle) * around - np.cos(angle) * UP
            receivers.point[i] = scene.spheres[0].center + radius * direction
            receivers.normal[i] = direction
    return scene, dataclasses.replace(receivers, inside=np.zeros(100, dtype=bool))


def small_case(rng):
    """A light of 1e-9 to 1 m, metres away, behind spheres of its size or behind the edge of
    spheres of 0.1 to 1 m; receivers as far apart as the light is large."""
    k = 10 ** rng.uniform(-9, 0)
    spheres = []
    for _ in range(rng.integers(1, 4)):
        if rng.random() < 0.5:
            centre = rng.normal(size=3) * (k, 0.5, k) + UP
            spheres.append((centre, k * 10 ** rng.uniform(-0.5, 0.5)))
        else:
            radius, turn = 10 ** rng.uniform(-1, 0), rng.uniform(0, 2 * np.pi)
            sine = radius / 2 + 0.2 * k * rng.normal()
            aside = sine * np.array([np.cos(turn), 0, np.sin(turn)])
            spheres.append((2 * (aside + math.sqrt(1 - (radius / 2) ** 2) * UP) - UP, radius))
    light = quad(k * rng.normal(size=3) + 4 * UP, k * rng.normal(size=3), k * rng.normal(size=3))
    scene = scene_of(spheres, [FLOOR], [light])
    return scene, on_floor(scene, 3 * k * rng.normal(size=(100, 3)) * (1, 0, 1) - UP)


def off_other_surfaces(scene: Scene, receivers: Receivers) -> Receivers:
    """Leaves out receivers that lie on another sphere too: which side they are on is rounding."""
    keep = np.ones(len(receivers), dtype=bool)
    for i, sphere in enumerate(scene.spheres):
        distance = np.linalg.norm(receivers.point - sphere.center, axis=1)
        close = np.abs(distance - sphere.radius) <= 1e-12 * sphere.radius
        keep &= ~close | (receivers.object_id == i)
    return receivers[keep]


@pytest.mark.parametrize("case", [random_case, small_case])
def test_closed_form_is_the_definition_slice_by_slice(case):
    """One receiver that sees part of the light in each of four scenes; all in the flags' sense."""
    seen = 0
    for seed in range(4):
        scene, receivers = case(np.random.default_rng(seed))
        receivers = off_other_surfaces(scene, receivers)
        view = view_of(scene, receivers)
        assert not (view.whole & view.hidden).any()
        assert np.all(view.projected_solid_angle[view.hidden] == 0)
        some = np.flatnonzero(~view.whole & ~view.hidden)[:1]
        value, error = by_slices(scene, scene.quad_lights[0], receivers[some], 1e-16, 96)
        off = np.abs(view.projected_solid_angle[some] - value).astype(float)
        assert np.all(off <= view.error_bound[some] + error), (seed, some)
        seen += len(some)
    assert seen >= 2


@pytest.mark.parametrize("case", [random_case, lattice_case, contact_case])
def test_closed_form_agrees_with_the_definition(case):
    """The mean of area V cos cos / d^2 over points drawn on the light, each shadow ray tested
    against each object's equation. By Bernstein's inequality a mean of n values in [0, m] is off
    by more than sqrt(2 E m L / n) + m L / (3 n) with a probability under 2 exp(-L) (their
    variance is under m E); L = 23 makes that 2e-10 for each of the 1,000 receivers."""
    n, log = 4000, 23
    for seed in range(10):
        rng = np.random.default_rng(1000 + seed)
        scene, receivers = case(rng)
        receivers = off_other_surfaces(scene, receivers)
        view = view_of(scene, receivers)
        for i in range(len(receivers)):
            mean, most = _by_definition(rng, scene, receivers[i : i + 1], n)
            expected = view.projected_solid_angle[i]
            limit = math.sqrt(2 * expected * most * log / n) + most * log / (3 * n)
            assert abs(mean - expected) <= limit, (seed, i)


CORNERS = np.array([[0, 0, 1, 1], [0, 1, 0, 1]]) * (1 - 2e-6) + 1e-6
"""s and t just inside the light: a receiver may lie on its corner"""


def _by_definition(rng, scene, receiver, n) -> tuple[float, float]:
    """The mean of n samples, and the largest value, the corners' included, without shadows."""
    light, point = scene.quad_lights[0], receiver.point[0]
    s, t = np.concatenate([rng.random((2, n)), CORNERS], axis=1)[..., None]
    to_light = light.corner + s * np.asarray(light.edge_u) + t * np.asarray(light.edge_v) - point
    squared = np.sum(to_light**2, axis=1)
    cosines = np.maximum(to_light @ receiver.normal[0], 0) * np.maximum(to_light @ light.normal, 0)
    sample = light.area * cosines / squared**2
    visible = np.ones(n + 4, dtype=bool)
    for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
        if i != receiver.object_id[0]:
            start = np.dot(point - np.asarray(plane.point), plane.normal)
            end = start + to_light @ plane.normal
            visible &= ~((start * end < 0) & (np.abs(end) > 1e-12))
    for sphere in scene.spheres:
        # |point + x to_light - centre|^2 = R^2 between the two ends, exclusive
        offset = point - np.asarray(sphere.center)
        b = to_light @ offset
        discriminant = b**2 - squared * (offset @ offset - sphere.radius**2)
        root = np.sqrt(np.maximum(discriminant, 0))
        for x in ((-b - root) / squared, (-b + root) / squared):
            visible &= ~((discriminant > 0) & (x > 1e-9) & (x < 1))
    return float(np.mean((sample * visible)[:n])), float(sample.max())


# ---------------------------------------------------------------- symmetries


def test_two_halves_of_a_light_add_up():
    for seed in range(20):
        scene, receivers = random_case(np.random.default_rng(seed))
        light = scene.quad_lights[0]
        corner, u, v = (np.asarray(x) for x in (light.corner, light.edge_u, light.edge_v))
        halves = [
            light_view(scene, part, receivers)
            for part in (quad(corner, 0.5 * u, v), quad(corner + 0.5 * u, 0.5 * u, v))
        ]
        one = view_of(scene, receivers)
        together = halves[0].projected_solid_angle + halves[1].projected_solid_angle
        bound = one.error_bound + halves[0].error_bound + halves[1].error_bound
        # the middle corner is rounded: 2 ulp of its coordinates, at a distance over 0.01 m
        off = np.abs(together - one.projected_solid_angle) > bound + 1e-13
        assert not off.any()


def test_mirrored_scene_gives_the_same():
    """x -> -x, exact in floating point. The mirrored edges change places, for u x v turns."""
    mirror = np.array([-1.0, 1, 1])
    for seed in range(20):
        scene, receivers = random_case(np.random.default_rng(seed))
        light = scene.quad_lights[0]
        mirrored_light = quad(light.corner * mirror, light.edge_v * mirror, light.edge_u * mirror)
        mirrored = dataclasses.replace(
            scene,
            spheres=tuple(
                dataclasses.replace(s, center=tuple(s.center * mirror)) for s in scene.spheres
            ),
            planes=tuple(
                dataclasses.replace(
                    p, point=tuple(p.point * mirror), normal=tuple(p.normal * mirror)
                )
                for p in scene.planes
            ),
            quad_lights=(mirrored_light,),
        )
        one = view_of(scene, receivers)
        two = view_of(
            mirrored,
            dataclasses.replace(
                receivers, point=receivers.point * mirror, normal=receivers.normal * mirror
            ),
        )
        difference = np.abs(one.projected_solid_angle - two.projected_solid_angle)
        assert np.all(difference <= one.error_bound + two.error_bound)


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20])
def test_scaling_all_lengths_by_a_power_of_two_changes_no_bit(scale):
    """Solid angles have no unit, and multiplying by 2^k is exact."""
    for seed in range(10):
        scene, receivers = random_case(np.random.default_rng(seed))
        light = scene.quad_lights[0]

        def scaled(v):
            return tuple(scale * np.asarray(v))

        bigger = dataclasses.replace(
            scene,
            spheres=tuple(
                dataclasses.replace(s, center=scaled(s.center), radius=scale * s.radius)
                for s in scene.spheres
            ),
            planes=tuple(dataclasses.replace(p, point=scaled(p.point)) for p in scene.planes),
            quad_lights=(
                dataclasses.replace(
                    light,
                    corner=scaled(light.corner),
                    edge_u=scaled(light.edge_u),
                    edge_v=scaled(light.edge_v),
                    area=scale**2 * light.area,
                ),
            ),
        )
        one = view_of(scene, receivers)
        two = view_of(bigger, dataclasses.replace(receivers, point=scale * receivers.point))
        for field in dataclasses.fields(LightView):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name))


def test_sphere_in_another_ones_shadow_changes_nothing():
    """Twice the same sphere, or a small one within its cone, hides what the one alone hides."""
    scene = read_scene(SCENES / "tp3.json")
    one = exact_image(scene, 90, 60)
    twin = dataclasses.replace(scene.spheres[0], name="twin")
    inner = dataclasses.replace(twin, name="inner", radius=0.5)
    for extra in (inner, dataclasses.replace(twin, radius=math.nextafter(1, 0)), twin):
        two = exact_image(dataclasses.replace(scene, spheres=(*scene.spheres, extra)), 90, 60)
        on_floor_one, on_floor_two = one.object_id == 1, two.object_id == 2
        np.testing.assert_array_equal(on_floor_one, on_floor_two)
        np.testing.assert_array_equal(one.shadow[on_floor_one], two.shadow[on_floor_one])
        difference = np.abs(one.radiance - two.radiance).max(axis=2)[on_floor_one]
        assert np.all(difference <= (one.error_bound + two.error_bound)[on_floor_one])


# ---------------------------------------------------------------- planes, and balls about a light


def test_light_in_the_ceiling_is_not_behind_it():
    scene = read_scene(SCENES / "tp3.json")
    ceiling = Plane("ceiling", (5.0, 10.0, -3.0), (0.0, -1.0, 0.0), WHITE)
    under = dataclasses.replace(scene, planes=(*scene.planes, ceiling))
    receivers = on_floor(scene, [(0.3, -2, 1.7), (3, -2, 3)])
    np.testing.assert_array_equal(
        view_of(scene, receivers).projected_solid_angle,
        view_of(under, receivers).projected_solid_angle,
    )
    np.testing.assert_array_equal(view_of(under, receivers).whole, [False, True])


def test_light_that_lies_or_stands_on_an_oblique_plane_is_whole():
    """Turned at random, the corners are on the plane to rounding only: neither a light in the
    ceiling nor one that stands on the receiver's plane may lose a sliver and turn to penumbra, nor
    may a second plane in the receiver's place hide anything."""
    rng = np.random.default_rng(7)
    for _ in range(50):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        shift = 10 * rng.normal(size=3)
        ceiling = quad(*(turn @ v for v in ((1, 5, -1), (-2, 0, 0), (0.3, 0, 2))))
        upright = quad(*(turn @ v for v in ((3, 0, -1), (0, 2, 0), (0, 0.5, 2))))
        light_planes = [
            (turn @ (x, y, z) + shift, turn @ UP) for x, y, z in ((7, 0, 2), (-9, 0, 1), (-4, 5, 3))
        ]
        for light in (ceiling, upright):
            light = dataclasses.replace(light, corner=tuple(light.corner + shift))
            scene = scene_of([], light_planes, [light])
            receiver = Receivers(
                np.array([0]),
                (turn @ (0.4, 0, 0.3) + shift)[None],
                (turn @ UP)[None],
                np.zeros(1, bool),
            )
            view = view_of(scene, receiver)
            assert view.whole and view.projected_solid_angle > 0.05


@pytest.mark.parametrize("wall", [0.5, 0.0, -0.999])
def test_wall_leaves_the_light_on_the_receivers_side(wall):
    """A wall at x = wall, the receiver at x = -1, the light from x = 1 to -1: what is left is the
    light that ends at the wall."""
    light, short = (
        quad((1, 4, 0), (-2, 0, 0), (0, 0, 2)),
        quad((wall, 4, 0), (-1 - wall, 0, 0), (0, 0, 2)),
    )
    scene, bare = (
        scene_of([], [FLOOR, ((wall, 0, 0), (1, 0, 0))], [light]),
        scene_of([], [FLOOR], [short]),
    )
    receiver = on_floor(scene, [(-1, -1, 0)])
    view, expected = view_of(scene, receiver), view_of(bare, receiver)
    difference = abs(view.projected_solid_angle - expected.projected_solid_angle)
    assert difference <= view.error_bound + expected.error_bound
    assert expected.whole and not view.whole and not view.hidden


def test_plane_before_the_light_hides_it():
    light = quad((1, 4, 0), (-2, 0, 0), (0, 0, 2))
    scene = scene_of([], [FLOOR, ((0, 2, 0), (0, 1, 0))], [light])
    view = view_of(scene, on_floor(scene, [(-1, -1, 0)]))
    assert view.hidden and view.projected_solid_angle == 0


def test_room_that_is_a_sphere_hides_nothing_in_it_and_all_outside():
    """A ball around camera, objects and light changes no radiance on them (and sends the
    background away); a light outside the ball lights nothing in it."""
    scene = read_scene(SCENES / "tp3.json")
    bare = exact_image(scene, 60, 40)
    for radius, factor in ((200.0, 1.0), (9.0, 0.0)):
        room = Sphere("room", (0.0, 0.0, 3.0), radius, WHITE)
        full = exact_image(dataclasses.replace(scene, spheres=(*scene.spheres, room)), 60, 40)
        sphere = bare.object_id == 0
        np.testing.assert_array_equal(full.object_id == 0, sphere)
        difference = np.abs(full.radiance - factor * bare.radiance).max(axis=2)
        assert np.all(difference[sphere] <= 2 * bare.error_bound[sphere])
    assert np.all(full.shadow[full.object_id >= 0] == UMBRA)


def test_ball_beyond_the_light_hides_nothing_and_a_ball_about_it_all():
    scene = read_scene(SCENES / "tp3.json")
    bare = exact_image(scene, 60, 40)
    beyond = Sphere("ball", (0.0, 11.0, 3.0), 1.0, WHITE)
    about = Sphere("ball", (0.0, 10.0, 3.0), 1.5, WHITE)
    after = exact_image(dataclasses.replace(scene, spheres=(*scene.spheres, beyond)), 60, 40)
    np.testing.assert_array_equal(after.radiance, bare.radiance)
    after = exact_image(dataclasses.replace(scene, spheres=(*scene.spheres, about)), 60, 40)
    assert np.all(after.shadow[after.object_id >= 0] == UMBRA)
    assert np.all(after.radiance[after.object_id >= 0] == 0)


@pytest.mark.parametrize(("height", "disc_radius"), [(4.0, 2.5 / math.sqrt(24.75)), (4.3, 0.4)])
def test_ball_that_cuts_the_light_hides_a_disc(height, disc_radius):
    """A ball of radius R = 1/2 straight above the receiver, cut by the light 5 m up. Its outline,
    the tangent circle, is (D^2 - R^2) / D up. Centred in the light (D = 5) that is 4.95, before
    the light: the cone's disc is hidden, 5 R / sqrt(D^2 - R^2). Centred 0.3 m above it (D = 5.3)
    it is 5.25, beyond: only the disc in the ball is hidden, sqrt(R^2 - 0.3^2) = 0.4. A disc of
    radius r straight above at 5 m: pi r^2 / (r^2 + 25)."""
    light = quad((1, 4, -1), (-2, 0, 0), (0, 0, 2))
    free, cut = scene_of([], [FLOOR], [light]), scene_of([((0, height, 0), 0.5)], [FLOOR], [light])
    whole = view_of(free, on_floor(free, [(0, -1, 0)]))
    expected = whole.projected_solid_angle[0]
    expected -= math.pi * disc_radius**2 / (disc_radius**2 + 25)
    view = view_of(cut, on_floor(cut, [(0, -1, 0)]))
    bound = view.error_bound[0] + whole.error_bound[0]
    assert abs(view.projected_solid_angle[0] - expected) <= bound < 1e-13


def test_image_is_in_closed_form_where_a_ball_cuts_the_light():
    """The floor straight below (the centre of a picture taken looking down), as above, in the
    image: radiance, penumbra, and a bound of rounding's size."""
    light = quad((1, 4, -1), (-2, 0, 0), (0, 0, 2))
    scene = scene_of([((0, 4.3, 0), 0.5)], [FLOOR], [light])
    down = Camera((0, 0, 0), (0, -1, 0), (1, 0, 0), (0, 0, 1), 60.0)
    image = exact_image(dataclasses.replace(scene, camera=down), 3, 3)
    free = exact_image(dataclasses.replace(scene, camera=down, spheres=()), 3, 3)
    expected = free.radiance[1, 1] - math.pi * 0.4**2 / (0.4**2 + 25)
    bound = image.error_bound[1, 1] + free.error_bound[1, 1]
    assert np.all(np.abs(image.radiance[1, 1] - expected) <= bound)
    assert image.shadow[1, 1] == PENUMBRA and bound < 1e-13


# ---------------------------------------------------------------- camera and image


def test_rays_meet_the_nearest_surface_on_it_and_facing_them():
    """For each pixel of a scene of many spheres: the hit is on the ray and on its object, the
    normal faces the camera, and no object's equation has a nearer root (brute force)."""
    rng = np.random.default_rng(5)
    spheres = [(3 * rng.normal(size=3) + (0, 0, 5), 10 ** rng.uniform(-1, 0.3)) for _ in range(30)]
    spheres.append(((0, 0, 3), 40.0))  # around the camera
    scene = scene_of(spheres, [((0, -2, 0), (0, 1, 0))])
    x, y = rng.uniform(0, 60, 500), rng.uniform(0, 40, 500)
    hits = camera_hits(scene, x, y, 60, 40)
    t = math.tan(math.radians(30))
    ray = np.stack([(2 * x / 60 - 1) * 1.5 * t, (1 - 2 * y / 40) * t, np.ones(500)], axis=1)
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    distance = np.linalg.norm(hits.point, axis=1)
    np.testing.assert_allclose(hits.point, distance[:, None] * ray, atol=1e-13 * 40)
    assert np.all(np.sum(hits.normal * ray, axis=1) < 0)
    for i in range(500):
        roots = [(-2 / ray[i, 1], 31)] if ray[i, 1] < 0 else []
        for j, (centre, radius) in enumerate(spheres):
            b, c = ray[i] @ np.asarray(centre), np.dot(centre, centre) - radius**2
            if b * b > c:
                roots += [(b - math.sqrt(b * b - c), j), (b + math.sqrt(b * b - c), j)]
        nearest, which = min(r for r in roots if r[0] > 0)
        assert which == hits.object_id[i]
        # b^2 - c loses about 1e-15 * 40^2 / (2 sqrt) of the root: 1e-10 unless it grazes
        assert abs(nearest - distance[i]) < 1e-10
        assert hits.inside[i] == (which == 30)


def test_small_sphere_far_away_is_where_it_is():
    """Radius 1 mm at 90 m: its outline is met at |perpendicular| = R within 1e-9 of R, where
    b^2 - c would have lost all but 8 digits of R^2 (90^2 eps / R^2 = 2e-6)."""
    scene = scene_of([((0, 0, 90.0), 1e-3)])
    size = 1000.0
    across = (
        1e-3 / math.sqrt(90**2 - 1e-6) / math.tan(math.radians(30))
    )  # tangent ray, y in [-1, 1]
    y = size / 2 * (1 - across * (1 + np.array([-1e-9, 1e-9])))
    hits = camera_hits(scene, np.full(2, size / 2), y, 1000, 1000)
    np.testing.assert_array_equal(hits.object_id, [0, -1])


def test_floor_ends_at_the_largest_ray_distance():
    """A floor 2 m below ends at the rays that go down by 2 / 100 of their length."""
    scene = scene_of([], [((0, -2, 0), (0, 1, 0))])
    sine = 0.02 * (1 + np.array([1e-12, -1e-12]))
    y = 500 * (1 + sine / np.sqrt(1 - sine**2) / math.tan(math.radians(30)))
    hits = camera_hits(scene, np.full(2, 500.0), y, 1000, 1000)
    np.testing.assert_array_equal(hits.object_id, [0, -1])


@pytest.fixture(scope="module")
def tp3() -> tuple[Scene, ExactImage]:
    scene = read_scene(SCENES / "tp3.json")
    return scene, exact_image(scene, 150, 100)


def test_tp3_background_and_umbra_are_exact(tp3):
    scene, image = tp3
    outside = image.object_id < 0
    assert np.all(image.radiance[outside] == scene.background_radiance)
    assert np.all(image.shadow[outside] == BACKGROUND) and np.all(image.error_bound[outside] == 0)
    assert np.all(image.radiance[image.shadow == UMBRA] == 0)
    assert np.all(image.radiance[image.shadow == PENUMBRA].max(axis=1) > 0)


def test_lit_means_the_whole_light_and_penumbra_less(tp3):
    """Without the sphere the floor is lit everywhere: the same radiance where it was lit, more
    where it was not."""
    scene, image = tp3
    free = exact_image(dataclasses.replace(scene, spheres=()), 150, 100)
    floor = image.object_id == 1
    assert np.all(free.shadow[floor] == LIT)
    lit, rest = floor & (image.shadow == LIT), floor & (image.shadow != LIT)
    assert lit.sum() > 4000 and rest.sum() > 400
    difference = np.abs(image.radiance - free.radiance)[lit].max(axis=1)
    assert np.all(difference <= image.error_bound[lit])
    assert np.all(image.radiance[rest, 0] < free.radiance[rest, 0])


def test_error_bound_of_a_closed_form_is_rounding(tp3):
    """1e-14 of the brightest pixel's 1.72 would be 1.7e-14; the bound charges 16 ulp for every
    radian of outline and 2 ulp of the coordinates, times radiance 40: under 40 * 1e-14."""
    _, image = tp3
    assert 0 < image.error_bound.max() < 4e-13


def test_point_light_follows_the_inverse_square_law_behind_a_hard_edge():
    """tp3_point, each pixel by itself: brdf I cos / d^2 unless the segment to the light passes
    the sphere's centre closer than its radius."""
    scene = read_scene(SCENES / "tp3_point.json")
    image = exact_image(scene, 60, 40)
    y, x = np.mgrid[0:40, 0:60]
    hits = camera_hits(scene, x.ravel() + 0.5, y.ravel() + 0.5, 60, 40)
    light = np.asarray(scene.point_lights[0].position)
    seen = {LIT: 0, UMBRA: 0}
    for i, which in enumerate(image.object_id.ravel()):
        if which < 0:
            continue
        to_light = light - hits.point[i]
        distance = np.linalg.norm(to_light)
        cosine = hits.normal[i] @ to_light / distance
        centre = np.asarray(scene.spheres[0].center) - hits.point[i]
        along = np.clip(centre @ to_light / distance**2, 0, 1)
        closest = np.linalg.norm(centre - along * to_light)
        visible = cosine > 0 and (which == 0 or closest > 1)
        expected = np.asarray(scene.objects[which].brdf) * 100 * cosine / distance**2 * visible
        np.testing.assert_allclose(image.radiance[i // 60, i % 60], expected, rtol=1e-13)
        assert image.shadow[i // 60, i % 60] == (LIT if visible else UMBRA)
        seen[LIT if visible else UMBRA] += 1
    assert min(seen.values()) > 100


def test_point_light_in_a_ball_lights_only_its_inside():
    light = PointLight("point", (0.0, 0.0, 5.0), WHITE)
    scene = scene_of([((0, 0, 5), 1.0)], [((0, -2, 0), (0, 1, 0))], points=[light])
    image = exact_image(scene)
    assert np.all(image.radiance[image.object_id >= 0] == 0)
    within = dataclasses.replace(
        scene, camera=dataclasses.replace(scene.camera, position=(0, 0, 4.5))
    )
    image = exact_image(within)
    assert np.all(image.object_id == 0)
    np.testing.assert_allclose(image.radiance, 1, rtol=1e-13)  # I cos / R^2 = 1


def test_silhouettes_are_where_neighbours_differ():
    """Brute force over the 3x3 neighbours: another object, or another side of the hard shadow,
    which for tp3_point is a change between dark and bright on the floor."""
    scene = read_scene(SCENES / "tp3_point.json")
    image = exact_image(scene, 60, 40)
    dark = (image.object_id == 1) & (image.shadow == UMBRA)
    by_shadow = 0
    for y in range(40):
        for x in range(60):
            around = np.s_[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            objects = np.unique(image.object_id[around])
            shadows = np.unique(dark[around])
            if len(objects) > 1:
                assert image.silhouette[y, x]
            elif objects[0] != 0:
                assert image.silhouette[y, x] == (len(shadows) > 1)
                by_shadow += len(shadows) > 1
            else:
                assert not image.silhouette[y, x]
    assert by_shadow > 20


def test_regions_part_the_image(tp3):
    scene, image = tp3
    parts = regions(scene, image)
    names = {"all", "lit", "penumbra", "umbra", "silhouette", "sphere", "floor"}
    names |= {f"{o}:{s}" for o in ("sphere", "floor") for s in ("lit", "penumbra", "umbra")}
    assert set(parts) == names
    inside = (image.object_id >= 0) & ~image.silhouette
    np.testing.assert_array_equal(parts["all"], inside)
    for group in (("lit", "penumbra", "umbra"), ("sphere", "floor")):
        np.testing.assert_array_equal(sum(parts[g].astype(int) for g in group), inside)
    for name, mask in parts.items():
        if ":" in name:
            thing, shadow = name.split(":")
            np.testing.assert_array_equal(mask, parts[thing] & parts[shadow])
    point = read_scene(SCENES / "tp3_point.json")
    assert "penumbra" not in regions(point, exact_image(point, 60, 40))


def test_pixel_grid_tends_to_the_pixels_mean():
    """The mean over 16 x 16 equal steps is that of 16 x 16 blocks of an image 16 times as fine.
    Where the image is smooth its error falls as k^-2, so it is a third of the distance from 8 x 8;
    the 4 x 4 Gauss-Legendre positions must be as near, all pixels together: within a half."""
    scene = read_scene(SCENES / "tp3.json")
    image = exact_image(scene, 24, 16, pixel_grid=4)
    fine = exact_image(scene, 24 * 16, 16 * 16)
    finer = fine.radiance.reshape(16, 16, 24, 16, 3).mean(axis=(1, 3))
    fine8 = exact_image(scene, 24 * 8, 16 * 8).radiance.reshape(16, 8, 24, 8, 3).mean(axis=(1, 3))
    shadow = fine.shadow.reshape(16, 16, 24, 16).transpose(0, 2, 1, 3).reshape(16, 24, -1)
    smooth = ~image.silhouette & (shadow == LIT).all(axis=2)
    assert smooth.sum() > 100
    off, step = (np.linalg.norm((a - finer)[smooth]) for a in (image.radiance, fine8))
    assert 0 < off <= step / 2
    assert np.all(image.silhouette[(image.object_id == 0) & exact_image(scene, 24, 16).silhouette])


def test_lights_add_and_dark_ones_count_for_nothing(tp3):
    """Twice the light gives twice the radiance; a light of radiance 0 does not make a penumbra."""
    scene, image = tp3
    light = scene.quad_lights[0]
    twice = dataclasses.replace(scene, quad_lights=(light, dataclasses.replace(light, name="b")))
    np.testing.assert_array_equal(
        exact_image(twice, 150, 100).radiance[image.object_id >= 0],
        2 * image.radiance[image.object_id >= 0],
    )
    elsewhere = dataclasses.replace(
        light, name="dark", corner=(1.0, -1.0, 2.0), radiance=(0.0, 0.0, 0.0)
    )
    off = PointLight("off", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    more = dataclasses.replace(scene, quad_lights=(light, elsewhere), point_lights=(off,))
    for field in dataclasses.fields(ExactImage):
        np.testing.assert_array_equal(
            getattr(exact_image(more, 150, 100), field.name), getattr(image, field.name)
        )


def test_empty_scene_is_background():
    image = exact_image(scene_of(quads=[quad((1, 9, 2), (-2, 0, 0), (0, 0, 2))]))
    assert image.radiance.shape == (40, 60, 3) and image.shadow.dtype == np.int8
    assert np.all(image.radiance == (0.5, 0.25, 0.125)) and np.all(image.shadow == BACKGROUND)
    assert not image.silhouette.any() and not regions(scene_of(), image)


@pytest.mark.parametrize("size", [(0, 40, 1), (60, -1, 1), (60, 40, 0)])
def test_sizes_below_one_are_refused(size):
    with pytest.raises(ValueError, match="must be 1 or more"):
        exact_image(scene_of(), *size)
