# SPDX-License-Identifier: Apache-2.0
"""Guided kernels: the C form against the PyTorch form, and what softmax kernels promise."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from training.features import NUM_FEATURES, NUM_FLAGS, Features, Layers
from training.models.pyramid import (
    FILTER_RADIUS,
    FILTER_TAPS,
    UP_RADIUS,
    UP_TAPS,
    guided_kernel,
    guided_kernel_reference,
    partition,
    partition_reference,
    take_planes,
    take_planes_reference,
)
from training.models.quell import Denoised, Quell, QuellConfig, filter_layers

SMALL = QuellConfig(widths=(16, 16, 16, 16), down_convs=(1, 1, 1, 1), up_convs=(1, 1, 1))
DIMENSIONS = 4
#: Kernels of two groups for three items over two images.
IMAGE, GROUP = torch.tensor([0, 1, 1]), torch.tensor([0, 0, 1])


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def arguments(radius: int, shift: int, height: int, width: int, centre: bool) -> list[Tensor | None]:
    """source, embedding, other, scale, centre, table of guided_kernel."""
    low = (height >> shift, width >> shift)
    taps = (2 * radius + 1) ** 2
    return [
        random(3, 3, *low, seed=1),
        random(2, DIMENSIONS, height, width, seed=2),
        random(2, DIMENSIONS, *low, seed=3),
        random(3, DIMENSIONS, height, width, seed=4),
        random(3, 1, height, width, seed=5) if centre else None,
        random(2, 4 if shift else 1, taps, seed=6),
    ]


@pytest.mark.parametrize(("radius", "shift", "centre"), [(FILTER_RADIUS, 0, True), (UP_RADIUS, 1, False)])
@pytest.mark.parametrize(("height", "width"), [(8, 12), (2, 2), (16, 6)])
def test_native_matches_reference(radius: int, shift: int, centre: bool, height: int, width: int) -> None:
    weight = random(3, 3, height, width, seed=7)
    results = []
    for function in (guided_kernel, guided_kernel_reference):
        given = arguments(radius, shift, height, width, centre)
        given = [t if t is None else t.requires_grad_() for t in given]
        out = function(*given, IMAGE, GROUP, radius, shift)
        (out * weight).sum().backward()
        results.append([out.detach(), *(t.grad for t in given if t is not None)])
    for native, reference in zip(*results, strict=True):
        torch.testing.assert_close(native, reference, rtol=1e-4, atol=1e-5)


def test_native_partition_matches_reference() -> None:
    results = []
    for function in (partition, partition_reference):
        values = random(2, 3, 8, 12).requires_grad_()
        logits = random(2, 1, 8, 12, seed=1).requires_grad_()
        out = function(values, logits)
        (out * random(2, 3, 4, 6, seed=2)).sum().backward()
        results.append((out.detach(), values.grad, logits.grad))
    for native, reference in zip(*results, strict=True):
        torch.testing.assert_close(native, reference, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("fine", [1, 2])
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_native_planes_match_reference(fine: int, dtype: torch.dtype) -> None:
    choices = [(torch.tensor([0, 6]), 2, 0.5), (torch.tensor([2]), 1, None), (torch.tensor([3, 8]), 2, None)]
    results = []
    for function in (take_planes, take_planes_reference):
        x = random(2, 5 * fine * fine, 6, 4).to(dtype).requires_grad_()
        out = function(x, fine, choices)
        sum((o * random(*o.shape, seed=i)).sum() for i, o in enumerate(out[:2])).backward()  # the last one is unused
        results.append((*(o.detach() for o in out), x.grad))
    for native, reference in zip(*results, strict=True):
        assert native.dtype == reference.dtype and torch.equal(native, reference)


@pytest.mark.parametrize("images", [1, 2])
def test_gradients_do_not_depend_on_threads(images: int) -> None:
    results = []
    for threads in (2, 1):  # 1 is what the other tests run with
        torch.set_num_threads(threads)
        given = [t.requires_grad_() for t in arguments(FILTER_RADIUS, 0, 16, 12, True)]
        guided_kernel(*given, IMAGE % images, GROUP, FILTER_RADIUS, 0).square().sum().backward()
        results.append([t.grad for t in given])
    for two, one in zip(*results, strict=True):
        assert torch.equal(two, one)


def one_item(height: int, width: int, radius: int, shift: int, table: Tensor) -> list[Tensor | None]:
    """Everything that is looked at is equal: the table alone decides."""
    low = (height >> shift, width >> shift)
    zeros = torch.zeros(1, DIMENSIONS, height, width)
    return [random(1, 3, *low), zeros, torch.zeros(1, DIMENSIONS, *low), zeros, None, table]


ONE = torch.zeros(1, dtype=torch.long)


def test_kernels_that_look_at_the_centre_copy() -> None:
    table = torch.full((1, 1, FILTER_TAPS), -1e4)
    table[..., FILTER_TAPS // 2] = 0
    given = one_item(8, 8, FILTER_RADIUS, 0, table)
    torch.testing.assert_close(guided_kernel(*given, ONE, ONE, FILTER_RADIUS, 0), given[0], rtol=1e-6, atol=0)


def test_outside_the_image_everything_is_zero() -> None:
    given = one_item(8, 8, FILTER_RADIUS, 0, torch.zeros(1, 1, FILTER_TAPS))
    out = guided_kernel(torch.ones(1, 1, 8, 8), *given[1:], ONE, ONE, FILTER_RADIUS, 0)
    assert out[0, 0, 4, 4].item() == pytest.approx(1)
    assert out[0, 0, 0, 0].item() == pytest.approx(9 / 25)  # a corner sees 3x3 of its 5x5


def test_upsampling_takes_the_parents_neighbours() -> None:
    table = torch.full((1, 4, UP_TAPS), -1e4)
    table[..., UP_TAPS // 2] = 0
    given = one_item(4, 4, UP_RADIUS, 1, table)
    expected = given[0].repeat_interleave(2, 2).repeat_interleave(2, 3)
    torch.testing.assert_close(guided_kernel(*given, ONE, ONE, UP_RADIUS, 1), expected, rtol=1e-6, atol=0)


def test_embeddings_far_apart_do_not_mix() -> None:
    """Two halves with embeddings of their own: a sharp kernel never looks across."""
    given = one_item(8, 8, FILTER_RADIUS, 0, torch.zeros(1, 1, FILTER_TAPS))
    embedding = torch.zeros(1, DIMENSIONS, 8, 8)
    embedding[..., 4:] = 10
    source = torch.zeros(1, 1, 8, 8)
    source[..., 4:] = 1
    out = guided_kernel(source, embedding, embedding, *given[3:], ONE, ONE, FILTER_RADIUS, 0)
    assert out[..., :4].max() < 1e-12 and out[0, 0, 4, 4].item() == pytest.approx(1)


def test_partition_is_a_weighted_mean_of_cells() -> None:
    values = torch.arange(16.0).view(1, 1, 4, 4)
    even = partition(values, torch.zeros(1, 1, 4, 4))
    torch.testing.assert_close(even, torch.nn.functional.avg_pool2d(values, 2))
    logits = torch.zeros(1, 1, 4, 4)
    logits[0, 0, 0, 1] = 1e4
    assert partition(values, logits)[0, 0, 0, 0].item() == 1


# ---- What the whole pyramid promises --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model() -> Quell:
    """Wild heads and tables."""
    torch.manual_seed(1)
    model = Quell(SMALL)
    for parameter in (*(head.weight for head in model.net.heads), *model.net.filter_table, *model.net.up_table):
        torch.nn.init.normal_(parameter, std=0.3)
    return model


def filtered(model: Quell, layers: Layers) -> Denoised:
    """Kernels that a noisy frame led to, on some layers."""
    features = Features(random(1, NUM_FEATURES, 32, 32).abs(), torch.ones(1, NUM_FLAGS))
    with torch.no_grad():
        return filter_layers(model.net, features, layers)


def constant_layers(value: float, size: int = 32) -> Layers:
    image = torch.full((1, 3, size, size), value)
    light = torch.full((1, 4, 2, 3, size, size), value)
    return Layers(image, light, torch.ones(1, 3, 3, size, size), image.clone())


@pytest.mark.parametrize("value", [1.0, 0.25, 4096.0])
def test_constants_stay_exactly(model: Quell, value: float) -> None:
    """Numerator and denominator are the same sums of products, times a power of two: the division is exact."""
    layers = constant_layers(value)
    out = filtered(model, layers)
    assert torch.equal(out.direct, layers.beauty)
    assert torch.equal(out.light, layers.light)
    assert torch.equal(out.emission, layers.emission)


def test_any_constant_stays_to_rounding(model: Quell) -> None:
    layers = constant_layers(0.3)
    out = filtered(model, layers)
    torch.testing.assert_close(out.direct, layers.beauty, rtol=1e-5, atol=0)
    torch.testing.assert_close(out.light, layers.light, rtol=1e-5, atol=0)


def test_results_stay_within_the_inputs_range(model: Quell) -> None:
    beauty = random(1, 3, 32, 32, seed=4).exp()
    out = filtered(model, Layers(beauty)).direct
    assert out.min() >= beauty.min() * (1 - 1e-5) and out.max() <= beauty.max() * (1 + 1e-5)
    assert torch.equal(filtered(model, Layers(beauty * 1024)).direct, out * 1024)


def test_black_passes_stay_black(model: Quell) -> None:
    layers = constant_layers(1.0)
    layers.light[:, 2] = 0
    assert filtered(model, layers).light[:, 2].abs().max() == 0
