"""The closed form of every light shape against the definition, slice by slice, to its error bound.

Quantities are projected solid angles [sr], irradiance over radiance, unless they say otherwise.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

from penumbra.compare.exact.image import LIT, PENUMBRA, UMBRA, exact_image
from penumbra.compare.exact.irradiance import LightView, SurfaceLight, light_view
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.scene import (
    Camera,
    DiskLight,
    Plane,
    QuadLight,
    Scene,
    Sphere,
    SphereLight,
    TriangleLight,
    read_scene,
)
from tests.slices import by_slices

SCENES = Path(__file__).resolve().parent.parent / "scenes"
WHITE = (1.0, 1.0, 1.0)
SHAPES = ("quad", "triangle", "disk", "sphere")
CENTRE = np.array([0.0, 3.0, 0.0])
"""of the light that each case is about; flat ones shine down"""


@dataclasses.dataclass
class Case:
    """A light about CENTRE, what stands before it, and a receiver."""

    size: float = 1.0
    point: tuple[float, float, float] = (0.4, 0.0, 0.3)
    normal: tuple[float, float, float] = (0.1, 1.0, -0.2)
    balls: tuple = ()
    """(centre, radius)"""
    planes: tuple = ()
    """(point, normal)"""
    own: int | None = None
    """the ball on whose inside the receiver is"""

    def made(self, shape: str, turn: np.ndarray, shift: np.ndarray):
        """Scene, light and receiver, turned and shifted."""

        def place(v) -> tuple[float, float, float]:
            return tuple(map(float, turn @ np.asarray(v, dtype=float) + shift))

        def direction(v) -> tuple[float, float, float]:
            v = turn @ np.asarray(v, dtype=float)
            return tuple(map(float, v / np.linalg.norm(v)))

        balls = [(f"b{i}", place(c), float(r), WHITE) for i, (c, r) in enumerate(self.balls)]
        walls = [(f"p{i}", place(p), direction(n), WHITE) for i, (p, n) in enumerate(self.planes)]
        scene = Scene(
            name="made",
            width=8,
            height=8,
            camera=Camera((0, 0, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), 60.0),
            background_radiance=(0.0, 0.0, 0.0),
            ray_max_distance=1e9,
            spheres=tuple(Sphere(*ball) for ball in balls),
            planes=tuple(Plane(*wall) for wall in walls),
            point_lights=(),
            quad_lights=(),
        )
        receivers = Receivers(
            np.array([len(scene.objects) if self.own is None else self.own]),
            np.array([place(self.point)]),
            np.array([direction(self.normal)]),
            np.array([self.own is not None]),
        )
        return scene, light_of(shape, self.size, turn, place), receivers


def light_of(shape: str, size: float, turn: np.ndarray, place) -> SurfaceLight:
    """About CENTRE, as wide as `size` from its middle."""
    if shape == "sphere":
        return SphereLight("light", place(CENTRE), size, WHITE)
    if shape == "disk":
        normal = turn @ np.array([0.0, 1.0, 0.0])
        return DiskLight("light", place(CENTRE), tuple(map(float, normal)), size, WHITE)
    corner = CENTRE + size * np.array([-0.8, 0, -0.7])
    u, v = (tuple(map(float, size * turn @ np.array(e))) for e in ((0.2, 0, 1.5), (1.6, 0, 0.1)))
    if shape == "triangle":
        return TriangleLight("light", place(corner), u, v, WHITE)
    normal = np.cross(u, v)
    area = float(np.linalg.norm(normal))
    return QuadLight("light", place(corner), u, v, tuple(map(float, normal / area)), area, WHITE)


def random_frame(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn)), rng.normal(size=3)


BALL = ((0.45, 1.5, 0.1), 0.25)
CASES = {
    "free": Case(),
    "horizon": Case(normal=(0.9, 0.1, 0.2)),
    "horizon and walls": Case(
        normal=(0.9, 0.2, 0.2), planes=(((-0.3, 0, 0), (1, 0, 0.1)), ((0, 0, -0.2), (0.2, 0.1, 1)))
    ),
    "ball": Case(balls=(BALL,)),
    "three balls that overlap": Case(
        balls=(BALL, ((0.2, 1.6, 0.3), 0.2), ((0.3, 1.2, 0.0), 0.22)), normal=(0.8, 0.3, 0.1)
    ),
    "ball that cuts": Case(balls=(((0.35, 2.8, 0.2), 0.5),)),
    "ball that cuts, beyond and before its outline": Case(
        point=(2.5, 0.0, 0.3), balls=(((0.3, 3.1, 0.2), 0.4),)
    ),
    "ball that cuts from above": Case(balls=(((0.2, 3.3, 0.1), 0.5),)),
    "ball at the edge": Case(balls=(((1.0, 2.9, 0.1), 0.3),)),
    "balls that cut and overlap": Case(
        balls=(((0.35, 2.8, 0.2), 0.5), ((0.0, 3.1, 0.0), 0.4), ((-0.4, 2.7, 0.1), 0.35), BALL)
    ),
    "wall": Case(planes=(((0.25, 0, 0), (1, 0.1, 0.2)),)),
    "walls": Case(planes=(((0.25, 0, 0), (-1, 0.1, 0.2)), ((0, 3, -0.1), (0.1, 0.2, 1)))),
    "ceiling that cuts": Case(planes=(((0.1, 2.9, 0.1), (0.3, 1, 0.1)),)),
    "in a ball that cuts": Case(balls=(((0.5, 1.0, 0.2), 2.1),)),
    "on the inside of a ball that cuts": Case(
        balls=(((0.4, 1.2, 0.3), 1.9),), point=(0.4, -0.7, 0.3), normal=(0, 1, 0), own=0
    ),
    "in two balls, before one and a wall": Case(
        balls=(((0.5, 1.0, 0.2), 2.1), ((-0.1, 1.0, 0.2), 2.15), BALL),
        planes=(((-0.2, 0, 0), (1, 0.1, 0.2)),),
    ),
    "in contact": Case(balls=(((0.4, 0.30001, 0.0), 0.3), ((0.9, 0.2, 0.4), 0.2))),
    "grazing": Case(point=(4.0, 2.997, 0.3), normal=(-0.7, 0.3, 0.1)),
    "grazing more": Case(point=(2.5, 2.999999, 0.3), normal=(-0.7, 0.3, 0.1)),
    "grazing behind a ball": Case(
        point=(4.0, 2.9, 0.3), normal=(-0.7, 0.3, 0.1), balls=(((1.5, 2.9, 0.2), 0.1),)
    ),
    "near its edge": Case(point=(1.0, 3.0 - 1e-6, 2e-7), normal=(-0.2, 1, 0.1)),
    "just below": Case(point=(0.2, 2.999, 0.1), normal=(-0.2, 1, 0.1)),
    "behind": Case(point=(0.4, 5.0, 0.1), normal=(0.1, -1, 0.1)),
    "its plane": Case(point=(2.0, 3.0, 0.0), normal=(-1, 0.1, 0.1)),
    "far": Case(
        point=(300.0, -400.0, 50.0), normal=(-0.3, 0.4, 0.1), balls=(((0.3, 2.3, 0), 0.4),)
    ),
}
for power in (2, 4):
    small = 10.0**-power
    # A ball of 0.2 m half-way, whose edge is seen a tenth of the size beside the light's middle.
    ball = ((0.2 + 0.05 * small, 1.5, 0.0), 0.2)
    CASES[f"1e-{power} m, half hidden"] = Case(size=small, point=(0.0, 0.0, 0.0), balls=(ball,))


def assert_within_bound(view: LightView, value, error, label) -> None:
    off = np.abs(view.projected_solid_angle - value).astype(float)
    assert np.all(off <= view.error_bound + error), (label, off, view, value)
    assert not (view.whole & view.hidden).any(), label
    assert np.all(view.projected_solid_angle[view.hidden] == 0), label


@pytest.mark.parametrize("shape", SHAPES)
def test_closed_form_is_the_definition_in_every_hard_case(shape):
    """Each case turned at random; the witness is right to 1e-16 of what it adds up."""
    for i, (name, case) in enumerate(CASES.items()):
        scene, light, receivers = case.made(shape, *random_frame(i))
        value, error = by_slices(scene, light, receivers, 1e-16 * case.size**2, 24)
        assert_within_bound(light_view(scene, light, receivers), value, error, name)


# ------------------------------------------------------------------------------- thirty digits


def mp_vector(v) -> list[mp.mpf]:
    return [mp.mpf(float(x)) for x in v]


def mp_dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def mp_cross(a, b):
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def mp_polygon(light: QuadLight | TriangleLight, point, normal):
    """Lambert's sum over the part above the horizon; positive on the lit side."""
    corner, u, v = (mp_vector(x) for x in (light.corner, light.edge_u, light.edge_v))
    places = [(0, 0), (1, 0), (1, 1), (0, 1)] if isinstance(light, QuadLight) else None
    vertices = [
        [c + s * x + t * y - p for c, x, y, p in zip(corner, u, v, point, strict=True)]
        for s, t in places or [(0, 0), (1, 0), (0, 1)]
    ]
    above = []
    for k, b in enumerate(vertices):
        a = vertices[k - 1]
        ha, hb = mp_dot(a, normal), mp_dot(b, normal)
        if (ha >= 0) != (hb >= 0):
            above.append([x + ha / (ha - hb) * (y - x) for x, y in zip(a, b, strict=True)])
        if hb >= 0:
            above.append(b)
    total = mp.mpf(0)
    for k, b in enumerate(above):
        moment = mp_cross(above[k - 1], b)
        sine = mp.sqrt(mp_dot(moment, moment))
        if sine > 0:
            total += mp.atan2(sine, mp_dot(above[k - 1], b)) * mp_dot(moment, normal) / sine
    return total / 2


