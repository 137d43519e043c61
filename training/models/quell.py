# SPDX-License-Identifier: Apache-2.0
"""The quell family: one small U-Net at half resolution predicts kernel pyramids for groups of light passes.

features [28] -> 2x2 stride 2 -> U-Net at 1/2, 1/4, 1/8, 1/16 (3x3 convolutions, ReLU, additive skips)
              -> heads (1x1): per group 148 logits at 1/2 (4 fine pixels x 37), 36 at 1/2, 1/4, 1/8, 25 at 1/16
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.features import NUM_FEATURES, NUM_FLAGS, Features, Layers
from training.models.pyramid import (
    COARSE_LOGITS,
    FILTER_TAPS,
    FINE_LOGITS,
    MIDDLE_LOGITS,
    apply_kernel,
    filter_pyramid,
    split_level,
)

GROUPS = ("beauty", "diffuse", "glossy", "transmission", "volume")
LEVELS = 5
IMPORTANCE_RANGE = 12.0  # logits beyond it change nothing; keeps the division far from underflow
COLOR_EPSILON = 0.02  # a colour this small halves the weight of its light: the ratio is noise there


@dataclass(frozen=True)
class QuellConfig:
    """Widths of the U-Net at 1/2, 1/4, 1/8, 1/16, and how many 3x3 convolutions each level has, down and up."""

    widths: tuple[int, int, int, int] = (48, 64, 80, 96)
    down_convs: tuple[int, int, int, int] = (1, 1, 1, 2)
    up_convs: tuple[int, int, int] = (1, 1, 2)  # at 1/2, 1/4, 1/8


@dataclass(frozen=True)
class Denoised:
    """Results, all [n,3,h,w] in the input's exposure; light passes are None where the frame has none."""

    combined: Tensor
    direct: Tensor
    rebuilt: Tensor | None = None
    light: Tensor | None = None  # [n,4 groups,2,3,h,w]: direct and indirect of diffuse, glossy, transmission, volume
    color: Tensor | None = None  # [n,3 groups,3,h,w]
    emission: Tensor | None = None


def conv3x3(channels: int) -> nn.Conv2d:
    return nn.Conv2d(channels, channels, 3, padding=1)


class QuellNet(nn.Module):
    """Features to logits."""

    def __init__(self, config: QuellConfig) -> None:
        super().__init__()
        self.config = config
        w = config.widths
        self.stem = nn.Conv2d(NUM_FEATURES, w[0], 2, stride=2)
        self.flags = nn.Linear(NUM_FLAGS, w[0], bias=False)
        self.down = nn.ModuleList(nn.Conv2d(w[i], w[i + 1], 2, stride=2) for i in range(3))
        self.encoder = nn.ModuleList(
            nn.ModuleList(conv3x3(w[i]) for _ in range(config.down_convs[i])) for i in range(4)
        )
        self.up = nn.ModuleList(nn.Conv2d(w[i + 1], w[i], 1) for i in range(3))
        self.decoder = nn.ModuleList(nn.ModuleList(conv3x3(w[i]) for _ in range(config.up_convs[i])) for i in range(3))
        heads = {}
        for group in GROUPS:
            heads[f"{group}_0"] = nn.Conv2d(w[0], 4 * FINE_LOGITS, 1)
            for level in (1, 2, 3):
                heads[f"{group}_{level}"] = nn.Conv2d(w[level - 1], MIDDLE_LOGITS, 1)
            heads[f"{group}_4"] = nn.Conv2d(w[3], COARSE_LOGITS, 1)
        heads["color_0"] = nn.Conv2d(w[0], 4 * FILTER_TAPS, 1)
        heads["mix_0"] = nn.Conv2d(w[0], 4, 1)
        self.heads = nn.ModuleDict(heads)
        self.initialise()

    def initialise(self) -> None:
        """He initialisation in the body. Heads start small, with kernels that lean on their centre and on the finer
        level, so that the first steps see a mild blur rather than the mean of 150 pixels."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)
        for name, head in self.heads.items():
            nn.init.normal_(head.weight, std=0.01)
            fine = 4 if name.endswith("_0") else 1
            if name != "mix_0":
                head.bias.data.view(-1, fine)[FILTER_TAPS // 2] = 1.0
            if name.endswith("_0") and name not in ("mix_0", "color_0"):
                head.bias.data.view(-1, fine)[FINE_LOGITS - 1] = 2.0  # importance: sigmoid(2) = 0.88

    def forward(self, features: Tensor, flags: Tensor) -> dict[str, Tensor]:
        """features [n,28,h,w] (h, w multiples of 16), flags [n,6] to logits by head."""
        x = F.relu(self.stem(features) + self.flags(flags)[:, :, None, None])
        skips = []
        for level in range(4):
            for conv in self.encoder[level]:
                x = F.relu(conv(x))
            if level < 3:
                skips.append(x)
                x = F.relu(self.down[level](x))
        levels = {4: x}
        for level in (2, 1, 0):
            x = F.relu(skips[level] + F.interpolate(self.up[level](x), scale_factor=2, mode="nearest"))
            for conv in self.decoder[level]:
                x = F.relu(conv(x))
            levels[level + 1] = x
        out = {}
        for name, head in self.heads.items():
            level = int(name[-1])
            out[name] = head(levels[max(level, 1)])
            if level == 0:
                out[name] = F.pixel_shuffle(out[name], 2)
        return out


def group_levels(logits: dict[str, Tensor], groups: tuple[str, ...]) -> tuple[list, Tensor]:
    """The pyramid's levels for some groups, stacked along the batch, and their importance logits [n*groups,1,h,w]."""
    stacked = [torch.cat([logits[f"{group}_{level}"] for group in groups]) for level in range(LEVELS)]
    importance = stacked[0][:, FINE_LOGITS - 1 :]
    return [split_level(stacked[0][:, : FINE_LOGITS - 1]), *map(split_level, stacked[1:])], importance


