# SPDX-License-Identifier: Apache-2.0
"""Stored renders to what training reads: memory-mapped arrays per frame, so that a random crop costs no decoding.

    inputs.npy  [renders, 47, h, w] float16: each render of up to MAX_INPUT_SPP samples (or the one with
                                            fewest), in INPUT's channel order
    sums.npy    [39, h, w] float32: sum over all renders of spp * value, in TARGET's channel order
    clean.npy   [39, h, w] float16: about what the frame converges to (training/data/clean.py); may be missing
    pack.json   spp of each input, total spp, whether the passes sum to Combined

Light passes are ratios of pixel means, so averages are taken of light x colour, which is linear in the samples. A
target independent of input i is then (sums - spp_i * input_i) / (total - spp_i).
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from training.data.store import BACKGROUND_DEPTH, CorruptRenderError, FrameRecord, list_frames, pass_slice, read_render
from training.paths import data_root

MAX_INPUT_SPP = 32
CLOSURE_TOLERANCE = 5e-3  # half floats of 20 summed passes round to about 1e-3

INPUT = {
    "beauty": slice(0, 3),
    "alpha": slice(3, 4),
    "light": slice(4, 28),  # diffuse, glossy, transmission, volume; direct, indirect; rgb
    "color": slice(28, 37),
    "emission": slice(37, 40),
    "albedo": slice(40, 43),
    "normal": slice(43, 46),
    "depth": slice(46, 47),
}
NUM_INPUT = 47
TARGET = {
    "beauty": slice(0, 3),
    "product": slice(3, 27),  # light x colour of diffuse, glossy, transmission; volume; in light's order
    "color": slice(27, 36),
    "emission": slice(36, 39),
}
NUM_TARGET = 39
VERSION = 2  # of the packs; older ones are made again


@dataclass(frozen=True)
class PackedFrame:
    """One frame ready for crops; the arrays are memory-mapped and read-only."""

    name: str
    family: str
    inputs: np.ndarray
    sums: np.ndarray
    spp: list[int]
    total_spp: int
    closes: bool
    clean: np.ndarray | None = None

    def level(self, window: tuple[slice, ...]) -> np.ndarray:
        """TARGET's channels [39,n,n] of a window, as nearly without noise as they are known: what errors are relative
        to."""
        if self.clean is not None:
            return self.clean[window].astype(np.float32)
        return self.sums[window] / np.float32(self.total_spp)


def select_passes(render: np.ndarray, with_environment: bool) -> np.ndarray:
    """One stored render [C,h,w] to INPUT's channels, float32."""
    x = render.astype(np.float32)

    def get(name: str) -> np.ndarray:
        return x[pass_slice(name)]

    light = [get(f"{p}{part}") for p in ("Diff", "Gloss", "Trans", "Volume") for part in ("Dir", "Ind")]
    color = [get(f"{p}Col") for p in ("Diff", "Gloss", "Trans")]
    emission = get("Emit") + (get("Env") if with_environment else 0)
    depth = get("Denoising Depth")
    depth = np.where((depth > 0) & (depth < BACKGROUND_DEPTH), depth, 0)
    combined = get("Combined")
    parts = [combined, *light, *color, emission, get("Denoising Albedo"), get("Denoising Normal"), depth]
    return np.nan_to_num(np.concatenate(parts), nan=0.0, posinf=65504.0, neginf=0.0)


def spread_color(color: np.ndarray) -> np.ndarray:
    """Colours [9,h,w] to the 18 channels of the light that they were divided out of."""
    return color.reshape(3, 1, 3, *color.shape[1:]).repeat(2, 1).reshape(18, *color.shape[1:])


def to_target(inputs: np.ndarray) -> np.ndarray:
    """INPUT's channels [47,h,w] to TARGET's [39,h,w]: light times colour."""
    product = inputs[INPUT["light"]].copy()
    product[:18] *= spread_color(inputs[INPUT["color"]])
    return np.concatenate([inputs[INPUT["beauty"]], product, inputs[INPUT["color"]], inputs[INPUT["emission"]]])


