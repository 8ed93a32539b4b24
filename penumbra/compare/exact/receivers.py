"""What the camera sees: the nearest hit of each camera ray, in double precision."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from penumbra.compare.scene import Plane, Scene, Sphere

BACKGROUND = -1
"""object_id of a ray that meets nothing within ray_max_distance"""


@dataclass(frozen=True)
class Receivers:
    """n points that receive light."""

    object_id: np.ndarray
    """(n,) int, position in scene.objects, or BACKGROUND (the other fields then mean nothing)"""
    point: np.ndarray
    """(n, 3) [m]"""
    normal: np.ndarray
    """(n, 3) unit vectors on the side that the camera ray came from"""
    inside: np.ndarray
    """(n,) bool: on a sphere, seen from its inside"""

    def __getitem__(self, which: np.ndarray | slice) -> Receivers:
        return Receivers(
            self.object_id[which], self.point[which], self.normal[which], self.inside[which]
        )

    def __len__(self) -> int:
        return len(self.object_id)


def camera_hits(scene: Scene, x: np.ndarray, y: np.ndarray, width: int, height: int) -> Receivers:
    """The nearest hits of the camera rays through image points (x, y).

    x, y: (n,) in pixels from the top left corner of an image of width x height pixels.
    """
    camera = scene.camera
    half_height = math.tan(math.radians(camera.fov_y_deg) / 2)
    direction = (
        np.asarray(camera.forward)
        + ((2 * x / width - 1) * (width / height) * half_height)[:, None] * np.asarray(camera.right)
        + ((1 - 2 * y / height) * half_height)[:, None] * np.asarray(camera.up)
    )
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    origin = np.asarray(camera.position)

    nearest = np.full(len(x), np.inf)
    object_id = np.full(len(x), BACKGROUND)
    leaving = np.zeros(len(x), dtype=bool)
    for i, thing in enumerate(scene.objects):
        if isinstance(thing, Sphere):
            distance, from_inside = _sphere_hit(thing, origin, direction)
        else:
            distance, from_inside = _plane_hit(thing, origin, direction)
        closer = (distance < nearest) & (distance <= scene.ray_max_distance)
        nearest[closer] = distance[closer]
        object_id[closer] = i
        leaving[closer] = from_inside[closer]

    met = object_id != BACKGROUND
    point = origin + np.where(met, nearest, 0.0)[:, None] * direction
    normal = np.zeros_like(point)
    for i, thing in enumerate(scene.objects):
        on = object_id == i
        if on.any():
            point[on], normal[on] = _on_surface(thing, point[on])
    on_sphere = object_id < len(scene.spheres)
    away = np.where(on_sphere, leaving, np.einsum("ij,ij->i", normal, direction) > 0)
    normal[away] *= -1
    return Receivers(object_id, point, normal, met & on_sphere & leaving)


def _sphere_hit(
    sphere: Sphere, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along each ray (inf where it misses), and whether the ray then leaves the ball.

    The discriminant is R^2 - |perpendicular|^2, not b^2 - c, and the second root is c / q:
    a small sphere far away would drown in b^2 (Haines et al., Precision Improvements for
    Ray/Sphere Intersection, Ray Tracing Gems, 2019).
    """
    to_centre = np.asarray(sphere.center) - origin
    along = direction @ to_centre
    perpendicular = to_centre - along[:, None] * direction
    discriminant = sphere.radius**2 - np.einsum("ij,ij->i", perpendicular, perpendicular)
    gap = np.linalg.norm(to_centre)
    constant = (gap - sphere.radius) * (gap + sphere.radius)
    q = along + np.copysign(np.sqrt(np.maximum(discriminant, 0)), along)
    with np.errstate(divide="ignore", invalid="ignore"):
        other = constant / q
    near, far = np.fmin(q, other), np.fmax(q, other)
    distance = np.where(near > 0, near, far)
    missed = (discriminant < 0) | ~(distance > 0)
    return np.where(missed, np.inf, distance), near <= 0


def _plane_hit(
    plane: Plane, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    normal = np.asarray(plane.normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = float(normal @ (np.asarray(plane.point) - origin)) / (direction @ normal)
    return np.where(distance > 0, distance, np.inf), np.zeros(len(direction), dtype=bool)


def _on_surface(thing: Sphere | Plane, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points moved onto the surface that rounding took them off, and its normals there."""
    if isinstance(thing, Sphere):
        normal = point - np.asarray(thing.center)
        # zero, and so dark, where rounding took the point to the centre
        normal /= np.maximum(np.linalg.norm(normal, axis=1), np.finfo(float).tiny)[:, None]
        return np.asarray(thing.center) + thing.radius * normal, normal
    normal = np.asarray(thing.normal)
    off = (point - np.asarray(thing.point)) @ normal
    return point - off[:, None] * normal, np.broadcast_to(normal, point.shape)
