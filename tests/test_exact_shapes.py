"""The closed form of every light shape against the definition, slice by slice, to its error bound.

Quantities are projected solid angles [sr], irradiance over radiance, unless they say otherwise.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from compare.exact.irradiance import LightView, SurfaceLight, light_view
from compare.exact.receivers import Receivers
from compare.scene import (
    Camera,
    DiskLight,
    Plane,
    QuadLight,
    Scene,
    Sphere,
    SphereLight,
    TriangleLight,
)
from tests.slices import by_slices

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

        scene = Scene(
            "made", 8, 8,
            Camera((0, 0, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), 60.0),
            (0.0, 0.0, 0.0), 1e9,
            tuple(Sphere(f"b{i}", place(c), float(r), WHITE) for i, (c, r) in enumerate(self.balls)),
            tuple(
                Plane(f"p{i}", place(p), direction(n), WHITE) for i, (p, n) in enumerate(self.planes)
            ),
            (), (),
        )  # fmt: skip
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
    "far": Case(point=(300.0, -400.0, 50.0), normal=(-0.3, 0.4, 0.1), balls=(((0.3, 2.3, 0), 0.4),)),
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
        value, error = by_slices(scene, light, receivers, 1e-17 * case.size**2)
        assert_within_bound(light_view(scene, light, receivers), value, error, name)
