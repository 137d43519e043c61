# SPDX-License-Identifier: Apache-2.0
"""Writes a run of DGAN-KPN as the weight file that the C library reads (docs/FORMATS.md: kind dgan-kpn-1).

python -m training.dgan.export --run dgan/joint --out weights/dgan-kpn.qwt --name dgan-kpn
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.dgan.model import DganKpn
from training.dgan.train import config_from_json, read_checkpoint
from training.export import write_weights
from training.train import run_folder

KIND = "dgan-kpn-1"


def load_run(name: str) -> tuple[DganKpn, int]:
    """A run's model, and the steps that it was trained."""
    config = config_from_json(json.loads((run_folder(name) / "config.json").read_text())["config"])
    state = read_checkpoint(name)
    model = DganKpn(config.model)
    model.load_state_dict(state["model"])
    return model.eval(), state["step"]


def round_to_half(model: DganKpn) -> DganKpn:
    """The model with the weights that its file has."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(parameter.half().float())
    return model


def file_order(weight: Tensor) -> np.ndarray:
    """[out,in,kh,kw] to [kh,kw,in,out], half."""
    return weight.detach().permute(2, 3, 1, 0).contiguous().numpy().astype(np.float16)


def convolution(name: str, weight: Tensor, bias: Tensor | None) -> dict[str, np.ndarray]:
    values = np.zeros(weight.shape[0], np.float16) if bias is None else bias.detach().numpy().astype(np.float16)
    return {f"{name}.weight": file_order(weight), f"{name}.bias": values}


def joined(name: str, weight: Tensor, bias: Tensor | None, own: int) -> dict[str, np.ndarray]:
    """A convolution of two joined tensors as one of each: the first `own` input channels, and the skip's."""
    return convolution(name, weight[:, :own], bias) | convolution(f"{name}.skip", weight[:, own:], None)


def tensors(model: DganKpn) -> dict[str, np.ndarray]:
    g, k, out = model.generator, model.kpn, {}
    widths, decoder = model.config.generator.widths, model.config.generator.decoder
    for i, layer in enumerate(g.encoder):
        out |= convolution(f"encoder.{i}", layer.conv.weight, None)
    for i, block in enumerate(g.blocks):
        for j, layer in enumerate((block.first, block.second)):
            out |= convolution(f"block.{i}.{j}", layer.conv.weight, None)
    for i, layer in enumerate(g.decoder):
        out |= joined(f"decoder.{i}", layer.conv.weight, None, decoder[i - 1] if i else widths[3])
    out |= joined("last", g.last.weight, g.last.bias, decoder[3])
    out |= convolution("source.0", k.source_first.weight, k.source_first.bias)
    out |= convolution("source.1", k.source_second.weight, k.source_second.bias)
    out |= convolution("source.skip", k.source_skip.weight, k.source_skip.bias)
    for i, block in enumerate(k.blocks):
        for j, layer in enumerate((block.first, block.second)):
            out |= convolution(f"feature.{i}.{j}", layer.weight, layer.bias)
    for i, layer in enumerate(k.predictor):
        out |= convolution(f"predictor.{i}", layer.weight, layer.bias)
    return out


def records(model: DganKpn, name: str, description: str) -> dict[str, np.ndarray | str]:
    """Everything that a weight file holds."""
    generator, kpn = model.config.generator, model.config.kpn
    if kpn.source_size != 5:
        raise ValueError("the C library runs source encoders of 5x5")
    return {
        "meta.kind": KIND,
        "meta.name": name,
        "meta.description": description,
        "config.generator.widths": np.array(generator.widths, np.int32),
        "config.generator.decoder": np.array(generator.decoder, np.int32),
        "config.generator.blocks": np.array([generator.blocks], np.int32),
        "config.kpn": np.array([kpn.width, kpn.blocks, kpn.predictor], np.int32),
        **tensors(model),
    }


def export(model: DganKpn, path: Path, name: str, description: str) -> str:
    """Writes the file and returns its SHA-256."""
    return write_weights(path, records(model, name, description))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--name", required=True)
    args = parser.parse_args()
    model, step = load_run(args.run)
    sha = export(model, args.out, args.name, f"DGAN-KPN as published, narrower; {step} joint training steps")
    print(f"{args.out}: {args.out.stat().st_size} bytes, sha256 {sha}")


if __name__ == "__main__":
    main()
