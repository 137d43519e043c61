#!/usr/bin/env python3
"""Write the EXR fixtures of this folder with whichever Blender runs the script.

Usage: with Blender as a Python module, or Debian's Blender 3.4:

    python make_fixtures.py [--out FOLDER] [NAME...]
    blender -b --factory-startup -P make_fixtures.py -- [--out FOLDER] [NAME...]

Only the fixtures of the running version are made: a name's first two digits are
the version, 45 for Blender 4.5. Fixtures that no Blender writes are converted
from these by convert_fixtures.py. README.md lists what each file is for.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import bpy

SIZE = (45, 29)  # odd, and not a multiple of any codec's block of lines
LIGHT_PASSES = (
    "use_pass_diffuse_direct use_pass_diffuse_indirect use_pass_diffuse_color "
    "use_pass_glossy_direct use_pass_glossy_indirect use_pass_glossy_color "
    "use_pass_transmission_direct use_pass_transmission_indirect "
    "use_pass_transmission_color use_pass_emit use_pass_environment"
).split()
VOLUME_PASSES = ("use_pass_volume_direct", "use_pass_volume_indirect")
DOTTED_LAYER = "View.Läyer 2"


def material(name: str, **inputs: float | tuple[float, ...]) -> bpy.types.Material:
    """Return a Principled material; unknown socket names are skipped."""
    mat = bpy.data.materials.new(name)
    mat.use_nodes = True
    node = next(n for n in mat.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    # Blender 4.0 renamed sockets: both names may be given.
    for key, value in inputs.items():
        socket = node.inputs.get(key.replace("_", " "))
        if socket is not None:
            socket.default_value = value
    return mat


def checker(mat: bpy.types.Material) -> bpy.types.Material:
    """Give a material a checker texture as its base colour."""
    tree = mat.node_tree
    node = tree.nodes.new("ShaderNodeTexChecker")
    node.inputs["Scale"].default_value = 9.0
    node.inputs["Color1"].default_value = (0.75, 0.6, 0.4, 1)
    node.inputs["Color2"].default_value = (0.12, 0.2, 0.3, 1)
    bsdf = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    tree.links.new(node.outputs["Color"], bsdf.inputs["Base Color"])
    return mat


def write_aovs(mat: bpy.types.Material) -> None:
    """Let a material fill the two AOVs of the all-pass fixtures."""
    tree = mat.node_tree
    for name, socket, value in (
        ("tint", "Color", (0.2, 0.4, 0.8, 1.0)),
        ("my.value", "Value", 0.5),
    ):
        node = tree.nodes.new("ShaderNodeOutputAOV")
        # 4.2 renamed the property.
        setattr(node, "aov_name" if hasattr(node, "aov_name") else "name", name)
        node.inputs[socket].default_value = value


def ball(mat: bpy.types.Material, where: tuple[float, float, float], radius: float) -> None:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=radius, location=where)
    obj = bpy.context.object
    obj.name = mat.name
    obj.data.materials.append(mat)
    for polygon in obj.data.polygons:
        polygon.use_smooth = True


def area_light(name: str, where: tuple[float, float, float], power: float, size: float) -> None:
    light = bpy.data.lights.new(name, "AREA")
    light.energy = power
    light.size = size
    obj = bpy.data.objects.new(name, light)
    obj.location = where
    bpy.context.scene.collection.objects.link(obj)
    constraint = obj.constraints.new("TRACK_TO")
    constraint.target = bpy.data.objects["Target"]
    constraint.track_axis, constraint.up_axis = "TRACK_NEGATIVE_Z", "UP_Y"


def scene() -> bpy.types.Scene:
    """Build the one small scene: every kind of light transport on 45x29 pixels."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    sc = bpy.context.scene
    target = bpy.data.objects.new("Target", None)
    target.location = (0, 0, 0.6)
    sc.collection.objects.link(target)

    floor = checker(material("floor", Roughness=0.6))
    bpy.ops.mesh.primitive_plane_add(size=12, location=(0, 0, 0))
    bpy.context.object.name = "floor"
    bpy.context.object.data.materials.append(floor)
    bpy.context.object.pass_index = 1
    clay = material("clay", Base_Color=(0.7, 0.2, 0.12, 1), Roughness=0.8)
    gold = material("gold", Base_Color=(0.9, 0.65, 0.25, 1), Metallic=1.0, Roughness=0.15)
    glass = material(
        "glass",
        Base_Color=(0.9, 0.97, 1, 1),
        Roughness=0.0,
        Transmission=1.0,
        Transmission_Weight=1.0,
    )
    glow = material("glow", Emission=(1, 0.5, 0.2, 1), Emission_Color=(1, 0.5, 0.2, 1), Emission_Strength=6.0)
    for index, (mat, where, radius) in enumerate(
        (
            (clay, (-1.5, 0.3, 0.6), 0.6),
            (gold, (-0.2, -0.1, 0.6), 0.6),
            (glass, (1.0, -0.5, 0.55), 0.55),
            (glow, (0.4, 1.5, 0.3), 0.3),
        )
    ):
        ball(mat, where, radius)
        bpy.context.object.pass_index = index + 2
        mat.pass_index = index + 1
        write_aovs(mat)

    smoke = bpy.data.materials.new("smoke")
    smoke.use_nodes = True
    smoke.node_tree.nodes.clear()
    out = smoke.node_tree.nodes.new("ShaderNodeOutputMaterial")
    scatter = smoke.node_tree.nodes.new("ShaderNodeVolumeScatter")
    scatter.inputs["Density"].default_value = 0.6
    smoke.node_tree.links.new(scatter.outputs["Volume"], out.inputs["Volume"])
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=(1.9, 1.0, 0.65))
    bpy.context.object.name = "smoke"
    bpy.context.object.data.materials.append(smoke)

    area_light("key", (-3, -2.5, 4), 250, 0.8)
    area_light("rim", (3, 3, 3), 120, 0.5)
    world = bpy.data.worlds.new("sky")
    sc.world = world
    world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.25, 0.4, 0.7, 1)
    background.inputs["Strength"].default_value = 0.5

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens = 38
    camera.location = (0.2, -5.2, 1.9)
    sc.collection.objects.link(camera)
    track = camera.constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    sc.camera = camera

    render = sc.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", 2
    sc.cycles.device = "CPU"
    sc.cycles.samples = 4
    sc.cycles.seed = 7
    sc.cycles.use_adaptive_sampling = False
    sc.cycles.use_denoising = False
    image_format(sc)
    return sc