def mp_disk(light: DiskLight, point, normal):
    """Stokes around the rim, by numbers: 1/2 n . integral of X x X' / X^2 dphi."""
    m = mp_vector(light.normal)
    m = [x / mp.sqrt(mp_dot(m, m)) for x in m]
    c = [x - p for x, p in zip(mp_vector(light.center), point, strict=True)]
    u = mp_cross(m, [1, 0, 0] if abs(m[0]) < 0.6 else [0, 1, 0])
    u = [light.radius * x / mp.sqrt(mp_dot(u, u)) for x in u]
    v = mp_cross(m, u)

    def slope(phi):
        cosine, sine = mp.cos(phi), mp.sin(phi)
        x = [a + b * cosine + d * sine for a, b, d in zip(c, u, v, strict=True)]
        dx = [d * cosine - b * sine for b, d in zip(u, v, strict=True)]
        return mp_dot(normal, mp_cross(x, dx)) / mp_dot(x, x)

    return mp.quad(slope, mp.linspace(0, 2 * mp.pi, 5), maxdegree=6) / 2


@pytest.mark.parametrize("shape", SHAPES)
def test_lights_of_any_size_are_within_the_bound_of_thirty_digits(shape):
    """Lights of 1 to 1e-8 m, metres away, turned at random, polygons also half below the horizon.
    The bound is useful: for the best one of each size under 1e-13 d / w of the value."""
    rng = np.random.default_rng(11)
    for power in range(9):
        relative = []
        for _ in range(4):
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            turn *= np.sign(np.linalg.det(turn))
            shift = rng.normal(size=3)
            towards = rng.normal(size=3) * (0.3, 0, 0.3) + (0, 1, 0)
            if shape in ("quad", "triangle") and rng.random() < 0.4:
                towards = np.cross(rng.normal(size=3), CENTRE)  # the light is on the horizon
            case = Case(size=10.0**-power, point=tuple(rng.normal(size=3)), normal=tuple(towards))
            scene, light, receivers = case.made(shape, turn, shift)
            view = light_view(scene, light, receivers)
            with mp.workdps(40):
                point, normal = mp_vector(receivers.point[0]), mp_vector(receivers.normal[0])
                if isinstance(light, SphereLight):
                    c = [x - p for x, p in zip(mp_vector(light.center), point, strict=True)]
                    d = mp.sqrt(mp_dot(c, c))
                    expected = mp.pi * (light.radius / d) ** 2 * mp_dot(c, normal) / d
                    whole = view.whole[0]
                elif isinstance(light, DiskLight):
                    expected, whole = mp_disk(light, point, normal), view.whole[0]
                else:
                    expected, whole = max(0, mp_polygon(light, point, normal)), True
                if whole:
                    off = float(abs(view.projected_solid_angle[0] - expected))
                    assert off <= view.error_bound[0], (power, off, view)
                    if expected > 0:
                        relative.append(view.error_bound[0] / float(expected))
        assert len(relative) >= 2
        assert min(relative) < 1e-13 * 10.0**power


