# SPDX-License-Identifier: GPL-3.0-or-later
"""Work on a thread of its own, while Blender's interface goes on. The thread must not touch bpy."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Job:
    """Runs work(progress) at once. The owner polls `is_done` and `fraction`; then `result` or `error` is set.

    work gets a progress function to hand to the library: it notes the fraction and says whether to stop.
    """

    def __init__(self, work: Callable[[Callable[[float], bool]], Any]) -> None:
        self.fraction = 0.0
        self.result: Any = None
        self.error: Exception | None = None
        self._cancelled = threading.Event()
        self._work = work
        self._thread = threading.Thread(target=self._run, name="quell", daemon=True)
        self._thread.start()

    @property
    def is_done(self) -> bool:
        return not self._thread.is_alive()

    def cancel(self) -> None:
        """Asks the work to stop; it ends soon after with the library's CancelledError."""
        self._cancelled.set()

    def wait(self) -> None:
        self._thread.join()

    def _progress(self, fraction: float) -> bool:
        self.fraction = fraction
        return self._cancelled.is_set()

    def _run(self) -> None:
        try:
            self.result = self._work(self._progress)
        except Exception as error:  # whatever it is, the owner's thread reports it
            self.error = error
