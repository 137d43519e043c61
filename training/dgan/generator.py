# SPDX-License-Identifier: Apache-2.0
"""The generator, section 3.1.1: encoder of four stride-2 convolutions, residual blocks, symmetric decoder with skips.

Every convolutional layer is convolution, instance normalisation, ReLU. The last one, to three channels, is bare.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.dgan.config import GENERATOR_LEVELS, GeneratorConfig

NORM_EPSILON = 1e-5
ALIGNMENT = 1 << GENERATOR_LEVELS
EXPOSURE_STOPS = 1  # the log average of a frame is brought to 2 before log(1 + x)


def instance_norm(x: Tensor) -> Tensor:
    """Zero mean and unit variance of each channel over the whole image. PyTorch's refuses images of one pixel."""
    x = x.float()
    mean = x.mean((2, 3), keepdim=True)
    variance = (x - mean).square().mean((2, 3), keepdim=True)
    return (x - mean) * torch.rsqrt(variance + NORM_EPSILON)


class Layer(nn.Module):
    """Convolution 3x3, instance normalisation, ReLU. The normalisation takes any bias out again, so there is none."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride=stride, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(instance_norm(self.conv(x)))


class ResidualBlock(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = Layer(width, width)
        self.second = Layer(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(self.first(x))


def mirror_index(size: int, padded: int) -> Tensor:
    """Indices that continue 0 .. size - 1 by reflection about the last pixel, as often as needed."""
    period = max(1, 2 * (size - 1))
    i = torch.arange(padded) % period
    return torch.where(i < size, i, period - i)


def mirror_pad(x: Tensor) -> Tensor:
    """Pads right and bottom to multiples of 16."""
    height, width = x.shape[-2:]
    rows = mirror_index(height, -(-height // ALIGNMENT) * ALIGNMENT)
    columns = mirror_index(width, -(-width // ALIGNMENT) * ALIGNMENT)
    return x[:, :, rows][:, :, :, columns]


class Generator(nn.Module):
    """Radiance in the network's logarithm [n,3,h,w] to the same, denoised."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        w, d = config.widths, config.decoder
        self.encoder = nn.ModuleList(Layer(3 if i == 0 else w[i - 1], w[i], stride=2) for i in range(GENERATOR_LEVELS))
        self.blocks = nn.ModuleList(ResidualBlock(w[3]) for _ in range(config.blocks))
        # What each upsampling sees: the tensor before it joined with the encoder's of the same size.
        joined = (w[3] + w[3], d[0] + w[2], d[1] + w[1], d[2] + w[0])
        self.decoder = nn.ModuleList(Layer(joined[i], d[i]) for i in range(GENERATOR_LEVELS))
        # At full resolution the encoder's tensor is the network's input.
        self.last = nn.Conv2d(d[3] + 3, 3, 3, padding=1)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.normal_(module.weight, std=config.deviation)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)

    def forward(self, x: Tensor) -> Tensor:
        """h and w are multiples of 16."""
        skips = [x]
        for layer in self.encoder:
            skips.append(layer(skips[-1]))
        y = skips[-1]
        for block in self.blocks:
            y = block(y)
        for layer in self.decoder:
            y = torch.cat([y, skips.pop()], 1)
            y = layer(F.interpolate(y, scale_factor=2, mode="nearest"))
        return self.last(torch.cat([y, skips.pop()], 1))


def to_log(radiance: Tensor, exponent: Tensor) -> Tensor:
    """log(1 + s x), s = 2^(1 - exponent) a power of two so that scaling a frame is exact. exponent [n]."""
    scale = torch.exp2(EXPOSURE_STOPS - exponent.float()).view(-1, 1, 1, 1)
    return torch.log1p(scale * radiance.clamp_min(0))


def from_log(y: Tensor, exponent: Tensor, top: Tensor) -> Tensor:
    """The inverse, limited to 0 .. top [n,1,1,1], the brightest value of the input's logarithm. Gradients pass the
    limits: a generator that starts below 0 must be able to rise."""
    y = y.float()
    limited = y + (torch.minimum(y.clamp_min(0), top) - y).detach()
    return torch.expm1(limited) * torch.exp2(exponent.float() - EXPOSURE_STOPS).view(-1, 1, 1, 1)


def generate(generator: Generator, radiance: Tensor, exponent: Tensor) -> Tensor:
    """G(z) of images of any size, in and out in scene-linear radiance [n,3,h,w]."""
    height, width = radiance.shape[-2:]
    y = to_log(radiance, exponent)
    top = y.flatten(1).amax(1).view(-1, 1, 1, 1)
    return from_log(generator(mirror_pad(y))[..., :height, :width], exponent, top)
