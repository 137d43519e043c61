# SPDX-License-Identifier: Apache-2.0
"""Scenes chosen for how they are lit and shot: darkness, neon, transparent film, heavy blur."""

from __future__ import annotations

import dataclasses
import math
import random

from mathutils import Vector

from training.scenes import interiors, lights, objects
from training.scenes import materials as mat
from training.scenes.abstract import light_up
from training.scenes.core import Shot, ShotMaker, Stage, family, inside, log_uniform, move, orbit
from training.scenes.stilllife import THINGS, arrange, candle, small


@family("dark")
def dark(stage: Stage) -> ShotMaker:
    """Almost nothing is lit: one small lamp, a strip under a door, a screen, a candle."""
    rng = stage.rng
    stage.brightness = rng.uniform(0.1, 0.2)
    lights.gradient_world(stage, log_uniform(rng, 0.0005, 0.01))
    if stage.chance(0.5):
        room = interiors.make_room(stage, rng.choice((0, 1)))
        interiors.furnish(stage, room, rng.randint(3, 8))
        interiors.hang_pictures(stage, room, rng.randint(0, 3))
        if stage.chance(0.5):
            interiors.shaded_lamp(stage, room)
        else:
            wall = rng.randrange(4)
            screen = mat.glow(rng, rng.uniform(2, 6), (0.4, 0.6, 1.0))
            interiors.slab(stage, room, wall, -0.6, 0.6, 0.7, 1.4, 0.03, 0.05, screen)
        return inside(room.low, room.high)
    objects.plane(stage, 20, mat.pick(rng, mat.DULL))
    arrange(stage, rng.randint(4, 14), 0.3)
    if stage.chance(0.5):
        for _ in range(rng.randint(1, 3)):
            candle(stage, rng.gauss(0, 0.3), rng.gauss(0, 0.3))
    else:
        spot = Vector((rng.gauss(0, 0.6), rng.gauss(0, 0.6), rng.uniform(0.3, 1.2)))
        kind = rng.choice(("SPOT", "POINT", "AREA"))
        lights.lamp(stage, kind, spot, 10, (0, 0, 0), size=log_uniform(rng, 0.005, 0.2))
    return orbit(Vector((0, 0, 0.1)), (0.6, 1.4), (5, 45), (28, 85), spread=0.2, blur=0.2)


@family("neon")
def neon(stage: Stage) -> ShotMaker:
    """Coloured tubes and spots on glossy walls and floors: a club, a corridor, a stage."""
    rng = stage.rng
    floor = rng.choice((mat.plastic, mat.tiles, mat.stone, mat.metal))(rng)
    wall = rng.choice((mat.plastic, mat.tiles, mat.diffuse, mat.metal))(rng)
    room = interiors.make_room(stage, 0, (3, 9), wall, floor)
    interiors.furnish(stage, room, rng.randint(1, 6), rug=False)
    lights.gradient_world(stage, 0.001)
    palette = [lights.random_light_color(rng) for _ in range(rng.randint(1, 4))]
    for _ in range(rng.randint(3, 14)):
        side = rng.randrange(4)
        reach = interiors.wall_length(room, side) / 2 - 0.1
        glow = mat.glow(rng, log_uniform(rng, 5, 40), rng.choice(palette))
        a = rng.uniform(-reach, reach)
        if stage.chance(0.5):
            z = rng.uniform(0.1, room.height - 0.1)
            b = min(reach, a + rng.uniform(0.4, 3))
            interiors.slab(stage, room, side, a, b, z, z + 0.03, 0.04, 0.07, glow)
        else:
            z = rng.uniform(0.0, 1.0)
            interiors.slab(stage, room, side, a, a + 0.03, z, z + rng.uniform(0.5, 1.5), 0.04, 0.07, glow)
    if stage.chance(0.5):
        low, high = room.low + Vector((0.3, 0.3, 1.8)), room.high - Vector((0.3, 0.3, 0.1))
        lights.scatter_lamps(stage, low, high, rng.randint(1, 5), 30, 1.0)
    for _ in range(rng.randint(1, 8)):
        mesh = objects.primitive_mesh(rng, log_uniform(rng, 0.2, 0.8))
        obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
        obj.location = (rng.uniform(-1.2, 1.2), rng.uniform(-1.2, 1.2), 0)
        objects.rest(obj)
    stage.brightness = rng.uniform(0.2, 0.45)
    return inside(room.low, room.high, (16, 45))


