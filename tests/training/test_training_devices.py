# SPDX-License-Identifier: Apache-2.0
"""What a CUDA device would run, checked without one: every tensor on its device, and the same numbers as on the CPU."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from training.data.crops import CropConfig, draw_batch, finish_batch, make_batch
from training.data.pack import load_packs
from training.device import autocast, choose_device, move
from training.loss import quell_loss
from training.models import pyramid
from training.models.quell import Quell, QuellConfig

SMALL = QuellConfig(widths=(16, 16, 16, 16))
CROPS = CropConfig(crop=64, batch=2, seed=3)


CUDA = torch.device("cuda")


def every_index(shape: torch.Size) -> torch.Tensor:
    """What nonzero() gives where nothing is zero."""
    return torch.cartesian_prod(*(torch.arange(n) for n in shape))


@pytest.fixture
def reference_kernels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The plain PyTorch form of the kernels, which other devices run."""
    monkeypatch.setattr(pyramid, "guided_kernel", pyramid.guided_kernel_reference)
    monkeypatch.setattr(pyramid, "partition", pyramid.partition_reference)
    yield


def loss_and_gradient(model: Quell, frames: list, index: int) -> tuple[torch.Tensor, list[torch.Tensor]]:
    batch = make_batch(frames, index, CROPS)
    model.zero_grad()
    loss = quell_loss(model(batch.features, batch.layers), batch.layers, batch.target)
    loss.backward()
    return loss.detach(), [p.grad.clone() for p in model.parameters() if p.grad is not None]


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_the_reference_trains_as_the_native_kernels_do(
    light: float, data_set: Path, request: pytest.FixtureRequest
) -> None:
    torch.manual_seed(1)
    model = Quell(SMALL)
    frames = load_packs("train", data_set)
    crops = dataclasses.replace(CROPS, light_fraction=light)
    index = 0
    assert draw_batch(frames, index, crops).has_light == bool(light)
    native = loss_and_gradient(model, frames, index)
    request.getfixturevalue("reference_kernels")
    reference = loss_and_gradient(model, frames, index)
    torch.testing.assert_close(native[0], reference[0], rtol=1e-4, atol=1e-6)
    for a, b in zip(native[1], reference[1], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-2, atol=1e-3 * float(b.abs().max() + 1e-6))


@pytest.mark.parametrize("light", [False, True])
def test_one_step_keeps_to_its_device(light: bool, data_set: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fake CUDA tensors refuse to be mixed with CPU ones, as real ones do; nothing is computed."""
    # Frames' scales are read as numbers, which fake tensors do not have; so is which passes are black.
    monkeypatch.setattr("training.data.crops.log_exponent", lambda image: 0)
    raw = draw_batch(load_packs("train", data_set), 0, dataclasses.replace(CROPS, light_fraction=float(light)))
    monkeypatch.setattr(torch.Tensor, "nonzero", lambda self: every_index(self.shape))
    with FakeTensorMode(allow_non_fake_inputs=True) as mode:
        fake = {name: mode.from_tensor(v) for name, v in vars(raw).items() if isinstance(v, torch.Tensor)}
        batch = finish_batch(move(dataclasses.replace(raw, **fake), CUDA))
        model = Quell(SMALL).to(CUDA)
        with autocast(CUDA, True):
            out = model(batch.features, batch.layers)
        loss = quell_loss(out, batch.layers, batch.target)
        loss.backward()
        assert loss.device.type == "cuda" and (out.light is not None) == light
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        assert len(gradients) > 20 and all(g.device.type == "cuda" for g in gradients)


def test_move_leaves_what_is_no_tensor(data_set: Path) -> None:
    raw = draw_batch(load_packs("train", data_set), 0, CROPS)
    moved = move(raw, torch.device("meta"))
    assert moved.inputs.device.type == "meta" and moved.has_light == raw.has_light and moved.dropped == raw.dropped


def test_cuda_is_asked_for_in_vain() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    assert choose_device().type == choose_device("cpu").type == "cpu"
    with pytest.raises(SystemExit, match="--device cpu"):
        choose_device("cuda")
