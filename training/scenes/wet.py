# SPDX-License-Identifier: Apache-2.0
"""Liquids, glass with caustics, wax and fruit, mist and clouds."""

from __future__ import annotations

import bmesh
import bpy
from mathutils import Vector, noise

from training.scenes import lights, nodes, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit
from training.scenes.stilllife import arrange, candle


def liquid(stage: Stage, color: mat.Color | None = None) -> bpy.types.Material:
    """Return water, wine, oil or juice: refraction with absorption by tint."""
    rng = stage.rng
    if color is None:
        # Pale: the tint acts at every surface that light crosses, eight times in a drink.
        color = mat.mix_color((1, 1, 1), mat.random_color(rng, 1.0, 1.0), rng.uniform(0, 0.35))
    material = mat.glass(rng, color, False)
    mat.principled_of(material).inputs["IOR"].default_value = rng.uniform(1.33, 1.45)
    return material


def filled_glass(stage: Stage, x: float, y: float, height: float) -> None:
    """Stand a glass with something to drink in it; the liquid overlaps the wall a little."""
    rng = stage.rng
    radius, wall = height * rng.uniform(0.25, 0.42), height * 0.025
    top = rng.uniform(0.85, 1.15)
    outer = [(radius * 0.9, 0), (radius, height * 0.5), (radius * top, height)]
    body = objects.smooth_curve(outer)
    base = height * rng.uniform(0.04, 0.12)
    inner = [(r - wall, z) for r, z in reversed(body) if z > base]
    clear = mat.glass(rng, (1, 1, 1), False)
    glass = objects.lathe_mesh([(0, 0), *body, *inner, (0, base)])
    objects.add_mesh(stage, "glass", glass, clear, (x, y, 1e-3))
    level = height * rng.uniform(0.35, 0.85)
    side = [(r - wall * 0.8, z) for r, z in body if base < z < level]
    if len(side) > 1:
        drink = objects.lathe_mesh([(0, base + 1e-4), *side, (0, side[-1][1])])
        objects.add_mesh(stage, "drink", drink, liquid(stage), (x, y, 1e-3))
    for _ in range(rng.choice((0, 0, 3, 5))):
        cube = objects.box(stage, (-0.5,) * 3, (0.5,) * 3, mat.glass(rng, (1, 1, 1), None), 0.1)
        size = radius * 0.55
        cube.scale = (size,) * 3
        cube.rotation_euler = [rng.uniform(-3, 3) for _ in range(3)]
        cube.location = (
            x + rng.gauss(0, radius * 0.25),
            y + rng.gauss(0, radius * 0.25),
            rng.uniform(base + size * 0.6, level),
        )


def water_surface(stage: Stage, size: float, z: float, depth: float) -> None:
    """Add a body of water with waves on top."""
    rng = stage.rng
    bm = bmesh.new()
    bmesh.ops.create_grid(bm, x_segments=140, y_segments=140, size=size / 2)
    offset = Vector([rng.uniform(-99, 99) for _ in range(3)])
    scale, height = rng.uniform(1.5, 6) / size * 4, size * log_uniform(rng, 0.003, 0.015)
    for vert in bm.verts:
        vert.co.z = height * noise.fractal(vert.co * scale + offset, 0.8, 2.0, 3)
    bmesh.ops.translate(bm, vec=(0, 0, z), verts=bm.verts)
    tint = mat.mix_color((1, 1, 1), (0.3, 0.75, 0.8), rng.random())
    water = liquid(stage, tint)
    mesh = objects.from_bmesh(bm, "water", True)
    objects.add_mesh(stage, "water", mesh, water)


@family("liquids")
def liquids(stage: Stage) -> ShotMaker:
    """Drinks on a table, or a basin of water with things in it: caustics everywhere."""
    rng = stage.rng
    if stage.chance(0.65):
        objects.plane(stage, 12, mat.pick(rng, mat.DULL))
        for _ in range(rng.randint(2, 7)):
            filled_glass(stage, rng.gauss(0, 0.2), rng.gauss(0, 0.15), rng.uniform(0.07, 0.2))
        arrange(stage, rng.randint(0, 4), 0.3, 0.2)
        radius, center = (0.5, 1.1), Vector((0, 0, 0.07))
    else:
        tile = mat.tiles(rng, rng.uniform(2, 8))
        objects.box(stage, (-2.2, -2.2, -0.9), (2.2, 2.2, -0.7), tile)
        for low, high in (
            ((-2.2, -2.2, -0.7), (-2, 2.2, 0.1)),
            ((2, -2.2, -0.7), (2.2, 2.2, 0.1)),
            ((-2, -2.2, -0.7), (2, -2, 0.1)),
            ((-2, 2, -0.7), (2, 2.2, 0.1)),
        ):
            objects.box(stage, low, high, tile)
        water_surface(stage, 4.0, -0.05, 0.6)
        for _ in range(rng.randint(2, 8)):
            mesh = objects.primitive_mesh(rng, rng.uniform(0.2, 0.6))
            obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
            obj.location = (rng.uniform(-1.6, 1.6), rng.uniform(-1.6, 1.6), -0.5)
            obj.location.z = rng.choice((-0.4, -0.1, 0.0))
        radius, center = (2.0, 4.0), Vector((0, 0, -0.2))
        objects.plane(stage, 60, mat.pick(rng, mat.DULL), -1.2)
    draw = rng.random()
    if draw < 0.4:
        lights.hdri_world(stage)
    elif draw < 0.6:
        lights.sky_world(stage, (15, 60))
    else:
        lights.gradient_world(stage, rng.uniform(0.02, 0.3))
        height = radius[0]
        for _ in range(rng.randint(1, 3)):
            spot = center + Vector((rng.gauss(0, 1), rng.gauss(0, 1), rng.uniform(0.7, 2))) * height
            size = height * log_uniform(rng, 0.02, 0.4)
            lights.lamp(stage, rng.choice(("AREA", "POINT", "SPOT")), spot, 40, center, size=size)
    return orbit(center, radius, (8, 55), (28, 85), spread=0.15, blur=0.3)


