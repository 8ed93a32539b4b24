"""A scene as the lab's C++: read back number by number, and compiled against the constructors."""

from __future__ import annotations

import doctest
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import penumbra.compare.cpp
from penumbra.__main__ import main
from penumbra.compare.cpp import COLORS, cpp_scene
from penumbra.compare.scene import (
    DiskLight,
    Light,
    PointLight,
    Scene,
    Sphere,
    SphereLight,
    read_scene,
)
from tests.conftest import ROOT

SCENES = sorted(f for f in (ROOT / "scenes").glob("*.json") if "schema" not in f.name)
NAMED = {name: color for color, name in COLORS.items()}
FRAMEWORK = """
#include <string>
struct Vec3f { Vec3f( float, float, float ) {} };
const Vec3f BLACK( 0, 0, 0 ), WHITE( 1, 1, 1 ), GREY( .5f, .5f, .5f ), RED( 1, 0, 0 ),
    GREEN( 0, 1, 0 ), BLUE( 0, 0, 1 ), YELLOW( 1, 1, 0 ), MAGENTA( 1, 0, 1 ), CYAN( 0, 1, 1 );
using Name = const std::string &; using V = const Vec3f &; using F = const float;
struct ColorMaterial { ColorMaterial( Name, V ) {} };
struct Sphere { Sphere( Name, V, F ) {} };
struct Plane { Plane( Name, V, V ) {} };
struct PointLight { PointLight( V, V, F ) {} };
struct QuadLight { QuadLight( V, V, V, V, F ) {} };
struct TriangleLight { TriangleLight( V, V, V, V, F ) {} };
struct DiskLight { DiskLight( V, V, F, V, F ) {} };
struct SphereLight { SphereLight( V, F, V, F ) {} };
struct PerspectiveCamera { PerspectiveCamera( V, V, V, F, F ) {} };
struct Renderer { void setBackgroundColor( V ) {} void setNbPixelSamples( int ) {} };
template<class T> void _addMaterial( T * p ) { delete p; }
template<class T> void _addObject( T * p ) { delete p; }
template<class T> void _addLight( T * p ) { delete p; }
void _attachMaterialToObject( Name, Name ) {}
"""


def arguments(text: str) -> list[float | str]:
    """What a constructor is given, in order, vectors and colours taken apart."""
    for name, color in NAMED.items():
        text = re.sub(rf"\b{name}\b", ", ".join(f"{c}f" for c in color), text)
    words = re.findall(r'"[^"]*"|(?<!\w)-?[0-9.]+(?:e[-+][0-9]+)?f\b', text)
    return [word[1:-1] if word[0] == '"' else float(np.float32(word[:-1])) for word in words]


def calls(text: str, function: str) -> list[tuple[str, list[float | str]]]:
    """(class, its arguments) of each `function( new Class( ... ) );`, in the order printed."""
    found = re.findall(rf"^{function}\( new (\w+)\( (.*) \) \);$", text, re.MULTILINE)
    return [(kind, arguments(rest)) for kind, rest in found]


def numbers(*values: float | tuple[float, ...]) -> list[float]:
    return [float(np.float32(x)) for x in np.hstack([np.asarray(v) for v in values])]


def light_as_printed(light: Light, color: tuple[float, ...], power: float) -> list[float]:
    if isinstance(light, PointLight):
        return numbers(light.position, color, power)
    if isinstance(light, SphereLight):
        return numbers(light.center, light.radius, color, power)
    if isinstance(light, DiskLight):
        return numbers(light.center, light.normal, light.radius, color, power)
    return numbers(light.corner, light.edge_u, light.edge_v, color, power)


