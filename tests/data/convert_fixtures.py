#!/usr/bin/env python3
"""Convert fixtures into files that other programs write, with OpenEXR 3.5.3.

Usage: python convert_fixtures.py [--out FOLDER]    (needs OpenEXR and numpy)

Run make_fixtures.py first. Pixels are those of the source file, bit for bit;
only codec, windows or storage change. README.md lists what each file is for.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Window = tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class Conversion:
    """One file to write: its source and the header fields that change."""

    source: str
    header: dict[str, Any] = field(default_factory=dict)
    data: Window | None = None
    display: Window | None = None


CONVERSIONS: dict[str, Conversion] = {
    "conv_htj2k256": Conversion("50_zip_float", {"compression": OpenEXR.HTJ2K256_COMPRESSION}),
    "conv_htj2k32_single": Conversion("45_zips_float", {"compression": OpenEXR.HTJ2K32_COMPRESSION}),
    # A crop: the picture is larger than the pixels stored.
    "conv_cropped_single": Conversion("45_piz", data=((10, 8), (54, 36)), display=((0, 0), (63, 47))),
    "conv_cropped_multi": Conversion("50_transparent", data=((10, 8), (54, 36)), display=((0, 0), (63, 47))),
    # Overscan: pixels beyond the picture on every side.
    "conv_overscan_single": Conversion("45_transparent", data=((-4, -3), (40, 25)), display=((0, 0), (36, 22))),
    "conv_tiled": Conversion(
        "45_beauty_guides",
        {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()},
    ),
    "conv_decreasing_y": Conversion("45_beauty_guides", {"lineOrder": OpenEXR.DECREASING_Y}),
}


def window(value: Window) -> tuple[np.ndarray, np.ndarray]:
    low, high = value
    return np.array(low, np.int32), np.array(high, np.int32)


def convert(name: str, what: Conversion, folder: Path, out: Path) -> None:
    source = OpenEXR.File(str(folder / f"{what.source}.exr"), separate_channels=True)
    parts = []
    for part in source.parts:
        header = {k: v for k, v in part.header.items() if k not in ("channels", "chunkCount")}
        header.update(what.header)
        if what.data and what.display:
            header["dataWindow"] = window(what.data)
            header["displayWindow"] = window(what.display)
        if "tiles" in header:
            header["tiles"].xSize = header["tiles"].ySize = 16
        channels = {
            key: OpenEXR.Channel(np.ascontiguousarray(channel.pixels)) for key, channel in part.channels.items()
        }
        parts.append(OpenEXR.Part(header, channels, part.header.get("name", "")))
    path = out / f"{name}.exr"
    OpenEXR.File(parts).write(str(path))
    verify(source, path, what)
    print(f"{path.name} {path.stat().st_size}")


def verify(source: OpenEXR.File, path: Path, what: Conversion) -> None:
    """Read the new file back; raise if a pixel or a window is not as asked."""
    again = OpenEXR.File(str(path), separate_channels=True)
    if len(again.parts) != len(source.parts):
        raise ValueError(f"{path.name}: {len(again.parts)} parts")
    for old, new in zip(source.parts, again.parts, strict=True):
        if what.data and [tuple(map(int, w)) for w in new.header["dataWindow"]] != list(what.data):
            raise ValueError(f"{path.name}: data window {new.header['dataWindow']}")
        for key, channel in old.channels.items():
            if not np.array_equal(channel.pixels, new.channels[key].pixels, equal_nan=True):
                raise ValueError(f"{path.name}: {key} differs")


def main() -> None:
    here = Path(__file__).resolve().parent
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=here)
    parser.add_argument("--source", type=Path, default=None, help="default: the same folder")
    options = parser.parse_args()
    for name, what in CONVERSIONS.items():
        convert(name, what, options.source or options.out, options.out)


if __name__ == "__main__":
    main()
