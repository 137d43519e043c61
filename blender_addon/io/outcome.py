# SPDX-License-Identifier: GPL-3.0-or-later
"""What a denoise did, in words for people."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Outcome:
    """Adds up over view layers, views and files. seconds: wall clock by stage."""

    denoised: list[str] = field(default_factory=list)  # full layer names
    skipped: list[tuple[str, str]] = field(default_factory=list)  # name and reason
    notes: list[str] = field(default_factory=list)  # what would make the result better
    seconds: dict[str, float] = field(default_factory=dict)
    # In memory "set up", "read", "denoise" (the library alone), "write"; of files "save", "read", "denoise", "write".

    def add_seconds(self, stage: str, seconds: float) -> None:
        self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds

    def add_report(self, report: Any) -> None:
        """report: quell.Report."""
        self.denoised += report.names("denoised")
        self.skipped += [(layer.name, layer.reason) for layer in report.layers if layer.action == "skipped"]

    def add_guides_note(self, roles: set[str]) -> None:
        """Says once when the passes that help most are missing."""
        note = "For a better result, enable the passes Quell wants."
        if not {"denoising-albedo", "denoising-normal"} <= roles and note not in self.notes:
            self.notes.append(note)

    @property
    def total(self) -> float:
        return sum(self.seconds.values())

    def summary(self) -> str:
        if not self.denoised:
            return "Nothing needed denoising"
        layers = "1 pass" if len(self.denoised) == 1 else f"{len(self.denoised)} passes"
        skipped = f", {len(self.skipped)} skipped" if self.skipped else ""
        return f"Denoised {layers} in {self.total:.2f} s{skipped}"

    def details(self) -> list[str]:
        """Lines below the summary: what was skipped and why, then the notes."""
        reasons: dict[str, list[str]] = {}
        for name, reason in self.skipped:
            reasons.setdefault(reason, []).append(name.rpartition(".")[2])
        return [
            f"{reason[:1].upper()}{reason[1:]}: {', '.join(names)}" for reason, names in reasons.items()
        ] + self.notes
