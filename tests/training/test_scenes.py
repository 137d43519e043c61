# SPDX-License-Identifier: Apache-2.0
"""Scenes: the split, the same scene from the same seed, light groups and shadow catchers; needs Blender as a module."""

from __future__ import annotations

import pytest

pytest.importorskip("bpy", reason="scenes are built inside Blender")
pytest.importorskip("zstandard", reason="stored renders are compressed with it")

import numpy as np  # noqa: E402

from training import cycles, frames  # noqa: E402
from training.data.store import CHANNELS, pass_slice  # noqa: E402
from training.scenes import FAMILIES, build_scene, lights, rng_for  # noqa: E402
from training.scenes.core import Shot, apply_shot  # noqa: E402


def test_families_of_both_splits() -> None:
    splits = [entry.split for entry in FAMILIES.values()]
    assert splits.count("train") >= 16
    assert splits.count("val") >= 6


def test_environment_pictures_are_split_by_place() -> None:
    train, val = (set(lights.environment_pictures(split)) for split in ("train", "val"))
    assert train and val and not train & val
    assert not set(lights.environment_pictures("train", outdoor=True)) & {"studio", "interior"}


@pytest.mark.parametrize("family", ["product", "light_groups"])
def test_a_seed_is_a_scene(family: str) -> None:
    marks = []
    for seed in (3, 3, 4):
        stage, _ = build_scene(family, seed)
        marks.append(frames.fingerprint(stage.scene))
    assert marks[0] == marks[1] != marks[2]


def test_light_groups_sum_to_combined() -> None:
    stage, maker = build_scene("light_groups", 3)
    cycles.configure(stage.scene)
    names = cycles.extra_passes(stage.scene)
    assert "Combined_key" in names and cycles.SHADOW_CATCHER not in names
    apply_shot(stage.scene, maker(rng_for("shot")))
    cycles.set_view(stage.scene, (24, 16), None)
    render = cycles.render(stage.scene, 2, 1)
    assert render.pixels.shape == (len(CHANNELS), 16, 24)
    total = sum(render.extra[name] for name in names)
    assert np.allclose(total, render.pixels[pass_slice("Combined")][:3], rtol=1e-3, atol=1e-4)


def test_shadow_catcher_has_its_pass() -> None:
    stage, _ = build_scene("shadow_catcher", 1)
    cycles.configure(stage.scene)
    assert cycles.extra_passes(stage.scene) == [cycles.SHADOW_CATCHER]


def test_shots_with_more_in_them_are_chosen() -> None:
    stage, _ = build_scene("product", 3)
    away = Shot(_vector(0, -3, 40), _vector(0, -3, 80))
    towards = Shot(_vector(0, -2, 0.8), _vector(0, 0, 0.2))
    assert frames.interest(stage.scene, towards, 0.6) > frames.interest(stage.scene, away, 0.6)


def _vector(*values: float):  # noqa: ANN202 - mathutils exists only once bpy is imported
    from mathutils import Vector

    return Vector(values)
