# SPDX-License-Identifier: Apache-2.0
"""One frame by the C library and by PyTorch: how far apart are they?

    python -m training.parity --weights FILE.qwt --exr RENDER.exr [--quell build/release/bin/quell]

The frame is handed over as an EXR of 32-bit floats. Prints, for each pass that both denoise, the largest difference
relative to the pass's largest value; exit status 1 when one exceeds --tolerance.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from training.data.crops import to_guides, to_layers
from training.data.pack import CLOSURE_TOLERANCE, choose_environment, select_passes
from training.data.store import pass_slice
from training.export import load_weights
from training.exr import ExrRender, read_exr, write_exr
from training.infer import denoise_frame
from training.models.quell import Quell

#: Sums of a few hundred products through a dozen layers, in another order; seen are differences below 1e-6.
TOLERANCE = 1e-5
LIGHT = ("Diff", "Gloss", "Trans", "Volume")


def by_pytorch(model: Quell, frame: ExrRender) -> dict[str, np.ndarray]:
    """Pass -> [3,h,w] of what the network filters; Emission and Environment, which C filters apart, are left out."""
    with_environment, error = choose_environment(frame.pixels)
    x = torch.from_numpy(select_passes(frame.pixels, with_environment))[None]
    has_light = all(f"{name}Dir" in frame.present for name in LIGHT[:3])
    guides = to_guides(x)
    for name in ("albedo", "normal", "depth"):
        if f"Denoising {name.title()}" not in frame.present:
            guides = replace(guides, **{name: None})
    out = denoise_frame(model, to_layers(x, has_light), guides, frame.spp or 0)
    combined = out.combined if error < CLOSURE_TOLERANCE else out.direct
    result = {"Combined": combined[0].numpy()}
    if out.light is None or out.color is None:
        return result
    for i, name in enumerate(LIGHT):
        for j, part in enumerate(("Dir", "Ind")):
            result[f"{name}{part}"] = out.light[0, i, j].numpy()
        if i < 3:
            result[f"{name}Col"] = out.color[0, i].numpy()
    return result


def by_tool(quell: Path, weights: Path, frame: ExrRender, folder: Path) -> ExrRender:
    """The same frame through the command-line tool."""
    source, target = folder / "parity-in.exr", folder / "parity-out.exr"
    write_exr(source, frame.pixels, frame.spp, frame.present)
    # The blend with the render is the library's own; the kernels are what both compute, in float32.
    plain = ["--no-blend", "--no-skip", "--precision", "float32"]
    subprocess.run([quell, "denoise", source, "-o", target, "-m", weights, "-q", *plain], check=True)
    return read_exr(target)


def compare(quell: Path, weights: Path, exr: Path, folder: Path) -> dict[str, float]:
    """Pass -> largest difference relative to the largest value, for every pass that is not black."""
    frame = read_exr(exr)
    expected = by_pytorch(load_weights(weights), frame)
    found = by_tool(quell, weights, frame, folder)
    worst = {}
    for name, image in expected.items():
        top = float(np.abs(image).max())
        if top > 0:
            worst[name] = float(np.abs(found.pixels[pass_slice(name)][:3] - image).max()) / top
    return worst


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--exr", type=Path, required=True)
    parser.add_argument("--quell", type=Path, default=Path("build/release/bin/quell"))
    parser.add_argument("--tolerance", type=float, default=TOLERANCE)
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="quell-parity-") as folder:
        worst = compare(args.quell, args.weights, args.exr, Path(folder))
    for name, difference in worst.items():
        print(f"{name:10s} {difference:.2e}")
    return 1 if max(worst.values()) > args.tolerance else 0


if __name__ == "__main__":
    sys.exit(main())
