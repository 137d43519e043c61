# SPDX-License-Identifier: GPL-3.0-or-later
"""What the running Blender remembers: the last outcome and the picture before it. Saved nowhere.

Render threads write here, the interface reads: whole objects are swapped, never changed in place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy

from ..io.outcome import Outcome

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True)
class Status:
    text: str
    icon: str = "INFO"
    details: tuple[str, ...] = ()


IDLE = Status("Nothing denoised yet")

status: Status = IDLE
before: np.ndarray | None = None  # the noisy Combined, [height][width][4], row 0 on top


def set_outcome(outcome: Outcome) -> None:
    _set(Status(outcome.summary(), "CHECKMARK", tuple(outcome.details())))


def set_error(sentence: str) -> None:
    _set(Status(sentence, "ERROR"))


def set_running(sentence: str) -> None:
    _set(Status(sentence, "SORTTIME"))


def set_before(pixels: np.ndarray | None) -> None:
    global before
    before = pixels


def clear() -> None:
    global status, before
    status, before = IDLE, None


def _set(new: Status) -> None:
    global status
    status = new
    # Handlers may run on the render thread: areas are only touched on the main one.
    if not bpy.app.background:
        bpy.app.timers.register(_redraw, first_interval=0.0)


def _redraw() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in {"PROPERTIES", "IMAGE_EDITOR"}:
                area.tag_redraw()
