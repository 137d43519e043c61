#!/usr/bin/env python3
"""Build and render the sample scenes with Blender as a Python module.

Usage: python make_samples.py [--out FOLDER] [--preview SPP] [NAME...]

Everything in the scenes is made here from code; nothing is loaded. Each sample
names the Blender that wrote it: the script makes those of the running version
(with --any, all of them). Per sample it writes NAME_4spp.exr, NAME_16spp.exr
and two references, NAME_ref_a.exr and NAME_ref_b.exr, of other seeds.
--preview writes NAME_preview.exr with few samples instead.
"""

from __future__ import annotations

import argparse
import math
import random
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy

# isort: split
import bmesh
from mathutils import Matrix, Vector, noise

Vec = tuple[float, float, float]
Colour = tuple[float, float, float]

# ---------------------------------------------------------------- materials


class Nodes:
    """A node tree, with the two calls that scene code needs."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def add(self, kind: str, **values: object) -> bpy.types.Node:
        """Add a node; a keyword sets the input or the property of that name."""
        node = self.tree.nodes.new("ShaderNode" + kind)
        for key, value in values.items():
            socket = node.inputs.get(key.replace("_", " "))
            if socket is None:
                setattr(node, key, value)
            else:
                self.give(socket, value)
        return node

    def give(self, socket: bpy.types.NodeSocket, value: object) -> None:
        """Link a socket to an input, or set the input's value."""
        if isinstance(value, bpy.types.NodeSocket):
            self.tree.links.new(value, socket)
        elif isinstance(value, tuple) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def coords(self, scale: Vec = (1, 1, 1), turn: Vec = (0, 0, 0), kind: str = "Object") -> bpy.types.NodeSocket:
        texco = self.add("TexCoord")
        mapping = self.add("Mapping", Vector=texco.outputs[kind], Scale=scale, Rotation=turn)
        return mapping.outputs[0]

    def ramp(self, value: bpy.types.NodeSocket, stops: Sequence[tuple[float, Colour]]) -> bpy.types.NodeSocket:
        node = self.add("ValToRGB")
        elements = node.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(1.0)
        for element, (at, colour) in zip(elements, stops, strict=True):
            element.position = at
            element.color = (*colour, 1.0)
        self.tree.links.new(value, node.inputs[0])
        return node.outputs[0]

    def mix(self, a: object, b: object, factor: object, blend: str = "MIX") -> bpy.types.NodeSocket:
        node = self.add("Mix", data_type="RGBA", blend_type=blend)
        for index, value in ((0, factor), (6, a), (7, b)):
            self.give(node.inputs[index], value)
        return node.outputs[2]

    def noise(self, scale: float, detail: float = 4.0, vector: object = None) -> bpy.types.NodeSocket:
        if vector is None:
            vector = self.coords()
        return self.add("TexNoise", Vector=vector, Scale=scale, Detail=detail).outputs[0]

    def bump(self, height: bpy.types.NodeSocket, strength: float, distance: float = 0.01):  # noqa: ANN201
        return self.add("Bump", Height=height, Strength=strength, Distance=distance).outputs[0]

    def island(self) -> bpy.types.NodeSocket:
        """Return a random number for each loose piece of a mesh."""
        return self.add("NewGeometry").outputs["Random Per Island"]

    def maths(self, operation: str, a: object, b: object = 0.0) -> bpy.types.NodeSocket:
        node = self.add("Math", operation=operation)
        self.give(node.inputs[0], a)
        self.give(node.inputs[1], b)
        return node.outputs[0]


def material(name: str, **inputs: object) -> bpy.types.Material:
    """Return a Principled material."""
    mat, nodes, bsdf = shaded(name)
    for key, value in inputs.items():
        nodes.give(bsdf.inputs[key.replace("_", " ")], value)
    return mat


def shaded(name: str) -> tuple[bpy.types.Material, Nodes, bpy.types.Node]:
    mat = bpy.data.materials.new(name)
    mat.use_nodes = True
    bsdf = next(n for n in mat.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    return mat, Nodes(mat.node_tree), bsdf


def dress(name: str, make: Callable[[Nodes], dict[str, object]]) -> bpy.types.Material:
    """Return a Principled material whose inputs come from a function of its nodes."""
    mat, nodes, bsdf = shaded(name)
    for key, value in make(nodes).items():
        nodes.give(bsdf.inputs[key.replace("_", " ")], value)
    return mat


def glow(name: str, colour: Colour, strength: float) -> bpy.types.Material:
    return material(name, Base_Color=(0.0, 0.0, 0.0), Roughness=1.0, Emission_Color=colour, Emission_Strength=strength)


def plaster(name: str, colour: Colour, rough: float = 0.9) -> bpy.types.Material:
    def make(n: Nodes) -> dict[str, object]:
        shade = n.mix(colour, tuple(c * 0.88 for c in colour), n.noise(2.5, 6))
        return {"Base_Color": shade, "Roughness": rough, "Normal": n.bump(n.noise(60, 8), 0.25, 0.004)}

    return dress(name, make)


def planks(
    name: str, light: Colour, dark: Colour, width: float = 0.14, rough: float = 0.35, turn: float = 0
) -> bpy.types.Material:
    """Boards along x of the object: rows of bricks, each with its own grain."""

    def make(n: Nodes) -> dict[str, object]:
        where = n.coords(turn=(0, 0, turn))
        brick = n.add(
            "TexBrick",
            Vector=where,
            Color1=(0, 0, 0),
            Color2=(1, 1, 1),
            Mortar=(0.5, 0.5, 0.5),
            Scale=1.0,
            Mortar_Size=0.0015,
            Bias=0.0,
            Brick_Width=width * 9,
            Row_Height=width,
        )
        jump = n.add("VectorMath", operation="SCALE", Scale=7.0)
        n.give(jump.inputs[0], brick.outputs[0])
        shifted = n.add("VectorMath", operation="ADD")
        n.give(shifted.inputs[0], where)
        n.give(shifted.inputs[1], jump.outputs[0])
        stretch = n.add("Mapping", Vector=shifted.outputs[0], Scale=(0.7, 9.0, 1.0))
        grain = n.add("TexNoise", Vector=stretch.outputs[0], Scale=5.0, Detail=7.0, Distortion=0.6).outputs[0]
        wood = n.ramp(grain, ((0.3, dark), (0.5, light), (0.72, dark)))
        tint = n.mix(wood, n.mix(dark, light, brick.outputs[0]), 0.45)
        colour = n.mix(tint, tuple(c * 0.25 for c in dark), brick.outputs[1])
        return {
            "Base_Color": colour,
            "Roughness": rough,
            "Normal": n.bump(n.maths("SUBTRACT", grain, brick.outputs[1]), 0.2, 0.004),
        }

    return dress(name, make)


def tiles(
    name: str,
    one: Colour,
    two: Colour,
    size: tuple[float, float],
    *,
    turn: Vec = (0, 0, 0),
    grout: Colour = (0.55, 0.53, 0.5),
    offset: float = 0.5,
    rough: float = 0.12,
    gap: float = 0.004,
    uneven: float = 0.2,
) -> bpy.types.Material:
    """Tiles or bricks on the object's x-y plane, after a turn."""

    def make(n: Nodes) -> dict[str, object]:
        where = n.coords(turn=turn)
        brick = n.add(
            "TexBrick",
            offset=offset,
            Vector=where,
            Color1=one,
            Color2=two,
            Mortar=grout,
            Scale=1.0,
            Mortar_Size=gap,
            Mortar_Smooth=0.2,
            Bias=0.0,
            Brick_Width=size[0],
            Row_Height=size[1],
        )
        wave = n.noise(14, 3)
        height = n.maths("SUBTRACT", n.maths("MULTIPLY", wave, uneven), brick.outputs[1])
        roughness = n.mix((rough,) * 3, (0.8, 0.8, 0.8), brick.outputs[1])
        return {"Base_Color": brick.outputs[0], "Roughness": roughness, "Normal": n.bump(height, 0.5, 0.006)}

    return dress(name, make)


def random_colours(name: str, stops: Sequence[tuple[float, Colour]], **inputs: object) -> bpy.types.Material:
    """Give each loose piece of a mesh a colour of its own."""
    return dress(name, lambda n: {"Base_Color": n.ramp(n.island(), stops), **inputs})


def leaf_material(name: str, stops: Sequence[tuple[float, Colour]]) -> bpy.types.Material:
    """Thin leaves that let light through."""
    mat, n, bsdf = shaded(name)
    colour = n.ramp(n.island(), stops)
    n.give(bsdf.inputs["Base Color"], colour)
    n.give(bsdf.inputs["Roughness"], 0.45)
    through = n.add("BsdfTranslucent", Color=n.mix(colour, (0.5, 0.6, 0.05), 0.35))
    both = n.add("MixShader")
    n.give(both.inputs[0], 0.4)
    n.give(both.inputs[1], bsdf.outputs[0])
    n.give(both.inputs[2], through.outputs[0])
    out = next(node for node in mat.node_tree.nodes if node.type == "OUTPUT_MATERIAL")
    n.give(out.inputs[0], both.outputs[0])
    return mat


def glass(name: str, colour: Colour = (1, 1, 1), rough: float = 0.0) -> bpy.types.Material:
    return material(name, Base_Color=colour, Roughness=rough, Transmission_Weight=1.0, IOR=1.5)


def metal(name: str, colour: Colour, rough: float) -> bpy.types.Material:
    return material(name, Base_Color=colour, Metallic=1.0, Roughness=rough)


# ---------------------------------------------------------------- shapes


def link(name: str, data: bpy.types.ID, where: Vec = (0, 0, 0)) -> bpy.types.Object:
    obj = bpy.data.objects.new(name, data)
    obj.location = where
    bpy.context.scene.collection.objects.link(obj)
    return obj


def mesh(
    name: str,
    verts: Iterable[Sequence[float]],
    faces: Iterable[Sequence[int]],
    mat: bpy.types.Material,
    where: Vec = (0, 0, 0),
    smooth: bool = False,
) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    data.from_pydata([tuple(v) for v in verts], [], [tuple(f) for f in faces])
    data.materials.append(mat)
    for polygon in data.polygons:
        polygon.use_smooth = smooth
    data.update()
    return link(name, data, where)


BOX_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def box_verts(low: Vec, high: Vec) -> list[Vec]:
    (a, b, c), (d, e, f) = low, high
    return [(a, b, c), (d, b, c), (d, e, c), (a, e, c), (a, b, f), (d, b, f), (d, e, f), (a, e, f)]


def box(
    name: str,
    centre: Vec,
    size: Vec,
    mat: bpy.types.Material,
    bevel: float = 0.0,
    turn: Vec = (0, 0, 0),
    segments: int = 2,
) -> bpy.types.Object:
    half = tuple(s / 2 for s in size)
    obj = mesh(name, box_verts(tuple(-h for h in half), half), BOX_FACES, mat, centre)
    obj.rotation_euler = turn
    if bevel:
        modifier = obj.modifiers.new("bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, segments
        for polygon in obj.data.polygons:
            polygon.use_smooth = segments > 2
    return obj


class Soup:
    """Many small pieces in one mesh."""

    def __init__(self) -> None:
        self.verts: list[Sequence[float]] = []
        self.faces: list[Sequence[int]] = []

    def add(self, verts: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]) -> None:
        base = len(self.verts)
        self.verts.extend(verts)
        self.faces.extend(tuple(base + i for i in face) for face in faces)

    def box(self, centre: Vec, size: Vec, turn: float = 0.0) -> None:
        half = tuple(s / 2 for s in size)
        spin = Matrix.Translation(centre) @ Matrix.Rotation(turn, 4, "Z")
        corners = box_verts(tuple(-h for h in half), half)
        self.add([spin @ Vector(v) for v in corners], BOX_FACES)

    def build(
        self, name: str, mat: bpy.types.Material, where: Vec = (0, 0, 0), smooth: bool = False
    ) -> bpy.types.Object:
        return mesh(name, self.verts, self.faces, mat, where, smooth)


def lathe(
    name: str,
    profile: str | Sequence[tuple[float, float]],
    mat: bpy.types.Material,
    where: Vec = (0, 0, 0),
    segments: int = 56,
    scale: float = 1.0,
    finer: int = 1,
) -> bpy.types.Object:
    """Turn a profile of radius and height, "r z, r z, ...", around z; radius 0 closes an end."""
    if isinstance(profile, str):
        profile = [tuple(map(float, point.split())) for point in profile.split(",")]
    verts: list[Vec] = []
    faces: list[tuple[int, ...]] = []
    rings: list[list[int]] = []
    for radius, height in profile:
        count = 1 if radius == 0 else segments
        rings.append(list(range(len(verts), len(verts) + count)))
        for i in range(count):
            angle = math.tau * i / segments
            verts.append((radius * scale * math.cos(angle), radius * scale * math.sin(angle), height * scale))
    for below, above in zip(rings, rings[1:], strict=False):
        for i in range(segments):
            j = (i + 1) % segments
            face = [below[i % len(below)], below[j % len(below)]]
            face += [above[j % len(above)], above[i % len(above)]]
            faces.append(tuple(dict.fromkeys(face)))
    obj = mesh(name, verts, [f for f in faces if len(f) > 2], mat, where, smooth=True)
    if finer:
        modifier = obj.modifiers.new("finer", "SUBSURF")
        modifier.levels = modifier.render_levels = finer
    return obj


def ball(
    name: str,
    where: Vec,
    radius: float,
    mat: bpy.types.Material,
    detail: int = 3,
    rough: float = 0.0,
    scale: Vec = (1, 1, 1),
) -> bpy.types.Object:
    """An icosphere; rough moves its points by noise, in parts of the radius."""
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=detail, radius=radius)
    for vert in shape.verts:
        if rough:
            push = noise.noise(vert.co * (1.6 / radius) + Vector(where))
            vert.co *= 1.0 + rough * push
        vert.co = Vector(a * b for a, b in zip(vert.co, scale, strict=True))
    data = bpy.data.meshes.new(name)
    shape.to_mesh(data)
    shape.free()
    data.materials.append(mat)
    for polygon in data.polygons:
        polygon.use_smooth = True
    return link(name, data, where)


