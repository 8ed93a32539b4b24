"""The scene, read from scenes/*.json and turned from the lab's numbers into SI.

This is the only Python that knows the file's keys. `c_renderer/src/io/scene_json.c` is the
other, independent reader; tests/test_scene_contract.py holds the two to one behaviour.
"""

from __future__ import annotations

import codecs
import json
import math
import re
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

import jsonschema

from penumbra.compare.run.provenance import ROOT

Vec3 = tuple[float, float, float]
Path_ = tuple[str | int, ...]

SCHEMA_FILE = ROOT / "scenes" / "scene.schema.json"
MAX_BYTES = 1 << 20
"""Largest scene file read [bytes]; a thousand lights take a tenth of it."""
MIN_LENGTH = 1e-9
"""Shorter vectors [m] and smaller angles [rad] count as zero."""
MAX_DEPTH = 16
"""Deepest nesting read; a scene needs 4. Python's own limit lies where its stack happens to."""
MAX_TEXT = 200
"""As much of a key or reason is repeated in a message [characters]."""
MAX_ERRORS = 100
"""Faults that the one to report, the first in the file, is chosen from: a hostile megabyte holds
half a million, which take 20 s and gigabytes to list."""
MAX_RADIANCE = 1e30
"""Largest color * power: keeps every product of the estimator finite in float32."""


class SceneError(ValueError):
    """A scene file that cannot be used; the text names file, line, key and reason."""

    def __init__(self, file: str | Path, line: int, key: str, reason: str) -> None:
        key, reason = _printable(key), _printable(reason)
        self.file, self.line, self.key, self.reason = str(file), line, key, reason
        place = f"{file}:{line}: " if line else f"{file}: "
        super().__init__(place + (f"{key}: " if key else "") + reason)


@dataclass(frozen=True)
class Sphere:
    name: str
    center: Vec3
    """[m]"""
    radius: float
    """[m]"""
    brdf: Vec3
    """[sr^-1], per colour channel"""


@dataclass(frozen=True)
class Plane:
    name: str
    point: Vec3
    """[m]"""
    normal: Vec3
    """unit vector"""
    brdf: Vec3
    """[sr^-1]"""


@dataclass(frozen=True)
class PointLight:
    name: str
    position: Vec3
    """[m]"""
    radiant_intensity: Vec3
    """[W sr^-1]"""


@dataclass(frozen=True)
class QuadLight:
    name: str
    corner: Vec3
    """[m]"""
    edge_u: Vec3
    """[m]"""
    edge_v: Vec3
    """[m]"""
    normal: Vec3
    """normalize(u x v); the light emits on the side that -normal faces"""
    area: float
    """|u x v| [m^2]"""
    radiance: Vec3
    """[W m^-2 sr^-1]"""


@dataclass(frozen=True)
class DiskLight:
    name: str
    center: Vec3
    """[m]"""
    normal: Vec3
    """unit vector; the light emits on the side that -normal faces"""
    radius: float
    """[m]"""
    radiance: Vec3
    """[W m^-2 sr^-1]"""

    @property
    def area(self) -> float:
        """[m^2]"""
        return math.pi * self.radius * self.radius


@dataclass(frozen=True)
class TriangleLight:
    """The points corner + s edge_u + t edge_v with s, t >= 0 and s + t <= 1."""

    name: str
    corner: Vec3
    """[m]"""
    edge_u: Vec3
    """[m]"""
    edge_v: Vec3
    """[m]"""
    radiance: Vec3
    """[W m^-2 sr^-1]"""

    @property
    def normal(self) -> Vec3:
        """normalize(u x v); the light emits on the side that -normal faces"""
        normal = _cross(self.edge_u, self.edge_v)
        return _divided(normal, _length(normal))

    @property
    def area(self) -> float:
        """|u x v| / 2 [m^2]"""
        return _length(_cross(self.edge_u, self.edge_v)) / 2


@dataclass(frozen=True)
class SphereLight:
    """It emits outwards."""

    name: str
    center: Vec3
    """[m]"""
    radius: float
    """[m]"""
    radiance: Vec3
    """[W m^-2 sr^-1]"""

    @property
    def area(self) -> float:
        """[m^2]"""
        return 4 * math.pi * self.radius * self.radius


Light = PointLight | QuadLight | DiskLight | TriangleLight | SphereLight


@dataclass(frozen=True)
class Camera:
    """Pinhole. The ray through image point (x, y), in pixels from the top left corner, goes along
    forward + (2 x / width - 1) * aspect * t * right + (1 - 2 y / height) * t * up,
    with t = tan(fov_y / 2) and aspect = width / height.
    """

    position: Vec3
    forward: Vec3
    right: Vec3
    up: Vec3
    fov_y_deg: float


