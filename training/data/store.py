# SPDX-License-Identifier: Apache-2.0
"""One file per render: planar floats, byte planes split, zstd.

Float noise hardly compresses as a stream of whole values; with the bytes of each
significance stored together the exponent planes shrink several times.
"""

from __future__ import annotations

import json
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

_RGB = ("R", "G", "B")
_XYZ = ("X", "Y", "Z")
_LIGHT_PASSES = (
    "DiffDir",
    "DiffInd",
    "DiffCol",
    "GlossDir",
    "GlossInd",
    "GlossCol",
    "TransDir",
    "TransInd",
    "TransCol",
    "VolumeDir",
    "VolumeInd",
    "Emit",
    "Env",
)

#: Channel groups in file order: pass name -> component letters.
PASSES: dict[str, tuple[str, ...]] = {
    "Combined": ("R", "G", "B", "A"),
    **{name: _RGB for name in _LIGHT_PASSES},
    "Denoising Albedo": _RGB,
    "Denoising Normal": _XYZ,
    "Denoising Depth": ("Z",),
    "Normal": _XYZ,
    "Position": _XYZ,
    "Depth": ("Z",),
}

#: Every channel of a stored render, in order, as "Pass.C".
CHANNELS: tuple[str, ...] = tuple(f"{name}.{c}" for name, cs in PASSES.items() for c in cs)

#: Planar depth beyond this is background (Cycles writes 1e10 or FLT_MAX there).
BACKGROUND_DEPTH = 1e9

_MAGIC = b"QFR1"
# magic, dtype (2 = float16, 4 = float32), channels, height, width, samples per pixel
_HEADER = struct.Struct("<4sIIIII")
_HALF_MAX = 65504.0
_FLOAT32_FROM_SPP = 256
_DTYPES = {2: np.dtype("<f2"), 4: np.dtype("<f4")}


class CorruptRenderError(Exception):
    """A render file is truncated, damaged or not a render file at all."""


@dataclass(frozen=True)
class FrameRecord:
    """One frame folder: its metadata and the renders that exist for it."""

    folder: Path
    split: str
    family: str
    name: str
    meta: dict[str, Any]
    renders: dict[str, Path]


def pass_slice(name: str) -> slice:
    """Return the channel range of a pass within a stored render."""
    start = 0
    for key, components in PASSES.items():
        if key == name:
            return slice(start, start + len(components))
        start += len(components)
    raise KeyError(name)


def write_atomic(path: Path, payload: bytes) -> None:
    """Write a file so that a kill at any moment leaves either all of it or none."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with temporary.open("wb") as file:
        file.write(payload)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def write_render(path: Path, array: np.ndarray, spp: int) -> None:
    """Store a [C,H,W] render: float16, or float32 for references of 256 spp and more."""
    if array.ndim != 3:
        raise ValueError(f"expected [C,H,W], got shape {array.shape}")
    dtype = _DTYPES[4 if spp >= _FLOAT32_FROM_SPP else 2]
    # NaN stays NaN: it is for the loader to mask, hiding it here would hide broken scenes.
    stored = np.clip(array, -_HALF_MAX, _HALF_MAX).astype(dtype)
    planes = stored.reshape(-1).view(np.uint8).reshape(-1, dtype.itemsize).T
    body = zstandard.ZstdCompressor(level=3, write_checksum=True).compress(np.ascontiguousarray(planes).tobytes())
    channels, height, width = stored.shape
    header = _HEADER.pack(_MAGIC, dtype.itemsize, channels, height, width, spp)
    write_atomic(path, header + body)


def read_header(path: Path) -> tuple[np.dtype, tuple[int, int, int], int]:
    """Return dtype, shape [C,H,W] and samples per pixel of a stored render."""
    with path.open("rb") as file:
        head = file.read(_HEADER.size)
    return _parse_header(path, head)


def _parse_header(path: Path, head: bytes) -> tuple[np.dtype, tuple[int, int, int], int]:
    if len(head) < _HEADER.size:
        raise CorruptRenderError(f"{path}: {len(head)} bytes, too short for a header")
    magic, size, channels, height, width, spp = _HEADER.unpack(head[: _HEADER.size])
    if magic != _MAGIC:
        raise CorruptRenderError(f"{path}: not a render file (starts with {magic!r})")
    if size not in _DTYPES:
        raise CorruptRenderError(f"{path}: unknown value size {size}")
    if not (0 < channels <= 4096 and 0 < height <= 65536 and 0 < width <= 65536):
        raise CorruptRenderError(f"{path}: impossible shape {channels}x{height}x{width}")
    return _DTYPES[size], (channels, height, width), spp


def read_render(path: Path) -> np.ndarray:
    """Return a stored render as [C,H,W], float16 (float32 for references)."""
    blob = path.read_bytes()
    dtype, shape, _ = _parse_header(path, blob)
    expected = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    try:
        body = zstandard.ZstdDecompressor().decompress(blob[_HEADER.size :], max_output_size=expected)
    except zstandard.ZstdError as error:
        raise CorruptRenderError(f"{path}: {error}") from error
    if len(body) != expected:
        raise CorruptRenderError(f"{path}: {len(body)} bytes of pixels, expected {expected}")
    planes = np.frombuffer(body, np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(planes.T).reshape(-1).view(dtype).reshape(shape)


def render_spp(name: str) -> int | None:
    """Return the sample count a render name like "4_0" tells, None for references."""
    head = name.split("_")[0]
    return int(head) if head.isdigit() else None


def list_frames(root: Path, split: str) -> list[FrameRecord]:
    """Return every frame of a split that has metadata and at least one render, sorted."""
    frames = []
    for meta_path in sorted((root / split).glob("*/*/meta.json")):
        folder = meta_path.parent
        renders = {path.stem: path for path in sorted(folder.glob("*.qfr"))}
        if not renders:
            continue
        meta = json.loads(meta_path.read_text(encoding="utf-8"))
        frames.append(FrameRecord(folder, split, folder.parent.name, folder.name, meta, renders))
    return frames
