# SPDX-License-Identifier: Apache-2.0
"""Abstract arrangements: no realism, but every material, light and shape at once."""

from __future__ import annotations

import math

from mathutils import Vector

from training.scenes import lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, move, orbit


@family("abstract")
def abstract(stage: Stage) -> ShotMaker:
    """Primitives of random size and material on a floor, under random lights."""
    rng = stage.rng
    floor = rng.choice((mat.diffuse, mat.tiles, mat.wood, mat.stone, mat.plastic, mat.metal))
    objects.plane(stage, 40, floor(rng))
    if stage.chance(0.4):
        y = rng.uniform(2.0, 4.0)
        objects.box(stage, (-20, y, 0), (20, y + 0.2, 8), mat.pick(rng, mat.DULL))
    palette = [mat.pick(rng) for _ in range(rng.randint(4, 14))]
    spread = rng.uniform(0.8, 2.2)
    for _ in range(rng.randint(8, 45)):
        size = log_uniform(rng, 0.12, 0.9)
        obj = objects.add_mesh(stage, "shape", objects.primitive_mesh(rng, size), rng.choice(palette))
        obj.rotation_euler = [rng.uniform(-math.pi, math.pi) for _ in range(3)]
        if stage.chance(0.5):
            obj.rotation_euler = (0, 0, rng.uniform(-3, 3))
        obj.location = (rng.gauss(0, spread), rng.gauss(0, spread), 0)
        if stage.chance(0.2):
            obj.location.z = rng.uniform(0, 1.5)
        else:
            objects.rest(obj)
    light_up(stage, spread)
    if stage.chance(0.12):
        blur_motion(stage)
    return orbit(Vector((0, 0, 0.3)), (1.6, 4.0), (6, 60), (22, 85), spread=0.25)


def light_up(stage: Stage, spread: float) -> None:
    """Choose one of the usual set-ups: sky, picture, studio, many lamps, glowing things."""
    rng = stage.rng
    setup = rng.choice(("world", "world", "studio", "lamps", "mixed", "glow"))
    if setup in ("world", "mixed"):
        lights.random_world(stage)
    elif stage.chance(0.5):
        lights.gradient_world(stage, rng.uniform(0.01, 0.2))
    if setup in ("studio", "mixed"):
        lights.softboxes(stage, Vector((0, 0, 0)), 3.0, rng.randint(1, 4), 30)
    if setup == "lamps":
        lights.scatter_lamps(
            stage,
            Vector((-3, -3, 0.4)),
            Vector((3, 3, 3)),
            rng.randint(2, 16),
            40,
            colored=rng.choice((0.0, 0.3, 1.0)),
        )
    if setup == "glow":
        for _ in range(rng.randint(2, 12)):
            color = lights.random_light_color(rng) if stage.chance(0.4) else None
            material = mat.glow(rng, log_uniform(rng, 3, 60), color)
            size = log_uniform(rng, 0.05, 0.5)
            obj = objects.add_mesh(stage, "glow", objects.primitive_mesh(rng, size), material)
            obj.location = (
                rng.gauss(0, spread),
                rng.gauss(0, spread),
                rng.uniform(0.2, 2.0),
            )


def blur_motion(stage: Stage) -> None:
    """Let some objects fly and spin while the shutter is open."""
    rng = stage.rng
    stage.scene.render.use_motion_blur = True
    for obj in [o for o in stage.scene.objects if o.name.startswith("shape")]:
        if stage.chance(0.5):
            travel = Vector([rng.gauss(0, 0.12) for _ in range(3)])
            move(obj, travel, Vector([rng.gauss(0, 0.3) for _ in range(3)]))


@family("instances")
def instances(stage: Stage) -> ShotMaker:
    """Hundreds to thousands of instances: gravel, crowds of screws, piles of blocks."""
    rng = stage.rng
    objects.plane(stage, 60, mat.pick(rng, mat.DULL))
    palette = [mat.pick(rng) for _ in range(rng.randint(2, 6))]
    size = log_uniform(rng, 0.05, 0.3)
    sources = []
    for _ in range(rng.randint(2, 6)):
        mesh = objects.primitive_mesh(rng, size)
        sources.append(objects.add_mesh(stage, "shape", mesh, rng.choice(palette)))
        sources[-1].location = (0, 0, -5)
    count = rng.randint(200, 2500)
    layout = rng.choice(("grid", "random", "wave"))
    side = max(2, int(math.sqrt(count)))
    step = size * rng.uniform(0.9, 2.0)
    for index in range(count):
        obj = objects.duplicate(stage, rng.choice(sources))
        if layout == "random":
            x, y = rng.gauss(0, side * step / 3), rng.gauss(0, side * step / 3)
        else:
            x = (index % side - side / 2) * step
            y = (index // side - side / 2) * step
        z = size / 2
        if layout == "wave":
            z += size * 2 * (1 + math.sin(x / step / 3) * math.cos(y / step / 4))
        obj.location = (x, y, z * rng.uniform(0.9, 1.3))
        if stage.chance(0.7):
            obj.rotation_euler = [rng.uniform(-3, 3) for _ in range(3)]
        obj.scale = (rng.uniform(0.6, 1.2),) * 3
    light_up(stage, side * step / 4)
    return orbit(Vector((0, 0, size)), (size * 5, size * 22), (8, 70), (24, 85), spread=0.5, blur=0.3)
