# SPDX-License-Identifier: Apache-2.0
"""Four discriminators of different scales, section 3.1, for the L1 form of eq. 6. The paper gives no layers."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.dgan.config import NUM_DISCRIMINATORS, DiscriminatorConfig
from training.dgan.generator import instance_norm
from training.dgan.losses import tone_map


class Discriminator(nn.Module):
    """(condition, candidate), 6 channels, to a map in [-1, 1]: eq. 6 has no maximum without a bound."""

    def __init__(self, config: DiscriminatorConfig) -> None:
        super().__init__()
        w = config.width
        widths, strides = (6, w, 2 * w, 4 * w, 1), (2, 2, 1, 1)
        self.layers = nn.ModuleList(
            nn.Conv2d(widths[i], widths[i + 1], 4, stride=strides[i], padding=2) for i in range(4)
        )
        for layer in self.layers:
            nn.init.normal_(layer.weight, std=0.02)
            nn.init.zeros_(layer.bias)

    def forward(self, condition: Tensor, candidate: Tensor) -> Tensor:
        x = torch.cat([condition, candidate], 1)
        for i, layer in enumerate(self.layers):
            x = layer(x)
            if i in (1, 2):
                x = instance_norm(x)
            if i < 3:
                x = F.leaky_relu(x, 0.2)
        return torch.tanh(x.float())


class Discriminators(nn.Module):
    """D_1 to D_4: the i-th sees the images reduced by 2^(i - 1)."""

    def __init__(self, config: DiscriminatorConfig) -> None:
        super().__init__()
        self.scales = nn.ModuleList(Discriminator(config) for _ in range(NUM_DISCRIMINATORS))

    def forward(self, noisy: Tensor, candidate: Tensor) -> list[Tensor]:
        """Linear radiance [n,3,h,w] to one map per scale."""
        condition, candidate = tone_map(noisy), tone_map(candidate)
        maps = []
        for i, scale in enumerate(self.scales):
            if i > 0:
                condition, candidate = F.avg_pool2d(condition, 2), F.avg_pool2d(candidate, 2)
            maps.append(scale(condition, candidate))
        return maps
