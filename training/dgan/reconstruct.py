# SPDX-License-Identifier: Apache-2.0
"""Image reconstruction, section 3.1.3: softmax kernels applied to an image, several times.

Eq. 1 as printed lacks an exp and has 1/|S| too many; its own text asks for weights in [0, 1] of sum 1, which is the
softmax. The factor 1/|S| of eq. 2 would darken an image 361 times and is left out for the same reason.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from training.dgan.config import KERNEL_RADIUS
from training.dgan.native import WideKernel


def normalise_kernels(logits: Tensor) -> Tensor:
    """Eq. 1: exp(K) / sum of exp(K) over the taps [n,taps,h,w]."""
    return logits.float().softmax(1)


def reconstruct_reference(image: Tensor, logits: Tensor, radius: int = KERNEL_RADIUS) -> Tensor:
    """Eq. 2 in plain PyTorch: z(p) = sum of K(x, y) z(p + (x, y)). Taps outside the image are dropped and the others
    weighed anew."""
    n, channels, height, width = image.shape
    side = 2 * radius + 1
    values = torch.cat([image, torch.ones_like(image[:, :1])], 1)
    taps = F.unfold(values, side, padding=radius).view(n, channels + 1, side * side, height, width)
    out = (taps * normalise_kernels(logits)[:, None]).sum(2)
    return out[:, :-1] / out[:, -1:]


def reconstruct(image: Tensor, logits: Tensor, radius: int = KERNEL_RADIUS) -> Tensor:
    """The same by the native kernel, for training on a CPU."""
    values = torch.cat([image.float(), torch.ones_like(image[:, :1], dtype=torch.float32)], 1)
    out = WideKernel.apply(values, logits, radius)
    return out[:, :-1] / out[:, -1:]


def iterate_filter(image: Tensor, logits: Tensor, iterations: int) -> Tensor:
    """The same kernels applied to their own result."""
    for _ in range(iterations):
        image = reconstruct(image, logits)
    return image
