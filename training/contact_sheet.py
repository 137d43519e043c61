# SPDX-License-Identifier: Apache-2.0
"""Make a PNG of tone-mapped thumbnails of rendered frames, to be looked at.

python -m training.contact_sheet --split train --out sheet.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from training.data.store import FrameRecord, list_frames, pass_slice, read_render, render_spp
from training.paths import data_root


def best_render(frame: FrameRecord) -> Path:
    """Return the frame's render of most samples."""
    return max(frame.renders.items(), key=lambda item: render_spp(item[0]) or 1 << 20)[1]


def thumbnail(frame: FrameRecord, side: int, layer: str) -> Image.Image:
    """Return a labelled, tone-mapped thumbnail."""
    pixels = read_render(best_render(frame))[pass_slice(layer)][:3].astype(np.float32)
    pixels = np.maximum(np.nan_to_num(pixels), 0.0)
    # Reinhard by luminance and the display's gamma: close to what Blender would show.
    light = pixels.mean(0, keepdims=True)
    toned = np.clip(pixels / (1.0 + light) * 1.1, 0, 1) ** (1 / 2.2)
    picture = Image.fromarray((toned.transpose(1, 2, 0) * 255 + 0.5).astype(np.uint8))
    picture = picture.resize((side, side), Image.Resampling.BOX)
    text = f"{frame.family} {frame.name}"
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, side - 11, min(side, 6 * len(text) + 4), side), fill=(0, 0, 0))
    draw.text((2, side - 12), text, fill=(255, 255, 0))
    return picture


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--split", default="train")
    parser.add_argument("--families", default="", help="comma-separated names, default all")
    parser.add_argument("--side", type=int, default=192, help="pixels per thumbnail")
    parser.add_argument("--columns", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="skip this many frames")
    parser.add_argument("--count", type=int, default=64, help="thumbnails at most")
    parser.add_argument("--since", default="", help="frames named from here on, e.g. 00004_0")
    parser.add_argument("--layer", default="Combined", help="pass to show")
    parser.add_argument("--data", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=Path("contact_sheet.png"))
    args = parser.parse_args()
    frames = list_frames(args.data or data_root(), args.split)
    if args.families:
        frames = [f for f in frames if f.family in args.families.split(",")]
    frames = sorted((f for f in frames if f.name >= args.since), key=lambda f: (f.name, f.family))
    frames = frames[args.first : args.first + args.count]
    if not frames:
        raise SystemExit("no frames")
    columns = min(args.columns, len(frames))
    rows = -(-len(frames) // columns)
    sheet = Image.new("RGB", (columns * args.side, rows * args.side))
    for index, frame in enumerate(frames):
        place = (index % columns * args.side, index // columns * args.side)
        sheet.paste(thumbnail(frame, args.side, args.layer), place)
    sheet.save(args.out)
    print(f"{args.out}: {len(frames)} frames")


if __name__ == "__main__":
    main()
