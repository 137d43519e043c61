# SPDX-License-Identifier: Apache-2.0
"""Places with many things in them: a classroom, a junk shop, a pavilion by a pool, a showroom."""

from __future__ import annotations

import math
import random

from mathutils import Matrix, Vector

from training.assets import Furniture
from training.scenes import clutter, interiors, lights, objects, textures
from training.scenes import materials as mat
from training.scenes.core import Shot, ShotMaker, Stage, family, inside, lens_blur, log_uniform, orbit, random_lens
from training.scenes.exteriors import ground_material, outdoor_item
from training.scenes.plants import add_tree
from training.scenes.wet import mist, water_surface


def named(*words: str) -> objects.Filter:
    """Return a filter for furniture whose name has one of some words, of a size to sit at."""

    def wanted(item: Furniture) -> bool:
        return any(word in item.name.lower() for word in words) and max(item.size) < 1.7 and not item.opening

    return wanted


@family("classroom")
def classroom(stage: Stage) -> ShotMaker:
    """Rows of desks and chairs in front of a board, windows along one side, papers everywhere."""
    rng = stage.rng
    room = interiors.make_room(stage, size=(5.5, 8.0), window_walls=(1,))
    desk = objects.choose(stage, ("Office", "Living room"), named("table", "desk"))
    chair = objects.choose(stage, ("Office", "Living room", "Bedroom"), named("chair"))
    models = [(objects.load(stage, item), item) for item in (desk, chair) if item is not None]
    columns, rows = rng.randint(2, 4), rng.randint(2, 5)
    for i in range(columns):
        for j in range(rows):
            x = ((i + 0.5) / columns - 0.5) * (room.width - 0.8)
            y = ((j + 0.5) / rows - 0.5) * (room.depth - 2.0) - 0.4
            for obj, item in models:
                if obj is None:
                    continue
                off = 0.0 if item is desk else -0.55
                turn = (math.pi if item is chair else 0.0) + rng.gauss(0, 0.12)
                objects.place(objects.duplicate(stage, obj), x, y + off, 0, turn)
            if desk is not None and stage.chance(0.7):
                clutter.on_top(stage, x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.1, 0.1), desk.size[2])
    for obj, _ in models:
        if obj is not None:
            obj.location = (0, 0, -5)
    board = rng.choice((mat.diffuse(rng, (0.02, 0.06, 0.04)), mat.plastic(rng, (0.8, 0.8, 0.8))))
    interiors.slab(stage, room, 0, -1.4, 1.4, 0.9, 2.1, 0.0, 0.03, board)
    interiors.hang_pictures(stage, room, rng.randint(2, 6), 0.0)
    for _ in range(rng.randint(1, 3)):
        interiors.hang_shelf(stage, room, rng.randrange(1, 4))
    if stage.chance(0.4):
        interiors.hang_curtains(stage, room)
    interiors.daylight(stage, room)
    if stage.chance(0.5):
        interiors.ceiling_lights(stage, room)
    return inside(room.low, room.high, (18, 45), 0.15)


@family("junk_shop")
def junk_shop(stage: Stage) -> ShotMaker:
    """Shelves and floor crammed with things under warm lamps and a window, dust in the air at times."""
    rng = stage.rng
    room = interiors.make_room(stage, rng.choice((0, 1)), (3.0, 5.0))
    for _ in range(rng.randint(2, 4)):
        wall = rng.randrange(4)
        width = rng.uniform(0.8, 1.6)
        reach = max(0.0, interiors.wall_length(room, wall) / 2 - width / 2)
        x, y = interiors.wall_point(room, wall, rng.uniform(-reach, reach), 0.02)
        first = len(stage.scene.objects)
        depth = rng.uniform(0.25, 0.4)
        spots = clutter.shelf_unit(stage, width, rng.uniform(1.2, 2.0), depth, rng.randint(3, 5))
        clutter.scatter(stage, spots, rng.uniform(0.4, 0.8))
        turn = (0, -math.pi / 2, math.pi, math.pi / 2)[wall]
        stand(stage, first, x, y, turn)
    interiors.furnish(stage, room, rng.randint(4, 9), (*interiors.BIG, "Miscellaneous", "Lights"), 0.3)
    for _ in range(rng.randint(5, 20)):
        clutter.on_top(stage, rng.uniform(-0.45, 0.45) * room.width, rng.uniform(-0.45, 0.45) * room.depth, 0.0)
    interiors.hang_pictures(stage, room, rng.randint(3, 9), 0.3)
    for _ in range(rng.randint(1, 4)):
        interiors.shaded_lamp(stage, room)
    if stage.chance(0.6):
        interiors.ceiling_lights(stage, room)
    if room.windows:
        interiors.daylight(stage, room)
    else:
        lights.gradient_world(stage, 0.03)
    if stage.chance(0.15):
        mist(stage, room.low - Vector((0.1,) * 3), room.high + Vector((0.1,) * 3), log_uniform(rng, 0.01, 0.05))
    return inside(room.low, room.high, (20, 60), 0.25)


