# SPDX-License-Identifier: Apache-2.0
"""Lamps, skies and environment pictures."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from pathlib import Path

import bpy
from mathutils import Vector

from training import assets
from training.scenes.core import Stage, log_uniform
from training.scenes.materials import Color, blackbody, rgba

#: Places that only validation scenes are lit by, from whichever source.
_VAL_PLACES = {"courtyard", "sunrise", "lobby", "venice", "bridge", "workshop"}
_INDOOR_PLACES = {"interior", "studio", "apartment", "hall", "lab", "lobby", "warehouse", "workshop"}


def environment_pictures(split: str, outdoor: bool = False) -> dict[str, list[Path]]:
    """Return the environment pictures of a split by place: Blender's own and those of the asset package."""
    own = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
    places: dict[str, list[Path]] = {}
    for path in (*sorted(own.glob("*.exr")), *assets.environments()):
        held_out = path.stem in _VAL_PLACES
        if held_out == (split == "val") and not (outdoor and path.stem in _INDOOR_PLACES):
            places.setdefault(path.stem, []).append(path)
    return places


def lamp(
    stage: Stage,
    kind: str,
    location: Sequence[float],
    energy: float,
    target: Sequence[float] | None = None,
    color: Color | None = None,
    size: float = 0.1,
    size_y: float | None = None,
) -> bpy.types.Object:
    """Add a lamp: POINT, SPOT, AREA or SUN (size in metres; for SUN in degrees)."""
    data = bpy.data.lights.new(kind.lower(), kind)
    data.energy = energy
    data.color = color or blackbody(stage.rng)
    if kind == "AREA":
        data.shape = "RECTANGLE" if size_y else stage.rng.choice(("SQUARE", "DISK"))
        data.size = size
        if size_y:
            data.size_y = size_y
    elif kind == "SUN":
        data.angle = math.radians(size)
    else:
        data.shadow_soft_size = size
    if kind == "SPOT":
        data.spot_size = math.radians(stage.rng.uniform(20, 90))
        data.spot_blend = stage.rng.random()
    obj = bpy.data.objects.new(kind.lower(), data)
    stage.scene.collection.objects.link(obj)
    obj.location = location
    if target is not None:
        direction = Vector(target) - Vector(location)
        obj.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()
    return obj


def _world_nodes(stage: Stage) -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    world = bpy.data.worlds.new("World")
    stage.scene.world = world
    world.use_nodes = True
    return world.node_tree, world.node_tree.nodes["Background"]


def plain_world(stage: Stage, color: Color, strength: float) -> None:
    """Light the scene evenly from everywhere."""
    _, background = _world_nodes(stage)
    background.inputs["Color"].default_value = rgba(color)
    background.inputs["Strength"].default_value = strength


