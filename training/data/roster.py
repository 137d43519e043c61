# SPDX-License-Identifier: Apache-2.0
"""Which frames a run trains on, step by step, so that it can be repeated although new renders keep arriving.

<run>/frames.json is a journal: [{"step": 0, "frames": {name: total spp}}, ...]. The frames of a step are those of all
entries up to it; a frame that got more renders is named again. A run that goes on from an older checkpoint meets the
later entries again at their steps; only behind the last entry are new frames added.
"""

from __future__ import annotations

import json
from pathlib import Path

from training.data.pack import PackedFrame, load_packs, pack_new
from training.data.store import write_atomic


class RosterError(Exception):
    """A run's frames are not there any more, or there are none."""


class Roster:
    """The frames of one run. grow: whether new frames may join; without it a run keeps those it began with."""

    def __init__(self, folder: Path, split: str, min_renders: int, root: Path | None = None, grow: bool = True) -> None:
        self.path = folder / "frames.json"
        self.split, self.min_renders, self.root, self.grow = split, min_renders, root, grow
        self.entries: list[dict] = json.loads(self.path.read_text()) if self.path.exists() else []
        if not self.entries:
            self._append(0)
        if not self.entries:
            raise RosterError(f"no packed {split} frames: render some first (training/README.md)")

    def frames(self, step: int) -> list[PackedFrame]:
        """The frames of a step, by name."""
        known: dict[str, int] = {}
        for entry in self.entries:
            if entry["step"] <= step:
                known |= entry["frames"]
        packs = {frame.name: frame for frame in load_packs(self.split, self.root)}
        gone = sorted(known.keys() - packs.keys())
        if gone:
            raise RosterError(
                f"{len(gone)} frames of this run are gone, {gone[0]} for one; remove {self.path} to do without"
            )
        changed = [name for name, spp in known.items() if packs[name].total_spp != spp]
        if changed:
            print(f"{len(changed)} frames have other renders than before: the run is no exact repeat", flush=True)
        return [packs[name] for name in sorted(known)]

    def joins_at(self, step: int) -> bool:
        """Whether frames join at this very step."""
        return any(entry["step"] == step for entry in self.entries)

    def update(self, step: int) -> None:
        """Lets frames that are new on disk join at this step; does nothing while old entries are still ahead."""
        if self.grow and self.entries[-1]["step"] <= step:
            self._append(step)

    def _append(self, step: int) -> None:
        pack_new(self.split, self.min_renders, self.root)
        known = {name: spp for entry in self.entries for name, spp in entry["frames"].items()}
        packs = load_packs(self.split, self.root)
        new = {f.name: f.total_spp for f in packs if known.get(f.name) != f.total_spp}
        if new:
            self.entries.append({"step": step, "frames": new})
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(self.path, json.dumps(self.entries, indent=1).encode())
