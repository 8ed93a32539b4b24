"""The C and the Python scene reader are one contract: both accept or both refuse."""

# ruff: noqa: E501 (a case a line)

from __future__ import annotations

import copy
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from penumbra.compare.scene import SceneError, dump_scene, read_scene

BASE: dict[str, Any] = {
    "name": "base",
    "description": "every kind of thing, nothing aligned",
    "image": {"width": 30, "height": 20},
    "camera": {
        "position": [0.1, 0.2, -2],
        "look_at": [0.3, -0.4, 9],
        "up": [0.1, 1, 0.2],
        "fov_y_deg": 47.5,
    },
    "background": [0.5, 0.25, 0],
    "ray_max_distance": 100,
    "spheres": [
        {"name": "ball", "center": [0, 0, 3], "radius": 1, "color": [0, 0.3, 1]},
        {"name": "pea", "center": [1.7, -0.3, 2.2], "radius": 0.07, "color": [0, 0, 0]},
    ],
    "planes": [
        {"name": "floor", "point": [0, -2, 0], "normal": [0.1, 3, -0.2], "color": [1, 0, 0.1]}
    ],
    "point_lights": [
        {"name": "bulb", "position": [1, 10, 1], "color": [1, 0.9, 0.8], "power": 100}
    ],
    "quad_lights": [
        {
            "name": "quad",
            "position": [1, 10, 2],
            "u": [-2, 0.1, 0],
            "v": [0.3, 0.2, 2],
            "color": [1, 1, 0.3],
            "power": 40,
        }
    ],
    "disk_lights": [
        {
            "name": "disk",
            "center": [-1, 9, 3],
            "normal": [0.2, 3, 0.1],
            "radius": 1.3,
            "color": [1, 0.2, 1],
            "power": 30,
        }
    ],
    "triangle_lights": [
        {
            "name": "triangle",
            "position": [2, 8, 1],
            "u": [0.3, 0.1, 2],
            "v": [1.7, 0.2, -0.4],
            "color": [0.1, 1, 1],
            "power": 20,
        }
    ],
    "sphere_lights": [
        {"name": "globe", "center": [3, 7, -2], "radius": 0.7, "color": [1, 0.7, 0.6], "power": 10}
    ],
}
SHAPES = ("point_lights", "quad_lights", "disk_lights", "triangle_lights", "sphere_lights")  # fmt: skip


def text(change: Any = None) -> str:
    data = copy.deepcopy(BASE)
    if change:
        change(data)
    return json.dumps(data, indent=1)


def edited(*path: Any, to: Any) -> str:
    def change(data: Any) -> None:
        for step in path[:-1]:
            data = data[step]
        data[path[-1]] = to

    return text(change)


def without(*path: Any) -> str:
    def change(data: Any) -> None:
        for step in path[:-1]:
            data = data[step]
        del data[path[-1]]

    return text(change)


def c_reader(renderer: Path, file: Path) -> tuple[str | None, str]:
    """(dump or None, message)"""
    run = subprocess.run(
        [str(renderer), "--print-scene", str(file)], capture_output=True, timeout=30
    )
    assert run.returncode in (0, 2), run.stderr
    assert (run.returncode == 0) == (run.stderr == b"")
    return (run.stdout.decode() if run.returncode == 0 else None), run.stderr.decode()


def python_reader(file: Path) -> tuple[str | None, str]:
    try:
        return dump_scene(read_scene(file)), ""
    except SceneError as error:
        return None, str(error)