@family("film")
def film(stage: Stage) -> ShotMaker:
    """Cut-outs on transparent film: products, glass and fine outlines against nothing."""
    rng = stage.rng
    stage.scene.render.film_transparent = True
    stage.scene.cycles.film_transparent_glass = stage.chance(0.4)
    if stage.chance(0.5):
        arrange(stage, rng.randint(3, 10), 0.22)
    else:
        item = objects.choose(stage, (*THINGS, "Lights", "Exterior"), small(2.0, 0.15))
        obj = objects.load(stage, item, 0.8) if item else None
        if obj:
            scale = 0.5 / max(item.size)
            obj.scale = (scale,) * 3
        for _ in range(2):
            mesh = objects.primitive_mesh(rng, rng.uniform(0.1, 0.3))
            obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
            obj.location = (rng.gauss(0, 0.3), rng.gauss(0, 0.3), rng.uniform(0.05, 0.4))
    if stage.chance(0.3):
        objects.box(stage, (-0.6, -0.5, -0.03), (0.6, 0.5, -0.001), mat.pick(rng, mat.DULL))
    lights.random_world(stage)
    if stage.chance(0.5):
        lights.softboxes(stage, Vector((0, 0, 0.1)), 1.0, rng.randint(1, 3), 20)
    return orbit(Vector((0, 0, 0.12)), (0.5, 1.0), (-5, 45), (35, 85), spread=0.15, blur=0.2)


@family("blur")
def blur(stage: Stage) -> ShotMaker:
    """Wide-open lenses with bokeh, spinning and flying things, camera shake."""
    rng = stage.rng
    objects.plane(stage, 40, mat.pick(rng, mat.DULL))
    moving = stage.chance(0.6)
    stage.scene.render.use_motion_blur = moving
    for _ in range(rng.randint(8, 30)):
        mesh = objects.primitive_mesh(rng, log_uniform(rng, 0.1, 0.6))
        obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
        obj.location = (rng.gauss(0, 1.2), rng.gauss(0, 1.5), 0)
        objects.rest(obj)
        if moving and stage.chance(0.5):
            travel = Vector([rng.gauss(0, 0.1) for _ in range(3)])
            move(obj, travel, Vector((0, 0, rng.gauss(0, 0.8))))
    for _ in range(rng.randint(0, 40)):
        glow = mat.glow(rng, log_uniform(rng, 20, 300), mat.blackbody(rng))
        spot = (rng.gauss(0, 3), rng.gauss(0, 3), rng.uniform(0.2, 2.5))
        objects.add_mesh(stage, "bulb", objects.sphere_mesh(0.025, 2), glow, spot)
    light_up(stage, 1.2)
    center = Vector((0, 0, 0.3))

    def make(r: random.Random) -> Shot:
        shot = orbit(center, (1.5, 3.5), (4, 35), (35, 85), spread=0.25, blur=0)(r)
        distance = (shot.target - shot.location).length
        if not moving or r.random() < 0.7:
            diameter = log_uniform(r, 0.02, 0.09) * distance
            focus = distance * r.uniform(0.7, 1.2)
            shot = dataclasses.replace(shot, fstop=shot.lens / 1000 / diameter, focus=focus)
        if moving and r.random() < 0.4:
            angle = r.uniform(0, 2 * math.pi)
            size = log_uniform(r, 0.005, 0.06) * distance
            travel = Vector((math.cos(angle), math.sin(angle), r.gauss(0, 0.5))) * size
            shot = dataclasses.replace(shot, travel=travel)
        return shot

    return make
