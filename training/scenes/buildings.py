# SPDX-License-Identifier: Apache-2.0
"""Bathrooms and kitchens, houses under the sky, streets at night, halls of columns."""

from __future__ import annotations

import math
import random

import bmesh
import bpy
from mathutils import Vector

from training.assets import Furniture
from training.scenes import clutter, interiors, lights, objects
from training.scenes import materials as mat
from training.scenes.core import Shot, ShotMaker, Stage, family, inside, lens_blur, log_uniform, orbit, random_lens
from training.scenes.exteriors import ground_material, outdoor_item, terrain
from training.scenes.fine import fence_paths, text, wire
from training.scenes.plants import add_tree, daylight, lawn


def tiled(stage: Stage) -> bpy.types.Material:
    """Return glossy wall tiles of the size that bathrooms have."""
    return mat.tiles(stage.rng, stage.rng.uniform(2.5, 9))


def wet_room(stage: Stage, categories: tuple[str, ...], count: int) -> ShotMaker:
    """Furnish a tiled room with mirrors, spots and maybe a window."""
    rng = stage.rng
    room = interiors.make_room(stage, rng.choice((0, 1, 1)), (2.0, 4.5), tiled(stage), tiled(stage))
    interiors.furnish(stage, room, count, categories, 0.2, rug=False)
    interiors.hang_pictures(stage, room, rng.randint(1, 3), 0.9)
    for _ in range(rng.randint(1, 3)):
        interiors.hang_shelf(stage, room, rng.randrange(4))
    if room.windows and stage.chance(0.7):
        interiors.daylight(stage, room)
    else:
        lights.gradient_world(stage, 0.05)
    if not room.windows or stage.chance(0.6):
        interiors.ceiling_lights(stage, room)
    return inside(room.low, room.high, (16, 50), 0.2)


@family("bathroom")
def bathroom(stage: Stage) -> ShotMaker:
    """Tiles, basins, mirrors and chrome."""
    return wet_room(stage, ("Bathroom",), stage.rng.randint(4, 10))


@family("kitchen")
def kitchen(stage: Stage) -> ShotMaker:
    """Cabinets in a row with a worktop full of things, lit from windows and spots."""
    rng = stage.rng
    room = interiors.make_room(stage, rng.choice((0, 1, 2)), (2.5, 5))
    interiors.furnish(stage, room, rng.randint(3, 9), ("Kitchen", "Living room"), 0.4, rug=False)
    door, top = rng.choice((mat.plastic, mat.wood, mat.diffuse))(rng), rng.choice((mat.stone, mat.wood, mat.metal))(rng)
    free = [w for w in range(4) if all(win[0] != w for win in room.windows)] or [0]
    wall = rng.choice(free)
    half = interiors.wall_length(room, wall) / 2
    x, handle = -half, mat.metal(rng)
    while x < half - 0.45:
        interiors.slab(stage, room, wall, x + 0.003, x + 0.597, 0.1, 0.86, 0.0, 0.56, door)
        interiors.slab(stage, room, wall, x + 0.15, x + 0.45, 0.78, 0.8, 0.565, 0.585, handle)
        if rng.random() < 0.6:
            interiors.slab(stage, room, wall, x + 0.003, x + 0.597, 1.45, 2.1, 0.0, 0.33, door)
        x += 0.6
    interiors.slab(stage, room, wall, -half, half, 0.86, 0.9, 0.0, 0.6, top)
    backsplash = tiled(stage)
    interiors.slab(stage, room, wall, -half, half, 0.9, 1.45, 0.0, 0.01, backsplash)

    def small(item: Furniture) -> bool:
        return 0.06 < max(item.size) < 0.5 and not item.opening

    for _ in range(rng.randint(6, 14)):
        px, py = interiors.wall_point(room, wall, rng.uniform(-half + 0.2, half - 0.2), rng.uniform(0.12, 0.45))
        model = objects.choose(stage, ("Kitchen",), small) if stage.chance(0.5) else None
        thing = objects.load(stage, model, 0.7) if model else None
        if thing:
            objects.place(thing, px, py, 0.901, rng.uniform(-3, 3))
        else:
            clutter.on_top(stage, px, py, 0.9)
    if room.windows:
        interiors.daylight(stage, room)
    else:
        lights.gradient_world(stage, 0.05)
    if not room.windows or stage.chance(0.6):
        interiors.ceiling_lights(stage, room)
    wide = inside(room.low, room.high, (18, 40), 0.15)
    spot = interiors.wall_point(room, wall, 0, 0.3)
    facing = math.degrees(math.atan2(-spot[1], -spot[0]))
    close = orbit(Vector((*spot, 1.0)), (1.1, 1.7), (5, 40), (28, 60), (facing - 50, facing + 50), 0.4, 0.35)
    return lambda r: (wide if r.random() < 0.5 else close)(r)


