# SPDX-License-Identifier: Apache-2.0
"""A data set without a renderer: analytic hills lit from one side, with noise as a path tracer's, passes that sum up.

Everything about a frame is known exactly, and a turned frame can be had by turning the hills instead of the picture.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from training.data.store import CHANNELS, pass_slice, write_render

#: Renders of a frame as the training data has them, name -> spp.
RENDERS = {"1_0": 1, "1_1": 1, "2_0": 2, "4_0": 4, "8_0": 8, "16_0": 16}

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights over the picture plane, x to the right, y up, both in -1..1. No symmetry of its own."""
    return 0.3 * np.sin(3 * x + 0.5) * np.cos(2 * y - 0.3) + 0.2 * x - 0.1 * y * y


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixel centres: x grows with columns, y falls with rows."""
    centres = (np.arange(size) + 0.5) / size * 2 - 1
    return np.meshgrid(centres, -centres)


def normals(surface: Surface, size: int) -> np.ndarray:
    """Camera-space normals [3,h,w] of a surface seen from above, by central differences."""
    x, y = grid(size)
    step = 1e-4
    slope_x = (surface(x + step, y) - surface(x - step, y)) / (2 * step)
    slope_y = (surface(x, y + step) - surface(x, y - step)) / (2 * step)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)])
    return normal / np.linalg.norm(normal, axis=0)


def clean_render(size: int, seed: int) -> np.ndarray:
    """A converged render [C,h,w] of hills with two lights, a mirror, an emitter and a textured ground."""
    rng = np.random.default_rng(seed)
    x, y = grid(size)
    normal = normals(hills, size)
    sun = np.array([0.5, 0.4, 0.77]) + 0.2 * rng.standard_normal(3)
    out = np.zeros((len(CHANNELS), size, size), np.float64)

    def put(name: str, value: np.ndarray) -> None:
        out[pass_slice(name)] = value

    texture = 0.5 + 0.4 * np.sign(np.sin(9 * x) * np.sin(7 * y))
    rgb = rng.uniform(0.3, 1.0, (3, 1, 1))
    put("DiffCol", texture * rgb)
    put("DiffDir", np.maximum(0, np.tensordot(sun, normal, 1)) * np.array([1.5, 1.3, 1.0]).reshape(3, 1, 1))
    put("DiffInd", 0.2 + 0.1 * normal[2:])
    put("GlossCol", np.where(x > 0.3, 0.6, 0.0) * np.ones((3, 1, 1)))
    put("GlossInd", np.where(x > 0.3, 0.5 + 0.5 * normal[1], 0.0) * np.ones((3, 1, 1)))
    put("VolumeInd", np.full((3, size, size), 0.02))
    put("Emit", np.where((x + 0.6) ** 2 + (y - 0.6) ** 2 < 0.02, 6.0, 0.0) * np.ones((3, 1, 1)))
    put("Denoising Albedo", texture * rgb)
    put("Denoising Normal", normal)
    put("Denoising Depth", 5 - hills(x, y)[None])
    out[pass_slice("Combined")][3] = 1
    return out


def sum_passes(render: np.ndarray) -> None:
    """Writes Combined as the sum of the others, as Cycles does."""
    total = render[pass_slice("Emit")] + render[pass_slice("VolumeDir")] + render[pass_slice("VolumeInd")]
    for name in ("Diff", "Gloss", "Trans"):
        light = render[pass_slice(f"{name}Dir")] + render[pass_slice(f"{name}Ind")]
        total = total + light * render[pass_slice(f"{name}Col")]
    render[pass_slice("Combined")][:3] = total


def noisy_render(clean: np.ndarray, spp: int, rng: np.random.Generator) -> np.ndarray:
    """Light times gamma noise of mean 1 and variance 1 / spp, the same for the three colours."""
    render = clean.copy()
    for name in ("DiffDir", "DiffInd", "GlossInd", "VolumeInd"):
        render[pass_slice(name)] *= rng.gamma(spp, 1 / spp, render.shape[1:])
    sum_passes(render)
    return render.astype(np.float32)


def write_frame(root: Path, name: str, size: int, seed: int, renders: Iterable[str] = RENDERS) -> Path:
    """One frame of the training split; name is FAMILY/FRAME. The same arguments write the same bytes."""
    folder = root / "train" / name
    folder.mkdir(parents=True, exist_ok=True)
    clean = clean_render(size, seed)
    renders = tuple(renders)
    meta = {
        "family": name.split("/")[0],
        "seed": seed,
        "fingerprint": f"{seed:016x}",
        "channels": CHANNELS,
        "seconds": {render: 0.0 for render in renders},
        "cycles_seeds": {render: i for i, render in enumerate(renders)},
    }
    (folder / "meta.json").write_text(json.dumps(meta))
    for index, (render, spp) in enumerate(RENDERS.items()):
        if render in renders:
            pixels = noisy_render(clean, spp, np.random.default_rng([seed, index]))
            write_render(folder / f"{render}.qfr", pixels, spp)
    return folder


def write_data_set(root: Path, frames: int = 3, size: int = 64) -> Path:
    """A training split of a few frames in two families."""
    for i in range(frames):
        write_frame(root, f"{'hills' if i % 2 == 0 else 'dunes'}/{i:05d}_0", size, seed=i)
    return root
