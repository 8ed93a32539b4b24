"""The scene, turned into Blender datablocks: the same surfaces, lights and camera.

World axes are turned once, here: Blender's (x, y, z) is the scene's (x, z, y). That one
reflection makes the scene's left-handed, y-up picture Blender's right-handed, z-up one, so the
rendered image needs no flip and the .blend shows what the reference shows. A cross product
changes its sign under it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import bpy
from mathutils import Matrix, Vector

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
    Vec3,
)

DISC_SIDES = 4096
"""The polygon falls short of its circle by 3e-7 of the radius: 1e-5 pixels of a 4K horizon."""
PERPENDICULAR = 1e-6
"""Cosine of u and v below which a quad is a rectangle: the float32 of Blender's matrices."""
NEAR = 0.1
"""Distance from a mesh light's plane, in its longest edges, from which on its samples are spread
over its area. Nearer by, Cycles spreads them over the solid angle, and those that rounding puts
beside the triangle are lost: measured, one in 10,000 at 0.02 sr, one in 200 at 8e-4 sr. It does so
where edge > distance / (2 area of the triangle), of whatever unit."""
MAX_PIECES = 200
"""A side: 80,000 triangles."""
MIN_WEIGHT = 1e-5
"""Cycles drops a BSDF whose mean over r, g, b is smaller (CLOSURE_WEIGHT_CUTOFF)."""
MAX_TRANSPARENT_SURFACES = 1024
"""Blender's largest transparent_max_bounces."""


class UnsupportedScene(ValueError):
    """Cycles cannot render this scene identically; the text says why."""


