# SPDX-License-Identifier: Apache-2.0
"""Validation scenes: places that no training family builds, from models it never sees."""

from __future__ import annotations

import math
import random

from mathutils import Vector

from training.assets import Furniture
from training.scenes import interiors, lights, objects
from training.scenes import materials as mat
from training.scenes.core import Shot, ShotMaker, Stage, family, inside, lens_blur, log_uniform, orbit, random_lens
from training.scenes.exteriors import ground_material, outdoor_item
from training.scenes.fine import wire
from training.scenes.plants import add_tree, daylight
from training.scenes.wet import filled_glass, mist, water_surface

SMALL = ("Kitchen", "Office", "Bedroom", "Miscellaneous", "Bathroom", "Living room")


def small(limit: float) -> objects.Filter:
    """Return a filter for models that fit on a shelf."""

    def wanted(item: Furniture) -> bool:
        return 0.05 < max(item.size) < limit and not item.opening

    return wanted


@family("staircase", "val")
def staircase(stage: Stage) -> ShotMaker:
    """A stair hall: flights of steps with rails, tall windows, a lamp on a long cord."""
    rng = stage.rng
    pale = mat.diffuse(rng, mat.mix_color(mat.warm_color(rng), (0.82, 0.81, 0.78), 0.8))
    room = interiors.make_room(stage, rng.choice((2, 3)), (4.5, 7), pale if stage.chance(0.7) else None)
    steps, wide = rng.randint(10, 16), rng.uniform(0.9, 1.4)
    rise, run = rng.uniform(0.15, 0.18), rng.uniform(0.24, 0.3)
    tread, riser = rng.choice((mat.wood, mat.stone))(rng), mat.diffuse(rng, (0.75, 0.74, 0.7))
    start = -room.width / 2 + 0.3
    rail = rng.choice((mat.metal, mat.wood, mat.plastic))(rng)
    posts = []
    for k in range(steps):
        if (k + 1) * rise > room.height - 0.1:
            break
        x, z = start + k * run, k * rise
        objects.box(stage, (x, -wide / 2, 0), (x + run, wide / 2, z + rise - 0.03), riser)
        objects.box(stage, (x - 0.03, -wide / 2 - 0.03, z + rise - 0.03), (x + run, wide / 2 + 0.03, z + rise), tread)
        for side in (-1, 1):
            y = side * wide / 2
            posts.append([(x + run / 2, y, z + rise), (x + run / 2, y, z + rise + 0.9)])
    for side in (-1, 1):
        y = side * wide / 2
        a = (start + run / 2, y, rise + 0.9)
        posts.append([a, (start + run * (k + 0.5), y, (k + 1) * rise + 0.9)])
    wire(stage, posts, rng.uniform(0.006, 0.02), rail)
    interiors.hang_pictures(stage, room, 4)
    interiors.furnish(stage, room, rng.randint(1, 4))
    interiors.dwell(stage, room)
    interiors.daylight(stage, room)
    if stage.chance(0.85):
        interiors.ceiling_lights(stage, room)
    return inside(room.low, room.high, (16, 40))


@family("library", "val")
def library(stage: Stage) -> ShotMaker:
    """Walls of shelves with hundreds of books, reading lamps, a table."""
    rng = stage.rng
    room = interiors.make_room(stage, rng.choice((0, 1)), (4, 7))
    board = mat.wood(rng)
    covers = [rng.choice((mat.cloth, mat.plastic, mat.diffuse))(rng) for _ in range(16)]
    paper = mat.diffuse(rng, (0.75, 0.7, 0.6))
    for wall in [w for w in range(4) if all(win[0] != w for win in room.windows)][:3]:
        half = interiors.wall_length(room, wall) / 2 - 0.4
        levels = int((room.height - 0.3) / 0.36)
        for level in range(levels + 1):
            z = 0.08 + level * 0.36
            interiors.slab(stage, room, wall, -half, half, z - 0.025, z, 0.0, 0.3, board)
            if level == levels:
                break
            x = -half
            while x < half - 0.06:
                thick = rng.uniform(0.015, 0.06)
                tall, deep = rng.uniform(0.18, 0.31), rng.uniform(0.14, 0.24)
                if rng.random() < 0.9:
                    cover = rng.choice(covers)
                    interiors.slab(stage, room, wall, x, x + thick, z, z + tall, 0.02, deep, cover)
                    if rng.random() < 0.2:
                        interiors.slab(
                            stage,
                            room,
                            wall,
                            x + 0.003,
                            x + thick - 0.003,
                            z,
                            z + tall - 0.004,
                            0.02,
                            deep + 0.002,
                            paper,
                        )
                x += thick + 0.001
        x = -half
        while x <= half + 0.01:
            interiors.slab(stage, room, wall, x - 0.012, x + 0.012, 0, room.height - 0.2, 0.0, 0.3, board)
            x += half / 2
    interiors.furnish(stage, room, rng.randint(2, 5), rug=True)
    for _ in range(rng.randint(1, 3)):
        interiors.shaded_lamp(stage, room)
    if room.windows:
        interiors.daylight(stage, room)
    else:
        lights.gradient_world(stage, 0.03)
    if stage.chance(0.6):
        interiors.ceiling_lights(stage, room)
    return inside(room.low, room.high, (18, 60), 0.25)


