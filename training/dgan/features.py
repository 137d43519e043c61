# SPDX-License-Identifier: Apache-2.0
"""The 13 auxiliary channels of section 3.2 from Cycles' passes. src/models/dgan_features.c computes the same.

    0-2 normal            Denoising Normal (or Normal)
    3-5 world position    Position, centred and scaled by the frame's bounding box
    6-8 texture value 1   Denoising Albedo (or Diffuse Color)
    9-11 texture value 2  Glossy Color + Transmission Color
    12 depth              Denoising Depth (or Depth)

Figure 2 of the paper lists RGB colour too, which would make 16; colour is the generator's input. A missing pass is
zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from training.data.store import BACKGROUND_DEPTH


@dataclass(frozen=True)
class Auxiliary:
    """Raw passes of frames or crops; a missing one is None. position is already in its frame's box."""

    normal: Tensor | None  # [n,3,h,w]
    position: Tensor | None  # [n,3,h,w] in -1..1
    texture_1: Tensor | None  # [n,3,h,w], unbounded
    texture_2: Tensor | None
    depth: Tensor | None  # [n,1,h,w]


def is_hit(depth: Tensor) -> Tensor:
    """Where the camera saw a surface."""
    return (depth > 0) & (depth < BACKGROUND_DEPTH)


def box_position(position: Tensor, hit: Tensor) -> Tensor:
    """Position of one frame [3,h,w] to -1..1 by the box round its hits [1,h,w]; one scale for all axes; 0 elsewhere."""
    if not hit.any():
        return torch.zeros_like(position)
    inside = position[:, hit[0]]
    low, high = inside.amin(1), inside.amax(1)
    half = 0.5 * (high - low).amax()
    center = (0.5 * (low + high)).view(3, 1, 1)
    scale = 1 / half if half > 0 else torch.zeros(())
    return torch.where(hit, ((position - center) * scale).clamp(-1, 1), torch.zeros(()))


def squash(texture: Tensor) -> Tensor:
    """Colours without an upper bound to 0..2, about linear to 1."""
    texture = texture.clamp_min(0)
    return 2 * texture / (1 + texture)


def encode_depth(depth: Tensor, exponent: Tensor) -> Tensor:
    """Hits to 1 / (1 + depth) in 0..1, depth in units of the frame's 2^exponent [n]; background to -1."""
    scaled = depth * torch.exp2(-exponent.float()).view(-1, 1, 1, 1)
    return torch.where(is_hit(depth), 1 / (1 + scaled.clamp_min(0)), torch.full((), -1.0))


def make_auxiliary(passes: Auxiliary, depth_exponent: Tensor, like: Tensor) -> Tensor:
    """[n,13,h,w]; like [n,_,h,w] gives the size."""
    zero3 = torch.zeros_like(like[:, :1]).expand(-1, 3, -1, -1)
    return torch.cat(
        [
            zero3 if passes.normal is None else passes.normal.clamp(-1, 1),
            zero3 if passes.position is None else passes.position,
            zero3 if passes.texture_1 is None else squash(passes.texture_1),
            zero3 if passes.texture_2 is None else squash(passes.texture_2),
            zero3[:, :1] if passes.depth is None else encode_depth(passes.depth, depth_exponent),
        ],
        1,
    )
