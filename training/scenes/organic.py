# SPDX-License-Identifier: Apache-2.0
"""Modelled figures: portrait busts with skin, eyes and hair, animals, statues."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from training.scenes import clutter, lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit
from training.scenes.plants import hair_material, strands
from training.scenes.stilllife import cyclorama

#: (centre, radii) of an ellipsoid, in metres.
Lump = tuple[Sequence[float], Sequence[float]]


def melt(stage: Stage, lumps: Sequence[Lump], voxel: float, smooth: int) -> bpy.types.Object:
    """Return one smooth body made of overlapping ellipsoids, as a sculptor starts from clay."""
    bm = bmesh.new()
    for center, radii in lumps:
        matrix = Matrix.Translation(center) @ Matrix.Diagonal((*radii, 1.0))
        bmesh.ops.create_icosphere(bm, subdivisions=4, radius=1.0, matrix=matrix)
    obj = objects.add_mesh(stage, "body", objects.from_bmesh(bm, "body"))
    remesh = obj.modifiers.new("melt", "REMESH")
    remesh.mode, remesh.voxel_size, remesh.use_smooth_shade = "VOXEL", voxel, True
    soften = obj.modifiers.new("soften", "SMOOTH")
    soften.iterations, soften.factor = smooth, 0.5
    graph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.meshes.new_from_object(obj.evaluated_get(graph))
    obj.modifiers.clear()
    obj.data = mesh
    return obj


def chain(start: Vector, end: Vector, thick: float, thin: float, count: int = 5) -> list[Lump]:
    """Return lumps along a limb."""
    return [(start.lerp(end, k / (count - 1)), (thick + (thin - thick) * k / (count - 1),) * 3) for k in range(count)]


def head_lumps(rng: random.Random) -> list[Lump]:
    """Return a head that looks along -y, its chin near the origin, and its neck."""

    def vary(value: float) -> float:
        return value * rng.uniform(0.88, 1.14)

    nose, lips = vary(0.015), vary(0.024)
    lumps: list[Lump] = [
        ((0, 0.012, 0.135), (vary(0.075), 0.095, vary(0.088))),
        ((0, -0.028, 0.065), (vary(0.056), 0.064, 0.06)),
        ((0, -0.082, 0.018), (vary(0.022), 0.018, 0.017)),
        ((0, -0.096, 0.108), (0.011, nose, 0.026)),
        ((0, -0.108, 0.088), (0.013, nose, 0.012)),
        ((0, -0.09, 0.056), (lips, 0.013, vary(0.007))),
        ((0, -0.088, 0.045), (lips * 0.85, 0.013, vary(0.008))),
        ((0, 0.03, -0.03), (vary(0.055), 0.056, 0.1)),
    ]
    for side in (-1, 1):
        lumps += [
            ((side * 0.032, -0.078, 0.138), (0.03, 0.014, 0.01)),
            ((side * 0.042, -0.066, 0.086), (0.026, 0.022, vary(0.02))),
            ((side * 0.013, -0.1, 0.084), (0.008, 0.009, 0.008)),
            ((side * 0.076, 0.012, 0.105), (0.009, 0.018, vary(0.031))),
            ((side * 0.031, -0.077, 0.1225), (0.019, 0.013, 0.005)),
            ((side * 0.031, -0.076, 0.1015), (0.017, 0.012, 0.005)),
        ]
    return lumps


def skin_material(rng: random.Random) -> bpy.types.Material:
    """Return human skin: light that travels below the surface, blotches, pores and a sheen."""
    tone = rng.random() ** 1.3
    color = mat.mix_color((0.78, 0.5, 0.38), (0.12, 0.055, 0.03), tone)
    material = mat.skin(rng, color, 1.0)
    shader = mat.principled_of(material)
    shader.inputs["Subsurface Weight"].default_value = rng.uniform(0.5, 1.0)
    shader.inputs["Subsurface Radius"].default_value = (1.0, 0.35, 0.18)
    shader.inputs["Subsurface Scale"].default_value = log_uniform(rng, 0.002, 0.01)
    shader.inputs["Roughness"].default_value = rng.uniform(0.3, 0.55)
    red = mat.mix_color(color, (0.6, 0.12, 0.08), rng.uniform(0.05, 0.2))
    mat.texture_color(material, rng, (red, color, color), rng.uniform(15, 60), ("noise",))
    return mat.add_bump(material, rng, rng.uniform(300, 900), ("noise", "voronoi"))


def paint_lips(obj: bpy.types.Object, rng: random.Random) -> None:
    """Give the mouth a redder, glossier material."""
    color = mat.mix_color((0.5, 0.12, 0.1), mat.random_color(rng, 1.0), rng.choice((0.0, 0.1, 0.5)))
    obj.data.materials.append(mat.skin(rng, color, 0.03))
    for face in obj.data.polygons:
        x, y, z = face.center
        if abs(x) < 0.026 - 1.2 * abs(z - 0.0505) and y < -0.088 and abs(z - 0.0505) < 0.011:
            face.material_index = 1


def eyes(stage: Stage) -> None:
    """Put in eyeballs: white, iris and pupil by angle, under a wet surface."""
    rng = stage.rng
    iris = mat.random_color(rng, 1.2, 0.5)
    wet = mat.new_material("eye", Roughness=0.05, Coat_Weight=1.0, Coat_Roughness=0.0)
    tree, shader = wet.node_tree, mat.principled_of(wet)
    source = tree.nodes.new("ShaderNodeTexCoord")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    tree.links.new(source.outputs["Generated"], split.inputs["Vector"])
    tree.links.new(split.outputs["Y"], ramp.inputs["Fac"])
    ramp.color_ramp.interpolation = "CONSTANT"
    stops = ((0.0, (0.01, 0.01, 0.01)), (0.03, iris), (0.13, (0.75, 0.71, 0.68)))
    ramp.color_ramp.elements.new(0.5)
    for element, (position, color) in zip(ramp.color_ramp.elements, stops, strict=True):
        element.position, element.color = position, mat.rgba(color)
    tree.links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    for side in (-1, 1):
        ball = objects.add_mesh(stage, "eyeball", objects.sphere_mesh(0.0135, 4), wet)
        objects.place(ball, side * 0.031, -0.0755, 0.112, rng.gauss(0, 0.08))


def hair(stage: Stage, head: bpy.types.Object) -> None:
    """Grow hair on the scalp: cropped, tousled or long."""
    rng = stage.rng
    count = len(head.data.vertices)
    where, normal = np.empty(count * 3, np.float32), np.empty(count * 3, np.float32)
    head.data.vertices.foreach_get("co", where)
    head.data.vertices.foreach_get("normal", normal)
    where, normal = where.reshape(-1, 3), normal.reshape(-1, 3)
    # From the forehead back and down to the nape; faces look along -y.
    scalp = np.flatnonzero(where[:, 2] > np.clip(0.19 - 1.1 * (where[:, 1] + 0.075), 0.07, 0.2))
    if len(scalp) == 0:
        return
    noise = np.random.default_rng(rng.getrandbits(32))
    pick = noise.choice(scalp, rng.randint(7000, 22000))
    long = rng.choice((0.008, 0.03, 0.06, 0.2))
    roots = where[pick] + noise.normal(0, 0.0015, (len(pick), 3))
    comb = normal[pick] + np.array((rng.gauss(0, 0.4), 0.6, 0.15 if long < 0.1 else -0.2))
    strands(stage, roots, comb, long, rng.uniform(0.0002, 0.0006), hair_material(rng), rng.uniform(0.15, 0.5), 7)


def bust(stage: Stage) -> None:
    """Build a person from the chest up."""
    rng = stage.rng
    head = melt(stage, head_lumps(rng), 0.0045, 4)
    head.data.materials.append(skin_material(rng))
    paint_lips(head, rng)
    eyes(stage)
    if stage.chance(0.85):
        hair(stage, head)
    wide = rng.uniform(0.17, 0.23)
    chest: list[Lump] = [((0, 0.045, -0.2), (wide, 0.1, 0.085)), ((0, 0.03, -0.33), (wide * 0.85, 0.12, 0.16))]
    chest += [((side * wide * 0.9, 0.045, -0.26), (0.065, 0.07, 0.11)) for side in (-1, 1)]
    chest += [((0, 0.036, -0.105), (0.068, 0.068, 0.035))]
    shirt = melt(stage, chest, 0.012, 5)
    shirt.data.materials.append(mat.cloth(rng) if stage.chance(0.8) else mat.plastic(rng))


@family("portrait")
def portrait(stage: Stage) -> ShotMaker:
    """A head and shoulders before a backdrop or blurred surroundings, lit as portraits are."""
    rng = stage.rng
    bust(stage)
    center = Vector((0, -0.02, 0.07))
    if stage.chance(0.6):
        paper = mat.diffuse(rng, mat.mix_color(mat.random_color(rng, 0.5), (0.3, 0.3, 0.3), 0.5))
        cyclorama(stage, paper, 0.9)
        for obj in stage.scene.objects:
            if obj.name.startswith("backdrop"):
                obj.location.z = -0.5
        lights.gradient_world(stage, log_uniform(rng, 0.02, 0.3))
        lights.softboxes(stage, center, 1.0, rng.randint(1, 3), 20)
        if stage.chance(0.5):
            rim = (rng.choice((-1, 1)) * 0.6, 0.8, 0.5)
            lights.lamp(stage, "AREA", rim, 25, center, size=rng.uniform(0.1, 0.5))
    else:
        lights.hdri_world(stage)
        if stage.chance(0.5):
            lights.softboxes(stage, center, 1.0, 1, 15)
    return orbit(center, (0.55, 1.1), (-5, 25), (50, 100), (215, 325), 0.05, 0.5)


def animal_lumps(rng: random.Random) -> list[Lump]:
    """Return a four-legged animal standing on the ground, its head towards -y, about half a metre long."""
    long, girth, leg = rng.uniform(0.18, 0.32), rng.uniform(0.05, 0.11), rng.uniform(0.08, 0.28)
    back = leg + girth * 0.8
    lumps = chain(Vector((0, -long, back)), Vector((0, long, back)), girth, girth * rng.uniform(0.7, 1.2), 6)
    for y in (-0.85, 0.85):
        for side in (-1, 1):
            foot = Vector((side * girth * 0.75, y * long + rng.gauss(0, 0.02), 0.018))
            lumps += chain(Vector((side * girth * 0.5, y * long, back)), foot, girth * 0.5, 0.018, 7)
    head = rng.uniform(0.05, 0.1)
    skull = Vector((0, -long - rng.uniform(0.03, 0.12) - head, back + rng.uniform(0.02, 0.25)))
    lumps += chain(Vector((0, -long * 0.9, back)), skull, girth * 0.8, head * 0.7)
    lumps += [(skull, (head * 0.85, head, head * 0.85))]
    lumps += chain(skull, skull + Vector((0, -head * rng.uniform(1.1, 2.0), -head * 0.4)), head * 0.6, head * 0.35)
    ear = head * rng.uniform(0.4, 1.6)
    for side in (-1, 1):
        lumps.append((skull + Vector((side * head * 0.6, 0.2 * head, 0.6 * head + ear * 0.5)), (0.012, 0.02, ear)))
    tip = Vector((rng.gauss(0, 0.08), long + rng.uniform(0.05, 0.25), back + rng.uniform(-0.1, 0.2)))
    return lumps + chain(Vector((0, long, back)), tip, 0.025, 0.012, 8)


@family("figures")
def figures(stage: Stage) -> ShotMaker:
    """Animals and busts of clay, marble, bronze, wax or fur, on a floor or a plinth."""
    rng = stage.rng
    objects.plane(stage, 30, mat.pick(rng, mat.DULL))
    looks = (mat.stone, mat.metal, mat.skin, mat.plastic, mat.wood, mat.diffuse, mat.glass, mat.tiles)
    count = rng.randint(1, 4)
    for index in range(count):
        is_bust = stage.chance(0.3)
        body = melt(stage, head_lumps(rng) if is_bust else animal_lumps(rng), 0.006, 4)
        body.data.materials.append(rng.choice(looks)(rng))
        angle, far = index * 2.1 + rng.uniform(-0.3, 0.3), 0.45 * (count > 1)
        objects.place(body, far * math.cos(angle), far * math.sin(angle), 0, rng.gauss(0, 0.6))
        tall = rng.choice((0.0, 0.0, 0.15, 0.4)) if not is_bust else rng.uniform(0.15, 0.4)
        if tall:
            x, y = body.location.xy
            low, high = (x - 0.16, y - 0.28, 0), (x + 0.16, y + 0.28, tall)
            objects.box(stage, low, high, rng.choice((mat.stone, mat.wood, mat.diffuse))(rng), 0.004)
        objects.rest(body, tall)
        if not is_bust and stage.chance(0.35):
            fur(stage, body)
    for _ in range(rng.randint(0, 6)):
        clutter.on_top(stage, rng.gauss(0, 0.6), rng.gauss(0, 0.6), 0.0)
    if stage.chance(0.6):
        lights.random_world(stage)
    else:
        lights.gradient_world(stage, log_uniform(rng, 0.02, 0.3))
        lights.softboxes(stage, Vector((0, 0, 0.3)), 1.4, rng.randint(1, 4), 30)
    return orbit(Vector((0, 0, 0.25)), (0.8, 1.8), (2, 35), (35, 85), spread=0.15, blur=0.3)


def fur(stage: Stage, body: bpy.types.Object) -> None:
    """Cover a body with hair."""
    rng = stage.rng
    bpy.context.view_layer.update()
    count = len(body.data.vertices)
    where, normal = np.empty(count * 3, np.float32), np.empty(count * 3, np.float32)
    body.data.vertices.foreach_get("co", where)
    body.data.vertices.foreach_get("normal", normal)
    noise = np.random.default_rng(rng.getrandbits(32))
    pick = noise.integers(0, count, rng.randint(12000, 30000))
    turn = np.array(body.matrix_world.to_3x3())
    roots = where.reshape(-1, 3)[pick] @ turn.T + np.array(body.matrix_world.translation)
    comb = normal.reshape(-1, 3)[pick] @ turn.T + np.array((0.0, 0.5, -0.2))
    roots = roots + noise.normal(0, 0.002, roots.shape)
    thin = log_uniform(rng, 0.0004, 0.0012)
    strands(stage, roots, comb, log_uniform(rng, 0.01, 0.06), thin, hair_material(rng), 0.3)
