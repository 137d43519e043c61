# SPDX-License-Identifier: Apache-2.0
"""Randomised materials: what artists use, from plain paint to thin film and velvet."""

from __future__ import annotations

import colorsys
import random
from collections.abc import Callable, Sequence

import bpy

from training.scenes import nodes
from training.scenes.core import log_uniform
from training.scenes.nodes import Color, rgba

Material = bpy.types.Material


def random_color(rng: random.Random, saturation: float = 0.6, value: float = 0.7) -> Color:
    """Return a believable surface colour: mostly muted, seldom pure."""
    s = min(0.85, abs(rng.gauss(0, saturation * 0.6)))
    v = min(0.92, max(0.02, rng.betavariate(2, 2) * value * 1.4))
    return colorsys.hsv_to_rgb(rng.random(), s, v)


def warm_color(rng: random.Random) -> Color:
    """Return a colour of wood, leather, stone or plaster."""
    hue, s = rng.uniform(0.03, 0.12), rng.uniform(0.1, 0.7)
    return colorsys.hsv_to_rgb(hue, s, rng.uniform(0.08, 0.75))


def blackbody(rng: random.Random, low: float = 2200, high: float = 7500) -> Color:
    """Return the colour of a lamp by its temperature, brightest component 1."""
    t = rng.uniform(low, high) / 100
    red = 1.0 if t <= 66 else min(1.0, 1.29 * (t - 60) ** -0.133)
    green = min(1.0, max(0.0, 0.39 * (t**0.45) * 0.36 + 0.05)) if t <= 66 else 0.95
    blue = 0.05 if t <= 19 else min(1.0, max(0.05, (t - 15) / 52))
    return red, green, blue


def mix_color(a: Color, b: Color, t: float) -> Color:
    """Blend two colours."""
    return tuple(x + (y - x) * t for x, y in zip(a, b, strict=True))