@family("greenhouse", "val")
def greenhouse(stage: Stage) -> ShotMaker:
    """Plants on benches under a roof of panes and thin bars, the sun through all of it."""
    rng = stage.rng
    objects.plane(stage, 80, ground_material(stage))
    wide, deep, eave, ridge = 2.5, 6.0, 2.2, 3.4
    bars = []
    for k in range(13):
        y = -deep + k * deep / 6
        bars.append([(-wide, y, 0), (-wide, y, eave), (0, y, ridge), (wide, y, eave), (wide, y, 0)])
    for x, z in ((-wide, 1.0), (-wide, eave), (wide, 1.0), (wide, eave), (0, ridge), (-wide / 2, 2.8), (wide / 2, 2.8)):
        bars.append([(x, -deep, z), (x, deep, z)])
    wire(stage, bars, rng.uniform(0.015, 0.03), rng.choice((mat.metal, mat.plastic))(rng))
    pane = mat.pane(rng) if stage.chance(0.7) else mat.glass(rng, (1, 1, 1), stage.chance(0.3))
    for side in (-1, 1):
        objects.box(stage, (side * wide - 0.003, -deep, 0), (side * wide + 0.003, deep, eave), pane)
        roof = objects.box(stage, (-1.38, -deep, -0.003), (1.38, deep, 0.003), pane)
        roof.location = (side * wide / 2, 0, (eave + ridge) / 2)
        roof.rotation_euler = (0, side * math.atan2(ridge - eave, wide), 0)
    bench, clay = mat.wood(rng), mat.diffuse(rng, (0.45, 0.2, 0.1))
    soil = mat.stone(rng, (0.06, 0.04, 0.03))
    spots = []
    for side in (-1, 1):
        objects.box(stage, (side * 1.7 - 0.5, -deep + 0.2, 0.75), (side * 1.7 + 0.5, deep - 0.2, 0.8), bench)
        for k in range(24):
            x, y = side * 1.7 + rng.uniform(-0.35, 0.35), -deep + 0.5 + k * 0.45
            r = rng.uniform(0.07, 0.15)
            pot = objects.lathe_mesh([(0, 0), (r * 0.7, 0), (r, r * 1.8), (r * 0.9, r * 1.8), (r * 0.85, r * 1.5)])
            objects.add_mesh(stage, "pot", pot, clay, (x, y, 0.801))
            objects.add_mesh(stage, "soil", objects.cylinder_mesh(r * 0.85, 0.01), soil, (x, y, 0.8 + r * 1.5))
            spots.append((x, y, 0.79 + r * 1.5))
    rng.shuffle(spots)
    for part in range(3):
        add_tree(stage, spots[part::3], rng.uniform(0.35, 0.9), rng.randint(500, 2500), rng.uniform(0.03, 0.09))
    for _ in range(4):
        item = objects.choose(stage, ("Exterior", "Living room"), outdoor_item(1.5, 0.2))
        obj = objects.load(stage, item) if item else None
        if obj:
            objects.place(obj, rng.uniform(-0.7, 0.7), rng.uniform(-4, 4), 0, rng.uniform(-3, 3))
    daylight(stage)
    return inside(Vector((-1.6, -5.5, 0)), Vector((1.6, 5.5, 2.4)), (18, 60), 0.3)


