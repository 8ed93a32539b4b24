"""The C core's noise-free irradiance: against the Python solution, against itself, against
what geometry says. All numbers are representable in float32, so the two sides see one scene."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.exact.image import BACKGROUND, exact_image
from penumbra.compare.exact.irradiance import light_view
from penumbra.compare.exact.receivers import Receivers
from penumbra.compare.scene import Plane, PointLight, QuadLight, Scene, Sphere, read_scene
from tests.core import ffi, library
from tests.test_estimator_packet import random_scene

EPS, EPS_REAL = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)
LANES = 16
WHITE = (1.0, 1.0, 1.0)


# ---- scenes and points, in Python and in C


def f32(values: Any) -> np.ndarray:
    return np.asarray(values, np.float32).astype(np.float64)


def triple(v: Any) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in f32(v))
    return x, y, z


def quad(corner: Any, u: Any, v: Any, radiance: Any = WHITE) -> QuadLight:
    u, v = f32(u), f32(v)
    normal = np.cross(u, v)
    area = float(np.linalg.norm(normal))
    x, y, z = (float(c) for c in normal / area)
    return QuadLight("q", triple(corner), triple(u), triple(v), (x, y, z), area, triple(radiance))


def scene_of(
    spheres: Any = (), planes: Any = (), quads: Any = (), points: Any = (), brdf: Any = WHITE
) -> Scene:
    """spheres: (centre, radius); planes: (point, normal). Plane normals are rounded to float32,
    and so not quite unit vectors: the sign of a distance is all that is asked of them."""
    any_scene = read_scene(Path(__file__).parent.parent / "scenes" / "tp3.json")
    return dataclasses.replace(
        any_scene,
        spheres=tuple(
            Sphere(f"s{i}", triple(c), float(np.float32(r)), triple(brdf))
            for i, (c, r) in enumerate(spheres)
        ),
        planes=tuple(
            Plane(f"p{i}", triple(p), triple(np.asarray(n) / np.linalg.norm(n)), triple(brdf))
            for i, (p, n) in enumerate(planes)
        ),
        quad_lights=tuple(quads),
        point_lights=tuple(PointLight("l", triple(p), triple(i)) for p, i in points),
    )


def hostile_scene(seed: int) -> Scene:
    """test_estimator_packet's random scene: nothing is kept apart."""
    data = random_scene(seed)
    return scene_of(
        [(s["center"], s["radius"]) for s in data["spheres"]],
        [(p["point"], p["normal"]) for p in data["planes"]],
        [quad(q["position"], q["u"], q["v"]) for q in data["quad_lights"]],
    )


def points_on_objects(scene: Scene, count: int, rng: np.random.Generator) -> Receivers:
    objects = rng.integers(0, len(scene.objects), count)
    point, normal = np.zeros((count, 3)), np.zeros((count, 3))
    inside = rng.random(count) < 0.3
    for i, index in enumerate(objects):
        thing = scene.objects[index]
        if isinstance(thing, Sphere):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            point[i] = np.asarray(thing.center) + thing.radius * direction
            normal[i] = -direction if inside[i] else direction
        else:
            m, somewhere = np.asarray(thing.normal), rng.uniform(-4, 4, 3)
            point[i] = somewhere - ((somewhere - np.asarray(thing.point)) @ m) * m
            normal[i] = m * rng.choice([-1, 1])
    inside &= objects < len(scene.spheres)
    return Receivers(objects, f32(point), f32(normal), inside)


def points_on_floor(scene: Scene, count: int, half: float, rng: np.random.Generator) -> Receivers:
    """On plane 0, which is y = 0, within a square about the origin."""
    point = rng.uniform(-half, half, (count, 3)) * [1, 0, 1]
    floor = np.full(count, len(scene.spheres))
    return Receivers(floor, f32(point), np.tile([0.0, 1.0, 0.0], (count, 1)), floor < 0)


def vec3(v: Any) -> dict[str, float]:
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}


def rgb(v: Any) -> dict[str, float]:
    return {"r": float(v[0]), "g": float(v[1]), "b": float(v[2])}


