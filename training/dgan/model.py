# SPDX-License-Identifier: Apache-2.0
"""The whole of DGAN-KPN: generator and kernel prediction network joined by the reconstruction, figure 1."""

from __future__ import annotations

from torch import Tensor, nn

from training.dgan.config import MAX_ITERATIONS, DganKpnConfig
from training.dgan.generator import Generator, generate
from training.dgan.kpn import Kpn
from training.dgan.reconstruct import iterate_filter

PARTS = ("both", "dgan", "kpn")
READINGS = ("filter", "network")  # of "undergoes four iterations" and "the network is used again"


class DganKpn(nn.Module):
    def __init__(self, config: DganKpnConfig) -> None:
        super().__init__()
        self.config = config
        self.generator = Generator(config.generator)
        self.kpn = Kpn(config.kpn)

    def forward(
        self,
        noisy: Tensor,
        auxiliary: Tensor,
        exponent: Tensor,
        iterations: int = 4,
        parts: str = "both",
        reading: str = "filter",
    ) -> Tensor:
        """noisy [n,3,h,w] scene-linear, auxiliary [n,13,h,w], exponent [n] of the frame's log average."""
        if not 1 <= iterations <= MAX_ITERATIONS or parts not in PARTS or reading not in READINGS:
            raise ValueError(f"{iterations} iterations of '{parts}', reading '{reading}'")
        image = noisy
        rounds, filters = (iterations, 1) if reading == "network" else (1, iterations)
        logits = None if parts == "dgan" else self.kpn(auxiliary)  # of the features alone: the same in each round
        for _ in range(rounds):
            if parts != "kpn":
                image = generate(self.generator, image, exponent)
            if logits is not None:
                image = iterate_filter(image, logits, filters)
        return image
