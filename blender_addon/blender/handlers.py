# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoises after a render, by files: for the output "EXR File", and where the way through the engine is closed.

Order for each frame: render_pre, [the render, engine_hook], render_post, render_write where a file is written; then
once render_complete or render_cancel. F12 runs all of these on the render thread, so data is only read here, besides
the image settings around save_render.
"""

from __future__ import annotations

import atexit
import os
import sys
import tempfile
import time
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..io import files, library
from ..io.journal import EXIT_FAILED, Journal
from ..io.outcome import Outcome
from . import cycles_settings, engine_hook, exr_save, preferences, properties, state

_journal = Journal()
_frame = 0
rendered_with = ""  # the engine of the render result; "" while nothing was rendered
_started = 0.0
_is_pending = False  # the frame is rendered, and not yet seen to


def record(outcome: Outcome) -> None:
    """Notes that the present frame is done."""
    _journal.done(_frame, outcome)


def record_failure(sentence: str) -> None:
    """Notes that the present frame could not be denoised; a batch run then ends with an exit code that says so."""
    _journal.failed(_frame, sentence)
    # Blender disables add-ons before it ends, so this stays when the add-on goes. Not in the bpy module: there the
    # process is its host's.
    if bpy.app.background and bpy.app.binary_path and not getattr(bpy.app, "module", False):
        atexit.unregister(_exit_with_failure)
        atexit.register(_exit_with_failure)


@persistent
def _on_init(_scene: bpy.types.Scene, *_: object) -> None:
    global _journal
    machine = preferences.get()
    _journal = Journal(os.environ.get("QUELL_JOURNAL") or (bpy.path.abspath(machine.journal) if machine else ""))


@persistent
def _on_pre(scene: bpy.types.Scene, *_: object) -> None:
    global _frame, _started, _is_pending, rendered_with
    _frame = scene.frame_current
    rendered_with = scene.render.engine
    _started = time.time()
    _is_pending = False
    engine_hook.begin_frame()


@persistent
def _on_post(scene: bpy.types.Scene, *_: object) -> None:
    global _is_pending
    _is_pending = _wants_file(scene)


@persistent
def _on_write(scene: bpy.types.Scene, *_: object) -> None:
    """Animations, -f, and stills that are written: the frame's file is there."""
    _see_to(scene)


@persistent
def _on_complete(scene: bpy.types.Scene, *_: object) -> None:
    """Stills that no file was written of."""
    if scene.quell.when == properties.WHEN_ALWAYS:
        _see_to(scene)


@persistent
def _on_cancel(_scene: bpy.types.Scene, *_: object) -> None:
    global _is_pending
    _is_pending = False


def _wants_file(scene: bpy.types.Scene) -> bool:
    settings = scene.quell
    if not settings.enabled or settings.when == properties.WHEN_BUTTON or scene.render.engine != "CYCLES":
        return False
    if settings.output == properties.OUTPUT_FILE:
        return True
    if settings.output == properties.OUTPUT_BOTH and engine_hook.is_frame_denoised:
        return True
    return not engine_hook.is_frame_seen and bool(engine_hook.problem())


def _see_to(scene: bpy.types.Scene) -> None:
    """Makes the frame's denoised file. Whatever goes wrong is reported, never raised: the render is safe."""
    global _is_pending
    if not _is_pending:
        return
    _is_pending = False
    try:
        library.quell()
        if engine_hook.is_frame_denoised:
            _save_denoised(scene)
            return
        written = written_multilayer(scene, _started)
        outcome = denoise_render_result(scene, output_path(scene, written), written)
    except Exception as error:  # an exception of a handler would only be printed
        state.set_error(str(error))
        record_failure(str(error))
    else:
        state.set_outcome(outcome)
        record(outcome)


def _save_denoised(scene: bpy.types.Scene) -> None:
    """The passes in memory are clean already: they only need a file, unless Blender's own is it."""
    written = written_multilayer(scene, _started)
    output = output_path(scene, written)
    if output != written:
        exr_save.save_render_result(scene, output, "ZIP")


def output_path(scene: bpy.types.Scene, written: Path | None = None) -> Path:
    """Where the denoised EXR file of the present frame goes."""
    rendered = written or Path(bpy.path.abspath(scene.render.frame_path(frame=scene.frame_current)))
    return files.output_path(rendered, scene.quell.pattern)


def denoise_render_result(scene: bpy.types.Scene, output: Path, written: Path | None = None) -> Outcome:
    """Denoises the render into `output`: from the file Blender wrote, or one that is written for this. Raises."""
    denoised = cycles_settings.denoised_layers(scene)
    plain = properties.file_settings(scene)
    if written is not None:
        return files.denoise_file(written, output, plain, lambda _fraction: None, denoised_layers=denoised)
    with tempfile.TemporaryDirectory(prefix="quell") as folder:
        source = Path(folder) / "render.exr"
        start = time.perf_counter()
        exr_save.save_render_result(scene, source)
        saved = time.perf_counter() - start
        outcome = files.denoise_fresh_file(source, output, plain, lambda _fraction: None, denoised)
    outcome.add_seconds("save", saved)
    return outcome


def written_multilayer(scene: bpy.types.Scene, since: float) -> Path | None:
    """The multilayer EXR file that Blender wrote of this frame after `since`, None where it wrote none."""
    if scene.render.image_settings.file_format != "OPEN_EXR_MULTILAYER":
        return None
    # Frames of an animation carry their number; a still that is written does not.
    numbered = Path(bpy.path.abspath(scene.render.frame_path(frame=_frame)))
    plain = Path(bpy.path.ensure_ext(bpy.path.abspath(scene.render.filepath), ".exr"))
    for path in (numbered, plain):
        if path.is_file() and path.stat().st_mtime >= since - 1.0:  # file systems count coarser than clocks
            return path
    return None


def _exit_with_failure() -> None:
    """Blender's own exit code stays 0 when a handler fails."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(EXIT_FAILED)


_HANDLERS = {
    "render_init": _on_init,
    "render_pre": _on_pre,
    "render_post": _on_post,
    "render_write": _on_write,
    "render_complete": _on_complete,
    "render_cancel": _on_cancel,
}


def register() -> None:
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in _HANDLERS.items():
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