def sheet(
    name: str,
    columns: int,
    rows: int,
    point: Callable[[float, float], Sequence[float]],
    mat: bpy.types.Material,
    where: Vec = (0, 0, 0),
    thick: float = 0.0,
) -> bpy.types.Object:
    """A grid of quads through point(u, v)."""
    verts = [point(i / columns, j / rows) for j in range(rows + 1) for i in range(columns + 1)]
    wide = columns + 1
    faces = [
        (j * wide + i, j * wide + i + 1, (j + 1) * wide + i + 1, (j + 1) * wide + i)
        for j in range(rows)
        for i in range(columns)
    ]
    obj = mesh(name, verts, faces, mat, where, smooth=True)
    if thick:
        obj.modifiers.new("thick", "SOLIDIFY").thickness = thick
    return obj


def tube(
    name: str, points: Sequence[Vec], radius: float, mat: bpy.types.Material, closed: bool = False, curved: bool = False
) -> bpy.types.Object:
    data = bpy.data.curves.new(name, "CURVE")
    data.dimensions = "3D"
    data.bevel_depth, data.bevel_resolution = radius, 3
    data.use_fill_caps = True
    line = data.splines.new("NURBS" if curved else "POLY")
    line.points.add(len(points) - 1)
    for target, point in zip(line.points, points, strict=True):
        target.co = (*point, 1.0)
    line.use_cyclic_u = closed
    if curved:
        line.use_endpoint_u, line.order_u = not closed, 4
    data.materials.append(mat)
    return link(name, data)


def circle(centre: Vec, radius: float, axis: str = "y", count: int = 40) -> list[Vec]:
    x, y, z = centre
    turns = [(math.cos(math.tau * i / count), math.sin(math.tau * i / count)) for i in range(count)]
    if axis == "y":
        return [(x + radius * c, y, z + radius * s) for c, s in turns]
    if axis == "x":
        return [(x, y + radius * c, z + radius * s) for c, s in turns]
    return [(x + radius * c, y + radius * s, z) for c, s in turns]


def wall_with_holes(
    name: str,
    axis: str,
    at: float,
    spans: tuple[float, float, float, float],
    holes: Sequence[tuple[float, float, float, float]],
    thick: float,
    mat: bpy.types.Material,
) -> None:
    """An upright wall across `axis` with rectangular holes (from, to, low, high)."""
    left, right, low, high = spans
    soup = Soup()

    def block(a: float, b: float, c: float, d: float) -> None:
        if b - a < 1e-6 or d - c < 1e-6:
            return
        centre, size = ((a + b) / 2, (c + d) / 2), (b - a, d - c)
        if axis == "x":
            soup.box((at, centre[0], centre[1]), (thick, size[0], size[1]))
        else:
            soup.box((centre[0], at, centre[1]), (size[0], thick, size[1]))

    edge = left
    for a, b, c, d in sorted(holes):
        block(edge, a, low, high)
        block(a, b, low, c)
        block(a, b, d, high)
        edge = b
    block(edge, right, low, high)
    soup.build(name, mat)


def leaves(soup: Soup, rng: random.Random, centre: Vec, spread: float, count: int, size: float) -> None:
    """Scatter bent leaves around a point."""
    for _ in range(count):
        while True:
            off = Vector(rng.uniform(-1, 1) for _ in range(3))
            if off.length <= 1:
                break
        matrix = (
            Matrix.Translation(Vector(centre) + off * spread)
            @ Matrix.Rotation(rng.uniform(0, math.tau), 4, "Z")
            @ Matrix.Rotation(rng.uniform(-0.9, 0.9), 4, "X")
            @ Matrix.Scale(size * rng.uniform(0.6, 1.3), 4)
        )
        shape = ((0, 0, 0), (0.28, 0.5, 0.06), (0, 1, -0.1), (-0.28, 0.5, 0.06))
        soup.add([matrix @ Vector(v) for v in shape], [(0, 1, 2), (0, 2, 3)])


# ---------------------------------------------------------------- lights, camera


def aim(obj: bpy.types.Object, target: Vec) -> None:
    obj.rotation_euler = (Vector(target) - obj.location).to_track_quat("-Z", "Y").to_euler()


def lamp(
    name: str,
    kind: str,
    where: Vec,
    power: float,
    colour: Colour = (1, 1, 1),
    size: float = 0.1,
    target: Vec | None = None,
    group: str = "",
) -> bpy.types.Object:
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = power, colour
    if kind == "AREA":
        data.size = size
    elif kind == "SUN":
        data.angle = size
    else:
        data.shadow_soft_size = size
    obj = link(name, data, where)
    if target is not None:
        aim(obj, target)
    obj.lightgroup = group
    return obj


def portal(name: str, where: Vec, size: tuple[float, float], power: float, colour: Colour, target: Vec) -> None:
    """An area light in a window, which the camera does not see: what artists put there."""
    obj = lamp(name, "AREA", where, power, colour, size[0], target)
    obj.data.shape, obj.data.size_y = "RECTANGLE", size[1]
    obj.visible_camera = False


def camera(where: Vec, target: Vec, lens: float, focus: Vec | None = None, fstop: float = 2.8) -> None:
    data = bpy.data.cameras.new("Camera")
    data.lens = lens
    obj = link("Camera", data, where)
    aim(obj, target)
    bpy.context.scene.camera = obj
    if focus is not None:
        data.dof.use_dof = True
        data.dof.aperture_fstop = fstop
        view = (Vector(target) - Vector(where)).normalized()
        data.dof.focus_distance = (Vector(focus) - Vector(where)).dot(view)


def sky(horizon: Colour, zenith: Colour, strength: float, ground: Colour = (0.1, 0.09, 0.08)) -> None:
    """A sky that goes from the horizon's colour to the zenith's."""
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes = Nodes(world.node_tree)
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    split = nodes.add("SeparateXYZ", Vector=nodes.coords(kind="Generated"))
    height = nodes.maths("MULTIPLY_ADD", split.outputs[2], 0.5)
    height.node.inputs[2].default_value = 0.5
    stops = ((0.0, ground), (0.495, ground), (0.5, horizon), (0.75, zenith))
    nodes.give(background.inputs["Color"], nodes.ramp(height, stops))
    background.inputs["Strength"].default_value = strength


def sky_is_backdrop() -> None:
    """Let the sky be seen but not light the room, where portals already do."""
    world = bpy.context.scene.world
    world.cycles.sampling_method = "NONE"
    visible = world.cycles_visibility
    visible.diffuse = visible.scatter = False


def group(obj: bpy.types.Object, name: str) -> bpy.types.Object:
    obj.lightgroup = name
    return obj


# ---------------------------------------------------------------- scenes