@family("workshop", "val")
def workshop(stage: Stage) -> ShotMaker:
    """A bench with tools, boxes and spare parts under strip lamps, dust in the air at times."""
    rng = stage.rng
    room = interiors.make_room(stage, rng.choice((0, 1)), (3.5, 6), rng.choice((mat.tiles, mat.wood, mat.stone))(rng))
    wood, steel = mat.wood(rng), mat.metal(rng)
    walls = [w for w in range(4) if all(win[0] != w for win in room.windows)]
    wall = rng.choice(walls)
    half = interiors.wall_length(room, wall) / 2 - 0.2
    interiors.slab(stage, room, wall, -half, half, 0.86, 0.92, 0.0, 0.7, wood)
    for k in range(5):
        x = -half + 0.05 + k * (2 * half - 0.15) / 4
        interiors.slab(stage, room, wall, x, x + 0.07, 0, 0.86, 0.58, 0.65, steel)
    for z in (1.5, 1.85):
        interiors.slab(stage, room, wall, -half, half, z, z + 0.025, 0.0, 0.25, wood)
    for z, off, count in ((0.921, 0.35, 18), (1.526, 0.12, 12), (1.876, 0.12, 12)):
        for _ in range(count):
            spread = 0.28 if z < 1 else 0.05
            x, y = interiors.wall_point(room, wall, rng.uniform(-half, half), off + rng.uniform(-spread, spread))
            draw = rng.random()
            if draw < 0.5:
                item = objects.choose(stage, SMALL, small(0.5 if z < 1 else 0.3))
                obj = objects.load(stage, item) if item else None
            elif draw < 0.8:
                size = rng.uniform(0.05, 0.14)
                low, high = (-size, -size * 0.7, 0), (size, size * 0.7, size * rng.uniform(0.6, 1.6))
                obj = objects.box(stage, low, high, mat.pick(rng, mat.DULL), 0.003)
            else:
                obj = objects.add_mesh(stage, "jar", objects.vessel_mesh(rng, rng.uniform(0.08, 0.2)), mat.pick(rng))
            if obj:
                objects.place(obj, x, y, z, rng.uniform(-3, 3))
    interiors.furnish(stage, room, rng.randint(2, 5), ("Miscellaneous", "Office", "Vehicles"), 0.4, rug=False)
    for k in range(rng.randint(1, 3)):
        tube = mat.glow(rng, rng.uniform(6, 20), mat.blackbody(rng, 4000, 6500))
        objects.box(stage, (-0.6, k - 1.04, room.height - 0.3), (0.6, k - 0.96, room.height - 0.26), tube)
    if stage.chance(0.3):
        mist(stage, room.low - Vector((0.1,) * 3), room.high + Vector((0.1,) * 3), log_uniform(rng, 0.01, 0.08))
    if room.windows:
        interiors.daylight(stage, room)
    else:
        lights.gradient_world(stage, 0.02)
    wide = inside(room.low, room.high, (18, 45), 0.2)
    spot = interiors.wall_point(room, wall, rng.uniform(-half, half) * 0.5, 0.35)
    facing = math.degrees(math.atan2(-spot[1], -spot[0]))
    close = orbit(Vector((*spot, 1.0)), (1.0, 1.7), (5, 45), (28, 70), (facing - 40, facing + 40), 0.35, 0.35)
    return lambda r: (wide if r.random() < 0.5 else close)(r)


