# SPDX-License-Identifier: Apache-2.0
"""Loss values against numbers worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from training import loss
from training.features import Layers
from training.models.quell import Denoised


def flat(value: float, size: int = 64) -> Tensor:
    return torch.full((1, 3, size, size), float(value))


#: Image 1, target 3, level 2: (3 - 1)^2 / (2^2 + 0.01), softened from 2 on.
ONE_TO_THREE = 4 * (math.sqrt(1 + 4 / 4.01 / 4) - 1)


def test_relative_error_of_flat_images() -> None:
    assert loss.relative_error(flat(1), flat(3), flat(2)).item() == pytest.approx(ONE_TO_THREE, rel=1e-6)
    assert loss.relative_error(flat(2), flat(2), flat(1)).item() == 0


def test_relative_error_is_squared_while_small_and_linear_when_large() -> None:
    small = loss.relative_error(flat(1.01), flat(1), flat(1)).item()
    assert small == pytest.approx(0.5 * 0.01**2 / (1 + 0.01), rel=0.01)
    # Where it converges to black the relative error of x is x / 0.1; twice that from the turn on.
    assert loss.relative_error(flat(1e4), flat(0), flat(0)).item() == pytest.approx(2 * 1e5, rel=1e-3)


def test_relative_error_has_a_gradient_of_the_image_alone() -> None:
    image, target, level = (flat(value).requires_grad_() for value in (2, 3, 1.5))
    loss.relative_error(image, target, level).sum().backward()
    # d/dx 4 (sqrt(1 + s / 4) - 1) = (x - t) / D / sqrt(1 + s / 4), spread over the values of the mean.
    d = 1.5**2 + 0.01
    expected = (2 - 3) / d / math.sqrt(1 + 1 / d / 4) / image.numel()
    assert image.grad is not None and target.grad is None and level.grad is None
    torch.testing.assert_close(image.grad, torch.full_like(image, expected))


def test_multiscale_of_flat_images_counts_every_scale() -> None:
    # One, plus a half for each of the means over 4x4 and 16x16.
    single = loss.relative_error(flat(1), flat(2), flat(2)).item()
    assert loss.multiscale(flat(1), flat(2), flat(2)).item() == pytest.approx(2 * single, rel=1e-5)


def test_multiscale_forgives_at_coarse_scales_what_cancels() -> None:
    checker = ((torch.arange(64)[:, None] + torch.arange(64)) % 2).float().expand(1, 3, 64, 64)
    # Means over 4x4 of a checker are its mean: the coarse terms vanish and the fine one stays.
    fine = loss.relative_error(checker, flat(0.5), flat(0.5)).item()
    assert loss.multiscale(checker, flat(0.5), flat(0.5)).item() == pytest.approx(fine, rel=1e-5)


def test_energy_is_the_squared_relative_error_of_means() -> None:
    # Means 1.1 and 1: (0.1 / 1.01)^2, once for 64x64 and once for the crop, here the same; in sums of 4096 floats.
    assert loss.energy(flat(1.1), flat(1)).item() == pytest.approx(
        2 * (0.1 / 1.01) ** 2, rel=2e-3
    )  # sums of 4096 floats


def test_energy_ignores_where_light_is() -> None:
    image = flat(0.0)
    image[..., 3, 5] = 4096.0  # all of it in one pixel: the mean over 64x64 is 1
    assert loss.energy(image, flat(1)).item() == pytest.approx(0, abs=1e-9)


def test_energy_is_clamped() -> None:
    assert loss.energy(flat(100), flat(1)).item() == pytest.approx(2)


def test_tone_l1() -> None:
    # 3 / 4 - 1 / 2
    assert loss.tone_l1(flat(3), flat(1)).item() == pytest.approx(0.25)


def test_worth_is_the_inverse_of_the_inputs_error() -> None:
    assert loss.worth(flat(1), flat(1), flat(1)).item() == pytest.approx(1 / loss.NOISE_FLOOR)
    expected = 1 / (ONE_TO_THREE + loss.NOISE_FLOOR)
    assert loss.worth(flat(1), flat(3), flat(2)).item() == pytest.approx(expected, rel=1e-5)


def test_crops_are_weighed_one_by_one() -> None:
    image, target, level = (torch.cat([flat(a), flat(2)]) for a in (1, 3, 2))
    assert loss.relative_error(image, target, level).tolist() == pytest.approx([ONE_TO_THREE, 0.0])


def denoised(value: float) -> tuple[Denoised, Layers]:
    """A result and a target whose passes sum up: four groups of two passes of equal light, colour 1, no emission."""
    n, size = 1, 64
    light = torch.full((n, 4, 2, 3, size, size), value / 8)
    color = torch.ones(n, 3, 3, size, size)
    emission = torch.zeros(n, 3, size, size)
    combined = flat(value)
    return Denoised(combined, combined, light, color, emission), Layers(combined, light, color, emission)


def test_a_perfect_result_costs_nothing() -> None:
    out, target = denoised(1.0)
    _, noisy = denoised(1.7)
    assert loss.quell_loss(out, noisy, target, target).item() == pytest.approx(0, abs=1e-9)
    alone, beauty = Denoised(out.direct), Layers(target.beauty)
    assert loss.quell_loss(alone, Layers(noisy.beauty), beauty, beauty).item() == pytest.approx(0, abs=1e-9)


def test_the_loss_rises_with_the_error_of_every_part() -> None:
    _, target = denoised(1.0)
    _, noisy = denoised(1.7)
    losses = [loss.quell_loss(denoised(value)[0], noisy, target, target).item() for value in (1.0, 1.05, 1.2, 1.5)]
    assert losses == sorted(losses) and losses[-1] > losses[0]
    out, _ = denoised(1.0)
    for name in ("light", "color", "emission", "rebuilt", "direct"):
        worse = {**vars(out), name: vars(out)[name] + 0.1}
        assert loss.quell_loss(Denoised(**worse), noisy, target, target).item() > 0, name


@pytest.mark.parametrize(("height", "width"), [(64, 64), (37, 21), (16, 48)])
@pytest.mark.parametrize("name", ["relative_error", "multiscale"])
def test_the_loss_in_c_is_that_of_pytorch(name: str, height: int, width: int) -> None:
    generator = torch.Generator().manual_seed(1)
    image = (2 * torch.rand(3, 3, height, width, generator=generator) - 0.1).requires_grad_()
    target = 3 * torch.rand(3, 3, height, width, generator=generator) - 0.1
    level = 2 * torch.rand(3, 3, height, width, generator=generator)
    share = torch.tensor([1.0, 2.0, 0.5])
    ours, theirs = (getattr(loss, one)(image, target, level) for one in (name, f"{name}_reference"))
    torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)
    gradients = [torch.autograd.grad((value * share).sum(), image)[0] for value in (ours, theirs)]
    torch.testing.assert_close(*gradients, rtol=1e-5, atol=1e-8)