def house(stage: Stage, x: float, y: float, size: tuple[float, float, float], lit: float = 0.0) -> None:
    """Build a house with a roof, windows that may be lit, and a door."""
    rng = stage.rng
    hw, hd, h = size[0] / 2, size[1] / 2, size[2]
    wall = rng.choice((mat.tiles, interiors.plaster_outside, mat.wood, mat.stone))(rng)
    objects.box(stage, (x - hw, y - hd, -0.5), (x + hw, y + hd, h), wall)
    frame, dark = mat.plastic(rng, (0.8, 0.8, 0.8)), mat.plastic(rng, (0.02, 0.025, 0.03))
    mat.principled_of(dark).inputs["Roughness"].default_value = 0.02
    glow = [mat.glow(rng, rng.uniform(1, 6), mat.blackbody(rng, 2400, 5000)) for _ in range(3)]
    floors = max(1, int(h / 2.8))
    for side in range(4):
        length = hw if side % 2 == 0 else hd
        count = max(1, int(length / rng.uniform(0.9, 1.6)))
        for floor in range(floors):
            for k in range(count):
                along = (k + 0.5) / count * 2 * length - length
                z, tall, wide = floor * 2.8 + 0.9, 1.3, min(1.1, 1.2 * length / count)
                face = rng.choice(glow) if rng.random() < lit else dark
                for grow, out, material in ((0.08, 0.02, frame), (0.0, 0.04, face)):
                    a, b = along - wide / 2 - grow, along + wide / 2 + grow
                    low, high = z - grow, z + tall + grow
                    corners = {
                        0: ((x + a, y - hd - out, low), (x + b, y - hd, high)),
                        1: ((x + hw, y + a, low), (x + hw + out, y + b, high)),
                        2: ((x + a, y + hd, low), (x + b, y + hd + out, high)),
                        3: ((x - hw - out, y + a, low), (x - hw, y + b, high)),
                    }[side]
                    objects.box(stage, *corners, material)
    door = rng.choice((mat.wood, mat.plastic))(rng)
    objects.box(stage, (x - 0.5, y - hd - 0.05, -0.1), (x + 0.5, y - hd, 2.05), door)
    if stage.chance(0.75):
        roof(stage, x, y, hw + 0.4, hd + 0.4, h, rng.uniform(0.3, 1.0) * hd)
    else:
        objects.box(stage, (x - hw - 0.2, y - hd - 0.2, h), (x + hw + 0.2, y + hd + 0.2, h + 0.3), mat.stone(rng))


def roof(stage: Stage, x: float, y: float, hw: float, hd: float, z: float, rise: float) -> None:
    """Put a gabled roof on a house."""
    bm = bmesh.new()
    left = [bm.verts.new(p) for p in ((x - hw, y - hd, z), (x - hw, y, z + rise), (x - hw, y + hd, z))]
    right = [bm.verts.new(p) for p in ((x + hw, y - hd, z), (x + hw, y, z + rise), (x + hw, y + hd, z))]
    bm.faces.new((left[0], right[0], right[1], left[1]))
    bm.faces.new((left[1], right[1], right[2], left[2]))
    bm.faces.new(left)
    bm.faces.new(right[::-1])
    bm.faces.new((left[0], left[2], right[2], right[0]))
    objects.add_mesh(stage, "roof", objects.from_bmesh(bm, "roof"), mat.tiles(stage.rng, stage.rng.uniform(2, 5)))


