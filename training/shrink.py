# SPDX-License-Identifier: Apache-2.0
"""A narrower network that begins with the channels of a wider one that matter most (pruning by magnitude, as Li et al.
2017): what a short training has to start from."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from training.models.quell import Quell, QuellConfig, QuellNet


@dataclass
class Channels:
    """One set of channels: the convolutions that make it, and those that take it in."""

    makers: list[nn.Module]
    takers: list[nn.Module]


def channel_sets(net: QuellNet) -> list[list[Channels]]:
    """Every set of channels of the body, by level. What is added to each other is one set."""
    out: list[list[Channels]] = []
    for level in range(4):
        made: list[nn.Module] = [net.stem, net.flags] if level == 0 else [net.down[level - 1]]
        own = []
        for conv in net.encoder[level]:
            own.append(Channels(made, [conv]))
            made = [conv]
        if level < 3:
            skip = Channels([*made, net.up[level]], [net.down[level]])
            own.append(skip)
            for i, conv in enumerate(net.decoder[level]):
                if i == 0:
                    skip.takers.append(conv)
                else:
                    own.append(Channels(made, [conv]))
                made = [conv]
        heads = [net.heads[level + 1], *([net.heads[0], net.detail_up] if level == 0 else [])]
        own.append(Channels(made, [*heads, *([net.up[level - 1]] if level > 0 else [])]))
        out.append(own)
    return out


def weight_norms(module: nn.Module, dim: int) -> Tensor:
    """Of each output (0) or input (1) channel."""
    weight = module.weight.detach()
    return weight.transpose(0, dim).flatten(1).square().sum(1)


def keep_largest(channels: Channels, num: int) -> Tensor:
    """Indices, ascending, of the channels with the largest product of incoming and outgoing weights."""
    made = sum(weight_norms(module, 0) for module in channels.makers)
    taken = sum(weight_norms(module, 1) for module in channels.takers)
    return (made * taken).topk(num).indices.sort().values


def shrink(model: Quell, config: QuellConfig) -> Quell:
    """A network of `config`'s widths, none above the model's, with the same numbers of convolutions and as wide at full
    resolution."""
    old = model.net.config
    if (old.down_convs, old.up_convs) != (config.down_convs, config.up_convs):
        raise ValueError("a network shrinks in width alone: the numbers of convolutions differ")
    if any(a < b for a, b in zip(old.widths, config.widths, strict=True)) or old.detail != config.detail:
        raise ValueError(
            f"a network of widths {old.widths}, {old.detail} does not shrink into {config.widths}, {config.detail}"
        )
    kept_out: dict[nn.Module, Tensor] = {}
    kept_in: dict[nn.Module, Tensor] = {}
    for level, sets in enumerate(channel_sets(model.net)):
        for channels in sets:
            kept = keep_largest(channels, config.widths[level])
            kept_out |= dict.fromkeys(channels.makers, kept)
            kept_in |= dict.fromkeys(channels.takers, kept)
    state = model.state_dict()
    for name, module in model.named_modules():
        for key, kept, dim in (("weight", kept_out, 0), ("bias", kept_out, 0), ("weight", kept_in, 1)):
            if module in kept and f"{name}.{key}" in state:
                state[f"{name}.{key}"] = state[f"{name}.{key}"].index_select(dim, kept[module])
    narrow = Quell(config)
    narrow.load_state_dict(state)
    return narrow
