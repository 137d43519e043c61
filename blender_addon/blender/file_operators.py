# SPDX-License-Identifier: GPL-3.0-or-later
"""Saved EXR files: an operator for the file browser, and drag and drop where this version has it (4.1)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from ..io import files, library
from ..io.outcome import Outcome
from . import images, job_operator, properties, state


class QUELL_OT_denoise_files(job_operator.JobOperator, bpy.types.Operator):
    bl_idname = "quell.denoise_files"
    bl_label = "Denoise EXR Files"
    bl_description = "Denoise saved multilayer EXR files, or all of a folder, with this scene's Quell settings"

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE", "HIDDEN"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"})
    filter_glob: bpy.props.StringProperty(default="*.exr", options={"HIDDEN"})
    pattern: bpy.props.StringProperty(
        name="Name",
        description="Name of a result; {name} stands for the file's name. {name} alone replaces the file",
        default=files.DEFAULT_PATTERN,
    )
    again: bpy.props.BoolProperty(
        name="Finished Ones Too",
        description="Also denoise files whose result is there and newer",
        default=False,
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if self.filepath or self.files:  # dropped
            return self.start(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Comes from the file browser, or from a script."""
        return self.start(context)

    def prepare(self, context: bpy.types.Context) -> Callable[[Callable[[float], bool]], Any]:
        folder = Path(bpy.path.abspath(self.directory))
        chosen = [folder / item.name for item in self.files if item.name]
        if not chosen:
            chosen = [Path(bpy.path.abspath(self.filepath or self.directory))]
        sources = files.collect(chosen, self.pattern)
        settings = properties.file_settings(context.scene)
        pattern, again = self.pattern, self.again

        def work(progress: Callable[[float], bool]) -> list[tuple[Path, Outcome | None, Exception | None]]:
            done: list[tuple[Path, Outcome | None, Exception | None]] = []
            files.denoise_files(sources, settings, pattern, None, again, progress, lambda *item: done.append(item))
            return done

        return work

    def finish(self, context: bpy.types.Context, result: Any) -> None:
        failed = [(source, error) for source, _, error in result if error is not None]
        if failed:
            source, error = failed[0]
            more = f" ({len(failed)} of {len(result)} files failed)" if len(result) > 1 else ""
            raise library.Problem(f"{error}{more}")
        outcomes = [outcome for _, outcome, _ in result if outcome is not None]
        if not outcomes:
            self.report({"INFO"}, "All results are there already")
            state.set_outcome(Outcome(notes=["All results are there already."]))
            return
        if len(result) == 1:
            images.show(context, images.load_result(files.output_path(result[0][0], self.pattern)))
        total = Outcome()
        for outcome in outcomes:
            total.denoised += outcome.denoised
            total.skipped += outcome.skipped
            for stage, seconds in outcome.seconds.items():
                total.add_seconds(stage, seconds)
        state.set_outcome(total)
        self.report({"INFO"}, f"{len(outcomes)} files: {total.summary()}")


_CLASSES: list[type] = [QUELL_OT_denoise_files]

if hasattr(bpy.types, "FileHandler"):

    class QUELL_FH_exr(bpy.types.FileHandler):
        bl_idname = "QUELL_FH_exr"
        bl_label = "Denoise with Quell"
        bl_import_operator = QUELL_OT_denoise_files.bl_idname
        bl_file_extensions = ".exr"

        @classmethod
        def poll_drop(cls, context: bpy.types.Context) -> bool:
            return context.area is not None and context.area.type == "IMAGE_EDITOR"

    _CLASSES.append(QUELL_FH_exr)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
