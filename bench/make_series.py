#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Render crops of the sample scenes at 1, 2, 4, ... 4096 samples per pixel.

Usage: python bench/make_series.py --out FOLDER [--max-spp N] [NAME...]

Needs Blender as a module (bpy), of the version that the sample names: 4.5 for living_room, 5.0 for still_life and
house. A crop covers the same pixels as in the sample, so the sample's two references serve it too; bench/series.py
measures. Each file has its own seed. A scene takes some 15 minutes on two idle cores up to 1024 samples, four times
that up to 4096; files that are there already are kept.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "samples"))

import bpy  # noqa: E402
import make_samples  # noqa: E402
from series_crops import CROPS, SIZE  # noqa: E402

FIRST_SEED = 9000  # no sample and no reference uses seeds from here on


def crop_to(scene: bpy.types.Scene, left: int, top: int) -> None:
    """Render the pixels left .. left + SIZE[0] - 1, top .. top + SIZE[1] - 1 alone."""
    render = scene.render
    width, height = render.resolution_x, render.resolution_y
    render.use_border = render.use_crop_to_border = True
    # Half a pixel inside, so that rounding cannot take a pixel more or less.
    render.border_min_x = (left + 0.25) / width
    render.border_max_x = (left + SIZE[0] + 0.25) / width
    render.border_min_y = (height - top - SIZE[1] + 0.25) / height
    render.border_max_y = (height - top + 0.25) / height


def make(name: str, out: Path, max_spp: int) -> None:
    sample = make_samples.SAMPLES[name]
    scene = make_samples.prepare(sample)
    make_samples.choose_passes(scene, sample, reference=False)
    crop_to(scene, *CROPS[name])
    (out / name).mkdir(parents=True, exist_ok=True)
    spp, seed = 1, FIRST_SEED
    while spp <= max_spp:
        path = out / name / f"{name}_{spp}spp.exr"
        if not path.exists():
            start = time.perf_counter()
            partial = path.with_suffix(".part.exr")
            make_samples.render(scene, partial, spp, seed)
            partial.rename(path)
            print(f"{path.name}: {time.perf_counter() - start:.0f} s", flush=True)
        spp, seed = 2 * spp, seed + 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--max-spp", type=int, default=4096)
    options = parser.parse_args()
    for name in options.names or CROPS:
        if make_samples.SAMPLES[name].version == bpy.app.version[:2]:
            make(name, options.out, options.max_spp)


if __name__ == "__main__":
    main()
