# SPDX-License-Identifier: Apache-2.0
"""What a denoise did, or would do, as plain Python values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LayerReport:
    """What happened to one layer, and why."""

    name: str  # full: "ViewLayer.Combined"
    action: str  # "denoised", "skipped", "guide" or "untouched"
    reason: str
    bad_pixels: int  # NaN, infinite or absurd, replaced from their neighbours
    limited_pixels: int  # fireflies
    mean_before: float
    mean_after: float


@dataclass(frozen=True)
class Report:
    """seconds_*: wall clock, 0 in a plan. peak_bytes: working memory beyond the frame's own pixels."""

    layers: tuple[LayerReport, ...]
    model: str
    combined: str  # how Combined was rebuilt: "direct", "from passes", ...
    peak_bytes: int
    num_tiles: int
    precision: str  # "float32" or "bfloat16": of numbers inside the network
    macs_per_pixel: float
    seconds_features: float
    seconds_network: float
    seconds_filter: float
    seconds_total: float

    def names(self, action: str) -> list[str]:
        """Full names of the layers with this action, in the frame's order."""
        return [layer.name for layer in self.layers if layer.action == action]
