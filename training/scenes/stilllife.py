# SPDX-License-Identifier: Apache-2.0
"""Tables full of glass, metal and ceramics, and products in a photo studio."""

from __future__ import annotations

import math

import bmesh
import bpy
from mathutils import Vector

from training.assets import Furniture
from training.scenes import clutter, lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit

THINGS = ("Kitchen", "Bathroom", "Office", "Miscellaneous", "Bedroom", "Living room")


def small(limit: float = 0.45, least: float = 0.05) -> objects.Filter:
    """Return a filter for models that fit on a table."""

    def wanted(item: Furniture) -> bool:
        return least < max(item.size) < limit and min(item.size) > 0.01 and not item.opening

    return wanted


def arrange(stage: Stage, count: int, spread: float, models: float = 0.35) -> None:
    """Place vessels, models and simple shapes around the origin without overlaps."""
    rng = stage.rng
    taken: list[tuple[float, float, float]] = []
    for _ in range(count):
        draw = rng.random()
        if draw < models:
            item = objects.choose(stage, THINGS, small())
            obj = objects.load(stage, item, 0.7) if item else None
            radius = max(item.size[:2]) / 2 if item else 0.1
        elif draw < models + 0.4:
            height = rng.uniform(0.06, 0.32)
            maker = rng.choice((mat.glass, mat.glass, mat.plastic, mat.metal, mat.skin, mat.stone))
            obj = objects.add_mesh(stage, "vessel", objects.vessel_mesh(rng, height), maker(rng))
            radius = max(obj.dimensions.x, 0.04) / 2
        else:
            size = rng.uniform(0.05, 0.16)
            mesh = objects.primitive_mesh(rng, size)
            obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
            radius = size / 2
        if obj is None:
            continue
        for _try in range(12):
            x, y = rng.gauss(0, spread), rng.gauss(0, spread)
            if all(math.hypot(x - a, y - b) > radius + r for a, b, r in taken):
                break
        else:
            bpy.data.objects.remove(obj)
            continue
        taken.append((x, y, radius))
        objects.place(obj, x, y, 0, rng.uniform(-3, 3))
        objects.rest(obj)


@family("still_life")
def still_life(stage: Stage) -> ShotMaker:
    """Things on a table by a wall or in front of an environment picture."""
    rng = stage.rng
    top = rng.choice((mat.wood, mat.wood, mat.cloth, mat.stone, mat.tiles, mat.plastic))(rng)
    objects.box(stage, (-1.2, -0.8, -0.05), (1.2, 0.8, 0), top, 0.01)
    arrange(stage, rng.randint(4, 16), rng.uniform(0.15, 0.35))
    for _ in range(rng.randint(0, 6)):
        clutter.on_top(stage, rng.gauss(0, 0.35), rng.gauss(0.1, 0.3), 0.0)
    if stage.chance(0.5):
        objects.box(stage, (-4, 0.8, -1), (4, 0.9, 3), mat.pick(rng, mat.DULL))
    objects.plane(stage, 30, mat.pick(rng, mat.DULL), -0.8)
    setup = rng.random()
    if setup < 0.6:
        lights.hdri_world(stage)
    else:
        lights.gradient_world(stage, rng.uniform(0.02, 0.3))
    if setup > 0.4:
        lights.softboxes(stage, Vector((0, 0, 0.1)), 1.2, rng.randint(1, 3), 25)
    if stage.chance(0.2):
        for _ in range(rng.randint(1, 4)):
            candle(stage, rng.gauss(0, 0.3), rng.gauss(0, 0.25))
    return orbit(Vector((0, 0, 0.1)), (0.6, 1.5), (4, 50), (28, 85), (180, 360), 0.2, 0.3)


def candle(stage: Stage, x: float, y: float) -> None:
    """Stand a burning candle: wax that glows through, and a flame."""
    rng = stage.rng
    height, radius = rng.uniform(0.05, 0.2), rng.uniform(0.012, 0.035)
    wax = mat.skin(rng, (0.9, 0.8, 0.65), 0.2)
    objects.add_mesh(stage, "wax", objects.cylinder_mesh(radius, height), wax, (x, y, 0))
    flame = objects.lathe_mesh([(0, 0), (0.004, 0.006), (0.003, 0.014), (0, 0.026)], 16)
    glow = mat.glow(rng, log_uniform(rng, 150, 800), (1.0, 0.55, 0.18))
    objects.add_mesh(stage, "flame", flame, glow, (x, y, height + 0.004))


def cyclorama(stage: Stage, material: bpy.types.Material, size: float) -> None:
    """Build a photo studio's backdrop: a floor that bends up into a wall."""
    bm = bmesh.new()
    profile = [(-size * 2, 0.0)]
    bend, steps = size * 0.6, 16
    for k in range(steps + 1):
        a = math.pi / 2 * k / steps
        profile.append((size + bend * math.sin(a), bend * (1 - math.cos(a))))
    profile.append((size + bend, size * 4))
    rows = [[bm.verts.new((x, y, z)) for x in (-size * 4, size * 4)] for y, z in profile]
    for a, b in zip(rows, rows[1:], strict=False):
        bm.faces.new((a[0], a[1], b[1], b[0]))
    objects.add_mesh(stage, "backdrop", objects.from_bmesh(bm, "backdrop", True), material)


@family("product")
def product(stage: Stage) -> ShotMaker:
    """One to three products on a seamless backdrop, lit by softboxes and strips."""
    rng = stage.rng
    shade = rng.choice((0.8, 0.8, 0.5, 0.18, 0.04))
    color = (shade,) * 3 if stage.chance(0.6) else mat.mix_color(mat.random_color(rng, 0.5), (0.6,) * 3, 0.5)
    paper = mat.new_material("paper", Base_Color=mat.rgba(color), Roughness=rng.choice((0.05, 0.25, 0.6, 0.9)))
    item = objects.choose(stage, THINGS + ("Lights", "Vehicles", "Exterior"), small(2.5, 0.08))
    radius = 0.3
    if item is not None and stage.chance(0.75):
        obj = objects.load(stage, item, 0.8)
        if obj is not None:
            objects.place(obj, 0, 0, 0, rng.uniform(-3, 3))
            radius = max(item.size) * 0.7
    else:
        for index in range(rng.randint(1, 4)):
            mesh = (objects.vessel_mesh if stage.chance(0.6) else objects.primitive_mesh)(rng, rng.uniform(0.12, 0.35))
            obj = objects.add_mesh(stage, "product", mesh, mat.pick(rng))
            objects.place(obj, index * 0.28 - 0.3, rng.gauss(0, 0.06), 0, rng.uniform(-3, 3))
            objects.rest(obj)
    for _ in range(rng.choice((0, 1, 3, 6))):
        angle, far = rng.uniform(0, 6.3), radius * rng.uniform(0.6, 1.4)
        clutter.on_top(stage, far * math.cos(angle), far * math.sin(angle), 0.0)
    cyclorama(stage, paper, radius * 4)
    if stage.chance(0.3):
        lights.hdri_world(stage, 0.4, "studio")
    else:
        lights.gradient_world(stage, rng.uniform(0.01, 0.15))
    lights.softboxes(stage, Vector((0, 0, radius * 0.5)), radius * 3, rng.randint(1, 4), 30)
    return orbit(
        Vector((0, 0, radius * 0.55)), (radius * 2.2, radius * 4.5), (3, 40), (35, 85),
        (200, 340), 0.1, 0.3,
    )  # fmt: skip