def new_material(name: str, **inputs: object) -> Material:
    """Return a Principled material; keywords are input names with _ for spaces."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = principled_of(material)
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return material


def principled_of(material: Material) -> bpy.types.Node:
    """Return the Principled node of a material made here."""
    return material.node_tree.nodes["Principled BSDF"]


def texture_color(
    material: Material,
    rng: random.Random,
    colors: Sequence[Color],
    scale: float | None = None,
    kinds: Sequence[str] = (),
) -> Material:
    """Drive the base colour (and sometimes roughness) by a procedural pattern."""
    tree, shader = material.node_tree, principled_of(material)
    value = nodes.pattern(tree, rng, scale or log_uniform(rng, 2, 60), kinds)
    tree.links.new(nodes.ramp(tree, rng, value, colors), shader.inputs["Base Color"])
    if rng.random() < 0.3:
        rough = shader.inputs["Roughness"].default_value
        out = nodes.map_range(tree, value, max(0.02, rough - 0.2), min(1.0, rough + 0.25))
        tree.links.new(out, shader.inputs["Roughness"])
    return material


def add_bump(material: Material, rng: random.Random, scale: float | None = None, kinds: Sequence[str] = ()) -> Material:
    """Give a surface small relief."""
    tree, shader = material.node_tree, principled_of(material)
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = rng.uniform(0.1, 0.9)
    scale = scale or log_uniform(rng, 8, 200)
    bump.inputs["Distance"].default_value = 0.3 / scale
    value = nodes.pattern(tree, rng, scale, kinds)
    tree.links.new(value, bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def diffuse(rng: random.Random, color: Color | None = None) -> Material:
    """Return matte paint, plaster or paper."""
    color = color or random_color(rng)
    material = new_material(
        "matte",
        Base_Color=rgba(color),
        Roughness=rng.uniform(0.6, 1.0),
        Specular_IOR_Level=rng.choice((0.0, 0.3, 0.5)),
    )
    if rng.random() < 0.3:
        texture_color(material, rng, (color, random_color(rng)))
    return material


def plastic(rng: random.Random, color: Color | None = None) -> Material:
    """Return glossy paint or plastic, sometimes with a clear coat."""
    color = color or random_color(rng, 0.9, 0.8)
    material = new_material(
        "plastic",
        Base_Color=rgba(color),
        Roughness=log_uniform(rng, 0.05, 0.5),
        Coat_Weight=rng.choice((0.0, 0.0, 1.0)),
        Coat_Roughness=rng.uniform(0.0, 0.1),
    )
    if rng.random() < 0.2:
        texture_color(material, rng, (color, random_color(rng), random_color(rng)))
    if rng.random() < 0.15:
        add_bump(material, rng)
    return material


METALS: tuple[Color, ...] = (
    (0.92, 0.92, 0.93),
    (0.56, 0.57, 0.58),
    (1.0, 0.77, 0.34),
    (0.95, 0.64, 0.54),
    (0.91, 0.92, 0.92),
    (0.66, 0.61, 0.53),
    (0.4, 0.42, 0.45),
)


def metal(rng: random.Random, color: Color | None = None) -> Material:
    """Return polished to rough metal, a third of it brushed."""
    color = color or rng.choice(METALS)
    material = new_material("metal", Base_Color=rgba(color), Metallic=1.0, Roughness=log_uniform(rng, 0.03, 0.5))
    if rng.random() < 0.35:
        brush(material, rng)
    elif rng.random() < 0.3:
        tree, shader = material.node_tree, principled_of(material)
        value = nodes.pattern(tree, rng, log_uniform(rng, 5, 60), ("noise", "voronoi"))
        low = rng.uniform(0.03, 0.2)
        tree.links.new(nodes.map_range(tree, value, low, low + 0.4), shader.inputs["Roughness"])
    if rng.random() < 0.2:
        add_bump(material, rng)
    return material


def brush(material: Material, rng: random.Random) -> Material:
    """Make a metal anisotropic, with visible streaks half of the time."""
    tree, shader = material.node_tree, principled_of(material)
    shader.inputs["Anisotropic"].default_value = rng.uniform(0.5, 0.95)
    shader.inputs["Anisotropic Rotation"].default_value = rng.choice((0.0, 0.25, 0.5))
    shader.inputs["Roughness"].default_value = rng.uniform(0.2, 0.45)
    # Across the surface, from a tilted axis: a radial tangent of a flat thing is 0/0, and
    # Cycles 4.5 then writes NaN into the glossy passes.
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    cross = tree.nodes.new("ShaderNodeVectorMath")
    cross.operation = "CROSS_PRODUCT"
    cross.inputs[1].default_value = [rng.uniform(0.1, 1.0) for _ in range(3)]
    tree.links.new(geometry.outputs["Normal"], cross.inputs[0])
    tree.links.new(cross.outputs["Vector"], shader.inputs["Tangent"])
    if rng.random() < 0.5:
        vector = nodes.coordinates(tree, rng, 1.0)
        mapping = vector.node
        scale = [4.0, 4.0, 4.0]
        scale[rng.randrange(3)] = rng.uniform(200, 900)
        mapping.inputs["Scale"].default_value = scale
        noise = tree.nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value = 1.0
        tree.links.new(vector, noise.inputs["Vector"])
        tree.links.new(nodes.map_range(tree, noise.outputs["Fac"], 0.1, 0.5), shader.inputs["Roughness"])
    return material


def mirror(rng: random.Random) -> Material:
    """Return a perfect or nearly perfect mirror."""
    return new_material(
        "mirror",
        Base_Color=rgba((0.93, 0.94, 0.94)),
        Metallic=1.0,
        Roughness=rng.choice((0.0, 0.0, 0.01, 0.04)),
    )


def glass(rng: random.Random, color: Color | None = None, rough: bool | None = None) -> Material:
    """Return clear, tinted or frosted glass."""
    if color is None:
        tint = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.05, 0.5), rng.uniform(0.85, 1.0))
        color = (1.0, 1.0, 1.0) if rng.random() < 0.55 else tint
    frosted = rng.random() < 0.2 if rough is None else rough
    return new_material(
        "glass",
        Base_Color=rgba(color),
        Transmission_Weight=1.0,
        Roughness=rng.uniform(0.08, 0.4) if frosted else 0.0,
        IOR=rng.uniform(1.3, 1.6),
    )


def pane(rng: random.Random) -> Material:
    """Return window glass that lets shadow rays through, as archviz artists build it."""
    material = bpy.data.materials.new("pane")
    material.use_nodes = True
    tree = material.node_tree
    clear = tree.nodes.new("ShaderNodeBsdfTransparent")
    clear.inputs["Color"].default_value = rgba((rng.uniform(0.85, 1.0),) * 3)
    glossy = tree.nodes.new("ShaderNodeBsdfGlossy")
    glossy.inputs["Roughness"].default_value = 0.0
    fresnel = tree.nodes.new("ShaderNodeFresnel")
    fresnel.inputs["IOR"].default_value = 1.3
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(fresnel.outputs[0], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(glossy.outputs[0], mix.inputs[2])
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def skin(rng: random.Random, color: Color | None = None, size: float = 1.0) -> Material:
    """Return wax, marble, milk, fruit or skin; size is how far light spreads, in metres."""
    material = new_material(
        "subsurface",
        Base_Color=rgba(color or random_color(rng, 0.8, 0.9)),
        Roughness=rng.uniform(0.15, 0.6),
        Subsurface_Weight=rng.choice((1.0, 1.0, 0.5)),
        Subsurface_Radius=[rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.6), rng.uniform(0.05, 0.5)],
        Subsurface_Scale=log_uniform(rng, 0.01, 0.15) * size,
    )
    principled_of(material).subsurface_method = "RANDOM_WALK"
    return material


def cloth(rng: random.Random, color: Color | None = None) -> Material:
    """Return fabric: sheen, weave relief, sometimes a print."""
    color = color or random_color(rng)
    material = new_material(
        "cloth",
        Base_Color=rgba(color),
        Roughness=rng.uniform(0.7, 1.0),
        Specular_IOR_Level=0.1,
        Sheen_Weight=rng.choice((0.0, 0.5, 1.0)),
        Sheen_Roughness=rng.uniform(0.2, 0.7),
    )
    if rng.random() < 0.45:
        texture_color(material, rng, (color, random_color(rng), random_color(rng)))
    if rng.random() < 0.5:
        add_bump(material, rng, log_uniform(rng, 80, 500), ("checker", "wave", "noise"))
    return material


def wood(rng: random.Random, color: Color | None = None) -> Material:
    """Return wood with grain: stretched noise through a ramp of browns."""
    color = color or warm_color(rng)
    material = new_material(
        "wood",
        Base_Color=rgba(color),
        Roughness=rng.uniform(0.15, 0.7),
        Coat_Weight=rng.choice((0.0, 0.0, 0.6)),
        Coat_Roughness=rng.uniform(0.02, 0.2),
    )
    tree, shader = material.node_tree, principled_of(material)
    vector = nodes.coordinates(tree, rng, 1.0)
    scale = [rng.uniform(8, 30)] * 3
    scale[rng.randrange(2)] = rng.uniform(0.8, 3)
    vector.node.inputs["Scale"].default_value = scale
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = 1.0
    noise.inputs["Detail"].default_value = rng.uniform(3, 10)
    noise.inputs["Distortion"].default_value = rng.uniform(0, 2.5)
    tree.links.new(vector, noise.inputs["Vector"])
    dark = mix_color(color, (0, 0, 0), rng.uniform(0.3, 0.7))
    light = mix_color(color, (1, 0.9, 0.7), rng.uniform(0.0, 0.25))
    value = noise.outputs["Fac"]
    tree.links.new(nodes.ramp(tree, rng, value, (dark, color, light)), shader.inputs["Base Color"])
    if rng.random() < 0.4:
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = rng.uniform(0.1, 0.5)
        bump.inputs["Distance"].default_value = 0.01
        tree.links.new(value, bump.inputs["Height"])
        tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def tiles(rng: random.Random, scale: float | None = None) -> Material:
    """Return bricks, tiles or planks with joints that are rougher than the rest."""
    material = new_material("tiles", Roughness=log_uniform(rng, 0.04, 0.8))
    tree, shader = material.node_tree, principled_of(material)
    node = tree.nodes.new("ShaderNodeTexBrick")
    base = random_color(rng, 0.5) if rng.random() < 0.5 else warm_color(rng)
    node.offset = rng.choice((0.0, 0.5, 0.5, 0.33))
    node.inputs["Color1"].default_value = rgba(base)
    node.inputs["Color2"].default_value = rgba(mix_color(base, random_color(rng), 0.35))
    node.inputs["Mortar"].default_value = rgba(random_color(rng, 0.1, 0.8))
    node.inputs["Scale"].default_value = 1.0
    node.inputs["Mortar Size"].default_value = rng.uniform(0.008, 0.03)
    node.inputs["Brick Width"].default_value = rng.choice((0.5, 1.0, 2.0))
    node.inputs["Row Height"].default_value = 0.5
    tree.links.new(nodes.box_coordinates(tree, rng, scale or log_uniform(rng, 1.0, 8.0)), node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    low = shader.inputs["Roughness"].default_value
    tree.links.new(nodes.map_range(tree, node.outputs["Fac"], low, min(1.0, low + 0.5)), shader.inputs["Roughness"])
    bump = tree.nodes.new("ShaderNodeBump")
    bump.invert = True
    bump.inputs["Strength"].default_value = rng.uniform(0.3, 1.0)
    bump.inputs["Distance"].default_value = 0.01
    tree.links.new(node.outputs["Fac"], bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def film(rng: random.Random) -> Material:
    """Return iridescent metal or glass."""
    material = metal(rng) if rng.random() < 0.6 else glass(rng)
    shader = principled_of(material)
    shader.inputs["Thin Film Thickness"].default_value = rng.uniform(200, 900)
    return material


def stone(rng: random.Random, color: Color | None = None) -> Material:
    """Return concrete, marble or rock: layered noise with relief."""
    color = color or mix_color(warm_color(rng), (0.5, 0.5, 0.5), rng.uniform(0.3, 1.0))
    material = new_material("stone", Base_Color=rgba(color), Roughness=rng.choice((0.1, 0.4, 0.8, 0.95)))
    dark = mix_color(color, (0, 0, 0), rng.uniform(0.2, 0.6))
    texture_color(material, rng, (dark, color), log_uniform(rng, 2, 30), ("noise", "noise", "voronoi"))
    if rng.random() < 0.6:
        add_bump(material, rng, log_uniform(rng, 5, 80), ("noise", "voronoi", "cells"))
    return material


def glow(rng: random.Random, strength: float, color: Color | None = None) -> Material:
    """Return a light-emitting surface."""
    return new_material(
        "glow",
        Base_Color=rgba((0, 0, 0)),
        Emission_Color=rgba(color or blackbody(rng)),
        Emission_Strength=strength,
    )


def leaf(rng: random.Random) -> Material:
    """Return a leaf: green, a little shiny, letting light through."""
    hue = rng.choice((rng.uniform(0.2, 0.36), rng.uniform(0.2, 0.36), rng.uniform(0.04, 0.14)))
    color = colorsys.hsv_to_rgb(hue, rng.uniform(0.5, 0.9), rng.uniform(0.15, 0.5))
    material = new_material("leaf", Base_Color=rgba(color), Roughness=rng.uniform(0.3, 0.7))
    tree = material.node_tree
    through = tree.nodes.new("ShaderNodeBsdfTranslucent")
    through.inputs["Color"].default_value = rgba(mix_color(color, (0.7, 0.8, 0.1), 0.4))
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = rng.uniform(0.2, 0.5)
    tree.links.new(principled_of(material).outputs["BSDF"], mix.inputs[1])
    tree.links.new(through.outputs["BSDF"], mix.inputs[2])
    output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
    tree.links.new(mix.outputs["Shader"], output.inputs["Surface"])
    return material


MaterialMaker = Callable[[random.Random], Material]

#: Everything a solid object may be made of, with how often artists would choose it.
SOLIDS: tuple[tuple[MaterialMaker, float], ...] = (
    (diffuse, 4),
    (plastic, 4),
    (metal, 3),
    (mirror, 0.6),
    (glass, 1.5),
    (skin, 1),
    (cloth, 1.5),
    (wood, 2),
    (tiles, 0.7),
    (stone, 1.5),
    (film, 0.4),
)

#: The opaque, unspectacular part of it: for walls and furniture.
DULL: tuple[tuple[MaterialMaker, float], ...] = (
    (diffuse, 4),
    (plastic, 2),
    (metal, 0.8),
    (cloth, 2),
    (wood, 3),
    (stone, 0.7),
)


def pick(rng: random.Random, choices: Sequence[tuple[MaterialMaker, float]] = SOLIDS) -> Material:
    """Return a new random material out of a weighted list."""
    makers, weights = zip(*choices, strict=True)
    return rng.choices(makers, weights)[0](rng)