class CScene:
    """The same scene in C, and its functions for many receivers."""

    def __init__(self, scene: Scene) -> None:
        core, camera = library(), scene.camera
        spheres = [
            {"center": vec3(s.center), "radius": s.radius, "brdf": rgb(s.brdf)}
            for s in scene.spheres
        ]
        planes = [
            {"point": vec3(p.point), "normal": vec3(p.normal), "brdf": rgb(p.brdf)}
            for p in scene.planes
        ]
        self.brdf = [thing.brdf for thing in scene.objects]
        self._spheres, self._planes = ffi.new("Sphere[]", spheres), ffi.new("Plane[]", planes)
        lights = len(scene.quad_lights) + len(scene.point_lights)
        self.lights = ffi.new("Light[]", lights)
        for light, q in zip(self.lights, scene.quad_lights, strict=False):
            light.type = core.LIGHT_QUAD
            light.shape.quad = {
                "corner": vec3(q.corner),
                "edge_u": vec3(q.edge_u),
                "edge_v": vec3(q.edge_v),
                "normal": vec3(q.normal),
                "area": q.area,
                "radiance": rgb(q.radiance),
            }
        for i, p in enumerate(scene.point_lights, start=len(scene.quad_lights)):
            self.lights[i].type = core.LIGHT_POINT
            self.lights[i].shape.point = {
                "position": vec3(p.position),
                "radiant_intensity": rgb(p.radiant_intensity),
            }
        self.scene = ffi.new(
            "Scene *",
            {
                "ray_max_distance": scene.ray_max_distance,
                "camera": {
                    "position": vec3(camera.position),
                    "forward": vec3(camera.forward),
                    "right": vec3(camera.right),
                    "up": vec3(camera.up),
                    "tan_half_fov_y": math.tan(math.radians(camera.fov_y_deg) / 2),
                },
                "nb_spheres": len(spheres),
                "nb_planes": len(planes),
                "nb_lights": lights,
                "spheres": self._spheres,
                "planes": self._planes,
                "lights": self.lights,
            },
        )

    def hits(self, receivers: Receivers) -> list[Any]:
        return [
            ffi.new(
                "Hit *",
                {
                    "object": int(receivers.object_id[i]),
                    "point": vec3(receivers.point[i]),
                    "normal": vec3(receivers.normal[i]),
                    "brdf": rgb(self.brdf[receivers.object_id[i]]),
                },
            )
            for i in range(len(receivers))
        ]

    def packets(self, receivers: Receivers) -> list[Any]:
        """The last one has empty lanes, unless the count is a multiple of 16."""
        hits, packets = self.hits(receivers), []
        for start in range(0, len(hits), LANES):
            packet = ffi.new("HitPacket *", {"object": [-1] * LANES})
            for lane, hit in enumerate(hits[start : start + LANES]):
                packet.any_hit = True
                packet.object[lane] = hit.object
                for name in "xyz":
                    getattr(packet.point, name)[lane] = getattr(hit.point, name)
                    getattr(packet.normal, name)[lane] = getattr(hit.normal, name)
                for name in "rgb":
                    getattr(packet.brdf, name)[lane] = getattr(hit.brdf, name)
            packets.append(packet)
        return packets

    def irradiance(self, light: int, receivers: Receivers) -> tuple[np.ndarray, np.ndarray]:
        """irradiance_light's value and error bound, (n,) each."""
        value, bound = np.zeros(len(receivers)), np.zeros(len(receivers))
        error = ffi.new("double *")
        for i, hit in enumerate(self.hits(receivers)):
            value[i] = library().irradiance_light(self.scene, self.lights + light, hit, error)
            bound[i] = error[0]
        return value, bound

    def irradiance_by_packet(self, light: int, receivers: Receivers) -> np.ndarray:
        result, value = [], ffi.new("double[16]")
        for packet in self.packets(receivers):
            library().irradiance_packet(self.scene, self.lights + light, packet, value)
            result += list(value)
        assert not any(result[len(receivers) :])
        return np.array(result[: len(receivers)])


def without_objects(scene: Scene, light: int, receivers: Receivers) -> np.ndarray:
    """What the light would give if nothing but the horizon stood before it."""
    bare = CScene(dataclasses.replace(scene, spheres=(), planes=()))
    bare.brdf = [WHITE] * (len(scene.objects) + 1)
    return bare.irradiance(light, receivers)[0]


