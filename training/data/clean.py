# SPDX-License-Identifier: Apache-2.0
"""What packed frames converge to, as nearly as a network knows: `python -m training.data.clean --weights FILE.qwt`.

The mean of all renders of a frame, denoised by weights that are there already. Nothing is trained towards it: the loss
divides by it (training/loss.py), and noise or bias of a few percent in a divisor matters little.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from training.data.crops import to_guides, to_layers
from training.data.pack import (
    INPUT,
    NUM_TARGET,
    TARGET,
    PackedFrame,
    divide_color,
    load_packs,
    pack_root,
    sum_parts,
)
from training.export import load_weights
from training.infer import denoise_frame
from training.models.quell import Quell
from training.paths import data_root


def mean_input(frame: PackedFrame) -> np.ndarray:
    """INPUT's channels [47,h,w] of all samples together; guides of the renders that are kept."""
    x = frame.inputs.mean(0, dtype=np.float32)
    mean = frame.sums / np.float32(frame.total_spp)
    for name in ("beauty", "color", "emission"):
        x[INPUT[name]] = mean[TARGET[name]]
    x[INPUT["light"]] = divide_color(mean[TARGET["product"]], mean[TARGET["color"]])
    return x


def clean_frame(model: Quell, frame: PackedFrame) -> np.ndarray:
    """TARGET's channels [39,h,w] of a frame, denoised."""
    x = torch.from_numpy(mean_input(frame))[None]
    out = denoise_frame(model, to_layers(x, True), to_guides(x), frame.total_spp)
    assert out.light is not None and out.color is not None and out.emission is not None and out.direct is not None
    product = out.light[0].clone()  # [4,2,3,h,w]
    product[:3] *= out.color[0][:, None]
    clean = np.empty((NUM_TARGET, *x.shape[-2:]), np.float32)
    clean[TARGET["product"]] = product.flatten(0, 2).numpy()
    clean[TARGET["color"]] = out.color[0].flatten(0, 1).numpy()
    clean[TARGET["emission"]] = out.emission[0].numpy()
    clean[TARGET["beauty"]] = sum_parts(clean) if frame.closes else out.direct[0].numpy()
    return clean


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--again", action="store_true", help="of frames that have one, too")
    args = parser.parse_args()
    model = load_weights(args.weights)
    done = 0
    for frame in load_packs(args.split):
        path = pack_root(data_root()) / args.split / frame.name / "clean.npy"
        if frame.clean is None or args.again:
            temporary = path.with_suffix(".tmp.npy")
            np.save(temporary, clean_frame(model, frame).clip(0, 65504).astype(np.float16))
            temporary.rename(path)
            done += 1
    print(f"{done} frames")


if __name__ == "__main__":
    main()