# ------------------------------------------------------------------------- values known otherwise


@pytest.mark.parametrize("shape", ["disk", "sphere"])
@pytest.mark.parametrize("slack", [0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6, -1e-6, 1e-4, -1e-4])
def test_eclipse_leaves_a_ring(shape, slack):
    """A ball on the axis through the receiver: of the light's cone, half-angle alpha, its own,
    beta, is hidden, sin(beta) = (1 - slack) sin(alpha) as rounded: pi (sin^2 alpha - sin^2 beta)
    is left, or nothing."""
    sine = 1 / math.sqrt(10) if shape == "disk" else 1 / 3
    ball = Case(balls=(((0, 1.5, 0), 1.5 * sine * (1 - slack)),), point=(0, 0, 0), normal=(0, 1, 0))
    scene, light, receivers = ball.made(shape, np.eye(3), np.zeros(3))
    view = light_view(scene, light, receivers)
    with mp.workdps(30):
        alpha2 = mp.mpf(1) / (10 if shape == "disk" else 9)
        left = mp.pi * (alpha2 - (mp.mpf(scene.spheres[0].radius) / 1.5) ** 2)
        assert abs(view.projected_solid_angle[0] - max(0, left)) <= view.error_bound[0] < 1e-13
    assert not view.whole[0] and view.hidden[0] == (slack < 1e-13)


