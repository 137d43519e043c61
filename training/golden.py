# SPDX-License-Identifier: Apache-2.0
"""Writes tests/golden/quell_small.qwt: a small network with random weights, an input, and what PyTorch makes of both.

    python -m training.golden --out tests/golden/quell_small.qwt

The C test runs every layer on PyTorch's input of that layer, then the whole network, then a whole frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from training.export import file_name, file_records, round_to_half, write_weights
from training.features import Guides, Layers
from training.infer import denoise_frame, frame_features
from training.models.quell import Quell, QuellConfig

WIDTH, HEIGHT, SPP = 30, 18, 4  # no multiples of 16: the padding is tested too


def random_frame(generator: torch.Generator) -> tuple[Layers, Guides]:
    """Light over several stops, a few fireflies, black colours, background depth."""

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    light = torch.exp(2 * torch.randn(1, 4, 2, 3, HEIGHT, WIDTH, generator=generator)) * 0.3
    color = uniform(1, 3, 3, HEIGHT, WIDTH)
    color[:, 1] *= (uniform(1, 1, HEIGHT, WIDTH) > 0.3).float()
    light[:, :3] *= (color.mean(2, keepdim=True) > 0).float()[:, :, None]
    emission = (uniform(1, 3, HEIGHT, WIDTH) > 0.95).float() * 5
    beauty = (light[:, :3].sum(2) * color).sum(1) + light[:, 3].sum(1) + emission
    depth = uniform(1, 1, HEIGHT, WIDTH) * 20
    depth[..., :3] = 1e10
    guides = Guides(
        uniform(1, 3, HEIGHT, WIDTH) * 2, uniform(1, 3, HEIGHT, WIDTH) * 2 - 1, depth, uniform(1, 1, HEIGHT, WIDTH)
    )
    return Layers(beauty, light, color, emission), guides


def nhwc(x: torch.Tensor) -> np.ndarray:
    return x[0].permute(1, 2, 0).contiguous().detach().numpy().astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    torch.manual_seed(5)
    config = QuellConfig(widths=(16, 32, 16, 48), down_convs=(1, 2, 1, 2), up_convs=(1, 1, 2), detail=32)
    model = Quell(config)
    for head in model.net.heads:
        torch.nn.init.normal_(head.weight, std=0.1)
    for conv in (model.net.detail_out, model.net.detail_up):
        torch.nn.init.normal_(conv.weight, std=0.1)
    for table in (*model.net.filter_table, *model.net.up_table):
        torch.nn.init.normal_(table)
    model = round_to_half(model)
    layers, guides = random_frame(torch.Generator().manual_seed(3))
    values = file_records(model, "golden", "random weights for tests")
    traced: dict[str, np.ndarray] = {}

    def trace(name: str):
        def hook(_module, inputs, output) -> None:
            traced[f"in.{name}"], traced[f"out.{name}"] = nhwc(inputs[0]), nhwc(output)

        return hook

    hooks = [
        module.register_forward_hook(trace(file_name(name)))
        for name, module in model.net.named_modules()
        if isinstance(module, torch.nn.Conv2d)
    ]
    full = denoise_frame(model, layers, guides, SPP)
    for hook in hooks:
        hook.remove()
    values |= traced
    features = frame_features(layers, guides, SPP)
    values["frame.features"] = nhwc(features.planes)
    values["frame.flags"] = features.flags[0].numpy()
    values["frame.size"] = np.array([WIDTH, HEIGHT, SPP], np.int32)
    for name, x in {"beauty": layers.beauty, "emission": layers.emission, "albedo": guides.albedo,
                    "normal": guides.normal, "depth": guides.depth, "alpha": guides.alpha}.items():  # fmt: skip
        values[f"frame.{name}"] = nhwc(x)
    for i, name in enumerate(("diffuse", "glossy", "transmission", "volume")):
        for j, part in enumerate(("direct", "indirect")):
            values[f"frame.{name}_{part}"] = nhwc(layers.light[:, i, j])
            values[f"want.{name}_{part}"] = nhwc(full.light[:, i, j])
        if i < 3:
            values[f"frame.{name}_color"] = nhwc(layers.color[:, i])
            values[f"want.{name}_color"] = nhwc(full.color[:, i])
    values["want.combined"] = nhwc(full.combined)
    values["want.emission"] = nhwc(full.emission)
    alone = denoise_frame(model, Layers(layers.beauty), guides, SPP)
    values["want.combined_alone"] = nhwc(alone.combined)
    bare = denoise_frame(model, Layers(layers.beauty), Guides(None, None, None, None), 0)
    values["want.combined_bare"] = nhwc(bare.combined)
    sha = write_weights(args.out, values)
    print(f"{args.out}: {args.out.stat().st_size} bytes, {sha}")


if __name__ == "__main__":
    main()
