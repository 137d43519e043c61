# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the Render Result, with all passes of all view layers, as a multilayer EXR file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import bpy

from ..io.library import Problem

# media_type first: since 5.0 it decides which formats there are.
_FIELDS = ("media_type", "file_format", "color_mode", "color_depth", "exr_codec", "use_exr_interleave", "views_format")


@contextlib.contextmanager
def _multilayer(settings: bpy.types.ImageFormatSettings, codec: str) -> Iterator[None]:
    """The image settings of a multilayer EXR file of full floats, and then the user's again."""
    before = {field: getattr(settings, field) for field in _FIELDS if hasattr(settings, field)}
    try:
        if "media_type" in before:
            settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format = "OPEN_EXR_MULTILAYER"
        settings.color_depth = "32"
        settings.exr_codec = codec
        settings.views_format = "MULTIVIEW"  # both eyes of a stereo render in this one file
        yield
    finally:
        for field, value in before.items():
            # A format without such a field keeps a value that it does not offer.
            with contextlib.suppress(TypeError):
                setattr(settings, field, value)


def save_render_result(scene: bpy.types.Scene, path: Path, codec: str = "NONE") -> None:
    """scene: the rendered one. codec: of bpy.types.ImageFormatSettings.exr_codec. Raises Problem."""
    image = next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)
    if image is None:
        raise Problem("There is no render result: render the scene first.")
    views_format = image.views_format
    if scene.render.use_multiview:
        # Of a stereo render the image's own setting goes before the scene's: by default it is a file for each eye.
        image.views_format = "STEREO_3D"
    try:
        with _multilayer(scene.render.image_settings, codec):
            image.save_render(str(path), scene=scene)
    except RuntimeError as error:
        if "does not have any image data" in str(error):
            raise Problem(f"There is no render of the scene '{scene.name}': render it first.") from error
        raise Problem(f"Blender could not write {path}: {str(error).strip()}") from error
    finally:
        image.views_format = views_format
    if not path.exists() or path.stat().st_size == 0:
        path.unlink(missing_ok=True)
        raise Problem(f"Blender could not write {path}: is the disk full?")
