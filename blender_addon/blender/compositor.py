# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts the denoised file in place of the render layers in the compositor, on both APIs: before and since 5.0.

The user's nodes stay. Each Render Layers node gets an image node beside it that takes over its links, socket by socket;
what the file does not have (Alpha) stays linked to the render.
"""

from __future__ import annotations

import bpy

from ..io.library import Problem
from . import images, state


def node_tree(scene: bpy.types.Scene, create: bool) -> bpy.types.NodeTree | None:
    """The scene's compositing nodes."""
    if hasattr(scene, "compositing_node_group"):  # 5.0
        if scene.compositing_node_group is None and create:
            scene.compositing_node_group = _default_group(scene)
        return scene.compositing_node_group
    if create and not scene.use_nodes:
        scene.use_nodes = True  # makes the default nodes
    return scene.node_tree if scene.use_nodes else None


def _default_group(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """What older versions make by themselves: the render layers, straight to the output."""
    tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    output = tree.nodes.new("NodeGroupOutput")
    output.location = (400, 0)
    tree.links.new(layers.outputs["Image"], output.inputs["Image"])
    return tree


def has_denoise_node(scene: bpy.types.Scene) -> bool:
    tree = node_tree(scene, create=False)
    return tree is not None and any(node.bl_idname == "CompositorNodeDenoise" and not node.mute for node in tree.nodes)


def use_result(scene: bpy.types.Scene, image: bpy.types.Image) -> int:
    """Returns how many links come from the image now, those of an earlier call included. Raises Problem."""
    tree = node_tree(scene, create=True)
    assert tree is not None
    _ = tuple(image.size)  # loads it: only then does it know its layers
    num_links = 0
    for node in [node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"]:
        if node.scene not in (scene, None):
            continue
        picture = _image_node(tree, node, image)
        for output in node.outputs:
            source = picture.outputs.get("Combined" if output.name == "Image" else output.name)
            if source is None or not source.enabled:
                continue
            for target in [link.to_socket for link in output.links]:
                tree.links.new(source, target)
        num_links += sum(len(source.links) for source in picture.outputs)
    if not num_links:
        raise Problem("No render layers of this scene are linked in the compositor: nothing to put the result in for.")
    return num_links


def _image_node(tree: bpy.types.NodeTree, layers: bpy.types.Node, image: bpy.types.Image) -> bpy.types.Node:
    """The node of an earlier click, or a new one under the render layers."""
    name = f"Quell {layers.name}"
    node = tree.nodes.get(name)
    if node is None:
        node = tree.nodes.new("CompositorNodeImage")
        node.name = node.label = name
        node.location = (layers.location.x, layers.location.y - 450)
        node.parent = layers.parent
    node.image = image
    if node.has_layers and layers.layer:
        node.layer = layers.layer
    return node


class QUELL_OT_use_in_compositor(bpy.types.Operator):
    bl_idname = "quell.use_in_compositor"
    bl_label = "Use in Compositor"
    bl_description = "Link the denoised result where the compositor uses the render layers. Your nodes stay; undo works"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return images.RESULT in bpy.data.images

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            num_links = use_result(context.scene, bpy.data.images[images.RESULT])
        except Problem as error:
            state.set_error(str(error))
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{num_links} links in the compositor use the denoised result")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(QUELL_OT_use_in_compositor)


def unregister() -> None:
    bpy.utils.unregister_class(QUELL_OT_use_in_compositor)
