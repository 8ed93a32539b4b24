"""Scenes at the extremes: each sweep changes one number of a small scene over many decades."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from penumbra.language import N_

Scene = dict[str, Any]
"""A scene file's content."""
Build = Callable[[float], Scene]
KINDS = (
    "spheres", "planes", "point_lights", "quad_lights", "disk_lights", "triangle_lights",
    "sphere_lights",
)  # fmt: skip
WIDTH, HEIGHT = 8, 6
"""[pixels]; what breaks, breaks in every pixel"""


@dataclass(frozen=True)
class Sweep:
    """One number of a scene over its range."""

    name: str
    title: str
    parameter: str
    """what changes, with its unit"""
    values: tuple[float, ...]
    build: Build
    failure: str
    """how floats fail here: cancellation, absorption, overflow, underflow, or none"""
    text: str


# ---- scenes


def lit_floor(
    corner: Sequence[float] = (0.5, 1, -0.5),
    u: Sequence[float] = (-1, 0, 0),
    v: Sequence[float] = (0, 0, 1),
    power: float = 1.0,
    color: Sequence[float] = (1, 1, 1),
    surface: Sequence[float] = (0.5, 0.5, 0.5),
    spheres: Sequence[tuple[Sequence[float], float]] = (),
    camera: Sequence[float] = (0.1, 1, -2),
    look_at: Sequence[float] = (0.1, 0, 0.05),
    fov: float = 2.0,
) -> Scene:
    """A floor at y = 0 seen around look_at, under a quad light; by default 1 m square, 1 m up."""
    return {
        "name": "stability",
        "image": {"width": WIDTH, "height": HEIGHT},
        "camera": {
            "position": list(camera), "look_at": list(look_at), "up": [0, 1, 0], "fov_y_deg": fov,
        },
        "background": [0, 0, 0],
        "ray_max_distance": 1e9,
        "spheres": [
            {"name": f"s{i}", "center": list(c), "radius": r, "color": list(surface)}
            for i, (c, r) in enumerate(spheres)
        ],
        "planes": [
            {"name": "floor", "point": [0, 0, 0], "normal": [0, 1, 0], "color": list(surface)}
        ],
        "quad_lights": [
            {"name": "light", "position": list(corner), "u": list(u), "v": list(v),
             "color": list(color), "power": power}
        ],
    }  # fmt: skip


def under(shape: str, look_at: Sequence[float] = (0.1, 0, 0.05), **light: Any) -> Scene:
    """The floor under one light of another shape, its entry in the scene file given by keys."""
    scene = lit_floor(look_at=look_at)
    del scene["quad_lights"]
    entry = {"name": "light", **light, "color": [1, 1, 1], "power": 1.0}
    return scene | {f"{shape}_lights": [entry]}


def light_of_side(side: float, height: float = 1.0) -> Scene:
    half = side / 2
    return lit_floor((half, height, -half), (-side, 0, 0), (0, 0, side))


def standing_light(low: float, high: float, x: float = 1.0) -> Scene:
    """A vertical light at x, from `low` to `high` above the floor, facing the place x = 0."""
    return lit_floor((x, low, -0.5), (0, high - low, 0), (0, 0, 1))


def translated(scene: Scene, by: float) -> Scene:
    """Along (1, 1, 1), by that much on each axis."""
    return _mapped(scene, lambda point: [x + by for x in point], list, list)


def scaled(scene: Scene, by: float) -> Scene:
    """All lengths; at fixed radiance the image stays the same."""

    def grow(v: Sequence[float]) -> list[float]:
        return [x * by for x in v]

    larger = _mapped(scene, grow, grow, list)
    for item in [part for kind in KINDS for part in larger.get(kind, []) if "radius" in part]:
        item["radius"] *= by
    larger["ray_max_distance"] = min(1e9, max(1e-9, 1e3 * by))
    return larger


