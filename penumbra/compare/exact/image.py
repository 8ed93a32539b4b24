"""The exact image: direct lighting without noise, and which pixels see how much of the lights.

docs/exact.md derives it; irradiance.py has what one light gives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from penumbra.compare.exact.irradiance import light_view
from penumbra.compare.exact.receivers import Receivers, camera_hits
from penumbra.compare.scene import PointLight, Scene

BACKGROUND, LIT, PENUMBRA, UMBRA = 0, 1, 2, 3
"""Values of ExactImage.shadow."""
CHUNK = 1 << 14
"""Camera rays worked on at once: what keeps the temporary arrays near the cache."""


@dataclass(frozen=True)
class ExactImage:
    """The image that a renderer's mean must tend to."""

    radiance: np.ndarray
    """(H, W, 3) float64 [W m^-2 sr^-1], background included"""
    object_id: np.ndarray
    """(H, W) int: position in scene.objects, -1 for the background; of the pixel's centre"""
    shadow: np.ndarray
    """(H, W) int8 at the pixel's centre: LIT where every light is wholly visible (in front of
    the receiver, above its horizon, behind nothing), UMBRA where no part of any is, PENUMBRA
    between, BACKGROUND"""
    silhouette: np.ndarray
    """(H, W) bool: the 3x3 pixels around it hold two objects (or background), or both sides
    of a point light's shadow"""
    error_bound: np.ndarray
    """(H, W) bound on the absolute error of radiance's largest channel: rounding, the
    coordinates' included. With pixel_grid > 1 of the mean over the grid, not of the grid as a
    stand-in for the pixel (docs/exact.md)"""


def exact_image(
    scene: Scene, width: int | None = None, height: int | None = None, pixel_grid: int = 1
) -> ExactImage:
    """The scene's direct lighting, L_o = sum over lights of brdf * L_e * projected solid angle
    of the visible part (quad) or brdf * I * cos_surface / d^2 (point).

    width, height: pixels, instead of the scene's own. pixel_grid = 1 gives what a ray through
    each pixel's centre sees; k > 1 the mean over the pixel by k x k Gauss-Legendre positions
    (equal steps would be 1e-3 wrong on the floor near the horizon where these are 3e-5, at k = 4
    and 300 x 200 pixels).
    Raises ValueError unless all three are positive.
    """
    width = scene.width if width is None else width
    height = scene.height if height is None else height
    if min(width, height, pixel_grid) < 1:
        raise ValueError("width, height and pixel_grid must be 1 or more")
    centre = _Layer.render(scene, width, height, 0.5, 0.5)
    radiance, error_bound, edge = centre.radiance, centre.error_bound, centre.edges()
    if pixel_grid > 1:
        radiance, error_bound = np.zeros_like(radiance), np.zeros_like(error_bound)
        for weight, dx, dy in _positions(pixel_grid):
            layer = _Layer.render(scene, width, height, dx, dy)
            radiance += weight * layer.radiance
            error_bound += weight * layer.error_bound
            edge |= layer.object_id != centre.object_id
            edge |= (layer.blocked != centre.blocked).any(axis=-1)
    return ExactImage(radiance, centre.object_id, centre.shadow, edge, error_bound)


def regions(scene: Scene, exact: ExactImage) -> dict[str, np.ndarray]:
    """The image's parts, name -> (H, W) bool: "all" (every object), "lit", "penumbra", "umbra",
    each object by its name, "<object>:lit" and so on, without the silhouettes, which are
    "silhouette". Parts without a pixel are left out.
    """
    counted = ~exact.silhouette & (exact.object_id >= 0)
    shadows = {"lit": LIT, "penumbra": PENUMBRA, "umbra": UMBRA}
    result = {"all": counted}
    result |= {name: counted & (exact.shadow == value) for name, value in shadows.items()}
    for i, thing in enumerate(scene.objects):
        on = counted & (exact.object_id == i)
        result[thing.name] = on
        result |= {f"{thing.name}:{name}": on & result[name] for name in shadows}
    result["silhouette"] = exact.silhouette
    return {name: mask for name, mask in result.items() if mask.any()}


