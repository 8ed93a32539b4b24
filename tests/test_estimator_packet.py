"""The vectorised estimator computes what the textbook one does, sample for sample."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from penumbra.compare.exact.image import exact_image
from penumbra.compare.measure.image import Image
from penumbra.compare.scene import read_scene

Render = Callable[..., Image]
SAMPLERS = ("independent", "jittered", "sobol")
OTHER_LIGHTS = ("tp3_disk", "tp3_sphere", "tp3_triangle", "tp3_sheared", "tp3_two_lights")


def random_scene(seed: int) -> dict[str, Any]:
    """A scene of up to 7 spheres, 3 planes and 4 lights around the camera's view. Nothing is
    kept apart: spheres overlap, hold the camera or stand in a light; planes cut lights."""
    rng = np.random.default_rng(seed)

    def vector(low: float, high: float) -> list[float]:
        return [float(x) for x in rng.uniform(low, high, 3)]

    count = rng.integers
    spheres = [
        {"name": f"s{i}", "center": vector(-3, 3), "radius": float(10 ** rng.uniform(-1.5, 0.4)),
         "color": vector(0, 1)}
        for i in range(count(0, 8))
    ]  # fmt: skip
    planes = [
        {"name": f"p{i}", "point": vector(-3, 3), "normal": vector(-1, 1), "color": vector(0, 1)}
        for i in range(count(0, 4))
    ]
    quads = [
        {"name": f"q{i}", "position": vector(-4, 4), "u": vector(-3, 3), "v": vector(-3, 3),
         "color": vector(0, 1), "power": 10.0}
        for i in range(count(1, 4))
    ]  # fmt: skip
    points = [
        {"name": f"l{i}", "position": vector(-4, 4), "color": vector(0, 1), "power": 10.0}
        for i in range(count(0, 2))
    ]
    return {
        "image": {"width": 37, "height": 23},
        "camera": {
            "position": vector(-4, 4), "look_at": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 60,
        },
        "background": [0.1, 0.2, 0.3],
        "ray_max_distance": 20,
        "spheres": spheres,
        "planes": planes,
        "quad_lights": quads,
        "point_lights": points,
    }  # fmt: skip


def random_scene_of_all_lights(seed: int) -> dict[str, Any]:
    """The same with a light or two of each other shape."""
    rng = np.random.default_rng([seed, 1])
    scene = random_scene(seed)

    def vector(low: float, high: float) -> list[float]:
        return [float(x) for x in rng.uniform(low, high, 3)]

    def lights(name: str, shape: Callable[[], dict[str, Any]]) -> list[dict[str, Any]]:
        return [
            {"name": f"{name}{i}", **shape(), "color": vector(0, 1), "power": 10.0}
            for i in range(rng.integers(1, 3))
        ]

    def radius() -> float:
        return float(10 ** rng.uniform(-1.5, 0.4))

    scene["disk_lights"] = lights(
        "d", lambda: {"center": vector(-4, 4), "normal": vector(-1, 1), "radius": radius()}
    )
    scene["triangle_lights"] = lights(
        "t", lambda: {"position": vector(-4, 4), "u": vector(-3, 3), "v": vector(-3, 3)}
    )
    scene["sphere_lights"] = lights("o", lambda: {"center": vector(-4, 4), "radius": radius()})
    return scene


def assert_same(packets: Image, textbook: Image, light_samples: int) -> None:
    """Both draw the same points, so they differ by rounding: 1e-4 relatively, where the terms
    have conditions (distance to the light, grazing angles) of up to 1e3 over float's 6e-8. A
    shadow ray within rounding of a sphere's edge may fall on either side, which changes the pixel
    by up to one sample's share; at most 1 sample in 2,000 does."""
    scale = np.maximum(np.abs(textbook.radiance), 1e-3)
    differs = np.abs(packets.radiance - textbook.radiance) > 1e-4 * scale
    samples = differs.shape[0] * differs.shape[1] * light_samples
    assert differs.any(axis=-1).sum() <= 2 + samples / 2000


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("seed", range(30))
def test_estimator_packet_is_the_textbook_on_random_scenes(
    seed: int, sampler: str, render: Render, make_scene: Callable[..., Path]
) -> None:
    scene = make_scene(**random_scene_of_all_lights(seed))
    options = {"light_samples": 7, "sampler": sampler, "seed": seed}
    packets = render(scene, estimator="area", **options)
    textbook = render(scene, estimator="textbook", **options)
    assert_same(packets, textbook, 7)