def stand(stage: Stage, first: int, x: float, y: float, turn: float) -> None:
    """Move everything that was added since `first` from the origin to a place, turned."""
    matrix = Matrix.Translation((x, y, 0)) @ Matrix.Rotation(turn, 4, "Z")
    for obj in list(stage.scene.objects)[first:]:
        if obj.parent is None:
            obj.matrix_world = matrix @ obj.matrix_basis


@family("pavilion")
def pavilion(stage: Stage) -> ShotMaker:
    """A flat-roofed house of glass and slabs by a pool, at noon or at dusk with its lamps on."""
    rng = stage.rng
    objects.plane(stage, 200, ground_material(stage), -0.02)
    deck = rng.choice((mat.wood, mat.tiles, mat.stone))(rng)
    concrete, steel = mat.stone(rng), mat.metal(rng)
    wide, deep, high = rng.uniform(6, 11), rng.uniform(4, 7), rng.uniform(2.6, 3.4)
    objects.box(stage, (-wide / 2 - 2, -deep / 2 - 1, -0.3), (wide / 2 + 2, deep / 2 + 1, 0.0), deck)
    objects.box(stage, (-wide / 2 - 1, -deep / 2 - 1.2, high), (wide / 2 + 1, deep / 2 + 0.6, high + 0.35), concrete)
    objects.box(stage, (-wide / 2, deep / 2 - 0.2, 0), (wide / 2, deep / 2, high), rng.choice((concrete, deck)))
    objects.box(stage, (wide / 2 - 0.2, -deep / 2 + 1, 0), (wide / 2, deep / 2, high), rng.choice((concrete, deck)))
    pane = mat.pane(rng)
    count = rng.randint(3, 7)
    for k in range(count):
        a, b = ((k / count) - 0.5) * wide, (((k + 1) / count) - 0.5) * wide
        if k != count // 2:
            objects.box(stage, (a, -deep / 2 - 0.01, 0), (b, -deep / 2, high), pane)
        objects.box(stage, (a - 0.03, -deep / 2 - 0.04, 0), (a + 0.03, -deep / 2 + 0.04, high), steel)
    furnished: list[tuple[Furniture, float, float]] = []
    for _ in range(rng.randint(5, 12)):
        item = objects.choose(stage, ("Living room", "Bedroom"), outdoor_item(3.0, 0.3))
        obj = objects.load(stage, item) if item else None
        if obj is None:
            continue
        x, y = rng.uniform(-0.42, 0.42) * wide, rng.uniform(-0.38, 0.38) * deep
        if all(math.hypot(x - a, y - b) > 0.45 * (max(item.size) + max(other.size)) for other, a, b in furnished):
            objects.place(obj, x, y, 0, rng.choice((0, 1, 2, 3)) * math.pi / 2)
            furnished.append((item, x, y))
        else:
            obj.location.z = -50
    for _ in range(rng.randint(1, 4)):
        x, y = rng.uniform(-0.4, 0.4) * wide, deep / 2 - 0.5
        clutter.potted_plant(stage, x, y, 0, rng.uniform(0.5, 1.4))
    if stage.chance(0.7):
        size = min(wide * 0.7, 6.0)
        edge = -deep / 2 - 1.0 - size / 2 - 0.4
        water_surface(stage, size, -0.01, 0.4)
        stage.scene.objects[-1].location.y = edge
        tile = mat.tiles(rng, rng.uniform(3, 8))
        objects.box(stage, (-size / 2, edge - size / 2, -0.015), (size / 2, edge + size / 2, -0.012), tile)
        for side in (-1, 1):
            low = (side * (size / 2 + 0.25) - 0.25, edge - size / 2, -0.1)
            objects.box(stage, low, (low[0] + 0.5, edge + size / 2, 0.05), deck)
    spots = [(rng.uniform(-14, 14), rng.uniform(6, 16), -0.1) for _ in range(rng.randint(3, 10))]
    add_tree(stage, spots, rng.uniform(4, 9), rng.randint(3000, 9000), rng.uniform(0.1, 0.2))
    dusk = stage.chance(0.45)
    if dusk:
        if stage.chance(0.5):
            lights.sky_world(stage, (-2, 3))
        else:
            lights.hdri_world(stage, 0.3, "sunset")
        warm = mat.blackbody(rng, 2600, 3600)
        for k in range(rng.randint(2, 6)):
            x = ((k + 0.5) / 6 - 0.5) * wide * 1.6
            lights.lamp(stage, "AREA", (x % (wide * 0.8) - wide * 0.4, 0, high - 0.05), 60, (x, 0, 0), warm, 0.4)
    elif stage.chance(0.7):
        lights.sky_world(stage, (10, 60))
    else:
        lights.hdri_world(stage, outdoor=True)
    far = orbit(Vector((0, -deep / 2, 1.4)), (7, 13), (2, 18), (20, 45), (225, 315), 0.1, 0.1)
    near = orbit(Vector((0, 0, 1.0)), (3.5, 5.5), (3, 15), (24, 50), (220, 320), 0.2, 0.2)
    return lambda r: (far if r.random() < 0.6 else near)(r)