def python_solution(
    scene: Scene, light: QuadLight, receivers: Receivers
) -> tuple[np.ndarray, np.ndarray]:
    """Value and error bound. The irradiance is linear in the normal,
    and compare/ wants unit normals, which float32 does not hold."""
    length = np.linalg.norm(receivers.normal, axis=1)
    unit = dataclasses.replace(receivers, normal=receivers.normal / length[:, None])
    view = light_view(scene, light, unit)
    return view.projected_solid_angle * length, view.error_bound * length


def assert_packets_agree(scene: Scene, light: int, receivers: Receivers) -> None:
    """Vector code against irradiance.c, whose error bound is 16 eps for each radian of outline.
    The polynomials for the arctangent add 2e-13 of each edge's term, of which the outline's
    length is the sum of magnitudes: less than 1,000 eps. A sphere's outline is known to
    eps / sin^2 of its cone's half-angle, relatively."""
    core = CScene(scene)
    value, bound = core.irradiance(light, receivers)
    bare = without_objects(scene, light, receivers)
    sine_squared = 1.0
    for sphere in scene.spheres:
        apart = receivers.point - np.asarray(sphere.center)
        sine_squared = min(sine_squared, sphere.radius**2 / (apart**2).sum(axis=1).max())
    tolerance = 64 * bound + 8 * EPS / max(sine_squared, 1e-7) * bare
    by_packet = core.irradiance_by_packet(light, receivers)
    assert (np.abs(by_packet - value) <= tolerance).all()


# ---- against the Python solution


@pytest.mark.parametrize("first_seed", range(0, 100, 20))
def test_irradiance_is_the_python_solution_on_hostile_scenes(first_seed: int) -> None:
    """Both give bounds on their errors: the difference is below their sum, also where a sphere
    cuts the light."""
    solved = 0
    for seed in range(first_seed, first_seed + 20):
        scene = hostile_scene(seed)
        if not scene.objects:
            continue
        receivers = points_on_objects(scene, 200, np.random.default_rng(seed))
        core = CScene(scene)
        for i, light in enumerate(scene.quad_lights):
            expected, error = python_solution(scene, light, receivers)
            value, bound = core.irradiance(i, receivers)
            assert (np.abs(value - expected) <= error + bound).all(), f"seed {seed}, light {i}"
            solved += (expected > 0).sum()
    assert solved > 500  # the test would see nothing otherwise


def test_balls_that_cut_the_light_are_solved_alike() -> None:
    """Spheres about the light itself: both bounds hold, and C's is rounding."""
    rng = np.random.default_rng(3)
    light = quad([-1, 3, -1], [2, 0, 0.5], [-0.25, 0.5, 2])
    light = light if light.normal[1] > 0 else quad(light.corner, light.edge_v, light.edge_u)
    cases = 0
    for _ in range(12):
        spheres = [
            (np.array([0, 3.2, 0]) + rng.uniform(-1, 1, 3), rng.uniform(0.1, 0.8)) for _ in range(3)
        ]
        scene = scene_of(spheres, [((0, 0, 0), (0, 1, 0))], [light])
        receivers = points_on_floor(scene, 10, 2, rng)
        expected, error = python_solution(scene, light, receivers)
        value, bound = CScene(scene).irradiance(0, receivers)
        bare = without_objects(scene, 0, receivers)
        assert (np.abs(value - expected) <= error + bound).all()
        assert (bound <= 1e-12 * bare).all()
        cases += ((expected > 0) & (expected < bare)).sum()
    assert cases > 50


TABLE = {  # irradiance * 40 on the floor at (x, -2, z), against brute force with 4 million points
    (0, 1.8): 0.54903358,
    (0.3, 1.7): 0.89020111,
    (-1, 2): 1.01930774,
    (1.3, 3): 0.79775183,
    (0.2, 4.3): 0.83866906,
    (3, 3): 0.97721693,
    (0, 3): 0,
    (-0.7, 4.1): 0.84399234,
}


