# SPDX-License-Identifier: Apache-2.0
"""Noisy frames with their two references, from the validation set or from EXR files in folders like samples/."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from training.data.store import BACKGROUND_DEPTH, PASSES, FrameRecord, list_frames, pass_slice, read_render

#: Layers of a frame that denoising may change, light groups (Combined_NAME) aside.
FILTERED = tuple(name for name in PASSES if name not in ("Normal", "Position", "Depth") and "Denoising" not in name)
GUIDES = ("Denoising Albedo", "Denoising Normal", "Denoising Depth")
LIGHT = ("Diff", "Gloss", "Trans")
EXTRA = "extra"

Layers = dict[str, np.ndarray]


@dataclass(frozen=True)
class Pair:
    """One noisy frame, layers [h,w,c] float32 by Cycles' short pass names, and two independent references of it."""

    name: str
    family: str
    spp: int
    layers: Layers
    reference_a: Layers
    reference_b: Layers

    def scored(self) -> list[str]:
        """Return the layers that both references have and that are not black everywhere, Combined first."""
        names = [n for n in self.layers if n not in GUIDES and n in self.reference_a and n in self.reference_b]
        lit = [n for n in names if self.layers[n][..., :3].any() and self.reference_a[n][..., :3].any()]
        return sorted(lit, key=lambda n: (n != "Combined", n))


def split_layers(render: np.ndarray, names: Sequence[str]) -> Layers:
    """Return passes of a stored render [C,h,w] as [h,w,c] float32; what is not finite reads as zero."""
    layers = {}
    for name in names:
        planes = np.nan_to_num(render[pass_slice(name)].astype(np.float32), posinf=65504.0, neginf=0.0)
        layers[name] = np.ascontiguousarray(planes.transpose(1, 2, 0))
    return layers


def stack_passes(layers: Layers) -> np.ndarray:
    """Return layers as a stored render [C,h,w]; passes that are not there are zero."""
    height, width = layers["Combined"].shape[:2]
    planes = []
    for name, components in PASSES.items():
        if name in layers:
            planes.append(layers[name].transpose(2, 0, 1))
        else:
            planes.append(np.zeros((len(components), height, width), np.float32))
    return np.concatenate(planes)


def frame_layers(record: FrameRecord, key: str) -> Layers:
    """Read one render of a frame, with the passes that its scene alone has."""
    layers = split_layers(read_render(record.renders[key]), (*FILTERED, *GUIDES))
    depth = layers["Denoising Depth"]
    layers["Denoising Depth"] = np.where(depth > 0, depth, np.float32(10 * BACKGROUND_DEPTH))
    extra = record.folder / EXTRA / f"{key}.qfr"
    if extra.is_file():
        planes = read_render(extra).astype(np.float32)
        for index, name in enumerate(record.meta["extra"]):
            layers[name] = np.ascontiguousarray(planes[3 * index : 3 * index + 3].transpose(1, 2, 0))
    return layers


def stored_pairs(root: Path, split: str, wanted_spp: Sequence[int]) -> Iterator[Pair]:
    """Yield the frames of a data set that have two references, at each sample count they have."""
    for record in list_frames(root, split):
        if not {"ref_a", "ref_b"} <= set(record.renders):
            continue
        references = [frame_layers(record, key) for key in ("ref_a", "ref_b")]
        for spp in wanted_spp:
            if f"{spp}_0" in record.renders:
                layers = frame_layers(record, f"{spp}_0")
                yield Pair(f"{record.family}/{record.name}", record.family, spp, layers, *references)


_LONG_NAMES = {
    f"{group} {part}": short + tail
    for group, short in (("Diffuse", "Diff"), ("Glossy", "Gloss"), ("Transmission", "Trans"), ("Volume", "Volume"))
    for part, tail in (("Direct", "Dir"), ("Indirect", "Ind"), ("Color", "Col"))
} | {"Emission": "Emit", "Environment": "Env"}


def read_exr_layers(path: Path) -> Layers:
    """Read the layers of a multilayer EXR of any Blender version that evaluation uses."""
    import OpenEXR

    planes: dict[str, dict[str, np.ndarray]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                *_, layer, letter = ["", *name.split(".")]
                planes.setdefault(_LONG_NAMES.get(layer, layer), {})[letter] = np.asarray(channel.pixels, np.float32)
    known = {*FILTERED, *GUIDES, "Shadow Catcher"}
    layers = {}
    for name, channels in planes.items():
        letters = next((w for w in ("RGBA", "RGB", "XYZ", "Z") if set(w) <= set(channels)), "")
        if letters and (name in known or name.startswith("Combined_")):
            layers[name] = np.nan_to_num(np.stack([channels[c] for c in letters], axis=-1), posinf=65504.0, neginf=0.0)
    return layers


def exr_pairs(folder: Path, wanted_spp: Sequence[int]) -> Iterator[Pair]:
    """Yield NAME/NAME_<spp>spp.exr with NAME_ref_a.exr and NAME_ref_b.exr beside it."""
    for path in sorted(folder.glob("*/*spp.exr")):
        match = re.fullmatch(r"(.+)_(\d+)spp", path.stem)
        references = [path.with_name(f"{match[1]}_ref_{k}.exr") for k in "ab"] if match else []
        if match and int(match[2]) in wanted_spp and all(r.is_file() for r in references):
            layers = read_exr_layers(path)
            yield Pair(match[1], match[1], int(match[2]), layers, *map(read_exr_layers, references))


def recombine(layers: Layers, with_environment: bool) -> np.ndarray:
    """Return the sum of the light passes [h,w,3]: (direct + indirect) * colour, volume, emission, environment."""
    total = sum((layers[f"{p}Dir"] + layers[f"{p}Ind"]) * layers[f"{p}Col"] for p in LIGHT)
    total = total + layers["Emit"] + layers.get("VolumeDir", 0) + layers.get("VolumeInd", 0)
    return total + layers["Env"] if with_environment else total


def closure(layers: Layers) -> tuple[bool, float]:
    """Return whether Environment is part of Combined, and how far the passes' sum is from it, relative to its mean."""
    if not {"Emit", "Env", *(f"{p}{t}" for p in LIGHT for t in ("Dir", "Ind", "Col"))} <= set(layers):
        return False, float("inf")
    combined = layers["Combined"][..., :3]
    errors = {env: float(np.abs(recombine(layers, env) - combined).mean()) for env in (True, False)}
    best = errors[True] <= errors[False]
    return best, errors[best] / max(float(combined.mean()), 1e-6)
