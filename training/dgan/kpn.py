# SPDX-License-Identifier: Apache-2.0
"""The kernel prediction network, section 3.1.2: source encoder, feature encoder, kernel predictor."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

from training.dgan.config import KERNEL_TAPS, NUM_AUXILIARY, KpnConfig


class ResidualBlock(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(x + self.second(F.relu(self.first(x))))


class Kpn(nn.Module):
    """Auxiliary features [n,13,h,w] to one 19x19 kernel's logits per pixel [n,361,h,w]."""

    def __init__(self, config: KpnConfig) -> None:
        super().__init__()
        width, size = config.width, config.source_size
        # The source encoder: two convolutions with enlarged kernels, their input joined through a skip.
        self.source_first = nn.Conv2d(NUM_AUXILIARY, width, size, padding=size // 2)
        self.source_second = nn.Conv2d(width, width, size, padding=size // 2)
        self.source_skip = nn.Conv2d(NUM_AUXILIARY, width, 1)
        self.blocks = nn.ModuleList(ResidualBlock(width) for _ in range(config.blocks))
        hidden = config.predictor
        self.predictor = nn.ModuleList(
            nn.Conv2d(i, o, 1) for i, o in ((width, hidden), (hidden, hidden), (hidden, KERNEL_TAPS))
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)  # section 3.3: Xavier, bias 0
                nn.init.zeros_(module.bias)

    def forward(self, auxiliary: Tensor) -> Tensor:
        x = F.relu(self.source_skip(auxiliary) + self.source_second(F.relu(self.source_first(auxiliary))))
        for block in self.blocks:
            x = block(x)
        for layer in self.predictor[:-1]:
            x = F.relu(layer(x))
        return self.predictor[-1](x)
