# SPDX-License-Identifier: Apache-2.0
"""One scene from (family, seed)."""

from __future__ import annotations

import bpy

from training.scenes import textures
from training.scenes.core import FAMILIES, ShotMaker, Stage, rng_for


def build_scene(name: str, seed: int) -> tuple[Stage, ShotMaker]:
    """Replace everything in Blender by the scene (family, seed)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.unit_settings.system = "METRIC"
    stage = Stage(rng_for(name, seed), FAMILIES[name].split, scene)
    # A fifth of all pictures is moody, the rest is exposed as one would expect.
    stage.brightness = stage.rng.uniform(0.2, 0.35) if stage.chance(0.2) else stage.rng.uniform(0.38, 0.6)
    maker = FAMILIES[name].build(stage)
    textures.dress(stage)
    bpy.context.view_layer.update()
    return stage, maker
