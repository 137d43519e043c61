# SPDX-License-Identifier: Apache-2.0
"""Small things that lived-in places are full of: books, prints, plants in pots, fruit, curtains."""

from __future__ import annotations

import math
import random

import bpy
from mathutils import Matrix, Vector, noise

from training.assets import Furniture
from training.scenes import materials as mat
from training.scenes import objects, textures
from training.scenes.core import Stage, log_uniform

SMALL = ("Kitchen", "Bedroom", "Miscellaneous", "Office", "Living room", "Bathroom")


def _small(item: Furniture) -> bool:
    return max(item.size) < 0.5 and item.size[2] > 0.05 and not item.opening


def cover(stage: Stage) -> bpy.types.Material:
    """Return the cover of a book: cloth, card or a picture."""
    rng = stage.rng
    return textures.picture_material(stage) if stage.chance(0.4) else rng.choice((mat.cloth, mat.plastic))(rng)


def book(stage: Stage, size: tuple[float, float, float], outside: bpy.types.Material) -> bpy.types.Object:
    """Return a closed book lying on the origin: width, depth, thickness in metres."""
    rng = stage.rng
    w, d, h = size
    body = objects.box(stage, (-w / 2, -d / 2, 0), (w / 2, d / 2, h), outside)
    pages = objects.box(stage, (-w / 2 + 0.004, -d / 2 - 0.0005, 0.002), (w / 2 + 0.0005, d / 2 - 0.004, h - 0.002))
    pages.data.materials.append(mat.new_material("paper", Base_Color=(0.8, 0.76, 0.66, 1), Roughness=0.9))
    pages.parent = body
    body.rotation_euler.z = rng.uniform(-3, 3)
    return body


def book_stack(stage: Stage, count: int) -> list[bpy.types.Object]:
    """Return books piled up on the origin, the lowest first."""
    rng, stack, z = stage.rng, [], 0.0
    for _ in range(count):
        size = (rng.uniform(0.11, 0.2), rng.uniform(0.17, 0.28), rng.uniform(0.012, 0.05))
        item = book(stage, size, cover(stage))
        item.location = (rng.gauss(0, 0.008), rng.gauss(0, 0.008), z)
        item.rotation_euler.z = rng.gauss(0, 0.25)
        z += size[2] + 0.0005
        stack.append(item)
    return stack


def leafy_mesh(rng: random.Random, height: float, blades: int) -> bpy.types.Mesh:
    """Return bent blades that fan out from the origin, as house plants have them."""
    verts, faces, steps = [], [], 7
    wide, droop = height * rng.uniform(0.05, 0.2), rng.uniform(0.3, 1.6)
    for _ in range(blades):
        turn = Matrix.Rotation(rng.uniform(0, 2 * math.pi), 4, "Z")
        lean, long = rng.uniform(0.1, 0.9), height * rng.uniform(0.5, 1.1)
        first = len(verts)
        for k in range(steps + 1):
            t = k / steps
            half = wide * math.sin(math.pi * min(0.97, 0.1 + 0.9 * t)) ** 0.8
            out, up = long * lean * t, long * (t - 0.35 * droop * t * t)
            verts += [turn @ Vector((out, side * half, up + 0.3 * half)) for side in (-1, 1)]
        faces += [(first + 2 * k, first + 2 * k + 1, first + 2 * k + 3, first + 2 * k + 2) for k in range(steps)]
    mesh = bpy.data.meshes.new("blades")
    mesh.from_pydata(verts, [], faces)
    mesh.shade_smooth()
    return mesh


def potted_plant(stage: Stage, x: float, y: float, z: float, height: float) -> None:
    """Stand a house plant in a pot."""
    rng = stage.rng
    r = height * rng.uniform(0.13, 0.22)
    tall = r * rng.uniform(1.2, 2.2)
    pot = objects.lathe_mesh(
        [(0, 0), (r * 0.75, 0), (r, tall), (r * 0.92, tall), (r * 0.88, tall * 0.85), (0, tall * 0.85)]
    )
    shell = rng.choice((mat.plastic, mat.stone, mat.metal, mat.tiles))(rng)
    objects.add_mesh(stage, "pot", pot, shell, (x, y, z))
    soil = mat.stone(rng, (0.06, 0.04, 0.03))
    objects.add_mesh(stage, "soil", objects.cylinder_mesh(r * 0.88, 0.01), soil, (x, y, z + tall * 0.85))
    plant = leafy_mesh(rng, height, rng.randint(12, 60))
    objects.add_mesh(stage, "plant", plant, mat.leaf(rng), (x, y, z + tall * 0.8))


def fruit_bowl(stage: Stage, x: float, y: float, z: float) -> None:
    """Set down a bowl with fruit in it."""
    rng = stage.rng
    r = rng.uniform(0.09, 0.16)
    profile = [(0, 0), (r * 0.4, 0), (r, r * 0.5), (r * 0.96, r * 0.5), (r * 0.4, 0.012), (0, 0.012)]
    shell = rng.choice((mat.wood, mat.glass, mat.plastic, mat.metal))(rng)
    objects.add_mesh(stage, "bowl", objects.lathe_mesh(profile), shell, (x, y, z + 5e-4))
    color = mat.random_color(rng, 1.2, 0.9)
    skin = mat.skin(rng, color, 0.05)
    for k in range(rng.randint(3, 8)):
        size = rng.uniform(0.03, 0.045)
        fruit = objects.blob_mesh(rng, size, 3) if stage.chance(0.3) else objects.sphere_mesh(size, 3)
        a, off = k * 2.4, r * 0.45 * (k > 0)
        spot = (x + off * math.cos(a), y + off * math.sin(a), z + size + 0.02 + 0.03 * (k > 4))
        objects.add_mesh(stage, "fruit", fruit, skin, spot)


