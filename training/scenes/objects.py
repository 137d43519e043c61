# SPDX-License-Identifier: Apache-2.0
"""Geometry helpers: primitives, boxes, lathed vessels and imported furniture."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

import bmesh
import bpy
from mathutils import Matrix, Vector, noise

from training import assets
from training.paths import asset_root
from training.scenes import materials as mat
from training.scenes.core import Stage


def add_mesh(
    stage: Stage,
    name: str,
    mesh: bpy.types.Mesh,
    material: bpy.types.Material | None = None,
    location: Sequence[float] = (0, 0, 0),
) -> bpy.types.Object:
    """Put a mesh into the scene."""
    obj = bpy.data.objects.new(name, mesh)
    stage.scene.collection.objects.link(obj)
    obj.location = location
    if material:
        mesh.materials.clear()
        mesh.materials.append(material)
    return obj


def from_bmesh(bm: bmesh.types.BMesh, name: str, smooth: bool = False) -> bpy.types.Mesh:
    """Finish a bmesh into a mesh."""
    mesh = bpy.data.meshes.new(name)
    bm.to_mesh(mesh)
    bm.free()
    if smooth:
        mesh.shade_smooth()
    return mesh


def box(
    stage: Stage,
    low: Sequence[float],
    high: Sequence[float],
    material: bpy.types.Material | None = None,
    bevel: float = 0.0,
) -> bpy.types.Object:
    """Add an axis-aligned box between two corners, its origin at the world's."""
    bm = bmesh.new()
    bmesh.ops.create_cube(bm, size=1.0)
    low, high = Vector(low), Vector(high)
    size, center = high - low, (high + low) / 2
    bmesh.ops.scale(bm, vec=size, verts=bm.verts)
    if bevel:
        bmesh.ops.bevel(bm, geom=bm.edges[:], offset=bevel, segments=2, affect="EDGES", profile=0.7)
    bmesh.ops.translate(bm, vec=center, verts=bm.verts)
    return add_mesh(stage, "box", from_bmesh(bm, "box"), material)


def plane(stage: Stage, size: float, material: bpy.types.Material, z: float = 0.0) -> bpy.types.Object:
    """Add a square ground."""
    bm = bmesh.new()
    bmesh.ops.create_grid(bm, x_segments=1, y_segments=1, size=size / 2)
    return add_mesh(stage, "plane", from_bmesh(bm, "plane"), material, (0, 0, z))


def sphere_mesh(radius: float, detail: int = 4) -> bpy.types.Mesh:
    """Return a smooth ball."""
    bm = bmesh.new()
    bmesh.ops.create_icosphere(bm, subdivisions=detail, radius=radius)
    return from_bmesh(bm, "ball", smooth=True)


def cylinder_mesh(radius: float, height: float, sides: int = 48, top: float | None = None) -> bpy.types.Mesh:
    """Return a closed cylinder or cone standing on the origin."""
    bm = bmesh.new()
    bmesh.ops.create_cone(
        bm,
        cap_ends=True,
        segments=sides,
        radius1=radius,
        radius2=radius if top is None else top,
        depth=height,
    )
    bmesh.ops.translate(bm, vec=(0, 0, height / 2), verts=bm.verts)
    mesh = from_bmesh(bm, "cylinder", smooth=True)
    mesh.set_sharp_from_angle(angle=math.radians(40))
    return mesh


def torus_mesh(major: float, minor: float, segments: int = 64, sides: int = 24) -> bpy.types.Mesh:
    """Return a ring lying flat."""
    bm = bmesh.new()
    rings = []
    for i in range(segments):
        a = 2 * math.pi * i / segments
        ring = []
        for j in range(sides):
            b = 2 * math.pi * j / sides
            r = major + minor * math.cos(b)
            ring.append(bm.verts.new((r * math.cos(a), r * math.sin(a), minor * math.sin(b))))
        rings.append(ring)
    for i in range(segments):
        for j in range(sides):
            n, m = (i + 1) % segments, (j + 1) % sides
            bm.faces.new((rings[i][j], rings[n][j], rings[n][m], rings[i][m]))
    return from_bmesh(bm, "ring", smooth=True)