@pytest.mark.parametrize("slack", [1e-15, -1e-15, 1e-10, -1e-10, 1e-4, -1e-4])
def test_ball_that_touches_the_outline_hides_its_cone_or_nothing(slack):
    """A disk 3 m above, of radius 1, a ball that touches its cone from outside or from within to
    `slack` of its radius. Outside it hides less than the sliver of that width; within all of
    pi sin^2(beta) cos(axis, normal), or that but for such a sliver."""
    edge = math.atan(1 / 3)
    for side in (-1, 1):
        beta = math.asin(0.1 / 2)
        angle = edge + side * beta * (1 + slack)
        centre = (2 * math.sin(angle), 2 * math.cos(angle), 0.0)
        case = Case(balls=((centre, 0.1),), point=(0, 0, 0), normal=(0, 1, 0))
        scene, light, receivers = case.made("disk", np.eye(3), np.zeros(3))
        view = light_view(scene, light, receivers)
        hidden = 0.0 if side > 0 else math.pi * 0.05**2 * math.cos(angle)
        off = abs(math.pi / 10 - hidden - view.projected_solid_angle[0])
        assert off <= view.error_bound[0] + 2 * beta * abs(slack) ** 1.5
        if abs(slack) > 1e-12:  # else rounding decides
            assert view.whole[0] == (side > 0 and slack > 0)


def test_sphere_light_half_in_the_floor_shines_as_a_half():
    """Centre on the receiver's plane: the upper half of its cone, seen from above the segment
    x >= cos(alpha) of the unit disc: alpha - sin(alpha) cos(alpha). The floor hides no more."""
    for distance in (1.0 + 1e-6, 1.5, 100.0):
        floor = Case(point=(distance, 3.0, 0), normal=(0, 1, 0), planes=(((5, 3, 5), (0, 1, 0)),))
        scene, light, receivers = floor.made("sphere", np.eye(3), np.zeros(3))
        receivers = dataclasses.replace(receivers, object_id=np.array([0]))
        view = light_view(scene, light, receivers)
        alpha = math.asin(1 / distance)
        expected = alpha - math.sin(alpha) * math.cos(alpha)
        assert abs(view.projected_solid_angle[0] - expected) <= view.error_bound[0] + 1e-16
        assert not view.whole[0] and not view.hidden[0]


