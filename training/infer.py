# SPDX-License-Identifier: Apache-2.0
"""Denoises whole frames in PyTorch as the C library does: the reference of its golden tests, and of evaluation."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from training.data.crops import limit_layers
from training.data.store import BACKGROUND_DEPTH
from training.features import Features, Guides, Layers, log_exponent, make_features
from training.models.quell import Denoised, Quell, filter_layers

ALIGNMENT = 16


def pad_planes(x: Tensor | None, height: int, width: int) -> Tensor | None:
    return None if x is None else F.pad(x, (0, width - x.shape[-1], 0, height - x.shape[-2]))


def frame_features(layers: Layers, guides: Guides, spp: int) -> Features:
    """Features of one frame [1,...] with its own exposure and depth scale."""
    depth = guides.depth
    if depth is None:
        exponent = 0
    else:
        exponent = log_exponent(torch.where((depth > 0) & (depth < BACKGROUND_DEPTH), depth, 0)[0])
    return make_features(
        layers,
        guides,
        torch.tensor([float(spp)]),
        torch.tensor([float(log_exponent(layers.beauty[0]))]),
        torch.tensor([float(exponent)]),
    )


@torch.no_grad()
def denoise_frame(model: Quell, layers: Layers, guides: Guides, spp: int) -> Denoised:
    """One frame [1,c,h,w] of any size. Outside the image features are 0 and values have no weight, as in C."""
    height, width = layers.beauty.shape[-2:]
    h, w = -(-height // ALIGNMENT) * ALIGNMENT, -(-width // ALIGNMENT) * ALIGNMENT
    span = layers.beauty.min(), layers.beauty.max()
    layers = limit_layers(layers, torch.tensor([float(spp)]))
    features = frame_features(layers, guides, spp)
    planes = pad_planes(features.planes, h, w)
    inside = pad_planes(torch.ones_like(layers.beauty[:, :1]), h, w)
    layers = replace(layers, albedo=guides.albedo)
    padded = Layers(**{name: pad_planes(value, h, w) for name, value in vars(layers).items()})
    out = filter_layers(model.net, Features(planes, features.flags), padded, inside)
    cut = {name: None if value is None else value[..., :height, :width] for name, value in vars(out).items()}
    if cut["direct"] is not None:
        # What was divided by one albedo and multiplied by another stays within what the layer's pixels span.
        cut["direct"] = cut["direct"].clamp(*span)
    return replace(out, **cut)
