# SPDX-License-Identifier: Apache-2.0
"""Training losses of the quell family."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from training.features import Layers
from training.models.quell import Denoised
from training.native import RelativeError

MIN_COLOR = 0.005  # light divided by less is all noise, in the target too
NOISE_FLOOR = 0.004  # error of an input that needs nothing done to it; targets are no cleaner
EPSILON = 0.01  # of relMSE (docs: error with two references)
TURN = 2.0  # relative error from which on the loss is linear


def relative_error_reference(image: Tensor, target: Tensor) -> Tensor:
    """Pseudo-Huber of the relative error: squared up to TURN, so that noise in the target cancels; linear beyond, so
    that one firefly does not decide a step. Relative to the estimate, because the target's own noise in the denominator
    would pull the result down, but to no more than twice the target's surroundings: an estimate that is far too bright
    must not excuse itself. Surroundings alone would forgive a bright edge that bleeds. One value a crop."""
    around = F.avg_pool2d(target.clamp_min(0), 3, stride=1, padding=1, count_include_pad=False)
    level = torch.minimum(image.detach(), 2 * around)
    squared = (image - target).square() / (level.square() + EPSILON)
    turn = TURN * TURN
    return (turn * (torch.sqrt(1 + squared / turn) - 1)).flatten(1).mean(1)


def relative_error(image: Tensor, target: Tensor) -> Tensor:
    """`relative_error_reference`, in C where the data is on the CPU."""
    if image.device.type == "cpu":
        return RelativeError.apply(image, target, 1, EPSILON, TURN)
    return relative_error_reference(image, target)


def multiscale(image: Tensor, target: Tensor) -> Tensor:
    """Relative error of pixels and of means over 4x4 and 16x16: the latter hold the residual blotches and the bias."""
    if image.device.type == "cpu":
        return RelativeError.apply(image, target, 3, EPSILON, TURN)
    return multiscale_reference(image, target)


def multiscale_reference(image: Tensor, target: Tensor) -> Tensor:
    total = relative_error_reference(image, target)
    for size in (4, 16):
        total = total + 0.5 * relative_error_reference(F.avg_pool2d(image, size), F.avg_pool2d(target, size))
    return total


def energy(image: Tensor, target: Tensor) -> Tensor:
    """Squared error of means over 64x64 and the whole crop, relative to the crop's mean alone. Robust losses drop what
    is rare and bright; this one has the expectation as its optimum and so keeps the mean. At smaller scales it spreads
    every firefly over its surroundings (docs/decisions/0003-energy.md). One value per crop."""
    level = target.mean((1, 2, 3), keepdim=True).abs().detach() + 0.01
    total = image.new_zeros(image.shape[0])
    for size in (64, image.shape[-1]):
        error = (F.avg_pool2d(image, size) - F.avg_pool2d(target, size)) / level
        total = total + error.square().clamp_max(1).flatten(1).mean(1)
    return total


def tone_l1(image: Tensor, target: Tensor) -> Tensor:
    """L1 after z / (1 + z): what a viewer sees (eq. 9 of DGAN-KPN). One value per crop."""
    return (image / (1 + image.clamp_min(0)) - target / (1 + target.clamp_min(0))).abs().flatten(1).mean(1)


def worth(noisy: Tensor, target: Tensor) -> Tensor:
    """Weight of each crop: the inverse of its input's own error. What counts is the share of the noise that is left,
    in a nearly clean crop as much as in a hopeless one; without it the noisiest crops alone would teach."""
    return 1 / (relative_error(noisy, target) + NOISE_FLOOR)


def combined_loss(made: Tensor, target: Tensor) -> Tensor:
    """Of Combined, by whichever way it was made. One value per crop."""
    return multiscale(made, target) + 0.4 * energy(made, target) + 0.2 * tone_l1(made, target)


def quell_loss(out: Denoised, noisy: Layers, target: Layers) -> Tensor:
    """Combined first, the passes it is the sum of second."""
    weight = worth(noisy.beauty, target.beauty)
    total = noisy.beauty.new_zeros(())
    for made in (out.direct, out.rebuilt):
        if made is not None:
            total = total + (weight * combined_loss(made, target.beauty)).mean()
    if out.light is None:
        return total
    for i in range(4):
        light, wanted, given = out.light[:, i], target.light[:, i], noisy.light[:, i]
        made = light.sum(1) * out.color[:, i] if i < 3 else light.sum(1)
        side = 0.1 * multiscale(made, wanted.sum(1)) + 0.05 * energy(made, wanted.sum(1))
        total = total + (weight * side).mean()
        # Each pass by itself, as its own file shows it: light without the colour.
        color = target.color[:, i : i + 1] if i < 3 else torch.ones_like(wanted[:, :1])
        known = (color > MIN_COLOR).float()[:, 0]
        for part in range(2):
            alone = wanted[:, part] / color[:, 0].clamp_min(MIN_COLOR) * known
            share = worth(given[:, part] * known, alone)
            total = total + 0.04 * (share * relative_error(light[:, part] * known, alone)).mean()
    for made, wanted, given in (
        (out.color.flatten(1, 2), target.color.flatten(1, 2), noisy.color.flatten(1, 2)),
        (out.emission, target.emission, noisy.emission),
    ):
        total = total + 0.04 * (worth(given, wanted) * relative_error(made, wanted)).mean()
    return total
