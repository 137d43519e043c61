# SPDX-License-Identifier: Apache-2.0
"""Plants: trees and bushes of branches with leaf cards or leaf meshes, grass, fur."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from training.scenes import lights, objects
from training.scenes import materials as mat
from training.scenes.core import ShotMaker, Stage, family, log_uniform, orbit
from training.scenes.exteriors import ground_material, terrain


def alpha_leaf(rng: random.Random) -> bpy.types.Material:
    """Return a leaf cut out of its square by transparency, the way game and archviz trees are."""
    material = mat.leaf(rng)
    tree = material.node_tree
    source = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = (-1, -1, 0)
    mapping.inputs["Scale"].default_value = (2, 2, 1)
    gradient = tree.nodes.new("ShaderNodeTexGradient")
    gradient.gradient_type = "QUADRATIC_SPHERE"
    step = tree.nodes.new("ShaderNodeMath")
    step.operation = "GREATER_THAN"
    step.inputs[1].default_value = rng.uniform(0.02, 0.2)
    tree.links.new(source.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], gradient.inputs["Vector"])
    tree.links.new(gradient.outputs["Fac"], step.inputs[0])
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    surface = output.inputs["Surface"].links[0].from_socket
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(step.outputs[0], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(surface, mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def _branch(
    bm: bmesh.types.BMesh,
    start: Vector,
    direction: Vector,
    length: float,
    radius: float,
    rng: random.Random,
    tips: list[tuple[Vector, Vector]],
    level: int,
    bend: float,
) -> None:
    """Grow one bent branch and, from along it, the next finer ones."""
    steps, sides = (6, 7) if level > 1 else (3, 4)
    at, heading, rings, nodes = start.copy(), direction.normalized(), [], []
    for k in range(steps + 1):
        r = radius * (1 - 0.75 * k / steps)
        a = heading.orthogonal().normalized()
        b = heading.cross(a)
        rings.append(
            [
                bm.verts.new(at + (a * math.cos(t) + b * math.sin(t)) * r)
                for t in (2 * math.pi * i / sides for i in range(sides))
            ]
        )
        nodes.append((at.copy(), heading.copy(), r))
        wobble = Vector([rng.gauss(0, bend) for _ in range(3)])
        heading = (heading + wobble + Vector((0, 0, 0.06))).normalized()
        at = at + heading * length / steps
    for low, high in zip(rings, rings[1:], strict=False):
        for i in range(sides):
            n = (i + 1) % sides
            bm.faces.new((low[i], low[n], high[n], high[i]))
    if level <= 1:
        tips += [(p, h) for p, h, _ in nodes[1:]]
    if level == 0:
        return
    for _ in range(rng.randint(4, 7)):
        point, along, r = nodes[rng.randint(max(1, steps // 3), steps)]
        side = Matrix.Rotation(rng.uniform(0, 6.3), 3, along) @ along.orthogonal()
        spread = (along * rng.uniform(0.3, 0.9) + side.normalized()).normalized()
        _branch(bm, point, spread, length * rng.uniform(0.45, 0.7), r * 0.6, rng, tips, level - 1, bend)


def tree_meshes(
    rng: random.Random, height: float, leaves: int = 5000, leaf_size: float = 0.12
) -> tuple[bpy.types.Mesh, bpy.types.Mesh]:
    """Return the wood and the leaves of a tree standing on the origin."""
    bm = bmesh.new()
    tips: list[tuple[Vector, Vector]] = []
    radius = height * rng.uniform(0.018, 0.04)
    up = Vector((rng.gauss(0, 0.08), rng.gauss(0, 0.08), 1))
    _branch(bm, Vector((0, 0, 0)), up, height * 0.6, radius, rng, tips, 3, rng.uniform(0.05, 0.18))
    wood = objects.from_bmesh(bm, "wood", True)
    rounded = rng.random() < 0.4
    verts, faces = [], []
    each = max(1, leaves // max(1, len(tips)))
    for point, _ in tips:
        for _ in range(each):
            size = leaf_size * rng.uniform(0.5, 1.2)
            at = point + Vector([rng.gauss(0, leaf_size * 1.2) for _ in range(3)])
            along = Vector([rng.gauss(0, 1) for _ in range(3)]).normalized()
            across = along.orthogonal().normalized() * size * (0.5 if rounded else 0.35)
            along = along * size
            first = len(verts)
            verts += [at - across, at + across, at + across + along, at - across + along]
            faces.append((first, first + 1, first + 2, first + 3))
    mesh = bpy.data.meshes.new("leaves")
    mesh.from_pydata(verts, [], faces)
    uv = mesh.uv_layers.new()
    uv.data.foreach_set("uv", np.tile((0, 0, 1, 0, 1, 1, 0, 1), len(faces)).astype(np.float32))
    return wood, mesh


def add_tree(
    stage: Stage,
    spots: Sequence[tuple[float, float, float]],
    height: float,
    leaves: int = 5000,
    leaf_size: float = 0.12,
) -> None:
    """Plant one kind of tree at several places (x, y, z)."""
    rng = stage.rng
    wood, leaf = tree_meshes(rng, height, leaves, leaf_size)
    wood.materials.append(mat.stone(rng, mat.warm_color(rng)))
    leaf.materials.append(alpha_leaf(rng) if stage.chance(0.6) else mat.leaf(rng))
    for x, y, z in spots:
        turn, scale = rng.uniform(-3, 3), rng.uniform(0.7, 1.2)
        for mesh in (wood, leaf):
            obj = bpy.data.objects.new("tree", mesh)
            stage.scene.collection.objects.link(obj)
            objects.place(obj, x, y, z, turn)
            obj.scale = (scale,) * 3


def strands(
    stage: Stage,
    roots: np.ndarray,
    directions: np.ndarray,
    length: float,
    radius: float,
    material: bpy.types.Material,
    curl: float = 0.3,
    points: int = 5,
) -> bpy.types.Object:
    """Add hair curves from roots [N,3] along directions [N,3]."""
    noise = np.random.default_rng(stage.rng.getrandbits(32))
    count = len(roots)
    t = np.linspace(0.0, 1.0, points)[None, :, None]
    bend = noise.normal(0, curl, (count, 1, 3)) - np.array((0, 0, curl))
    size = length * noise.uniform(0.6, 1.2, (count, 1, 1))
    path = roots[:, None] + size * (directions[:, None] * t + bend * t**2)
    curves = bpy.data.hair_curves.new("hair")
    curves.add_curves([points] * count)
    curves.attributes["position"].data.foreach_set("vector", path.astype(np.float32).ravel())
    if "radius" not in curves.attributes:
        curves.attributes.new("radius", "FLOAT", "POINT")
    thick = radius * (1.0 - 0.85 * np.broadcast_to(t, (count, points, 1)))
    curves.attributes["radius"].data.foreach_set("value", thick.astype(np.float32).ravel())
    curves.materials.append(material)
    obj = bpy.data.objects.new("hair", curves)
    stage.scene.collection.objects.link(obj)
    return obj


def hair_material(rng: random.Random) -> bpy.types.Material:
    """Return real hair (Principled Hair) or painted strands."""
    if rng.random() < 0.3:
        return rng.choice((mat.diffuse, mat.plastic, mat.leaf))(rng)
    material = bpy.data.materials.new("fur")
    material.use_nodes = True
    tree = material.node_tree
    shader = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    shader.parametrization = "COLOR"
    shader.inputs["Color"].default_value = mat.rgba(
        mat.warm_color(rng) if rng.random() < 0.7 else mat.random_color(rng, 0.9)
    )
    shader.inputs["Roughness"].default_value = rng.uniform(0.15, 0.5)
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


@family("foliage")
def foliage(stage: Stage) -> ShotMaker:
    """Trees, bushes and ground plants close to the camera, under sun or sky."""
    rng = stage.rng
    terrain(stage, 80, rng.uniform(1, 6), ground_material(stage))
    for _ in range(rng.randint(1, 3)):
        height = rng.uniform(3, 8)
        spots = [(rng.gauss(0, 5), rng.gauss(0, 5), -0.1) for _ in range(rng.randint(1, 7))]
        add_tree(stage, spots, height, rng.randint(3000, 14000), rng.uniform(0.06, 0.25))
    if stage.chance(0.7):
        spots = [(rng.gauss(0, 3), rng.gauss(0, 3), -0.15) for _ in range(rng.randint(5, 25))]
        add_tree(stage, spots, rng.uniform(0.5, 1.4), 1500, rng.uniform(0.04, 0.1))
    if stage.chance(0.5):
        lawn(stage, 5.0, rng.randint(8000, 40000), rng.uniform(0.1, 0.4))
    daylight(stage)
    near = orbit(Vector((0, 0, 1.0)), (3, 7), (2, 40), (20, 85), spread=0.35, blur=0.3)
    up = orbit(Vector((0, 0, 3.0)), (3, 6), (-15, 10), (24, 85), spread=0.35, blur=0.3)
    return lambda r: (near if r.random() < 0.7 else up)(r)


def daylight(stage: Stage) -> None:
    """Light an outdoor scene by sky or picture."""
    if stage.chance(0.6):
        lights.sky_world(stage)
    else:
        lights.hdri_world(stage, outdoor=True)


def lawn(stage: Stage, radius: float, count: int, length: float) -> None:
    """Let grass grow on flat ground around the origin."""
    noise = np.random.default_rng(stage.rng.getrandbits(32))
    distance = radius * np.sqrt(noise.random(count))
    angle = noise.random(count) * 2 * math.pi
    roots = np.stack((distance * np.cos(angle), distance * np.sin(angle), np.zeros(count)), 1)
    lean = noise.normal(0, 0.25, (count, 3)) + np.array((0, 0, 1.0))
    strands(stage, roots, lean, length, length * 0.015 + 0.001, mat.leaf(stage.rng), 0.25)


@family("grass_hair")
def grass_hair(stage: Stage) -> ShotMaker:
    """Lawns, fur balls, brushes and carpets: tens of thousands of thin strands."""
    rng = stage.rng
    if stage.chance(0.4):
        objects.plane(stage, 60, ground_material(stage))
        lawn(stage, 2.0, rng.randint(20000, 60000), log_uniform(rng, 0.05, 0.35))
        for _ in range(rng.randint(1, 5)):
            mesh = objects.primitive_mesh(rng, rng.uniform(0.1, 0.5))
            obj = objects.add_mesh(stage, "shape", mesh, mat.pick(rng))
            obj.location = (rng.gauss(0, 0.6), rng.gauss(0, 0.6), 0)
            objects.rest(obj)
        daylight(stage)
        return orbit(Vector((0, 0, 0.1)), (0.8, 2.5), (5, 45), (28, 85), spread=0.4, blur=0.4)
    objects.plane(stage, 60, mat.pick(rng, mat.DULL))
    noise = np.random.default_rng(rng.getrandbits(32))
    for index in range(rng.randint(1, 4)):
        radius = rng.uniform(0.15, 0.4)
        mesh = objects.blob_mesh(rng, radius, 4) if stage.chance(0.6) else objects.sphere_mesh(radius)
        body = objects.add_mesh(stage, "skin", mesh, mat.skin(rng))
        center = Vector((index * 0.75 - 0.7, rng.gauss(0, 0.3), radius * 1.1))
        body.location = center
        count = len(mesh.vertices)
        where, normal = np.empty(count * 3, np.float32), np.empty(count * 3, np.float32)
        mesh.vertices.foreach_get("co", where)
        mesh.vertices.foreach_get("normal", normal)
        pick = noise.integers(0, count, rng.randint(6000, 25000))
        jitter = noise.normal(0, radius * 0.03, (len(pick), 3))
        roots = where.reshape(-1, 3)[pick] * 0.99 + jitter * 0.6 + np.array(center)
        long = radius * log_uniform(rng, 0.15, 1.0)
        thin = log_uniform(rng, 0.0006, 0.003)
        fur = hair_material(rng)
        strands(stage, roots, normal.reshape(-1, 3)[pick], long, thin, fur, rng.uniform(0.1, 0.6))
    if stage.chance(0.6):
        lights.random_world(stage)
    else:
        lights.gradient_world(stage, 0.1)
        lights.softboxes(stage, Vector((0, 0, 0.3)), 1.5, rng.randint(1, 3), 30)
    return orbit(Vector((0, 0, 0.3)), (0.9, 2.2), (5, 40), (35, 85), spread=0.3, blur=0.3)