@pytest.mark.parametrize("scene", ["tp3", "tp3_statement", "tp3_point", *OTHER_LIGHTS])
@pytest.mark.parametrize("pixel_samples", [1, 3])
def test_estimator_packet_is_the_textbook_on_the_labs_scenes(
    scene: str, pixel_samples: int, render: Render, scenes: Path
) -> None:
    """More samples than one chunk of the packets, and variances too: they are differences of sums,
    so 1e-3 of the largest."""
    options = {"light_samples": 300, "pixel_samples": pixel_samples, "width": 75, "height": 50}
    packets = render(scenes / f"{scene}.json", estimator="area", **options)
    textbook = render(scenes / f"{scene}.json", estimator="textbook", **options)
    assert_same(packets, textbook, 300)
    assert packets.variance is not None and textbook.variance is not None
    tolerance = 1e-3 * textbook.variance.max() + 1e-12
    assert (np.abs(packets.variance - textbook.variance) > tolerance).sum() <= 4


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_every_sampler_is_bit_identical_for_any_number_of_threads(
    sampler: str, render: Render, make_scene: Callable[..., Path]
) -> None:
    scene = make_scene(**random_scene_of_all_lights(3))
    images = [render(scene, threads=t, sampler=sampler, light_samples=9) for t in (1, 2, 3, 8)]
    for image in images[1:]:
        assert np.array_equal(image.radiance, images[0].radiance)


@pytest.mark.parametrize(
    "scene", ["tp3", "tp3_statement", "tp3_point", "three_spheres", *OTHER_LIGHTS]
)
def test_exact_estimator_is_the_exact_solution(scene: str, render: Render, scenes: Path) -> None:
    """Two implementations of one closed form. What is left is the renderer's float32: the point
    that a ray hits is right to some 1e-6, and so is what it sees."""
    exact = exact_image(read_scene(scenes / f"{scene}.json"), 150, 100)
    image = render(scenes / f"{scene}.json", estimator="exact", width=150, height=100)
    here = ~exact.silhouette
    error = np.linalg.norm((image.radiance - exact.radiance)[here])
    assert error <= 1e-6 * np.linalg.norm(exact.radiance[here])
    assert image.variance is not None and not image.variance.any()


@pytest.mark.parametrize("estimator", ["solid-angle", "exact"])
def test_every_estimator_is_bit_identical_for_any_number_of_threads(
    estimator: str, render: Render, make_scene: Callable[..., Path]
) -> None:
    scene = make_scene(**random_scene_of_all_lights(5))
    images = [render(scene, threads=t, estimator=estimator, light_samples=5) for t in (1, 3, 8)]
    for image in images[1:]:
        assert np.array_equal(image.radiance, images[0].radiance)


def test_solid_angle_estimator_is_unbiased(render: Render, scenes: Path) -> None:
    """As above, over all pixels."""
    exact = exact_image(read_scene(scenes / "tp3.json"), 90, 60)
    image = render(
        scenes / "tp3.json", estimator="solid-angle", light_samples=64, width=90, height=60
    )
    assert image.variance is not None
    here = ~exact.silhouette
    error = (image.radiance - exact.radiance)[here].sum()
    assert abs(error) < 4.5 * np.sqrt(image.variance[here].sum())
