# SPDX-License-Identifier: Apache-2.0
"""Set-ups for compositing: light groups, and objects that only cast their shadow into a photograph."""

from __future__ import annotations

import math

import bpy
from mathutils import Vector

from training.scenes import clutter, lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit
from training.scenes.stilllife import THINGS, arrange, small


@family("light_groups")
def light_groups(stage: Stage) -> ShotMaker:
    """A still life lit by a key lamp, a fill, a rim or practical lamps and surroundings, each a light group."""
    rng = stage.rng
    objects.plane(stage, 20, mat.pick(rng, mat.DULL))
    arrange(stage, rng.randint(3, 10), 0.28)
    for _ in range(rng.randint(1, 5)):
        clutter.on_top(stage, rng.gauss(0, 0.3), rng.gauss(0, 0.3), 0.0)
    if stage.chance(0.5):
        objects.box(stage, (-4, 0.9, -1), (4, 1.0, 3), mat.pick(rng, mat.DULL))
    center = Vector((0, 0, 0.1))
    if stage.chance(0.6):
        lights.hdri_world(stage, log_uniform(rng, 0.1, 0.6))
    else:
        lights.gradient_world(stage, log_uniform(rng, 0.02, 0.2))
    for name, angle, power in (("key", 220, 30), ("fill", 320, 8), ("rim", 80, 20)):
        turn = math.radians(angle + rng.gauss(0, 20))
        spot = (1.3 * math.cos(turn), 1.3 * math.sin(turn), rng.uniform(0.3, 1.4))
        size = log_uniform(rng, 0.05, 0.8)
        assign(stage, lights.lamp(stage, "AREA", spot, power, center, size=size), name)
    if stage.chance(0.5):
        for _ in range(rng.randint(1, 4)):
            glow = mat.glow(rng, log_uniform(rng, 30, 300), mat.blackbody(rng, 2200, 4500))
            spot = (rng.gauss(0, 0.35), rng.gauss(0, 0.3), rng.uniform(0.02, 0.3))
            assign(stage, objects.add_mesh(stage, "bulb", objects.sphere_mesh(0.012, 3), glow, spot), "practical")
    add_group(stage, "surroundings")
    stage.scene.world.lightgroup = "surroundings"
    return orbit(center, (0.7, 1.5), (5, 45), (28, 85), (190, 350), 0.2, 0.3)


def add_group(stage: Stage, name: str) -> None:
    """Make a light group unless there is one of that name."""
    groups = stage.scene.view_layers[0].lightgroups
    if name not in groups:
        groups.add(name=name)


def assign(stage: Stage, obj: bpy.types.Object, name: str) -> None:
    """Let an object shine into a light group."""
    add_group(stage, name)
    obj.lightgroup = name


@family("shadow_catcher")
def shadow_catcher(stage: Stage) -> ShotMaker:
    """Things to be put into a photograph: a catcher below them, on transparent film or before the picture itself."""
    rng = stage.rng
    item = objects.choose(stage, (*THINGS, "Vehicles", "Exterior", "Characters"), small(2.5, 0.2))
    obj = objects.load(stage, item, 0.6) if item and stage.chance(0.6) else None
    radius = max(item.size) * 0.6 if obj is not None else 0.4
    if obj is None:
        arrange(stage, rng.randint(3, 9), 0.25)
    catcher = objects.plane(stage, radius * 12, mat.diffuse(rng, (rng.uniform(0.2, 0.8),) * 3))
    catcher.is_shadow_catcher = True
    if stage.chance(0.3):
        low, high = (-radius * 4, radius * 1.6, 0), (radius * 4, radius * 1.7, radius * 4)
        objects.box(stage, low, high, mat.diffuse(rng, (0.5,) * 3)).is_shadow_catcher = True
    stage.scene.render.film_transparent = stage.chance(0.65)
    lights.hdri_world(stage)
    if stage.chance(0.6):
        sun = Vector((rng.gauss(0, 5), rng.gauss(0, 5), rng.uniform(3, 8)))
        lights.lamp(stage, "SUN", sun, log_uniform(rng, 1, 6), (0, 0, 0), mat.blackbody(rng, 4000, 6500), 1.0)
    return orbit(Vector((0, 0, radius * 0.5)), (radius * 2.4, radius * 4.5), (8, 45), (28, 70), spread=0.1, blur=0.2)
