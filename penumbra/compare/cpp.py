"""A scene as the lines that build it in the lab's C++ framework.

Students' renderers read no scene files: their scene is what Scene::init() says. The constructors
are those that the lab's texts give; a class that the lab leaves to the student comes with a comment
that says what its arguments are.
"""

from __future__ import annotations

from penumbra.compare.scene import (
    DiskLight,
    Light,
    Plane,
    PointLight,
    QuadLight,
    Scene,
    Sphere,
    SphereLight,
    TriangleLight,
)

COLORS: dict[tuple[float, ...], str] = {
    (0.0, 0.0, 0.0): "BLACK",
    (1.0, 1.0, 1.0): "WHITE",
    (0.5, 0.5, 0.5): "GREY",
    (1.0, 0.0, 0.0): "RED",
    (0.0, 1.0, 0.0): "GREEN",
    (0.0, 0.0, 1.0): "BLUE",
    (1.0, 1.0, 0.0): "YELLOW",
    (1.0, 0.0, 1.0): "MAGENTA",
    (0.0, 1.0, 1.0): "CYAN",
}
"""The framework's own, of its defines.hpp."""
LIGHT_SAMPLES = (16, 64)
"""A picture each: at 1 nothing shows what the number does, at 1000 8 bits hide the noise."""


def cpp_scene(scene: Scene) -> str:
    """C++ statements: the body of Scene::init(), then as comments what belongs into main().

    Numbers are the scene's own to the last bit of a float, with these liberties: unit normals, a
    camera that looks at the point 1 m ahead, and of a light's color * power, which is all that
    the scene knows, the largest channel for power.
    """
    lines = [f"// {scene.name}: the whole of Scene::init()"]
    for thing in scene.objects:
        # Not the object's own name: a material "default" is there before init(), and stays.
        material = f'"{thing.name}_color"'
        shape = (
            f"Sphere( {_name(thing)}, {_vector(thing.center)}, {_number(thing.radius)} )"
            if isinstance(thing, Sphere)
            else f"Plane( {_name(thing)}, {_vector(thing.point)}, {_vector(thing.normal)} )"
        )
        lines += [
            f"_addMaterial( new ColorMaterial( {material}, {_color(thing.brdf)} ) );",
            f"_addObject( new {shape} );",
            f"_attachMaterialToObject( {material}, {_name(thing)} );",
        ]
    for light in scene.lights:
        lines += _light(light)

    camera = scene.camera
    look_at = tuple(p + f for p, f in zip(camera.position, camera.forward, strict=True))
    seen = ", ".join(_vector(v) for v in (camera.position, look_at, camera.up))
    first, second = LIGHT_SAMPLES
    lines += [
        "",
        "// main(), and the renderer that it sets up:",
        f"// const int imgWidth = {scene.width};",
        f"// const int imgHeight = {scene.height};",
        f"// PerspectiveCamera camera( {seen}, {_number(camera.fov_y_deg)}, "
        "float( imgWidth ) / imgHeight );",
        f"// renderer.setBackgroundColor( {_color(scene.background_radiance)} );",
        "// renderer.setNbPixelSamples( 1 );",
        "// In Renderer::renderImage, rays are cut at "
        f"_integrator->Li( p_scene, ray, 0.f, {_number(scene.ray_max_distance)} )",
        f"// _nbLightSamples of the integrator: {first} in one picture, {second} in another; PNG",
    ]
    return "\n".join(lines) + "\n"


def _light(light: Light) -> list[str]:
    emitted = light.radiant_intensity if isinstance(light, PointLight) else light.radiance
    power = max(emitted)
    color = tuple(c / power for c in emitted) if power > 0 else (1.0, 1.0, 1.0)
    last = f"{_color(color)}, {_number(power)}"
    match light:
        case PointLight():
            return [f"_addLight( new PointLight( {_vector(light.position)}, {last} ) );"]
        case QuadLight():
            edges = ", ".join(_vector(v) for v in (light.corner, light.edge_u, light.edge_v))
            return [f"_addLight( new QuadLight( {edges}, {last} ) );"]
        case DiskLight():
            frame = f"{_vector(light.center)}, {_vector(light.normal)}, {_number(light.radius)}"
            return [
                "// center, normal (lit is the other side, as of a quad), radius, color, power",
                f"_addLight( new DiskLight( {frame}, {last} ) );",
            ]
        case TriangleLight():
            edges = ", ".join(_vector(v) for v in (light.corner, light.edge_u, light.edge_v))
            return [
                "// position, u, v (half a quad: s + t <= 1 in position + s u + t v), color, power",
                f"_addLight( new TriangleLight( {edges}, {last} ) );",
            ]
        case SphereLight():
            frame = f"{_vector(light.center)}, {_number(light.radius)}"
            return [
                "// center, radius, color, power; it is no object: no ray hits it",
                f"_addLight( new SphereLight( {frame}, {last} ) );",
            ]


def _name(thing: Sphere | Plane) -> str:
    """A C++ string: scenes/scene.schema.json allows names nothing that would need an escape."""
    return f'"{thing.name}"'


def _color(v: tuple[float, ...]) -> str:
    return COLORS.get(v) or _vector(v)


def _vector(v: tuple[float, ...]) -> str:
    """
    >>> _vector((1, -0.1, 1e-7))
    'Vec3f( 1.f, -0.1f, 1e-07f )'
    """
    return f"Vec3f( {', '.join(_number(x) for x in v)} )"


def _number(x: float) -> str:
    digits = repr(float(x) + 0.0)  # + 0.0 turns -0 into 0
    return digits.removesuffix("0") + "f" if digits.endswith(".0") else digits + "f"
