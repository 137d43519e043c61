# SPDX-License-Identifier: Apache-2.0
"""docs/images/debug-layers.png: a sample, and what --debug-layers says about it.

python bench/debug_layers.py [--quell build/release/bin/quell] [--out docs/images/debug-layers.png] [FILE.exr]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import matplotlib.pyplot as plt

from bench.common import ROOT
from bench.plots import save

#: Layer, title, the value that is white.
MAPS = (
    ("Quell Noise", "Quell Noise: deviation / mean", 0.5),
    ("Quell Confidence", "Quell Confidence: share of the kernels", 1.0),
    ("Quell Skipped", "Quell Skipped: not computed", 1.0),
)


def display(image: np.ndarray) -> np.ndarray:
    """Scene-linear to the sRGB curve, clipped."""
    clipped = np.clip(image.astype(np.float32), 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def channels(path: Path) -> dict[str, np.ndarray]:
    """Channels of the first view layer by "PASS.LETTER"."""
    import OpenEXR

    found: dict[str, np.ndarray] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                found.setdefault(".".join(name.split(".")[-2:]), np.asarray(channel.pixels))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quell", type=Path, default=ROOT / "build" / "release" / "bin" / "quell")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "debug-layers.png")
    parser.add_argument("file", type=Path, nargs="?", default=ROOT / "samples" / "house" / "house_16spp.exr")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.exr"
        subprocess.run([args.quell, "denoise", args.file, "-q", "-o", out, "--debug-layers"], check=True)
        before, after = channels(args.file), channels(out)
    beauty = np.stack([before[f"Combined.{c}"] for c in "RGB"], -1)
    height, width = beauty.shape[:2]
    figure, panels = plt.subplots(
        1, 1 + len(MAPS), figsize=(3.2 * (1 + len(MAPS)), 3.2 * height / width + 0.35), constrained_layout=True
    )
    panels[0].imshow(display(beauty))
    panels[0].set_title("Combined, as rendered", fontsize=9)
    for panel, (name, title, white) in zip(panels[1:], MAPS, strict=True):
        panel.imshow(after[f"{name}.Y"].astype(np.float32), cmap="viridis", vmin=0.0, vmax=white)
        panel.set_title(title, fontsize=9)
    for panel in panels:
        panel.set_axis_off()
    save(figure, args.out, num_colors=256)


if __name__ == "__main__":
    main()
