# SPDX-License-Identifier: Apache-2.0
"""What decides which frames are rendered: the plan of a run, the split of assets, the judgement of previews."""

from __future__ import annotations

import dataclasses
import random
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("zstandard", reason="stored renders are compressed with it")

from training import judge, render  # noqa: E402
from training.assets import Texture, split_of  # noqa: E402
from training.data.store import CHANNELS, pass_slice  # noqa: E402


def config(root: Path, **changes: object) -> render.Config:
    base = render.Config("train", ("a", "b"), 0, 2, (1, 1, 4), 1, 256, 64, 2, 90.0, str(root))
    return dataclasses.replace(base, **changes)


def test_renders_of_a_frame(tmp_path: Path) -> None:
    assert config(tmp_path).renders() == [("1_0", 1), ("1_1", 1), ("4_0", 4), ("ref_a", 256)]


def test_any_prefix_of_a_run_is_varied(tmp_path: Path) -> None:
    assert [(j.family, j.seed) for j in render.jobs(config(tmp_path))] == [("a", 0), ("b", 0), ("a", 1), ("b", 1)]


def test_what_exists_is_not_rendered_again(tmp_path: Path) -> None:
    plan, job = config(tmp_path), render.Job("a", 1)
    folder = render.frame_folder(plan, job, 0)
    folder.mkdir(parents=True)
    (folder / "1_0.qfr").touch()
    assert [name for name, _ in render.missing(plan, job, 0)] == ["1_1", "4_0", "ref_a"]
    render.reject(plan, job, 0, "flat")
    assert render.missing(plan, job, 0) == []
    assert render.marker(plan, job, 0).read_text() == "flat\n"
    assert render.count_frames(plan) == (1, 8)


def test_seeds_of_renders_differ() -> None:
    names = [("a", 0, 0, "1_0"), ("a", 0, 0, "1_1"), ("a", 0, 1, "1_0"), ("a", 1, 0, "1_0"), ("b", 0, 0, "1_0")]
    seeds = {render.cycles_seed(render.Job(f, s), c, n) for f, s, c, n in names}
    assert len(seeds) == len(names)


def test_variants_of_an_asset_stay_on_one_side() -> None:
    sides = {Texture("tile", Path(f"wicked/wickedtile8{v}.jpg"), None).split for v in ("", "a", "b", "c")}
    assert len(sides) == 1
    share = np.mean([split_of(f"model-{i}") == "val" for i in range(2000)])
    assert 0.2 < share < 0.3


def preview(light: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """A preview [C,h,w] with something at every pixel, of the given light and albedo [h,w]."""
    out = np.zeros((len(CHANNELS), *light.shape), np.float32)
    out[pass_slice("Combined")][:3] = light
    out[pass_slice("Combined")][3] = 1.0
    out[pass_slice("Denoising Albedo")] = albedo
    out[pass_slice("Denoising Normal")][2] = 1.0
    out[pass_slice("Depth")] = 3.0
    return out


def squares(size: int = 64) -> np.ndarray:
    y, x = np.mgrid[:size, :size]
    return np.where((x // 6 + y // 6) % 2, 0.8, 0.2)


def test_regions_that_no_artist_would_render() -> None:
    plain, full = np.full((64, 64), 0.5), np.ones((64, 64))
    assert judge.region_score(preview(squares(), squares()))[1] == ""
    assert judge.region_score(preview(0.001 * full, squares()))[1] == "black"
    assert judge.region_score(preview(100 * full, squares()))[1] == "burnt out"
    assert judge.region_score(preview(plain, plain))[1] == "flat"
    sky = preview(squares(), squares())
    sky[pass_slice("Depth")] = 0
    assert judge.region_score(sky)[1] == "empty sky"
    lamp = preview(squares(), squares())
    lamp[pass_slice("Emit")] = lamp[pass_slice("Combined")][:3]
    assert judge.region_score(lamp)[1] == "all emission"


def test_busy_regions_are_preferred() -> None:
    rng = random.Random(1)
    picture = preview(np.full((120, 208), 0.5), np.full((120, 208), 0.5))
    picture[pass_slice("Denoising Albedo"), 60:, 104:] = np.tile(squares(), (1, 2))[:60, :104]
    picture[pass_slice("Combined"), 60:, 104:] = np.tile(squares(), (1, 2))[:60, :104]
    region, reason = judge.choose_region(picture, (1280, 738), 256, rng)
    assert reason == ""
    x, y, w, h = region
    assert x + w > 640 and y + h > 369


def test_whole_pictures_that_are_useless() -> None:
    good = preview(squares(), squares())
    assert judge.whole_picture_fault(good) == ""
    assert judge.whole_picture_fault(0 * good) == "nothing to see"
    unlit = good.copy()
    unlit[pass_slice("Combined")][:3, :, :48] = 0
    assert judge.whole_picture_fault(unlit) == "hardly lit"
    close = good.copy()
    close[pass_slice("Depth")] = 0.05
    assert judge.whole_picture_fault(close) == "camera too close to something"


def test_gain_reaches_the_brightness_asked_for() -> None:
    dim = preview(0.02 * np.ones((64, 64)), squares())
    gain = judge.choose_gain(dim, 0.45)
    assert float(judge.tone(np.full(1, 0.02 * gain))[0]) == pytest.approx(0.45, abs=0.04)
    assert judge.choose_gain(dim, None) == 1.0
    assert judge.choose_gain(1e-9 * dim, 0.45) is None
