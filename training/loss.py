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
TURN = 2.0  # relative error from which on the loss of a pass is linear
TURN_COMBINED = 64.0  # of Combined: a bright pixel that stays in the dark is what shows most
COMBINED_FLOOR = 0.002  # of its error; targets are hardly cleaner


def relative_error_reference(image: Tensor, target: Tensor, level: Tensor, turn: float = TURN) -> Tensor:
    """Pseudo-Huber of the error relative to the level: squared up to turn, so that noise in the target cancels; linear
    beyond, so that one firefly does not decide a step. The level is what the frame converges to, as nearly as it is
    known: the target's own noise in the denominator would pull the result down, the estimate in it would forgive a
    bright edge that bleeds into the dark. One value a crop."""
    squared = (image - target).square() / (level.square() + EPSILON)
    return (squared / (torch.sqrt(1 + squared / turn**2) + 1)).flatten(1).mean(1)


def relative_error(image: Tensor, target: Tensor, level: Tensor) -> Tensor:
    """`relative_error_reference`, in C where the data is on the CPU."""
    if image.device.type == "cpu":
        return RelativeError.apply(image, target, level, 1, EPSILON, TURN)
    return relative_error_reference(image, target, level)


def multiscale(image: Tensor, target: Tensor, level: Tensor, turn: float = TURN) -> Tensor:
    """Relative error of pixels and of means over 4x4 and 16x16: the latter hold the residual blotches and the bias."""
    if image.device.type == "cpu":
        return RelativeError.apply(image, target, level, 3, EPSILON, turn)
    return multiscale_reference(image, target, level, turn)


def multiscale_reference(image: Tensor, target: Tensor, level: Tensor, turn: float = TURN) -> Tensor:
    total = relative_error_reference(image, target, level, turn)
    for size in (4, 16):
        means = (F.avg_pool2d(x, size) for x in (image, target, level))
        total = total + 0.5 * relative_error_reference(*means, turn)
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


def worth(noisy: Tensor, target: Tensor, level: Tensor) -> Tensor:
    """Weight of each crop: the inverse of its input's own error. What counts is the share of the noise that is left,
    in a nearly clean crop as much as in a hopeless one; without it the noisiest crops alone would teach."""
    return 1 / (relative_error(noisy, target, level) + NOISE_FLOOR)


def combined_loss(made: Tensor, target: Tensor, level: Tensor, weight: Tensor, energy_weight: float) -> Tensor:
    """Of Combined, by whichever way it was made. One value per crop: the logarithm of its error, because what counts is
    the geometric mean over frames, and means and tones by `worth`."""
    error = 0.3 * torch.log1p(multiscale(made, target, level, TURN_COMBINED) / COMBINED_FLOOR)
    return error + weight * (energy_weight * energy(made, target) + 0.2 * tone_l1(made, target))


def quell_loss(out: Denoised, noisy: Layers, target: Layers, level: Layers, energy_weight: float = 0.4) -> Tensor:
    """Combined first, the passes it is the sum of second. energy_weight: of means against pixels."""
    weight = worth(noisy.beauty, target.beauty, level.beauty)
    total = noisy.beauty.new_zeros(())
    for made in (out.direct, out.rebuilt):
        if made is not None:
            total = total + combined_loss(made, target.beauty, level.beauty, weight, energy_weight).mean()
    if out.light is None:
        return total
    for i in range(4):
        light, given = out.light[:, i], noisy.light[:, i]
        made = light.sum(1) * out.color[:, i] if i < 3 else light.sum(1)
        wanted, around = target.light[:, i].sum(1), level.light[:, i].sum(1)
        side = 0.1 * multiscale(made, wanted, around) + 0.125 * energy_weight * energy(made, wanted)
        total = total + (weight * side).mean()
        # Each pass by itself, as its own file shows it: light without the colour.
        for part in range(2):
            wanted, known = without_color(target, i, part)
            around, _ = without_color(level, i, part)
            share = worth(given[:, part] * known, wanted * known, around)
            total = total + 0.04 * (share * relative_error(light[:, part] * known, wanted * known, around)).mean()
    for made, wanted, around, given in (
        (out.color.flatten(1, 2), target.color.flatten(1, 2), level.color.flatten(1, 2), noisy.color.flatten(1, 2)),
        (out.emission, target.emission, level.emission, noisy.emission),
    ):
        share = worth(given, wanted, around)
        total = total + 0.04 * (share * relative_error(made, wanted, around)).mean()
    return total + 0.05 * energy_weight * (weight * energy(out.emission, target.emission)).mean()


def without_color(target: Layers, light: int, part: int) -> tuple[Tensor, Tensor]:
    """A light pass [n,3,h,w] of a target, and where its colour lets it be known."""
    product = target.light[:, light, part]
    color = target.color[:, light] if light < 3 else torch.ones_like(product)
    return product / color.clamp_min(MIN_COLOR), (color > MIN_COLOR).float()