@pytest.mark.parametrize("place", TABLE)
def test_floor_of_the_labs_scene_matches_known_values(place: tuple[float, float]) -> None:
    """Eight decimals, so 5e-9, and what rounding the place to float32 changes: gradient times
    rounding, the gradient from differences over 2^-9."""
    scene = read_scene(Path(__file__).parent.parent / "scenes" / "tp3.json")
    core, h = CScene(scene), 2.0**-9
    exact = np.array([place[0], -2, place[1]])
    points = f32(exact) + h * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    floor = Receivers(np.full(5, 1), points, np.tile([0.0, 1, 0], (5, 1)), np.zeros(5, dtype=bool))
    value = 40 * core.irradiance(0, floor)[0]
    gradient = np.abs([value[1] - value[2], 0, value[3] - value[4]]) / (2 * h)
    tolerance = 5.1e-9 + 2 * gradient @ np.abs(f32(exact) - exact)
    assert abs(value[0] - TABLE[place]) <= tolerance
    assert abs(40 * core.irradiance_by_packet(0, floor)[0] - TABLE[place]) <= tolerance


@pytest.mark.parametrize("name", ["tp3", "tp3_statement", "tp3_point"])
def test_exact_frame_of_the_labs_scenes_is_within_1e_6(name: str) -> None:
    """Camera rays, hits and results are float32, the sums in between are not: a relative RMSE of
    some 2 EPS_REAL of the brightest, where the project's promise is 1e-6."""
    scene = read_scene(Path(__file__).parent.parent / "scenes" / f"{name}.json")
    width, height = 96, 64
    expected = exact_image(scene, width, height)
    core = CScene(scene)
    image = np.zeros((height, width, 3))
    hits, radiance = ffi.new("HitPacket *"), ffi.new("RgbPacket *")
    camera = ffi.addressof(core.scene[0], "camera")
    plane = ffi.new("ImagePlane *", library().image_plane(camera, width, height))
    for y in range(height):
        for x in range(0, width, LANES):
            xs, ys = [x + i + 0.5 for i in range(LANES)], [y + 0.5] * LANES
            library().packet_hit(core.scene, plane, xs, ys, hits)
            library().exact_lighting_packet(core.scene, hits, radiance)
            channels = [list(radiance.r), list(radiance.g), list(radiance.b)]
            image[y, x : x + LANES] = np.transpose(channels)
    seen = (expected.shadow != BACKGROUND) & ~expected.silhouette
    difference = image[seen] - expected.radiance[seen]
    assert np.linalg.norm(difference) <= 1e-6 * np.linalg.norm(expected.radiance[seen])
    assert not image[expected.shadow == BACKGROUND].any()


# ---- sixteen at a time


@pytest.mark.parametrize("first_seed", range(200, 300, 25))
def test_packets_are_the_scalar_solution_on_hostile_scenes(first_seed: int) -> None:
    for seed in range(first_seed, first_seed + 25):
        scene = hostile_scene(seed)
        if scene.objects:
            receivers = points_on_objects(scene, 41, np.random.default_rng(seed))
            for i in range(len(scene.quad_lights)):
                assert_packets_agree(scene, i, receivers)


def shadowed_floor(seed: int) -> tuple[Scene, Receivers]:
    """A floor, a light of side 0.003 to 5 over it, and one to three spheres between."""
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-2.5, 0.7)
    u, v = rng.normal(size=(2, 3)) * size
    if np.cross(u, v)[1] < 0:
        u, v = v, u
    corner = np.array([0, 4, 0]) + rng.uniform(-1, 1, 3) - (u + v) / 2
    spheres = []
    for _ in range(rng.integers(1, 4)):
        foot = rng.uniform(-1, 1, 3) * [1, 0, 1]
        target = corner + rng.random() * u + rng.random() * v
        center = foot + rng.uniform(0.15, 0.85) * (target - foot)
        spheres.append((center, 10 ** rng.uniform(-1.7, 0.3)))
    scene = scene_of(spheres, [((0, 0, 0), (0, 1, 0))], [quad(corner, u, v)])
    return scene, points_on_floor(scene, 96, 2, rng)


def test_packets_are_the_scalar_solution_in_penumbras() -> None:
    """One or more cones, partly over the light, also overlapping: a quarter of all points."""
    penumbra = total = 0
    for seed in range(80):
        scene, receivers = shadowed_floor(seed)
        assert_packets_agree(scene, 0, receivers)
        value, bare = (
            CScene(scene).irradiance(0, receivers)[0],
            without_objects(scene, 0, receivers),
        )
        penumbra += ((value > 1e-9 * bare) & (value < (1 - 1e-9) * bare)).sum()
        total += len(receivers)
    assert penumbra > 0.2 * total