def lathe_mesh(profile: Sequence[tuple[float, float]], segments: int = 64) -> bpy.types.Mesh:
    """Return a turned body; the profile is (radius, height) from bottom to top."""
    bm = bmesh.new()
    rings = []
    for radius, height in profile:
        if radius < 1e-5:
            rings.append([bm.verts.new((0, 0, height))])
            continue
        ring = []
        for i in range(segments):
            a = 2 * math.pi * i / segments
            ring.append(bm.verts.new((radius * math.cos(a), radius * math.sin(a), height)))
        rings.append(ring)
    for below, above in zip(rings, rings[1:], strict=False):
        for i in range(segments):
            n = (i + 1) % segments
            if len(below) == 1 and len(above) > 1:
                bm.faces.new((below[0], above[n], above[i]))
            elif len(above) == 1 and len(below) > 1:
                bm.faces.new((below[i], below[n], above[0]))
            elif len(below) > 1:
                bm.faces.new((below[i], below[n], above[n], above[i]))
    bmesh.ops.recalc_face_normals(bm, faces=bm.faces)
    mesh = from_bmesh(bm, "lathe", smooth=True)
    mesh.set_sharp_from_angle(angle=math.radians(50))
    return mesh


def smooth_curve(points: Sequence[tuple[float, float]], steps: int = 8) -> list[tuple[float, float]]:
    """Return a Catmull-Rom curve through 2-D points."""
    ends = [points[0], *points, points[-1]]
    out = []
    for p0, p1, p2, p3 in zip(ends, ends[1:], ends[2:], ends[3:], strict=False):
        for k in range(steps):
            t = k / steps
            out.append(
                tuple(
                    0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
                    for a, b, c, d in zip(p0, p1, p2, p3, strict=True)
                )
            )
    return [(max(0.0, r), h) for r, h in [*out, points[-1]]]


def vessel_mesh(rng: random.Random, height: float, wall: float | None = None) -> bpy.types.Mesh:
    """Return a vase, bowl, bottle, cup or drinking glass with real wall thickness."""
    kind = rng.choice(("vase", "bottle", "bowl", "tumbler", "goblet"))
    h = height
    if kind == "vase":
        w = h * rng.uniform(0.2, 0.4)
        outer = [
            (w * rng.uniform(0.4, 0.8), 0),
            (w * rng.uniform(0.7, 1.2), h * 0.35),
            (w * rng.uniform(0.4, 1.1), h * 0.7),
            (w * rng.uniform(0.3, 0.9), h),
        ]
    elif kind == "bottle":
        w = h * rng.uniform(0.13, 0.2)
        neck = w * rng.uniform(0.28, 0.45)
        outer = [(w * 0.95, 0), (w, h * 0.05), (w, h * 0.55), (neck, h * 0.78), (neck, h)]
    elif kind == "bowl":
        w = h * rng.uniform(0.8, 1.6)
        outer = [(w * 0.35, 0), (w * 0.7, h * 0.3), (w * 0.95, h * 0.7), (w, h)]
    elif kind == "tumbler":
        w = h * rng.uniform(0.28, 0.45)
        outer = [(w * 0.85, 0), (w * 0.9, h * 0.4), (w, h)]
    else:
        w = h * rng.uniform(0.22, 0.32)
        outer = [
            (w * 0.9, 0),
            (w * 0.8, h * 0.02),
            (w * 0.12, h * 0.08),
            (w * 0.1, h * 0.42),
            (w * 0.85, h * 0.6),
            (w, h * 0.78),
            (w * 0.75, h),
        ]
    body = smooth_curve(outer) if kind != "bottle" else smooth_curve(outer, 6)
    thick = wall or h * rng.uniform(0.012, 0.04)
    floor = h * 0.45 if kind == "goblet" else thick * 1.5
    inner = [(max(1e-3, r - thick), z) for r, z in reversed(body) if z > floor and r > thick * 1.2]
    return lathe_mesh([(0, 0), *body, *inner, (0, floor)])