@dataclass(frozen=True)
class Scene:
    name: str
    width: int
    height: int
    camera: Camera
    background_radiance: Vec3
    ray_max_distance: float
    spheres: tuple[Sphere, ...]
    planes: tuple[Plane, ...]
    point_lights: tuple[PointLight, ...]
    quad_lights: tuple[QuadLight, ...]
    disk_lights: tuple[DiskLight, ...] = ()
    triangle_lights: tuple[TriangleLight, ...] = ()
    sphere_lights: tuple[SphereLight, ...] = ()

    @property
    def lights(self) -> tuple[Light, ...]:
        """The position in this tuple is the light's index everywhere."""
        return (
            *self.point_lights,
            *self.quad_lights,
            *self.disk_lights,
            *self.triangle_lights,
            *self.sphere_lights,
        )

    @property
    def objects(self) -> tuple[Sphere | Plane, ...]:
        """Spheres, then planes: the position in this tuple is the object's id everywhere."""
        return (*self.spheres, *self.planes)

    @property
    def hash(self) -> str:
        """FNV-1a (64 bits, hexadecimal) of the dump without name and image size.

        Two files with one hash show the same objects, lights and camera. It tells scenes
        apart; it is no protection against forgery.
        """
        value = 0xCBF29CE484222325
        for byte in _dump_body(self).encode():
            value = (value ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
        return f"{value:016x}"


def read_scene(file: str | Path) -> Scene:
    """Read a scene file.

    Raises SceneError for anything that scenes/scene.schema.json refuses, in its keys or in
    its description.
    """
    data, lines = _read_json(file)

    def refuse(path: Path_, reason: str) -> NoReturn:
        line = next((lines[path[:n]] for n in range(len(path), -1, -1) if path[:n] in lines), 0)
        raise SceneError(file, line, _key(path), reason)

    errors = [_innermost(e) for e in islice(_validator().iter_errors(data), MAX_ERRORS)]
    if errors:
        path, reason = min(errors, key=lambda e: lines.get(e[0], 0))
        refuse(path, reason)

    def unit(path: Path_, v: Vec3) -> Vec3:
        length = _length(v)
        if length < MIN_LENGTH:
            refuse(path, "a zero vector has no direction")
        return _divided(v, length)

    def radiance(path: Path_, light: dict[str, Any]) -> Vec3:
        value = _vec3([c * float(light["power"]) for c in _vec3(light["color"])])
        if max(value) > MAX_RADIANCE:
            refuse((*path, "power"), f"color * power is over {MAX_RADIANCE:g}")
        return value

    camera = data["camera"]
    position, look_at = _vec3(camera["position"]), _vec3(camera["look_at"])
    forward = unit(("camera", "look_at"), _minus(look_at, position))
    right = _cross(unit(("camera", "up"), _vec3(camera["up"])), forward)
    if _length(right) <= MIN_LENGTH:
        refuse(("camera", "up"), "up is parallel to the view direction")
    right = _divided(right, _length(right))

    names: dict[str, set[str]] = {"object": set(), "light": set()}
    for group, kind in (
        ("spheres", "object"),
        ("planes", "object"),
        ("point_lights", "light"),
        ("quad_lights", "light"),
        ("disk_lights", "light"),
        ("triangle_lights", "light"),
        ("sphere_lights", "light"),
    ):
        for i, item in enumerate(data.get(group, [])):
            if item["name"] in names[kind]:
                refuse((group, i, "name"), f'there is already a {kind} named "{item["name"]}"')
            names[kind].add(item["name"])

    def edges(path: Path_, light: dict[str, Any], shape: str) -> tuple[Vec3, Vec3]:
        edge_u, edge_v = _vec3(light["u"]), _vec3(light["v"])
        unit((*path, "u"), edge_u)
        unit((*path, "v"), edge_v)
        if _length(_cross(edge_u, edge_v)) <= MIN_LENGTH * _length(edge_u) * _length(edge_v):
            refuse((*path, "v"), f"u and v are parallel: the {shape} has no area")
        return edge_u, edge_v

    quad_lights = []
    for i, light in enumerate(data.get("quad_lights", [])):
        path = ("quad_lights", i)
        edge_u, edge_v = edges(path, light, "quad")
        normal = _cross(edge_u, edge_v)
        area = _length(normal)
        quad_lights.append(
            QuadLight(
                light["name"],
                _vec3(light["position"]),
                edge_u,
                edge_v,
                _divided(normal, area),
                area,
                radiance(path, light),
            )
        )

    return Scene(
        name=data["name"],
        width=int(data["image"]["width"]),
        height=int(data["image"]["height"]),
        camera=Camera(position, forward, right, _cross(forward, right), float(camera["fov_y_deg"])),
        background_radiance=_vec3(data["background"]),
        ray_max_distance=float(data["ray_max_distance"]),
        spheres=tuple(
            Sphere(s["name"], _vec3(s["center"]), float(s["radius"]), _vec3(s["color"]))
            for s in data.get("spheres", [])
        ),
        planes=tuple(
            Plane(
                p["name"],
                _vec3(p["point"]),
                unit(("planes", i, "normal"), _vec3(p["normal"])),
                _vec3(p["color"]),
            )
            for i, p in enumerate(data.get("planes", []))
        ),
        point_lights=tuple(
            PointLight(p["name"], _vec3(p["position"]), radiance(("point_lights", i), p))
            for i, p in enumerate(data.get("point_lights", []))
        ),
        quad_lights=tuple(quad_lights),
        disk_lights=tuple(
            DiskLight(
                d["name"],
                _vec3(d["center"]),
                unit(("disk_lights", i, "normal"), _vec3(d["normal"])),
                float(d["radius"]),
                radiance(("disk_lights", i), d),
            )
            for i, d in enumerate(data.get("disk_lights", []))
        ),
        triangle_lights=tuple(
            TriangleLight(
                t["name"],
                _vec3(t["position"]),
                *edges(("triangle_lights", i), t, "triangle"),
                radiance(("triangle_lights", i), t),
            )
            for i, t in enumerate(data.get("triangle_lights", []))
        ),
        sphere_lights=tuple(
            SphereLight(
                s["name"], _vec3(s["center"]), float(s["radius"]), radiance(("sphere_lights", i), s)
            )
            for i, s in enumerate(data.get("sphere_lights", []))
        ),
    )


def dump_scene(scene: Scene) -> str:
    """The scene in SI as JSON text, byte for byte what `penumbra-render --print-scene` prints."""
    return (
        f'{{\n  "name": "{scene.name}",\n  "hash": "{scene.hash}",\n'
        f'  "image": [{scene.width}, {scene.height}],\n{_dump_body(scene)}}}\n'
    )


def _dump_body(scene: Scene) -> str:
    def numbers(v: Vec3) -> str:
        return "[" + ", ".join(_number(x) for x in v) + "]"

    def items(things: tuple[Any, ...], *fields: str) -> str:
        rows = []
        for thing in things:
            values = [f'"name": "{thing.name}"']
            for field in fields:
                value = getattr(thing, field)
                text = _number(value) if isinstance(value, float) else numbers(value)
                values.append(f'"{field}": {text}')
            rows.append("\n    {" + ", ".join(values) + "}")
        return "[" + ",".join(rows) + ("\n  ]" if rows else "]")

    # Shapes that came later stand in the dump only where a scene has them: hashes stay.
    later = "".join(
        f',\n  "{group}": {items(lights, *fields)}'
        for group, lights, fields in (
            ("disk_lights", scene.disk_lights, ("center", "normal", "radius", "area", "radiance")),
            (
                "triangle_lights",
                scene.triangle_lights,
                ("corner", "edge_u", "edge_v", "normal", "area", "radiance"),
            ),
            ("sphere_lights", scene.sphere_lights, ("center", "radius", "area", "radiance")),
        )
        if lights
    )
    c = scene.camera
    return (
        f'  "camera": {{"position": {numbers(c.position)}, "forward": {numbers(c.forward)}, '
        f'"right": {numbers(c.right)}, "up": {numbers(c.up)}, '
        f'"fov_y_deg": {_number(c.fov_y_deg)}}},\n'
        f'  "background_radiance": {numbers(scene.background_radiance)},\n'
        f'  "ray_max_distance": {_number(scene.ray_max_distance)},\n'
        f'  "spheres": {items(scene.spheres, "center", "radius", "brdf")},\n'
        f'  "planes": {items(scene.planes, "point", "normal", "brdf")},\n'
        f'  "point_lights": {items(scene.point_lights, "position", "radiant_intensity")},\n'
        '  "quad_lights": '
        + items(scene.quad_lights, "corner", "edge_u", "edge_v", "normal", "area", "radiance")
        + later
        + "\n"
    )


def _number(x: float) -> str:
    return f"{x + 0.0:.17g}"  # + 0.0 turns -0 into 0


def _read_json(file: str | Path) -> tuple[Any, dict[Path_, int]]:
    """The parsed text, and the line of every value by its path."""
    try:
        with Path(file).open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise SceneError(file, 0, "", error.strerror or str(error)) from error
    if len(raw) > MAX_BYTES:
        raise SceneError(file, 0, "", f"larger than {MAX_BYTES} bytes: not a scene")
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise SceneError(file, 1, "", "UTF-16 text: save it as UTF-8")
    raw = raw.removeprefix(codecs.BOM_UTF8)  # of Windows' editors; JSON has no place for it
    try:
        text = raw.decode()
        # Integers become float64 too, as in C: else 1e30 + 1 would be over a limit of 1e30.
        data = json.loads(text, parse_constant=_refuse_constant, parse_int=float)
        json.dumps(data, ensure_ascii=False).encode()  # a lone surrogate fails here
        if "\\u0000" in text and "\0" in "".join(_strings(data)):
            raise ValueError("a string holds the character U+0000")
    except json.JSONDecodeError as error:
        raise SceneError(file, error.lineno, "", f"not JSON: {error.msg}") from error
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise SceneError(file, line, "", "not UTF-8 text") from error
    except (ValueError, RecursionError) as error:
        raise SceneError(file, 1, "", f"not usable JSON: {error}") from error
    return data, _line_of_each_value(file, text)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _strings(data: Any) -> list[str]:
    if isinstance(data, str):
        return [data]
    if isinstance(data, dict):
        return [*data, *(s for v in data.values() for s in _strings(v))]
    if isinstance(data, list):
        return [s for v in data for s in _strings(v)]
    return []


_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\],:]|[^\s{}\[\],:"]+')


def _line_of_each_value(file: str | Path, text: str) -> dict[Path_, int]:
    """Walk valid JSON once: the line of each value (of its key, in an object).

    Raises SceneError at the second of two equal keys, and beyond MAX_DEPTH.
    """
    lines: dict[Path_, int] = {(): 1}
    path: list[str | int] = []  # the path of the value that comes next, while inside containers
    in_object: list[bool] = []
    expect_key = False
    line, seen = 1, 0
    for match in _TOKEN.finditer(text):
        line += text.count("\n", seen, match.start())
        seen = match.start()
        token = match.group()
        if token in "{[":
            lines.setdefault(tuple(path), line)
            in_object.append(token == "{")
            path.append("" if token == "{" else 0)
            if len(path) > MAX_DEPTH:
                raise SceneError(file, line, _key(tuple(path[:4])), "nested too deeply")
            expect_key = token == "{"
        elif token in "}]":
            in_object.pop()
            path.pop()
            expect_key = False
        elif token == ",":
            last = path[-1]
            expect_key = in_object[-1]
            path[-1] = "" if isinstance(last, str) else last + 1
        elif token == ":":
            expect_key = False
        elif expect_key:
            path[-1] = json.loads(token)
            if tuple(path) in lines:
                raise SceneError(file, line, _key(tuple(path)), "duplicate key")
            lines[tuple(path)] = line
        else:
            lines.setdefault(tuple(path), line)
    return lines


def _key(path: Path_) -> str:
    """
    >>> _key(("quad_lights", 0, "power"))
    'quad_lights[0].power'
    """
    text = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in path)
    return text.removeprefix(".")


