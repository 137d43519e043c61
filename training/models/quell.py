# SPDX-License-Identifier: Apache-2.0
"""The quell family: one small U-Net at half resolution guides a kernel pyramid for each pass.

guides [13]   -> 1x1, and with three more and the U-Net's finest features three 3x3: an embedding at full resolution,
                 which follows edges
features [32] -> 2x2 stride 2 -> U-Net at 1/2, 1/4, 1/8, 1/16 (3x3 convolutions, ReLU, additive skips)
              -> heads (1x1), one per level: its share of the embedding, and for each pass how sharply each of its
                 dimensions is looked at, a bonus for the centre, a blend, a partition, at full resolution an importance
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.features import DETAIL_PLANES, GUIDE_PLANES, NUM_FEATURES, NUM_FLAGS, Features, Layers
from training.models.pyramid import FILTER_TAPS, MAX_SCALE, UP_TAPS, Level, filter_pyramid, take_planes

LIGHTS = ("diffuse", "glossy", "transmission", "volume")
PARTS = ("direct", "indirect")
GROUPS = ("beauty", *(f"{light}_{part}" for light in LIGHTS for part in PARTS), "color", "emission")
LEVELS = 5
EMBEDDING = 10  # dimensions; all passes share them
DETAIL_INPUTS = 16  # what the convolutions at full resolution see
GROUP_FIELDS = {"scale": EMBEDDING, "centre": 1, "blend": 1, "down": 1, "importance": 1}
FIELDS_AT = (5, 4, 4, 4, 2)  # how many of these a level has
IMPORTANCE_RANGE = 12.0  # logits beyond it change nothing; keeps the division far from underflow
ALBEDO_EPSILON = 0.02  # added to the albedo that Combined is divided by: what is black has highlights still


def group_planes(level: int) -> int:
    """Planes of one group's head at a level."""
    return sum(list(GROUP_FIELDS.values())[: FIELDS_AT[level]])


def head_planes(level: int) -> int:
    """Planes of a level's whole head: groups, then the embedding."""
    return len(GROUPS) * group_planes(level) + EMBEDDING


@dataclass(frozen=True)
class QuellConfig:
    """Widths of the U-Net at 1/2, 1/4, 1/8, 1/16, and how many 3x3 convolutions each level has, down and up; the width
    at full resolution."""

    widths: tuple[int, int, int, int] = (48, 64, 80, 96)
    down_convs: tuple[int, int, int, int] = (1, 1, 1, 2)
    up_convs: tuple[int, int, int] = (1, 1, 2)  # at 1/2, 1/4, 1/8
    detail: int = 16  # channels at full resolution


@dataclass(frozen=True)
class Denoised:
    """Results, all [n,3,h,w] in the input's exposure; None: not asked for, or not in the frame."""

    direct: Tensor | None = None  # Combined by kernels of its own
    rebuilt: Tensor | None = None  # Combined as the sum of what follows
    light: Tensor | None = None  # [n,4 groups,2,3,h,w]: direct and indirect of diffuse, glossy, transmission, volume
    color: Tensor | None = None  # [n,3 groups,3,h,w]
    emission: Tensor | None = None

    @property
    def combined(self) -> Tensor:
        """Combined of a frame whose passes sum to it."""
        combined = self.direct if self.rebuilt is None else self.rebuilt
        assert combined is not None
        return combined


@dataclass(frozen=True)
class Head:
    """What a level's head says of n items, each a group of an image, and of every image; float32. What a level has not
    is None."""

    embedding: Tensor  # [images,e,h,w]: the head's share
    scale: Tensor  # [n,e,h,w], within MAX_SCALE
    centre: Tensor  # [n,1,h,w]
    blend: Tensor | None = None  # [n,1,h,w]
    down: Tensor | None = None  # [n,1,h,w]
    importance: Tensor | None = None  # [n,1,h,w]


