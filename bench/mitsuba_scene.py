"""The scene as Mitsuba 3 wants it, in plain numbers: the identical surfaces, lights and camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from penumbra.compare.scene import Plane, QuadLight, Scene, Vec3


class UnsupportedScene(ValueError):
    """Mitsuba cannot render this scene identically; the text says why."""


def mitsuba_scene(scene: Scene, width: int, height: int) -> dict[str, Any]:
    """What mitsuba.load_dict takes, but that each "to_world" is a list of four rows.

    One camera ray to a random place of the pixel and one shadow ray to a random point of one
    light are a sample. Mitsuba's diffuse surface divides by pi what the scene's brdf does not:
    the light's radiance is multiplied. A plane is the disc in which it meets the ball that the
    camera sees, as in blender_ref/build_scene.py. The background is left black: as an emitter it
    would light the scene and take half of the samples.

    Raises UnsupportedScene for a sheared quad, another light than a quad, or one beyond the ball.
    """
    for light in scene.lights:
        if not isinstance(light, QuadLight):
            raise UnsupportedScene(
                f'the benchmark\'s Mitsuba scene knows quad lights only, not "{light.name}"'
            )
    shapes: dict[str, Any] = {}
    for i, sphere in enumerate(scene.spheres):
        shapes[f"sphere{i}"] = {
            "type": "sphere",
            "center": list(sphere.center),
            "radius": sphere.radius,
            "bsdf": _diffuse(sphere.brdf),
        }
    for i, plane in enumerate(scene.planes):
        shapes[f"plane{i}"] = _disc(scene, plane)
    for i, quad in enumerate(scene.quad_lights):
        shapes[f"light{i}"] = _rectangle(scene, quad)
    return {
        "type": "scene",
        "integrator": {
            "type": "direct",
            "emitter_samples": 1,
            "bsdf_samples": 0,
            "hide_emitters": True,
        },
        "sensor": _sensor(scene, width, height),
        **shapes,
    }


def _sensor(scene: Scene, width: int, height: int) -> dict[str, Any]:
    """Mitsuba's image has the camera's own x axis to the left."""
    camera = scene.camera
    left = -np.asarray(camera.right)
    return {
        "type": "perspective",
        "fov": camera.fov_y_deg,
        "fov_axis": "y",
        "near_clip": 1e-3,
        "far_clip": 2 * scene.ray_max_distance,
        "to_world": _matrix(left, camera.up, camera.forward, camera.position),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def _diffuse(brdf: Vec3) -> dict[str, Any]:
    reflectance = {"type": "rgb", "value": list(brdf)}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def _disc(scene: Scene, plane: Plane) -> dict[str, Any]:
    eye, normal = np.asarray(scene.camera.position), np.asarray(plane.normal)
    height = float(normal @ (eye - np.asarray(plane.point)))
    radius = math.sqrt(max(0.0, scene.ray_max_distance**2 - height**2))
    along = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(along, normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    return {
        "type": "disk",
        "to_world": _matrix(radius * first, radius * second, normal, eye - height * normal),
        "bsdf": _diffuse(plane.brdf),
    }


def _rectangle(scene: Scene, light: QuadLight) -> dict[str, Any]:
    """Mitsuba's reaches from -1 to 1 and shines towards +z; the scene's towards -normal."""
    u, v, corner = (np.asarray(x) for x in (light.edge_u, light.edge_v, light.corner))
    if abs(u @ v) > 1e-6 * math.sqrt((u @ u) * (v @ v)):
        raise UnsupportedScene(f'the quad light "{light.name}" is sheared')
    far = max(
        math.dist(corner + s * u + t * v, scene.camera.position) for s in (0, 1) for t in (0, 1)
    )
    if far > scene.ray_max_distance:
        raise UnsupportedScene(f'the quad light "{light.name}" is beyond ray_max_distance')
    return {
        "type": "rectangle",
        "to_world": _matrix(v / 2, u / 2, -np.asarray(light.normal), corner + u / 2 + v / 2),
        "bsdf": _diffuse((0.0, 0.0, 0.0)),
        "emitter": {
            "type": "area",
            "radiance": {"type": "rgb", "value": [math.pi * x for x in light.radiance]},
        },
    }


def _matrix(x: Any, y: Any, z: Any, origin: Any) -> list[list[float]]:
    columns = [np.append(axis, 0.0) for axis in (x, y, z)] + [np.append(origin, 1.0)]
    rows: list[list[float]] = np.stack(columns, axis=1).astype(float).tolist()
    return rows
