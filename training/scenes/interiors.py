# SPDX-License-Identifier: Apache-2.0
"""Furnished rooms by day and by lamplight."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
from mathutils import Vector

from training.assets import Furniture
from training.scenes import clutter, lights, objects, textures
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, inside, log_uniform

BIG = ("Living room", "Bedroom", "Office")
WALL = 0.2


@dataclass
class Room:
    """An empty room: its inner size and the openings in its walls."""

    width: float
    depth: float
    height: float
    #: (wall 0..3, centre along the wall, sill, width, height)
    windows: list[tuple[int, float, float, float, float]]

    @property
    def low(self) -> Vector:
        """Return the lower inner corner."""
        return Vector((-self.width / 2, -self.depth / 2, 0))

    @property
    def high(self) -> Vector:
        """Return the upper inner corner."""
        return Vector((self.width / 2, self.depth / 2, self.height))


def wall_point(room: Room, wall: int, along: float, off: float) -> tuple[float, float]:
    """Return a point by a wall: `along` from its middle, `off` into the room."""
    w, d = room.width / 2, room.depth / 2
    return [(along, d - off), (w - off, -along), (-along, -d + off), (-w + off, along)][wall]


def wall_length(room: Room, wall: int) -> float:
    """Return the inner length of wall 0..3."""
    return room.width if wall % 2 == 0 else room.depth


def make_room(
    stage: Stage,
    windows: int = 0,
    size: tuple[float, float] = (3.0, 7.0),
    wall: bpy.types.Material | None = None,
    floor: bpy.types.Material | None = None,
    window_walls: Sequence[int] | None = None,
) -> Room:
    """Build walls with holes for windows (in so many walls, or in the given ones), floor and ceiling."""
    rng = stage.rng
    room = Room(rng.uniform(*size), rng.uniform(*size), rng.uniform(2.4, 3.4), [])
    for index in window_walls or rng.sample(range(4), min(windows, 4)):
        length = wall_length(room, index)
        count = rng.choice((1, 1, 2, 3)) if length > 3.5 else 1
        width = min(rng.uniform(0.8, 2.5), length / count * 0.75)
        sill = rng.choice((0.0, 0.4, 0.9, 1.0))
        height = min(rng.uniform(1.0, 2.2), room.height - sill - 0.15)
        for k in range(count):
            center = (k + 0.5) * length / count - length / 2
            room.windows.append((index, center, sill, width, height))
    wall = wall or plaster(stage)
    floor = floor or rng.choice((mat.wood, mat.wood, mat.tiles, mat.cloth, mat.stone))(rng)
    w, d, h = room.width / 2, room.depth / 2, room.height
    objects.box(stage, (-w - WALL, -d - WALL, -0.1), (w + WALL, d + WALL, 0), floor)
    ceiling = mat.diffuse(rng, (0.8, 0.8, 0.78))
    objects.box(stage, (-w - WALL, -d - WALL, h), (w + WALL, d + WALL, h + 0.1), ceiling)
    other = plaster(stage) if stage.chance(0.3) else wall
    for index in range(4):
        build_wall(stage, room, index, other if index == 2 else wall)
    for window in room.windows:
        glaze(stage, room, window)
    skirting = mat.plastic(rng, (0.8, 0.8, 0.8)) if stage.chance(0.7) else mat.wood(rng)
    for index in range(4):
        length = wall_length(room, index)
        slab(stage, room, index, -length / 2, length / 2, 0.0, 0.1, 0.0, 0.015, skirting)
    return room


def plaster(stage: Stage) -> bpy.types.Material:
    """Return paint, wallpaper, bricks or panels for a wall."""
    rng = stage.rng
    draw = rng.random()
    if draw < 0.65:
        pale = mat.mix_color(mat.warm_color(rng), (0.82, 0.81, 0.78), rng.uniform(0.7, 1.0))
        bold = mat.mix_color(mat.random_color(rng, 0.5), (0.85,) * 3, 0.5)
        material = mat.diffuse(rng, pale if stage.chance(0.7) else bold)
        return mat.add_bump(material, rng, 60, ("noise",)) if stage.chance(0.4) else material
    if draw < 0.75:
        material = mat.diffuse(rng)
        colors = (mat.random_color(rng, 0.4), mat.random_color(rng, 0.4))
        return mat.texture_color(material, rng, colors, log_uniform(rng, 3, 20))
    return mat.tiles(rng) if draw < 0.87 else mat.wood(rng) if draw < 0.94 else mat.stone(rng)


def plaster_outside(rng: random.Random) -> bpy.types.Material:
    """Return weathered paint for a facade."""
    color = mat.mix_color(mat.random_color(rng, 0.5), (0.8, 0.78, 0.72), 0.5)
    material = mat.diffuse(rng, color)
    mat.texture_color(material, rng, (mat.mix_color(color, (0.1, 0.1, 0.1), 0.25), color), rng.uniform(0.5, 3))
    return mat.add_bump(material, rng, rng.uniform(20, 80), ("noise",))


def slab(
    stage: Stage,
    room: Room,
    wall: int,
    start: float,
    end: float,
    bottom: float,
    top: float,
    near: float,
    far: float,
    material: bpy.types.Material,
) -> bpy.types.Object | None:
    """Add a box along a wall; near/far are distances into the room (negative: in the wall)."""
    if end - start < 1e-4 or top - bottom < 1e-4:
        return None
    a = wall_point(room, wall, start, near)
    b = wall_point(room, wall, end, far)
    low = (min(a[0], b[0]), min(a[1], b[1]), bottom)
    high = (max(a[0], b[0]), max(a[1], b[1]), top)
    return objects.box(stage, low, high, material)


def build_wall(stage: Stage, room: Room, wall: int, material: bpy.types.Material) -> None:
    """Build one wall around its windows."""
    length = wall_length(room, wall)
    holes = sorted(w for w in room.windows if w[0] == wall)
    cursor = -length / 2 - WALL
    for _, center, sill, width, height in holes:
        left, right = center - width / 2, center + width / 2
        slab(stage, room, wall, cursor, left, 0, room.height, -WALL, 0, material)
        slab(stage, room, wall, left, right, 0, sill, -WALL, 0, material)
        slab(stage, room, wall, left, right, sill + height, room.height, -WALL, 0, material)
        cursor = right
    slab(stage, room, wall, cursor, length / 2 + WALL, 0, room.height, -WALL, 0, material)


def glaze(stage: Stage, room: Room, window: tuple[int, float, float, float, float]) -> None:
    """Put a frame with bars into a window, and often a pane of glass."""
    rng = stage.rng
    wall, center, sill, width, height = window
    frame = mat.plastic(rng, (0.8, 0.8, 0.8)) if stage.chance(0.6) else mat.wood(rng)
    left, right, top = center - width / 2, center + width / 2, sill + height
    bar, near, far = 0.05, -0.12, -0.06
    for start, end, low, high in (
        (left, left + bar, sill, top),
        (right - bar, right, sill, top),
        (left, right, sill, sill + bar),
        (left, right, top - bar, top),
    ):
        slab(stage, room, wall, start, end, low, high, near, far, frame)
    for k in range(1, rng.choice((1, 2, 2, 3, 4))):
        x = left + width * k / 4 if width > 1.2 else center
        slab(stage, room, wall, x - bar / 2, x + bar / 2, sill, top, near, far, frame)
    if stage.chance(0.6):
        # Solid glass blocks direct light; few artists keep it once they saw the noise.
        pane = mat.glass(rng, (1, 1, 1), False) if stage.chance(0.12) else mat.pane(rng)
        slab(stage, room, wall, left, right, sill, top, -0.095, -0.085, pane)
    if stage.chance(0.25):
        blinds(stage, room, window)


def blinds(stage: Stage, room: Room, window: tuple[int, float, float, float, float]) -> None:
    """Hang slats in front of a window: stripes of light on everything behind."""
    rng = stage.rng
    wall, center, sill, width, height = window
    material = mat.plastic(rng, (0.75, 0.75, 0.7))
    step = rng.uniform(0.04, 0.08)
    lowest = sill + height * rng.choice((0.0, 0.0, 0.3, 0.5))
    z = sill + height
    while z > lowest:
        slab(
            stage,
            room,
            wall,
            center - width / 2,
            center + width / 2,
            z - 0.004,
            z,
            0.02,
            0.02 + step * 0.8,
            material,
        )
        z -= step


def furnish(
    stage: Stage,
    room: Room,
    count: int,
    categories: Sequence[str] = BIG,
    smallest: float = 0.35,
    rug: bool = True,
) -> list[tuple[bpy.types.Object, Furniture]]:
    """Stand furniture along the walls and some in the middle, without overlaps."""
    rng = stage.rng
    placed: list[tuple[bpy.types.Object, Furniture]] = []
    taken: list[tuple[float, float, float]] = []

    def wanted(item: Furniture) -> bool:
        w, d, h = item.size
        return (
            max(w, d) < min(room.width, room.depth) * 0.6
            and h < room.height - 0.2
            and max(w, d, h) > smallest
            and h > 0.15
            and not item.opening
        )

    for _ in range(count * 3):
        if len(placed) >= count:
            break
        item = objects.choose(stage, categories, wanted)
        if item is None:
            break
        wall = rng.randrange(4)
        middle = stage.chance(0.25)
        reach = max(0.0, wall_length(room, wall) / 2 - item.size[0] / 2 - 0.05)
        along = rng.uniform(-reach, reach)
        off = item.size[1] / 2 + (rng.uniform(0.6, room.depth / 2) if middle else 0.04)
        x, y = wall_point(room, wall, along, off)
        radius = max(item.size[0], item.size[1]) / 2
        if any(math.hypot(x - a, y - b) < 0.8 * (radius + r) for a, b, r in taken):
            continue
        obj = objects.load(stage, item)
        if obj is None:
            continue
        turn = (0, -math.pi / 2, math.pi, math.pi / 2)[wall]
        objects.place(obj, x, y, 0, turn + (rng.gauss(0, 0.4) if middle else rng.gauss(0, 0.02)))
        placed.append((obj, item))
        taken.append((x, y, radius))
    decorate(stage, placed)
    if rug and stage.chance(0.5):
        w, d = room.width * rng.uniform(0.15, 0.3), room.depth * rng.uniform(0.15, 0.3)
        objects.box(stage, (-w, -d, 0), (w, d, 0.012), mat.cloth(rng))
    return placed


FLAT_TOPS = ("table", "desk", "drawer", "chest", "stand", "cabinet", "board", "shel", "bench", "counter")


def decorate(stage: Stage, placed: Sequence[tuple[bpy.types.Object, Furniture]]) -> None:
    """Put small things on tables, desks and chests."""
    rng = stage.rng
    for obj, item in placed:
        if not any(word in item.name.lower() for word in FLAT_TOPS) or not 0.25 < item.size[2] < 1.3:
            continue
        for _ in range(rng.randint(1, 5)):
            x = rng.uniform(-0.35, 0.35) * item.size[0]
            y = rng.uniform(-0.35, 0.35) * item.size[1]
            spot = obj.matrix_basis @ Vector((x, y, item.size[2]))
            clutter.on_top(stage, spot.x, spot.y, spot.z)


def hang_curtains(stage: Stage, room: Room) -> None:
    """Hang curtains beside or before the windows."""
    rng = stage.rng
    cloth = clutter.curtain_cloth(stage)
    for wall, center, sill, width, height in room.windows:
        closed = stage.chance(0.25)
        top, drop = sill + height + 0.08, height + rng.choice((0.15, sill + 0.05))
        for side in (-1, 1):
            wide = width * (0.55 if closed else rng.uniform(0.15, 0.35))
            mesh = clutter.curtain_mesh(rng, wide, drop, wide * rng.uniform(6, 12))
            along = center + side * (width / 2 + 0.06 - wide / 2)
            x, y = wall_point(room, wall, along, 0.12)
            curtain = objects.add_mesh(stage, "curtain", mesh, cloth)
            objects.place(curtain, x, y, top, (0, -math.pi / 2, math.pi, math.pi / 2)[wall])


def dwell(stage: Stage, room: Room) -> None:
    """Add what makes a room lived in: plants, shelves, curtains, things on the floor."""
    rng = stage.rng
    if room.windows and stage.chance(0.5):
        hang_curtains(stage, room)
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        wall = rng.randrange(4)
        reach = wall_length(room, wall) / 2 - 0.35
        x, y = wall_point(room, wall, rng.uniform(-reach, reach), 0.35)
        clutter.potted_plant(stage, x, y, 0.0, rng.uniform(0.4, 1.3))
    if stage.chance(0.4):
        free = [w for w in range(4) if all(win[0] != w for win in room.windows)] or [0]
        hang_shelf(stage, room, rng.choice(free))
    for _ in range(rng.choice((0, 0, 2, 6))):
        clutter.on_top(stage, rng.uniform(-0.4, 0.4) * room.width, rng.uniform(-0.4, 0.4) * room.depth, 0.0)


def hang_shelf(stage: Stage, room: Room, wall: int) -> None:
    """Fix boards with things on them to a wall."""
    rng = stage.rng
    board = rng.choice((mat.wood, mat.plastic))(rng)
    half = min(rng.uniform(0.4, 1.2), wall_length(room, wall) * 0.4)
    middle = rng.uniform(-1, 1) * (wall_length(room, wall) / 2 - half)
    for level in range(rng.randint(1, 3)):
        z = 1.25 + 0.35 * level
        slab(stage, room, wall, middle - half, middle + half, z - 0.025, z, 0.0, 0.24, board)
        for _ in range(rng.randint(2, 7)):
            x, y = wall_point(room, wall, middle + rng.uniform(-0.9, 0.9) * half, 0.12)
            clutter.on_top(stage, x, y, z)


def hang_pictures(stage: Stage, room: Room, count: int, mirrors: float = 0.25) -> None:
    """Hang pictures and mirrors on walls where there is no window."""
    rng = stage.rng
    free = [w for w in range(4) if all(win[0] != w for win in room.windows)]
    for _ in range(count if free else 0):
        wall = rng.choice(free)
        w, h = rng.uniform(0.3, 1.2), rng.uniform(0.3, 1.0)
        reach = max(0.0, wall_length(room, wall) / 2 - w)
        x, z = rng.uniform(-reach, reach), rng.uniform(1.2, max(1.3, room.height - h / 2 - 0.3))
        frame = rng.choice((mat.wood, mat.metal, mat.plastic))(rng)
        slab(stage, room, wall, x - w / 2, x + w / 2, z - h / 2, z + h / 2, 0.0, 0.03, frame)
        if stage.chance(mirrors):
            face = mat.mirror(rng)
        else:
            face = textures.picture_material(stage)
        b = 0.03
        slab(
            stage,
            room,
            wall,
            x - w / 2 + b,
            x + w / 2 - b,
            z - h / 2 + b,
            z + h / 2 - b,
            0.03,
            0.032,
            face,
        )


def daylight(stage: Stage, room: Room) -> None:
    """Put a sky or an environment picture outside, and what artists put into windows to help it in."""
    rng = stage.rng
    if stage.chance(0.65):
        lights.sky_world(stage, (8, 50))
    else:
        lights.hdri_world(stage, log_uniform(rng, 1, 4), outdoor=True)
    helper = rng.choice((None, "portal", "portal", "lamp"))
    color = mat.blackbody(rng, 5500, 8000)
    for wall, center, sill, width, height in room.windows if helper else ():
        x, y = wall_point(room, wall, center, -WALL - 0.05)
        spot = Vector((x, y, sill + height / 2))
        ahead = Vector((*wall_point(room, wall, center, 1.0), sill + height / 2))
        power = 25 * width * height
        light = lights.lamp(stage, "AREA", spot, power, ahead, color, width, height)
        light.data.cycles.is_portal = helper == "portal"


@family("room_day")
def room_day(stage: Stage) -> ShotMaker:
    """A furnished room that gets its light through windows."""
    rng = stage.rng
    room = make_room(stage, rng.choice((1, 1, 2, 2, 3)))
    furnish(stage, room, rng.randint(5, 14))
    hang_pictures(stage, room, rng.randint(0, 5))
    dwell(stage, room)
    objects.plane(stage, 200, mat.diffuse(rng), -0.3)
    daylight(stage, room)
    if stage.chance(0.3):
        lights.lamp(stage, "AREA", (0, 0, room.height - 0.05), 60, (0, 0, 0), size=0.5)
    return inside(room.low, room.high)


@family("room_lamps")
def room_lamps(stage: Stage) -> ShotMaker:
    """A furnished room in the evening: many lamps, shades, strips and candles."""
    rng = stage.rng
    room = make_room(stage, rng.choice((0, 1)))
    placed = furnish(stage, room, rng.randint(5, 12))
    hang_pictures(stage, room, rng.randint(0, 5))
    dwell(stage, room)
    lights.gradient_world(stage, log_uniform(rng, 0.002, 0.05))
    if stage.chance(0.6):
        ceiling_lights(stage, room)
    for _ in range(rng.randint(1, 5)):
        shaded_lamp(stage, room)
    for obj, item in placed:
        if stage.chance(0.15):
            spot = obj.matrix_basis @ Vector((0, 0, item.size[2] + 0.15))
            lights.lamp(stage, "POINT", spot, log_uniform(rng, 2, 15), size=0.04)
    if stage.chance(0.25):
        wall = rng.randrange(4)
        length = wall_length(room, wall) * 0.45
        color = lights.random_light_color(rng) if stage.chance(0.6) else None
        strip = mat.glow(rng, log_uniform(rng, 8, 40), color)
        z = rng.choice((0.15, room.height - 0.1))
        slab(stage, room, wall, -length, length, z, z + 0.02, 0.03, 0.05, strip)
    return inside(room.low, room.high)


def ceiling_lights(stage: Stage, room: Room) -> None:
    """Add a lamp in the middle, a grid of spots, or panels."""
    rng = stage.rng
    kind = rng.choice(("globe", "spots", "panel"))
    color = mat.blackbody(rng, 2600, 5000)
    if kind == "globe":
        radius = rng.uniform(0.06, 0.2)
        height = room.height - rng.uniform(0.2, 0.9)
        material = mat.glow(rng, 1.5 / radius**2 * 0.1, color)
        objects.add_mesh(stage, "globe", objects.sphere_mesh(radius), material, (0, 0, height))
        cord = objects.cylinder_mesh(0.004, room.height - height, 8)
        objects.add_mesh(stage, "cord", cord, mat.plastic(rng), (0, 0, height))
        return
    nx, ny = rng.randint(1, 4), rng.randint(1, 3)
    for i in range(nx):
        for j in range(ny):
            x = ((i + 0.5) / nx - 0.5) * room.width
            y = ((j + 0.5) / ny - 0.5) * room.depth
            if kind == "spots":
                lights.lamp(
                    stage,
                    "SPOT",
                    (x, y, room.height - 0.02),
                    log_uniform(rng, 20, 60),
                    (x, y, 0),
                    color,
                    0.02,
                )
            else:
                glow = mat.glow(rng, rng.uniform(4, 15), color)
                z = room.height
                objects.box(stage, (x - 0.3, y - 0.15, z - 0.02), (x + 0.3, y + 0.15, z), glow)


def shaded_lamp(stage: Stage, room: Room) -> None:
    """Stand a lamp with a cloth, glass or metal shade on the floor near a wall."""
    rng = stage.rng
    wall = rng.randrange(4)
    reach = wall_length(room, wall) / 2 - 0.4
    x, y = wall_point(room, wall, rng.uniform(-reach, reach), rng.uniform(0.3, 0.6))
    height = rng.uniform(0.5, 1.8)
    radius = rng.uniform(0.1, 0.25)
    pole = rng.choice((mat.metal, mat.wood, mat.plastic))(rng)
    objects.add_mesh(stage, "pole", objects.cylinder_mesh(0.012, height), pole, (x, y, 0))
    objects.add_mesh(stage, "foot", objects.cylinder_mesh(radius * 0.8, 0.02), pole, (x, y, 0))
    tall = rng.uniform(0.15, 0.35)
    profile = [(radius, 0), (radius * rng.uniform(0.5, 1.0), tall)]
    shade = objects.lathe_mesh(profile)
    if stage.chance(0.6):
        material = mat.leaf(rng)
        shader = mat.principled_of(material)
        shader.inputs["Base Color"].default_value = mat.rgba(mat.blackbody(rng, 3000, 6000))
    else:
        material = rng.choice((mat.plastic, mat.metal, mat.glass))(rng)
    objects.add_mesh(stage, "shade", shade, material, (x, y, height - tall * 0.3))
    bulb = (x, y, height + tall * 0.2)
    if stage.chance(0.5):
        lights.lamp(stage, "POINT", bulb, log_uniform(rng, 8, 60), size=rng.uniform(0.01, 0.05))
    else:
        glow = mat.glow(rng, log_uniform(rng, 60, 600), mat.blackbody(rng, 2400, 4500))
        objects.add_mesh(stage, "bulb", objects.sphere_mesh(0.035), glow, bulb)
