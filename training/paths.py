# SPDX-License-Identifier: Apache-2.0
"""Where generated data and unpacked assets live, outside the checkout."""

from __future__ import annotations

import os
from pathlib import Path


def state_root() -> Path:
    """Return the folder for everything generated: QUELL_CACHE, or a folder in the user's cache."""
    override = os.environ.get("QUELL_CACHE")
    return Path(override) if override else Path.home() / ".cache" / "quell"


def data_root() -> Path:
    """Return the data set folder: QUELL_DATA, or a folder of the state."""
    override = os.environ.get("QUELL_DATA")
    return Path(override) if override else state_root() / "data"


def asset_root() -> Path:
    """Return the folder that holds unpacked third-party models."""
    return state_root() / "assets"
