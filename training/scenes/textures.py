# SPDX-License-Identifier: Apache-2.0
"""Photographed and painted surfaces: image textures over the materials of a finished scene."""

from __future__ import annotations

import random
from functools import lru_cache

import bpy

from training import assets
from training.scenes import materials as mat
from training.scenes import nodes
from training.scenes.core import Stage, log_uniform

#: Start of a material's name -> kinds of pictures that suit it.
_SUITS: dict[str, tuple[str, ...]] = {
    "matte": ("stone", "cloth", "tile", "cloth"),
    "wood": ("wood",),
    "tiles": ("tile", "stone"),
    "stone": ("stone", "stone", "ground"),
    "cloth": ("cloth",),
    "metal": ("metal",),
    "plastic": ("cloth", "metal"),
}


@lru_cache(maxsize=32)
def _choices(kind: str, split: str) -> tuple[assets.Texture, ...]:
    return tuple(t for t in assets.textures() if t.kind == kind and t.split == split)


def choose(stage: Stage, kind: str) -> assets.Texture | None:
    """Return a random picture of a kind of surface, None where none is installed."""
    found = _choices(kind, stage.split)
    return stage.rng.choice(found) if found else None


def dress(stage: Stage) -> None:
    """Put image textures on some of a built scene's materials: a third of the scenes keep none."""
    share = stage.rng.choice((0.0, 0.35, 0.7))
    for material in sorted(bpy.data.materials, key=lambda m: m.name):
        kinds = _SUITS.get(material.name.split(".")[0])
        if kinds is None or not stage.chance(share * (0.4 if material.name.startswith(("metal", "plastic")) else 1.0)):
            continue
        texture = choose(stage, stage.rng.choice(kinds))
        if texture is not None:
            cover(material, stage.rng, texture)


def _picture_node(
    tree: nodes.NodeTree, path: str, vector: nodes.Socket, colorspace: str = "sRGB"
) -> bpy.types.ShaderNodeTexImage:
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(path, check_existing=True)
    node.image.colorspace_settings.name = colorspace
    node.projection, node.projection_blend = "BOX", 0.15
    tree.links.new(vector, node.inputs["Vector"])
    return node


def cover(material: bpy.types.Material, rng: random.Random, texture: assets.Texture) -> None:
    """Project a picture on a surface from three sides as its colour, relief and gloss."""
    tree, shader = material.node_tree, mat.principled_of(material)
    base = shader.inputs["Base Color"]
    own = tuple(base.default_value)[:3]
    scale = log_uniform(rng, 0.4, 2.0) if texture.kind in ("tile", "ground") else log_uniform(rng, 0.5, 6.0)
    vector = nodes.coordinates(tree, rng, scale)
    picture = _picture_node(tree, str(texture.path), vector)
    color = picture.outputs["Color"]
    # Grey pictures are meant to be tinted, and any other may be.
    if texture.kind == "cloth" or rng.random() < 0.3:
        multiply = tree.nodes.new("ShaderNodeMix")
        multiply.data_type, multiply.blend_type = "RGBA", "MULTIPLY"
        multiply.inputs["Factor"].default_value = 1.0
        tree.links.new(color, multiply.inputs[6])
        multiply.inputs[7].default_value = mat.rgba(mat.mix_color(own, (1, 1, 1), rng.uniform(0.2, 0.7)))
        color = multiply.outputs[2]
    tree.links.new(color, base)
    if rng.random() < 0.6:
        height = picture.outputs["Color"]
        if texture.height is not None:
            height = _picture_node(tree, str(texture.height), vector, "Non-Color").outputs["Color"]
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = rng.uniform(0.2, 1.0)
        bump.inputs["Distance"].default_value = 0.02 / scale
        tree.links.new(height, bump.inputs["Height"])
        tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    if rng.random() < 0.4 and not shader.inputs["Roughness"].is_linked:
        rough = shader.inputs["Roughness"].default_value
        value = nodes.map_range(tree, picture.outputs["Color"], min(1.0, rough + 0.25), max(0.03, rough - 0.25))
        tree.links.new(value, shader.inputs["Roughness"])


def picture_material(stage: Stage) -> bpy.types.Material:
    """Return a printed or painted picture that fills whatever box it is put on."""
    rng = stage.rng
    material = mat.new_material("picture", Roughness=rng.choice((0.05, 0.4, 0.9)))
    texture = choose(stage, rng.choice(("picture", "picture", "cloth", "tile")))
    if texture is None:
        colors = [mat.random_color(rng, 0.9) for _ in range(4)]
        return mat.texture_color(material, rng, colors, log_uniform(rng, 2, 20))
    tree = material.node_tree
    source = tree.nodes.new("ShaderNodeTexCoord")
    node = _picture_node(tree, str(texture.path), source.outputs["Generated"])
    tree.links.new(node.outputs["Color"], mat.principled_of(material).inputs["Base Color"])
    return material