def gradient_world(stage: Stage, strength: float = 1.0) -> None:
    """Light the scene by a soft gradient from ground to sky."""
    tree, background = _world_nodes(stage)
    source = tree.nodes.new("ShaderNodeTexCoord")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    tree.links.new(source.outputs["Generated"], split.inputs["Vector"])
    tree.links.new(split.outputs["Z"], ramp.inputs["Fac"])
    sky = blackbody(stage.rng, 5500, 9000)
    ground = stage.rng.uniform(0.05, 0.4)
    ramp.color_ramp.elements[0].color = rgba([c * ground for c in blackbody(stage.rng)])
    ramp.color_ramp.elements[1].color = rgba(sky)
    tree.links.new(ramp.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength


def hdri_world(stage: Stage, strength: float | None = None, place: str | None = None, outdoor: bool = False) -> None:
    """Light the scene by an environment picture turned at random; any place where the wanted one is not to be had."""
    rng = stage.rng
    places = environment_pictures(stage.split, outdoor)
    path = rng.choice(places[place if place in places else rng.choice(sorted(places))])
    tree, background = _world_nodes(stage)
    source = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str(path))
    mapping.inputs["Rotation"].default_value = (0, 0, rng.uniform(0, 2 * math.pi))
    tree.links.new(source.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    tree.links.new(picture.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength or log_uniform(rng, 0.4, 2.0)


def sky_world(stage: Stage, elevation: tuple[float, float] = (4, 65), strength: float = 0.3) -> float:
    """Light the scene by a physical sky with its sun; return the sun's azimuth."""
    tree, background = _world_nodes(stage)
    sky = tree.nodes.new("ShaderNodeTexSky")
    kinds = {item.identifier for item in sky.bl_rna.properties["sky_type"].enum_items}
    # Blender 5 renamed the model that has a sun disc.
    sky.sky_type = "NISHITA" if "NISHITA" in kinds else "MULTIPLE_SCATTERING"
    azimuth = stage.rng.uniform(0, 2 * math.pi)
    sky.sun_rotation = azimuth
    sky.sun_elevation = math.radians(stage.rng.uniform(*elevation))
    sky.sun_size = math.radians(log_uniform(stage.rng, 0.3, 4.0))
    sky.sun_disc = stage.chance(0.8)
    sky.air_density = stage.rng.uniform(0.6, 2.5)
    dust = stage.rng.uniform(0.2, 4.0)
    setattr(sky, "dust_density" if hasattr(sky, "dust_density") else "aerosol_density", dust)
    sky.sun_intensity = stage.rng.uniform(0.4, 1.0)
    tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength
    return azimuth


def random_world(stage: Stage, fill: float = 1.0) -> None:
    """Light the scene by any kind of surroundings."""
    draw = stage.rng.random()
    if draw < 0.5:
        hdri_world(stage)
    elif draw < 0.75:
        sky_world(stage)
    elif draw < 0.9:
        gradient_world(stage, fill)
    else:
        plain_world(stage, blackbody(stage.rng), fill)


def softboxes(stage: Stage, center: Vector, radius: float, count: int, energy: float) -> None:
    """Put area lamps of a photo studio around and above a subject."""
    rng = stage.rng
    for _ in range(count):
        angle = rng.uniform(0, 2 * math.pi)
        height = rng.uniform(0.4, 1.6) * radius
        distance = rng.uniform(0.8, 1.5) * radius
        location = center + Vector((math.cos(angle) * distance, math.sin(angle) * distance, height))
        size = log_uniform(rng, 0.1, 1.0) * radius
        lamp(
            stage,
            "AREA",
            location,
            energy * radius**2 * log_uniform(rng, 0.3, 3.0),
            center,
            size=size,
            size_y=size * rng.uniform(0.3, 2.0) if stage.chance(0.6) else None,
        )


def scatter_lamps(stage: Stage, low: Vector, high: Vector, count: int, energy: float, colored: float = 0.3) -> None:
    """Fill a box with point and spot lamps of mixed size, power and colour."""
    rng = stage.rng
    for _ in range(count):
        location = [rng.uniform(a, b) for a, b in zip(low, high, strict=True)]
        hue = random_light_color(rng) if stage.chance(colored) else blackbody(rng)
        kind = rng.choice(("POINT", "POINT", "SPOT", "AREA"))
        target = [rng.uniform(a, b) for a, b in zip(low, high, strict=True)]
        target[2] = low[2]
        size = log_uniform(rng, 0.01, 0.4)
        power = energy * log_uniform(rng, 0.3, 3.0) * (4 if kind == "SPOT" else 1)
        lamp(stage, kind, location, power, target, hue, size)


def random_light_color(rng: random.Random) -> Color:
    """Return the colour of a neon tube or stage lamp."""
    import colorsys

    return colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.5, 1.0), 1.0)


def scale_lights(scene: bpy.types.Scene, factor: float) -> None:
    """Multiply everything that shines, so that a scene gets the brightness meant for it."""
    for light in bpy.data.lights:
        light.energy *= factor
    if scene.world and scene.world.use_nodes:
        for node in scene.world.node_tree.nodes:
            if node.type == "BACKGROUND":
                node.inputs["Strength"].default_value *= factor
    for material in bpy.data.materials:
        if not material.use_nodes:
            continue
        for node in material.node_tree.nodes:
            name = {
                "BSDF_PRINCIPLED": "Emission Strength",
                "EMISSION": "Strength",
                "PRINCIPLED_VOLUME": "Emission Strength",
            }.get(node.type)
            if name:
                node.inputs[name].default_value *= factor
