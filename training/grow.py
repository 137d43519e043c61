# SPDX-License-Identifier: Apache-2.0
"""A wider network that begins where a narrower one stands: what a short training has to start from."""

from __future__ import annotations

import torch
from torch import Tensor

from training.models.quell import Quell, QuellConfig
from training.shrink import shrink

LEAK = 0.05  # of their initial size: weights from new channels to old ones in the body, so that all differ


def grow(model: Quell, config: QuellConfig) -> Quell:
    """A network of `config`'s widths, none below the model's, with the same numbers of convolutions. Old channels come
    first and keep their weights; new ones are initialised as usual, but hardly reach the old, and the heads not at all
    (Net2Net, Chen et al. 2016, is the relative)."""
    old = model.net.config
    if (old.down_convs, old.up_convs) != (config.down_convs, config.up_convs):
        raise ValueError("a network grows in width alone: the numbers of convolutions differ")
    if any(a > b for a, b in zip((*old.widths, old.detail), (*config.widths, config.detail), strict=True)):
        raise ValueError(
            f"a network of widths {old.widths}, {old.detail} does not grow into {config.widths}, {config.detail}"
        )
    wide = Quell(config)
    narrow = model.state_dict()
    wide.load_state_dict({name: widen(name, narrow[name], value) for name, value in wide.state_dict().items()})
    return wide


def widen(name: str, old: Tensor, new: Tensor) -> Tensor:
    """One parameter: the old one in the corner of the new one."""
    if old.shape == new.shape:
        return old.clone()
    out = new.clone()
    if out.ndim > 1 and old.shape[1] < out.shape[1]:
        out[: old.shape[0], old.shape[1] :] *= 0.0 if ".heads." in name else LEAK
    out[tuple(slice(n) for n in old.shape)] = old
    return out


def origin_model(model: Quell, config: QuellConfig, seed: int) -> Quell:
    """What a run of this configuration begins with, given a trained model: itself, grown or shrunk."""
    if model.net.config == config:
        return model
    torch.manual_seed(seed)
    return shrink(model, config) if sum(config.widths) < sum(model.net.config.widths) else grow(model, config)
