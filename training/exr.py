# SPDX-License-Identifier: Apache-2.0
"""Multilayer EXRs of any Blender version as stored renders, and back. Needs no Blender."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR

from training.data.store import BACKGROUND_DEPTH, CHANNELS, PASSES, pass_slice

#: Blender 5 writes long pass names; the store keeps the short ones of 4.x.
SHORT_NAMES = {
    "Diffuse Direct": "DiffDir",
    "Diffuse Indirect": "DiffInd",
    "Diffuse Color": "DiffCol",
    "Glossy Direct": "GlossDir",
    "Glossy Indirect": "GlossInd",
    "Glossy Color": "GlossCol",
    "Transmission Direct": "TransDir",
    "Transmission Indirect": "TransInd",
    "Transmission Color": "TransCol",
    "Volume Direct": "VolumeDir",
    "Volume Indirect": "VolumeInd",
    "Emission": "Emit",
    "Environment": "Env",
}
LAYER = "ViewLayer"  # of files written here


class MissingPassError(Exception):
    """A file lacks a pass that its use asks for."""


@dataclass(frozen=True)
class ExrRender:
    """One file's passes: pixels [C,H,W] float32 in the order of CHANNELS, absent ones 0."""

    pixels: np.ndarray
    present: frozenset[str]  # passes that the file has
    channels: dict[str, np.ndarray]  # all that the layer holds, "Pass.C" by 4.x's short names
    spp: int | None  # samples per pixel, where the file says


def read_exr(path: Path) -> ExrRender:
    """Read the first view layer of a multilayer EXR, of several views the first. Where Blender has denoised, Combined
    is taken from Noisy Image."""
    layers: dict[str, dict[str, np.ndarray]] = {}
    spp: dict[str, int] = {}
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for part in file.parts:
                for key, value in part.header.items():
                    if key.startswith("cycles.") and key.endswith(".samples"):
                        spp[key.removeprefix("cycles.").removesuffix(".samples")] = int(value)
                views = list(part.header.get("multiView", []))
                for name, channel in part.channels.items():
                    # Layer names may hold dots: channel and pass are what stands last.
                    stem, _, component = name.rpartition(".")
                    view = stem.rpartition(".")[2]
                    if view in views[1:]:
                        continue
                    stem = stem.removesuffix(f".{view}") if view in views else stem
                    layer, pass_name = (["", *stem.rsplit(".", 1)] if stem else ["", "Combined"])[-2:]
                    found = layers.setdefault(layer, {})
                    found[f"{SHORT_NAMES.get(pass_name, pass_name)}.{component}"] = channel.pixels
    except (RuntimeError, ValueError) as error:
        raise MissingPassError(f"{path}: {error}") from error
    rendered = [layer for layer, found in layers.items() if "Combined.R" in found]
    if not rendered:
        raise MissingPassError(f"{path}: no Combined; it holds the layers {', '.join(sorted(layers)) or 'none'}")
    # Composite is what the compositor made of the view layers.
    layer = min(rendered, key=lambda name: name == "Composite")
    found = layers[layer]
    for c in "RGBA":
        if f"Noisy Image.{c}" in found:
            found[f"Combined.{c}"] = found[f"Noisy Image.{c}"]
    present = {name for name, parts in PASSES.items() if all(f"{name}.{c}" in found for c in parts)} | {"Combined"}
    height, width = found["Combined.R"].shape
    out = np.zeros((len(CHANNELS), height, width), np.float32)
    out[CHANNELS.index("Combined.A")] = 1
    for index, name in enumerate(CHANNELS):
        if name in found:
            out[index] = found[name]
    for name in ("Depth.Z", "Denoising Depth.Z"):
        plane = out[CHANNELS.index(name)]
        plane[plane > BACKGROUND_DEPTH] = 0.0
    return ExrRender(out, frozenset(present), found, spp.get(layer, next(iter(spp.values()), None)))


def write_exr(path: Path, pixels: np.ndarray, spp: int | None, passes: frozenset[str] | None = None) -> None:
    """Write passes of a stored render as one part of 32-bit floats, as Cycles would name them; None: all."""
    channels = {}
    for name, components in PASSES.items():
        if passes is None or name in passes:
            planes = pixels[pass_slice(name)].astype(np.float32)
            channels |= {
                f"{LAYER}.{name}.{c}": np.ascontiguousarray(p) for c, p in zip(components, planes, strict=True)
            }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if spp:
        header[f"cycles.{LAYER}.samples"] = str(spp)
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
