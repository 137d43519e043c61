#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Error against samples per pixel: what denoising does to renders of 1 to 4096 samples.

Usage: python bench/series.py --series FOLDER [--quell PROGRAM] [--csv FILE] [-- OPTION...]

FOLDER is what bench/make_series.py made. Options behind -- go to `quell denoise`. Errors are relMSE against the
sample's two references, whose own noise cancels; change is the RMS of output - input, both relative to the mean of the
references as in relMSE and in the display's range after z / (1 + z), of which 1 is white.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from series_crops import CROPS, SIZE

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Point:
    """One file of a series before and after denoising."""

    scene: str
    spp: int
    before: float
    after: float
    change: float
    change_display: float


def read_combined(path: Path) -> np.ndarray:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: c.pixels for part in file.parts for name, c in part.channels.items()}
    name = next(n for n in channels if n.endswith("Combined.R"))
    return np.stack([channels[name[:-1] + c].astype(np.float64) for c in "RGB"], -1)


def crop(name: str, pixels: np.ndarray) -> np.ndarray:
    (left, top), (width, height) = CROPS[name], SIZE
    return pixels[top : top + height, left : left + width]


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    m = 0.5 * (a + b)
    return float(((x - a) * (x - b) / (m * m + 0.01)).mean())


def display(x: np.ndarray) -> np.ndarray:
    x = np.maximum(x, 0)
    return x / (1 + x)


def measure(quell: Path, options: list[str], path: Path, name: str, spp: int, out: Path) -> Point:
    target = out / path.name
    subprocess.run([str(quell), "denoise", "-q", str(path), "-o", str(target), *options], check=True)
    refs = [crop(name, read_combined(ROOT / "samples" / name / f"{name}_ref_{k}.exr")) for k in "ab"]
    source, result = read_combined(path), read_combined(target)
    m = 0.5 * (refs[0] + refs[1])
    return Point(
        name,
        spp,
        rel_mse(source, *refs),
        rel_mse(result, *refs),
        float(np.sqrt(((result - source) ** 2 / (m * m + 0.01)).mean())),
        float(np.sqrt(((display(result) - display(source)) ** 2).mean())),
    )


def main() -> None:
    at = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    own, rest = sys.argv[1:at], sys.argv[at + 1 :]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--series", type=Path, required=True)
    parser.add_argument("--quell", type=Path, default=ROOT / "build" / "release" / "bin" / "quell")
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args(own)
    points = []
    print(f"{'scene':12} {'spp':>5} {'before':>10} {'after':>10} {'change':>8} {'display':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for name in CROPS:
            for spp in (2**k for k in range(13)):
                path = options.series / name / f"{name}_{spp}spp.exr"
                if not path.exists():
                    continue
                p = measure(options.quell, rest, path, name, spp, Path(folder))
                points.append(p)
                print(
                    f"{p.scene:12} {p.spp:5} {p.before:10.6f} {p.after:10.6f} {p.change:8.2%} {p.change_display:8.3%}",
                    flush=True,
                )
    if options.csv:
        with options.csv.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(asdict(points[0])))
            writer.writeheader()
            writer.writerows(asdict(p) for p in points)


if __name__ == "__main__":
    main()