def image_format(sc: bpy.types.Scene, codec: str = "ZIP", depth: str = "16", kind: str = "OPEN_EXR_MULTILAYER") -> None:
    settings = sc.render.image_settings
    if hasattr(settings, "media_type"):  # 5.0 and later
        settings.media_type = "MULTI_LAYER_IMAGE" if kind.endswith("MULTILAYER") else "IMAGE"
    settings.file_format = kind
    settings.color_depth = depth
    settings.exr_codec = codec


def denoiser_passes(layer: bpy.types.ViewLayer) -> None:
    """What a typical user turns on: light passes and denoising data."""
    for name in LIGHT_PASSES:
        setattr(layer, name, True)
    for name in VOLUME_PASSES:
        setattr(layer.cycles, name, True)
    layer.cycles.denoising_store_passes = True


def all_passes(layer: bpy.types.ViewLayer) -> None:
    """Turn on every pass this Blender knows, two AOVs and light groups."""
    for owner in (layer, layer.cycles):
        for prop in owner.bl_rna.properties:
            if prop.type == "BOOLEAN" and ("pass_" in prop.identifier or "denoising_store" in prop.identifier):
                if prop.identifier not in ("pass_alpha_threshold", "use_pass_cryptomatte_accurate"):
                    setattr(owner, prop.identifier, True)
    for name, kind in (("tint", "COLOR"), ("my.value", "VALUE")):
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind
    light_groups(layer)


def light_groups(layer: bpy.types.ViewLayer) -> None:
    names = {"key": "key", "rim": "rim", "glow": "lamps"}
    for group in (*sorted(set(names.values())), "env.world"):
        layer.lightgroups.add(name=group)
    for obj, group in names.items():
        bpy.data.objects[obj].lightgroup = group
    bpy.context.scene.world.lightgroup = "env_world"


def two_layers(sc: bpy.types.Scene) -> None:
    all_passes(sc.view_layers[0])
    denoiser_passes(sc.view_layers.new(DOTTED_LAYER))


def everything(sc: bpy.types.Scene) -> None:
    all_passes(sc.view_layers[0])


def codec(name: str, depth: str = "16") -> Callable[[bpy.types.Scene], None]:
    def setup(sc: bpy.types.Scene) -> None:
        denoiser_passes(sc.view_layers[0])
        sc.view_layers[0].use_pass_normal = True
        sc.view_layers[0].use_pass_cryptomatte_object = True
        image_format(sc, name, depth)

    return setup


