# SPDX-License-Identifier: Apache-2.0
"""The kernel pyramid: every filtered pixel is a convex combination of valid input pixels.

Values travel in homogeneous form: channels (v * x, v) with a validity v >= 0 that is 0 for bad pixels and outside the
image. Every step below is linear with non-negative weights, so one division at the end gives a convex combination of
valid pixels, and borders and holes need no case of their own.

    x_(l+1) = sum over 2x2 of d_l * x_l                              d_l: softmax over the four (partition)
    y_l     = (1 - a_l) * K_l x_l + a_l * U_l y_(l+1)                K_l: softmax over 5x5, U_l: over 3x3 parents
    result  = y_0[values] / y_0[validity]

Closest published relative: the partitioning pyramid of Balint et al. 2023.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from training.native import ApplyKernel

FILTER_TAPS = 25
UP_TAPS = 9
FINE_LOGITS = FILTER_TAPS + UP_TAPS + 3  # level 0: K, U, blend, partition, importance
MIDDLE_LOGITS = FILTER_TAPS + UP_TAPS + 2  # K, U, blend, partition
COARSE_LOGITS = FILTER_TAPS  # the last level


def apply_kernel_reference(source: Tensor, logits: Tensor, radius: int, shift: int) -> Tensor:
    """Plain PyTorch form of `training.native.ApplyKernel`. source [n,c,h,w], logits [n,taps,H,W]."""
    n, channels, height, width = source.shape
    side = 2 * radius + 1
    taps = F.unfold(source, side, padding=radius).view(n, channels, side * side, height, width)
    if shift:
        taps = taps.repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2)
    return (taps * logits.float().softmax(1)[:, None]).sum(2)


def apply_kernel(source: Tensor, logits: Tensor, radius: int, shift: int) -> Tensor:
    """Softmax kernels over (2 radius + 1)^2 taps; shift 1 takes the taps round the coarser level's parent pixel."""
    if source.device.type == "cpu":
        return ApplyKernel.apply(source, logits, radius, shift)
    return apply_kernel_reference(source.float(), logits, radius, shift)


def partition(values: Tensor, logits: Tensor) -> Tensor:
    """[n,c,h,w] and [n,1,h,w] to [n,c,h/2,w/2]: a softmax-weighted mean of each 2x2 cell."""
    weights = F.pixel_unshuffle(logits.float(), 2).softmax(1)  # [n,4,h/2,w/2]
    n, channels, height, width = values.shape
    cells = F.pixel_unshuffle(values, 2).view(n, channels, 4, height // 2, width // 2)
    return (cells * weights[:, None]).sum(2)


@dataclass(frozen=True)
class LevelLogits:
    """Logits of one level of one group; up, blend and down are None at the coarsest."""

    filter: Tensor  # [n,25,h,w]
    up: Tensor | None  # [n,9,h,w]
    blend: Tensor | None  # [n,1,h,w]
    down: Tensor | None  # [n,1,h,w]


def split_level(logits: Tensor) -> LevelLogits:
    """Names the channels of a level's head."""
    if logits.shape[1] == COARSE_LOGITS:
        return LevelLogits(logits, None, None, None)
    k, u = FILTER_TAPS, FILTER_TAPS + UP_TAPS
    return LevelLogits(logits[:, :k], logits[:, k:u], logits[:, u : u + 1], logits[:, u + 1 : u + 2])


def filter_pyramid(values: Tensor, levels: list[LevelLogits]) -> Tensor:
    """Runs the pyramid on homogeneous values [n,c,h,w]; returns y_0."""
    inputs = [values]
    for level in levels[:-1]:
        assert level.down is not None
        inputs.append(partition(inputs[-1], level.down))
    result = apply_kernel(inputs[-1], levels[-1].filter, 2, 0)
    for level, x in zip(reversed(levels[:-1]), reversed(inputs[:-1]), strict=True):
        assert level.up is not None and level.blend is not None
        blend = torch.sigmoid(level.blend.float())
        result = (1 - blend) * apply_kernel(x, level.filter, 2, 0) + blend * apply_kernel(result, level.up, 1, 1)
    return result
