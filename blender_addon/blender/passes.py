# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes that make Quell's result better, what they cost, and the button that turns them on."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

_BYTES_PER_VALUE = 4
_MEGABYTE = 1024 * 1024


@dataclass(frozen=True)
class PassGroup:
    """attributes: of a view layer, dotted. num_channels: of all its passes together."""

    title: str
    why: str
    attributes: tuple[str, ...]
    num_channels: int


GUIDES = PassGroup(
    "Denoising Data",
    "Albedo, normal and depth: tell texture from noise. Helps most",
    ("cycles.denoising_store_passes",),
    7,
)
LIGHT = PassGroup(
    "Light Passes",
    "Diffuse, glossy, transmission, volume, emission, environment: each is denoised by itself",
    (
        *(f"use_pass_{kind}_{part}" for kind in ("diffuse", "glossy", "transmission")
          for part in ("direct", "indirect", "color")),
        "cycles.use_pass_volume_direct",
        "cycles.use_pass_volume_indirect",
        "use_pass_emit",
        "use_pass_environment",
    ),
    39,
)  # fmt: skip


def is_on(view_layer: bpy.types.ViewLayer, group: PassGroup) -> bool:
    return all(_get(view_layer, attribute) for attribute in group.attributes)


def turn_on(view_layer: bpy.types.ViewLayer, group: PassGroup) -> None:
    for attribute in group.attributes:
        owner, name = _owner(view_layer, attribute)
        setattr(owner, name, True)


def megabytes(scene: bpy.types.Scene, group: PassGroup) -> float:
    """Memory that the group takes in the render result."""
    scale = scene.render.resolution_percentage / 100
    pixels = int(scene.render.resolution_x * scale) * int(scene.render.resolution_y * scale)
    return pixels * group.num_channels * _BYTES_PER_VALUE / _MEGABYTE


def _owner(view_layer: bpy.types.ViewLayer, attribute: str) -> tuple[object, str]:
    path, _, name = attribute.rpartition(".")
    return (getattr(view_layer, path) if path else view_layer), name


def _get(view_layer: bpy.types.ViewLayer, attribute: str) -> bool:
    owner, name = _owner(view_layer, attribute)
    return bool(getattr(owner, name))


class QUELL_OT_enable_passes(bpy.types.Operator):
    bl_idname = "quell.enable_passes"
    bl_label = "Enable the Passes Quell Wants"
    bl_description = "Choose passes that make the result better, and see what each costs"
    bl_options = {"REGISTER", "UNDO"}

    guides: bpy.props.BoolProperty(name=GUIDES.title, description=GUIDES.why, default=True)
    light: bpy.props.BoolProperty(name=LIGHT.title, description=LIGHT.why, default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return hasattr(context.scene, "cycles")

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return context.window_manager.invoke_props_dialog(self, width=420)

    def draw(self, context: bpy.types.Context) -> None:
        for name, group in (("guides", GUIDES), ("light", LIGHT)):
            column = self.layout.column(align=True)
            column.prop(self, name)
            column.label(text=group.why)
            column.label(text=f"{megabytes(context.scene, group):.0f} MB of memory at this size, in each view layer")
        self.layout.label(text="Rendering takes hardly longer. Files with all passes are larger.")

    def execute(self, context: bpy.types.Context) -> set[str]:
        for view_layer in context.scene.view_layers:
            for is_wanted, group in ((self.guides, GUIDES), (self.light, LIGHT)):
                if is_wanted:
                    turn_on(view_layer, group)
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(QUELL_OT_enable_passes)


def unregister() -> None:
    bpy.utils.unregister_class(QUELL_OT_enable_passes)
