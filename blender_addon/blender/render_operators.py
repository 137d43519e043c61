# SPDX-License-Identifier: GPL-3.0-or-later
"""The button: denoises the finished render."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ..io import files, library
from . import cycles_settings, engine_hook, exr_save, handlers, images, job_operator, properties, state


class QUELL_OT_denoise_render(job_operator.JobOperator, bpy.types.Operator):
    bl_idname = "quell.denoise_render"
    bl_label = "Denoise Render Result"
    bl_description = (
        "Denoise the finished render with all its passes into an EXR file beside the output, and show it. "
        "The render itself stays. Esc cancels"
    )

    _folder: tempfile.TemporaryDirectory[str] | None = None

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return self.start(context)

    def prepare(self, context: bpy.types.Context) -> Callable[[Callable[[float], bool]], Any]:
        scene = context.scene
        if bpy.app.is_job_running("RENDER"):
            raise library.Problem("Wait until the render has finished.")
        if scene.render.engine != "CYCLES":
            raise library.Problem("Quell denoises renders made with Cycles; this scene uses another render engine.")
        if handlers.rendered_with not in ("", "CYCLES"):
            raise library.Problem("This render was made with another engine than Cycles: render it again.")
        if engine_hook.is_frame_denoised:
            raise library.Problem("This render is denoised already.")
        denoised = cycles_settings.denoised_layers(scene)
        settings = properties.file_settings(scene)
        output = handlers.output_path(scene)
        if not output.parent.is_dir():
            output = Path(bpy.app.tempdir) / output.name
        self._folder = tempfile.TemporaryDirectory(prefix="quell")
        source = Path(self._folder.name) / "render.exr"
        exr_save.save_render_result(scene, source)

        def work(progress: Callable[[float], bool]) -> tuple[Path, Any, Any]:
            outcome = files.denoise_fresh_file(source, output, settings, progress, denoised)
            return output, outcome, files.picture_behind_composite(output)

        return work

    def finish(self, context: bpy.types.Context, result: Any) -> None:
        output, outcome, picture = result
        image = images.load_result(output)
        if picture is not None:
            image = images.from_pixels(images.RESULT_PICTURE, picture)
        images.show(context, image)
        state.set_outcome(outcome)
        self.report({"INFO"}, f"{outcome.summary()}: {output}")

    def clean_up(self) -> None:
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


class QUELL_OT_use_quell_alone(bpy.types.Operator):
    bl_idname = "quell.use_quell_alone"
    bl_label = "Turn Off Cycles' Denoiser"
    bl_description = "Cycles denoises this scene too: doing it twice costs time and detail"
    bl_options = {"UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.cycles.use_denoising = False
        return {"FINISHED"}


_CLASSES = (QUELL_OT_denoise_render, QUELL_OT_use_quell_alone)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
