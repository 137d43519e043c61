# SPDX-License-Identifier: Apache-2.0
"""Error measures of one image against two independent references."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from training import libquell

#: Two references can leave a difference of either sign; less than this is as good as none.
_LEAST = 1e-8


@dataclass(frozen=True)
class Scores:
    """relMSE, PSNR (dB) and SSIM after z / (1 + z), GMSD, and FLIP (NaN where its package is missing)."""

    rel_mse: float
    psnr: float
    ssim: float
    gmsd: float
    flip: float


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Mean of (x - a)(x - b) / (m^2 + 0.01), m = (a + b) / 2: the references' own noise cancels."""
    x, a, b = (np.asarray(z, np.float64) for z in (x, a, b))
    m = 0.5 * (a + b)
    return float(((x - a) * (x - b) / (m * m + 0.01)).mean())


def display(pixels: np.ndarray) -> np.ndarray:
    """Map scene light [h,w,3] to 0..1 for the eye: z / (1 + z), then sRGB's curve."""
    z = np.maximum(np.nan_to_num(pixels.astype(np.float32)), 0.0)
    z = z / (1.0 + z)
    return np.where(z <= 0.0031308, 12.92 * z, 1.055 * np.maximum(z, 1e-8) ** (1 / 2.4) - 0.055).astype(np.float32)


def flip(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Mean FLIP of what would be seen, against the mean of the references; NaN without the flip-evaluator package."""
    try:
        import flip_evaluator
    except ImportError:
        return math.nan
    reference, test = display(0.5 * (a + b)), display(x)
    return float(flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)[1])


def score(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> Scores:
    """Score the first three channels of [h,w,c] images."""
    x, a, b = (np.ascontiguousarray(z[..., :3], np.float32) for z in (x, a, b))
    found = libquell.compare(x, a, b)
    return Scores(found.rel_mse, found.psnr, found.ssim, found.gmsd, flip(x, a, b))


def geometric_mean(values: Iterable[float]) -> float:
    """Geometric mean of errors; those at or below zero count as the smallest that can be told."""
    return float(np.exp(np.mean([math.log(max(v, _LEAST)) for v in values])))
