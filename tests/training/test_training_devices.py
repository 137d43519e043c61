# SPDX-License-Identifier: Apache-2.0
"""What a CUDA device would run, checked without one: the same numbers as by the native kernels, and every tensor on its
device. PyTorch's meta device stands for the other one: it computes nothing but refuses tensors of the CPU."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from training.data.crops import CropConfig, draw_batch, finish_batch, make_batch
from training.data.pack import load_packs
from training.device import choose_device, move
from training.loss import quell_loss
from training.models import pyramid
from training.models.quell import Quell, QuellConfig

SMALL = QuellConfig(widths=(16, 16, 16, 16))
CROPS = CropConfig(crop=64, batch=2, seed=3)


OTHER = torch.device("meta")


def every_index(shape: torch.Size) -> torch.Tensor:
    """What nonzero() gives where nothing is zero."""
    return torch.cartesian_prod(*(torch.arange(n) for n in shape))


@pytest.fixture
def reference_kernels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The plain PyTorch form of the kernels, which other devices run."""
    monkeypatch.setattr(pyramid, "guided_kernel", pyramid.guided_kernel_reference)
    monkeypatch.setattr(pyramid, "partition", pyramid.partition_reference)
    yield


def loss_and_gradient(model: Quell, frames: list, crops: CropConfig) -> tuple[torch.Tensor, torch.Tensor]:
    batch = make_batch(frames, 0, crops)
    model.zero_grad()
    loss = quell_loss(model(batch.features, batch.layers), batch.layers, batch.target, batch.level)
    loss.backward()
    return loss.detach(), torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_the_reference_trains_as_the_native_kernels_do(
    light: float, data_set: Path, request: pytest.FixtureRequest
) -> None:
    torch.manual_seed(1)
    model, frames = Quell(SMALL), load_packs("train", data_set)
    crops = dataclasses.replace(CROPS, light_fraction=light)
    native = loss_and_gradient(model, frames, crops)
    request.getfixturevalue("reference_kernels")
    reference = loss_and_gradient(model, frames, crops)
    torch.testing.assert_close(native[0], reference[0], rtol=1e-4, atol=1e-6)
    error = (native[1] - reference[1]).norm() / reference[1].norm()
    assert error < 1e-3, error


@pytest.mark.parametrize("light", [False, True])
def test_one_step_keeps_to_its_device(light: bool, data_set: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = draw_batch(load_packs("train", data_set), 0, dataclasses.replace(CROPS, light_fraction=float(light)))
    # What is read back as numbers: the scales of a frame, and which passes are black.
    monkeypatch.setattr("training.data.crops.log_exponent", lambda image: 0)
    monkeypatch.setattr(torch.Tensor, "cpu", lambda self: self)
    monkeypatch.setattr(torch.Tensor, "nonzero", lambda self: every_index(self.shape))
    batch = finish_batch(move(raw, OTHER))
    model = Quell(SMALL).to(OTHER)
    out = model(batch.features, batch.layers)
    loss = quell_loss(out, batch.layers, batch.target, batch.level)
    loss.backward()
    assert loss.device == OTHER and (out.light is not None) == light
    gradients = [p.grad for p in model.parameters() if p.grad is not None]
    assert len(gradients) > 20 and all(g.device == OTHER for g in gradients)


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