def take_head(x: Tensor, level: int, image: Tensor, group: Tensor) -> Head:
    """x: what the level's convolution made, [images,head_planes,h,w]; at full resolution
    [images,4 head_planes,h/2,w/2], the pixels of a cell of 2x2 one after another."""
    fields = dict(list(GROUP_FIELDS.items())[: FIELDS_AT[level]])
    first = image * head_planes(level) + group * group_planes(level)
    choices = []  # first planes, how many from each, bound
    for name, planes in fields.items():
        choices.append((first, planes, MAX_SCALE if name == "scale" else None))
        first = first + planes
    own = torch.arange(len(x)) * head_planes(level) + len(GROUPS) * group_planes(level)
    *taken, embedding = take_planes(x, 2 if level == 0 else 1, [*choices, (own, EMBEDDING, None)])
    return Head(embedding, **dict(zip(fields, taken, strict=True)))


def conv3x3(channels: int) -> nn.Conv2d:
    return nn.Conv2d(channels, channels, 3, padding=1)


class QuellNet(nn.Module):
    """Features to what guides the kernels."""

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
        self.heads = nn.ModuleList(
            nn.Conv2d(w[max(level - 1, 0)], head_planes(level) * (4 if level == 0 else 1), 1) for level in range(LEVELS)
        )
        self.guides = nn.Conv2d(GUIDE_PLANES.stop - GUIDE_PLANES.start, EMBEDDING, 1, bias=False)
        self.filter_table = nn.ParameterList(torch.zeros(len(GROUPS), 1, FILTER_TAPS) for _ in range(LEVELS))
        self.up_table = nn.ParameterList(torch.zeros(len(GROUPS), 4, UP_TAPS) for _ in range(LEVELS - 1))
        self.detail_in = nn.Conv2d(DETAIL_INPUTS, config.detail, 3, padding=1)
        self.detail_up = nn.Conv2d(w[0], config.detail, 1, bias=False)
        self.detail_mid = conv3x3(config.detail)
        self.detail_out = nn.Conv2d(config.detail, EMBEDDING, 3, padding=1)
        self.initialise()

    def initialise(self) -> None:
        """He initialisation in the body. Heads start small, the embedding as normal, albedo and depth, the tables as a
        Gaussian and a tent: the first step sees a joint bilateral filter rather than the mean of 150 pixels."""
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        for level, head in enumerate(self.heads):
            fine = 4 if level == 0 else 1
            nn.init.normal_(head.weight, std=0.01)
            nn.init.normal_(head.weight[-EMBEDDING * fine :], std=0.5 / head.weight.shape[1] ** 0.5)
            bias = head.bias.data.view(-1, fine)
            for group in range(len(GROUPS)):
                own = bias[group * group_planes(level) :]
                if group > 0:
                    own[3:6] = -2.0  # light without its colour need not heed albedo
                if level == 0:
                    own[group_planes(0) - 1] = 2.0  # importance: sigmoid(2) = 0.88
        nn.init.zeros_(self.detail_out.weight)
        nn.init.zeros_(self.detail_up.weight)
        nn.init.zeros_(self.guides.weight)
        for dimension, plane, gain in [(0, 3, 3.0), (1, 4, 3.0), (2, 5, 3.0), (3, 0, 4.0), (4, 1, 4.0), (5, 2, 4.0),
                                       (6, 6, 6.0), (7, 7, 4.0)]:  # fmt: skip
            self.guides.weight.data[dimension, plane] = gain
        offset = torch.arange(FILTER_TAPS)
        gauss = -((offset // 5 - 2) ** 2 + (offset % 5 - 2) ** 2) / 8.0
        for table in self.filter_table:
            table.data[:] = gauss
        tent = torch.tensor([[0.25, 0.75, 0.02], [0.02, 0.75, 0.25]])  # of the parents before, at and behind, by parity
        for table in self.up_table:
            for y in range(2):
                for x in range(2):
                    table.data[:, 2 * y + x] = (tent[y][:, None] * tent[x][None]).flatten().log()

    def forward(self, features: Tensor, flags: Tensor) -> tuple[list[Tensor], Tensor]:
        """features [n,32,h,w] (h, w multiples of 16), flags [n,6] to what `take_head` takes, by level, and the
        embedding's share that is made at full resolution [n,e,h,w], float32."""
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
        planes = [self.heads[level](levels[max(level, 1)]) for level in range(LEVELS)]
        return planes, self.detail(features, levels[1])

    def detail(self, features: Tensor, finest: Tensor) -> Tensor:
        """finest [n,w0,h/2,w/2]: the U-Net's, which knows what lies around."""
        guides = features[:, GUIDE_PLANES]
        seen = torch.cat([guides, features[:, DETAIL_PLANES], features[:, :3].mean(1, keepdim=True)], 1)
        around = F.interpolate(self.detail_up(finest), scale_factor=2, mode="nearest")
        x = F.relu(self.detail_in(seen) + around)
        x = F.relu(self.detail_mid(x))
        return self.guides(guides).float() + self.detail_out(x).float()

    def embeddings(self, passed: Tensor, heads: list[Head]) -> list[tuple[Tensor, Tensor]]:
        """By level [n,e,h,w] and its means of 2x2: the share at full resolution, passed down by those means, plus the
        heads'."""
        out = []
        for head in heads:
            embedding = passed + head.embedding
            passed = F.avg_pool2d(embedding, 2)
            out.append((embedding, passed))
        return out

    def levels(self, heads: list[Head], embeddings: list[tuple[Tensor, Tensor]], items: slice) -> list[Level]:
        """The pyramid of some of the heads' items."""
        out = []
        for level, (head, (embedding, pooled)) in enumerate(zip(heads, embeddings, strict=True)):
            last = level + 1 == LEVELS
            names = list(GROUP_FIELDS)[: FIELDS_AT[level]]
            out.append(
                Level(
                    embedding=embedding,
                    pooled=pooled,
                    table=self.filter_table[level],
                    up_table=None if last else self.up_table[level],
                    **{name: getattr(head, name)[items] for name in names},
                )
            )
        return out


def importance_weight(logits: Tensor) -> Tensor:
    return torch.sigmoid(logits.clamp(-IMPORTANCE_RANGE, IMPORTANCE_RANGE))


def divide(values: Tensor) -> Tensor:
    """Homogeneous values back to pixels."""
    values, validity = values.split([values.shape[1] - 1, 1], 1)
    return values / validity.clamp_min(1e-20)


def filter_layers(
    net: QuellNet, features: Features, layers: Layers, inside: Tensor | None = None, with_direct: bool = True
) -> Denoised:
    """Applies the network's kernels to the frame's layers and puts Combined together again.

    inside [n,1,h,w]: 0 where padding lies outside the image and must have no weight; None: all is inside.
    with_direct False: Combined is not filtered by itself where there is light to sum it from."""
    planes, detail = net(features.planes, features.flags)
    n = layers.beauty.shape[0]
    if inside is None:
        inside = torch.ones_like(layers.beauty[:, :1])
    # Items: Combined of every image, then the light passes and the emission that are not black, then the colours.
    num_direct = n if with_direct or layers.light is None else 0
    all_images = torch.arange(n)
    images, groups = [all_images[:num_direct]], [torch.zeros(num_direct, dtype=torch.long)]
    divisor = None if layers.albedo is None else layers.albedo.clamp(0, 1) + ALBEDO_EPSILON
    if divisor is None:
        values, validity = [layers.beauty[:num_direct]], [inside[:num_direct]]
    else:
        values = [(layers.beauty / divisor)[:num_direct]]
        validity = [(inside * divisor.mean(1, keepdim=True))[:num_direct]]
    colors = [] if divisor is None or num_direct == 0 else [divisor]
    if layers.light is not None:
        # Weighed by its colour, light times colour is the mean of the products where both kernels agree.
        scale = layers.color.mean(2, keepdim=True).clamp_max(1)
        weights = torch.cat([scale, torch.ones_like(inside)[:, None]], 1) * inside[:, None]
        passes = layers.light.flatten(1, 2)  # [n,8,3,h,w]
        lit = passes.flatten(2).any(2).cpu().nonzero()
        glowing = layers.emission.flatten(1).any(1, keepdim=True).cpu().nonzero()[:, 0]
        images += [lit[:, 0], glowing]
        groups += [lit[:, 1] + 1, torch.full_like(glowing, GROUPS.index("emission"))]
        values += [passes[lit[:, 0], lit[:, 1]], layers.emission[glowing]]
        validity += [weights[lit[:, 0], lit[:, 1] // 2], inside[glowing]]
        colors.append(layers.color.flatten(1, 2))
    counts = [len(part) for part in images]
    images.append(all_images)
    groups.append(torch.full_like(all_images, GROUPS.index("color")))
    image, group = torch.cat(images), torch.cat(groups)
    heads = [take_head(x, level, image, group) for level, x in enumerate(planes)]
    embeddings = net.embeddings(detail, heads)

    def run(values: Tensor, validity: Tensor, items: slice) -> Tensor:
        levels = net.levels(heads, embeddings, items)
        assert levels[0].importance is not None
        weight = importance_weight(levels[0].importance) * validity
        return divide(filter_pyramid(torch.cat([values * weight, weight], 1), levels, image[items], group[items]))

    num = sum(counts)
    direct, *filtered = run(torch.cat(values), torch.cat(validity), slice(num)).split(counts)
    if colors:
        color = run(torch.cat(colors, 1), inside, slice(num, None))
        if divisor is not None and num_direct > 0:
            # Textures pass by the light's kernels: they are put on again from the albedo, filtered as a colour.
            direct, color = direct * color[:, :3], color[:, 3:]
    if layers.light is None:
        return Denoised(direct)

    light = torch.zeros_like(passes).index_put((lit[:, 0], lit[:, 1]), filtered[0]).view_as(layers.light)
    emission = torch.zeros_like(layers.emission).index_put((glowing,), filtered[1])
    # Light without a colour is "no data", not darkness to be filled from beside: it stays what it was.
    known = (layers.color != 0).any(2, keepdim=True)
    colored = torch.cat([known, torch.ones_like(known[:, :1])], 1)
    light = torch.where(colored[:, :, None], light, layers.light)
    color = color.view_as(layers.color)
    parts = light.sum(2)
    rebuilt = (parts[:, :3] * color).sum(1) + parts[:, 3] + emission
    return Denoised(None if num_direct == 0 else direct, rebuilt, light, color, emission)


class Quell(nn.Module):
    """Layers in, denoised layers out."""

    def __init__(self, config: QuellConfig) -> None:
        super().__init__()
        self.net = QuellNet(config)

    def forward(self, features: Features, layers: Layers, with_direct: bool = True) -> Denoised:
        return filter_layers(self.net, features, layers, with_direct=with_direct)


def multiply_adds(config: QuellConfig, groups: int) -> float:
    """Multiply-adds of the convolutions per image pixel, when so many groups of layers are filtered."""
    w, per = config.widths, (1 / 4, 1 / 16, 1 / 64, 1 / 256)
    total = NUM_FEATURES * w[0] * 4 * per[0] + w[0] * config.detail * per[0]
    total += 9 * config.detail * (DETAIL_INPUTS + config.detail + EMBEDDING)
    for i in range(4):
        total += config.down_convs[i] * 9 * w[i] ** 2 * per[i]
        total += EMBEDDING * w[i] * per[i]
    for i in range(3):
        total += 4 * w[i] * w[i + 1] * per[i + 1] + w[i + 1] * w[i] * per[i + 1]
        total += config.up_convs[i] * 9 * w[i] ** 2 * per[i]
    head = group_planes(0) * w[0] + sum(group_planes(i + 1) * w[i] * per[i] for i in range(4))
    total += groups * head + EMBEDDING * (w[0] + GUIDE_PLANES.stop - GUIDE_PLANES.start)
    return total


def multiply_adds_range(config: QuellConfig) -> tuple[float, float]:
    """Of Combined with its albedo, and of all light passes."""
    return multiply_adds(config, 2), multiply_adds(config, len(GROUPS) - 1)