def denoised(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.cycles.use_denoising = True
    sc.cycles.denoiser = "OPENIMAGEDENOISE"


def stereo(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.render.use_multiview = True
    sc.render.views_format = "STEREO_3D"
    sc.render.image_settings.views_format = "MULTIVIEW"


def transparent(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.render.film_transparent = True


def shadow_catcher(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.view_layers[0].cycles.use_pass_shadow_catcher = True
    bpy.data.objects["floor"].is_shadow_catcher = True


def denoised_catcher(sc: bpy.types.Scene) -> None:
    shadow_catcher(sc)
    denoised(sc)


def interleaved(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.render.image_settings.use_exr_interleave = True


def adaptive(sc: bpy.types.Scene) -> None:
    denoiser_passes(sc.view_layers[0])
    sc.cycles.samples = 64
    sc.cycles.use_adaptive_sampling = True
    sc.cycles.adaptive_threshold = 0.1
    sc.view_layers[0].cycles.pass_debug_sample_count = True


def plain(sc: bpy.types.Scene) -> None:
    image_format(sc, kind="OPEN_EXR")


def beauty(sc: bpy.types.Scene) -> None:
    """Keep Combined and the guides alone, under PIZ."""
    sc.view_layers[0].cycles.denoising_store_passes = True
    image_format(sc, "PIZ", "32")


def composite(sc: bpy.types.Scene) -> None:
    """Add a compositor, so that Composite.Combined comes first in the file."""
    sc.view_layers[0].cycles.denoising_store_passes = True
    sc.use_nodes = True


def long_names(sc: bpy.types.Scene) -> None:
    """Use names that Blender up to 4.5 cuts at 63 bytes, channel letter included."""
    aov = sc.view_layers[0].aovs.add()
    aov.name, aov.type = "b" * 63, "COLOR"
    sc.view_layers[0].cycles.denoising_store_passes = True
    sc.view_layers.new("x" * 63).use_pass_normal = True


def infinite(sc: bpy.types.Scene) -> None:
    """Let an emitter be infinite: 65504 in Combined, NaN in 3.4's DiffDir."""
    denoiser_passes(sc.view_layers[0])
    tree = bpy.data.materials["glow"].node_tree
    bsdf = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    bsdf.inputs["Emission Strength"].default_value = float("inf")


FIXTURES: dict[str, Callable[[bpy.types.Scene], None]] = {
    "34_all": everything,
    "34_infinite": infinite,
    "45_all_two_layers": two_layers,
    "45_adaptive": adaptive,
    "45_b44": codec("B44"),
    "45_beauty_guides": beauty,
    "45_composite": composite,
    "45_denoised": denoised,
    "45_dwaa": codec("DWAA"),
    "45_dwab_float": codec("DWAB", "32"),
    "45_long_names": long_names,
    "45_none": codec("NONE"),
    "45_piz": codec("PIZ"),
    "45_plain": plain,
    "45_pxr24_float": codec("PXR24", "32"),
    "45_rle": codec("RLE"),
    "45_shadow_catcher": shadow_catcher,
    "45_stereo": stereo,
    "45_transparent": transparent,
    "45_zips_float": codec("ZIPS", "32"),
    "50_all": everything,
    "50_b44": codec("B44"),
    "50_denoised_catcher": denoised_catcher,
    "50_dwab": codec("DWAB"),
    "50_interleaved": interleaved,
    "50_pxr24": codec("PXR24"),
    "50_stereo": stereo,
    "50_transparent": transparent,
    "50_zip_float": codec("ZIP", "32"),
    "52_htj2k": codec("HTJ2K"),
    "52_zip": codec("ZIP"),
}


def make(name: str, out: Path) -> None:
    sc = scene()
    FIXTURES[name](sc)
    sc.render.filepath = str(out / name)
    sc.render.use_file_extension = True
    bpy.ops.render.render(write_still=True)
    print(f"{name}.exr {(out / (name + '.exr')).stat().st_size}")


def main() -> None:
    args = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent)
    options = parser.parse_args(args)
    version = f"{bpy.app.version[0]}{bpy.app.version[1]}_"
    for name in options.names or [n for n in FIXTURES if n.startswith(version)]:
        make(name, options.out)


if __name__ == "__main__":
    main()