def build_scene(scene: Scene, aspect: float) -> bpy.types.Scene:
    """Fill an empty factory file; aspect = image width / height.

    Raises UnsupportedScene, and touches nothing outside of the new file.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    check_supported(scene)
    _background(scene)
    _camera(scene, aspect)
    for sphere in scene.spheres:
        _sphere(scene, sphere)
    for plane in scene.planes:
        _plane(scene, plane)
    for light in scene.lights:
        _light(light)
    return bpy.context.scene


def check_supported(scene: Scene) -> None:
    """Raise UnsupportedScene for what Cycles would silently render otherwise."""
    for sphere in scene.spheres:
        if _distance(scene, sphere.center) <= sphere.radius * (1 + 1e-6):
            raise UnsupportedScene(
                f'the camera is inside of the sphere "{sphere.name}"; '
                "Cycles' spheres have no inner side"
            )
    for thing in scene.objects:
        if 0 < sum(thing.brdf) / 3 < MIN_WEIGHT:
            raise UnsupportedScene(
                f'the colour of "{thing.name}" is so dark (mean under {MIN_WEIGHT:g}) '
                "that Cycles takes it for black; make it 0, or lighter and the lights weaker"
            )
        for light in scene.sphere_lights:
            if abs(_to_surface(thing, light.center)) < light.radius:
                raise UnsupportedScene(
                    f'"{thing.name}" reaches into the sphere light "{light.name}"; '
                    "Cycles would light what is inside of it"
                )
    if transparent_surfaces(scene) > MAX_TRANSPARENT_SURFACES:
        raise UnsupportedScene(
            f"more than {MAX_TRANSPARENT_SURFACES // 2} spheres are cut by ray_max_distance"
        )


def _to_surface(thing: Sphere | Plane, point: Vec3) -> float:
    """How far outside of a sphere or above a plane the point is [m]."""
    if isinstance(thing, Sphere):
        return math.dist(point, thing.center) - thing.radius
    return _height(thing, point)


def transparent_surfaces(scene: Scene) -> int:
    """How many surfaces of cut spheres one camera ray may have to pass."""
    return 2 * len([s for s in scene.spheres if _is_cut(scene, s)])


def _turned(v: Vec3) -> Vector:
    return Vector((v[0], v[2], v[1]))


def _frame(x: Vec3, y: Vec3, z: Vec3, origin: Vec3) -> Matrix:
    """Blender's matrix_world of an object with these local axes, given in the scene's axes."""
    columns = [_turned(axis).normalized().to_4d() for axis in (x, y, z)]
    for column in columns:
        column.w = 0
    return Matrix((*columns, _turned(origin).to_4d())).transposed()


def _add(name: str, data: bpy.types.ID) -> bpy.types.Object:
    thing = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(thing)
    # Both offsets move the shadow's edge on smooth-shaded meshes.
    thing.shadow_terminator_geometry_offset = 0
    thing.shadow_terminator_shading_offset = 0
    return thing


def _distance(scene: Scene, point: Vec3) -> float:
    return math.dist(scene.camera.position, point)


def _negative(v: Vec3) -> Vec3:
    return -v[0], -v[1], -v[2]


# Camera and background


def _camera(scene: Scene, aspect: float) -> None:
    """A pinhole; the far end of what it sees is cut along the ray by the surfaces themselves."""
    camera = bpy.data.cameras.new("camera")
    view = scene.camera
    slope = math.tan(math.radians(view.fov_y_deg) / 2)
    camera.type = "PERSP"
    camera.sensor_fit = "VERTICAL"
    camera.lens = max(1.0, 12 / slope)  # [mm]; Blender refuses focal lengths under 1 mm
    camera.sensor_height = 2 * slope * camera.lens
    camera.dof.use_dof = False
    # The clip planes cut along the axis. The nearest visible point is at least `nearest` away
    # along a ray that is at most half the image's diagonal off the axis.
    nearest = min(
        [scene.ray_max_distance]
        + [_distance(scene, s.center) - s.radius for s in scene.spheres]
        + [abs(_height(p, scene.camera.position)) for p in scene.planes]
    )
    camera.clip_start = max(1e-6, 0.5 * nearest / math.hypot(1, slope, slope * aspect))
    camera.clip_end = 2 * scene.ray_max_distance
    thing = _add("camera", camera)
    thing.matrix_world = _frame(view.right, view.up, _negative(view.forward), view.position)
    bpy.context.scene.camera = thing


def _background(scene: Scene) -> None:
    """What camera rays that hit nothing see; it lights nothing."""
    world = bpy.data.worlds.new("background")
    bpy.context.scene.world = world
    world.color = scene.background_radiance
    tree = _node_tree(world)
    output = tree.nodes.new("ShaderNodeOutputWorld")
    shader = tree.nodes.new("ShaderNodeBackground")
    shader.inputs["Color"].default_value = (*scene.background_radiance, 1)
    shader.inputs["Strength"].default_value = 1
    tree.links.new(shader.outputs["Background"], output.inputs["Surface"])
    world.cycles.sampling_method = "NONE"  # else it is sampled as a light
    seen_by = world.cycles_visibility
    seen_by.camera = True
    seen_by.diffuse = seen_by.glossy = seen_by.transmission = seen_by.scatter = False


def _node_tree(owner: bpy.types.ID) -> bpy.types.NodeTree:
    if owner.node_tree is None:  # Blender 5 always has one, and warns of use_nodes
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


# Surfaces


def _diffuse(scene: Scene, thing: Sphere | Plane, cut: bool = False) -> bpy.types.Material:
    """Lambert on both sides. Cycles divides by pi: see _cycles_radiance.

    cut: camera rays pass where the surface is farther than ray_max_distance.
    """
    material = bpy.data.materials.new(thing.name)
    material.diffuse_color = (*thing.brdf, 1)  # in the viewport only
    tree = _node_tree(material)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*thing.brdf, 1)
    shader.inputs["Roughness"].default_value = 0
    surface = shader.outputs["BSDF"]
    if cut:
        surface = _cut(tree, surface, scene)
    tree.links.new(surface, output.inputs["Surface"])
    return material


def _cut(
    tree: bpy.types.NodeTree, surface: bpy.types.NodeSocket, scene: Scene
) -> bpy.types.NodeSocket:
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    path = tree.nodes.new("ShaderNodeLightPath")
    distance = tree.nodes.new("ShaderNodeVectorMath")
    distance.operation = "DISTANCE"
    distance.inputs[1].default_value = _turned(scene.camera.position)
    tree.links.new(geometry.outputs["Position"], distance.inputs[0])
    beyond = tree.nodes.new("ShaderNodeMath")
    beyond.operation = "GREATER_THAN"
    beyond.inputs[1].default_value = scene.ray_max_distance
    tree.links.new(distance.outputs["Value"], beyond.inputs[0])
    passes = tree.nodes.new("ShaderNodeMath")
    passes.operation = "MULTIPLY"
    tree.links.new(beyond.outputs["Value"], passes.inputs[0])
    tree.links.new(path.outputs["Is Camera Ray"], passes.inputs[1])
    transparent = tree.nodes.new("ShaderNodeBsdfTransparent")
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(passes.outputs["Value"], mix.inputs[0])
    tree.links.new(surface, mix.inputs[1])
    tree.links.new(transparent.outputs["BSDF"], mix.inputs[2])
    return mix.outputs["Shader"]


def _is_cut(scene: Scene, sphere: Sphere) -> bool:
    """Whether ray_max_distance ends on the side of the sphere that the camera sees."""
    distance = _distance(scene, sphere.center)
    horizon = math.sqrt(max(0.0, distance**2 - sphere.radius**2))
    return distance - sphere.radius < scene.ray_max_distance < horizon


def _sphere(scene: Scene, sphere: Sphere) -> None:
    """One vertex and "Mesh to Points": Cycles renders a point as an analytic sphere."""
    mesh = bpy.data.meshes.new(sphere.name)
    mesh.from_pydata([(0, 0, 0)], [], [])
    thing = _add(sphere.name, mesh)
    thing.location = _turned(sphere.center)
    thing.visible_camera = _distance(scene, sphere.center) - sphere.radius < scene.ray_max_distance
    material = _diffuse(scene, sphere, cut=_is_cut(scene, sphere))
    mesh.materials.append(material)
    tree = bpy.data.node_groups.new(sphere.name, "GeometryNodeTree")
    tree.is_modifier = True
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    vertex, points, coloured, result = (
        tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "GeometryNodeMeshToPoints",
            "GeometryNodeSetMaterial",
            "NodeGroupOutput",
        )
    )
    points.inputs["Radius"].default_value = sphere.radius
    coloured.inputs["Material"].default_value = material
    tree.links.new(vertex.outputs["Geometry"], points.inputs["Mesh"])
    tree.links.new(points.outputs["Points"], coloured.inputs["Geometry"])
    tree.links.new(coloured.outputs["Geometry"], result.inputs["Geometry"])
    thing.modifiers.new("sphere", "NODES").node_group = tree


def _plane(scene: Scene, plane: Plane) -> None:
    """The disc in which the plane meets the ball that the camera sees, and if need be a ring.

    A shadow ray from a visible point to a light inside of that ball stays in it, for a ball is
    convex. Where a light is farther away, a ring around the disc, out to the ball that holds
    the light too, casts the rest of the infinite plane's shadow; the camera does not see it.
    """
    height = _height(plane, scene.camera.position)
    disc = _radius_of_cut(scene.ray_max_distance, height)
    reach = _radius_of_cut(1.001 * _farthest_light(scene), height)
    material = _diffuse(scene, plane)
    if disc > 0:
        _add_flat(plane.name, _foot(scene, plane), plane, [disc], material)
    if reach > disc:
        radii = [disc, reach] if disc > 0 else [reach]
        ring = _add_flat(plane.name + " beyond", _foot(scene, plane), plane, radii, material)
        ring.visible_camera = False


def _add_flat(
    name: str, centre: Vec3, plane: Plane, radii: list[float], material: bpy.types.Material
) -> bpy.types.Object:
    """A disc of radius radii[0], or the ring from radii[0] to radii[1]."""
    along = min(range(3), key=lambda i: abs(plane.normal[i]))
    helper = _turned(tuple(float(i == along) for i in range(3)))  # type: ignore[arg-type]
    normal = _turned(plane.normal)
    first = helper.cross(normal).normalized()
    second = normal.cross(first)
    angles = [2 * math.pi * i / DISC_SIDES for i in range(DISC_SIDES)]
    directions = [math.cos(a) * first + math.sin(a) * second for a in angles]
    vertices = [r * d for r in radii for d in directions]
    if len(radii) == 1:
        faces: Iterable[Iterable[int]] = [range(DISC_SIDES)]
    else:
        n = DISC_SIDES
        faces = [(i, i + n, (i + 1) % n + n, (i + 1) % n) for i in range(n)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(material)
    thing = _add(name, mesh)
    thing.location = _turned(centre)
    return thing


def _height(plane: Plane, point: Vec3) -> float:
    """The point's signed distance from the plane [m]."""
    return sum(n * (c - p) for n, c, p in zip(plane.normal, point, plane.point, strict=True))


