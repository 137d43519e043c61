# SPDX-License-Identifier: Apache-2.0
"""The pictures that benchmarks work on: the samples, a sample repeated to any size, and made-up EXR files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

LIGHT = ["DiffDir", "DiffInd", "DiffCol", "GlossDir", "GlossInd", "GlossCol", "TransDir", "TransInd", "TransCol"]
#: Names of Blender 5 for those of Blender 4.
SHORT_NAMES = {
    f"{long} {kind_long}": f"{short}{kind}"
    for long, short in (("Diffuse", "Diff"), ("Glossy", "Gloss"), ("Transmission", "Trans"))
    for kind_long, kind in (("Direct", "Dir"), ("Indirect", "Ind"), ("Color", "Col"))
} | {"Volume Direct": "VolumeDir", "Volume Indirect": "VolumeInd", "Emission": "Emit", "Environment": "Env"}
WANTED = {
    "Combined",
    *LIGHT,
    *SHORT_NAMES.values(),
    "Denoising Albedo",
    "Denoising Normal",
    "Denoising Depth",
    "Noisy Image",
}
LETTERS = ("R", "G", "B", "X", "Y", "Z", "A")


def read_passes(path: Path) -> dict[str, np.ndarray]:
    """Float32 [height][width][channels] of the passes in WANTED, by Blender 4's names; of the first view layer."""
    import OpenEXR

    channels: dict[str, dict[str, np.ndarray]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for full, channel in part.channels.items():
                layer, _, letter = full.rpartition(".")
                name = layer.rpartition(".")[2]
                name = SHORT_NAMES.get(name, name)
                if name in WANTED:
                    channels.setdefault(name, {}).setdefault(letter, np.asarray(channel.pixels, np.float32))
    return {
        name: np.ascontiguousarray(np.stack([found[c] for c in LETTERS if c in found], axis=-1))
        for name, found in channels.items()
    }


def render_seconds(path: Path) -> float:
    """Seconds that Cycles took for the samples of this file, as its header says; nan where it does not."""
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        for name, value in file.header().items():
            if re.fullmatch(r"cycles\..*\.render_time", name):
                minutes, seconds = value.rpartition(":")[::2]
                return 60 * float(minutes.rpartition(":")[2] or 0) + float(seconds)
    return float("nan")


@dataclass(frozen=True)
class Sample:
    """A noisy render and the two references of its scene."""

    path: Path
    scene: str
    spp: int

    @property
    def references(self) -> tuple[Path, Path]:
        return tuple(self.path.parent / f"{self.scene}_ref_{k}.exr" for k in "ab")


def list_samples(folder: Path) -> list[Sample]:
    """By scene, then samples per pixel."""
    found = []
    for path in folder.glob("*/*_*spp.exr"):
        scene, spp = re.fullmatch(r"(.*)_(\d+)spp", path.stem).groups()
        found.append(Sample(path, scene, int(spp)))
    return sorted(found, key=lambda s: (s.scene, s.spp))


def repeat_to(passes: dict[str, np.ndarray], width: int, height: int) -> dict[str, np.ndarray]:
    """The picture beside and below its mirror images until it fills width x height: a real render's noise and passes at
    any size."""

    def fill(image: np.ndarray) -> np.ndarray:
        h, w = image.shape[:2]
        return np.ascontiguousarray(np.pad(image, ((0, height - h), (0, width - w), (0, 0)), "symmetric"))

    cropped = {name: image[:height, :width] for name, image in passes.items()}
    return {name: fill(image) for name, image in cropped.items()}


def write_exr(path: Path, width: int, height: int, passes: list[str]) -> None:
    """Smooth surfaces under the noise of a few samples, so that codecs have as much to do as with a render: half floats
    in ZIP, as Blender's default. Combined is the sum of what its passes make."""
    import OpenEXR

    rng = np.random.default_rng(width + len(passes))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    surface = 0.4 + 0.3 * np.sin(x / 97) * np.cos(y / 61) + 0.2 * ((x // 64 + y // 64) % 2)

    def noisy(scale: float) -> np.ndarray:
        return (scale * surface * rng.gamma(4.0, 0.25, surface.shape)).astype(np.float32)

    layers: dict[str, dict[str, np.ndarray]] = {}
    for name in passes:
        layers[name] = {c: surface if name.endswith("Col") else noisy(0.3) for c in "RGB"}
    combined = {c: np.zeros_like(surface) for c in "RGB"}
    for group in ("Diff", "Gloss", "Trans"):
        if f"{group}Col" in layers:
            for c in "RGB":
                light = layers[f"{group}Dir"][c] + layers[f"{group}Ind"][c]
                combined[c] += light * layers[f"{group}Col"][c]
    if not passes:
        combined = {c: noisy(0.5) for c in "RGB"}
    layers["Combined"] = combined | {"A": np.ones_like(surface)}
    layers["Denoising Albedo"] = {c: surface for c in "RGB"}
    layers["Denoising Normal"] = {"X": 0 * surface, "Y": 0 * surface, "Z": 0 * surface + 1}
    channels = {
        f"ViewLayer.{name}.{c}": np.ascontiguousarray(pixels.astype(np.float16))
        for name, letters in layers.items()
        for c, pixels in letters.items()
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def write_passes(path: Path, passes: dict[str, np.ndarray], samples: int) -> None:
    """A single-part multilayer file as Cycles writes it, without compression: what a program spends on it is its
    own."""
    import OpenEXR

    channels = {}
    for name, pixels in passes.items():
        letters = "Z" if pixels.shape[2] == 1 else "XYZ" if name == "Denoising Normal" else "RGBA"
        for index in range(pixels.shape[2]):
            channels[f"ViewLayer.{name}.{letters[index]}"] = np.ascontiguousarray(pixels[..., index].astype(np.float16))
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header | {"cycles.ViewLayer.samples": str(samples)}, channels) as file:
        file.write(str(path))