def importance_weight(logits: Tensor) -> Tensor:
    return torch.sigmoid(logits.float().clamp(-IMPORTANCE_RANGE, IMPORTANCE_RANGE))


def filter_layers(logits: dict[str, Tensor], layers: Layers, inside: Tensor | None = None) -> Denoised:
    """Applies the predicted kernels to the frame's layers and puts Combined together again.

    inside [n,1,h,w]: 0 where padding lies outside the image and must have no weight; None: all is inside."""
    n = layers.beauty.shape[0]
    if inside is None:
        inside = torch.ones_like(layers.beauty[:, :1])
    levels, importance = group_levels(logits, ("beauty",))
    weight = importance_weight(importance) * inside
    filtered = filter_pyramid(torch.cat([layers.beauty * weight, weight], 1), levels)
    direct = filtered[:, :3] / filtered[:, 3:].clamp_min(1e-20)
    if layers.light is None:
        return Denoised(combined=direct, direct=direct)

    groups = GROUPS[1:]
    levels, importance = group_levels(logits, groups)
    scale = layers.color.mean(2, keepdim=True)  # [n,3,1,h,w]
    validity = torch.cat([scale / (scale + COLOR_EPSILON), torch.ones_like(scale[:, :1])], 1)
    validity = validity.transpose(0, 1).flatten(0, 1)  # [4n,1,h,w]: groups outermost, as in group_levels
    weight = importance_weight(importance) * validity * inside.repeat(len(groups), 1, 1, 1)
    light = layers.light.transpose(0, 1).flatten(0, 1).flatten(1, 2)  # [4n,6,h,w]
    values = filter_pyramid(torch.cat([light * weight, weight], 1), levels)
    light = values[:, :6] / values[:, 6:].clamp_min(1e-20)
    light = light.view(len(groups), n, 2, 3, *light.shape[2:]).transpose(0, 1)
    # Light without a colour is "no data", not darkness to be filled from beside: it stays what it was.
    colored = torch.cat([(layers.color != 0).any(2, keepdim=True), torch.ones_like(scale[:, :1], dtype=torch.bool)], 1)
    light = torch.where(colored[:, :, None], light, layers.light)

    # What the camera sees directly, colours and emitters, is noisy at edges and under blur alone: narrow kernels.
    seen = torch.cat([layers.color.flatten(1, 2), layers.emission, inside], 1)
    seen = apply_kernel(seen, logits["color_0"], 2, 0)
    seen = seen[:, :-1] / seen[:, -1:].clamp_min(1e-20)
    color, emission = seen[:, :9].view_as(layers.color), seen[:, 9:]
    rebuilt = (light[:, :3].sum(2) * color).sum(1) + light[:, 3].sum(1) + emission
    mix = torch.sigmoid(logits["mix_0"].float())
    combined = mix * rebuilt + (1 - mix) * direct
    return Denoised(combined, direct, rebuilt, light, color, emission)


class Quell(nn.Module):
    """Layers in, denoised layers out."""

    def __init__(self, config: QuellConfig) -> None:
        super().__init__()
        self.net = QuellNet(config)

    def forward(self, features: Features, layers: Layers) -> Denoised:
        return filter_layers(self.net(features.planes, features.flags), layers)


def multiply_adds(config: QuellConfig, groups: int, light: bool) -> float:
    """Multiply-adds of the convolutions per image pixel, when `groups` groups of layers are filtered."""
    w, per = config.widths, (1 / 4, 1 / 16, 1 / 64, 1 / 256)
    total = NUM_FEATURES * w[0] * 4 * per[0]
    for i in range(4):
        total += config.down_convs[i] * 9 * w[i] ** 2 * per[i]
    for i in range(3):
        total += 4 * w[i] * w[i + 1] * per[i + 1] + w[i + 1] * w[i] * per[i + 1]
        total += config.up_convs[i] * 9 * w[i] ** 2 * per[i]
    head = 4 * FINE_LOGITS * w[0] * per[0] + COARSE_LOGITS * w[3] * per[3]
    head += sum(MIDDLE_LOGITS * w[i] * per[i] for i in range(3))
    total += groups * head
    return total + (4 * (FILTER_TAPS + 1) * w[0] * per[0] if light else 0)