def living_room() -> None:
    """A room lit by sun and sky through one window, and by a lamp."""
    rng = random.Random(11)
    wall = plaster("wall", (0.78, 0.72, 0.62))
    accent = plaster("accent", (0.16, 0.27, 0.27))
    white = material("white", Base_Color=(0.8, 0.78, 0.74), Roughness=0.45)
    oak = planks("oak", (0.48, 0.28, 0.13), (0.27, 0.13, 0.055), 0.13, 0.28, turn=math.pi / 2)
    walnut = planks("walnut", (0.2, 0.1, 0.045), (0.09, 0.04, 0.018), 0.3, 0.3)
    brass = metal("brass", (0.86, 0.62, 0.28), 0.25)
    box("floor", (0, 2.4, -0.05), (5.4, 6.2, 0.1), oak)
    box("ceiling", (0, 2.4, 2.75), (5.4, 6.2, 0.1), white)
    wall_with_holes("left", "x", -2.65, (-0.6, 5.5, 0, 2.7), [(1.7, 3.9, 0.55, 2.35)], 0.3, wall)
    box("back", (0, 5.1, 1.35), (5.4, 0.2, 2.7), accent)
    box("right", (2.65, 2.4, 1.35), (0.3, 6.2, 2.7), wall)
    box("behind", (0, -0.65, 1.35), (5.4, 0.2, 2.7), wall)
    box("skirting", (0, 4.985, 0.06), (5.2, 0.03, 0.12), white, 0.005)
    for y in (1.73, 2.8, 3.87):
        box("mullion", (-2.6, y, 1.45), (0.06, 0.07, 1.8), white, 0.008)
    for z in (0.57, 1.75, 2.33):
        box("mullion", (-2.6, 2.8, z), (0.06, 2.2, 0.06), white, 0.008)
    box("sill", (-2.48, 2.8, 0.53), (0.3, 2.3, 0.04), white, 0.01)
    linen = material("linen", Base_Color=(0.75, 0.68, 0.55), Roughness=0.9)
    for start in (1.3, 3.85):
        sheet(
            "curtain",
            60,
            6,
            lambda u, v, s=start: (-2.38 + 0.05 * math.sin(u * 31 + s) * (1.1 - 0.3 * v), s + 0.5 * u, 0.04 + 2.46 * v),
            linen,
        )
    tube("rail", [(-2.38, 1.1, 2.52), (-2.38, 4.5, 2.52)], 0.015, brass)

    def weave(n: Nodes) -> dict[str, object]:
        rings = n.add("TexWave", wave_type="RINGS", rings_direction="Z", Vector=n.coords(), Scale=1.4, Distortion=0.6)
        stops = ((0.0, (0.42, 0.09, 0.05)), (0.4, (0.6, 0.45, 0.28)), (0.65, (0.06, 0.12, 0.2)))
        return {
            "Base_Color": n.ramp(rings.outputs[1], stops),
            "Roughness": 1.0,
            "Normal": n.bump(n.noise(220, 2), 0.8, 0.01),
        }

    lathe("rug", "0 0.0, 1.5 0.0, 1.52 0.01, 1.5 0.02, 0 0.02", dress("rug", weave), (-0.1, 2.75, 0), finer=0)

    def velvet(name: str, colour: Colour) -> bpy.types.Material:
        return dress(
            name,
            lambda n: {
                "Base_Color": n.mix(colour, tuple(c * 0.7 for c in colour), n.noise(9, 5)),
                "Roughness": 0.85,
                "Sheen_Weight": 0.5,
                "Normal": n.bump(n.noise(160, 3), 0.3, 0.004),
            },
        )

    sofa = velvet("sofa", (0.42, 0.2, 0.09))
    mustard = velvet("mustard", (0.7, 0.42, 0.06))
    sage = velvet("sage", (0.28, 0.36, 0.25))
    box("base", (-0.5, 4.45, 0.27), (2.2, 0.85, 0.22), sofa, 0.05, segments=4)
    for x in (-1.05, 0.05):
        box("seat", (x, 4.4, 0.45), (1.06, 0.82, 0.18), sofa, 0.07, segments=5)
        box("rest", (x, 4.75, 0.72), (1.04, 0.24, 0.5), sofa, 0.1, (-0.2, 0, 0), segments=5)
    for x in (-1.68, 0.68):
        box("arm", (x, 4.45, 0.42), (0.2, 0.9, 0.5), sofa, 0.08, segments=5)
    for x, z in ((-1.4, 0.1), (0.4, 0.1), (-1.4, 0), (0.4, 0)):
        tube("leg", [(x, 4.1 + 6 * z, 0), (x, 4.1 + 6 * z, 0.18)], 0.025, walnut)
    box("cushion", (-1.35, 4.5, 0.72), (0.42, 0.16, 0.42), mustard, 0.075, (-0.35, 0.2, 0.3), 5)
    box("cushion", (-1.0, 4.47, 0.7), (0.36, 0.14, 0.36), sage, 0.065, (-0.4, -0.1, 0.0), 5)
    box("cushion", (0.38, 4.5, 0.7), (0.4, 0.15, 0.4), sage, 0.07, (-0.3, -0.2, -0.3), 5)
    # Table with a tray of things.
    lathe("top", "0 0.4, 0.52 0.4, 0.54 0.42, 0.52 0.44, 0 0.44", walnut, (-0.25, 3.0, 0), finer=0)
    for i in range(3):
        angle = 0.5 + i * math.tau / 3
        tip = (-0.25 + 0.42 * math.cos(angle), 3.0 + 0.42 * math.sin(angle), 0)
        tube("leg", [tip, (-0.25 + 0.2 * math.cos(angle), 3.0 + 0.2 * math.sin(angle), 0.41)], 0.02, brass)
    clay = material("clay", Base_Color=(0.75, 0.72, 0.68), Roughness=0.25)
    lathe("vase", "0 0, 0.06 0, 0.1 0.08, 0.09 0.17, 0.035 0.25, 0.05 0.29, 0.03 0.25, 0 0.1", clay, (-0.42, 3.1, 0.44))
    twig = material("twig", Base_Color=(0.3, 0.2, 0.1), Roughness=0.8)
    soup = Soup()
    for _ in range(7):
        tip = Vector((-0.42 + rng.uniform(-0.2, 0.2), 3.1 + rng.uniform(-0.2, 0.2), 1.0 + rng.uniform(-0.1, 0.15)))
        tube("twig", [(-0.42, 3.1, 0.66), (*tip,)], 0.004, twig)
        leaves(soup, rng, tuple(tip), 0.09, 16, 0.07)
    soup.build("blossom", leaf_material("blossom", ((0.0, (0.7, 0.25, 0.2)), (1.0, (0.8, 0.6, 0.45)))))
    bowl = material("bowl", Base_Color=(0.05, 0.12, 0.25), Roughness=0.12)
    lathe("bowl", "0 0, 0.06 0, 0.13 0.07, 0.12 0.07, 0.05 0.015, 0 0.015", bowl, (0.02, 2.88, 0.44))
    orange = dress(
        "orange",
        lambda n: {"Base_Color": (0.85, 0.3, 0.02), "Roughness": 0.4, "Normal": n.bump(n.noise(120, 2), 0.4, 0.003)},
    )
    for x, y, z in ((-0.03, 2.88, 0.5), (0.06, 2.91, 0.5), (0.03, 2.84, 0.5), (0.02, 2.88, 0.56)):
        ball("orange", (x, y, z), 0.042, orange)
    box(
        "book",
        (-0.18, 2.78, 0.455),
        (0.24, 0.17, 0.03),
        material("cover", Base_Color=(0.5, 0.06, 0.05), Roughness=0.5),
        0.003,
        (0, 0, 0.4),
    )
    box("book", (-0.17, 2.78, 0.48), (0.2, 0.15, 0.025), sage, 0.003, (0, 0, 0.15))
    # Lamp in the corner.
    lathe("foot", "0 0, 0.16 0, 0.16 0.02, 0.02 0.035, 0 0.035", brass, (1.25, 4.6, 0), finer=0)
    tube("pole", [(1.25, 4.6, 0.02), (1.25, 4.6, 1.5)], 0.012, brass)
    # The shade glows by itself and lets the bulb's light pass: far less noise than a real one.
    shade = glow("shade", (1.0, 0.68, 0.34), 2.6)
    lathe("shade", "0.22 0.0, 0.15 0.34", shade, (1.25, 4.6, 1.42), finer=0).visible_shadow = False
    lamp("bulb", "POINT", (1.25, 4.6, 1.57), 22, (1.0, 0.62, 0.28), 0.06)
    # Shelves with books on the right wall.
    for z in (0.05, 0.5, 0.95, 1.4, 1.85):
        box("shelf", (2.32, 3.35, z), (0.32, 1.5, 0.035), walnut, 0.004)
    for y in (2.6, 4.1):
        box("side", (2.32, y, 0.95), (0.32, 0.035, 1.85), walnut, 0.004)
    books = Soup()
    for z in (0.07, 0.52, 0.97, 1.42):
        y = 2.64
        while y < 3.95:
            if rng.random() < 0.12:
                y += rng.uniform(0.1, 0.25)
                continue
            wide, tall, deep = (rng.uniform(0.018, 0.05), rng.uniform(0.2, 0.33), rng.uniform(0.14, 0.2))
            books.box((2.36 - deep / 2 + 0.06, y + wide / 2, z + tall / 2), (deep, wide - 0.002, tall))
            y += wide
    palette = (
        (0.0, (0.35, 0.05, 0.04)),
        (0.2, (0.6, 0.5, 0.35)),
        (0.4, (0.05, 0.12, 0.2)),
        (0.6, (0.55, 0.3, 0.05)),
        (0.8, (0.1, 0.2, 0.1)),
        (1.0, (0.7, 0.66, 0.6)),
    )
    books.build("books", random_colours("books", palette, Roughness=0.55))
    # Pictures and a plant.
    for x, z, w, h, scale in ((-1.1, 1.62, 0.62, 0.8, 2.2), (-0.2, 1.72, 0.8, 0.6, 4.0), (0.6, 1.6, 0.45, 0.6, 7.0)):
        box("frame", (x, 4.985, z), (w + 0.06, 0.03, h + 0.06), brass, 0.006)
        art = dress(
            f"art{x}",
            lambda n, s=scale: {
                "Base_Color": n.ramp(
                    n.add("TexVoronoi", Vector=n.coords(), Scale=s, Randomness=0.9).outputs[0],
                    (
                        (0.1, (0.75, 0.7, 0.6)),
                        (0.3, (0.7, 0.25, 0.1)),
                        (0.5, (0.12, 0.25, 0.35)),
                        (0.7, (0.8, 0.6, 0.2)),
                    ),
                ),
                "Roughness": 0.15,
            },
        )
        box("art", (x, 4.972, z), (w, 0.02, h), art)
    lathe(
        "pot", "0 0, 0.16 0, 0.2 0.36, 0.18 0.36, 0.17 0.3, 0 0.3", plaster("pot", (0.65, 0.6, 0.55)), (-2.05, 4.55, 0)
    )
    green = Soup()
    for _ in range(26):
        angle, lean, tall = rng.uniform(0, math.tau), rng.uniform(0.1, 0.75), rng.uniform(0.6, 1.35)
        across = Vector((-math.sin(angle), math.cos(angle), 0))
        out = Vector((math.cos(angle), math.sin(angle), 0))
        strip: list[Vector] = []
        for k in range(7):
            t = k / 6
            mid = (
                Vector((-2.05, 4.55, 0.3))
                + out * (lean * 0.8 * t * t)
                + Vector((0, 0, tall * t * (1 - 0.3 * lean * t)))
            )
            wide = 0.055 * math.sin(math.pi * min(0.98, 0.12 + 0.88 * t)) + 0.004
            strip += [mid - across * wide, mid + across * wide]
        green.add(strip, [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(6)])
    green.build("plant", leaf_material("plant", ((0.0, (0.02, 0.1, 0.02)), (1.0, (0.1, 0.25, 0.05)))), smooth=True)
    # An armchair turned to the window.
    for obj in (
        box("chair", (1.35, 2.35, 0.3), (0.72, 0.7, 0.24), sage, 0.09, (0, 0, 0.5), 5),
        box("chair back", (1.63, 2.52, 0.66), (0.2, 0.74, 0.72), sage, 0.09, (0, 0.2, 0.5), 5),
    ):
        obj.pass_index = 3
    lamp("sun", "SUN", (-6, 0, 5), 9.0, (1.0, 0.83, 0.62), 0.012, (-0.6, 2.85, 0.3))
    portal("window", (-2.75, 2.8, 1.45), (1.8, 2.2), 230, (0.72, 0.85, 1.0), (5, 2.8, 1.45))
    lamp("fill", "AREA", (0.9, -0.4, 2.4), 42, (1.0, 0.92, 0.82), 1.6, (-0.4, 3.5, 0.7))
    sky((0.75, 0.85, 1.0), (0.25, 0.45, 0.9), 3.0, (0.25, 0.27, 0.18))
    sky_is_backdrop()
    camera((1.7, -0.4, 1.35), (-0.42, 3.6, 0.9), 25)


