# SPDX-License-Identifier: Apache-2.0
"""Random crops of packed frames, augmented, as batches of input and independent target.

Deterministic: batch i of seed s is the same whatever was drawn before, so a resumed run sees what an uninterrupted one
would have seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from training.data.pack import (
    INPUT,
    NUM_INPUT,
    NUM_TARGET,
    TARGET,
    PackedFrame,
    divide_color,
    sum_parts,
    to_target,
)
from training.features import Features, Guides, Layers, firefly_factor, limit_fireflies, log_exponent, make_features


@dataclass(frozen=True)
class CropConfig:
    crop: int = 128
    batch: int = 8
    light_fraction: float = 0.6  # of batches that have light passes; the others train Combined alone
    direct_fraction: float = 0.3  # of batches with light in which Combined is filtered by itself besides
    drop_guide: float = 0.1  # of batches, for each guide
    hide_spp: float = 0.2
    spp_weights: tuple[tuple[int, float], ...] = ((1, 0.5), (2, 0.8), (4, 2.0), (8, 1.2), (16, 1.5), (32, 1.0))
    max_gain_stops: float = 1.5  # of one pass group against another
    clean_share: float = 0.0  # of targets, of their denoised mean; less by the input's share of the frame's samples
    seed: int = 1


@dataclass(frozen=True)
class Batch:
    features: Features
    layers: Layers
    target: Layers  # light holds light x colour here
    level: Layers  # the target nearly without noise: what errors are relative to
    spp: Tensor
    with_direct: bool


def choose_input(frame: PackedFrame, rng: np.random.Generator, config: CropConfig) -> tuple[list[int], int]:
    """Indices of the renders averaged to the input, and its spp: the two of 1 spp make 2."""
    wanted = [(s, w) for s, w in config.spp_weights if s in frame.spp or (s == 2 and frame.spp.count(1) == 2)]
    weights = np.array([w for _, w in wanted])
    spp = wanted[rng.choice(len(wanted), p=weights / weights.sum())][0]
    ones = [i for i, s in enumerate(frame.spp) if s == 1]
    if spp == 2 and (2 not in frame.spp or (len(ones) == 2 and rng.random() < 0.5)):
        return ones, 2
    return [int(rng.choice([i for i, s in enumerate(frame.spp) if s == spp]))], spp


def combine_inputs(parts: list[np.ndarray]) -> np.ndarray:
    """Averages renders as Cycles would have: light passes through their products."""
    if len(parts) == 1:
        return parts[0]
    mean = sum(parts) / len(parts)
    product = sum(to_target(p)[TARGET["product"]] for p in parts) / len(parts)
    mean[INPUT["light"]] = divide_color(product, mean[INPUT["color"]])
    return mean


def crop_frame(
    frame: PackedFrame, rng: np.random.Generator, config: CropConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """One input [47,n,n], its independent target and the level of both [39,n,n], and the input's spp."""
    chosen, spp = choose_input(frame, rng, config)
    height, width = frame.sums.shape[1:]
    y = int(rng.integers(0, height - config.crop + 1))
    x = int(rng.integers(0, width - config.crop + 1))
    window = (slice(None), slice(y, y + config.crop), slice(x, x + config.crop))
    parts = [frame.inputs[i][window].astype(np.float32) for i in chosen]
    used = sum(to_target(p) * frame.spp[i] for p, i in zip(parts, chosen, strict=True))
    target = (frame.sums[window] - used) / (frame.total_spp - spp)
    level = frame.level(window)
    if frame.clean is not None:
        target += config.clean_share * (1 - spp / frame.total_spp) * (level - target)
    return combine_inputs(parts), target, level, spp


def turn(array: np.ndarray, flip_x: bool, flip_y: bool, transpose: bool) -> np.ndarray:
    if flip_x:
        array = array[:, :, ::-1]
    if flip_y:
        array = array[:, ::-1]
    return array.transpose(0, 2, 1) if transpose else array


def turn_normal(normal: np.ndarray, flip_x: bool, flip_y: bool, transpose: bool) -> np.ndarray:
    """Camera-space normals of a turned picture: x right, y up, while rows go down."""
    nx, ny, nz = normal
    nx = -nx if flip_x else nx
    ny = -ny if flip_y else ny
    if transpose:
        nx, ny = -ny, -nx
    return np.stack([nx, ny, nz])


RGB_INPUT = ("beauty", "light", "color", "emission", "albedo")
RGB_TARGET = ("beauty", "product", "color", "emission")