VALID = {
    "everything": text(),
    "one line": json.dumps(BASE),
    "windows line ends": text().replace("\n", "\r\n"),
    "no lights, no objects": text(lambda d: [d.pop(k) for k in ("spheres", "planes", *SHAPES)]),
    "empty lists": text(lambda d: d.update(spheres=[], **{k: [] for k in SHAPES})),
    **{f"no {k}": without(k) for k in SHAPES},
    **{f"two {k}": text(lambda d, k=k: d[k].append(d[k][0] | {"name": "second"})) for k in SHAPES},
    **{f"dark {k}": edited(k, 0, "power", to=0) for k in SHAPES},
    **{f"1000 {k}": text(lambda d, k=k: d.update({k: [d[k][0] | {"name": f"s{i}"} for i in range(1000)]})) for k in SHAPES},
    "no description": without("description"),
    "accents": edited("description", to="éclairage à l'ombre ☀ \U0001d11e"),
    "escaped key": text().replace('"radius"', r'"\u0072adius"', 1),
    "whole number as real": text().replace('"width": 30', '"width": 30.0'),
    "exponents": text().replace("47.5", "4.75e1"),
    "negative zero": edited("spheres", 0, "center", to=[-0.0, 0, 3]),
    **{f"{size} radius, {k}": edited(k, 0, "radius", to=radius) for k in ("spheres", "disk_lights", "sphere_lights") for size, radius in (("smallest", 1e-9), ("largest", 1e9), ("odd", 0.1))},
    **{f"shortest edges, {k}": text(lambda d, k=k: d[k][0].update(u=[1e-9, 0, 0], v=[0, 0, 1e-9])) for k in ("quad_lights", "triangle_lights")},
    "underflow is zero": text().replace('"power": 40', '"power": 1e-400'),
    **{f"needle, {k}": edited(k, 0, "u", to=[1e-6, 0, 0]) for k in ("quad_lights", "triangle_lights")},
    "no up component along z": edited("camera", "up", to=[0, 1e-9, 0]),
    "one name for an object and a light": edited("quad_lights", 0, "name", to="ball"),
    "largest brightness": edited("point_lights", 0, "power", to=1e30),
    "1000 spheres": text(lambda d: d.update(spheres=[{"name": f"s{i}", "center": [i, 0, 3], "radius": 0.1, "color": [1, 1, 1]} for i in range(1000)])),
    "byte order mark": "\ufeff" + text(),
    "byte order mark, windows line ends": "\ufeff" + text().replace("\n", "\r\n"),
    "trailing space": text() + " \n\t ",
}  # fmt: skip