def tilted(scene: Scene) -> Scene:
    """Turned by 0.3 rad about z and 0.5 about x: no coordinate is a round number any more."""
    c, s, d, t = math.cos(0.3), math.sin(0.3), math.cos(0.5), math.sin(0.5)

    def turn(v: Sequence[float]) -> list[float]:
        x, y, z = c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]
        return [x, d * y - t * z, t * y + d * z]

    new = _mapped(scene, turn, turn, turn)
    new["camera"]["up"] = turn(new["camera"]["up"])
    return new


def mirrored(scene: Scene) -> Scene:
    """In the plane x = 0. A light's u and v change places, so that it faces the same way."""

    def flip(v: Sequence[float]) -> list[float]:
        return [-v[0], *v[1:]]

    other = _mapped(scene, flip, flip, flip)
    for light in other.get("quad_lights", []) + other.get("triangle_lights", []):
        light["u"], light["v"] = light["v"], light["u"]
    return other


Map = Callable[[Sequence[float]], list[float]]


def _mapped(scene: Scene, place: Map, edge: Map, normal: Map) -> Scene:
    new = copy.deepcopy(scene)
    new["camera"] |= {k: place(new["camera"][k]) for k in ("position", "look_at")}
    maps = {"position": place, "center": place, "point": place, "u": edge, "v": edge}
    maps["normal"] = normal
    for item in [part for kind in KINDS for part in new.get(kind, [])]:
        item |= {key: maps[key](item[key]) for key in maps.keys() & item.keys()}
    return new


def in_a_ball(radius: float) -> Scene:
    """Camera and light within a sphere; its far wall is what is seen."""
    side = radius / 4
    corner = (side / 2, radius / 2, -side / 2)
    scene = lit_floor(
        corner, (-side, 0, 0), (0, 0, side),
        spheres=[((0, 0, 0), radius)], camera=(0, 0, 0), look_at=(0.1, -0.3, 1), fov=20,
    )  # fmt: skip
    return scene | {"planes": []}


def light_in_a_ball(radius: float) -> Scene:
    """A small light within a sphere above the floor: all is dark outside."""
    side, height = radius / 4, 2 * radius
    return lit_floor(
        (side / 2, height, -side / 2), (-side, 0, 0), (0, 0, side),
        spheres=[((0, height, 0), radius)],
        camera=(0, radius, -4 * radius), look_at=(0, 0, 0), fov=20,
    )  # fmt: skip


def ball_on_the_floor(radius: float) -> Scene:
    """The floor beside its point of contact with a sphere, a tenth of the radius away."""
    return lit_floor(
        (1.5, 3, -0.5), spheres=[((0, radius, 0), radius)],
        camera=(radius, radius, -3 * radius), look_at=(0.6 * radius, 0, 0), fov=5,
    )  # fmt: skip


def decades(low: int, high: int, per_decade: int = 1) -> tuple[float, ...]:
    """
    >>> decades(-1, 1)
    (0.1, 1.0, 10.0)
    """
    steps = range(low * per_decade, high * per_decade + 1)
    return tuple(float(f"{10 ** (k / per_decade):.6g}") for k in steps)


def signed(low: int, high: int) -> tuple[float, ...]:
    """Decades on both sides of 0, and 0."""
    values = decades(low, high)
    return (*(-v for v in reversed(values)), 0.0, *values)