def still_life() -> None:
    """A painter's table: glass, gold, ceramics, fruit, cloth."""
    rng = random.Random(5)
    wood = planks("table", (0.2, 0.1, 0.05), (0.07, 0.03, 0.015), 0.16, 0.3)
    box("table", (0, 0, -0.02), (2.4, 1.3, 0.04), wood, 0.008)
    wall = dress(
        "wall",
        lambda n: {
            "Base_Color": n.ramp(n.noise(1.7, 9), ((0.3, (0.035, 0.05, 0.052)), (0.7, (0.12, 0.14, 0.13)))),
            "Roughness": 0.8,
            "Normal": n.bump(n.noise(18, 9), 0.4, 0.02),
        },
    )
    box("wall", (0, 1.05, 0.8), (5, 0.05, 3), wall)
    gold = dress(
        "gold",
        lambda n: {
            "Base_Color": (0.95, 0.65, 0.24),
            "Metallic": 1.0,
            "Roughness": n.maths("MULTIPLY", n.noise(35, 4), 0.34),
        },
    )
    lathe(
        "goblet",
        "0 0, 0.062 0, 0.064 0.008, 0.02 0.022, 0.012 0.05, 0.02 0.07, 0.012 0.09, "
        "0.03 0.115, 0.06 0.15, 0.062 0.21, 0.058 0.21, 0.055 0.15, 0.02 0.12, 0 0.12",
        gold,
        (0.36, 0.16, 0),
    )
    lathe("plate", "0 0, 0.09 0, 0.155 0.018, 0.157 0.022, 0.09 0.006, 0 0.006", gold, (0.13, -0.2, 0))
    clear = glass("clear", (0.98, 1, 0.99))
    lathe(
        "wineglass",
        "0 0, 0.045 0, 0.045 0.003, 0.006 0.008, 0.005 0.09, 0.02 0.105, 0.042 0.14, "
        "0.044 0.175, 0.035 0.23, 0.0335 0.23, 0.042 0.175, 0.04 0.14, 0.018 0.108, "
        "0 0.103",
        clear,
        (0.2, 0.05, 0),
    )
    wine = glass("wine", (0.42, 0.01, 0.02))
    lathe("wine", "0 0.1025, 0.0185 0.1075, 0.0405 0.14, 0.0422 0.165, 0 0.165", wine, (0.2, 0.05, 0), finer=0)
    green = glass("green", (0.12, 0.38, 0.16))
    lathe(
        "bottle",
        "0 0.012, 0.038 0.004, 0.042 0.01, 0.042 0.2, 0.036 0.235, 0.016 0.27, "
        "0.0145 0.33, 0.017 0.334, 0.017 0.345, 0.012 0.345, 0.0115 0.27, 0.032 0.23, "
        "0.038 0.2, 0.038 0.02, 0 0.026",
        green,
        (0.05, 0.3, 0),
    )
    label = material("label", Base_Color=(0.7, 0.62, 0.45), Roughness=0.8)
    lathe("label", "0.0425 0.07, 0.0425 0.15", label, (0.05, 0.3, 0), finer=0)

    def porcelain(n: Nodes) -> dict[str, object]:
        cells = n.add("TexVoronoi", feature="DISTANCE_TO_EDGE", Vector=n.coords(), Scale=17.0)
        waves = n.add("TexWave", Vector=n.coords(), Scale=9.0, Distortion=14.0, Detail=3.0)
        lines = n.ramp(cells.outputs[0], ((0.03, (0.02, 0.06, 0.35)), (0.07, (0.82, 0.85, 0.88))))
        swirl = n.ramp(waves.outputs[1], ((0.1, (0.03, 0.1, 0.45)), (0.3, (0.85, 0.87, 0.9))))
        return {
            "Base_Color": n.mix(lines, swirl, 1.0, "MULTIPLY"),
            "Roughness": 0.3,
            "Coat_Weight": 1.0,
            "Coat_Roughness": 0.03,
        }

    lathe(
        "vase",
        "0 0, 0.05 0, 0.055 0.01, 0.1 0.1, 0.105 0.17, 0.06 0.25, 0.035 0.28, 0.034 0.31, "
        "0.055 0.34, 0.05 0.34, 0.03 0.31, 0.03 0.28, 0 0.2",
        dress("porcelain", porcelain),
        (-0.27, 0.2, 0),
    )
    stem = material("stem", Base_Color=(0.16, 0.22, 0.07), Roughness=0.7)
    berries, foliage = Soup(), Soup()
    for _ in range(9):
        lean = Vector((rng.uniform(-0.22, 0.22), rng.uniform(-0.12, 0.12), rng.uniform(0.16, 0.34)))
        root = Vector((-0.27, 0.2, 0.33))
        points = [root + Vector((lean.x * t * t, lean.y * t * t, lean.z * t)) for t in (0, 0.35, 0.7, 1.0)]
        tube("stem", [tuple(p) for p in points], 0.0025, stem)
        for point in points[1:]:
            leaves(foliage, rng, tuple(point), 0.025, 5, 0.075)
            for _ in range(3):
                spot = point + Vector(rng.uniform(-0.03, 0.03) for _ in range(3))
                shape = bmesh.new()
                bmesh.ops.create_icosphere(shape, subdivisions=2, radius=0.0105)
                berries.add([v.co + spot for v in shape.verts], [[v.index for v in f.verts] for f in shape.faces])
                shape.free()
    foliage.build(
        "foliage", leaf_material("foliage", ((0, (0.05, 0.12, 0.03)), (0.6, (0.15, 0.25, 0.06)), (1, (0.5, 0.3, 0.05))))
    )
    berries.build(
        "berries",
        random_colours("berries", ((0, (0.65, 0.05, 0.02)), (1, (0.8, 0.3, 0.05))), Roughness=0.2),
        smooth=True,
    )

    def peel(colour: Colour, other: Colour) -> Callable[[Nodes], dict[str, object]]:
        return lambda n: {
            "Base_Color": n.mix(colour, other, n.ramp(n.noise(9, 5), ((0.4, (0, 0, 0)), (0.65, (1, 1, 1))))),
            "Roughness": 0.35,
            "Subsurface_Weight": 0.3,
            "Subsurface_Radius": (0.02, 0.008, 0.003),
            "Normal": n.bump(n.noise(260, 2), 0.25, 0.001),
        }

    orange = dress("orange", peel((0.85, 0.28, 0.015), (0.9, 0.42, 0.04)))
    lemon = dress("lemon", peel((0.9, 0.68, 0.06), (0.75, 0.65, 0.1)))
    apple = dress("apple", peel((0.5, 0.02, 0.02), (0.7, 0.45, 0.08)))
    glaze = dress(
        "glaze",
        lambda n: {
            "Base_Color": n.ramp(n.noise(25, 8), ((0.35, (0.1, 0.2, 0.2)), (0.6, (0.32, 0.46, 0.42)))),
            "Roughness": 0.15,
        },
    )
    lathe(
        "bowl",
        "0 0, 0.055 0, 0.06 0.012, 0.13 0.075, 0.135 0.085, 0.126 0.083, 0.05 0.02, 0 0.02",
        glaze,
        (-0.08, -0.03, 0),
    )
    for x, y, z, mat in (
        (-0.12, -0.05, 0.075, orange),
        (-0.03, -0.06, 0.075, apple),
        (-0.08, 0.02, 0.075, orange),
        (-0.075, -0.04, 0.13, lemon),
    ):
        ball("fruit", (x, y, z), 0.043, mat, 4, 0.04)
    ball("lemon", (0.3, -0.1, 0.032), 0.034, lemon, 4, 0.04, (1.3, 0.95, 0.95))
    ball("apple", (-0.33, -0.1, 0.04), 0.042, apple, 4, 0.08, (1, 1, 0.92))
    grape = material(
        "grape",
        Base_Color=(0.16, 0.02, 0.08),
        Roughness=0.18,
        Transmission_Weight=0.5,
        Subsurface_Weight=0.5,
        Subsurface_Radius=(0.01, 0.003, 0.004),
    )
    for i in range(34):
        t = i / 34
        angle, reach = i * 2.4, 0.062 * math.sqrt(1 - t)
        ball(
            "grape",
            (0.13 + reach * math.cos(angle) * 1.35, -0.2 + reach * math.sin(angle), 0.024 + 0.03 * t),
            0.0155,
            grape,
            3,
            0,
            (1, 1, 1.15),
        )

    def drape(u: float, v: float) -> Vec:
        x, y = -0.78 + 0.72 * u, -0.62 + 0.6 * v
        fold = noise.noise(Vector((x * 4.2, y * 3.0 + x * 3, 0.7)))
        fine = noise.noise(Vector((x * 11, y * 5, 3.1)))
        ridge = max(0.0, 1 - abs(fold) * 3.2) ** 1.6
        return (x, y - 0.03 * fold, 0.004 + 0.055 * ridge + 0.008 * (fine + 1) if y > -0.5 else 0.004 + 0.03 * ridge)

    cloth = dress(
        "cloth",
        lambda n: {
            "Base_Color": (0.62, 0.55, 0.44),
            "Roughness": 0.9,
            "Sheen_Weight": 0.3,
            "Normal": n.bump(n.add("TexChecker", Vector=n.coords(), Scale=420.0).outputs[1], 0.25, 0.001),
        },
    )
    sheet("cloth", 130, 110, drape, cloth, thick=0.003)
    steel = metal("steel", (0.7, 0.7, 0.72), 0.14)
    box("knife", (0.44, -0.26, 0.006), (0.22, 0.022, 0.002), steel, 0.0008, (0.1, 0, 0.5))
    box(
        "handle",
        (0.315, -0.33, 0.011),
        (0.1, 0.022, 0.016),
        material("horn", Base_Color=(0.05, 0.02, 0.01), Roughness=0.25),
        0.006,
        (0, 0, 0.5),
        4,
    )
    lamp("window", "AREA", (-1.5, -0.7, 1.3), 64, (1.0, 0.93, 0.82), 0.75, (-0.05, 0.05, 0.12))
    lamp("rim", "AREA", (1.3, 0.65, 0.85), 19, (0.7, 0.83, 1.0), 0.4, (0.1, 0.1, 0.15))
    sky((0.5, 0.42, 0.35), (0.16, 0.2, 0.3), 0.45)
    camera((0.12, -1.45, 0.46), (0.02, 0.06, 0.17), 50)


