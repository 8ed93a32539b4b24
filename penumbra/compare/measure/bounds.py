"""The least and the most that one light sample can bring to a point.

A sample of a surface light, drawn by area or by solid angle, brings L_e times a value of
A cos_surface cos_light / d^2 on the light, or a mean of such values. On a flat light, with w from
the point to the light and h the light's height over the point, that is A (n . w) h / |w|^4: n . w
and |w| are taken at their extremes one by one, so the bounds are valid but not tight.
"""

from __future__ import annotations

import numpy as np

from penumbra.compare.scene import (
    DiskLight,
    Light,
    PointLight,
    QuadLight,
    SphereLight,
    TriangleLight,
)


def geometry_range(
    light: Light, point: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and the most, (n,) each, of A cos_surface cos_light / d^2 (a point light's
    cos_surface / d^2 [m^-2]) for points (n, 3) [m] with these unit normals, visibility aside."""
    match light:
        case PointLight():
            to_light = np.asarray(light.position) - point
            above = np.maximum(np.einsum("ij,ij->i", to_light, normal), 0)
            value = above / np.linalg.norm(to_light, axis=1) ** 3
            return value, value
        case QuadLight():
            u, v = np.asarray(light.edge_u), np.asarray(light.edge_v)
            return _polygon_range(light, np.array([0 * u, u, u + v, v]), point, normal)
        case TriangleLight():
            u, v = np.asarray(light.edge_u), np.asarray(light.edge_v)
            return _polygon_range(light, np.array([0 * u, u, v]), point, normal)
        case DiskLight():
            return _disk_range(light, point, normal)
        case SphereLight():
            return _sphere_range(light, point, normal)


def _polygon_range(
    light: QuadLight | TriangleLight, corners: np.ndarray, point: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """corners: (k, 3) from light.corner. n . w is extreme at a corner, |w| largest at a corner."""
    to_corners = np.asarray(light.corner) + corners - point[:, None, :]
    above = np.einsum("ikj,ij->ik", to_corners, normal)
    height = to_corners[:, 0] @ np.asarray(light.normal)
    farthest = np.linalg.norm(to_corners, axis=2).max(axis=1)
    nearest = _distance_to_polygon(to_corners, height)
    return _flat_range(light.area, height, above.min(axis=1), above.max(axis=1), nearest, farthest)


def _disk_range(
    light: DiskLight, point: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    to_center, axis = np.asarray(light.center) - point, np.asarray(light.normal)
    height = to_center @ axis
    beside = np.linalg.norm(to_center - height[:, None] * axis, axis=1)
    middle = np.einsum("ij,ij->i", to_center, normal)
    spread = light.radius * np.sqrt(np.maximum(1 - (normal @ axis) ** 2, 0))
    nearest = np.hypot(height, np.maximum(beside - light.radius, 0))
    farthest = np.hypot(height, beside + light.radius)
    return _flat_range(light.area, height, middle - spread, middle + spread, nearest, farthest)


def _flat_range(
    area: float,
    height: np.ndarray,
    lowest: np.ndarray,
    highest: np.ndarray,
    nearest: np.ndarray,
    farthest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """lowest, highest: of n . w on the light; nearest, farthest: of |w|."""
    shining = area * np.maximum(height, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        least = shining * np.maximum(lowest, 0) / farthest**4
        most = shining * np.maximum(highest, 0) / nearest**4
    return least, np.nan_to_num(most, nan=0.0)


def _sphere_range(
    light: SphereLight, point: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places of the far side bring nothing. On the near side cos_light <= 1, |w| >= d - R and
    n . w is at most what it is at the silhouette or at the pole towards n."""
    to_center = np.asarray(light.center) - point
    distance = np.linalg.norm(to_center, axis=1)
    highest = np.einsum("ij,ij->i", to_center, normal) + light.radius
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.minimum(np.maximum(highest, 0) / (distance - light.radius), 1)
        most = light.area * cosine / (distance - light.radius) ** 2
    most = np.where(distance > light.radius, most, 0.0)
    return np.zeros_like(most), most


def _distance_to_polygon(to_corners: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Distance from the origin to n convex polygons (n, k, 3) whose planes are at this height."""
    start, along = to_corners, np.roll(to_corners, -1, axis=1) - to_corners
    step = -np.einsum("ikj,ikj->ik", start, along) / np.einsum("ikj,ikj->ik", along, along)
    closest = start + np.clip(step, 0, 1)[..., None] * along
    to_edges = np.linalg.norm(closest, axis=2).min(axis=1)
    # The foot of the perpendicular is inside if it is on the same side of all edges.
    normal = np.cross(along[:, 0], along[:, 1])
    side = np.einsum("ikj,ij->ik", np.cross(along, -start), normal)
    inside = (side >= 0).all(axis=1) | (side <= 0).all(axis=1)
    return np.where(inside, np.minimum(np.abs(height), to_edges), to_edges)