@pytest.mark.parametrize("shape", SHAPES)
def test_receivers_that_see_no_light_are_in_umbra(shape):
    """In a sphere light (or behind a flat one), behind a plane, in a ball that does not reach the
    light, behind a ball that holds it; a ball in the light, or beyond, hides nothing."""
    inside = (0.1, 3.2, 0.1)
    dark = [
        Case(point=inside, normal=(0, 1, 0)),
        Case(planes=(((0, 1, 0), (0, 1, 0.1)),)),
        Case(balls=(((0.4, 0, 0.2), 1.0),)),
        Case(balls=((CENTRE, 1.6),)),
        Case(normal=(0, -1, 0)),
    ]
    if shape != "sphere":
        dark.append(Case(point=(0.2, 3.0, 0.1)))
    for i, case in enumerate(dark):
        view = light_view(*case.made(shape, *random_frame(i)))
        assert view.hidden[0] and not view.whole[0] and view.projected_solid_angle[0] == 0, i
    free = light_view(*Case().made(shape, *random_frame(0)))
    for ball in (((0.1, 3.2, 0.1), 0.2 if shape == "sphere" else 0.15), ((0, 5, 0), 0.5)):
        view = light_view(*Case(balls=(ball,)).made(shape, *random_frame(0)))
        assert view.whole[0]
        np.testing.assert_array_equal(view.projected_solid_angle, free.projected_solid_angle)


def test_triangle_and_its_mirrored_half_make_the_quad():
    for i, case in enumerate(CASES.values()):
        scene, quad, receivers = case.made("quad", *random_frame(i))
        corner, u, v = (np.asarray(x) for x in (quad.corner, quad.edge_u, quad.edge_v))
        other = tuple(map(float, corner + u + v)), tuple(-u), tuple(-v)
        halves = [
            light_view(scene, TriangleLight("half", *edges, WHITE), receivers)
            for edges in ((quad.corner, quad.edge_u, quad.edge_v), other)
        ]
        one = light_view(scene, quad, receivers)
        together = sum(h.projected_solid_angle[0] for h in halves)
        bound = one.error_bound[0] + sum(h.error_bound[0] for h in halves)
        assert abs(together - one.projected_solid_angle[0]) <= bound


def test_image_adds_lights_of_every_shape():
    """tp3 with each light alone, and with all four: the radiances add; dark ones do not count."""
    scene = read_scene(SCENES / "tp3.json")
    place = np.eye(3), np.array([0.5, 7.0, 3.0])
    lights = [Case().made(shape, *place)[1] for shape in SHAPES]
    groups = ("quad_lights", "triangle_lights", "disk_lights", "sphere_lights")
    none = dict.fromkeys(groups, ())
    images = [
        exact_image(dataclasses.replace(scene, **none | {group: (light,)}), 30, 20)
        for group, light in zip(groups, lights, strict=True)
    ]
    together = {g: (light,) for g, light in zip(groups, lights, strict=True)}
    image = exact_image(dataclasses.replace(scene, **together), 30, 20)
    seen = image.object_id >= 0
    total = sum(i.radiance for i in images)
    np.testing.assert_allclose(image.radiance[seen], total[seen], rtol=1e-13)
    for part in images:
        assert {LIT, PENUMBRA, UMBRA} <= set(np.unique(part.shadow[seen]))
    lit = np.all([i.shadow == LIT for i in images], axis=0)
    dark = np.all([i.shadow == UMBRA for i in images], axis=0)
    np.testing.assert_array_equal(image.shadow[seen] == LIT, lit[seen])
    np.testing.assert_array_equal(image.shadow[seen] == UMBRA, dark[seen])
    off = dataclasses.replace(lights[3], radiance=(0.0, 0.0, 0.0))
    dim = dataclasses.replace(scene, **together | {"sphere_lights": (off,)})
    without = exact_image(dim, 30, 20)
    np.testing.assert_allclose(
        without.radiance[seen], (total - images[3].radiance)[seen], rtol=1e-13, atol=1e-15
    )
