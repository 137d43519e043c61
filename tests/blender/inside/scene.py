# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender: the scene of the tests, and small helpers. Works in 3.4 to 5.2, as executable and as module."""

from __future__ import annotations

from pathlib import Path

import bpy

SIZE = 64
LIGHT_PASSES = [
    *(f"use_pass_{kind}_{part}" for kind in ("diffuse", "glossy", "transmission")
      for part in ("direct", "indirect", "color")),
    "use_pass_emit",
    "use_pass_environment",
    "use_pass_z",
]  # fmt: skip


def make() -> bpy.types.Scene:
    """A cube, a glossy ball, a lamp; 2 samples, all light passes, denoising data, a seed that changes by frame."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 2
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_animated_seed = True
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    bpy.ops.mesh.primitive_uv_sphere_add(location=(2, -1, 0))
    material = bpy.data.materials.new("gloss")
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 1.0
    bpy.context.object.data.materials.append(material)
    for layer in scene.view_layers:
        turn_on_passes(layer)
    return scene


def turn_on_passes(layer: bpy.types.ViewLayer) -> None:
    for name in LIGHT_PASSES:
        setattr(layer, name, True)
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
    layer.cycles.denoising_store_passes = True


def set_format(scene: bpy.types.Scene, name: str) -> None:
    """OPEN_EXR_MULTILAYER of full floats, or another format."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE" if name == "OPEN_EXR_MULTILAYER" else "IMAGE"
    settings.file_format = name
    if name.startswith("OPEN_EXR"):
        settings.color_depth = "32"


def render(scene: bpy.types.Scene, path: Path) -> Path:
    """Renders frame 1 into `path`, a multilayer EXR file."""
    set_format(scene, "OPEN_EXR_MULTILAYER")
    scene.frame_set(1)
    scene.render.filepath = str(path)
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    assert path.exists(), f"Blender wrote no {path}"
    return path


def compositing_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """Fresh nodes: the render layers, and where their picture goes."""
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.new("test", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        scene.compositing_node_group = tree
        output = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        output = tree.nodes.new("CompositorNodeComposite")
    output.name = "output"
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.name = "layers"
    layers.scene = scene
    tree.links.new(layers.outputs["Image"], output.inputs["Image"])
    return tree


def drop_compositing(scene: bpy.types.Scene) -> None:
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = None
    else:
        scene.use_nodes = False


def reset(settings: bpy.types.PropertyGroup) -> None:
    """The scene's Quell settings as in a new file, but off."""
    for name in settings.bl_rna.properties.keys():
        if name not in ("rna_type", "name"):
            settings.property_unset(name)
