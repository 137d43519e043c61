# SPDX-License-Identifier: Apache-2.0
"""Crops of packed frames for DGAN-KPN and KPCN: a noisy input, its auxiliary passes and an independent target.

Batch i of seed s is the same whatever was drawn before, so a resumed run sees what an uninterrupted one would have.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from training.data.crops import turn, turn_normal
from training.data.pack import INPUT, TARGET, PackedFrame, load_packs, to_target
from training.data.store import FrameRecord, list_frames, pass_slice, read_render
from training.dgan.features import Auxiliary, box_position, is_hit, make_auxiliary
from training.features import log_exponent
from training.paths import data_root, state_root


@dataclass(frozen=True)
class DataConfig:
    crop: int = 128
    batch: int = 1  # section 3.3
    spp_weights: tuple[tuple[int, float], ...] = ((1, 0.5), (2, 1.0), (4, 4.0), (8, 1.5), (16, 1.0), (32, 0.5))
    drop_position: float = 0.5  # files seldom have Position
    drop_other: float = 0.1  # normal, the textures, depth: each
    clean_share: float = 0.0  # of targets, of their denoised mean (training/data/clean.py), where a frame has one
    seed: int = 1


@dataclass(frozen=True)
class Frame:
    """A packed frame and what a crop of it needs from the whole."""

    packed: PackedFrame
    position: np.ndarray  # [3,h,w] float16, in the frame's box
    depth_exponent: int


@dataclass(frozen=True)
class Batch:
    noisy: Tensor  # [n,3,h,w] scene-linear
    target: Tensor  # [n,3,h,w], independent of noisy
    auxiliary: Tensor  # [n,13,h,w]
    exponent: Tensor  # [n], of noisy's log average
    passes: Tensor  # [n,47,h,w], training.data.pack.INPUT: KPCN splits light by them
    target_passes: Tensor  # [n,39,h,w], training.data.pack.TARGET


def frame_exponent(image: Tensor) -> Tensor:
    """[n] of images [n,c,h,w]."""
    return torch.tensor([float(log_exponent(one)) for one in image])


def depth_exponent(depth: Tensor) -> int:
    """Of the hits of [1,h,w]."""
    return log_exponent(torch.where(is_hit(depth), depth, torch.zeros(())))


def boxed_position(packed: PackedFrame, record: FrameRecord) -> np.ndarray:
    """Position [3,h,w] in the frame's box, float16. It is not in the packs: it is read from the render with the most
    samples and kept, because decoding all passes of a render takes a tenth of a second."""
    kept = state_root() / "positions" / f"{packed.name}.npy"
    if not kept.exists():
        numbered = {int(key.split("_")[0]): path for key, path in record.renders.items() if key[0].isdigit()}
        render = read_render(numbered[max(numbered)])
        depth = torch.from_numpy(packed.inputs[-1][INPUT["depth"]].astype(np.float32))
        position = torch.from_numpy(np.nan_to_num(render[pass_slice("Position")].astype(np.float32)))
        kept.parent.mkdir(parents=True, exist_ok=True)
        temporary = kept.with_suffix(".tmp.npy")
        np.save(temporary, box_position(position, is_hit(depth)).numpy().astype(np.float16))
        temporary.rename(kept)
    return np.load(kept)


def load_frames(split: str) -> list[Frame]:
    """Every packed frame of a split whose render is there."""
    records = {f"{r.family}-{r.name}": r for r in list_frames(data_root(), split)}
    frames = []
    for packed in load_packs(split):
        if packed.name in records:
            depth = torch.from_numpy(packed.inputs[-1][INPUT["depth"]].astype(np.float32))
            frames.append(Frame(packed, boxed_position(packed, records[packed.name]), depth_exponent(depth)))
    return frames


def second_texture(passes: Tensor) -> Tensor:
    """Glossy and transmission colour of INPUT's channels [n,47,h,w]."""
    color = passes[:, INPUT["color"]]
    return color[:, 3:6] + color[:, 6:9]


def crop(frame: Frame, rng: np.random.Generator, config: DataConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input [47,n,n], position [3,n,n], target [39,n,n] of one random window and sample count."""
    packed = frame.packed
    weight = dict(config.spp_weights)
    weights = np.array([weight.get(spp, 0.0) for spp in packed.spp])
    chosen = int(rng.choice(len(weights), p=weights / weights.sum()))
    height, width = packed.sums.shape[1:]
    y, x = (int(rng.integers(0, edge - config.crop + 1)) for edge in (height, width))
    window = (slice(None), slice(y, y + config.crop), slice(x, x + config.crop))
    inputs = packed.inputs[chosen][window].astype(np.float32)
    spp = packed.spp[chosen]
    target = (packed.sums[window] - spp * to_target(inputs)) / (packed.total_spp - spp)
    if packed.clean is not None:
        target += config.clean_share * (packed.level(window) - target)
    return inputs, frame.position[window].astype(np.float32), target


def augment(
    inputs: np.ndarray, position: np.ndarray, target: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turns, permutes the colour channels of everything, scales exposure, turns the axes of Position."""
    flips = tuple(bool(b) for b in rng.integers(0, 2, 3))
    inputs, position, target = (turn(a, *flips).copy() for a in (inputs, position, target))
    inputs[INPUT["normal"]] = turn_normal(inputs[INPUT["normal"]], *flips)
    position = position[rng.permutation(3)] * rng.choice((-1, 1), 3).reshape(3, 1, 1).astype(np.float32)
    order = rng.permutation(3)
    for name in ("beauty", "light", "color", "emission", "albedo"):
        part = inputs[INPUT[name]]
        inputs[INPUT[name]] = part.reshape(-1, 3, *part.shape[1:])[:, order].reshape(part.shape)
    target = target.reshape(-1, 3, *target.shape[1:])[:, order].reshape(target.shape)
    exposure = np.float32(2.0 ** rng.uniform(-1, 1))
    for name in ("beauty", "light", "emission"):
        inputs[INPUT[name]] *= exposure
    for name in ("beauty", "product", "emission"):
        target[TARGET[name]] *= exposure
    return inputs, position, target


def make_batch(frames: list[Frame], index: int, config: DataConfig) -> Batch:
    rng = np.random.default_rng([config.seed, index])
    chosen = [frames[int(rng.integers(len(frames)))] for _ in range(config.batch)]
    drawn = [augment(*crop(frame, rng, config), rng) for frame in chosen]
    inputs, position, target = (
        torch.from_numpy(np.stack(part).astype(np.float32)) for part in zip(*drawn, strict=True)
    )
    drop = rng.random(5) < np.array([config.drop_other, config.drop_position, *[config.drop_other] * 3])
    parts = (
        inputs[:, INPUT["normal"]],
        position,
        inputs[:, INPUT["albedo"]],
        second_texture(inputs),
        inputs[:, INPUT["depth"]],
    )
    passes = Auxiliary(*(None if gone else part for part, gone in zip(parts, drop, strict=True)))
    noisy = inputs[:, INPUT["beauty"]]
    auxiliary = make_auxiliary(passes, torch.tensor([float(f.depth_exponent) for f in chosen]), noisy)
    return Batch(noisy, target[:, TARGET["beauty"]].contiguous(), auxiliary, frame_exponent(noisy), inputs, target)


def batches(frames: list[Frame], first: int, config: DataConfig) -> Iterator[Batch]:
    index = first
    while True:
        yield make_batch(frames, index, config)
        index += 1
