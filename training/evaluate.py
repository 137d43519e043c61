# SPDX-License-Identifier: Apache-2.0
"""Error of a run on the validation frames, beside the noisy input and Open Image Denoise.

    python -m training.evaluate --run NAME [--spp 4,16,64] [--csv FILE] [--no-peer]

relMSE with two references, whose own noise cancels: mean of (x - a)(x - b) / (m^2 + 0.01), m = (a + b) / 2. Quoted are
the geometric mean over frames and the worst frame. Models see all passes ("all") or Combined and guides ("beauty").
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
import torch

from training import peer
from training.data.crops import to_guides, to_layers
from training.data.pack import CLOSURE_TOLERANCE, INPUT, choose_environment, select_passes
from training.data.store import FrameRecord, list_frames, pass_slice, read_render
from training.export import load_run, round_to_half
from training.infer import denoise_frame
from training.models.quell import Quell
from training.paths import data_root

EPSILON = 0.01


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Images [3,h,w], float."""
    m = 0.5 * (a.astype(np.float64) + b)
    return float(((x - a) * (x - b).astype(np.float64) / (m * m + EPSILON)).mean())


def evaluate_frame(model: Quell | None, record: FrameRecord, spp: int, use_peer: bool) -> dict[str, float]:
    """relMSE of Combined by method."""
    refs = [read_render(record.renders[f"ref_{k}"])[pass_slice("Combined")][:3].astype(np.float32) for k in "ab"]
    render = read_render(record.renders[f"{spp}_0"])
    with_environment, error = choose_environment(render)
    x = select_passes(render, with_environment)
    closes = error < CLOSURE_TOLERANCE
    noisy = x[INPUT["beauty"]]
    out = {"noisy": rel_mse(noisy, *refs)}
    tensor = torch.from_numpy(x)[None]
    guides = to_guides(tensor)
    if model is not None:
        for name, light in (("beauty", False), ("all", True)):
            result = denoise_frame(model, to_layers(tensor, light), guides, spp)
            image = result.combined if closes or not light else result.direct
            out[name] = rel_mse(image[0].numpy(), *refs)
            if light:
                out["direct"] = rel_mse(result.direct[0].numpy(), *refs)
                out["rebuilt"] = rel_mse(result.rebuilt[0].numpy(), *refs)
    if use_peer:
        planes = [x[INPUT[name]].transpose(1, 2, 0) for name in ("beauty", "albedo", "normal")]
        for setting in ("fast/fast", "high/fast", "high/accurate"):
            image = peer.denoise(*planes, setting).transpose(2, 0, 1)
            out[setting] = rel_mse(image, *refs)
    return out


def geometric(values: list[float]) -> float:
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-8)))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run")
    parser.add_argument("--spp", default="4,16,64")
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--no-peer", action="store_true")
    args = parser.parse_args()
    model = round_to_half(load_run(args.run)[0]) if args.run else None
    rows = []
    for spp in map(int, args.spp.split(",")):
        scores: dict[str, list[float]] = {}
        for record in list_frames(data_root(), "val"):
            if not {f"{spp}_0", "ref_a", "ref_b"} <= set(record.renders):
                continue
            frame = evaluate_frame(model, record, spp, not args.no_peer)
            rows.append({"frame": f"{record.family}/{record.name}", "spp": spp, **frame})
            for method, value in frame.items():
                scores.setdefault(method, []).append(value)
        for method, values in scores.items():
            print(f"{spp:4d} spp {method:14s} {geometric(values):.5f}  worst {max(values):.5f}  ({len(values)} frames)")
    if args.csv and rows:
        args.csv.parent.mkdir(parents=True, exist_ok=True)
        with args.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
