# SPDX-License-Identifier: Apache-2.0
"""Thin and small things: wires, fences, machine parts, lettering, cloth."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from pathlib import Path

import bmesh
import bpy
from mathutils import Vector, noise

from training.scenes import lights, objects
from training.scenes import materials as mat
from training.scenes.abstract import light_up
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit

FONTS = (Path("/usr/share/fonts/truetype/dejavu"), Path("/usr/share/fonts/truetype/liberation"))


def wire(
    stage: Stage,
    paths: Sequence[Sequence[Sequence[float]]],
    radius: float,
    material: bpy.types.Material,
) -> bpy.types.Object:
    """Add round wires along polylines."""
    data = bpy.data.curves.new("wire", "CURVE")
    data.dimensions = "3D"
    data.bevel_depth = radius
    data.bevel_resolution = 1
    data.materials.append(material)
    for path in paths:
        spline = data.splines.new("POLY")
        spline.points.add(len(path) - 1)
        for point, where in zip(spline.points, path, strict=True):
            point.co = (*where, 1.0)
    obj = bpy.data.objects.new("wire", data)
    stage.scene.collection.objects.link(obj)
    return obj


def fence_paths(rng: random.Random, width: float, height: float) -> list[list[tuple[float, float, float]]]:
    """Return the wires of a chain-link, bar or lattice fence in the x-z plane."""
    step = log_uniform(rng, 0.03, 0.15)
    kind = rng.choice(("chain", "bars", "grid", "lattice"))
    paths = []
    count = int(width / step)
    if kind in ("bars", "grid"):
        paths += [[(k * step - width / 2, 0, 0), (k * step - width / 2, 0, height)] for k in range(count)]
        rows = int(height / step) if kind == "grid" else 2
        for k in range(rows + 1):
            z = height * k / max(1, rows)
            paths.append([(-width / 2, 0, z), (width / 2, 0, z)])
        return paths
    for k in range(-int(height / step), count):
        for sign in (1, -1):
            points = []
            for t in range(int(height / step) + 1):
                x = (k + t) * step * sign - width / 2 * sign
                if abs(x) <= width / 2:
                    zig = 0.004 * (-1) ** t if kind == "chain" else 0
                    points.append((x, zig * sign, t * step))
            if len(points) > 1:
                paths.append(points)
    return paths


@family("fine_geometry")
def fine_geometry(stage: Stage) -> ShotMaker:
    """Fences, meshes, cables and strings in front of things, below a pixel in width."""
    rng = stage.rng
    objects.plane(stage, 40, mat.pick(rng, mat.DULL))
    for _ in range(rng.randint(3, 12)):
        mesh = objects.primitive_mesh(rng, log_uniform(rng, 0.2, 0.9))
        obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
        obj.location = (rng.gauss(0, 1.2), rng.gauss(0, 1.2), 0)
        objects.rest(obj)
    for _ in range(rng.randint(1, 3)):
        maker = rng.choice((mat.metal, mat.plastic, mat.diffuse))
        paths = fence_paths(rng, rng.uniform(2, 5), rng.uniform(0.8, 2))
        fence = wire(stage, paths, log_uniform(rng, 0.002, 0.012), maker(rng))
        objects.place(fence, rng.gauss(0, 0.8), rng.gauss(0, 1.0), 0, rng.uniform(-3, 3))
    for _ in range(rng.randint(0, 3)):
        paths = []
        for _ in range(rng.randint(3, 40)):
            a = Vector((rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(0.5, 2.5)))
            b = Vector((rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(0.5, 2.5)))
            sag = rng.uniform(0, 0.6)
            steps = [k / 12 for k in range(13)]
            paths.append([a.lerp(b, t) - Vector((0, 0, 4 * sag * t * (1 - t))) for t in steps])
        maker = rng.choice((mat.metal, mat.plastic, mat.diffuse))
        wire(stage, paths, log_uniform(rng, 0.001, 0.008), maker(rng))
    if stage.chance(0.3):
        cage = objects.add_mesh(stage, "cage", objects.sphere_mesh(rng.uniform(0.3, 0.7), 3), mat.metal(rng))
        cage.location = (rng.gauss(0, 0.5), rng.gauss(0, 0.5), 0.8)
        skeleton = cage.modifiers.new("wire", "WIREFRAME")
        skeleton.thickness = log_uniform(rng, 0.003, 0.02)
    light_up(stage, 1.2)
    return orbit(Vector((0, 0, 0.6)), (2, 5), (4, 45), (24, 85), spread=0.2)


def gear_mesh(rng: random.Random, radius: float, thick: float) -> bpy.types.Mesh:
    """Return a toothed wheel with a hole."""
    teeth = rng.randint(9, 36)
    outline = []
    for k in range(teeth):
        for part, r in ((0.0, 0.86), (0.2, 1.0), (0.45, 1.0), (0.65, 0.86)):
            a = 2 * math.pi * (k + part) / teeth
            outline.append((r * radius * math.cos(a), r * radius * math.sin(a)))
    hole = radius * rng.uniform(0.15, 0.5)
    bm = bmesh.new()
    rings = []
    for z, bore in ((0, False), (thick, False), (thick, True), (0, True)):
        ring = []
        for x, y in outline:
            f = hole / math.hypot(x, y) if bore else 1.0
            ring.append(bm.verts.new((x * f, y * f, z)))
        rings.append(ring)
    for a, b in zip(rings, rings[1:] + rings[:1], strict=True):
        for i in range(len(outline)):
            n = (i + 1) % len(outline)
            bm.faces.new((a[i], a[n], b[n], b[i]))
    return objects.from_bmesh(bm, "gear")


@family("metal_parts")
def metal_parts(stage: Stage) -> ShotMaker:
    """Gears, bolts, pipes and plates of brushed, polished and worn metal."""
    rng = stage.rng
    objects.plane(stage, 20, mat.pick(rng, mat.DULL) if stage.chance(0.6) else mat.metal(rng))
    palette = [mat.metal(rng) for _ in range(4)] + [mat.mirror(rng), mat.plastic(rng)]
    palette.append(mat.brush(mat.metal(rng, (0.6, 0.6, 0.62)), rng))
    for _ in range(rng.randint(8, 40)):
        size = log_uniform(rng, 0.03, 0.16)
        kind = rng.choice(("gear", "gear", "bolt", "pipe", "ring", "plate", "ball"))
        if kind == "gear":
            mesh = gear_mesh(rng, size, size * rng.uniform(0.1, 0.5))
        elif kind == "bolt":
            head, shaft = size * 0.3, size * 0.16
            mesh = objects.lathe_mesh(
                [(0, 0), (head, 0), (head, size * 0.2), (shaft, size * 0.2)]
                + [(shaft * (1 if k % 2 else 0.85), size * (0.2 + k * 0.04)) for k in range(24)]
                + [(0, size * 1.2)],
                rng.choice((6, 32)),
            )
        elif kind == "pipe":
            r = size * 0.3
            mesh = objects.lathe_mesh([(r * 0.85, 0), (r, 0), (r, size * 2), (r * 0.85, size * 2), (r * 0.85, 0)])
        elif kind == "ring":
            mesh = objects.torus_mesh(size * 0.5, size * rng.uniform(0.05, 0.2))
        elif kind == "plate":
            mesh = objects.cylinder_mesh(size, size * 0.06, rng.choice((4, 6, 64)))
        else:
            mesh = objects.sphere_mesh(size * 0.4)
        obj = objects.add_mesh(stage, "part", mesh, rng.choice(palette))
        tilt = (rng.choice((0, 0, math.pi / 2, 0.4)), rng.choice((0, 0, 0.3)), rng.uniform(-3, 3))
        obj.rotation_euler = tilt
        obj.location = (rng.gauss(0, 0.22), rng.gauss(0, 0.22), 0)
        objects.rest(obj, rng.choice((0, 0, 0, 0.05)))
    if stage.chance(0.6):
        lights.hdri_world(stage)
    else:
        lights.gradient_world(stage, rng.uniform(0.02, 0.3))
        lights.softboxes(stage, Vector((0, 0, 0)), 0.9, rng.randint(1, 4), 15)
    return orbit(Vector((0, 0, 0.03)), (0.45, 1.1), (8, 60), (35, 85), spread=0.2, blur=0.4)


WORDS = "QUELL LIGHT noise 2026 Ray & path SALE open 24h Blender Cycles pixel Hotel BAR cafe 73%".split()


def text(stage: Stage, body: str, size: float, depth: float) -> bpy.types.Object:
    """Return upright extruded lettering."""
    rng = stage.rng
    data = bpy.data.curves.new("text", "FONT")
    fonts = sorted(p for folder in FONTS for p in folder.glob("*.ttf"))
    if fonts and stage.chance(0.8):
        data.font = bpy.data.fonts.load(str(rng.choice(fonts)))
    data.body, data.size, data.extrude = body, size, depth
    data.bevel_depth = rng.choice((0.0, depth * 0.2))
    data.align_x = "CENTER"
    obj = bpy.data.objects.new("text", data)
    stage.scene.collection.objects.link(obj)
    obj.rotation_euler = (math.pi / 2, 0, rng.gauss(0, 0.15))
    return obj


@family("lettering")
def lettering(stage: Stage) -> ShotMaker:
    """Signs, logos and printed pages: crisp edges and fine print."""
    rng = stage.rng
    objects.plane(stage, 40, mat.pick(rng, mat.DULL))
    objects.box(stage, (-8, 1.2, 0), (8, 1.4, 5), mat.pick(rng, mat.DULL))
    glowing = stage.chance(0.35)
    z = 0.05
    for _ in range(rng.randint(1, 4)):
        size = rng.uniform(0.25, 0.7)
        body = " ".join(rng.sample(WORDS, rng.randint(1, 2)))
        obj = text(stage, body, size, rng.uniform(0.01, 0.12))
        obj.location = (rng.gauss(0, 0.3), rng.uniform(0, 1.1), z)
        if glowing and stage.chance(0.6):
            color = lights.random_light_color(rng)
            obj.data.materials.append(mat.glow(rng, log_uniform(rng, 2, 12), color))
        else:
            obj.data.materials.append(mat.pick(rng))
        z += size * 0.9
    if stage.chance(0.6):
        page = text(stage, "\n".join(" ".join(rng.choices(WORDS, k=9)) for _ in range(26)), 0.06, 0.0005)
        page.location, page.rotation_euler = (rng.gauss(0, 0.4), -0.6, 0.004), (0, 0, rng.gauss(0, 0.3))
        page.data.materials.append(mat.diffuse(rng, (0.03, 0.03, 0.04)))
    if glowing:
        lights.gradient_world(stage, rng.uniform(0.05, 0.5))
    else:
        light_up(stage, 1.0)
    return orbit(Vector((0, 0.3, 0.5)), (1.8, 4), (4, 35), (24, 85), (225, 315), 0.2, 0.3)


def drape_mesh(rng: random.Random, width: float, height: float) -> bpy.types.Mesh:
    """Return hanging or lying cloth with folds, in the x-z plane."""
    bm = bmesh.new()
    bmesh.ops.create_grid(bm, x_segments=160, y_segments=80, size=0.5)
    folds, deep = rng.uniform(4, 16), width * rng.uniform(0.02, 0.08)
    offset = Vector([rng.uniform(-99, 99) for _ in range(3)])
    for vert in bm.verts:
        u, v = vert.co.x + 0.5, vert.co.y + 0.5
        wobble = noise.noise(Vector((u * 3, v * 2, 0)) + offset)
        wave = math.sin(folds * 2 * math.pi * (u + 0.1 * wobble)) * (0.4 + 0.6 * (1 - v))
        vert.co = Vector(((u - 0.5) * width, deep * (wave + 2 * wobble), v * height))
    return objects.from_bmesh(bm, "drape", True)


@family("fabric")
def fabric(stage: Stage) -> ShotMaker:
    """Curtains, folded cloth and cushions: sheen, weave and light that shines through."""
    rng = stage.rng
    objects.plane(stage, 30, rng.choice((mat.wood, mat.cloth, mat.diffuse))(rng))
    for index in range(rng.randint(1, 4)):
        material = mat.cloth(rng) if stage.chance(0.7) else mat.leaf(rng)
        if material.name.startswith("leaf"):
            color = mat.random_color(rng, 0.5, 0.9)
            mat.principled_of(material).inputs["Base Color"].default_value = mat.rgba(color)
        mesh = drape_mesh(rng, rng.uniform(1, 3), rng.uniform(1.2, 2.5))
        obj = objects.add_mesh(stage, "drape", mesh, material)
        objects.place(obj, rng.gauss(0, 0.8), index * 0.5, 0.01, rng.gauss(0, 0.4))
    for _ in range(rng.randint(1, 6)):
        bm = bmesh.new()
        bmesh.ops.create_uvsphere(bm, u_segments=64, v_segments=32, radius=1.0)
        power = rng.uniform(2.5, 5)
        for vert in bm.verts:
            # A super-ellipse: a ball pulled out into the four corners of a cushion.
            r = max(abs(vert.co.x), abs(vert.co.y))
            if r < 1e-4:
                continue
            f = (abs(vert.co.x / r) ** power + abs(vert.co.y / r) ** power) ** (1 / power)
            stretch = Vector((vert.co.x, vert.co.y, 0)).length / (r * f)
            vert.co.x, vert.co.y = vert.co.x * stretch, vert.co.y * stretch
        mesh = objects.from_bmesh(bm, "cushion", True)
        obj = objects.add_mesh(stage, "cushion", mesh, mat.cloth(rng))
        size = rng.uniform(0.18, 0.35)
        obj.scale = (size, size, size * rng.uniform(0.3, 0.5))
        obj.rotation_euler = (rng.gauss(0, 0.4), rng.gauss(0, 0.4), rng.uniform(-3, 3))
        obj.location = (rng.gauss(0, 0.6), rng.uniform(-1.2, -0.2), 0)
        objects.rest(obj)
    if stage.chance(0.5):
        lights.random_world(stage)
    else:
        lights.gradient_world(stage, 0.1)
        lights.softboxes(stage, Vector((0, 0, 0.6)), 2.0, rng.randint(1, 3), 30)
        if stage.chance(0.5):
            lights.lamp(stage, "AREA", (0, 3.5, 1.5), 200, (0, 0, 1), size=1.5)
    return orbit(Vector((0, -0.1, 0.5)), (1.3, 3), (3, 40), (28, 85), (200, 340), 0.25, 0.2)