def check(scene: Scene, text: str) -> None:
    """Every statement of `text`, read back, is the scene's."""
    objects = calls(text, "_addObject")
    materials = {name: color for _, (name, *color) in calls(text, "_addMaterial")}
    attached = re.findall(r'^_attachMaterialToObject\( "(\w+)", "(\w+)" \);$', text, re.MULTILINE)
    color_of = {thing: materials[material] for material, thing in attached}
    assert len(materials) == len(attached) == len(objects) and "default" not in materials
    for thing, (kind, found) in zip(scene.objects, objects, strict=True):
        shape = (
            numbers(thing.center, thing.radius)
            if isinstance(thing, Sphere)
            else numbers(thing.point, thing.normal)
        )
        assert (kind, found) == (type(thing).__name__, [thing.name, *shape])
        assert color_of[thing.name] == numbers(thing.brdf)
    for light, (kind, found) in zip(scene.lights, calls(text, "_addLight"), strict=True):
        emitted = light.radiant_intensity if isinstance(light, PointLight) else light.radiance
        *color, power = (float(x) for x in found[-4:])
        assert np.allclose(power * np.array(color), emitted, rtol=2e-7, atol=0)
        assert (kind, found) == (type(light).__name__, light_as_printed(light, tuple(color), power))

    seen = re.search(r"^// PerspectiveCamera camera\( (.*), float\( imgWidth", text, re.MULTILINE)
    assert seen
    position, look_at, up = np.array(arguments(seen[1])[:9], dtype=float).reshape(3, 3)
    assert np.allclose(position, scene.camera.position) and np.allclose(up, scene.camera.up)
    assert np.allclose(look_at - position, scene.camera.forward, atol=1e-6)
    assert arguments(seen[1])[9:] == numbers(scene.camera.fov_y_deg)
    background = re.search(r"^// renderer.setBackgroundColor\( (.*) \);$", text, re.MULTILINE)
    assert background and arguments(background[1]) == numbers(scene.background_radiance)
    cut = re.search(r"Li\( p_scene, ray, 0\.f, (.*) \)$", text, re.MULTILINE)
    assert cut and arguments(cut[1]) == numbers(scene.ray_max_distance)
    assert f"imgWidth = {scene.width};" in text and f"imgHeight = {scene.height};" in text


@pytest.mark.parametrize("file", SCENES, ids=lambda file: file.stem)
def test_the_lines_read_back_are_the_scene(file: Path) -> None:
    scene = read_scene(file)
    check(scene, cpp_scene(scene))


def test_unusual_numbers_and_names_survive(make_scene: Callable[..., Path]) -> None:
    """An object called as the framework's own material; colours above 1, black and of one channel;
    1e-7, 1e9, 1e30, -0 and what takes 17 digits."""
    sphere = {"name": "default", "center": [0.1, -0.0, 1e9], "radius": 1e-7, "color": [2, 0, 1 / 3]}
    quad = {"position": [1, 10, 2], "u": [-2, 0.3, 0], "v": [0, 1e-7, 2]}
    lights = [((0, 0, 0), 5), ((1, 1, 1), 0), ((0, 0.3, 0), 1e30), ((0.1, 0.7, 0.3), 1 / 3)]
    scene = read_scene(
        make_scene(
            spheres=[sphere],
            quad_lights=[
                {"name": f"q{i}", "color": color, "power": power, **quad}
                for i, (color, power) in enumerate(lights)
            ],
        )
    )
    text = cpp_scene(scene)
    check(scene, text)
    assert "-0.f" not in text and "nan" not in text and "inf" not in text


def test_the_lines_compile(tmp_path: Path) -> None:
    """Against constructors as the lab's texts declare them; main()'s lines without their //."""
    source = FRAMEWORK
    for file in SCENES:
        text = re.sub(r"^// (.*;)$", r"\1", cpp_scene(read_scene(file)), flags=re.MULTILINE)
        source += f"void {file.stem}()\n{{\nRenderer renderer;\n{text}}}\n"
    (tmp_path / "scenes.cpp").write_text(source)
    command = ["clang", "-x", "c++", "-std=c++17", "-fsyntax-only", "-Wall", "-Werror"]
    command.append(str(tmp_path / "scenes.cpp"))
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_the_command_prints_them(scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", str(scenes / "tp3.json"), "--as", "cpp"]) == 0
    printed = capsys.readouterr().out
    assert printed == cpp_scene(read_scene(scenes / "tp3.json"))
    assert (
        "_addLight( new QuadLight( Vec3f( 1.f, 10.f, 2.f ), Vec3f( -2.f, 0.f, 0.f ), "
        "Vec3f( 0.f, 0.f, 2.f ), WHITE, 40.f ) );\n" in printed
    )


def test_doctests_hold() -> None:
    tried = doctest.testmod(penumbra.compare.cpp)
    assert tried.attempted and not tried.failed
