# SPDX-License-Identifier: Apache-2.0
"""Scene generators.  Importing this package registers every family."""

import bpy  # noqa: F401, I001 - first: only then does mathutils exist

from training.scenes import (
    abstract,
    buildings,
    exteriors,
    fine,
    heldout,
    interiors,
    moods,
    organic,
    places,
    plants,
    stilllife,
    studio,
    wet,
)
from training.scenes.build import build_scene
from training.scenes.core import FAMILIES, Family, rng_for

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
    "organic",
    "places",
    "plants",
    "rng_for",
    "stilllife",
    "studio",
    "wet",
]