def labelled_bottle(stage: Stage, x: float, y: float, z: float) -> None:
    """Stand a bottle, can or jar with a printed label round it."""
    rng = stage.rng
    r, tall = rng.uniform(0.025, 0.05), rng.uniform(0.1, 0.3)
    neck = r * rng.choice((1.0, 0.8, 0.35))
    profile = [(0, 0), (r, 0), (r, tall * 0.65), (neck, tall * 0.85), (neck, tall), (0, tall)]
    body = rng.choice((mat.glass, mat.plastic, mat.metal))(rng)
    objects.add_mesh(stage, "bottle", objects.lathe_mesh(profile), body, (x, y, z + 5e-4))
    band = objects.lathe_mesh([(r + 5e-4, tall * 0.12), (r + 5e-4, tall * rng.uniform(0.35, 0.6))])
    objects.add_mesh(stage, "label", band, textures.picture_material(stage), (x, y, z))


def on_top(stage: Stage, x: float, y: float, z: float) -> None:
    """Put some small thing down at a point of a table, shelf or floor."""
    rng = stage.rng
    kind = rng.choice(("vessel", "model", "model", "books", "print", "plant", "fruit", "bottle"))
    if kind == "vessel":
        material = rng.choice((mat.glass, mat.plastic, mat.metal, mat.skin))(rng)
        thing = objects.add_mesh(stage, "vessel", objects.vessel_mesh(rng, rng.uniform(0.08, 0.3)), material)
        objects.place(thing, x, y, z + 1e-3, rng.uniform(-3, 3))
    elif kind == "model":
        model = objects.choose(stage, SMALL, _small)
        thing = objects.load(stage, model) if model else None
        if thing:
            objects.place(thing, x, y, z + 1e-3, rng.uniform(-3, 3))
    elif kind == "books":
        turn = rng.uniform(-3, 3)
        for item in book_stack(stage, rng.randint(1, 5)):
            item.location += Vector((x, y, z + 1e-3))
            item.rotation_euler.z += turn
    elif kind == "print":
        sheet = objects.box(stage, (-0.105, -0.148, 0), (0.105, 0.148, 8e-4), textures.picture_material(stage))
        objects.place(sheet, x, y, z + rng.uniform(5e-4, 2e-3), rng.uniform(-3, 3))
    elif kind == "plant":
        potted_plant(stage, x, y, z + 1e-3, rng.uniform(0.15, 0.4))
    elif kind == "fruit":
        fruit_bowl(stage, x, y, z)
    else:
        labelled_bottle(stage, x, y, z)


def curtain_mesh(rng: random.Random, width: float, height: float, folds: float) -> bpy.types.Mesh:
    """Return a hanging curtain, its upper edge centred on the origin, in the x-z plane."""
    columns, rows = 120, 14
    deep = rng.uniform(0.015, 0.05)
    offset = Vector([rng.uniform(-99, 99) for _ in range(3)])
    verts = []
    for j in range(rows + 1):
        v = j / rows
        for i in range(columns + 1):
            u = i / columns
            wobble = noise.noise(Vector((u * 4, v, 0)) + offset)
            wave = math.sin(2 * math.pi * folds * (u + 0.04 * wobble)) * deep * (0.5 + 0.5 * v)
            verts.append(((u - 0.5) * width, wave + 0.02 * wobble, -v * height))
    row = columns + 1
    faces = [
        (j * row + i, j * row + i + 1, (j + 1) * row + i + 1, (j + 1) * row + i)
        for j in range(rows)
        for i in range(columns)
    ]
    mesh = bpy.data.meshes.new("curtain")
    mesh.from_pydata(verts, [], faces)
    mesh.shade_smooth()
    return mesh


def curtain_cloth(stage: Stage) -> bpy.types.Material:
    """Return cloth that lets some light through, net curtains and all."""
    rng = stage.rng
    if stage.chance(0.4):
        return mat.cloth(rng)
    material = mat.leaf(rng)
    color = mat.mix_color(mat.random_color(rng, 0.5), (0.85, 0.83, 0.78), 0.6)
    mat.principled_of(material).inputs["Base Color"].default_value = mat.rgba(color)
    through = next(n for n in material.node_tree.nodes if n.type == "BSDF_TRANSLUCENT")
    through.inputs["Color"].default_value = mat.rgba(color)
    return material


def scatter(stage: Stage, spots: list[tuple[float, float, float]], share: float) -> None:
    """Put small things on a share of the given spots."""
    for x, y, z in spots:
        if stage.chance(share):
            on_top(stage, x, y, z)


Spot = tuple[float, float, float]


def shelf_unit(stage: Stage, width: float, height: float, depth: float, levels: int) -> list[Spot]:
    """Build open shelves standing on the origin, their back at y = 0; return spots to put things on."""
    rng = stage.rng
    board = rng.choice((mat.wood, mat.plastic, mat.metal))(rng)
    thick, spots = rng.uniform(0.015, 0.035), []
    for x in (-width / 2, width / 2 - thick):
        objects.box(stage, (x, -depth, 0), (x + thick, 0, height), board)
    if stage.chance(0.5):
        objects.box(stage, (-width / 2, -0.005, 0), (width / 2, 0, height), board)
    step = log_uniform(rng, 0.1, 0.22)
    for level in range(levels + 1):
        z = level * (height - thick) / levels
        objects.box(stage, (-width / 2, -depth, z), (width / 2, 0, z + thick), board)
        x = -width / 2 + step / 2
        while x < width / 2 - step / 2:
            spots.append((x, -depth * rng.uniform(0.35, 0.65), z + thick))
            x += step
    return spots
