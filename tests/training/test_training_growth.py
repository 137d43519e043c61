# SPDX-License-Identifier: Apache-2.0
"""Wider networks from narrower ones, and steps along orthogonalised momentum."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from training.grow import grow, origin_model
from training.models.quell import GROUPS, Quell, QuellConfig, group_planes
from training.muon import Muon, make_optimisers, orthogonalise, split_parameters
from training.shrink import shrink

NARROW = QuellConfig(widths=(16, 16, 16, 16), down_convs=(1, 1, 1, 1), up_convs=(1, 1, 1))
WIDE = QuellConfig(widths=(32, 48, 16, 32), down_convs=(1, 1, 1, 1), up_convs=(1, 1, 1), detail=32)


def test_a_grown_network_says_about_what_the_narrow_one_says() -> None:
    torch.manual_seed(1)
    narrow = Quell(NARROW)
    wide = grow(narrow, WIDE)
    features, flags = torch.rand(1, 32, 32, 32), torch.rand(1, 6)
    (heads, detail), (wide_heads, wide_detail) = narrow.net(features, flags), wide.net(features, flags)
    assert (detail - wide_detail).abs().mean() < 0.3 * detail.abs().mean()
    for level, (a, b) in enumerate(zip(heads, wide_heads, strict=True)):
        of_groups = slice(len(GROUPS) * group_planes(level) * (4 if level == 0 else 1))
        a, b = a[:, of_groups], b[:, of_groups]
        assert (a - b).abs().mean() < 0.3 * (a - a.mean()).abs().mean()
    assert sum(p.numel() for p in wide.parameters()) > 2 * sum(p.numel() for p in narrow.parameters())


def test_what_cannot_grow_is_an_error() -> None:
    with pytest.raises(ValueError, match="does not grow"):
        grow(Quell(WIDE), NARROW)
    with pytest.raises(ValueError, match="width alone"):
        grow(Quell(NARROW), QuellConfig(WIDE.widths, (1, 1, 1, 2), (1, 1, 1)))
    same = Quell(NARROW)
    assert origin_model(same, NARROW, 1) is same


def test_a_shrunk_network_keeps_the_channels_that_matter() -> None:
    torch.manual_seed(1)
    narrow = Quell(NARROW)
    grown = grow(narrow, replace(WIDE, detail=NARROW.detail))
    with torch.no_grad():  # what was added matters least
        for name, parameter in grown.named_parameters():
            old = dict(narrow.named_parameters())[name]
            if parameter.shape != old.shape:
                kept = parameter[tuple(slice(n) for n in old.shape)].clone()
                parameter *= 0.01
                parameter[tuple(slice(n) for n in old.shape)] = kept
    for a, b in zip(narrow.state_dict().values(), shrink(grown, NARROW).state_dict().values(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(ValueError, match="does not shrink"):
        shrink(narrow, WIDE)


@pytest.mark.parametrize("shape", [(16, 64), (64, 16), (32, 32)])
def test_orthogonalised_momentum_has_singular_values_near_one(shape: tuple[int, int]) -> None:
    torch.manual_seed(2)
    values = torch.linalg.svdvals(orthogonalise(torch.randn(shape)))
    assert values.min() > 0.5 and values.max() < 1.3


def test_a_step_of_muon_is_as_large_as_one_of_adamw() -> None:
    torch.manual_seed(3)
    weight = torch.nn.Parameter(torch.zeros(32, 16, 3, 3))
    weight.grad = torch.randn_like(weight) * 1e-3
    Muon([weight], lr=1e-2, weight_decay=0).step()
    assert 0.1e-2 < weight.detach().square().mean().sqrt().item() < 0.3e-2


def test_every_parameter_has_one_optimiser() -> None:
    model = Quell(NARROW)
    matrices, rest = split_parameters(model)
    assert {id(p) for p in matrices} | {id(p) for p in rest} == {id(p) for p in model.parameters()}
    assert len(matrices) + len(rest) == len(list(model.parameters())) and all(p.dim() == 4 for p in matrices)
    assert len(make_optimisers(model, True, 1e-3)) == 2 and len(make_optimisers(model, False, 1e-3)) == 1