@family("subsurface")
def subsurface(stage: Stage) -> ShotMaker:
    """Candles, soap, marble, fruit and jelly, often lit from behind."""
    rng = stage.rng
    objects.plane(stage, 12, mat.pick(rng, mat.DULL))
    for _ in range(rng.randint(2, 9)):
        size = rng.uniform(0.06, 0.22)
        maker = rng.choice((objects.blob_mesh, objects.primitive_mesh, objects.vessel_mesh))
        obj = objects.add_mesh(stage, "wax", maker(rng, size), mat.skin(rng, None, size * 3))
        objects.place(obj, rng.gauss(0, 0.22), rng.gauss(0, 0.2), 0, rng.uniform(-3, 3))
        objects.rest(obj)
    flames = stage.chance(0.5)
    if flames:
        for _ in range(rng.randint(1, 6)):
            candle(stage, rng.gauss(0, 0.22), rng.gauss(0, 0.18))
    if stage.chance(0.5) and not flames:
        lights.random_world(stage)
    else:
        lights.gradient_world(stage, log_uniform(rng, 0.003, 0.2))
        count = rng.randint(0 if flames else 1, 2)
        lights.softboxes(stage, Vector((0, 0, 0.1)), 0.8, count, 12)
    return orbit(Vector((0, 0, 0.08)), (0.5, 1.1), (3, 40), (35, 85), spread=0.2, blur=0.3)


def mist(
    stage: Stage,
    low: Vector,
    high: Vector,
    density: float,
    lumpy: float | None = None,
    anisotropy: float = 0.3,
) -> bpy.types.Material:
    """Fill a box with fog; lumpy is the size of its clouds, None for even fog."""
    rng = stage.rng
    material = bpy.data.materials.new("mist")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.remove(mat.principled_of(material))
    volume = tree.nodes.new("ShaderNodeVolumePrincipled")
    volume.inputs["Density"].default_value = density
    volume.inputs["Anisotropy"].default_value = anisotropy
    grey = rng.uniform(0.7, 1.0)
    volume.inputs["Color"].default_value = mat.rgba((grey,) * 3)
    if stage.chance(0.2):
        volume.inputs["Color"].default_value = mat.rgba(mat.random_color(rng, 0.6, 0.9))
    if lumpy is not None:
        value = nodes.pattern(tree, rng, 1.0 / lumpy, ("noise",))
        node = nodes.map_range(tree, value, -density * 3, density * 4)
        tree.links.new(node, volume.inputs["Density"])
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(volume.outputs[0], output.inputs["Volume"])
    objects.box(stage, low, high, material)
    return material


@family("volumes")
def volumes(stage: Stage) -> ShotMaker:
    """Fog with beams, smoke over an arrangement, a cloud in a box, hazy halls."""
    rng = stage.rng
    stage.scene.cycles.volume_step_rate = 2.0
    objects.plane(stage, 60, mat.pick(rng, mat.DULL))
    for _ in range(rng.randint(4, 18)):
        mesh = objects.primitive_mesh(rng, log_uniform(rng, 0.2, 1.0))
        obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
        obj.location = (rng.gauss(0, 1.4), rng.gauss(0, 1.4), 0)
        objects.rest(obj)
    kind = rng.choice(("even", "even", "beams", "cloud", "cloud"))
    if kind == "cloud":
        size = rng.uniform(0.8, 1.8)
        low, high = Vector((-size, -size, 0.1)), Vector((size, size, size * 1.2))
        mist(stage, low, high, log_uniform(rng, 1.5, 8), rng.uniform(0.3, 0.8), rng.uniform(0, 0.6))
    else:
        deep = log_uniform(rng, 0.03, 0.3)
        mist(stage, Vector((-9, -9, -0.1)), Vector((9, 9, 6)), deep, None, rng.uniform(0, 0.7))
    if kind == "beams":
        wall = mat.diffuse(rng, (0.4, 0.4, 0.4))
        for k in range(-8, 9):
            if rng.random() < 0.8:
                objects.box(stage, (k * 0.5, 3.0, 0), (k * 0.5 + 0.38, 3.1, 5), wall)
        lights.gradient_world(stage, 0.02)
        energy = log_uniform(rng, 2, 8)
        origin = Vector((rng.uniform(-3, 3), 10, rng.uniform(3, 9)))
        lights.lamp(stage, "SUN", origin, energy, (0, 0, 0), size=0.5)
    elif stage.chance(0.5):
        lights.random_world(stage)
    else:
        lights.gradient_world(stage, log_uniform(rng, 0.005, 0.1))
        low, high = Vector((-2.5, -2.5, 0.5)), Vector((2.5, 2.5, 3))
        lights.scatter_lamps(stage, low, high, rng.randint(1, 7), 60, rng.choice((0, 0.5, 1)))
    return orbit(Vector((0, 0, 0.6)), (3, 6), (3, 40), (24, 70), spread=0.15)