@family("courtyard", "val")
def courtyard(stage: Stage) -> ShotMaker:
    """A paved court with arcades on all sides, a pool, trees in tubs and benches."""
    rng = stage.rng
    objects.plane(stage, 60, mat.tiles(rng, rng.uniform(1, 4)))
    facade = interiors.plaster_outside(rng)
    column = objects.cylinder_mesh(rng.uniform(0.12, 0.25), 2.6, rng.choice((4, 24)))
    stone, size = mat.stone(rng), rng.uniform(4, 7)
    for side in range(4):
        turn = side * math.pi / 2
        c, s = math.cos(turn), math.sin(turn)
        for low, high in (
            ((-size - 3, size + 2.0, 0), (size + 3, size + 2.4, 6)),
            ((-size, size - 0.3, 2.6), (size, size + 2.0, 3.0)),
            ((-size, size - 0.3, 3.0), (size, size - 0.1, 6)),
        ):
            wall = objects.box(stage, low, high, facade)
            wall.rotation_euler = (0, 0, turn)
        for k in range(7):
            x, y = -size + k * size / 3, size - 0.2
            objects.add_mesh(stage, "column", column, stone, (x * c - y * s, x * s + y * c, 0))
    if stage.chance(0.7):
        objects.box(stage, (-1.6, -1.6, 0), (1.6, 1.6, 0.02), mat.tiles(rng, 6))
        for a, b in (((-1.8, -1.8), (1.8, -1.6)), ((-1.8, 1.6), (1.8, 1.8)), ((-1.8, -1.6), (-1.6, 1.6))):
            objects.box(stage, (*a, 0), (*b, 0.45), stone)
        objects.box(stage, (1.6, -1.6, 0), (1.8, 1.6, 0.45), stone)
        water_surface(stage, 3.19, 0.32, 0.3)
    spots = [(x * (size - 1.8), y * (size - 1.8), 0.3) for x in (-1, 1) for y in (-1, 1)]
    add_tree(stage, spots, rng.uniform(1.8, 3.5), rng.randint(2000, 6000), rng.uniform(0.06, 0.15))
    tub = objects.lathe_mesh([(0, 0), (0.35, 0), (0.5, 0.6), (0.45, 0.6), (0.4, 0.4), (0, 0.4)])
    for x, y, _ in spots:
        objects.add_mesh(stage, "tub", tub, mat.pick(rng, mat.DULL), (x, y, 0))
    for _ in range(rng.randint(3, 9)):
        item = objects.choose(stage, ("Exterior", "Characters", "Living room"), outdoor_item(2.2, 0.4))
        obj = objects.load(stage, item) if item else None
        if obj:
            angle, reach = rng.uniform(0, 6.3), rng.uniform(2.4, size - 1)
            objects.place(obj, math.cos(angle) * reach, math.sin(angle) * reach, 0, rng.uniform(-3, 3))
    daylight(stage)
    edge = size + 1.5
    return inside(Vector((-edge, -edge, 0)), Vector((edge, edge, 3)), (18, 60), 0.2)


@family("bar", "val")
def bar(stage: Stage) -> ShotMaker:
    """Bottles on lit glass shelves before a mirror, drinks on a counter, an aquarium."""
    rng = stage.rng
    objects.box(stage, (-3, -0.5, -0.1), (3, 0.4, 0), rng.choice((mat.stone, mat.wood, mat.metal))(rng), 0.01)
    objects.plane(stage, 30, mat.tiles(rng), -1.05)
    back = mat.mirror(rng) if stage.chance(0.6) else mat.tiles(rng, 5)
    objects.box(stage, (-3, 1.2, -1), (3, 1.25, 2.2), back)
    objects.box(stage, (-5, -4, 2.2), (5, 2, 2.3), mat.diffuse(rng))
    objects.box(stage, (-5, -4.1, -1), (5, -4, 2.2), interiors.plaster(stage))
    color = lights.random_light_color(rng) if stage.chance(0.5) else mat.blackbody(rng, 2300, 4500)
    glow = mat.glow(rng, log_uniform(rng, 1.5, 6), color)
    shelf = mat.glass(rng, (1, 1, 1), False) if stage.chance(0.6) else mat.wood(rng)
    kinds = [objects.vessel_mesh(rng, rng.uniform(0.2, 0.32)) for _ in range(7)]
    looks = [mat.glass(rng) for _ in range(8)] + [mat.plastic(rng), mat.metal(rng)]
    for level in range(4):
        z = 0.25 + level * 0.42
        objects.box(stage, (-2.4, 0.9, z - 0.012), (2.4, 1.18, z), shelf)
        objects.box(stage, (-2.4, 1.175, z - 0.04), (2.4, 1.195, z - 0.02), glow)
        x = -2.3
        while x < 2.3:
            mesh = rng.choice(kinds).copy()
            bottle = objects.add_mesh(stage, "bottle", mesh, rng.choice(looks))
            objects.place(bottle, x, 1.03 + rng.gauss(0, 0.03), z + 0.001, rng.uniform(-3, 3))
            x += rng.uniform(0.12, 0.3)
    for _ in range(rng.randint(3, 8)):
        filled_glass(stage, rng.uniform(-1.2, 1.2), rng.uniform(-0.35, 0.25), rng.uniform(0.08, 0.2))
    for _ in range(rng.randint(0, 4)):
        item = objects.choose(stage, ("Kitchen",), small(0.4))
        obj = objects.load(stage, item) if item else None
        if obj:
            objects.place(obj, rng.uniform(-1.2, 1.2), rng.uniform(-0.3, 0.2), 0.001, rng.uniform(-3, 3))
    for k in range(rng.randint(1, 4)):
        bulb = mat.glow(rng, log_uniform(rng, 30, 200), mat.blackbody(rng, 2200, 3500))
        objects.add_mesh(stage, "bulb", objects.sphere_mesh(0.05), bulb, (k * 0.9 - 1.2, -0.1, 1.2))
    lights.gradient_world(stage, 0.02)

    def make(r: random.Random) -> Shot:
        where = Vector((r.uniform(-1.6, 1.6), r.uniform(-2.2, -0.9), r.uniform(0.15, 0.9)))
        target = Vector((r.uniform(-1, 1), r.uniform(0, 1.1), r.uniform(0.05, 1.2)))
        focal = random_lens(r, 24, 85)
        fstop, focus = lens_blur(r, focal, (target - where).length, 0.35)
        return Shot(where, target, focal, fstop, focus)

    return make