def _foot(scene: Scene, plane: Plane) -> Vec3:
    """The point of the plane that is nearest to the camera."""
    height = _height(plane, scene.camera.position)
    x, y, z = (c - height * n for c, n in zip(scene.camera.position, plane.normal, strict=True))
    return x, y, z


def _radius_of_cut(ball: float, height: float) -> float:
    return math.sqrt(max(0.0, ball**2 - height**2))


def _farthest_light(scene: Scene) -> float:
    """No point of a light is farther from the camera than this [m]."""
    distances = [0.0]
    for light in scene.lights:
        match light:
            case PointLight():
                distances.append(_distance(scene, light.position))
            case QuadLight() | TriangleLight():
                distances += [_distance(scene, corner) for corner in _corners(light)]
            case DiskLight() | SphereLight():
                distances.append(_distance(scene, light.center) + light.radius)
    return max(distances)


# Lights


def _cycles_radiance(value: Vec3) -> tuple[float, Vec3]:
    """Pi times the scene's radiance (or radiant intensity), as strength and colour.

    The scene's surfaces reflect brdf * E, a Cycles Diffuse BSDF reflects color / pi * E.
    """
    strength = max(value)
    r, g, b = (v / strength for v in value)
    return math.pi * strength, (r, g, b)


def _light(light: Light) -> None:
    """A lamp where Cycles has its shape, else a mesh; the camera sees neither."""
    emitted = light.radiant_intensity if isinstance(light, PointLight) else light.radiance
    if max(emitted) == 0:
        return
    match light:
        case PointLight():
            thing = _point_light(light)
        case QuadLight() if _is_rectangle(light):
            thing = _rectangle(light)
        case QuadLight() | TriangleLight():
            thing = _mesh_light(light)
        case DiskLight():
            thing = _disk_light(light)
        case SphereLight():
            thing = _sphere_light(light)
    thing.visible_camera = False


