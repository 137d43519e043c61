# SPDX-License-Identifier: Apache-2.0
"""Render passes to network inputs. src/models/features.c computes the same; tests compare the two.

Exposure and depth are normalised by powers of two taken from the whole frame, so that scaling a frame by a power of two
scales the result exactly and a crop sees what the frame sees.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from training.data.store import BACKGROUND_DEPTH

NUM_FEATURES = 32
NUM_FLAGS = 6
GUIDE_PLANES = slice(15, 28)  # albedo, normal, depth, alpha, colours: what the embedding starts from
DETAIL_PLANES = (
    28,
    31,
)  # direct diffuse light, emission: with the guides and the mean of beauty, what it looks closely at
BIN = 8  # pixels along the edge of a bin of the log average: one firefly spoils one bin
KEY_EXPONENT = 2  # the log average is brought to 2^-2, near middle grey
FIREFLY_FACTOR = 0.8125  # times the root of the samples: see firefly_factor
MIN_FIREFLY_FACTOR, MAX_FIREFLY_FACTOR = 1.625, 16.0
UNKNOWN_FIREFLY_FACTOR = 4.0  # where the number of samples is not known
FIREFLY_REACH = 2  # pixels that a firefly is compared with, to each side
MIN_NEIGHBOURS = 8  # without as many nothing is a firefly


@dataclass(frozen=True)
class Layers:
    """What is filtered. Scene-linear, finite. None: the frame has no light passes, or no albedo."""

    beauty: Tensor  # [n,3,h,w]
    light: Tensor | None = None  # [n,4,2,3,h,w]: diffuse, glossy, transmission, volume; direct, indirect
    color: Tensor | None = None  # [n,3,3,h,w]: diffuse, glossy, transmission
    emission: Tensor | None = None  # [n,3,h,w]: what else belongs to Combined: emission and environment
    albedo: Tensor | None = None  # [n,3,h,w]: what beauty is divided by while it is filtered


@dataclass(frozen=True)
class Guides:
    """Auxiliary features; a missing one is None."""

    albedo: Tensor | None  # [n,3,h,w], unbounded
    normal: Tensor | None  # [n,3,h,w], camera space
    depth: Tensor | None  # [n,1,h,w], 0 or beyond BACKGROUND_DEPTH on background
    alpha: Tensor | None  # [n,1,h,w]


@dataclass(frozen=True)
class Features:
    planes: Tensor  # [n,NUM_FEATURES,h,w]
    flags: Tensor  # [n,NUM_FLAGS]


def log_exponent(image: Tensor) -> int:
    """k such that 2^k is nearest to the log average of an image [c,h,w]: over bins of 8x8 pixels, those above zero."""
    luminance = image.float().mean(0)
    height, width = luminance.shape
    padded = torch.nn.functional.pad(luminance, (0, -width % BIN, 0, -height % BIN))
    bins = padded.view(-(-height // BIN), BIN, -(-width // BIN), BIN).sum((1, 3))
    count = torch.nn.functional.pad(torch.ones_like(luminance), (0, -width % BIN, 0, -height % BIN))
    bins = bins / count.view(-(-height // BIN), BIN, -(-width // BIN), BIN).sum((1, 3))
    bins = bins[bins > 0]
    if bins.numel() == 0:
        return 0
    mantissa, exponent = torch.frexp(bins)
    return int(torch.floor(torch.log2(mantissa.double()).mean() + exponent.double().mean() + 0.5))


def tone(radiance: Tensor) -> Tensor:
    """Radiance, normalised to a log average near 1/4, to about 0..3."""
    return 0.5 * torch.log1p(8 * radiance.clamp_min(0))


def squash(color: Tensor) -> Tensor:
    """Albedo and other colours without an upper bound to 0..2; about linear to 1."""
    color = color.clamp_min(0)
    return 2 * color / (1 + color)


def firefly_factor(spp: Tensor) -> Tensor:
    """How many times brighter than its brightest neighbour a single pixel may be, by samples per pixel (0: unknown). A
    stray sample weighs less the more there are, and a glint that many samples agree on is none."""
    known = (FIREFLY_FACTOR * torch.sqrt(spp)).clamp(MIN_FIREFLY_FACTOR, MAX_FIREFLY_FACTOR)
    return torch.where(spp > 0, known, torch.full_like(known, UNKNOWN_FIREFLY_FACTOR))


def limit_fireflies(image: Tensor, factor: Tensor, emitter: Tensor | None = None) -> Tensor:
    """Scales single pixels brighter than `factor` [n] times their brightest of 24 neighbours down to that bound.

    emitter [n,1,h,w]: radiance that is known to be emitted towards the camera, which is no noise and raises the bound.
    """
    luminance = image.mean(1, keepdim=True)
    reach = FIREFLY_REACH
    rows = torch.nn.functional.pad(luminance, (reach, reach, reach, reach))
    height, width = luminance.shape[-2:]
    bound = torch.zeros_like(luminance)
    for dy in range(2 * reach + 1):
        for dx in range(2 * reach + 1):
            if (dy, dx) != (reach, reach):
                bound = torch.maximum(bound, rows[..., dy : dy + height, dx : dx + width])
    bound = factor.view(-1, 1, 1, 1) * bound
    # Too few neighbours to compare with: tiny images.
    across, down = (torch.arange(size, device=image.device) for size in (width, height))
    around = [(x.clamp_max(reach) + 1 + (x.numel() - 1 - x).clamp_max(reach)) for x in (down, across)]
    bound = torch.where(around[0][:, None] * around[1] > MIN_NEIGHBOURS, bound, torch.full_like(bound, torch.inf))
    if emitter is not None:
        bound = torch.maximum(bound, 2 * emitter)
    # Without any light around there is nothing to compare with.
    scale = torch.where((luminance > bound) & (bound > 0), bound / luminance.clamp_min(1e-30), torch.ones_like(bound))
    return image * scale


def make_features(layers: Layers, guides: Guides, spp: Tensor, exposure: Tensor, depth_exponent: Tensor) -> Features:
    """spp [n] (0: unknown), exposure [n]: log_exponent of beauty, depth_exponent [n]: that of the valid depth."""
    n, _, height, width = layers.beauty.shape
    like = layers.beauty
    zero3 = torch.zeros_like(like)
    zero1 = zero3[:, :1]
    scale = torch.exp2(-exposure.float() - KEY_EXPONENT).view(n, 1, 1, 1)
    planes = [tone(layers.beauty * scale)]
    if layers.light is not None:
        planes += [tone(layers.light[:, i].sum(1) * scale) for i in range(4)]
    else:
        planes += [zero3] * 4
    planes.append(zero3 if guides.albedo is None else squash(guides.albedo))
    planes.append(zero3 if guides.normal is None else guides.normal.clamp(-1, 1))
    if guides.depth is None:
        planes.append(zero1)
    else:
        valid = (guides.depth > 0) & (guides.depth < BACKGROUND_DEPTH)
        depth = guides.depth * torch.exp2(-depth_exponent.float()).view(n, 1, 1, 1)
        planes.append(torch.where(valid, 1 / (1 + depth), zero1))
    planes.append(torch.ones_like(zero1) if guides.alpha is None else guides.alpha.clamp(0, 1))
    if layers.color is not None:
        planes.append(squash(layers.color[:, 0]))
        planes += [squash(layers.color[:, i].mean(1, keepdim=True)) for i in (1, 2)]
    else:
        planes += [zero3, zero1, zero1]
    if layers.light is not None:
        planes += [tone(layers.light[:, i, 0].mean(1, keepdim=True) * scale) for i in range(3)]
        planes.append(tone(layers.emission.mean(1, keepdim=True) * scale))
    else:
        planes += [zero1] * 4
    have = [layers.light, guides.albedo, guides.normal, guides.depth]
    flags = torch.stack(
        [
            *(torch.full_like(spp, float(x is not None)) for x in have),
            torch.where(spp > 0, torch.log2(spp.clamp_min(1)) / 8, torch.zeros_like(spp)),
            (spp > 0).to(spp.dtype),
        ],
        dim=1,
    )
    return Features(torch.cat(planes, 1), flags)
