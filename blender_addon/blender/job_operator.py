# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators whose work runs on a thread: progress in the status bar, Esc cancels, Blender stays usable meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy

from ..io import library
from ..io.job import Job
from . import state

POLL_SECONDS = 0.1


class JobOperator(bpy.types.Operator if TYPE_CHECKING else object):  # type: ignore[misc]
    """Mix-in. prepare() runs on the main thread and returns the work; finish() gets its result, there again."""

    _job: Job  # set by _begin
    _timer: bpy.types.Timer

    def prepare(self, context: bpy.types.Context) -> Callable[[Callable[[float], bool]], Any]:
        """Raises library.Problem."""
        raise NotImplementedError

    def finish(self, context: bpy.types.Context, result: Any) -> None:
        """Raises library.Problem."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Runs in the end, whatever happened."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ends when the work has: scripts."""
        if not self._begin(context):
            return {"CANCELLED"}
        self._job.wait()
        return self._end(context)

    def start(self, context: bpy.types.Context) -> set[str]:
        """Ends at once, the work goes on; in background mode, which has no events, like a script."""
        if bpy.app.background:
            return JobOperator.execute(self, context)
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(POLL_SECONDS, window=context.window)
        manager.progress_begin(0, 100)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self._job.cancel()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            percent = int(100 * self._job.fraction)
            context.window_manager.progress_update(percent)
            context.workspace.status_text_set(f"Quell: denoising, {percent} %. Esc cancels")
            if self._job.is_done:
                context.window_manager.event_timer_remove(self._timer)
                context.window_manager.progress_end()
                context.workspace.status_text_set(None)
                return self._end(context)
        return {"PASS_THROUGH"}

    def _begin(self, context: bpy.types.Context) -> bool:
        try:
            library.quell()
            self._job = Job(self.prepare(context))
        except library.Problem as error:
            self._fail(str(error))
            self.clean_up()
            return False
        state.set_running("Denoising")
        return True

    def _end(self, context: bpy.types.Context) -> set[str]:
        try:
            if self._job.error is not None:
                raise self._job.error
            self.finish(context, self._job.result)
            return {"FINISHED"}
        except library.quell().CancelledError:
            state.set_error("Denoising was cancelled")
            self.report({"INFO"}, "Denoising was cancelled")
        except (library.Problem, library.quell().QuellError, OSError) as error:
            self._fail(str(error))
        finally:
            self.clean_up()
        return {"CANCELLED"}

    def _fail(self, sentence: str) -> None:
        state.set_error(sentence)
        self.report({"ERROR"}, sentence)
