# SPDX-License-Identifier: Apache-2.0
"""The kernel pyramid: every filtered pixel is a convex combination of valid input pixels.

Values travel in homogeneous form: channels (v * x, v) with a validity v >= 0 that is 0 for bad pixels and outside the
image. Every step below is linear with non-negative weights, so one division at the end gives a convex combination of
valid pixels, and borders and holes need no case of their own.

    x_(l+1) = sum over 2x2 of d_l * x_l                              d_l: softmax over the four (partition)
    y_l     = (1 - a_l) * K_l x_l + a_l * U_l y_(l+1)                K_l: softmax over 5x5, U_l: over 3x3 parents
    result  = y_0[values] / y_0[validity]

K and U are guided: a tap's logit falls with the squared distance of two embeddings, that of the pixel and that of the
tap, in units that the network predicts for each pixel:

    logit_k(p) = table_k + [k is the centre] centre(p) - sum_e exp(scale_e(p)) * (e(p) - e(q_k))^2

With embeddings made of normals, albedo and depth this is a joint bilateral filter, which is where training starts.
Closest published relatives: the partitioning pyramid of Balint et al. 2023, the affinities of Isik et al. 2021.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from training.native import GuidedKernel, Partition, TakePlanes

FILTER_RADIUS, UP_RADIUS = 2, 1
FILTER_TAPS, UP_TAPS = 25, 9
MAX_SCALE = 8.0  # of |scale|: e^8 is as sharp as a kernel can be


def guided_kernel_reference(
    source: Tensor,
    embedding: Tensor,
    other: Tensor,
    scale: Tensor,
    centre: Tensor | None,
    table: Tensor,
    image: Tensor,
    group: Tensor,
    radius: int,
    shift: int,
) -> Tensor:
    """Plain PyTorch form of `training.native.GuidedKernel`, for n items over some images and groups.

    source [n,c,h,w]; embedding [images,e,H,W] of the output's pixels, other [images,e,h,w] of the taps;
    scale [n,e,H,W]; centre [n,1,H,W] or None; table [groups,1 or 4,taps] (4: by the parity of y and x);
    image, group [n]: which embedding and which table an item uses. shift 1: H, W are twice h, w, and the taps lie
    round the parent pixel."""
    taps = (2 * radius + 1) ** 2

    def unfold(x: Tensor) -> Tensor:
        n, channels, h, w = x.shape
        out = F.unfold(x, 2 * radius + 1, padding=radius).view(n, channels, taps, h, w)
        return out.repeat_interleave(2, -1).repeat_interleave(2, -2) if shift else out

    distance = (embedding[:, :, None] - unfold(other))[image].square()  # [n,e,taps,H,W]
    logits = -(distance * scale.exp()[:, :, None]).sum(1)
    height, width = scale.shape[-2:]
    if shift:
        y = torch.arange(height, device=table.device)[:, None] % 2
        x = torch.arange(width, device=table.device)[None] % 2
        logits = logits + table[group][:, (y * 2 + x)].permute(0, 3, 1, 2)
    else:
        logits = logits + table[group][:, 0, :, None, None]
    if centre is not None:
        logits = logits + F.pad(centre, (0, 0, 0, 0, taps // 2, taps // 2))
    return (unfold(source) * logits.softmax(1)[:, None]).sum(2)


def guided_kernel(*args) -> Tensor:
    """`guided_kernel_reference` in C where the data is on the CPU."""
    return GuidedKernel.apply(*args) if args[0].device.type == "cpu" else guided_kernel_reference(*args)


def partition(values: Tensor, logits: Tensor) -> Tensor:
    """`partition_reference` in C where the data is on the CPU."""
    return Partition.apply(values, logits) if values.device.type == "cpu" else partition_reference(values, logits)


def partition_reference(values: Tensor, logits: Tensor) -> Tensor:
    """[n,c,h,w] and [n,1,h,w] to [n,c,h/2,w/2]: a softmax-weighted mean of each 2x2 cell."""
    weights = F.pixel_unshuffle(logits, 2).softmax(1)  # [n,4,h/2,w/2]
    n, channels, height, width = values.shape
    cells = F.pixel_unshuffle(values, 2).view(n, channels, 4, height // 2, width // 2)
    return (cells * weights[:, None]).sum(2)


Choice = tuple[Tensor, int, float | None]  # indices of first planes, planes from each, bound of their values


def take_planes_reference(x: Tensor, fine: int, choices: list[Choice]) -> tuple[Tensor, ...]:
    """Planes by their index of all images' planes, float32 and clamped: for each choice [len(first),planes,h,w].

    x [images,planes,h,w]; fine 2: [images,4 planes,h/2,w/2], in the order of `pixel_shuffle`. No plane twice."""
    planes = F.pixel_shuffle(x, fine).flatten(0, 1)
    out = []
    for first, count, bound in choices:
        taken = planes[(first[:, None] + torch.arange(count)).to(x.device)].float()
        out.append(taken if bound is None else taken.clamp(-bound, bound))
    return tuple(out)


def take_planes(x: Tensor, fine: int, choices: list[Choice]) -> tuple[Tensor, ...]:
    """`take_planes_reference` in C where the data is on the CPU."""
    if x.device.type != "cpu":
        return take_planes_reference(x, fine, choices)
    return TakePlanes.apply(x, fine, *(part for choice in choices for part in choice))


@dataclass(frozen=True)
class Level:
    """What the network says of one level, float32. up_table, blend and down are None at the coarsest, importance (of
    the level's own pixels) everywhere but at the finest."""

    embedding: Tensor  # [images,e,h,w]
    pooled: Tensor  # [images,e,h/2,w/2]: of the parents, as upsampling sees them
    scale: Tensor  # [n,e,h,w]
    centre: Tensor  # [n,1,h,w]
    table: Tensor  # [groups,1,25]
    up_table: Tensor | None = None  # [groups,4,9]
    blend: Tensor | None = None  # [n,1,h,w]
    down: Tensor | None = None  # [n,1,h,w]
    importance: Tensor | None = None  # [n,1,h,w]


def filter_level(values: Tensor, level: Level, image: Tensor, group: Tensor) -> Tensor:
    """K_l on one level's values [n,c,h,w]."""
    return guided_kernel(
        values, level.embedding, level.embedding, level.scale, level.centre, level.table, image, group, FILTER_RADIUS, 0
    )


def filter_pyramid(values: Tensor, levels: list[Level], image: Tensor, group: Tensor) -> Tensor:
    """Runs the pyramid on homogeneous values [n,c,h,w] of n items; returns y_0."""
    inputs = [values]
    for level in levels[:-1]:
        assert level.down is not None
        inputs.append(partition(inputs[-1], level.down))
    result = filter_level(inputs[-1], levels[-1], image, group)
    for level, x in zip(reversed(levels[:-1]), reversed(inputs[:-1]), strict=True):
        assert level.up_table is not None and level.blend is not None
        up = guided_kernel(
            result, level.embedding, level.pooled, level.scale, None, level.up_table, image, group, UP_RADIUS, 1
        )
        fine = filter_level(x, level, image, group)
        result = fine + torch.sigmoid(level.blend) * (up - fine)
    return result
