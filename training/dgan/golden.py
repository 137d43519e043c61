# SPDX-License-Identifier: Apache-2.0
"""Writes tests/golden/dgan_small.qwt: a small DGAN-KPN of random weights, frames, and what PyTorch makes of them.

python -m training.dgan.golden --out tests/golden/dgan_small.qwt
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.dgan.config import DganKpnConfig, GeneratorConfig, KpnConfig
from training.dgan.export import records, round_to_half
from training.dgan.infer import FramePasses, denoise_frame
from training.dgan.model import DganKpn
from training.export import write_weights

SIZES = ((1, 1), (17, 33), (40, 21))  # width, height
#: name -> iterations, parts, reading
CASES = {
    "both": (4, "both", "filter"),
    "both_8": (8, "both", "filter"),
    "network": (2, "both", "network"),
    "dgan": (1, "dgan", "filter"),
    "kpn": (3, "kpn", "filter"),
}


def random_model(seed: int) -> DganKpn:
    torch.manual_seed(seed)
    config = DganKpnConfig(
        GeneratorConfig(widths=(16, 16, 16, 32), blocks=2, decoder=(16, 16, 16, 16), deviation=0.1),
        KpnConfig(width=16, blocks=2, predictor=24),
    )
    model = DganKpn(config).eval()
    with torch.no_grad():
        # Far from the start, where kernels would be nearly flat and the picture nearly black.
        model.kpn.predictor[-1].weight.mul_(4)
        model.generator.last.weight.mul_(0.7)
        model.generator.last.bias.fill_(0.8)
    return round_to_half(model)


def random_passes(width: int, height: int, seed: int) -> FramePasses:
    """Light over several stops, a firefly, background beyond the depth's end, unbounded albedo."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(channels: int) -> Tensor:
        return torch.rand(1, channels, height, width, generator=generator)

    combined = torch.exp(2 * torch.randn(1, 3, height, width, generator=generator)) * 0.3
    combined[..., height // 2, width // 2] *= 50
    depth = uniform(1) * 20 + 0.5
    if height > 4:
        depth[..., :3, :] = 1e10
    return FramePasses(
        combined, uniform(3) * 2 - 1, uniform(3) * 30 - 9, uniform(3) * 2, uniform(3), uniform(3) * 0.5, depth
    )


def planar(x: Tensor) -> np.ndarray:
    return x[0].contiguous().numpy().astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    model = random_model(7)
    values = records(model, "golden", "random weights for tests")
    for index, (width, height) in enumerate(SIZES):
        passes = random_passes(width, height, index)
        for name, plane in vars(passes).items():
            values[f"frame.{index}.{name}"] = planar(plane)
        for case, (iterations, parts, reading) in CASES.items():
            values[f"want.{index}.{case}"] = planar(denoise_frame(model, passes, iterations, parts, reading))
        bare = FramePasses(passes.combined)
        values[f"want.{index}.bare"] = planar(denoise_frame(model, bare, 4))
    sha = write_weights(args.out, values)
    print(f"{args.out}: {args.out.stat().st_size} bytes, {sha}")


if __name__ == "__main__":
    main()
