# SPDX-License-Identifier: Apache-2.0
"""Shader nodes that materials are put together from: coordinates, patterns, colour ramps."""

from __future__ import annotations

import random
from collections.abc import Sequence

import bpy

Color = tuple[float, float, float]
NodeTree = bpy.types.NodeTree
Socket = bpy.types.NodeSocket


def rgba(color: Sequence[float]) -> tuple[float, float, float, float]:
    """Return a colour with alpha 1."""
    return color[0], color[1], color[2], 1.0


def coordinates(tree: NodeTree, rng: random.Random, scale: float, kind: str | None = None) -> Socket:
    """Return texture coordinates turned at random; scale is features per metre."""
    source = tree.nodes.new("ShaderNodeTexCoord")
    mapping = tree.nodes.new("ShaderNodeMapping")
    tree.links.new(source.outputs[kind or "Object"], mapping.inputs["Vector"])
    mapping.inputs["Scale"].default_value = (scale,) * 3
    mapping.inputs["Location"].default_value = [rng.uniform(-9, 9) for _ in range(3)]
    if rng.random() < 0.4:
        mapping.inputs["Rotation"].default_value = [rng.uniform(-3, 3) for _ in range(3)]
    return mapping.outputs["Vector"]


#: Bold patterns are rare: most surfaces are uneven rather than striped.
_PATTERNS = ("noise",) * 6 + ("voronoi",) * 3 + ("cells", "wave", "checker", "brick", "rings", "magic")


def pattern(tree: NodeTree, rng: random.Random, scale: float, kinds: Sequence[str] = ()) -> Socket:
    """Return a value between about 0 and 1 from a random procedural texture."""
    kind = rng.choice(kinds or _PATTERNS)
    vector = coordinates(tree, rng, scale)
    if kind == "noise":
        node = tree.nodes.new("ShaderNodeTexNoise")
        node.inputs["Scale"].default_value = 1.0
        node.inputs["Detail"].default_value = rng.uniform(0, 9)
        node.inputs["Roughness"].default_value = rng.uniform(0.3, 0.8)
        node.inputs["Distortion"].default_value = rng.choice((0.0, 0.0, rng.uniform(0, 3)))
        output = node.outputs["Fac"]
    elif kind in ("voronoi", "cells"):
        node = tree.nodes.new("ShaderNodeTexVoronoi")
        node.feature = "DISTANCE_TO_EDGE" if kind == "cells" else "F1"
        node.inputs["Scale"].default_value = 1.0
        output = node.outputs["Distance"]
    elif kind in ("wave", "rings"):
        node = tree.nodes.new("ShaderNodeTexWave")
        node.wave_type = "RINGS" if kind == "rings" else "BANDS"
        node.wave_profile = rng.choice(("SIN", "SAW", "TRI"))
        node.inputs["Scale"].default_value = 0.4
        node.inputs["Distortion"].default_value = rng.uniform(0, 8)
        node.inputs["Detail"].default_value = rng.uniform(0, 4)
        output = node.outputs["Fac"]
    elif kind == "checker":
        node = tree.nodes.new("ShaderNodeTexChecker")
        node.inputs["Scale"].default_value = 1.0
        output = node.outputs["Fac"]
    elif kind == "brick":
        node = tree.nodes.new("ShaderNodeTexBrick")
        node.inputs["Scale"].default_value = 1.0
        node.inputs["Mortar Size"].default_value = rng.uniform(0.01, 0.06)
        node.inputs["Color1"].default_value = rgba((1, 1, 1))
        node.inputs["Color2"].default_value = rgba((0.5, 0.5, 0.5))
        node.inputs["Mortar"].default_value = rgba((0, 0, 0))
        output = node.outputs["Color"]
    else:
        node = tree.nodes.new("ShaderNodeTexMagic")
        node.turbulence_depth = rng.randint(1, 5)
        node.inputs["Scale"].default_value = 0.5
        output = node.outputs["Fac"]
    tree.links.new(vector, node.inputs["Vector"])
    return output


def ramp(tree: NodeTree, rng: random.Random, value: Socket, colors: Sequence[Color]) -> Socket:
    """Return a colour picked along a ramp by a value; hard steps now and then."""
    node = tree.nodes.new("ShaderNodeValToRGB")
    node.color_ramp.interpolation = rng.choice(("LINEAR", "LINEAR", "EASE", "EASE", "CONSTANT"))
    elements = node.color_ramp.elements
    while len(elements) < len(colors):
        elements.new(0.5)
    low, high = sorted((rng.uniform(0.1, 0.5), rng.uniform(0.5, 0.9)))
    for index, color in enumerate(colors):
        elements[index].position = low + (high - low) * index / max(1, len(colors) - 1)
        elements[index].color = rgba(color)
    tree.links.new(value, node.inputs["Fac"])
    return node.outputs["Color"]


def map_range(tree: NodeTree, value: Socket, low: float, high: float) -> Socket:
    """Return a 0..1 value stretched to another range."""
    node = tree.nodes.new("ShaderNodeMapRange")
    tree.links.new(value, node.inputs["Value"])
    node.inputs["To Min"].default_value = low
    node.inputs["To Max"].default_value = high
    return node.outputs["Result"]


def box_coordinates(tree: NodeTree, rng: random.Random, scale: float) -> Socket:
    """Return flat coordinates that follow walls and floors alike.

    Brick textures use x and y only; a plain object coordinate would smear them on
    walls, so x becomes x + y and y becomes z wherever the surface is upright.
    """
    source = tree.nodes.new("ShaderNodeTexCoord")
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    normal = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(source.outputs["Object"], split.inputs["Vector"])
    tree.links.new(geometry.outputs["True Normal"], normal.inputs["Vector"])

    def math_node(operation: str, a: Socket, b: Socket | float) -> Socket:
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        tree.links.new(a, node.inputs[0])
        if isinstance(b, float):
            node.inputs[1].default_value = b
        else:
            tree.links.new(b, node.inputs[1])
        return node.outputs[0]

    flat = math_node("GREATER_THAN", math_node("ABSOLUTE", normal.outputs["Z"], 0.0), 0.6)
    upright = math_node("ADD", split.outputs["X"], split.outputs["Y"])
    wall = tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(upright, wall.inputs["X"])
    tree.links.new(split.outputs["Z"], wall.inputs["Y"])
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "VECTOR"
    tree.links.new(flat, mix.inputs["Factor"])
    tree.links.new(wall.outputs["Vector"], mix.inputs["A"])
    tree.links.new(source.outputs["Object"], mix.inputs["B"])
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (scale,) * 3
    mapping.inputs["Location"].default_value = [rng.uniform(-9, 9) for _ in range(3)]
    tree.links.new(mix.outputs["Result"], mapping.inputs["Vector"])
    return mapping.outputs["Vector"]