def test_packets_are_the_scalar_solution_under_wide_lights_and_beside_balls() -> None:
    """A light much wider than it is high, and balls that rest on the floor close by or are sunk
    in it: cones of almost a half-space, and parts of the light in the cone's other half."""
    rng = np.random.default_rng(4)
    low = quad([-8, 1.5, -8], [0, 0, 16], [16, 0, 0])
    for _ in range(60):
        spheres = []
        for _ in range(rng.integers(1, 4)):
            radius = float(np.float32(10 ** rng.uniform(-1, -0.2)))
            height = radius * rng.choice([1, rng.uniform(-0.9, 1)])
            spheres.append((rng.uniform(-1, 1, 3) * [1, 0, 1] + [0, height, 0], radius))
        scene = scene_of(spheres, [((0, 0, 0), (0, 1, 0))], [low])
        assert_packets_agree(scene, 0, points_on_floor(scene, 64, 1.5, rng))


# ---- what geometry says


def closed_box(half: float) -> list[QuadLight]:
    """Six lights that face inwards: the cube |x|, |y|, |z| <= half."""
    lights = []
    for axis in range(3):
        for sign in (-1, 1):
            normal = np.zeros(3)
            normal[axis] = sign  # light leaves on the side of -normal
            u, v = np.roll(normal, 1) * sign, np.roll(normal, 2)
            lights.append(quad(half * (normal - u - v), 2 * half * u, 2 * half * v))
    return lights


def sum_over_lights(scene: Scene, receivers: Receivers) -> tuple[np.ndarray, np.ndarray]:
    """By irradiance_light and by irradiance_packet."""
    core, lights = CScene(scene), range(len(scene.quad_lights))
    return (
        sum(core.irradiance(i, receivers)[0] for i in lights),
        sum(core.irradiance_by_packet(i, receivers) for i in lights),
    )


def test_irradiance_in_a_closed_box_of_light_is_pi() -> None:
    """The hemisphere's projected solid angle is pi, however the horizon cuts the six lights; times
    the normal's length, which float32 leaves a little off 1. 12 outlines of at most 2 pi each, 16
    eps a radian."""
    rng = np.random.default_rng(5)
    normal = rng.normal(size=(200, 3))
    normal = f32(normal / np.linalg.norm(normal, axis=1)[:, None])
    point = f32(rng.uniform(-0.95, 0.95, (200, 3)))
    receivers = Receivers(np.zeros(200, dtype=int), point, normal, np.zeros(200, dtype=bool))
    scene = scene_of(planes=[((0, 9, 0), (0, 1, 0))], quads=closed_box(1))
    expected = np.pi * np.linalg.norm(normal, axis=1)
    for value in sum_over_lights(scene, receivers):
        assert np.abs(value - expected).max() <= 12 * 2 * np.pi * 16 * EPS


def test_a_sphere_in_a_closed_box_takes_the_projection_of_its_cone() -> None:
    """A cone of half-angle alpha, its axis at theta to the normal and all of it above the horizon,
    has the projected solid angle pi sin^2(alpha) cos(theta), over however many lights it lies."""
    rng = np.random.default_rng(6)
    center, radius = np.array([0.125, 0.25, -0.125]), 0.25
    scene = scene_of([(center, radius)], [((0, -0.75, 0), (0, 1, 0))], closed_box(1))
    receivers = points_on_floor(scene, 150, 0.9, rng)
    receivers = dataclasses.replace(receivers, point=receivers.point - [0, 0.75, 0])
    axis = center - receivers.point
    squared = (axis**2).sum(axis=1)
    expected = np.pi * (1 - radius**2 / squared * axis[:, 1] / np.sqrt(squared))
    for value in sum_over_lights(scene, receivers):
        assert np.abs(value - expected).max() <= 24 * 2 * np.pi * 16 * EPS


def test_halves_of_a_light_add_up() -> None:
    """Cut along u at the middle and along v at a quarter; spheres before it, on it and around."""
    rng = np.random.default_rng(7)
    corner, u, v = np.array([-1, 3, 0.5]), np.array([2, 0.5, 0.5]), np.array([0.5, 0.25, -2])
    whole = quad(corner, u, v)
    assert whole.normal[1] > 0
    parts = [
        quad(corner + s * u + t * v, 0.5 * u, part * v)
        for s in (0, 0.5)
        for t, part in ((0, 0.25), (0.25, 0.75))
    ]
    spheres = [((0, 1, 0), 0.5), ((0.5, 1.5, -0.25), 0.75), ((0.25, 3.25, 0), 0.5)]
    scene = scene_of(spheres, [((0, 0, 0), (0, 1, 0))], [whole, *parts])
    receivers = points_on_floor(scene, 80, 2, rng)
    core = CScene(scene)
    results = [core.irradiance(i, receivers) for i in range(5)]
    difference = results[0][0] - sum(value for value, _ in results[1:])
    assert (np.abs(difference) <= sum(bound for _, bound in results)).all()


