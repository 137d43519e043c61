# SPDX-License-Identifier: Apache-2.0
"""Quell: removes the noise from renders made with Blender's Cycles.

    import quell

    with quell.Context() as context:
        model = context.open_model()
        with context.read_exr("shot.0001.exr") as frame:
            context.denoise(frame, model)
            frame.write_exr("clean.0001.exr")

or, with pixels in memory: Context.new_frame, Frame.add_layer(..., borrow=True), Context.denoise.
"""

from . import native
from .core import Context, Frame, LayerInfo, Model, ModelInfo, models, qualities, roles, version
from .errors import CancelledError, FileError, LibraryError, ModelError, NoLayerError, QuellError, ResourceError
from .report import LayerReport, Report

__all__ = [
    "CancelledError",
    "Context",
    "FileError",
    "Frame",
    "LayerInfo",
    "LayerReport",
    "LibraryError",
    "Model",
    "ModelError",
    "ModelInfo",
    "NoLayerError",
    "QuellError",
    "Report",
    "ResourceError",
    "models",
    "native",
    "qualities",
    "roles",
    "version",
]