def _is_rectangle(light: QuadLight) -> bool:
    """Cycles' area lights cannot be sheared."""
    u, v = light.edge_u, light.edge_v
    cosine = sum(a * b for a, b in zip(u, v, strict=True)) / (math.hypot(*u) * math.hypot(*v))
    return abs(cosine) <= PERPENDICULAR


def _place(light: QuadLight | TriangleLight, s: float, t: float) -> Vec3:
    x, y, z = (
        c + s * u + t * v for c, u, v in zip(light.corner, light.edge_u, light.edge_v, strict=True)
    )
    return x, y, z


def _corners(light: QuadLight | TriangleLight) -> list[Vec3]:
    """Counter-clockwise about the normal."""
    ends = ((1, 0), (1, 1), (0, 1)) if isinstance(light, QuadLight) else ((1, 0), (0, 1))
    return [light.corner, *(_place(light, s, t) for s, t in ends)]


def _lamp(name: str, kind: str, energy: float, colour: Vec3) -> bpy.types.Light:
    light = bpy.data.lights.new(name, kind)
    light.energy = energy  # [W]
    light.color = colour
    light.normalize = True  # energy is a flux, whatever the size
    light.exposure = 0
    light.use_temperature = False
    light.use_custom_distance = False
    light.use_shadow = True
    light.diffuse_factor = 1
    light.cycles.use_multiple_importance_sampling = False
    light.cycles.max_bounces = 1024
    light.cycles.is_portal = False
    return light


