# SPDX-License-Identifier: GPL-3.0-or-later
"""A record of a batch run, one JSON object per line, for farms: Blender itself exits with 0 whatever a handler met."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from .outcome import Outcome

EXIT_FAILED = 1


class Journal:
    """Writes lines to the file that `path` names, if any. Failures are printed too."""

    def __init__(self, path: str = "") -> None:
        self.path = Path(path) if path else None

    def done(self, frame: int | str, outcome: Outcome) -> None:
        self._write(
            {
                "frame": frame,
                "status": "done",
                "denoised": outcome.denoised,
                "skipped": dict(outcome.skipped),
                "seconds": {stage: round(seconds, 4) for stage, seconds in outcome.seconds.items()},
            }
        )

    def failed(self, frame: int | str, sentence: str) -> None:
        print(f"quell: frame {frame}: {sentence}", file=sys.stderr, flush=True)
        self._write({"frame": frame, "status": "failed", "message": sentence})

    def _write(self, entry: dict[str, object]) -> None:
        if self.path is None:
            return
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
        except OSError as error:
            print(f"quell: the record {self.path} cannot be written: {error}", file=sys.stderr, flush=True)
