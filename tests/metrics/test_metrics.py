# SPDX-License-Identifier: Apache-2.0
"""The error measures of `quell compare` against numpy, written from their definitions."""

from __future__ import annotations

import json

import numpy as np
import pytest

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def tone_map(z: np.ndarray) -> np.ndarray:
    z = np.maximum(z, 0.0)
    return z / (1.0 + z)


def windows_mean(plane: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted mean of each 11x11 window inside the plane."""
    views = np.lib.stride_tricks.sliding_window_view(plane, weights.shape)
    return np.einsum("yxij,ij->yx", views, weights)


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    g = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    w = np.outer(g, g) / g.sum() ** 2
    ma, mb = windows_mean(a, w), windows_mean(b, w)
    va = windows_mean(a * a, w) - ma**2
    vb = windows_mean(b * b, w) - mb**2
    cov = windows_mean(a * b, w) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    return float(np.mean((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))))


def gmsd(a: np.ndarray, b: np.ndarray) -> float:
    """On 0..255 as in the paper, T = 170."""

    def gradient(plane: np.ndarray) -> np.ndarray:
        padded = np.pad(255.0 * plane, ((0, 1), (0, 1)))
        halved = (padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:])[::2, ::2] / 4
        p = np.pad(halved, 1)
        h, w = halved.shape
        dx = sum(p[i : i + h, 2 : 2 + w] - p[i : i + h, 0:w] for i in range(3)) / 3
        dy = sum(p[2 : 2 + h, i : i + w] - p[0:h, i : i + w] for i in range(3)) / 3
        return np.sqrt(dx**2 + dy**2)

    ga, gb = gradient(a), gradient(b)
    return float(np.std((2 * ga * gb + 170) / (ga**2 + gb**2 + 170), ddof=1))


def expected(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    m = (a + b) / 2
    tone = np.mean((tone_map(x) - tone_map(a)) * (tone_map(x) - tone_map(b)))
    planes = [(tone_map(z) @ LUMINANCE).astype(np.float32).astype(np.float64) for z in (x, m)]
    return {
        "mse": float(np.mean((x - a) * (x - b))),
        "rel_mse": float(np.mean((x - a) * (x - b) / (m**2 + 0.01))),
        "psnr": float(-10 * np.log10(tone)),
        "ssim": ssim(*planes),
        "gmsd": gmsd(*planes),
    }


@pytest.mark.parametrize("shape", [(64, 96), (37, 53), (11, 200)])
@pytest.mark.parametrize("num_references", [1, 2])
def test_against_numpy(quell, tmp_path, exr_writer, shape, num_references):
    rng = np.random.default_rng(shape[0] + num_references)
    truth = rng.gamma(1.0, 1.0, (*shape, 3))
    truth[:, shape[1] // 2 :] *= 0.05
    images = [(truth + sigma * rng.normal(size=truth.shape)).astype(np.float32) for sigma in (0.3, 0.05, 0.05)]
    images = images[: 1 + num_references]
    paths = [exr_writer(tmp_path / f"{i}.exr", {"ViewLayer.Combined": image}) for i, image in enumerate(images)]
    found = json.loads(quell.ok("compare", "--json", *paths).stdout)["layers"][0]
    x, a, b = (images[i].astype(np.float64) for i in (0, 1, num_references))
    for name, value in expected(x, a, b).items():
        assert found[name] == pytest.approx(value, rel=2e-6, abs=1e-9), name
    assert found["non_finite"] == 0


def test_independent_references_cancel_their_noise(quell, tmp_path, exr_writer):
    """An image without error scores about 0 against two noisy references, though not against one."""
    rng = np.random.default_rng(5)
    truth = np.full((128, 128, 3), 0.5, np.float32)
    noisy = [(truth + 0.2 * rng.normal(size=truth.shape)).astype(np.float32) for _ in range(2)]
    paths = [exr_writer(tmp_path / f"{i}.exr", {"ViewLayer.Combined": p}) for i, p in enumerate([truth, *noisy])]
    one = json.loads(quell.ok("compare", "--json", *paths[:2]).stdout)["layers"][0]["mse"]
    two = json.loads(quell.ok("compare", "--json", *paths).stdout)["layers"][0]["mse"]
    assert one == pytest.approx(0.04, rel=0.05) and abs(two) < 0.001


def test_bad_values_are_counted(quell, tmp_path, exr_writer):
    image = np.ones((8, 8, 3), np.float32)
    image[2, 3] = [np.nan, np.inf, 1.0]
    paths = [
        exr_writer(tmp_path / "a.exr", {"ViewLayer.Combined": image}),
        exr_writer(tmp_path / "b.exr", {"ViewLayer.Combined": np.ones_like(image)}),
    ]
    found = json.loads(quell.ok("compare", "--json", *paths).stdout)["layers"][0]
    assert found["non_finite"] == 2
    assert found["mse"] == pytest.approx(2 / 192)
