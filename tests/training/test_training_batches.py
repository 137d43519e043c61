# SPDX-License-Identifier: Apache-2.0
"""Packing and batches: independent targets, order and augmentation by seed alone, faults reported and stepped over."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import RENDERS, clean_render, sum_passes, write_data_set

from training import export
from training.data import clean
from training.data.crops import Batch, CropConfig, augment, combine_inputs, crop_frame, make_batch
from training.data.pack import INPUT, TARGET, load_packs, pack_new, pack_root, select_passes, to_target
from training.data.store import CorruptRenderError, pass_slice, read_render
from training.data.stream import stream
from training.models.quell import Quell, QuellConfig

CROPS = CropConfig(crop=32, batch=2, seed=7)


def same(a: Batch, b: Batch) -> bool:
    """Bit by bit."""

    def tensors(value) -> list[torch.Tensor]:
        if isinstance(value, torch.Tensor):
            return [value]
        if isinstance(value, bool | None):
            return []
        return [t for part in vars(value).values() for t in tensors(part)]

    return all(torch.equal(x, y) for x, y in zip(tensors(a), tensors(b), strict=True))


@pytest.mark.parametrize("workers", [1, 3])
def test_batches_are_a_function_of_seed_and_step(workers: int, data_set: Path) -> None:
    frames = load_packs("train", data_set)
    made = [make_batch(frames, i, CROPS) for i in range(6)]
    make = functools.partial(make_batch, load_packs("train", data_set), config=CROPS)
    assert all(map(same, made, stream(make, 0, workers)))
    assert all(map(same, made[4:], stream(make, 4, workers)))


def test_a_failure_in_a_worker_reaches_the_reader() -> None:
    def make(index: int) -> int:
        if index == 2:
            raise ValueError("broken")
        return index

    items = stream(make, 0, 2)
    assert [next(items), next(items)] == [0, 1]
    with pytest.raises(ValueError, match="broken"):
        next(items)


def test_another_seed_gives_other_batches(data_set: Path) -> None:
    frames = load_packs("train", data_set)
    assert not torch.equal(
        make_batch(frames, 0, CROPS).target.beauty,
        make_batch(frames, 0, dataclasses.replace(CROPS, seed=8)).target.beauty,
    )
    assert not torch.equal(make_batch(frames, 0, CROPS).target.beauty, make_batch(frames, 1, CROPS).target.beauty)


def test_packing_is_repeatable_and_ordered(tmp_path: Path) -> None:
    roots = [write_data_set(tmp_path / name) for name in "ab"]
    for root in roots:
        assert pack_new("train", 6, root) == 3
        assert pack_new("train", 6, root) == 0  # nothing to do
    packs = [load_packs("train", root) for root in roots]
    assert [f.name for f in packs[0]] == [f.name for f in packs[1]] == sorted(f.name for f in packs[0])
    for a, b in zip(*packs, strict=True):
        assert np.array_equal(a.inputs, b.inputs) and np.array_equal(a.sums, b.sums) and a.spp == b.spp


def test_a_new_render_is_packed_in(tmp_path: Path) -> None:
    root = write_data_set(tmp_path, frames=1)
    held = root / "train" / "hills" / "00000_0" / "8_0.qfr"
    kept = held.rename(tmp_path / "8_0.qfr")
    assert pack_new("train", 5, root) == 1
    assert load_packs("train", root)[0].total_spp == 24
    kept.rename(held)
    assert pack_new("train", 5, root) == 1
    assert load_packs("train", root)[0].total_spp == 32


def test_target_is_the_mean_of_the_other_renders(data_set: Path) -> None:
    frame = load_packs("train", data_set)[0]
    folder = data_set / "train" / "/".join(frame.name.split("-", 1))
    total = sum(
        spp * to_target(select_passes(read_render(folder / f"{name}.qfr"), True)) for name, spp in RENDERS.items()
    )
    checked = set()
    for seed in range(12):
        x, target, level, spp = crop_frame(frame, np.random.default_rng(seed), dataclasses.replace(CROPS, crop=64))
        if spp == 2:
            continue  # one render or two: which cannot be told from the pixels
        np.testing.assert_allclose(target, (total - spp * to_target(x)) / (32 - spp), rtol=2e-3, atol=2e-3)
        together = (spp * to_target(x) + (32 - spp) * target) / 32
        np.testing.assert_allclose(level, together, rtol=2e-3, atol=2e-3)
        checked.add(spp)
    assert len(checked) >= 3


def test_two_renders_average_as_cycles_would_have(data_set: Path) -> None:
    """Light passes are ratios: the average's light times its colour is the mean of the products."""
    frame = load_packs("train", data_set)[0]
    pair = [frame.inputs[i].astype(np.float32) for i, spp in enumerate(frame.spp) if spp == 1]
    mean = combine_inputs([p.copy() for p in pair])
    expected = (to_target(pair[0]) + to_target(pair[1])) / 2
    np.testing.assert_allclose(to_target(mean)[TARGET["product"]], expected[TARGET["product"]], rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(mean[INPUT["beauty"]], expected[TARGET["beauty"]], rtol=1e-6)


def passes_sum_up(target: np.ndarray) -> bool:
    total = target[TARGET["product"]].reshape(8, 3, *target.shape[1:]).sum(0) + target[TARGET["emission"]]
    return bool(np.allclose(total, target[TARGET["beauty"]], rtol=1e-4, atol=1e-4))


@pytest.mark.parametrize("seed", range(8))
def test_augmentation_keeps_the_passes_summing_up(seed: int) -> None:
    clean = clean_render(32, 5)
    sum_passes(clean)
    inputs = select_passes(clean, True)
    target = to_target(inputs)
    turned, (wanted, level) = augment(inputs.copy(), [target, 2 * target], True, np.random.default_rng(seed), CROPS)
    assert passes_sum_up(to_target(turned)) and passes_sum_up(wanted) and np.array_equal(wanted[:27] * 2, level[:27])
    # A converged frame stays its own target, whatever was done to it.
    np.testing.assert_allclose(to_target(turned), wanted, rtol=1e-4, atol=1e-5)


def test_augmentation_without_closure_scales_combined_alone() -> None:
    inputs = select_passes(clean_render(32, 5), True)
    inputs[INPUT["beauty"]] = 3.0
    turned, (wanted,) = augment(inputs.copy(), [to_target(inputs)], False, np.random.default_rng(0), CROPS)
    assert np.array_equal(turned[INPUT["beauty"]], wanted[TARGET["beauty"]])
    for name in ("alpha", "depth"):
        assert sorted(turned[INPUT[name]].ravel()) == sorted(inputs[INPUT[name]].ravel())


def test_clean_estimates_are_what_errors_are_relative_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = write_data_set(tmp_path)
    monkeypatch.setenv("QUELL_DATA", str(root))
    pack_new("train", 5, root)
    weights = tmp_path / "small.qwt"
    torch.manual_seed(1)
    export.export(Quell(QuellConfig((16, 16, 16, 16))), weights, "small", "untrained")
    for _ in range(2):  # what is there already is left alone
        monkeypatch.setattr("sys.argv", ["clean", "--weights", str(weights)])
        clean.main()
    frame = load_packs("train", root)[0]
    assert frame.clean is not None and frame.clean.shape == frame.sums.shape
    found = frame.clean.astype(np.float32)
    if frame.closes:
        np.testing.assert_allclose(found[TARGET["beauty"]], clean.sum_parts(found), rtol=5e-3, atol=1e-3)
    window = (slice(None), slice(8, 40), slice(0, 32))
    np.testing.assert_array_equal(frame.level(window), frame.clean[window].astype(np.float32))
    # Denoised, not made up: about as bright as the mean of all renders.
    mean = frame.sums[TARGET["beauty"]].mean() / frame.total_spp
    assert frame.clean[TARGET["beauty"]].astype(np.float32).mean() == pytest.approx(mean, rel=0.1)


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "no render"])
def test_damaged_renders_are_reported_and_stepped_over(damage: str, tmp_path: Path, capsys) -> None:
    root = write_data_set(tmp_path)
    victim = root / "train" / "dunes" / "00001_0" / "4_0.qfr"
    content = bytearray(victim.read_bytes())
    if damage == "cut":
        content = content[: len(content) // 2]
    elif damage == "flipped":
        content[len(content) // 2] ^= 0x40
    elif damage == "empty":
        content = bytearray()
    else:
        content[:4] = b"JUNK"
    victim.write_bytes(content)
    with pytest.raises(CorruptRenderError, match="4_0.qfr"):
        read_render(victim)
    assert pack_new("train", 6, root) == 2
    assert "skipped" in (out := capsys.readouterr().out) and "4_0.qfr" in out
    assert [f.family for f in load_packs("train", root)] == ["hills", "hills"]


def test_nan_and_infinity_never_reach_a_batch(tmp_path: Path) -> None:
    root = write_data_set(tmp_path, frames=1)
    frame = root / "train" / "hills" / "00000_0"
    from training.data.store import write_render

    pixels = read_render(frame / "4_0.qfr").astype(np.float32)
    pixels[pass_slice("Combined"), 10, 10] = np.nan
    pixels[pass_slice("DiffDir"), 20, 20] = np.inf
    write_render(frame / "4_0.qfr", pixels, 4)
    assert pack_new("train", 6, root) == 1
    frames = load_packs("train", root)
    assert np.isfinite(frames[0].inputs.astype(np.float32)).all() and np.isfinite(frames[0].sums).all()
    for i in range(4):
        assert torch.isfinite(make_batch(frames, i, dataclasses.replace(CROPS, crop=64)).features.planes).all()


def test_packs_of_another_version_are_made_again(tmp_path: Path) -> None:
    root = write_data_set(tmp_path, frames=1)
    pack_new("train", 6, root)
    info = next(pack_root(root).glob("train/*/pack.json"))
    info.write_text(json.dumps({**json.loads(info.read_text()), "version": 0}))
    assert load_packs("train", root) == []
    assert pack_new("train", 6, root) == 1 and len(load_packs("train", root)) == 1
    shutil.rmtree(info.parent)
    assert pack_new("train", 6, root) == 1
