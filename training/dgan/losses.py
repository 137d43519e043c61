# SPDX-License-Identifier: Apache-2.0
"""The paper's losses, by equation number. Images are scene-linear [n,3,h,w]; each loss is one number."""

from __future__ import annotations

import torch
from torch import Tensor

from training.dgan.config import LossFactors


def tone_map(image: Tensor) -> Tensor:
    """z / (1 + z) of eq. 9, negatives as 0."""
    image = image.clamp_min(0)
    return image / (1 + image)


def pixel_l1(image: Tensor, target: Tensor) -> Tensor:
    """L1 norm over channels, mean over pixels, mean over the batch's images."""
    return (image - target).abs().sum(1).mean()


def adversarial_loss(real: list[Tensor], fake: list[Tensor]) -> Tensor:
    """Eq. 6 and 7, summed over the discriminators as in eq. 4: real is D_i(z, g), fake D_i(z, G(z)) or D_i(z, z^)."""
    return sum((pixel_l1(r, f) for r, f in zip(real, fake, strict=True)), torch.zeros(()))


def kernel_loss(image: Tensor, target: Tensor) -> Tensor:
    """Eq. 8."""
    return pixel_l1(image, target)


def tone_loss(image: Tensor, target: Tensor) -> Tensor:
    """Eq. 9."""
    return pixel_l1(tone_map(image), tone_map(target))


def total_loss(adversarial: Tensor, kernel: Tensor, tone: Tensor, factors: LossFactors) -> Tensor:
    """Eq. 10."""
    return factors.adversarial * adversarial + factors.kernel * kernel + factors.tone * tone
