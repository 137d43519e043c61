# SPDX-License-Identifier: GPL-3.0-or-later
"""Images that show results, and the editors that show the images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

if TYPE_CHECKING:
    import numpy as np

RESULT = "Quell Result"  # the multilayer file
RESULT_PICTURE = "Quell Result Picture"  # its Combined, where the file begins with the compositor's picture instead
BEFORE = "Quell Before"


def render_result() -> bpy.types.Image | None:
    return next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)


def load_result(path: Path) -> bpy.types.Image:
    """The result's file as an image, under one name whatever the file's."""
    image = bpy.data.images.get(RESULT)
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = RESULT
    else:
        image.filepath = str(path)
        image.reload()
    image.use_view_as_render = True
    return image


def from_pixels(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """An image of scene-linear pixels [height][width][4], row 0 on top."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.get(name)
    if image is None or tuple(image.size) != (width, height):
        if image is not None:
            bpy.data.images.remove(image)
        image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
    image.alpha_mode = "PREMUL"
    image.use_view_as_render = True
    image.pixels.foreach_set(pixels[::-1].ravel())
    image.update()
    return image


def show(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """In every image editor that shows a render or a picture of Quell's; elsewhere in the first image editor."""
    editors = [
        area.spaces.active
        for window in context.window_manager.windows
        for area in window.screen.areas
        if area.type == "IMAGE_EDITOR"
    ]
    shown = [space for space in editors if is_ours(space.image)]
    for space in shown or editors[:1]:
        space.image = image


def is_ours(image: bpy.types.Image | None) -> bool:
    return image is not None and (image.type == "RENDER_RESULT" or image.name in (RESULT, RESULT_PICTURE, BEFORE))
