# SPDX-License-Identifier: Apache-2.0
"""Whole frames through DGAN-KPN in PyTorch, from the passes that the C library reads: the reference of its tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from training.dgan.data import depth_exponent, frame_exponent
from training.dgan.features import Auxiliary, box_position, is_hit, make_auxiliary
from training.dgan.model import DganKpn


@dataclass(frozen=True)
class FramePasses:
    """Raw passes of one frame [1,c,h,w]; None where the file lacks one."""

    combined: Tensor
    normal: Tensor | None = None
    position: Tensor | None = None
    albedo: Tensor | None = None
    glossy: Tensor | None = None
    transmission: Tensor | None = None
    depth: Tensor | None = None


def frame_auxiliary(passes: FramePasses) -> Tensor:
    """[1,13,h,w], scaled by the whole frame."""
    colors = [c for c in (passes.glossy, passes.transmission) if c is not None]
    made = Auxiliary(passes.normal, None, passes.albedo, sum(colors) if colors else None, passes.depth)
    if passes.position is not None:
        hit = (passes.position != 0).any(1)[0:1] if passes.depth is None else is_hit(passes.depth[0])
        made = replace(made, position=box_position(passes.position[0], hit)[None])
    exponent = 0 if passes.depth is None else depth_exponent(passes.depth[0])
    return make_auxiliary(made, torch.tensor([float(exponent)]), passes.combined)


@torch.no_grad()
def denoise_frame(
    model: DganKpn, passes: FramePasses, iterations: int = 4, parts: str = "both", reading: str = "filter"
) -> Tensor:
    """Combined [1,3,h,w], any size."""
    exponent = frame_exponent(passes.combined)
    return model(passes.combined, frame_auxiliary(passes), exponent, iterations, parts, reading)