# name: (text, key that both messages must name, word that both must hold)
INVALID: dict[str, tuple[str | bytes, str, str]] = {
    "empty file": ("", "", ""),
    "only space": (" \n ", "", ""),
    "truncated": (text()[:-40], "", ""),
    "trailing text": (text() + "{}", "", ""),
    "binary": (bytes(range(256)) * 8, "", ""),
    "NUL byte": (text().encode().replace(b"floor", b"flo\0r"), "", ""),
    "latin-1": (edited("description", to="XX").encode().replace(b"XX", b"\xe9\xe8"), "", ""),
    "only a byte order mark": (b"\xef\xbb\xbf", "", ""),
    "half a byte order mark": (b"\xef\xbb" + text().encode(), "", ""),
    "two byte order marks": (b"\xef\xbb\xbf" * 2 + text().encode(), "", ""),
    "a byte order mark at the end": (text().encode() + b"\xef\xbb\xbf", "", ""),
    **{f"UTF-16, {order}": (("\ufeff" + text()).encode(f"utf-16-{order}"), "", "UTF-16 text") for order in ("le", "be")},
    "UTF-16 without a mark": (text().encode("utf-16-le"), "", ""),
    "UTF-32": (text().encode("utf-32"), "", ""),
    "enormous by a byte order mark": ("\ufeff" + text() + " " * ((1 << 20) - len(text())), "", "larger"),
    "escaped NUL": (text().replace("every kind", r"every \u0000 kind"), "", ""),
    "lone surrogate": (text().replace("every kind", r"every \ud800 kind"), "", ""),
    "deeply nested": ('{"a":' * 5000 + "1" + "}" * 5000, "", ""),
    "enormous": (text() + " " * (1 << 20), "", "larger"),
    "array at the top": ("[]", "", "object"),
    "number at the top": ("7", "", ""),
    "NaN": (text().replace('"power": 40', '"power": NaN'), "", ""),
    "Infinity": (text().replace('"power": 40', '"power": Infinity'), "", ""),
    "overflow": (text().replace('"power": 40', '"power": 1e400'), "", ""),
    "many digits": (text().replace('"power": 40', '"power": ' + "9" * 5000), "", ""),
    "comment": (text().replace("{", "{ // lab\n", 1), "", ""),
    "trailing comma": (text().replace("20\n", "20,\n"), "", ""),
    "single quotes": (text().replace('"', "'"), "", ""),
    "duplicate key": (text().replace('"radius": 1,', '"radius": 1, "radius": 2,'), "radius", "duplicate"),
    "duplicate escaped key": (text().replace('"radius": 1,', r'"radius": 1, "\u0072adius": 2,'), "adius", "duplicate"),
    "unknown key": (text(lambda d: d["camera"].update(zoom=2)), "camera.zoom", "unknown"),
    "unknown key at the top": (text(lambda d: d.update(lights=[])), "lights", "unknown"),
    "unknown key with dots": (text(lambda d: d.update({"a.b[0]/~": 1})), "a.b[0]/~", "unknown"),
    "missing name": (without("name"), "", '"name" is missing'),
    "missing radius": (without("spheres", 1, "radius"), "spheres[1]", '"radius" is missing'),
    "missing fov": (without("camera", "fov_y_deg"), "camera", '"fov_y_deg" is missing'),
    "null": (edited("spheres", to=None), "spheres", "type"),
    "string for number": (edited("quad_lights", 0, "power", to="40"), "quad_lights[0].power", "type"),
    "bool for number": (edited("quad_lights", 0, "power", to=True), "quad_lights[0].power", "type"),
    "number for name": (edited("name", to=3), "name", ""),
    "object for array": (edited("spheres", to={}), "spheres", "type"),
    "array for object": (edited("camera", to=[]), "camera", "type"),
    "number for object": (edited("spheres", 0, to=5), "spheres[0]", "type"),
    "two numbers": (edited("background", to=[1, 2]), "background", ""),
    "four numbers": (edited("quad_lights", 0, "u", to=[1, 2, 3, 4]), "quad_lights[0].u", ""),
    "string in triple": (edited("camera", "up", 1, to="y"), "camera.up[1]", "type"),
    "negative colour": (edited("background", 2, to=-0.1), "background[2]", ""),
    "negative power": (edited("quad_lights", 0, "power", to=-1), "quad_lights[0].power", ""),
    "zero radius": (edited("spheres", 0, "radius", to=0), "spheres[0].radius", ""),
    "negative radius": (edited("spheres", 0, "radius", to=-1), "spheres[0].radius", ""),
    "coordinate too large": (edited("planes", 0, "point", 0, to=1e10), "planes[0].point[0]", ""),
    "zero cut-off": (edited("ray_max_distance", to=0), "ray_max_distance", ""),
    "half a pixel": (edited("image", "width", to=30.5), "image.width", "integer"),
    "no pixels": (edited("image", "height", to=0), "image.height", ""),
    "too many pixels": (edited("image", "height", to=16385), "image.height", ""),
    "flat field of view": (edited("camera", "fov_y_deg", to=180), "camera.fov_y_deg", ""),
    "zero normal": (edited("planes", 0, "normal", to=[0, 0, 0]), "planes[0].normal", "zero vector"),
    "zero up": (edited("camera", "up", to=[0, 0, 0]), "camera.up", "zero vector"),
    "looks nowhere": (edited("camera", "look_at", to=[0.1, 0.2, -2]), "camera.look_at", "zero vector"),
    "up along the view": (text(lambda d: d["camera"].update(position=[0, 0, 0], look_at=[0, 3, 0], up=[0, 1, 0])), "camera.up", "parallel"),
    **{f"zero {edge}, {k}": (edited(k, 0, edge, to=[0, 0, 0]), f"{k}[0].{edge}", "zero vector") for k in ("quad_lights", "triangle_lights") for edge in "uv"},
    "parallel edges": (edited("quad_lights", 0, "v", to=[-4, 0.2, 0]), "quad_lights[0].v", "the quad has no area"),
    "parallel edges, triangle": (edited("triangle_lights", 0, "v", to=[0.6, 0.2, 4]), "triangle_lights[0].v", "the triangle has no area"),
    "zero normal, disk": (edited("disk_lights", 0, "normal", to=[0, 1e-10, 0]), "disk_lights[0].normal", "zero vector"),
    **{f"{kind} radius, {k}": (edited(k, 0, "radius", to=radius), f"{k}[0].radius", "") for k in ("disk_lights", "sphere_lights") for kind, radius in (("zero", 0), ("negative", -1), ("short", 9.99e-10), ("long", 1.0000001e9))},
    **{f"too bright, {k}": (text(lambda d, k=k: d[k][0].update(power=1e29, color=[11, 0, 0])), f"{k}[0].power", "1e+30") for k in SHAPES},
    **{f"missing {key}, {k}": (without(k, 0, key), f"{k}[0]", f'"{key}" is missing') for k in SHAPES for key in BASE[k][0]},
    **{f"unknown key, {k}": (text(lambda d, k=k: d[k][0].update(area=2)), f"{k}[0].area", "unknown") for k in SHAPES},
    **{f"object for array, {k}": (edited(k, to={}), k, "type") for k in SHAPES},
    **{f"1001 {k}": (text(lambda d, k=k: d.update({k: [d[k][0] | {"name": f"s{i}"} for i in range(1001)]})), k, "") for k in SHAPES},
    **{f"same name, {k}": (edited(k, 0, "name", to="bulb"), f"{k}[0].name", "already") for k in SHAPES[2:]},
    "same name": (edited("spheres", 1, "name", to="ball"), "spheres[1].name", "already"),
    "same name, sphere and plane": (edited("planes", 0, "name", to="ball"), "planes[0].name", "already"),
    "same name, two lights": (edited("quad_lights", 0, "name", to="bulb"), "quad_lights[0].name", "already"),
    "reserved name": (edited("spheres", 0, "name", to="penumbra"), "spheres[0].name", "reserved"),
    "capital in name": (edited("name", to="TP3"), "name", ""),
    "newline after name": (edited("name", to="tp3\n"), "name", ""),
    "empty name": (edited("name", to=""), "name", ""),
    "long name": (edited("name", to="a" * 41), "name", ""),
    "long description": (edited("description", to="é" * 1001), "description", ""),
    "1001 spheres": (text(lambda d: d.update(spheres=[{"name": f"s{i}", "center": [0, 0, 3], "radius": 1, "color": [1, 1, 1]} for i in range(1001)])), "spheres", ""),
}  # fmt: skip


