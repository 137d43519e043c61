# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user sees: beside Cycles' own denoiser in Render Properties, and in the Image Editor's sidebar."""

from __future__ import annotations

import bpy

from ..io import library
from . import compositor, cycles_settings, engine_hook, image_operators, passes, properties, state

_DETAIL_LINES = 6
# Of Blender's own font at a scale of 1, on average; and what the panel's borders and icon take.
_CHARACTER_WIDTH = 7
_BORDER_WIDTH = 60


def _draw_text(layout: bpy.types.UILayout, text: str, icon: str = "NONE") -> None:
    """A sentence, broken where the region is too narrow for it."""
    scale = bpy.context.preferences.system.ui_scale
    num_characters = int((bpy.context.region.width / scale - _BORDER_WIDTH) / _CHARACTER_WIDTH)
    line = ""
    for word in text.split():
        if line and len(line) + len(word) >= num_characters:
            layout.label(text=line, icon=icon)
            line, icon = "", "BLANK1" if icon != "NONE" else "NONE"
        line = f"{line} {word}".strip()
    layout.label(text=line, icon=icon)


def draw_status(layout: bpy.types.UILayout) -> None:
    status = state.status
    box = layout.box().column(align=True)
    _draw_text(box, status.text, status.icon)
    for line in status.details[:_DETAIL_LINES]:
        _draw_text(box, line)
    if len(status.details) > _DETAIL_LINES:
        box.label(text=f"and {len(status.details) - _DETAIL_LINES} more")


def _draw_warnings(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """What stands in the way of a good result."""
    if scene.quell.quality.lower() not in library.qualities():
        _draw_text(layout.column(align=True), "This add-on was packed without the network of that quality.", "ERROR")
    view_layers = [layer for layer in scene.view_layers if layer.use]
    if any(cycles_settings.denoises(scene, layer) for layer in view_layers):
        column = layout.column(align=True)
        _draw_text(column, "Cycles denoises this scene too.", "ERROR")
        column.operator("quell.use_quell_alone")
    if compositor.has_denoise_node(scene):
        _draw_text(layout.column(align=True), "A Denoise node in the compositor denoises once more.", "ERROR")
    if not all(passes.is_on(layer, group) for layer in view_layers for group in (passes.GUIDES, passes.LIGHT)):
        layout.operator("quell.enable_passes", icon="ADD")


class _QuellPanel:
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine == "CYCLES"


class QUELL_PT_render(_QuellPanel, bpy.types.Panel):
    bl_label = "Quell"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_parent_id = "CYCLES_RENDER_PT_sampling"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.quell, "enabled", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        scene = context.scene
        settings = scene.quell
        if library.problem():
            _draw_text(layout.column(align=True), library.problem(), "ERROR")
            return
        column = layout.column()
        column.active = settings.enabled
        column.prop(settings, "when")
        column = layout.column()
        column.prop(settings, "quality")
        column.prop(settings, "layers")
        if settings.layers == "NAMES":
            column.prop(settings, "layer_names")
        _draw_warnings(layout, scene)
        layout.operator("quell.denoise_render", icon="RENDER_STILL")
        draw_status(layout)


class QUELL_PT_output(_QuellPanel, bpy.types.Panel):
    bl_label = "Output"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_parent_id = "QUELL_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.quell
        layout.prop(settings, "output")
        if settings.output != properties.OUTPUT_FILE:
            layout.prop(settings, "target")
            if engine_hook.problem():
                _draw_text(layout.column(align=True), engine_hook.problem(), "INFO")
                _draw_text(layout.column(align=True), "Results go into EXR files instead.")
        if settings.output != properties.OUTPUT_RENDER or engine_hook.problem():
            layout.prop(settings, "pattern")
        layout.prop(settings, "keep_noisy")
        layout.operator("quell.denoise_files", icon="FILE_FOLDER")


class QUELL_PT_image(bpy.types.Panel):
    bl_label = "Quell"
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "Quell"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator("quell.denoise_render", icon="RENDER_STILL")
        picture = image_operators.other_picture(context.space_data.image)
        text = {"BEFORE": "Show Before", "RESULT": "Show Denoised", "RENDER": "Show the Render"}.get(picture)
        layout.operator("quell.toggle_before", text=text or "Before / After", icon="ARROW_LEFTRIGHT")
        layout.operator("quell.use_in_compositor", icon="NODE_COMPOSITING")
        layout.operator("quell.denoise_files", icon="FILE_FOLDER")
        draw_status(layout)


_CLASSES = (QUELL_PT_render, QUELL_PT_output, QUELL_PT_image)


def register() -> None:
    # The parent is Cycles' own: without that add-on the panel stands by itself.
    if not hasattr(bpy.types, "CYCLES_RENDER_PT_sampling"):
        QUELL_PT_render.bl_parent_id = ""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