@dataclass(frozen=True)
class _Layer:
    """One ray through each pixel, at the same place in all of them."""

    radiance: np.ndarray
    object_id: np.ndarray
    shadow: np.ndarray
    error_bound: np.ndarray
    blocked: np.ndarray
    """(H, W, number of point lights) bool"""

    @staticmethod
    def render(scene: Scene, width: int, height: int, dx: float, dy: float) -> _Layer:
        """One ray through (column + dx, row + dy) of every pixel."""
        rows = max(1, CHUNK // width)
        parts = []
        for first in range(0, height, rows):
            y, x = np.mgrid[first : min(first + rows, height), 0:width]
            hits = camera_hits(scene, x.ravel() + dx, y.ravel() + dy, width, height)
            parts.append(shade(scene, hits))
        flat = [np.concatenate(values) for values in zip(*parts, strict=True)]
        return _Layer(*(values.reshape(height, width, *values.shape[1:]) for values in flat))

    def edges(self) -> np.ndarray:
        """(H, W) bool: whether the 3x3 pixels around hold two objects, or both sides of a
        point light's shadow."""
        edge = _mixed_neighbourhood(self.object_id)
        for light in range(self.blocked.shape[-1]):
            edge |= _mixed_neighbourhood(self.blocked[..., light])
        return edge


def _positions(k: int) -> Iterator[tuple[float, float, float]]:
    """(weight, dx, dy) of the k x k Gauss-Legendre positions in a pixel."""
    nodes, weights = np.polynomial.legendre.leggauss(k)  # type: ignore[no-untyped-call]
    for x, weight_x in zip(nodes, weights, strict=True):
        for y, weight_y in zip(nodes, weights, strict=True):
            yield weight_x * weight_y / 4, 0.5 + x / 2, 0.5 + y / 2


def shade(scene: Scene, hits: Receivers) -> tuple[np.ndarray, ...]:
    """Of n points: radiance (n, 3), object_id, shadow, error_bound (n,), as in ExactImage, and
    blocked (n, number of point lights) bool: whether an object is in the way of that light."""
    n = len(hits)
    radiance = np.tile(np.asarray(scene.background_radiance), (n, 1))
    error, shadow = np.zeros(n), np.full(n, BACKGROUND, dtype=np.int8)
    blocked = np.zeros((n, len(scene.point_lights)), dtype=bool)
    index = np.flatnonzero(hits.object_id >= 0)
    receivers = hits[index]
    brdf = np.array([thing.brdf for thing in scene.objects]).reshape(-1, 3)[receivers.object_id]

    irradiance = np.zeros((len(index), 3))
    irradiance_error = np.zeros((len(index), 3))
    whole, hidden = np.ones(len(index), dtype=bool), np.ones(len(index), dtype=bool)
    for i, point_light in enumerate(scene.point_lights):
        geometry, visible, behind = _point_view(scene, point_light, receivers)
        intensity = np.asarray(point_light.radiant_intensity)
        irradiance += geometry[:, None] * intensity
        irradiance_error += np.finfo(float).eps * 8 * geometry[:, None] * intensity
        if intensity.any():
            blocked[index, i] = behind
            whole &= visible
            hidden &= ~visible
    for light in scene.lights:
        if isinstance(light, PointLight):
            continue
        light_radiance = np.asarray(light.radiance)
        if light_radiance.any():
            view = light_view(scene, light, receivers)
            irradiance += view.projected_solid_angle[:, None] * light_radiance
            irradiance_error += view.error_bound[:, None] * light_radiance
            whole &= view.whole
            hidden &= view.hidden
    radiance[index] = brdf * irradiance
    error[index] = (brdf * irradiance_error).max(axis=1, initial=0)
    shadow[index] = np.where(hidden, UMBRA, np.where(whole, LIT, PENUMBRA))
    return radiance, hits.object_id, shadow, error, blocked


def _point_view(
    scene: Scene, light: PointLight, receivers: Receivers
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """visibility cos_surface / d^2 [m^-2], whether the light is visible, and whether another
    object (or the far wall of the own sphere) is in the way: (n,) each."""
    to_light = np.asarray(light.position) - receivers.point
    squared = np.einsum("ij,ij->i", to_light, to_light)
    height = np.einsum("ij,ij->i", to_light, receivers.normal)
    behind = np.zeros(len(receivers), dtype=bool)
    for j, sphere in enumerate(scene.spheres):
        centre = np.asarray(sphere.center) - receivers.point
        own = receivers.object_id == j
        within = np.where(own, receivers.inside, (centre**2).sum(axis=1) < sphere.radius**2)
        light_outside = ((to_light - centre) ** 2).sum(axis=1) >= sphere.radius**2
        along = np.einsum("ij,ij->i", to_light, centre) / np.where(squared > 0, squared, 1)
        closest = centre - np.clip(along, 0, 1)[:, None] * to_light
        touches = (closest**2).sum(axis=1) < sphere.radius**2
        behind |= np.where(within, light_outside, touches & ~own)
    for i, plane in enumerate(scene.planes, start=len(scene.spheres)):
        normal = np.asarray(plane.normal)
        side = (receivers.point - np.asarray(plane.point)) @ normal
        light_side = float((np.asarray(light.position) - np.asarray(plane.point)) @ normal)
        behind |= (receivers.object_id != i) & (side * light_side < 0)
    visible = (height > 0) & ~behind
    with np.errstate(divide="ignore", invalid="ignore"):
        geometry = np.where(visible, height / (squared * np.sqrt(squared)), 0)
    return geometry, visible, behind


def _mixed_neighbourhood(values: np.ndarray) -> np.ndarray:
    """(H, W) bool: whether the 3x3 pixels around each pixel differ."""
    padded = np.pad(values, 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.asarray(around.max(axis=(2, 3)) != around.min(axis=(2, 3)))