@family("showroom")
def showroom(stage: Stage) -> ShotMaker:
    """One large thing in a studio or hall with ceiling panels and a glossy floor, as cars and furniture are shown."""
    rng = stage.rng
    floor = rng.choice((mat.plastic(rng, (0.25,) * 3), mat.tiles(rng), mat.stone(rng), mat.wood(rng)))
    mat.principled_of(floor).inputs["Roughness"].default_value = rng.choice((0.05, 0.15, 0.4))
    objects.plane(stage, 60, floor)

    def large(item: Furniture) -> bool:
        return 0.8 < max(item.size) < 6.5 and not item.opening

    item = objects.choose(stage, ("Vehicles", "Living room", "Bedroom", "Exterior"), large)
    reach = max(item.size) / 2 if item else 1.0
    obj = objects.load(stage, item, 0.7) if item else None
    if obj is None:
        obj = objects.add_mesh(stage, "shape", objects.primitive_mesh(rng, 1.5), mat.pick(rng))
        objects.rest(obj)
    objects.place(obj, 0, 0, obj.location.z, rng.uniform(-3, 3))
    for _ in range(rng.randint(0, 4)):
        other = objects.choose(stage, ("Living room", "Lights", "Office"), outdoor_item(2.0, 0.3))
        extra = objects.load(stage, other) if other else None
        if extra is not None:
            angle, far = rng.uniform(0, 6.3), reach + max(other.size) * rng.uniform(0.6, 1.0)
            objects.place(extra, far * math.cos(angle), far * math.sin(angle), 0, rng.uniform(-3, 3))
    size = reach * 4 + 2
    if stage.chance(0.6):
        wall = interiors.plaster(stage)
        for k in range(4):
            box = objects.box(stage, (-size, size, 0), (size, size + 0.2, size * 0.8), wall)
            box.rotation_euler.z = k * math.pi / 2
        for k in range(rng.randint(1, 3)):
            face = textures.picture_material(stage)
            x = (k - 1) * size * 0.6
            low, high = (x - size * 0.2, size - 0.06, size * 0.1), (x + size * 0.2, size - 0.02, size * 0.4)
            objects.box(stage, low, high, face)
        rows = rng.randint(1, 4)
        for k in range(rows):
            glow = mat.glow(rng, rng.uniform(4, 15), mat.blackbody(rng, 4500, 6500))
            y = ((k + 0.5) / rows - 0.5) * size * 1.4
            objects.box(stage, (-size * 0.7, y - 0.15, size * 0.78), (size * 0.7, y + 0.15, size * 0.79), glow)
        lights.gradient_world(stage, 0.02)
    else:
        lights.hdri_world(stage)
        lights.softboxes(stage, Vector((0, 0, reach * 0.4)), reach * 3, rng.randint(0, 3), 30)

    def make(r: random.Random) -> Shot:
        focal = random_lens(r, 24, 85)
        far = reach * r.uniform(1.3, 2.2) * (focal / 50) ** 0.6
        angle = r.uniform(0, 2 * math.pi)
        where = Vector((far * math.cos(angle), far * math.sin(angle), r.uniform(0.15, 0.9) * reach))
        target = Vector((r.gauss(0, 0.2), r.gauss(0, 0.2), 0.25)) * reach
        fstop, focus = lens_blur(r, focal, (target - where).length, 0.3)
        return Shot(where, target, focal, fstop, focus)

    return make
