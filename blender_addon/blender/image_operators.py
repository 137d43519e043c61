# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking at the render before and after."""

from __future__ import annotations

import bpy

from . import engine_hook, images, state


def other_picture(image: bpy.types.Image | None) -> str:
    """What the toggle shows next, "" where there is nothing to compare: "BEFORE", "RESULT" or "RENDER"."""
    if image is None:
        return ""
    if image.name in (images.BEFORE, images.RESULT, images.RESULT_PICTURE):
        return "RENDER" if images.render_result() else ""
    if image.type != "RENDER_RESULT":
        return ""
    if engine_hook.is_frame_denoised:
        return "BEFORE" if state.before is not None else ""
    return "RESULT" if images.RESULT in bpy.data.images else ""


class QUELL_OT_toggle_before(bpy.types.Operator):
    bl_idname = "quell.toggle_before"
    bl_label = "Before / After"
    bl_description = "Switch this editor between the noisy and the denoised picture"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        space = context.space_data
        return space is not None and space.type == "IMAGE_EDITOR" and other_picture(space.image) != ""

    def execute(self, context: bpy.types.Context) -> set[str]:
        space = context.space_data
        picture = other_picture(space.image)
        if picture == "BEFORE" and state.before is not None:
            space.image = images.from_pixels(images.BEFORE, state.before)
        elif picture == "RESULT":
            space.image = bpy.data.images.get(images.RESULT_PICTURE) or bpy.data.images[images.RESULT]
        else:
            space.image = images.render_result()
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(QUELL_OT_toggle_before)


def unregister() -> None:
    bpy.utils.unregister_class(QUELL_OT_toggle_before)