def test_nothing_is_seen_from_behind_below_or_inside() -> None:
    """Behind the light, in its plane, below the horizon, inside a sphere without the light,
    beyond a plane; and all of it where the sphere around the point holds the light too."""
    light = quad([-1, 2, -1], [0, 0, 2], [2, 0, 0])
    assert light.normal[1] > 0

    def seen(point: Any, normal: Any, spheres: Any = (), planes: Any = (), on: int = 99) -> Any:
        scene = scene_of(spheres, planes, [light])
        receivers = Receivers(np.array([on]), f32([point]), f32([normal]), np.zeros(1, dtype=bool))
        core = CScene(scene)
        core.brdf = [WHITE] * 100
        value = core.irradiance(0, receivers)[0][0]
        assert core.irradiance_by_packet(0, receivers)[0] == pytest.approx(value, abs=1e-14)
        return value

    up = (0, 1, 0)
    free = seen((0, 0, 0), up)
    assert free > 0
    assert seen((0, 3, 0), (0, -1, 0)) == 0
    assert seen((5, 2, 0), (-1, 0, 0)) == 0
    assert seen((0, 0, 0), (0, -1, 0)) == 0
    assert seen((0, 0, 0), up, planes=[((0, 1, 0), (0, 1, 0))]) == 0
    assert seen((0, 0, 0), up, planes=[((0, -1, 0), (0, 1, 0))]) == free
    assert seen((0, -1, 0), up, spheres=[((0, 0, 0), 1)], on=0) == 0
    assert seen((0, 0.5, 0), up, spheres=[((0, 0, 0), 1)]) == 0
    assert seen((0, 0, 0), up, spheres=[((0, 1, 0), 4)]) == free
    assert seen((0, 0, 0), up, spheres=[((0, 2, 0), 1.75)]) == 0  # it holds the light alone
    assert seen((0, 0, 0), up, spheres=[((0, 4, 0), 1)]) == free


def test_a_sphere_given_twice_hides_no_more_than_once() -> None:
    """Equal cones, which overlap everywhere, and one within another."""
    scene, receivers = shadowed_floor(17)
    assert len(scene.spheres) > 1
    once, bound = CScene(scene).irradiance(0, receivers)
    inner = dataclasses.replace(scene.spheres[0], radius=scene.spheres[0].radius / 2)
    twice = dataclasses.replace(scene, spheres=(*scene.spheres, *scene.spheres, inner))
    receivers = dataclasses.replace(receivers, object_id=np.full(96, len(twice.spheres)))
    assert (once < without_objects(twice, 0, receivers)).any()
    value, bound_twice = CScene(twice).irradiance(0, receivers)
    assert (np.abs(value - once) <= bound + bound_twice).all()


@pytest.mark.parametrize("size", [1e-1, 1e-2, 1e-3, 1e-4, 1e-5])
def test_small_lights_keep_their_digits(size: float) -> None:
    """Lambert's terms are as large as the light's side, their sum as its area: eps / size is lost.
    The reference is a 12 x 12 point Gauss-Legendre rule, whose terms have one sign; its own error
    is below (size / 2)^24."""
    rng = np.random.default_rng(8)
    u, v = np.array([0, 0, 1.0]), np.array([1, 0.25, 0.5])
    light = quad([0.25, 1, -0.125], size * u, size * v)
    assert light.normal[1] > 0
    scene = scene_of(planes=[((0, 0, 0), (0, 1, 0))], quads=[light])
    receivers = points_on_floor(scene, 32, 1, rng)
    node, weight = np.polynomial.legendre.leggauss(12)
    s, t = np.meshgrid((1 + node) / 2, (1 + node) / 2)
    w = (
        np.asarray(light.corner)
        + s[..., None] * np.asarray(light.edge_u)
        + t[..., None] * np.asarray(light.edge_v)
        - receivers.point[:, None, None]
    )
    squared = (w**2).sum(axis=-1)
    integrand = w[..., 1] * (w @ np.asarray(light.normal)) / squared**2
    expected = light.area / 4 * np.einsum("nij,i,j->n", integrand, weight, weight)
    core = CScene(scene)
    value, bound = core.irradiance(0, receivers)
    assert (bound <= 16 * EPS * 4 * size * 2).all()  # four edges, each at most 1.15 size / 1
    assert (np.abs(value - expected) <= bound + 1e-14 * expected).all()
    by_packet = core.irradiance_by_packet(0, receivers)
    assert (np.abs(by_packet - expected) <= bound + 2e-13 * expected).all()