@family("house_sky")
def house_sky(stage: Stage) -> ShotMaker:
    """A house with a garden, trees, a fence and things standing about, in daylight."""
    rng = stage.rng
    terrain(stage, 120, rng.uniform(2, 8), ground_material(stage))
    size = (rng.uniform(5, 12), rng.uniform(5, 9), rng.choice((2.9, 5.7)))
    house(stage, 0, 0, size)
    if stage.chance(0.3):
        house(stage, rng.choice((-1, 1)) * 14, rng.uniform(-3, 6), size)
    spots = []
    for _ in range(rng.randint(2, 9)):
        angle, distance = rng.uniform(0, 6.3), rng.uniform(7, 16)
        spots.append((math.cos(angle) * distance, math.sin(angle) * distance, -0.2))
    add_tree(stage, spots, rng.uniform(3, 8), rng.randint(3000, 9000), rng.uniform(0.1, 0.25))
    for _ in range(rng.randint(2, 8)):
        item = objects.choose(stage, ("Exterior", "Vehicles"), outdoor_item(5.5))
        obj = objects.load(stage, item, 0.4) if item else None
        if obj:
            objects.place(obj, rng.uniform(-7, 7), -size[1] / 2 - rng.uniform(1.2, 6), 0, rng.uniform(-3, 3))
    if stage.chance(0.5):
        fence = wire(stage, fence_paths(rng, 16, rng.uniform(0.8, 1.4)), 0.012, rng.choice((mat.wood, mat.metal))(rng))
        objects.place(fence, 0, -size[1] / 2 - 6, 0)
    if stage.chance(0.3):
        lawn(stage, 9, 30000, 0.15)
    daylight(stage)
    far = orbit(Vector((0, -size[1] / 2, 1.7)), (8, 18), (2, 22), (18, 50), (215, 325), 0.2, 0.1)
    near = orbit(Vector((0, -size[1] / 2 - 2, 1.0)), (3, 6), (5, 30), (24, 70), (200, 340), 0.6, 0.25)
    return lambda r: (far if r.random() < 0.6 else near)(r)


@family("street_night")
def street_night(stage: Stage) -> ShotMaker:
    """A street between lit houses: lamps, signs, headlights, wet asphalt, dozens of emitters."""
    rng = stage.rng
    asphalt = mat.diffuse(rng, (0.04, 0.04, 0.045))
    mat.principled_of(asphalt).inputs["Roughness"].default_value = rng.choice((0.08, 0.2, 0.6, 0.9))
    mat.add_bump(asphalt, rng, rng.uniform(1, 20), ("noise",))
    objects.plane(stage, 200, asphalt)
    for side in (-1, 1):
        objects.box(stage, (side * 4 - 1, -30, 0), (side * 4 + 1, 60, 0.14), mat.tiles(rng, 2))
        y = -12.0
        while y < 45:
            length = rng.uniform(6, 12)
            lit = rng.uniform(0.1, 0.5)
            house(stage, side * 9, y + length / 2, (8, length, rng.choice((3, 5.8, 8.6))), lit)
            y += length + rng.choice((0.0, 0.0, 2.0))
    pole = mat.metal(rng, (0.2, 0.2, 0.2))
    post = objects.cylinder_mesh(0.06, 4.5, 12)
    head = objects.sphere_mesh(0.14, 3)
    color = mat.blackbody(rng, 2000, 5500)
    glow = mat.glow(rng, log_uniform(rng, 40, 200), color)
    step = rng.uniform(6, 14)
    for k in range(int(50 / step)):
        for side in (-1, 1):
            y = k * step - 8 + (step / 2 if side > 0 else 0)
            objects.add_mesh(stage, "post", post, pole, (side * 3.3, y, 0))
            objects.add_mesh(stage, "lamp", head, glow, (side * 3.3, y, 4.55))
    for _ in range(rng.randint(2, 8)):
        side = rng.choice((-1, 1))
        sign = text(stage, rng.choice(("BAR", "HOTEL", "OPEN", "24h", "CINEMA", "cafe")), rng.uniform(0.4, 1.0), 0.04)
        neon = mat.glow(rng, log_uniform(rng, 4, 25), lights.random_light_color(rng))
        sign.data.materials.append(neon)
        sign.location = (side * 4.75, rng.uniform(-2, 25), rng.uniform(2.4, 4.5))
        sign.rotation_euler = (math.pi / 2, 0, -side * math.pi / 2 if stage.chance(0.6) else 0)
    for _ in range(rng.randint(2, 7)):
        item = objects.choose(stage, ("Vehicles", "Exterior", "Characters"), outdoor_item(6.5))
        obj = objects.load(stage, item, 0.3) if item else None
        if obj:
            x = rng.choice((-1, 1)) * (rng.uniform(1.2, 2.2) if max(item.size) > 2 else rng.uniform(3.4, 4.4))
            objects.place(obj, x, rng.uniform(-1, 18), 0 if abs(x) < 3 else 0.14, rng.choice((0, math.pi)))
            if item.category == "Vehicles" and stage.chance(0.6):
                front = obj.location + Vector((0, -item.size[1] / 2 - 0.1, 0.6))
                lights.lamp(stage, "SPOT", front, 150, front + Vector((0, -5, -0.5)), (1, 0.95, 0.85), 0.05)
    if stage.chance(0.3):
        lights.hdri_world(stage, 0.15, "night")
    else:
        lights.plain_world(stage, (0.15, 0.2, 0.35), log_uniform(rng, 0.005, 0.08))
    stage.brightness = rng.uniform(0.18, 0.4)

    def make(r: random.Random) -> Shot:
        where = Vector((r.uniform(-3.8, 3.8), r.uniform(-8, 2), r.uniform(0.8, 2.2)))
        target = Vector((r.uniform(-4, 4), r.uniform(8, 18), r.uniform(0.8, 3)))
        focal = random_lens(r, 20, 70)
        fstop, focus = lens_blur(r, focal, r.uniform(6, 14), 0.25, (0.003, 0.02))
        travel = Vector((0, 0.05, 0)) if r.random() < 0.1 else None
        return Shot(where, target, focal, fstop, focus, travel=travel)

    return make


