# SPDX-License-Identifier: Apache-2.0
"""The tool against PyTorch on whole frames, for each of DGAN-KPN's switches, in bands and in one piece. Small frames
are in tests/golden/test_dgan.c, which needs no PyTorch."""

from __future__ import annotations

import math
import os
import subprocess
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch, which the product's tests do not install")

import numpy as np  # noqa: E402
import OpenEXR  # noqa: E402

from training.dgan.export import export  # noqa: E402
from training.dgan.golden import random_model, random_passes  # noqa: E402
from training.dgan.infer import FramePasses, denoise_frame  # noqa: E402
from training.dgan.model import DganKpn  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / os.environ.get("QUELL_BUILD", "build/release") / "bin" / "quell"
MIN_PSNR = 90.0
#: switches of the tool -> iterations, parts, reading
SWITCHES = {
    (): (4, "both", "filter"),
    ("--dgan-only",): (1, "dgan", "filter"),
    ("--kpn-only", "--iterations", "8"): (8, "kpn", "filter"),
    ("--iterate", "network", "--iterations", "2", "--run-all-iterations"): (2, "both", "network"),
}
CHANNELS = {
    "combined": ("Combined", "RGB"),
    "normal": ("Denoising Normal", "XYZ"),
    "position": ("Position", "XYZ"),
    "albedo": ("Denoising Albedo", "RGB"),
    "glossy": ("GlossCol", "RGB"),
    "transmission": ("TransCol", "RGB"),
    "depth": ("Denoising Depth", "Z"),
}


def write_exr(path: Path, passes: FramePasses) -> None:
    planes = {}
    for field, (name, letters) in CHANNELS.items():
        for letter, plane in zip(letters, getattr(passes, field)[0].numpy(), strict=True):
            planes[f"ViewLayer.{name}.{letter}"] = np.ascontiguousarray(plane, np.float32)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(path))


def read_combined(path: Path) -> np.ndarray:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return np.stack([file.channels()[f"ViewLayer.Combined.{c}"].pixels for c in "RGB"])


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[DganKpn, Path]:
    model = random_model(3)
    path = tmp_path_factory.mktemp("dgan") / "random.qwt"
    export(model, path, "random", "random weights for a test")
    return model, path


@pytest.mark.parametrize("size", [(256, 256), (1000, 700)], ids=str)
@pytest.mark.parametrize("switches", SWITCHES, ids=lambda s: " ".join(s) or "both")
def test_tool_agrees_with_pytorch(
    size: tuple[int, int], switches: tuple[str, ...], model_file: tuple[DganKpn, Path], tmp_path: Path
) -> None:
    model, weights = model_file
    passes = random_passes(*size, seed=5)
    write_exr(tmp_path / "in.exr", passes)
    iterations, parts, reading = SWITCHES[switches]
    want = denoise_frame(model, passes, iterations, parts, reading)[0].numpy().astype(np.float64)
    results = []
    for tile in ("0", "64"):
        out = tmp_path / f"out{tile}.exr"
        command = [TOOL, "denoise", tmp_path / "in.exr", "-o", out, "-q", "--model", weights, "--tile", tile, *switches]
        subprocess.run(command, check=True)
        results.append(read_combined(out))
    error = np.mean((results[0] - want) ** 2)
    assert 10 * math.log10(want.max() ** 2 / max(error, 1e-300)) >= MIN_PSNR
    assert np.array_equal(results[0], results[1])