@family("corridor", "val")
def corridor(stage: Stage) -> ShotMaker:
    """A long corridor with doors, coloured lamps and a polished floor, hazy at times."""
    rng = stage.rng
    floor = rng.choice((mat.plastic, mat.tiles, mat.stone, mat.cloth))(rng)
    wide, high, long = rng.uniform(1.6, 3), rng.uniform(2.3, 3.2), 18.0
    half = wide / 2
    side, door = interiors.plaster(stage), rng.choice((mat.wood, mat.plastic, mat.metal))(rng)
    objects.box(stage, (-half, -long / 2, -0.1), (half, long / 2, 0), floor)
    objects.box(stage, (-half, -long / 2, high), (half, long / 2, high + 0.1), mat.diffuse(rng, (0.8,) * 3))
    for x in (-1, 1):
        a, b = sorted((x * half, x * (half + 0.2)))
        objects.box(stage, (a, -long / 2, 0), (b, long / 2, high), side)
        for k in range(6):
            y = -8 + k * 3 + rng.uniform(-0.3, 0.3)
            a, b = sorted((x * half, x * (half - 0.03)))
            objects.box(stage, (a, y, 0), (b, y + 0.9, 2.05), door)
            knob = objects.add_mesh(stage, "knob", objects.sphere_mesh(0.03, 3), mat.metal(rng))
            knob.location = (x * (half - 0.07), y + 0.1, 1.0)
    for y in (-long / 2, long / 2):
        objects.box(stage, (-half, y - 0.1, 0), (half, y + 0.1, high), side)
    palette = [lights.random_light_color(rng) if stage.chance(0.5) else mat.blackbody(rng) for _ in range(3)]
    style = rng.choice(("ceiling", "wall", "strip"))
    for k in range(6):
        if stage.chance(0.15):
            continue
        y, glow = -7.5 + k * 3, mat.glow(rng, log_uniform(rng, 10, 40), rng.choice(palette))
        if style == "ceiling":
            objects.box(stage, (-0.25, y - 0.25, high - 0.03), (0.25, y + 0.25, high - 0.001), glow)
        elif style == "wall":
            for x in (-1, 1):
                objects.add_mesh(stage, "lamp", objects.sphere_mesh(0.08), glow, (x * (half - 0.1), y, 1.9))
        else:
            objects.box(stage, (-half, y, 0.02), (-half + 0.02, y + 2.2, 0.06), glow)
            objects.box(stage, (half - 0.02, y, high - 0.06), (half, y + 2.2, high - 0.02), glow)
    for _ in range(rng.randint(2, 7)):
        item = objects.choose(stage, ("Living room", "Office", "Miscellaneous", "Characters"), outdoor_item(1.9, 0.3))
        obj = objects.load(stage, item) if item else None
        if obj:
            x = rng.choice((-1, 1)) * max(0.1, half - item.size[0] / 2 - 0.1)
            objects.place(obj, x, rng.uniform(-6, 6), 0, rng.uniform(-3, 3))
    if stage.chance(0.3):
        fog = log_uniform(rng, 0.01, 0.1)
        mist(stage, Vector((-half, -long / 2, 0)), Vector((half, long / 2, high)), fog)
    lights.gradient_world(stage, 0.01)

    def make(r: random.Random) -> Shot:
        y = r.choice((-1, 1)) * r.uniform(4, 8)
        where = Vector((r.uniform(-half + 0.3, half - 0.3), y, r.uniform(0.5, 1.8)))
        target = Vector((r.uniform(-half, half), y - math.copysign(r.uniform(3, 6), y), r.uniform(0.4, 1.6)))
        focal = random_lens(r, 18, 50)
        fstop, focus = lens_blur(r, focal, 4.0, 0.2)
        return Shot(where, target, focal, fstop, focus)

    return make