def blob_mesh(rng: random.Random, radius: float, detail: int = 5) -> bpy.types.Mesh:
    """Return a lumpy ball: a pebble, fruit or sculpture."""
    bm = bmesh.new()
    bmesh.ops.create_icosphere(bm, subdivisions=detail, radius=1.0)
    offset = Vector([rng.uniform(-99, 99) for _ in range(3)])
    scale, depth = rng.uniform(0.5, 2.0), rng.uniform(0.1, 0.6)
    for vert in bm.verts:
        vert.co *= radius * (1 + depth * noise.noise(vert.co * scale + offset))
    return from_bmesh(bm, "blob", smooth=True)


def primitive_mesh(rng: random.Random, size: float) -> bpy.types.Mesh:
    """Return one of many simple shapes, about `size` across, centred near the origin."""
    kind = rng.choice(("box", "box", "ball", "ball", "cylinder", "cone", "ring", "monkey", "blob", "vessel", "poly"))
    bm = bmesh.new()
    half = size / 2
    if kind == "box":
        bmesh.ops.create_cube(bm, size=1.0)
        bmesh.ops.scale(bm, vec=[size * rng.uniform(0.4, 1.2) for _ in range(3)], verts=bm.verts)
        if rng.random() < 0.6:
            bmesh.ops.bevel(
                bm,
                geom=bm.edges[:],
                offset=size * rng.uniform(0.01, 0.1),
                segments=3,
                affect="EDGES",
                profile=0.5,
            )
        mesh = from_bmesh(bm, kind)
        mesh.set_sharp_from_angle(angle=math.radians(35))
        return mesh
    if kind == "monkey":
        bmesh.ops.create_monkey(bm)
        bmesh.ops.scale(bm, vec=(half, half, half), verts=bm.verts)
        bmesh.ops.subdivide_edges(bm, edges=bm.edges, cuts=1, smooth=1.0, use_grid_fill=True)
        return from_bmesh(bm, kind, smooth=True)
    if kind == "poly":
        bmesh.ops.create_icosphere(bm, subdivisions=rng.choice((1, 1, 2)), radius=half)
        return from_bmesh(bm, kind)
    bm.free()
    if kind == "ball":
        return sphere_mesh(half)
    if kind == "cylinder":
        return cylinder_mesh(half * rng.uniform(0.2, 1), size, rng.choice((6, 8, 48)))
    if kind == "cone":
        return cylinder_mesh(half, size, 48, half * rng.choice((0.0, 0.5)))
    if kind == "ring":
        return torus_mesh(half * 0.7, half * rng.uniform(0.08, 0.3))
    if kind == "blob":
        return blob_mesh(rng, half, 4)
    return vessel_mesh(rng, size)


def rest(obj: bpy.types.Object, z: float = 0.0) -> None:
    """Lower or raise an object until its lowest point lies just above height z.

    Not exactly at it: glass that touches the table makes the contact face black.
    """
    bpy.context.view_layer.update()
    lowest = min((obj.matrix_world @ Vector(corner)).z for corner in obj.bound_box)
    obj.location.z += z + 5e-4 - lowest


Filter = Callable[[assets.Furniture], bool]


def choose(stage: Stage, categories: Sequence[str], wanted: Filter | None = None) -> assets.Furniture | None:
    """Return a random model of the stage's split, None if the package is not there."""
    items = [
        item
        for item in assets.furniture()
        if item.split == stage.split and item.category in categories and (wanted is None or wanted(item))
    ]
    return stage.rng.choice(items) if items else None