SWEEPS = (
    Sweep(
        "size", N_("A light of side s, 1 m away"), "s [m]", decades(-6, 6),
        light_of_side, "absorption",
        N_("A small light's corners differ by less than a float at 1 m resolves: corner + s u "
        "absorbs s u, and the light becomes a point. What it adds up to stays right."),
    ),
    Sweep(
        "distance", N_("A light of 1 m at distance d"), "d [m]", decades(-6, 6),
        lambda d: light_of_side(1, d), "absorption",
        N_("Far away as before. Close by, the light's plane is nearly that of the point."),
    ),
    Sweep(
        "grazing", N_("A light at grazing angle"), "angle [rad]", decades(-7, -1),
        lambda a: standing_light(a, 2 * a), "cancellation",
        N_("cos is the small difference of large products: n . w keeps the error of w's length."),
    ),
    Sweep(
        "tilted", N_("The same, the scene tilted"), "angle [rad]", decades(-7, -1),
        lambda a: tilted(standing_light(a, 2 * a)), "cancellation",
        N_("Put back on the floor, a point of a level floor is exactly on it, and grazing light "
        "loses nothing. On a tilted one it is off by a rounding, and n . w is a difference of "
        "1 and 1."),
    ),
    Sweep(
        "plane", N_("A point at height h before the light's plane"), "h [m]", signed(-7, -1),
        lambda h: lit_floor((2, h, -0.5)), "cancellation",
        N_("Beside the light, just in front of its plane, in it and behind it."),
    ),
    Sweep(
        "edge", N_("A point at height h before the light's edge"), "h [m]", decades(-7, 0),
        lambda h: lit_floor((0.1, h, -0.5)), "overflow",
        N_("1 / d^2 is unbounded where a light touches a surface."),
    ),
    Sweep(
        "corner", N_("A point at height h before the light's corner"), "h [m]", decades(-7, 0),
        lambda h: lit_floor((0.1, h, 0.05)), "overflow", N_("As at the edge."),
    ),
    Sweep(
        "touching", N_("A tilted light that ends at height h above the floor"), "h [m]",
        (0.0, *decades(-7, 0)), lambda h: lit_floor((1, h, -0.5), (-1, 1, 0)), "cancellation",
        N_("At h = 0 the light's lower edge lies in the floor."),
    ),
    Sweep(
        "standing", N_("A vertical light that ends at height h"), "h [m]", signed(-7, -1),
        lambda h: standing_light(h, 1), "cancellation",
        N_("Below the floor (h < 0) the light's lower part is hidden by the horizon."),
    ),
    Sweep(
        "shear", N_("A sheared light, v = k u + 1 m across"), "k", (0.0, *decades(-1, 6)),
        lambda k: lit_floor((0.5 + k / 2, 1, -0.5), (-1, 0, 0), (-k, 0, 1)), "cancellation",
        N_("|u x v| stays 1 while |u||v| grows: the area is a difference of large products."),
    ),
    Sweep(
        "needle", N_("A needle: sides a and 1 / a"), "a", decades(0, 6),
        lambda a: lit_floor((a / 2, 1, -0.5 / a), (-a, 0, 0), (0, 0, 1 / a)), "absorption",
        N_("Most of it is far away."),
    ),
    Sweep(
        "degenerate", N_("Edges at angle a to each other"), "angle [rad]", (2e-9, *decades(-8, 0)),
        lambda a: lit_floor((0.5, 1, 0), (-1, 0, 0), (-math.cos(a), 0, math.sin(a))),
        "cancellation", N_("u x v is the difference of near-equal products."),
    ),
    Sweep(
        "translation", N_("The scene moved by t on every axis"), "t [m]", (0.0, *decades(0, 7)),
        lambda t: translated(light_of_side(1), t), "absorption",
        N_("At 1e7 floats are 1 m apart: the scene's numbers themselves are absorbed."),
    ),
    Sweep(
        "scale", N_("The scene scaled by k"), "k", decades(-6, 6),
        lambda k: scaled(light_of_side(1), k),
        "none",
        N_("Powers of ten round; nothing is added to anything else. d^4 must not overflow."),
    ),
    Sweep(
        "power", N_("A light of power p"), "p [W m^-2 sr^-1]",
        (0.0, 1e-38, 1e-30, *decades(-6, 6)[::3], 1e20, 1e30), lambda p: lit_floor(power=p),
        "underflow",
        N_("1e-38 is at the end of float32's range: the products below it lose digits."),
    ),
    Sweep(
        "colour", N_("A surface and a light of colour c"), "c",
        (0.0, 1e-30, 1e-20, *decades(-6, 6)[::2]),
        lambda c: lit_floor(color=(c, c, c), surface=(c, c, c)), "underflow",
        N_("The product of two colours of 1e-20 is 1e-40: float32 keeps four digits of it."),
    ),
    Sweep(
        "sphere", N_("A sphere of radius r between floor and light"), "r [m]", decades(-6, 6),
        lambda r: lit_floor(spheres=[((r, 0.5, 0.05), r)], look_at=(-0.2, 0, 0.05)), "cancellation",
        N_("The edge of a large sphere is a wall; r^2 - d^2 is a small difference of large "
        "squares."),
    ),
    Sweep(
        "inside", N_("Camera and light in a sphere of radius r"), "r [m]", decades(-6, 6),
        in_a_ball, "none", N_("Its far wall is seen and lit."),
    ),
    Sweep(
        "enclosed", N_("A light in a sphere of radius r"), "r [m]", decades(-6, 6), light_in_a_ball,
        "none", N_("No light leaves the sphere: every number outside is exactly 0."),
    ),
    Sweep(
        "tangent", N_("A sphere of radius r on the floor"), "r [m]", decades(-3, 0, 3)[:-1],
        ball_on_the_floor, "cancellation", N_("Sphere and floor touch."),
    ),
    Sweep(
        "touch", N_("A sphere at distance g below the light"), "g [m]", signed(-7, -2),
        lambda g: lit_floor(spheres=[((0, 0.7 - g, 0), 0.3)], look_at=(0.35, 0, 0.05)),
        "cancellation", N_("At g = 0 it touches the light, below 0 it pierces it."),
    ),
    Sweep(
        "disk-size", N_("A disk light of radius r, 1 m away"), "r [m]", decades(-6, 6),
        lambda r: under("disk", center=[0, 1, 0], normal=[0, 1, 0], radius=r), "absorption",
        N_("As a small square: its frame is made of the normal, and the centre absorbs it."),
    ),
    Sweep(
        "disk-plane", N_("A point at height h before a disk light's plane"), "h [m]",
        signed(-7, -1), lambda h: under("disk", center=[1.5, h, 0], normal=[0, 1, 0], radius=0.5),
        "cancellation",
        N_("The disk is seen edge-on: beside it, just in front of its plane, in it and behind it."),
    ),
    Sweep(
        "disk-standing", N_("A vertical disk light that ends at height h"), "h [m]", signed(-7, -1),
        lambda h: under("disk", center=[1, 0.5 + h, 0], normal=[1, 0, 0], radius=0.5),
        "cancellation", N_("Below the floor (h < 0) the horizon cuts a piece of it off."),
    ),
    Sweep(
        "triangle-sliver", N_("A triangle light with an angle a"), "a [rad]",
        (2e-9, *decades(-8, 0)),
        lambda a: under(
            "triangle", position=[0.5, 1, 0], u=[-1, 0, 0], v=[-math.cos(a), 0, math.sin(a)]
        ),
        "cancellation", N_("u x v is the difference of near-equal products."),
    ),
    Sweep(
        "triangle-standing", N_("A vertical triangle light whose corner is at height h"), "h [m]",
        signed(-7, -1),
        lambda h: under("triangle", position=[1, h, 0], u=[0, 1, -0.5], v=[0, 1, 0.5]),
        "cancellation", N_("Below the floor (h < 0) its corner is hidden by the horizon."),
    ),
    Sweep(
        "sphere-light-size", N_("A sphere light of radius r, its surface 1 m away"), "r [m]",
        decades(-6, 6), lambda r: under("sphere", center=[0, 1 + r, 0], radius=r), "absorption",
        N_("A large one is a ceiling: the place on it is a small difference of centre and radius."),
    ),
    Sweep(
        "sphere-light-touching", N_("A sphere light of radius 0.5 m that ends at height h"),
        "h [m]", (-0.5, -0.25, *signed(-7, -1)),
        lambda h: under("sphere", (0, 0, 0), center=[0, 0.5 + h, 0], radius=0.5), "cancellation",
        N_("At h = 0 it touches the floor, below 0 it stands in it: inside, the floor gets "
        "nothing."),
    ),
)  # fmt: skip
