# SPDX-License-Identifier: Apache-2.0
"""Scene generators.  Importing this package registers every family."""

import bpy  # noqa: F401, I001 - first: only then does mathutils exist

from training.scenes import abstract, buildings, exteriors, fine, heldout, interiors, moods, plants, stilllife, wet
from training.scenes.core import FAMILIES, Family, build_scene, rng_for

__all__ = [
    "FAMILIES",
    "Family",
    "abstract",
    "buildings",
    "build_scene",
    "exteriors",
    "fine",
    "heldout",
    "interiors",
    "moods",
    "plants",
    "rng_for",
    "stilllife",
    "wet",
]
