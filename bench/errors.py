# SPDX-License-Identifier: Apache-2.0
"""Errors of an image against two independent references, images being [height][width][3], scene-linear.

In relMSE and PSNR the references' own noise cancels, because each difference is multiplied with the one to the other
reference. SSIM and FLIP know no such thing: they are taken against the references' mean.
"""

from __future__ import annotations

import math

import numpy as np

EPSILON = 0.01


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    x, a, b = (z.astype(np.float64) for z in (x, a, b))
    return float(np.mean((x - a) * (x - b) / (((a + b) / 2) ** 2 + EPSILON)))


def tone(z: np.ndarray) -> np.ndarray:
    z = np.maximum(z.astype(np.float64), 0)
    return z / (1 + z)


def psnr(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """dB after z / (1 + z)."""
    x, a, b = tone(x), tone(a), tone(b)
    return -10 * math.log10(max(float(np.mean((x - a) * (x - b))), 1e-10))


def blur(z: np.ndarray) -> np.ndarray:
    """11x11 Gaussian, sigma 1.5, of [height][width]; the valid part."""
    kernel = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        z = np.apply_along_axis(np.convolve, axis, z, kernel, "valid")
    return z


def ssim(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """On luminance after z / (1 + z), as in Wang et al. 2004."""
    weights = np.array([0.2126, 0.7152, 0.0722])
    x, y = tone(x) @ weights, tone((a.astype(np.float64) + b) / 2) @ weights
    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    return float(np.mean((2 * mx * my + c1) * (2 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2))))


def flip(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """HDR-FLIP (Andersson et al. 2021), mean over the image, with NVIDIA's defaults."""
    import flip_evaluator

    reference, test = (np.ascontiguousarray(np.maximum(z, 0), np.float32) for z in ((a + b) / 2, x))
    return float(flip_evaluator.evaluate(reference, test, "HDR", applyMagma=False)[1])


MEASURES = {"rel_mse": rel_mse, "psnr": psnr, "ssim": ssim, "flip": flip}


def geometric_mean(values: list[float]) -> float:
    # With two references an error may come out at or below 0: smaller than they can tell.
    return math.exp(sum(math.log(max(v, 1e-9)) for v in values) / len(values))