@family("colonnade")
def colonnade(stage: Stage) -> ShotMaker:
    """A hall of columns with the sun or windows from one side: long soft indirect light."""
    rng = stage.rng
    floor = rng.choice((mat.tiles, mat.stone, mat.wood))(rng)
    objects.box(stage, (-8, -20, -0.2), (8, 20, 0), floor)
    wall = rng.choice((mat.stone, mat.tiles, interiors.plaster_outside))(rng)
    height = rng.uniform(3.5, 7)
    objects.box(stage, (-8, -20, height), (rng.choice((4.5, 8)), 20, height + 0.3), wall)
    objects.box(stage, (-8.3, -20, 0), (-8, 20, height), wall)
    objects.box(stage, (-8, 20, 0), (8, 20.3, height), wall)
    objects.box(stage, (-8, -20.3, 0), (8, -20, height), wall)
    radius = rng.uniform(0.2, 0.5)
    profile = [(radius * 1.4, 0), (radius * 1.4, 0.25), (radius * 1.1, 0.3), (radius, 0.5)]
    profile += [(radius * 0.85, height - 0.5), (radius * 1.2, height - 0.3), (radius * 1.4, height - 0.25)]
    profile += [(radius * 1.4, height)]
    column = objects.lathe_mesh([(0, 0), *profile, (0, height)], rng.choice((4, 8, 24, 48)))
    stone = mat.stone(rng)
    step = rng.uniform(2.2, 4.5)
    for k in range(int(38 / step)):
        for x in (-4.2, 4.2):
            objects.add_mesh(stage, "column", column, stone, (x, -18.5 + k * step, 0))
    for _ in range(rng.randint(0, 10)):
        item = objects.choose(stage, ("Living room", "Exterior", "Characters"), outdoor_item(2.5))
        obj = objects.load(stage, item) if item else None
        if obj:
            objects.place(obj, rng.uniform(-7, 3.5), rng.uniform(-12, 12), 0, rng.uniform(-3, 3))
    objects.plane(stage, 300, ground_material(stage), -0.25)
    if stage.chance(0.7):
        lights.sky_world(stage, (8, 45))
        sun = Vector((20, rng.uniform(-25, 25), rng.uniform(6, 25)))
        if stage.chance(0.6):
            lights.lamp(stage, "SUN", sun, rng.uniform(1, 4), (0, 0, 0), mat.blackbody(rng, 3500, 6500), 0.6)
    else:
        lights.hdri_world(stage, 1.5)
    if stage.chance(0.3):
        for k in range(5):
            spot = (rng.uniform(-7, 3), -14 + k * 7, height - 0.6)
            lights.lamp(stage, "POINT", spot, 60, color=mat.blackbody(rng, 2000, 3500), size=0.08)
    return inside(Vector((-7.6, -18, 0)), Vector((4, 18, height)), (18, 50), 0.15)