def test_more_spheres_than_there_is_room_for_say_so() -> None:
    """Forty overlapping spheres are in closed form; of 300 before the light 256 fit, and the bound
    is then all that the light gives."""
    rng = np.random.default_rng(9)
    light, middle = quad([-1, 4, -1], [0, 0, 2], [2, 0, 0]), np.array([0, 2, 0])

    def crowd(count: int) -> tuple[Scene, Receivers]:
        spheres = [(middle + rng.uniform(-0.5, 0.5, 3), 0.0625) for _ in range(count)]
        scene = scene_of(spheres, [((0, 0, 0), (0, 1, 0))], [light])
        return scene, points_on_floor(scene, 4, 0.25, rng)

    scene, receivers = crowd(40)
    expected, error = python_solution(scene, light, receivers)
    value, bound = CScene(scene).irradiance(0, receivers)
    assert (value < without_objects(scene, 0, receivers)).all()
    assert (np.abs(value - expected) <= error + bound).all()
    assert_packets_agree(scene, 0, receivers)

    scene, receivers = crowd(300)
    bound = CScene(scene).irradiance(0, receivers)[1]
    assert bound == pytest.approx(without_objects(scene, 0, receivers), rel=1e-12)


# ---- several lights


def test_exact_lighting_sums_all_lights_times_brdf() -> None:
    """Two quads and a point light: L = brdf (L_1 E_1 + L_2 E_2 + I cos / d^2), to the roundings of
    float32; the packet likewise, and 0 in empty lanes."""
    rng = np.random.default_rng(10)
    quads = [
        quad([-1, 4, -1], [0, 0, 2], [2, 0, 0], (8, 4, 2)),
        quad([2, 3, 0], [0.25, 0, 1], [1, 0, 0], (1, 2, 16)),
    ]
    lamp, intensity = np.array([-1, 2, 1]), np.array([3, 5, 7])
    scene = scene_of(
        [((0, 1, 0), 0.5)],
        [((0, 0, 0), (0, 1, 0))],
        quads,
        [(lamp, intensity)],
        brdf=(0.25, 0.5, 0.75),
    )
    receivers = points_on_floor(scene, 70, 3, rng)
    core = CScene(scene)
    expected = np.zeros((70, 3))
    for i, light in enumerate(quads):
        expected += core.irradiance(i, receivers)[0][:, None] * np.asarray(light.radiance)
    to_lamp = lamp - receivers.point
    squared = (to_lamp**2).sum(axis=1)
    along = ((np.array([0, 1, 0]) - receivers.point) * to_lamp).sum(axis=1) / squared
    nearest = receivers.point + along[:, None] * to_lamp - [0, 1, 0]
    free = (nearest**2).sum(axis=1) > 0.25
    assert 0 < free.sum() < 70
    expected += (free * to_lamp[:, 1] / squared**1.5)[:, None] * intensity
    expected *= [0.25, 0.5, 0.75]

    one_by_one = []
    for hit in core.hits(receivers):
        sum_ = library().exact_lighting(core.scene, hit)
        one_by_one.append([sum_.r, sum_.g, sum_.b])
    assert np.array(one_by_one) == pytest.approx(expected, rel=16 * EPS_REAL)

    by_packet, radiance = [], ffi.new("RgbPacket *")
    for packet in core.packets(receivers):
        library().exact_lighting_packet(core.scene, packet, radiance)
        by_packet += list(zip(radiance.r, radiance.g, radiance.b, strict=True))
    assert np.array(by_packet[:70]) == pytest.approx(expected, rel=16 * EPS_REAL)
    assert not np.array(by_packet[70:]).any()
