# SPDX-License-Identifier: Apache-2.0
"""One scene from (family, seed)."""

from __future__ import annotations

import random

import bpy

from training.scenes import textures
from training.scenes.core import FAMILIES, ShotMaker, Stage, rng_for


def vary_light_paths(scene: bpy.types.Scene, rng: random.Random) -> None:
    """Change what artists change to save time or fireflies, in four scenes of ten; validation keeps the defaults."""
    if rng.random() < 0.6:
        return
    scene.cycles.sample_clamp_indirect = rng.choice((0.0, 1.0, 3.0, 10.0, 50.0))
    scene.cycles.blur_glossy = rng.choice((0.0, 0.5, 1.0, 2.0))
    scene.cycles.caustics_reflective = rng.random() < 0.5
    scene.cycles.caustics_refractive = rng.random() < 0.7
    scene.cycles.max_bounces = rng.choice((4, 8, 12, 24))


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
    if stage.split == "train":
        vary_light_paths(scene, rng_for(name, seed, "light paths"))
    bpy.context.view_layer.update()
    return stage, maker