def load(stage: Stage, item: assets.Furniture, restyle: float = 0.6) -> bpy.types.Object | None:
    """Import a model in metres, standing on the origin; None if Blender finds nothing in it."""
    before = set(bpy.data.objects)
    bpy.ops.wm.obj_import(filepath=str(asset_root() / item.path), use_split_objects=False, use_split_groups=False)
    new = [obj for obj in bpy.data.objects if obj not in before]
    meshes = [obj for obj in new if obj.type == "MESH" and obj.data.vertices]
    if len(meshes) != 1:
        for obj in new:
            bpy.data.objects.remove(obj)
        return None
    obj = meshes[0]
    obj.data.transform(obj.matrix_world)
    obj.matrix_world = Matrix.Identity(4)
    corners = [Vector(v.co) for v in obj.data.vertices]
    low = Vector([min(c[i] for c in corners) for i in range(3)])
    high = Vector([max(c[i] for c in corners) for i in range(3)])
    size = high - low
    scale = [wanted / max(have, 1e-6) for wanted, have in zip(item.size, size, strict=True)]
    center = Vector(((low.x + high.x) / 2, (low.y + high.y) / 2, low.z))
    obj.data.transform(Matrix.Diagonal((*scale, 1)) @ Matrix.Translation(-center))
    restyle_materials(stage, obj, restyle)
    return obj


def restyle_materials(stage: Stage, obj: bpy.types.Object, probability: float) -> None:
    """Replace plain imported materials: the models' own are all flat paint.

    Transparent parts become glass, since alpha without refraction looks like no glass at
    all; pictures stay most of the time.
    """
    rng = stage.rng
    for slot in obj.material_slots:
        old = slot.material
        if old is None or not old.use_nodes:
            slot.material = mat.pick(rng, mat.DULL)
            continue
        shader = next((n for n in old.node_tree.nodes if n.type == "BSDF_PRINCIPLED"), None)
        if shader is None:
            continue
        pictures = [n for n in old.node_tree.nodes if n.type == "TEX_IMAGE"]
        if any(n.image is None or n.image.size[0] == 0 for n in pictures):
            # Unreadable pictures would show up as plain magenta.
            slot.material = mat.pick(rng, mat.DULL)
            continue
        textured = bool(pictures)
        alpha = shader.inputs["Alpha"]
        draw = rng.random()
        color = tuple(shader.inputs["Base Color"].default_value)[:3]
        if not alpha.is_linked and alpha.default_value < 0.95 and not textured:
            thin = rng.random() < 0.5
            slot.material = mat.glass(rng, (1, 1, 1) if thin else None, False)
        elif textured:
            shader.inputs["Roughness"].default_value = rng.choice((0.15, 0.3, 0.5, 0.8, 1.0))
            shader.inputs["Specular IOR Level"].default_value = 0.5
        elif draw < probability:
            # A black or white part is usually meant to be so; others get any colour.
            keep = max(color) - min(color) < 0.1 and rng.random() < 0.6
            makers = [m for m, _ in mat.DULL]
            maker = rng.choices(makers, [w for _, w in mat.DULL])[0]
            slot.material = maker(rng, color) if keep and maker is not mat.wood else maker(rng)
        else:
            shader.inputs["Roughness"].default_value = rng.choice((0.1, 0.25, 0.5, 0.8))


def place(obj: bpy.types.Object, x: float, y: float, z: float = 0.0, turn: float = 0.0) -> None:
    """Stand an object somewhere, turned about the vertical axis."""
    obj.rotation_mode = "XYZ"
    obj.location = (x, y, z)
    obj.rotation_euler = (0, 0, turn)


def duplicate(stage: Stage, obj: bpy.types.Object) -> bpy.types.Object:
    """Add another object that shares the mesh: an instance for Cycles."""
    copy = bpy.data.objects.new(obj.name, obj.data)
    stage.scene.collection.objects.link(copy)
    return copy
