# SPDX-License-Identifier: Apache-2.0
"""KPCN, the baseline that the paper compares with: Bako et al., Kernel-Predicting Convolutional Networks for Denoising
Monte Carlo Renderings, ACM Transactions on Graphics 36(4), 2017.

Two networks of 5x5 convolutions, one for diffuse light divided by its colour, one for the logarithm of all other light,
each predicting a 21x21 softmax kernel per pixel. The paper's are 8 layers of 100 channels and see the variance of every
feature; these are narrower, and the renders hold no variances.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.data.pack import INPUT, TARGET
from training.dgan.data import Batch
from training.dgan.features import encode_depth, squash
from training.dgan.generator import to_log
from training.dgan.losses import pixel_l1
from training.dgan.reconstruct import reconstruct
from training.features import log_exponent

RADIUS = 10  # 21x21
TAPS = (2 * RADIUS + 1) ** 2
ALBEDO_EPSILON = 0.00316  # the paper's
NUM_CHANNELS = 18


@dataclass(frozen=True)
class KpcnConfig:
    width: int = 16  # published: 100
    layers: int = 5  # hidden 5x5 convolutions; published: 8


@dataclass(frozen=True)
class Split:
    """Combined = diffuse * color + specular, and the features beside."""

    diffuse: Tensor  # [n,3,h,w], divided by color
    specular: Tensor
    color: Tensor  # diffuse colour + epsilon
    features: Tensor  # [n,7,h,w]: normal, albedo, depth


def split_light(passes: Tensor) -> Split:
    """INPUT's channels [n,47,h,w]. Where the render has no light passes, all light is specular."""
    beauty, light = passes[:, INPUT["beauty"]], passes[:, INPUT["light"]]
    color = passes[:, INPUT["color"]][:, :3]
    diffuse = (light[:, 0:3] + light[:, 3:6]) * color
    depth = passes[:, INPUT["depth"]]
    exponent = torch.tensor([float(log_exponent(one)) for one in depth])
    features = torch.cat(
        [
            passes[:, INPUT["normal"]].clamp(-1, 1),
            squash(passes[:, INPUT["albedo"]]),
            encode_depth(depth, exponent),
        ],
        1,
    )
    albedo = color + ALBEDO_EPSILON
    return Split(diffuse / albedo, (beauty - diffuse).clamp_min(0), albedo, features)


def gradients(x: Tensor) -> Tensor:
    """Horizontal and vertical differences of the channels' mean [n,2,h,w]."""
    mean = F.pad(x.mean(1, keepdim=True), (1, 0, 1, 0), mode="replicate")
    return torch.cat([mean[..., 1:, 1:] - mean[..., 1:, :-1], mean[..., 1:, 1:] - mean[..., :-1, 1:]], 1)


class KernelNet(nn.Module):
    def __init__(self, config: KpcnConfig) -> None:
        super().__init__()
        widths = [NUM_CHANNELS] + [config.width] * config.layers + [TAPS]
        self.layers = nn.ModuleList(nn.Conv2d(i, o, 5, padding=2) for i, o in zip(widths[:-1], widths[1:], strict=True))
        for layer in self.layers:
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, light: Tensor, features: Tensor) -> Tensor:
        """light: what the network sees of its component [n,3,h,w]; to logits [n,441,h,w]."""
        groups = (light, features[:, :3], features[:, 3:6], features[:, 6:7])
        x = torch.cat([light, features, *map(gradients, groups)], 1)
        for layer in self.layers[:-1]:
            x = F.relu(layer(x))
        return self.layers[-1](x)


class Kpcn(nn.Module):
    def __init__(self, config: KpcnConfig) -> None:
        super().__init__()
        self.diffuse, self.specular = KernelNet(config), KernelNet(config)

    def forward(self, split: Split) -> tuple[Tensor, Tensor, Tensor]:
        """Denoised diffuse (divided by colour), specular, and their sum as Combined."""
        exponent = torch.tensor([float(log_exponent(s)) for s in split.diffuse])
        diffuse = reconstruct(split.diffuse, self.diffuse(to_log(split.diffuse, exponent), split.features), RADIUS)
        logarithm = torch.log1p(split.specular)
        specular = torch.expm1(reconstruct(logarithm, self.specular(logarithm, split.features), RADIUS).clamp_max(80))
        return diffuse, specular, diffuse * split.color + specular


def kpcn_loss(model: Kpcn, batch: Batch) -> Tensor:
    """L1 of both components and of the sum: the paper trains the components first and the sum afterwards."""
    split = split_light(batch.passes)
    diffuse, specular, combined = model(split)
    product = batch.target_passes[:, TARGET["product"]]
    want = product[:, 0:3] + product[:, 3:6]
    rest = (batch.target - want).clamp_min(0)
    parts = pixel_l1(diffuse, want / split.color) + pixel_l1(torch.log1p(specular), torch.log1p(rest))
    return 0.5 * parts + pixel_l1(combined, batch.target)