@pytest.mark.parametrize("case", VALID)
def test_both_readers_accept_and_print_the_same_bytes(
    case: str, renderer: Path, tmp_path: Path
) -> None:
    file = tmp_path / "scene.json"
    file.write_bytes(VALID[case].encode())
    from_c, message = c_reader(renderer, file)
    from_python, python_message = python_reader(file)
    assert from_c is not None, message
    assert from_python is not None, python_message
    assert from_c == from_python
    json.loads(from_c)


@pytest.mark.parametrize("case", INVALID)
def test_both_readers_refuse_and_name_file_line_key_and_reason(
    case: str, renderer: Path, tmp_path: Path
) -> None:
    content, key, word = INVALID[case]
    file = tmp_path / "scene.json"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    for dump, message in (c_reader(renderer, file), python_reader(file)):
        assert dump is None
        assert str(file) in message
        assert key in message and word in message, message
        if not case.startswith("enormous"):
            assert re.search(re.escape(str(file)) + r":\d+: ", message), message


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["", "byte order mark"])
@pytest.mark.parametrize(
    ("case", "needle"),
    [
        ("unknown key", '"zoom"'),
        ("duplicate key", '"radius": 2'),
        ("string for number", '"power": "40"'),
        ("same name", '"pea"'),
        ("zero v, triangle_lights", '"v"'),
        ("negative colour", "-0.1"),
    ],
)
def test_both_readers_name_the_same_line(
    case: str, needle: str, mark: str, renderer: Path, tmp_path: Path
) -> None:
    """The line is that of the value (or key) itself, counted from 1."""
    content = mark + INVALID[case][0]
    assert isinstance(content, str)
    needle = '"name": "ball"' if case == "same name" else needle
    line = content[: content.rindex(needle)].count("\n") + 1
    file = tmp_path / "scene.json"
    file.write_text(content)
    for dump, message in (c_reader(renderer, file), python_reader(file)):
        assert dump is None
        assert f"{file}:{line}: " in message


@pytest.mark.parametrize("content", [None, "folder"])
def test_both_readers_refuse_what_is_not_a_file(
    content: str | None, renderer: Path, tmp_path: Path
) -> None:
    file = tmp_path / "scene.json"
    if content == "folder":
        file.mkdir()
    for dump, message in (c_reader(renderer, file), python_reader(file)):
        assert dump is None
        assert str(file) in message


# Numbers that sit on the readers' limits, and ordinary ones.
NUMBER = st.one_of(
    st.sampled_from([0, -0.0, 1, 1e-9, 1e-10, 1e9, 1.0000001e9, 1e30, 1e6, 0.1, -1, 179, 16384]),
    st.floats(-10, 10),
    st.floats(allow_nan=False, allow_infinity=False),
)
VALUE = st.one_of(
    NUMBER,
    st.lists(NUMBER, min_size=2, max_size=4),
    st.sampled_from([None, True, "x", "lit", "ball", [], {}, [[1]], "é"]),
)


def paths(data: Any, prefix: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    steps = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    return [p for step, value in steps for p in ((*prefix, step), *paths(value, (*prefix, step)))]


@settings(
    max_examples=300,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    edits=st.lists(st.tuples(st.sampled_from(paths(BASE)), VALUE), min_size=1, max_size=2),
    cut=st.one_of(st.none(), st.integers(0, 2500)),
)
def test_readers_agree_on_mutated_scenes(
    edits: list[tuple[tuple[Any, ...], Any]],
    cut: int | None,
    renderer: Path,
    tmp_path: Path,
) -> None:
    data = copy.deepcopy(BASE)
    for path, value in edits:
        parent: Any = data
        try:
            for step in path[:-1]:
                parent = parent[step]
            parent[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # an earlier edit removed the place
    content = json.dumps(data, indent=1)
    file = tmp_path / "scene.json"
    file.write_text(content if cut is None else content[:cut])
    from_c, message = c_reader(renderer, file)
    from_python, python_message = python_reader(file)
    assert from_c == from_python, (message, python_message)
