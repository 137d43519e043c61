# SPDX-License-Identifier: Apache-2.0
"""Things under the open sky."""

from __future__ import annotations

import math

import bmesh
import bpy
from mathutils import Vector, noise

from training.assets import Furniture
from training.scenes import lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit

OUTDOOR = ("Exterior", "Vehicles", "Characters", "Lights", "Miscellaneous")


def terrain(
    stage: Stage, size: float, height: float, material: bpy.types.Material, cells: int = 96
) -> bpy.types.Object:
    """Add rolling ground that is flat around the origin."""
    rng = stage.rng
    bm = bmesh.new()
    bmesh.ops.create_grid(bm, x_segments=cells, y_segments=cells, size=size / 2)
    offset = Vector([rng.uniform(-99, 99) for _ in range(3)])
    for vert in bm.verts:
        rise = min(1.0, max(0.0, (vert.co.xy.length - size * 0.08) / (size * 0.3)))
        vert.co.z = height * rise * noise.noise(vert.co * (6 / size) + offset)
    return objects.add_mesh(stage, "ground", objects.from_bmesh(bm, "ground", True), material)


def ground_material(stage: Stage) -> bpy.types.Material:
    """Return grass-like, sandy, paved or asphalt ground."""
    rng = stage.rng
    kind = rng.choice(("grass", "sand", "paving", "asphalt", "stone"))
    if kind == "paving":
        return mat.tiles(rng, rng.uniform(1, 4))
    if kind == "stone":
        return mat.stone(rng)
    color = {
        "grass": (0.06, 0.12, 0.03),
        "sand": (0.5, 0.4, 0.26),
        "asphalt": (0.07, 0.07, 0.075),
    }[kind]
    material = mat.diffuse(rng, color)
    dark = mat.mix_color(color, (0, 0, 0), 0.5)
    mat.texture_color(material, rng, (dark, color), log_uniform(rng, 2, 40), ("noise", "noise", "voronoi"))
    return mat.add_bump(material, rng, log_uniform(rng, 10, 80), ("noise", "voronoi"))


def outdoor_item(largest: float, least: float = 0.4) -> objects.Filter:
    """Return a filter for models that stand outdoors."""

    def wanted(item: Furniture) -> bool:
        return least < max(item.size) < largest and item.size[2] > 0.2 and not item.opening

    return wanted


@family("exterior_hdri")
def exterior_hdri(stage: Stage) -> ShotMaker:
    """A few large objects on open ground in front of an environment picture."""
    rng = stage.rng
    terrain(stage, 60, rng.uniform(0, 4), ground_material(stage))
    taken: list[tuple[float, float, float]] = []
    for _ in range(rng.randint(6, 16)):
        item = objects.choose(stage, OUTDOOR, outdoor_item(9.0))
        if item is None:
            break
        radius = max(item.size[:2]) / 2
        x, y = rng.gauss(0, 3), rng.gauss(0, 3)
        if any(math.hypot(x - a, y - b) < radius + r for a, b, r in taken):
            continue
        obj = objects.load(stage, item, 0.5)
        if obj is None:
            continue
        objects.place(obj, x, y, 0, rng.uniform(-3, 3))
        taken.append((x, y, radius))
    for _ in range(rng.randint(0, 10)):
        size = log_uniform(rng, 0.2, 1.5)
        mesh = objects.primitive_mesh(rng, size)
        obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
        obj.location = (rng.gauss(0, 3), rng.gauss(0, 3), 0)
        objects.rest(obj)
    if stage.chance(0.8):
        lights.hdri_world(stage, log_uniform(rng, 0.5, 2), outdoor=True)
    else:
        lights.sky_world(stage)
    return orbit(Vector((0, 0, 0.8)), (4, 9), (4, 35), (20, 70), spread=0.2)
