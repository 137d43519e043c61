# SPDX-License-Identifier: Apache-2.0
"""Randomised materials: what artists use, from plain paint to thin film and velvet."""

from __future__ import annotations

import colorsys
import random
from collections.abc import Callable, Sequence

import bpy

from training.scenes.core import log_uniform

Color = tuple[float, float, float]
Material = bpy.types.Material
NodeTree = bpy.types.NodeTree
Socket = bpy.types.NodeSocket


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


def rgba(color: Sequence[float]) -> tuple[float, float, float, float]:
    """Return a colour with alpha 1."""
    return color[0], color[1], color[2], 1.0


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


def texture_color(
    material: Material,
    rng: random.Random,
    colors: Sequence[Color],
    scale: float | None = None,
    kinds: Sequence[str] = (),
) -> Material:
    """Drive the base colour (and sometimes roughness) by a procedural pattern."""
    tree, shader = material.node_tree, principled_of(material)
    value = pattern(tree, rng, scale or log_uniform(rng, 2, 60), kinds)
    tree.links.new(ramp(tree, rng, value, colors), shader.inputs["Base Color"])
    if rng.random() < 0.3:
        rough = shader.inputs["Roughness"].default_value
        out = map_range(tree, value, max(0.02, rough - 0.2), min(1.0, rough + 0.25))
        tree.links.new(out, shader.inputs["Roughness"])
    return material


def add_bump(material: Material, rng: random.Random, scale: float | None = None, kinds: Sequence[str] = ()) -> Material:
    """Give a surface small relief."""
    tree, shader = material.node_tree, principled_of(material)
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = rng.uniform(0.1, 0.9)
    scale = scale or log_uniform(rng, 8, 200)
    bump.inputs["Distance"].default_value = 0.3 / scale
    value = pattern(tree, rng, scale, kinds)
    tree.links.new(value, bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


def add_image(material: Material, rng: random.Random, image: bpy.types.Image, scale: float) -> Material:
    """Project an image onto a surface from three sides; scale in repeats per metre."""
    tree, shader = material.node_tree, principled_of(material)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    node.projection = "BOX"
    node.projection_blend = 0.2
    tree.links.new(coordinates(tree, random.Random(0), scale), node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    if rng.random() < 0.5:
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = rng.uniform(0.1, 0.6)
        bump.inputs["Distance"].default_value = 0.01
        tree.links.new(node.outputs["Color"], bump.inputs["Height"])
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
        value = pattern(tree, rng, log_uniform(rng, 5, 60), ("noise", "voronoi"))
        low = rng.uniform(0.03, 0.2)
        tree.links.new(map_range(tree, value, low, low + 0.4), shader.inputs["Roughness"])
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
        vector = coordinates(tree, rng, 1.0)
        mapping = vector.node
        scale = [4.0, 4.0, 4.0]
        scale[rng.randrange(3)] = rng.uniform(200, 900)
        mapping.inputs["Scale"].default_value = scale
        noise = tree.nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value = 1.0
        tree.links.new(vector, noise.inputs["Vector"])
        tree.links.new(map_range(tree, noise.outputs["Fac"], 0.1, 0.5), shader.inputs["Roughness"])
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
    vector = coordinates(tree, rng, 1.0)
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
    tree.links.new(ramp(tree, rng, value, (dark, color, light)), shader.inputs["Base Color"])
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
    tree.links.new(box_coordinates(tree, rng, scale or log_uniform(rng, 1.0, 8.0)), node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    low = shader.inputs["Roughness"].default_value
    tree.links.new(map_range(tree, node.outputs["Fac"], low, min(1.0, low + 0.5)), shader.inputs["Roughness"])
    bump = tree.nodes.new("ShaderNodeBump")
    bump.invert = True
    bump.inputs["Strength"].default_value = rng.uniform(0.3, 1.0)
    bump.inputs["Distance"].default_value = 0.01
    tree.links.new(node.outputs["Fac"], bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material


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