def divide_color(product: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Light [24,h,w] of light times colour [24,h,w]; 0 where the colour [9,h,w] is black. Volume has none."""
    color = spread_color(color)
    light = product.copy()
    light[:18] = np.where(color > 1e-6, product[:18] / np.maximum(color, 1e-6), 0)
    return light


def sum_parts(target: np.ndarray) -> np.ndarray:
    """Combined [3,h,w] of TARGET's channels."""
    return target[TARGET["product"]].reshape(8, 3, *target.shape[1:]).sum(0) + target[TARGET["emission"]]


def closure_error(target: np.ndarray) -> float:
    """Mean difference of the passes' sum and Combined, relative to Combined's mean."""
    beauty = target[TARGET["beauty"]]
    return float(np.abs(sum_parts(target) - beauty).mean() / max(beauty.mean(), 1e-6))


def choose_environment(render: np.ndarray) -> tuple[bool, float]:
    """Whether the passes sum to Combined better with Environment than without, and by how much they then miss."""
    errors = {env: closure_error(to_target(select_passes(render, env))) for env in (True, False)}
    best = errors[True] <= errors[False]
    return best, errors[best]


def pack_frame(record: FrameRecord, folder: Path) -> None:
    """Writes one frame's pack; the folder appears whole or not at all."""
    renders = sorted(((int(key.split("_")[0]), path) for key, path in record.renders.items() if key[0].isdigit()))
    decoded = [(spp, read_render(path)) for spp, path in renders]
    if len(decoded) < 2:
        raise CorruptRenderError(f"{record.folder}: {len(decoded)} renders, but a target needs one besides the input")
    best = decoded[-1][1]
    with_environment, error = choose_environment(best)
    inputs, sums, total = [], np.zeros((NUM_TARGET, *best.shape[1:]), np.float32), 0
    for spp, render in decoded:
        half = select_passes(render, with_environment).clip(-65504, 65504).astype(np.float16)
        sums += spp * to_target(half.astype(np.float32))
        total += spp
        if spp <= max(MAX_INPUT_SPP, decoded[0][0]):
            inputs.append((spp, half))
    temporary = folder.with_suffix(".tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    np.save(temporary / "inputs.npy", np.stack([half for _, half in inputs]))
    np.save(temporary / "sums.npy", sums)
    info = {
        "family": record.family,
        "spp": [spp for spp, _ in inputs],
        "total_spp": total,
        "closes": error < CLOSURE_TOLERANCE,
        "closure_error": error,
        "renders": sorted(record.renders),
        "version": VERSION,
    }
    (temporary / "pack.json").write_text(json.dumps(info))
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


def pack_root(root: Path | None = None) -> Path:
    return (root or data_root()) / "packed"


@contextlib.contextmanager
def one_at_a_time(root: Path | None) -> Iterator[None]:
    """Several runs may share one data set: they pack and list it in turn."""
    folder = pack_root(root)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # given back when the file closes, by a kill too
        yield


def pack_new(split: str, min_renders: int, root: Path | None = None) -> int:
    """Packs every frame of a split that has min_renders renders and is not packed as it stands. Returns how many."""
    root = root or data_root()
    with one_at_a_time(root):
        return pack_missing(split, min_renders, root)


def pack_missing(split: str, min_renders: int, root: Path) -> int:
    done = 0
    for record in list_frames(root, split):
        if len(record.renders) < min_renders:
            continue
        folder = pack_root(root) / split / f"{record.family}-{record.name}"
        info = folder / "pack.json"
        if info.exists():
            known = json.loads(info.read_text())
            if known.get("version") == VERSION and known["renders"] == sorted(record.renders):
                continue
        try:
            pack_frame(record, folder)
            done += 1
        except CorruptRenderError as error:
            print(f"skipped: {error}", flush=True)
    return done


def load_packs(split: str, root: Path | None = None) -> list[PackedFrame]:
    """All packed frames of a split, in a fixed order."""
    with one_at_a_time(root):
        return open_packs(split, root)


def open_packs(split: str, root: Path | None) -> list[PackedFrame]:
    frames = []
    for info_path in sorted((pack_root(root) / split).glob("*/pack.json")):
        info = json.loads(info_path.read_text())
        if info.get("version") != VERSION:
            continue
        folder = info_path.parent
        frames.append(
            PackedFrame(
                folder.name,
                info["family"],
                np.load(folder / "inputs.npy", mmap_mode="r"),
                np.load(folder / "sums.npy", mmap_mode="r"),
                info["spp"],
                info["total_spp"],
                info["closes"],
                np.load(clean, mmap_mode="r") if (clean := folder / "clean.npy").exists() else None,
            )
        )
    return frames


def prefetch(make: Iterator, depth: int = 4) -> Iterator:
    """Runs an iterator in a thread of its own, a few items ahead."""
    with ThreadPoolExecutor(1) as executor:
        pending = [executor.submit(next, make) for _ in range(depth)]
        while True:
            yield pending.pop(0).result()
            pending.append(executor.submit(next, make))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--split", default="train")
    parser.add_argument("--min-renders", type=int, default=7)
    args = parser.parse_args()
    print(f"packed {pack_new(args.split, args.min_renders)} frames; {len(load_packs(args.split))} in all")


if __name__ == "__main__":
    main()
