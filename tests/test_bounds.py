"""Bounds of a light sample: no sample leaves them."""

from __future__ import annotations

import numpy as np
import pytest

from penumbra.compare.measure.bounds import geometry_range
from penumbra.compare.scene import DiskLight, Light, QuadLight, SphereLight, TriangleLight

WHITE = (1.0, 1.0, 1.0)
CORNER, U, V = (1.0, 3.0, 2.0), (-2.0, 0.3, 0.5), (1.0, 0.2, 2.0)
AREA = float(np.linalg.norm(np.cross(U, V)))
NORMAL = tuple(float(x) for x in np.cross(U, V) / AREA)
LIGHTS: dict[str, Light] = {
    "quad": QuadLight("quad", CORNER, U, V, NORMAL, AREA, WHITE),
    "disk": DiskLight("disk", CORNER, NORMAL, 0.8, WHITE),
    "triangle": TriangleLight("triangle", CORNER, U, V, WHITE),
    "sphere": SphereLight("sphere", CORNER, 0.8, WHITE),
}


def places(light: Light, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3) places on the light, its outline among them, and the normals away from its light."""
    first, second = np.concatenate([rng.random((500, 2)), [[0, 0], [0, 1], [1, 0], [1, 1]]]).T
    match light:
        case SphereLight():
            outwards = rng.normal(size=(2000, 3))
            outwards /= np.linalg.norm(outwards, axis=1)[:, None]
            return np.asarray(light.center) + light.radius * outwards, -outwards
        case DiskLight():
            across = np.cross(light.normal, (0.6, 0.0, 0.8))
            across /= np.linalg.norm(across)
            turn, radius = 2 * np.pi * first, light.radius * np.sqrt(second)
            beside = np.cos(turn)[:, None] * across
            beside += np.sin(turn)[:, None] * np.cross(light.normal, across)
            place = np.asarray(light.center) + radius[:, None] * beside
        case QuadLight():
            place = light.corner + np.outer(first, light.edge_u) + np.outer(second, light.edge_v)
        case TriangleLight():
            s, t = 1 - np.sqrt(first), second * np.sqrt(first)
            place = light.corner + np.outer(s, light.edge_u) + np.outer(t, light.edge_v)
        case _:
            raise AssertionError(light)
    return place, np.broadcast_to(light.normal, place.shape)


@pytest.mark.parametrize("name", LIGHTS)
def test_no_sample_leaves_the_range_of_a_sample(name: str) -> None:
    """By the definition A cos cos / d^2, for 300 points around the light in all directions. The
    range must not be idle either: far before a flat light it is narrow."""
    light, rng = LIGHTS[name], np.random.default_rng(5)
    point = np.asarray(CORNER) + rng.normal(size=(300, 3)) * np.geomspace(0.3, 30, 300)[:, None]
    normal = rng.normal(size=(300, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    least, most = geometry_range(light, point, normal)

    place, away = places(light, rng)
    to_light = place - point[:, None]
    distance = np.linalg.norm(to_light, axis=2)
    cos_surface = np.einsum("pkj,pj->pk", to_light, normal) / distance
    cos_light = np.einsum("pkj,kj->pk", to_light, away) / distance
    sample = light.area * np.maximum(cos_surface, 0) * np.maximum(cos_light, 0) / distance**2
    assert (sample >= least[:, None] - 1e-12 * sample.max()).all()
    assert (sample <= most[:, None] * (1 + 1e-12) + 1e-12 * sample.max()).all()
    assert (sample.max(axis=1) > 0).mean() > 0.2
    far = (distance.min(axis=1) > 10) & (sample.min(axis=1) > 0)
    if name != "sphere":
        assert far.any() and np.median(most[far] / least[far]) < 2