def night_bar() -> None:
    """A wet lane at night: bulbs, neon, lit windows, candles; light groups."""
    rng = random.Random(23)
    brick = tiles(
        "brick",
        (0.22, 0.07, 0.04),
        (0.1, 0.035, 0.025),
        (0.24, 0.08),
        turn=(0, math.pi / 2, math.pi / 2),
        grout=(0.12, 0.11, 0.1),
        rough=0.75,
        gap=0.008,
        uneven=0.6,
    )
    stucco = plaster("stucco", (0.32, 0.26, 0.2))

    def wet(n: Nodes) -> dict[str, object]:
        where = n.coords()
        cells = n.add("TexVoronoi", feature="DISTANCE_TO_EDGE", Vector=where, Scale=6.5, Randomness=0.6).outputs[0]
        gaps = n.ramp(cells, ((0.0, (0, 0, 0)), (0.12, (1, 1, 1))))
        pool = n.ramp(n.noise(0.55, 3), ((0.46, (1, 1, 1)), (0.56, (0, 0, 0))))
        height = n.mix(gaps, (0, 0, 0), n.mix((0.1, 0.1, 0.1), (0.97, 0.97, 0.97), pool))
        return {
            "Base_Color": n.mix((0.02, 0.02, 0.022), (0.075, 0.07, 0.068), gaps),
            "Roughness": n.mix((0.34, 0.34, 0.34), (0.04, 0.04, 0.04), pool),
            "Normal": n.bump(height, 0.7, 0.02),
        }

    box("ground", (0, 12, -0.05), (14, 44, 0.1), dress("wet", wet))
    stone = material("stone", Base_Color=(0.16, 0.15, 0.14), Roughness=0.4)
    for side in (-1, 1):
        box("kerb", (side * 2.35, 12, 0.04), (0.7, 44, 0.1), stone, 0.02)

    frames, panes_warm, panes_dark = Soup(), Soup(), Soup()
    y, index = -5.0, 0
    while y < 27:
        for side in (-1, 1):
            deep, tall = 5.0, rng.uniform(5.5, 8.5)
            front = side * (2.7 + rng.uniform(0, 0.15))
            box(
                "house",
                (front + side * 2.5, y + deep / 2, tall / 2),
                (5, deep - 0.02, tall),
                brick if (index + (side > 0)) % 2 else stucco,
            )
            box("cornice", (front, y + deep / 2, tall), (0.3, deep, 0.18), stone, 0.03)
            for floor in range(int((tall - 2.9) // 1.75) + 1):
                for k in range(3):
                    cy, cz = y + 0.9 + k * 1.6, 3.55 + floor * 1.75
                    if cz > tall - 0.7:
                        continue
                    frames.box((front, cy, cz), (0.12, 0.95, 1.3))
                    for a in (-0.22, 0.22):
                        (panes_warm if rng.random() < 0.36 else panes_dark).box(
                            (front - side * 0.065, cy + a, cz), (0.02, 0.36, 1.1)
                        )
        y += 5.0
        index += 1
    frames.build("frames", material("frame", Base_Color=(0.25, 0.22, 0.18), Roughness=0.5))
    pane = dress(
        "pane",
        lambda n: {
            "Base_Color": (0, 0, 0),
            "Roughness": 0.1,
            "Emission_Color": n.ramp(
                n.island(),
                ((0, (1.0, 0.5, 0.16)), (0.5, (1.0, 0.66, 0.3)), (0.85, (0.95, 0.8, 0.6)), (1.0, (0.45, 0.6, 1.0))),
            ),
            "Emission_Strength": n.maths("MULTIPLY", n.noise(2.4, 3), 5.0),
        },
    )
    group(panes_warm.build("windows", pane), "windows")
    panes_dark.build("dark windows", material("dark pane", Base_Color=(0.01, 0.012, 0.02), Roughness=0.05))

    # The bar on the right: a lit front with bottles, an awning and a counter.
    wood = planks("bar wood", (0.22, 0.09, 0.04), (0.08, 0.03, 0.015), 0.1, 0.3)
    box("front", (2.66, 3.0, 1.35), (0.12, 4.4, 2.7), wood, 0.01)
    back = dress(
        "bar back",
        lambda n: {
            "Base_Color": (0, 0, 0),
            "Roughness": 1.0,
            "Emission_Color": n.ramp(n.noise(1.3, 2), ((0.35, (0.9, 0.25, 0.05)), (0.65, (1.0, 0.66, 0.25)))),
            "Emission_Strength": 3.2,
        },
    )
    for cy in (1.75, 4.25):
        group(box("bar window", (2.59, cy, 1.55), (0.02, 1.7, 1.25), back), "windows")
        for z in (0.95, 1.35, 1.75):
            box("ledge", (2.54, cy, z), (0.1, 1.7, 0.02), wood)
            for _ in range(11):
                tall = rng.uniform(0.16, 0.29)
                by = cy + rng.uniform(-0.8, 0.8)
                tint = rng.choice(((0.1, 0.4, 0.15), (0.55, 0.25, 0.05), (0.7, 0.8, 0.85), (0.4, 0.05, 0.05)))
                name = f"bottle {tint}"
                mat = bpy.data.materials.get(name) or glass(name, tint)
                lathe(
                    "bottle",
                    [(0, 0), (0.035, 0), (0.035, tall * 0.6), (0.012, tall * 0.75), (0.012, tall), (0, tall)],
                    mat,
                    (2.53, by, z + 0.012),
                    segments=10,
                    finer=0,
                )
    box(
        "door",
        (2.58, 3.0, 1.05),
        (0.03, 0.62, 2.1),
        material("door", Base_Color=(0.05, 0.13, 0.1), Roughness=0.25),
        0.01,
    )
    stripes = dress(
        "awning",
        lambda n: {
            "Base_Color": n.ramp(
                n.add("TexWave", bands_direction="Y", Vector=n.coords(), Scale=0.8).outputs[1],
                ((0.49, (0.42, 0.02, 0.025)), (0.51, (0.7, 0.62, 0.5))),
            ),
            "Roughness": 0.8,
        },
    )
    sheet(
        "awning",
        40,
        6,
        lambda u, v: (
            2.6 - 1.0 * v,
            0.8 + 4.4 * u,
            2.75 - 0.55 * v - (0.09 + 0.03 * math.cos(u * 88) if v == 1 else 0),
        ),
        stripes,
        thick=0.01,
    )

    # Neon: a sign with letters and a glass.
    pink, cyan = glow("pink", (1.0, 0.08, 0.35), 14.0), glow("cyan", (0.1, 0.75, 1.0), 12.0)

    def at(points: Sequence[tuple[float, float]], y0: float, z0: float, size: float) -> list[Vec]:
        return [(1.62, y0 - size * px, z0 + size * pz) for px, pz in points]

    letters = {
        "B": (
            (0, 0),
            (0, 1),
            (0.45, 1),
            (0.55, 0.88),
            (0.55, 0.64),
            (0.45, 0.54),
            (0, 0.54),
            (0.5, 0.54),
            (0.62, 0.42),
            (0.62, 0.12),
            (0.5, 0),
            (0, 0),
        ),
        "A": ((0, 0), (0.32, 1), (0.64, 0), (0.53, 0.35), (0.11, 0.35)),
        "R": ((0, 0), (0, 1), (0.45, 1), (0.58, 0.88), (0.58, 0.62), (0.45, 0.5), (0, 0.5), (0.28, 0.5), (0.6, 0)),
    }
    board = material("board", Base_Color=(0.02, 0.02, 0.03), Roughness=0.4)
    sign_x = 1.95
    box("board", (sign_x, 6.0, 3.55), (1.15, 0.08, 1.5), board, 0.02)
    tube("bracket", [(sign_x, 6.0, 4.2), (2.8, 6.0, 4.2)], 0.02, board)
    for i, letter in enumerate("BAR"):
        line = [(sign_x - 0.47 + 0.33 * i + 0.42 * px, 5.94, 3.72 + 0.44 * pz) for px, pz in letters[letter]]
        group(tube("neon " + letter, line, 0.016, pink), "neon")
    shape = (
        (-0.3, 0.55),
        (0.3, 0.55),
        (0, 0.2),
        (0, -0.1),
        (-0.17, -0.14),
        (0.17, -0.14),
        (0, -0.1),
        (0, 0.2),
        (-0.3, 0.55),
    )
    group(tube("neon glass", [(sign_x + 0.8 * px, 5.94, 3.08 + 0.8 * pz) for px, pz in shape], 0.013, cyan), "neon")
    arrow = ((-2.66, 9.2, 2.4), (-2.66, 9.2, 3.6), (-2.66, 8.2, 3.6), (-2.66, 8.2, 2.4))
    group(tube("neon frame", arrow, 0.02, glow("violet", (0.45, 0.12, 1.0), 12.0), closed=True), "neon")

    # Strings of bulbs across the lane.
    bulbs = Soup()
    wire = material("wire", Base_Color=(0.01, 0.01, 0.01), Roughness=0.6)
    for i in range(6):
        start, end = Vector((-2.7, 0.3 + i * 2.7, 4.1)), Vector((2.7, 1.6 + i * 2.7, 4.0))
        if i % 2:
            start, end = Vector((-2.7, 1.6 + i * 2.7, 4.0)), Vector((2.7, 0.3 + i * 2.7, 4.1))
        line = []
        for k in range(17):
            t = k / 16
            point = start.lerp(end, t) - Vector((0, 0, 2.6 * t * (1 - t)))
            line.append(tuple(point))
            if 0 < k < 16:
                shape_b = bmesh.new()
                bmesh.ops.create_icosphere(shape_b, subdivisions=1, radius=0.08)
                bulbs.add(
                    [v.co + point - Vector((0, 0, 0.05)) for v in shape_b.verts],
                    [[v.index for v in f.verts] for f in shape_b.faces],
                )
                shape_b.free()
        tube("wire", line, 0.006, wire)
    group(bulbs.build("bulbs", glow("bulb", (1.0, 0.58, 0.22), 22.0), smooth=True), "bulbs")

    # Street lamps.
    iron = material("iron", Base_Color=(0.02, 0.025, 0.022), Metallic=0.6, Roughness=0.35)
    for x, y0 in ((-2.15, 3.6), (2.15, 10.5), (-2.15, 16.5), (2.15, 21)):
        tube("post", [(x, y0, 0), (x, y0, 2.9)], 0.045, iron)
        lathe("hat", "0.22 0, 0.03 0.17, 0 0.25", iron, (x, y0, 3.3), 6, finer=0)
        tube("ring", circle((x, y0, 2.95), 0.13, "z", 12), 0.012, iron, closed=True)
        group(ball("flame", (x, y0, 3.1), 0.14, glow("lamp", (1.0, 0.72, 0.4), 60.0), 2), "lamps")

    # Tables with candles, chairs, plants.
    for x, y0 in ((1.25, 1.5), (0.95, 3.3), (1.2, 5.0), (-1.7, 6.6)):
        lathe(
            "table",
            "0 0, 0.2 0, 0.2 0.02, 0.025 0.03, 0.025 0.7, 0.34 0.71, 0.34 0.74, 0 0.74",
            iron,
            (x, y0, 0),
            32,
            finer=0,
        )
        lathe("cup", "0.035 0, 0.04 0.09", glass("cup", (1.0, 0.45, 0.2), 0.1), (x + 0.08, y0, 0.745), 24, finer=0)
        group(ball("candle", (x + 0.08, y0, 0.785), 0.022, glow("candle", (1.0, 0.5, 0.15), 70.0), 2), "lamps")
        lathe(
            "tumbler",
            "0 0, 0.03 0, 0.035 0.11, 0.032 0.11, 0.027 0.015, 0 0.015",
            glass("clear"),
            (x - 0.12, y0 - 0.08, 0.745),
            24,
            finer=0,
        )
        for turn in (0.6, 3.9):
            cx, cy = x + 0.62 * math.cos(turn), y0 + 0.62 * math.sin(turn)
            seat = Soup()
            seat.box((0, 0, 0.45), (0.38, 0.38, 0.03))
            for a in (-0.17, 0.17):
                for b in (-0.17, 0.17):
                    seat.box((a, b, 0.22), (0.025, 0.025, 0.45))
                seat.box((0.18, a, 0.68), (0.025, 0.025, 0.45))
            for z in (0.66, 0.76, 0.86):
                seat.box((0.18, 0, z), (0.02, 0.36, 0.045))
            seat.build("chair", wood, (cx, cy, 0)).rotation_euler = (0, 0, turn)
    plants = Soup()
    for x, y0 in ((2.15, 0.5), (2.2, 5.5), (-2.2, 1.6), (-2.2, 5.2), (-2.25, 8.0)):
        lathe("pot", "0 0, 0.15 0, 0.19 0.34, 0.16 0.34, 0 0.28", plaster("pot", (0.35, 0.13, 0.07)), (x, y0, 0.09), 32)
        leaves(plants, rng, (x, y0, 0.72), 0.34, 170, 0.14)
    plants.build("plants", leaf_material("plants", ((0, (0.02, 0.08, 0.02)), (1, (0.09, 0.18, 0.04)))))
    for y0 in (1.75, 4.25):
        lamp("under awning", "AREA", (2.0, y0, 2.3), 26, (1.0, 0.62, 0.3), 0.5, (1.5, y0, 0), "lamps")
    sky((0.16, 0.13, 0.2), (0.02, 0.04, 0.13), 2.0, (0, 0, 0))
    bpy.context.scene.world.lightgroup = "sky"
    camera((-1.0, -2.6, 1.6), (0.75, 5.2, 1.75), 25)


def house() -> None:
    """A country house in the afternoon: grass, a tree, a fence; transparent film."""
    rng = random.Random(31)

    def ground(x: float, y: float) -> float:
        far = max(0.0, (y - 14) / 20)
        return (
            0.35 * noise.noise(Vector((x * 0.12, y * 0.12, 0.3)))
            + 2.4 * far * far
            + 0.06 * noise.noise(Vector((x, y, 5.0)))
        )

    soil = dress(
        "soil",
        lambda n: {
            "Base_Color": n.ramp(
                n.noise(0.9, 9), ((0.3, (0.05, 0.085, 0.02)), (0.55, (0.12, 0.15, 0.035)), (0.75, (0.2, 0.16, 0.07)))
            ),
            "Roughness": 0.95,
            "Normal": n.bump(n.noise(25, 8), 0.8, 0.05),
        },
    )
    sheet("terrain", 120, 120, lambda u, v: (-30 + 60 * u, -4 + 44 * v, ground(-30 + 60 * u, -4 + 44 * v)), soil)
    base = ground(0.5, 9.0)
    boards = tiles(
        "boards",
        (0.8, 0.77, 0.7),
        (0.74, 0.71, 0.64),
        (40.0, 0.16),
        turn=(math.pi / 2, 0, 0),
        grout=(0.3, 0.28, 0.25),
        rough=0.6,
        gap=0.008,
        uneven=0.05,
    )
    boards_x = tiles(
        "boards x",
        (0.8, 0.77, 0.7),
        (0.74, 0.71, 0.64),
        (40.0, 0.16),
        turn=(math.pi / 2, 0, math.pi / 2),
        grout=(0.3, 0.28, 0.25),
        rough=0.6,
        gap=0.008,
        uneven=0.05,
    )
    roof = tiles(
        "roof",
        (0.32, 0.1, 0.06),
        (0.2, 0.07, 0.05),
        (0.3, 0.24),
        grout=(0.05, 0.02, 0.015),
        rough=0.7,
        gap=0.015,
        uneven=0.8,
    )
    trim = material("trim", Base_Color=(0.85, 0.84, 0.8), Roughness=0.5)
    cx, cy, w, d, h = 0.8, 9.5, 5.6, 4.4, 3.0
    box("front", (cx, cy - d / 2, base + h / 2), (w, 0.15, h), boards)
    box("rear", (cx, cy + d / 2, base + h / 2), (w, 0.15, h), boards)
    for side in (-1, 1):
        x = cx + side * w / 2
        box("side", (x, cy, base + h / 2), (0.15, d, h), boards_x)
        peak = 2.0
        mesh(
            "gable",
            [(x, cy - d / 2, base + h), (x, cy + d / 2, base + h), (x, cy, base + h + peak)],
            [(0, 1, 2)],
            boards_x,
        )
        slope = math.atan2(peak, d / 2)
        length = math.hypot(peak, d / 2) + 0.55
        mid_y, mid_z = cy + side * (d / 4 + 0.2), base + h + peak / 2 - 0.1
        box("roof", (cx, mid_y, mid_z), (w + 0.8, length, 0.1), roof, 0, (-side * slope, 0, 0))
        box("corner", (x, cy - d / 2 - 0.05, base + h / 2), (0.2, 0.14, h), trim, 0.01)
    box(
        "chimney",
        (cx + 1.5, cy + 0.6, base + h + 2.0),
        (0.6, 0.6, 1.9),
        tiles(
            "chimney", (0.3, 0.1, 0.06), (0.2, 0.06, 0.04), (0.22, 0.075), turn=(math.pi / 2, 0, 0), rough=0.8, gap=0.01
        ),
    )
    box("floor", (cx, cy, base + 0.1), (w, d, 0.2), trim)
    front = cy - d / 2 - 0.06
    pane = material("pane", Base_Color=(0.02, 0.025, 0.03), Roughness=0.03, Metallic=0.0, Specular_IOR_Level=1.0)
    shutter = tiles(
        "shutter",
        (0.07, 0.2, 0.24),
        (0.06, 0.17, 0.2),
        (3.0, 0.06),
        turn=(math.pi / 2, 0, 0),
        grout=(0.02, 0.06, 0.07),
        rough=0.5,
    )
    for x in (cx - 1.9, cx + 1.9):
        box("frame", (x, front, base + 1.65), (1.0, 0.1, 1.35), trim, 0.01)
        for a in (-0.23, 0.23):
            for b in (-0.31, 0.31):
                box("pane", (x + a, front - 0.05, base + 1.65 + b), (0.4, 0.02, 0.55), pane)
        for side in (-1, 1):
            box("shutter", (x + side * 0.74, front - 0.02, base + 1.65), (0.44, 0.06, 1.35), shutter, 0.01)
        box(
            "flowerbox",
            (x, front - 0.18, base + 0.86),
            (1.1, 0.24, 0.2),
            material("box", Base_Color=(0.2, 0.1, 0.05), Roughness=0.7),
            0.01,
        )
        blossom = Soup()
        leaves(blossom, rng, (x, front - 0.2, base + 1.02), 0.3, 90, 0.09)
        leaves(blossom, rng, (x - 0.32, front - 0.2, base + 1.02), 0.22, 60, 0.09)
        leaves(blossom, rng, (x + 0.32, front - 0.2, base + 1.02), 0.22, 60, 0.09)
        blossom.build(
            "blossom",
            leaf_material(
                "geranium",
                ((0, (0.03, 0.12, 0.02)), (0.5, (0.1, 0.25, 0.05)), (0.6, (0.75, 0.04, 0.05)), (1, (0.85, 0.2, 0.25))),
            ),
        )
    box(
        "door",
        (cx, front, base + 1.15),
        (0.95, 0.1, 2.1),
        material("door", Base_Color=(0.4, 0.05, 0.04), Roughness=0.25),
        0.02,
    )
    box("lintel", (cx, front - 0.02, base + 2.28), (1.2, 0.16, 0.14), trim, 0.01)
    ball("knob", (cx + 0.36, front - 0.08, base + 1.1), 0.04, metal("brass", (0.9, 0.65, 0.25), 0.15), 3)
    # Porch.
    porch = planks("porch", (0.35, 0.25, 0.17), (0.2, 0.13, 0.08), 0.12, 0.6, turn=math.pi / 2)
    box("deck", (cx, front - 0.7, base + 0.12), (2.6, 1.4, 0.14), porch, 0.01)
    box("step", (cx, front - 1.6, base + 0.04), (1.4, 0.4, 0.1), porch, 0.01)
    for side in (-1, 1):
        lathe(
            "column",
            "0.09 0, 0.07 0.1, 0.06 2.2, 0.1 2.35",
            trim,
            (cx + side * 1.15, front - 1.3, base + 0.18),
            24,
            finer=0,
        )
    box("porch roof", (cx, front - 0.7, base + 2.72), (2.9, 1.65, 0.1), roof, 0, (0.22, 0, 0))
    # Path of flat stones and a fence.
    slab = plaster("slab", (0.36, 0.33, 0.29))
    for i in range(12):
        y = front - 2.1 - i * 0.62
        x = cx - 0.9 * (i / 11) ** 2 + rng.uniform(-0.08, 0.08)
        ball("slab", (x, y, ground(x, y) + 0.0), 0.4, slab, 3, 0.25, (1.0, 0.66, 0.12))
    fence = Soup()
    for i in range(-26, 30):
        x, y = i * 0.24, 3.9
        if -0.5 < x - cx + 0.35 < 0.75:
            continue
        z, tall = ground(x, y), 0.78 + 0.02 * rng.random()
        fence.box((x, y, z + tall / 2), (0.085, 0.025, tall))
        fence.add(
            [(x - 0.0425, y - 0.0125, z + tall), (x + 0.0425, y - 0.0125, z + tall), (x, y, z + tall + 0.07)],
            [(0, 1, 2)],
        )
    for z in (0.25, 0.62):
        fence.box((-3.2, 3.93, ground(-3, 3.9) + z), (6.6, 0.03, 0.07))
        fence.box((4.4, 3.93, ground(4, 3.9) + z), (6.4, 0.03, 0.07))
    fence.build("fence", trim)
    # Grass: one blade mesh per patch, patches repeated.
    blade_mat = leaf_material(
        "grass",
        ((0, (0.045, 0.11, 0.015)), (0.6, (0.12, 0.2, 0.03)), (0.9, (0.28, 0.28, 0.07)), (1, (0.4, 0.33, 0.12))),
    )
    patches = []
    for k in range(3):
        soup = Soup()
        for _ in range(1500):
            x, y, angle = rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(0, math.tau)
            tall, lean, wide = (rng.uniform(0.07, 0.24), rng.uniform(0.02, 0.12), rng.uniform(0.004, 0.009))
            out, across = (
                Vector((math.cos(angle), math.sin(angle), 0)),
                Vector((-math.sin(angle), math.cos(angle), 0)),
            )
            foot = Vector((x, y, -0.03))
            middle = foot + out * lean * 0.35 + Vector((0, 0, tall * 0.6))
            soup.add(
                [
                    foot - across * wide,
                    foot + across * wide,
                    middle + across * wide * 0.8,
                    middle - across * wide * 0.8,
                    foot + out * lean + Vector((0, 0, tall)),
                ],
                [(0, 1, 2, 3), (3, 2, 4)],
            )
        patches.append(soup.build(f"patch{k}", blade_mat, (0, -60, 0)).data)
    for i in range(-12, 13):
        for j in range(0, 20):
            x, y = i * 0.92 + rng.uniform(-0.2, 0.2), -1.4 + j * 0.85 + rng.uniform(-0.2, 0.2)
            track = cx - 0.9 * min(1.0, max(0.0, (front - 2.1 - y) / 6.8)) ** 2
            if (abs(x - track) < 0.95 and y < front) or (abs(x - cx) < w / 2 + 0.3 and front - 1.6 < y):
                continue
            if abs(x) > 3.0 + 0.75 * (y + 4):
                continue
            turf = link("turf", patches[rng.randrange(3)], (x, y, ground(x, y)))
            turf.rotation_euler = (0, 0, rng.uniform(0, math.tau))
            turf.scale = (1, 1, rng.uniform(0.7, 1.5))
    petals = Soup()
    for _ in range(260):
        x, y = rng.uniform(-6, 6), rng.uniform(0.2, 3.7)
        z = ground(x, y) + rng.uniform(0.15, 0.3)
        if abs(x - cx + 0.6) > 0.8:
            leaves(petals, rng, (x, y, z), 0.02, 5, 0.05)
    petals.build(
        "flowers",
        leaf_material(
            "flowers",
            ((0, (0.9, 0.85, 0.8)), (0.4, (0.85, 0.65, 0.05)), (0.7, (0.75, 0.08, 0.1)), (1, (0.35, 0.15, 0.7))),
        ),
    )
    # A tree: branches by splitting, leaves at the ends.
    bark = dress(
        "bark",
        lambda n: {
            "Base_Color": n.ramp(
                n.noise(6, 8, n.coords((4, 4, 0.6))), ((0.3, (0.05, 0.03, 0.02)), (0.7, (0.2, 0.14, 0.09)))
            ),
            "Roughness": 0.95,
        },
    )
    crown = Soup()

    def branch(start: Vector, way: Vector, length: float, thick: float, level: int) -> None:
        bend = Vector(rng.uniform(-0.15, 0.15) for _ in range(3))
        middle, end = start + way * length * 0.5 + bend * length * 0.3, start + way * length
        tube("branch", [tuple(start), tuple(middle), tuple(end)], thick, bark, curved=False)
        if level >= 3:
            leaves(crown, rng, tuple(end), 0.62, 130, 0.2)
        if level == 4:
            return
        for k in range(3 if level < 3 else 2):
            around = k * 2.1 + rng.uniform(-0.5, 0.5) + level
            spread = rng.uniform(0.45, 0.8)
            aside = Vector((math.cos(around), math.sin(around), 0)) * spread
            turned = (way + aside + Vector((0, 0, 0.25))).normalized()
            branch(end, turned, length * rng.uniform(0.62, 0.8), thick * 0.6, level + 1)

    foot = Vector((-4.0, 7.2, ground(-4.0, 7.2) - 0.1))
    branch(foot, Vector((0.08, 0, 1)).normalized(), 1.9, 0.2, 0)
    crown.build(
        "crown", leaf_material("crown", ((0, (0.04, 0.11, 0.015)), (0.7, (0.12, 0.22, 0.03)), (1, (0.35, 0.28, 0.04))))
    )
    bush = Soup()
    for x, y, r in ((-1.4, 6.9, 0.5), (3.3, 6.9, 0.55), (4.2, 7.6, 0.75), (-2.4, 8.2, 0.7), (6.0, 9.5, 1.1)):
        leaves(bush, rng, (x, y, ground(x, y) + r * 0.7), r, int(900 * r), 0.13)
    bush.build("bushes", leaf_material("bush", ((0, (0.03, 0.09, 0.02)), (1, (0.12, 0.2, 0.05)))))
    for i in range(9):
        x, y = rng.uniform(-16, 18), rng.uniform(19, 26)
        far = Soup()
        leaves(far, rng, (x, y, ground(x, y) + 2.6), 2.6, 1500, 0.45)
        far.build(f"far tree {i}", bpy.data.materials["crown"])
    lamp("sun", "SUN", (-6, -2.5, 4.2), 4.2, (1.0, 0.85, 0.66), 0.009, (0.5, 5, 0))
    sky((0.75, 0.82, 0.95), (0.22, 0.42, 0.85), 1.2, (0.1, 0.11, 0.05))
    bpy.context.scene.render.film_transparent = True
    camera((-1.7, -2.6, 1.5), (0.15, 7.5, 1.75), 30)


SLOTS = (-0.85, 1.7, 2.7, 4.7, 5.7, 7.7, 8.7, 10.7, 11.7, 14.2)  # windows along the hall


def misty_hall() -> None:
    """Sunbeams in a hall of stone, wax and jade in front; fog and depth of field."""
    rng = random.Random(47)
    stone = dress(
        "stone",
        lambda n: {
            "Base_Color": n.ramp(n.noise(1.8, 9), ((0.3, (0.22, 0.19, 0.16)), (0.7, (0.4, 0.36, 0.3)))),
            "Roughness": 0.85,
            "Normal": n.bump(n.noise(14, 9), 0.5, 0.03),
        },
    )
    flags = tiles(
        "flags",
        (0.3, 0.26, 0.22),
        (0.17, 0.15, 0.13),
        (0.9, 0.9),
        grout=(0.05, 0.045, 0.04),
        rough=0.3,
        gap=0.012,
        uneven=0.4,
    )
    box("floor", (0, 8, -0.05), (9, 24, 0.1), flags)
    box("vault", (0, 8, 6.4), (9, 24, 0.2), stone)
    box("left", (-3.9, 8, 3.2), (0.4, 24, 6.4), stone)
    slots = [(y - 0.22, y + 0.22, 2.2, 5.2) for y in SLOTS]
    wall_with_holes("right", "x", 3.9, (-4, 20, 0, 6.4), slots, 0.4, stone)
    wall_with_holes("end", "y", 18.2, (-4, 4, 0, 6.4), [(-0.7, 0.7, 2.4, 5.4)], 0.4, stone)
    box("behind", (0, -3.8, 3.2), (9, 0.3, 6.4), stone)
    column = [
        (0.36, 0),
        (0.36, 0.25),
        (0.27, 0.36),
        (0.24, 0.5),
        (0.21, 3.0),
        (0.25, 3.08),
        (0.25, 3.15),
        (0.37, 3.45),
        (0.37, 3.6),
    ]
    for side in (-1, 1):
        for k in range(6):
            y = 0.7 + 3.0 * k
            if y > 1:
                lathe("column", column, stone, (side * 2.2, y, 0), 32, finer=0)
            rise = [
                (side * 2.2, y + 1.5 - 1.5 * math.cos(a * math.pi / 12), 3.6 + 1.4 * math.sin(a * math.pi / 12))
                for a in range(13)
            ]
            tube("arch", rise, 0.22, stone)
            tube(
                "rib",
                [(2.2 * math.cos(a * math.pi / 12), y, 3.6 + 2.5 * math.sin(a * math.pi / 12)) for a in range(13)],
                0.14,
                stone,
            )
    fog = bpy.data.materials.new("fog")
    fog.use_nodes = True
    fog.node_tree.nodes.clear()
    n = Nodes(fog.node_tree)
    scatter = n.add("VolumeScatter", Color=(0.95, 0.95, 1.0), Density=0.12, Anisotropy=0.3)
    out = n.add("OutputMaterial")
    n.give(out.inputs["Volume"], scatter.outputs[0])
    box("fog", (0, 7.1, 3.0), (7.3, 21.5, 6.3), fog)
    # A stone block with things to look at.
    block = plaster("block", (0.42, 0.38, 0.33), 0.6)
    box("plinth", (0.0, 0.25, 0.41), (1.9, 0.8, 0.82), block, 0.03)
    box("slab", (0.0, 0.25, 0.86), (2.1, 0.95, 0.09), block, 0.02)
    wax = material(
        "wax",
        Base_Color=(0.85, 0.72, 0.5),
        Roughness=0.4,
        Subsurface_Weight=1.0,
        Subsurface_Radius=(0.06, 0.025, 0.012),
        Subsurface_Scale=1.0,
    )
    flame = glow("flame", (1.0, 0.55, 0.18), 30.0)
    wick = material("wick", Base_Color=(0.01, 0.01, 0.01), Roughness=1.0)
    for x, y, r, tall in (
        (-0.52, 0.2, 0.06, 0.34),
        (-0.38, 0.36, 0.05, 0.22),
        (-0.64, 0.42, 0.045, 0.46),
        (0.66, 0.42, 0.055, 0.26),
        (0.8, 0.25, 0.045, 0.15),
    ):
        dip = rng.uniform(0.01, 0.02)
        lathe(
            "candle",
            [
                (0, 0),
                (r * 1.1, 0),
                (r, 0.02),
                (r, tall - 0.01),
                (r * 0.93, tall + 0.004),
                (r * 0.75, tall - dip),
                (0, tall - dip),
            ],
            wax,
            (x, y, 0.905),
            40,
        )
        tube("wick", [(x, y, 0.9 + tall - dip), (x + 0.002, y, 0.9 + tall + 0.02)], 0.003, wick)
        lathe(
            "flame", "0 0, 0.008 0.008, 0.0105 0.022, 0.005 0.045, 0 0.06", flame, (x, y, 0.9 + tall + 0.008), 16
        ).visible_shadow = False
        lamp("flame light", "POINT", (x, y, 0.93 + tall), 2.2, (1.0, 0.55, 0.18), 0.012)
    jade = dress(
        "jade",
        lambda n: {
            "Base_Color": n.ramp(n.noise(6, 7), ((0.35, (0.08, 0.4, 0.2)), (0.7, (0.5, 0.75, 0.5)))),
            "Roughness": 0.14,
            "Subsurface_Weight": 1.0,
            "Subsurface_Radius": (0.03, 0.06, 0.035),
            "Subsurface_Scale": 1.0,
        },
    )
    lathe(
        "queen",
        "0 0, 0.13 0, 0.135 0.03, 0.11 0.06, 0.115 0.08, 0.075 0.12, 0.05 0.2, 0.042 0.32, "
        "0.05 0.36, 0.085 0.37, 0.085 0.385, 0.055 0.395, 0.05 0.42, 0.085 0.5, "
        "0.09 0.515, 0.06 0.51, 0.03 0.535, 0 0.54",
        jade,
        (0.05, 0.12, 0.905),
    )
    ball("pearl", (0.05, 0.12, 1.465), 0.03, jade, 4)
    bronze = metal("bronze", (0.55, 0.3, 0.12), 0.3)
    lathe(
        "bowl",
        "0 0, 0.05 0, 0.05 0.01, 0.02 0.02, 0.12 0.07, 0.14 0.11, 0.132 0.11, 0.11 0.075, 0 0.03",
        bronze,
        (0.4, 0.14, 0.905),
    )
    for i in range(9):
        ball(
            "bead",
            (0.4 + 0.06 * math.cos(i * 2.4), 0.14 + 0.06 * math.sin(i * 2.4), 0.985 + 0.012 * (i % 2)),
            0.026,
            jade if i % 3 else bronze,
            3,
        )
    book = material("leather", Base_Color=(0.22, 0.05, 0.03), Roughness=0.45)
    box("book", (-0.28, 0.02, 0.93), (0.26, 0.19, 0.05), book, 0.006, (0, 0, 0.35))
    box("pages", (-0.28, 0.02, 0.93), (0.262, 0.18, 0.04), plaster("paper", (0.7, 0.62, 0.45)), 0, (0, 0, 0.35))
    for x, y in ((-2.9, 6), (-2.9, 9), (2.9, 7)):
        tube("bench leg", [(x, y, 0), (x, y, 0.45)], 0.1, stone)
    for k in range(4):
        for x in (-1.15, 1.15):
            bench = Soup()
            bench.box((x, 5.6 + 1.5 * k, 0.42), (1.3, 0.35, 0.05))
            bench.box((x, 5.8 + 1.5 * k, 0.7), (1.3, 0.04, 0.5))
            for a in (-0.62, 0.62):
                bench.box((x + a, 5.65 + 1.5 * k, 0.35), (0.06, 0.4, 0.7))
            bench.build("bench", planks("bench wood", (0.16, 0.08, 0.04), (0.07, 0.03, 0.015), 0.3, 0.4))
    lamp("sun", "SUN", (9, 0, 8.5), 36.0, (1.0, 0.8, 0.55), 0.01, (0, 2.4, 1.0))
    for y in SLOTS:
        portal("slot", (4.12, y, 3.7), (0.44, 3.0), 26, (0.6, 0.78, 1.0), (0, y, 3.7))
    sky((0.5, 0.65, 1.0), (0.25, 0.4, 0.9), 5.0, (0.2, 0.2, 0.2))
    sky_is_backdrop()
    camera((-0.25, -1.8, 1.4), (0.08, 1.5, 1.5), 29, (0.05, 0.12, 1.2), 1.2)


def bathroom() -> None:
    """Tiles, a mirror, chrome and glass."""
    rng = random.Random(3)
    zellige = tiles(
        "zellige",
        (0.03, 0.2, 0.22),
        (0.12, 0.4, 0.38),
        (0.1, 0.1),
        turn=(math.pi / 2, 0, 0),
        offset=0.0,
        rough=0.06,
        gap=0.004,
        uneven=0.5,
        grout=(0.6, 0.58, 0.52),
    )
    white_x = tiles(
        "metro",
        (0.82, 0.81, 0.78),
        (0.74, 0.73, 0.7),
        (0.2, 0.1),
        turn=(0, math.pi / 2, math.pi / 2),
        rough=0.08,
        gap=0.004,
        uneven=0.3,
    )
    white = plaster("paint", (0.82, 0.8, 0.76))
    porcelain = material("porcelain", Base_Color=(0.85, 0.85, 0.83), Roughness=0.08, Coat_Weight=0.5)
    chrome = metal("chrome", (0.9, 0.9, 0.92), 0.06)
    brass = metal("brass", (0.85, 0.6, 0.27), 0.18)
    oak = planks("oak", (0.45, 0.26, 0.12), (0.28, 0.14, 0.06), 0.3, 0.4)

    def checks(n: Nodes) -> dict[str, object]:
        board = n.add(
            "TexChecker",
            Vector=n.coords(turn=(0, 0, math.pi / 4)),
            Scale=5.0,
            Color1=(0.75, 0.73, 0.68),
            Color2=(0.04, 0.045, 0.05),
        )
        veins = n.ramp(n.noise(3.0, 9), ((0.48, (1, 1, 1)), (0.5, (0.6, 0.58, 0.55)), (0.52, (1, 1, 1))))
        return {"Base_Color": n.mix(board.outputs[0], veins, 0.6, "MULTIPLY"), "Roughness": 0.1}

    box("floor", (0, 1.2, -0.05), (3.4, 4.2, 0.1), dress("checks", checks))
    box("ceiling", (0, 1.2, 2.65), (3.4, 4.2, 0.1), white)
    box("back", (0, 3.05, 1.3), (3.4, 0.1, 2.6), zellige)
    wall_with_holes("left", "x", -1.65, (-0.9, 3.1, 0, 2.6), [(1.0, 2.1, 1.15, 2.2)], 0.2, white_x)
    box("right", (1.65, 1.2, 1.3), (0.2, 4.2, 2.6), white_x)
    box("front", (0, -0.85, 1.3), (3.4, 0.1, 2.6), white)
    for y in (1.02, 1.55, 2.08):
        box("bar", (-1.62, y, 1.67), (0.05, 0.05, 1.05), white, 0.005)
    for z in (1.17, 2.18):
        box("bar", (-1.62, 1.55, z), (0.05, 1.1, 0.05), white, 0.005)
    # Vanity, basin, tap.
    box("vanity", (-0.45, 2.72, 0.62), (1.5, 0.54, 0.36), oak, 0.008)
    for x in (-0.83, -0.07):
        box("drawer", (x, 2.445, 0.62), (0.72, 0.02, 0.3), oak, 0.004)
        tube("handle", [(x - 0.12, 2.41, 0.66), (x + 0.12, 2.41, 0.66)], 0.008, brass)
    marble = dress(
        "marble",
        lambda n: {
            "Base_Color": n.ramp(
                n.noise(4.0, 10), ((0.44, (0.82, 0.81, 0.79)), (0.5, (0.35, 0.36, 0.38)), (0.56, (0.8, 0.79, 0.77)))
            ),
            "Roughness": 0.07,
        },
    )
    box("top", (-0.45, 2.72, 0.82), (1.54, 0.58, 0.04), marble, 0.006)
    lathe(
        "basin",
        "0 0, 0.14 0, 0.22 0.09, 0.235 0.14, 0.225 0.142, 0.2 0.09, 0.1 0.025, 0 0.02",
        porcelain,
        (-0.45, 2.68, 0.84),
    )
    tube(
        "tap",
        [
            (-0.45, 2.94, 0.84),
            (-0.45, 2.94, 1.1),
            (-0.45, 2.94, 1.2),
            (-0.45, 2.88, 1.22),
            (-0.45, 2.78, 1.2),
            (-0.45, 2.77, 1.14),
        ],
        0.015,
        chrome,
        curved=True,
    )
    for x in (-0.57, -0.33):
        lathe("knob", "0 0, 0.025 0, 0.02 0.03, 0.03 0.05, 0 0.06", chrome, (x, 2.92, 0.84), 24)
    lathe(
        "mirror",
        "0 0.012, 0.42 0.012, 0.42 0",
        metal("silver", (0.95, 0.95, 0.95), 0.0),
        (-0.45, 2.985, 1.7),
        96,
        finer=0,
    ).rotation_euler = (math.pi / 2, 0, 0)
    tube("mirror frame", circle((-0.45, 2.98, 1.7), 0.43, count=72), 0.014, brass, closed=True)
    opal = glow("opal", (1.0, 0.74, 0.45), 22.0)
    for x in (-1.1, 0.2):
        tube("arm", [(x, 3.0, 1.75), (x, 2.88, 1.75)], 0.012, brass)
        ball("globe", (x, 2.86, 1.83), 0.075, opal, 4)
    # Bottles, a plant, a towel.
    amber, mint, clear = (glass("amber", (0.75, 0.3, 0.06)), glass("mint", (0.6, 0.9, 0.8), 0.1), glass("clear"))
    bottle = [(0, 0), (0.035, 0), (0.037, 0.01), (0.037, 0.12), (0.015, 0.145), (0.014, 0.17), (0, 0.17)]
    for x, y, mat, size in (
        (-0.98, 2.78, amber, 1.0),
        (-1.07, 2.66, mint, 0.8),
        (-0.9, 2.63, clear, 0.7),
        (0.08, 2.85, amber, 1.2),
    ):
        lathe("bottle", bottle, mat, (x, y, 0.84), 40, size)
        lathe("cap", "0 0.17, 0.018 0.17, 0.018 0.2, 0 0.2", brass, (x, y, 0.84), 24, size, finer=0)
    lathe(
        "pot",
        "0 0, 0.05 0, 0.065 0.09, 0.055 0.09, 0 0.07",
        plaster("terracotta", (0.5, 0.2, 0.11)),
        (0.13, 2.66, 0.84),
    )
    fern = Soup()
    leaves(fern, rng, (0.13, 2.66, 1.02), 0.12, 80, 0.085)
    fern.build("fern", leaf_material("fern", ((0, (0.03, 0.13, 0.03)), (1, (0.15, 0.32, 0.06)))))
    terry = dress(
        "terry",
        lambda n: {
            "Base_Color": n.ramp(
                n.add("TexWave", bands_direction="Z", Vector=n.coords(), Scale=3.2).outputs[1],
                ((0.15, (0.7, 0.26, 0.14)), (0.2, (0.82, 0.78, 0.7))),
            ),
            "Roughness": 1.0,
            "Sheen_Weight": 0.4,
            "Normal": n.bump(n.noise(240, 2), 1.0, 0.01),
        },
    )
    sheet(
        "towel",
        50,
        24,
        lambda u, v: (-1.15 + 0.46 * u, 2.4 + 0.014 * math.sin(u * 24) * (1 - v), 0.3 + 0.36 * v),
        terry,
        thick=0.012,
    )
    # A bath on the right behind glass.
    tub = sheet("tub", 48, 16, lambda u, v: tub_point(u, v), porcelain, (0.98, 1.75, 0))
    smooth = tub.modifiers.new("finer", "SUBSURF")
    smooth.levels = smooth.render_levels = 1
    water = material("water", Base_Color=(0.75, 0.95, 0.95), Roughness=0.0, Transmission_Weight=1.0, IOR=1.33)
    sheet(
        "water",
        24,
        24,
        lambda u, v: (0.98 + 0.29 * (2 * u - 1), 1.75 + 0.66 * (2 * v - 1), 0.4 + 0.004 * math.sin(u * 17 + v * 11)),
        water,
    )
    tube(
        "filler",
        [(1.5, 1.75, 0.95), (1.4, 1.75, 0.97), (1.28, 1.75, 0.95), (1.27, 1.75, 0.85)],
        0.018,
        chrome,
        curved=True,
    )
    box("screen", (0.55, 2.55, 1.15), (0.012, 0.95, 2.0), glass("screen", (0.93, 0.99, 0.97)), 0.002)
    tube("screen edge", [(0.55, 2.07, 0.14), (0.55, 2.07, 2.15)], 0.01, brass)
    tube("riser", [(1.1, 2.97, 0.9), (1.1, 2.97, 2.2), (1.1, 2.6, 2.25)], 0.012, brass)
    lathe("rose", "0 0, 0.12 0, 0.12 0.012, 0.02 0.03, 0 0.03", brass, (1.1, 2.6, 2.2), 40, finer=0)
    rug = dress(
        "mat",
        lambda n: {"Base_Color": (0.55, 0.5, 0.42), "Roughness": 1.0, "Normal": n.bump(n.noise(70, 4), 1.0, 0.03)},
    )
    box("mat", (-0.42, 1.85, 0.015), (0.95, 0.6, 0.03), rug, 0.012, (0, 0, 0.05), 3)
    box("stool", (0.22, 1.35, 0.4), (0.3, 0.3, 0.03), oak, 0.008)
    for a in (-0.12, 0.12):
        for b in (-0.12, 0.12):
            tube("stool leg", [(0.22 + a, 1.35 + b, 0.39), (0.22 + a * 1.2, 1.35 + b * 1.2, 0)], 0.014, oak)
    box("folded", (0.22, 1.35, 0.455), (0.25, 0.24, 0.07), terry, 0.03, (0, 0, 0.2), 4)
    ball(
        "soap",
        (0.22, 1.32, 0.505),
        0.04,
        material(
            "soap",
            Base_Color=(0.8, 0.7, 0.5),
            Roughness=0.4,
            Subsurface_Weight=0.8,
            Subsurface_Radius=(0.03, 0.02, 0.01),
        ),
        3,
        0,
        (1.2, 0.8, 0.45),
    )
    lamp("sun", "SUN", (-6, -1, 5), 6.0, (1.0, 0.86, 0.7), 0.01, (0, 2.0, 0.4))
    portal("window", (-1.72, 1.55, 1.67), (1.05, 1.1), 48, (0.78, 0.88, 1.0), (3, 1.55, 1.67))
    lamp("panel", "AREA", (0.0, 1.2, 2.58), 28, (1.0, 0.9, 0.78), 0.9, (0, 1.2, 0))
    sky((0.8, 0.88, 1.0), (0.4, 0.55, 0.9), 3.0, (0.3, 0.3, 0.25))
    sky_is_backdrop()
    camera((0.3, -0.78, 1.45), (0.02, 2.6, 1.02), 21)


def tub_point(u: float, v: float) -> Vec:
    """A bath's surface: u around, v from the outer foot over the rim to the inner floor."""
    angle = math.tau * u
    if v < 0.5:
        t = v / 0.5
        grow, z = 0.72 + 0.28 * t**0.6, 0.56 * t
    else:
        t = (v - 0.5) / 0.5
        grow, z = 0.95 * (1 - t**5), 0.56 - 0.46 * math.sin(min(1.0, t * 1.3) * math.pi / 2)
    c, s = math.cos(angle), math.sin(angle)
    square = 1 / (abs(c) ** 3.2 + abs(s) ** 3.2) ** (1 / 3.2)
    return (0.4 * grow * square * c, 0.82 * grow * square * s, z + 0.02)


# ---------------------------------------------------------------- rendering

LIGHT_PASSES = tuple(
    f"use_pass_{kind}_{what}"
    for kind in ("diffuse", "glossy", "transmission")
    for what in ("direct", "indirect", "color")
) + ("use_pass_emit", "use_pass_environment")
EXTRA_PASSES = ("use_pass_ambient_occlusion", "use_pass_z", "use_pass_normal", "use_pass_position")
INDEX_PASSES = (
    "use_pass_mist",
    "use_pass_object_index",
    "use_pass_material_index",
    "use_pass_cryptomatte_object",
    "use_pass_cryptomatte_material",
)


@dataclass(frozen=True)
class Sample:
    """How one scene becomes files."""

    build: Callable[[], None]
    version: tuple[int, int]
    seed: int  # 4 spp; then 16 spp, reference a, reference b
    size: tuple[int, int] = (208, 156)
    depth: str = "16"
    codec: str = "ZIP"
    light_passes: bool = True
    extras: Sequence[str] = ()
    groups: Sequence[str] = field(default_factory=tuple)
    full_references: bool = False
    reference_spp: int = 512


SAMPLES: dict[str, Sample] = {
    "living_room": Sample(
        living_room,
        (4, 5),
        101,
        extras=("use_pass_z", "use_pass_normal", "use_pass_ambient_occlusion"),
        full_references=True,
    ),
    "still_life": Sample(still_life, (5, 0), 201, extras=("use_pass_z", "use_pass_normal"), full_references=True),
    "night_bar": Sample(night_bar, (4, 5), 301, (192, 144), groups=("bulbs", "lamps", "neon", "sky", "windows")),
    "house": Sample(house, (5, 0), 401, (224, 168), extras=("use_pass_z", *INDEX_PASSES)),
    "misty_hall": Sample(
        misty_hall, (5, 0), 501, codec="PIZ", extras=("use_pass_z", "use_pass_position"), reference_spp=768
    ),
    "bathroom": Sample(bathroom, (4, 5), 601, light_passes=False),
}


def prepare(sample: Sample) -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    noise.seed_set(1)
    sample.build()
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = sample.size
    scene.render.resolution_percentage = 100
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # 5.0 and later
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.exr_codec = sample.codec
    for index, obj in enumerate(sorted(bpy.data.objects, key=lambda o: o.name)):
        obj.pass_index = index + 1
    return scene


def choose_passes(scene: bpy.types.Scene, sample: Sample, reference: bool) -> None:
    """Turn on a noisy file's passes, or a reference's."""
    layer = scene.view_layers[0]
    light = sample.light_passes and (sample.full_references or not reference)
    for name in LIGHT_PASSES:
        setattr(layer, name, light)
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = light
    layer.cycles.denoising_store_passes = not reference
    for name in EXTRA_PASSES + INDEX_PASSES:
        setattr(layer, name, name in sample.extras and not reference)
    if sample.groups and not reference:
        for name in sample.groups:
            layer.lightgroups.add(name=name)
    scene.render.image_settings.color_depth = "16" if reference else sample.depth


def render(scene: bpy.types.Scene, path: Path, spp: int, seed: int) -> None:
    scene.cycles.samples, scene.cycles.seed = spp, seed
    scene.render.filepath = str(path)
    start = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    size = path.stat().st_size
    print(f"{path.name}: {spp} spp, seed {seed}, {size} bytes, {time.perf_counter() - start:.1f} s")


def make(name: str, sample: Sample, out: Path, preview: int) -> None:
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    scene = prepare(sample)
    choose_passes(scene, sample, reference=False)
    if preview:
        render(scene, folder / f"{name}_preview.exr", preview, sample.seed + 9)
        return
    render(scene, folder / f"{name}_4spp.exr", 4, sample.seed)
    render(scene, folder / f"{name}_16spp.exr", 16, sample.seed + 1)
    scene = prepare(sample)  # light groups cannot be switched off
    choose_passes(scene, sample, reference=True)
    render(scene, folder / f"{name}_ref_a.exr", sample.reference_spp, sample.seed + 2)
    render(scene, folder / f"{name}_ref_b.exr", sample.reference_spp, sample.seed + 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent)
    parser.add_argument("--preview", type=int, default=0, metavar="SPP")
    parser.add_argument("--any", action="store_true", help="ignore the sample's Blender version")
    options = parser.parse_args()
    for name in options.names or SAMPLES:
        sample = SAMPLES[name]
        if options.any or sample.version == bpy.app.version[:2]:
            make(name, sample, options.out, options.preview)


if __name__ == "__main__":
    main()
