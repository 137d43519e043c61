# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user chose, as plain values that any thread may read."""

from __future__ import annotations

from dataclasses import dataclass

REPLACE = "REPLACE"  # the result takes the place of the noisy passes
ADD_PASS = "PASS"  # the result is a pass of its own, all others stay

LEVELS = ("fast", "balanced", "high")  # of quality, as the library names them

PASS_NAME = "Quell"
# Not "Noisy Image": where that pass is asked for, Cycles expects to denoise, and leaves Combined black otherwise.
KEPT_NAME = "Quell Noisy"
NOISY_NAME = "Noisy Image"  # Cycles' own, beside a Combined that it denoised


@dataclass(frozen=True)
class Settings:
    quality: str = ""  # one of LEVELS; "" is the library's default
    model: str = ""  # instead of a level: a built-in model or a weight file
    layers: str | None = None  # None: what suits the model, else "all", "beauty", or names, comma-separated
    keep_noisy: bool = False
    target: str = REPLACE
    threads: int = 0  # 0: one per core
    max_memory_bytes: int = 0  # 0: the library's default