def augment(
    inputs: np.ndarray, wanted: list[np.ndarray], closes: bool, rng: np.random.Generator, config: CropConfig
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Turns, permutes colours, scales exposure and, where the passes sum to Combined, re-weights light by group: of one
    input, and alike of what is wanted in TARGET's channels."""
    flips = tuple(bool(b) for b in rng.integers(0, 2, 3))
    inputs, wanted = turn(inputs, *flips).copy(), [turn(array, *flips).copy() for array in wanted]
    inputs[INPUT["normal"]] = turn_normal(inputs[INPUT["normal"]], *flips)
    order = rng.permutation(3)
    tables = [(inputs, INPUT, RGB_INPUT), *((array, TARGET, RGB_TARGET) for array in wanted)]
    for array, table, names in tables:
        for name in names:
            part = array[table[name]]
            array[table[name]] = part.reshape(-1, 3, *part.shape[1:])[:, order].reshape(part.shape)
    exposure = np.float32(2.0 ** rng.uniform(-1, 1))
    tint = 2.0 ** rng.normal(0, 0.2, 3)
    gains = np.ones(5)
    if closes and rng.random() < 0.5:
        gains = 2.0 ** rng.uniform(-config.max_gain_stops, config.max_gain_stops, 5)
    factors = (exposure * gains[:, None] * tint[None]).astype(np.float32)  # [diffuse..volume, emission][rgb]
    if closes:
        by_part = factors[:4, None].repeat(2, 1).reshape(24, 1, 1)
        inputs[INPUT["light"]] *= by_part
        inputs[INPUT["emission"]] *= factors[4].reshape(3, 1, 1)
        for array in wanted:
            array[TARGET["product"]] *= by_part
            array[TARGET["emission"]] *= factors[4].reshape(3, 1, 1)
            array[TARGET["beauty"]] = sum_parts(array)
        inputs[INPUT["beauty"]] = sum_parts(to_target(inputs))
    else:
        factor = (exposure * tint).astype(np.float32).reshape(3, 1, 1)
        inputs[INPUT["beauty"]] *= factor
        for array in wanted:
            array[TARGET["beauty"]] *= factor
    return inputs, wanted


def to_layers(x: Tensor, has_light: bool) -> Layers:
    """INPUT's channels [n,47,h,w]."""
    if not has_light:
        return Layers(x[:, INPUT["beauty"]])
    return Layers(
        x[:, INPUT["beauty"]],
        x[:, INPUT["light"]].unflatten(1, (4, 2, 3)),
        x[:, INPUT["color"]].unflatten(1, (3, 3)),
        x[:, INPUT["emission"]],
    )


def to_guides(x: Tensor) -> Guides:
    return Guides(x[:, INPUT["albedo"]], x[:, INPUT["normal"]], x[:, INPUT["depth"]], x[:, INPUT["alpha"]])


def target_layers(t: Tensor) -> Layers:
    return Layers(
        t[:, TARGET["beauty"]],
        t[:, TARGET["product"]].unflatten(1, (4, 2, 3)),
        t[:, TARGET["color"]].unflatten(1, (3, 3)),
        t[:, TARGET["emission"]],
    )


def limit_layers(layers: Layers, spp: Tensor) -> Layers:
    """Fireflies are limited layer by layer before anything else sees them."""
    factor = firefly_factor(spp)
    if layers.light is None:
        return Layers(limit_fireflies(layers.beauty, factor))
    emitter = layers.emission.mean(1, keepdim=True)
    light = limit_fireflies(layers.light.flatten(0, 2), factor.repeat_interleave(8)).view_as(layers.light)
    return Layers(limit_fireflies(layers.beauty, factor, emitter), light, layers.color, layers.emission)


@dataclass(frozen=True)
class RawBatch:
    """What chance has decided of a batch: crops, augmented, and what the network will not be told."""

    inputs: Tensor  # [n,47,h,w] in INPUT's order
    target: Tensor  # [n,39,h,w] in TARGET's
    level: Tensor  # [n,39,h,w]
    spp: Tensor  # [n]
    known: Tensor  # [n] spp as the network sees it, 0: hidden
    jitter: Tensor  # [n] stops of exposure
    has_light: bool
    with_direct: bool  # whether Combined is to be filtered by itself
    dropped: tuple[bool, bool, bool]  # albedo, normal, depth


def draw_batch(frames: list[PackedFrame], index: int, config: CropConfig) -> RawBatch:
    """Batch `index`: all its crops either have light passes or have none."""
    rng = np.random.default_rng([config.seed, index])
    has_light = bool(rng.random() < config.light_fraction)
    closing = [f for f in frames if f.closes]
    pool = closing if has_light and closing else frames
    inputs = np.empty((config.batch, NUM_INPUT, config.crop, config.crop), np.float32)
    target = np.empty((config.batch, NUM_TARGET, config.crop, config.crop), np.float32)
    level = np.empty_like(target)
    spp = np.empty(config.batch, np.float32)
    for i in range(config.batch):
        frame = pool[int(rng.integers(len(pool)))]
        x, *wanted, spp[i] = crop_frame(frame, rng, config)
        inputs[i], (target[i], level[i]) = augment(x, wanted, frame.closes, rng, config)
    albedo, normal, depth = (bool(b) for b in rng.random(3) < config.drop_guide)
    known = spp * float(rng.random() >= config.hide_spp)
    jitter = rng.integers(-1, 2, config.batch).astype(np.float32)
    tensors = map(torch.from_numpy, (inputs, target, level, spp, known, jitter))
    with_direct = not has_light or bool(rng.random() < config.direct_fraction)
    return RawBatch(*tensors, has_light, with_direct, (albedo, normal, depth))


def finish_batch(raw: RawBatch) -> Batch:
    """The features of a batch, on the device that its crops are on."""
    x = raw.inputs
    layers = limit_layers(to_layers(x, raw.has_light), raw.known)
    guides = to_guides(x)
    for name, dropped in zip(("albedo", "normal", "depth"), raw.dropped, strict=True):
        if dropped:
            guides = replace(guides, **{name: None})
    exposure = x.new_tensor([log_exponent(b) for b in layers.beauty]) + raw.jitter
    depth = x.new_tensor([log_exponent(d) for d in x[:, INPUT["depth"]]])
    features = make_features(layers, guides, raw.known, exposure, depth)
    layers = replace(layers, albedo=guides.albedo)
    target, level = target_layers(raw.target), target_layers(raw.level)
    return Batch(features, layers, target, level, raw.spp, raw.with_direct)


def make_batch(frames: list[PackedFrame], index: int, config: CropConfig) -> Batch:
    """Batch `index`, whatever was drawn before."""
    return finish_batch(draw_batch(frames, index, config))