def _printable(text: str) -> str:
    """What a file says, fit for one line on a terminal.

    >>> _printable("a\\nb\\x1b[31m")
    'a?b?[31m'
    """
    return "".join(c if c.isprintable() else "?" for c in text[:MAX_TEXT])


@cache
def _validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text()))


def _innermost(error: jsonschema.ValidationError) -> tuple[Path_, str]:
    """Where a schema error is, down to the unknown key, and what it says."""
    path = tuple(error.absolute_path)
    if error.validator == "additionalProperties":
        unknown = next(k for k in error.instance if k not in error.schema["properties"])
        return (*path, unknown), "unknown key"
    if error.validator == "required":
        missing = next(k for k in error.validator_value if k not in error.instance)
        return path, f'the key "{missing}" is missing'
    if error.validator == "type":
        return path, f"not of type {error.validator_value}"
    if error.validator == "not":
        return path, f'"{error.instance}" is a reserved name'
    return path, error.message


def _vec3(v: Any) -> Vec3:
    x, y, z = v
    return float(x), float(y), float(z)


# Plain float arithmetic in the C reader's order, so that both give the same bits.


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Vec3, b: Vec3) -> Vec3:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _length(v: Vec3) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def _divided(v: Vec3, by: float) -> Vec3:
    return v[0] / by, v[1] / by, v[2] / by