def _rectangle(quad: QuadLight) -> bpy.types.Object:
    thing = _area_light(quad, "RECTANGLE")
    thing.data.size, thing.data.size_y = math.hypot(*quad.edge_v), math.hypot(*quad.edge_u)
    # v, u, n: the reflection of the axes has turned the right-handed u, v, n round.
    thing.matrix_world = _frame(quad.edge_v, quad.edge_u, quad.normal, _place(quad, 0.5, 0.5))
    return thing


def _disk_light(disk: DiskLight) -> bpy.types.Object:
    thing = _area_light(disk, "DISK")
    thing.data.size = 2 * disk.radius
    turn = _turned(disk.normal).to_track_quat("Z", "Y")  # local +Z along the normal
    thing.matrix_world = Matrix.LocRotScale(_turned(disk.center), turn, None)
    return thing


def _area_light(light: QuadLight | DiskLight, shape: str) -> bpy.types.Object:
    """L = P / (pi A), emitted along local -Z: Blender >= 4.0, an area light with spread pi."""
    radiance, colour = _cycles_radiance(light.radiance)
    lamp = _lamp(light.name, "AREA", math.pi * light.area * radiance, colour)
    lamp.shape = shape
    lamp.spread = math.pi
    return _add(light.name, lamp)


def _mesh_light(light: QuadLight | TriangleLight) -> bpy.types.Object:
    """A mesh that emits L = strength from its front alone and casts no shadow.

    What is counter-clockwise about n is clockwise in Blender's axes: the front is where -n faces.
    """
    radiance, colour = _cycles_radiance(light.radiance)
    mesh = bpy.data.meshes.new(light.name)
    mesh.from_pydata(*_pieces(light))
    material = bpy.data.materials.new(light.name)
    material.diffuse_color = (*colour, 1)
    tree = _node_tree(material)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (*colour, 1)
    emission.inputs["Strength"].default_value = radiance
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    front = tree.nodes.new("ShaderNodeMixShader")  # an empty socket is black
    tree.links.new(geometry.outputs["Backfacing"], front.inputs[0])
    tree.links.new(emission.outputs["Emission"], front.inputs[1])
    tree.links.new(front.outputs["Shader"], output.inputs["Surface"])
    material.cycles.emission_sampling = "FRONT"
    mesh.materials.append(material)
    thing = _add(light.name, mesh)
    thing.location = _turned(light.corner)
    thing.visible_shadow = False
    return thing


def _pieces(
    light: QuadLight | TriangleLight,
) -> tuple[list[Vector], list[tuple[int, int]], list[tuple[int, int, int]]]:
    """Vertices, from the corner on, no edges, and equal triangles so small that Cycles spreads
    their samples over the area: see NEAR."""
    n = min(MAX_PIECES, math.ceil((2 * light.area / NEAR) ** (1 / 3)))
    edge_u, edge_v = _turned(light.edge_u), _turned(light.edge_v)
    vertices = [(edge_u * i + edge_v * j) / n for j in range(n + 1) for i in range(n + 1)]
    end = n if isinstance(light, TriangleLight) else 2 * n  # of i + j
    faces = []
    for j in range(n):
        for i in range(min(n, end - j)):
            here, above = j * (n + 1) + i, (j + 1) * (n + 1) + i
            faces.append((here, here + 1, above))
            if i + j + 2 <= end:
                faces.append((here + 1, above + 1, above))
    return vertices, [], faces


def _point_light(point: PointLight) -> bpy.types.Object:
    """I = P / (4 pi)."""
    return _bulb(point.name, point.position, 0, 4 * math.pi, point.radiant_intensity)


def _sphere_light(sphere: SphereLight) -> bpy.types.Object:
    """L = P / (pi A)."""
    scale = math.pi * sphere.area
    return _bulb(sphere.name, sphere.center, sphere.radius, scale, sphere.radiance)


def _bulb(name: str, centre: Vec3, radius: float, scale: float, emitted: Vec3) -> bpy.types.Object:
    """Blender's point light: scale * emitted watts."""
    strength, colour = _cycles_radiance(emitted)
    light = _lamp(name, "POINT", scale * strength, colour)
    light.shadow_soft_size = radius
    light.use_soft_falloff = False  # else a disc that turns to each receiver
    thing = _add(name, light)
    thing.location = _turned(centre)
    return thing
