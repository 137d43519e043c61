# SPDX-License-Identifier: Apache-2.0
"""Trains a released model a little further on one's own renders.

    python -m training.finetune --weights weights/quell-balanced.qwt --out mine.qwt \\
        --pair noisy.exr reference.exr             # any number of times
        --renders seed1.exr seed2.exr seed3.exr    # any number of times: one frame with several seeds
        --blend scene.blend --frames 1,40,80 --renderer PYTHON

Of --renders any one is the input and the others, averaged, the target, which may be noisy: the loss is unbiased to it.
They need seeds of their own; a seed that is used twice teaches the network to keep its noise. The frames become a data
set of their own below the run, and the training is that of `training.train`: killed, it goes on where it was.
What a scene gains on itself, other scenes may lose; the error before and after is printed for the frames given alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from training.data.crops import CropConfig, combine_inputs, to_guides, to_layers
from training.data.pack import INPUT, TARGET, PackedFrame, load_packs, pack_new, to_target
from training.data.store import CHANNELS, pass_slice, write_atomic, write_render
from training.device import choose_device
from training.export import export, load_run, load_weights
from training.exr import ExrRender, MissingPassError, read_exr
from training.infer import denoise_frame
from training.models.quell import Quell
from training.train import Pace, TrainConfig, run_folder, train

#: What a reference counts as beside its noisy frame: the target is the reference, whatever its own sample count.
REFERENCE_SPP = 4096
#: Assumed where a file does not say.
UNKNOWN_SPP = 16
LARGEST_CROP, SMALLEST_CROP = 128, 64
FAMILY = "own"
GUIDES = ("Denoising Albedo", "Denoising Normal", "Denoising Depth")


class FinetuneError(Exception):
    """Frames that cannot be trained on."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How far to go from the released weights."""

    steps: int = 400
    rate: float = 2e-4
    batch: int = 4
    seed: int = 1


def write_frame(root: Path, index: int, renders: Sequence[tuple[ExrRender, int]], source: str) -> None:
    """Stores renders of one frame as the training data is stored."""
    shapes = {render.pixels.shape for render, _ in renders}
    if len(shapes) > 1:
        sizes = ", ".join(sorted(f"{shape[2]}x{shape[1]}" for shape in shapes))
        raise FinetuneError(f"{source}: renders of one frame differ in size: {sizes}")
    height, width = renders[0][0].pixels.shape[1:]
    if min(height, width) < SMALLEST_CROP:
        raise FinetuneError(f"{source}: {width}x{height} pixels, {SMALLEST_CROP} in each direction is the least")
    present = frozenset.intersection(*(render.present for render, _ in renders))
    folder = root / "train" / FAMILY / f"{index:05d}_0"
    folder.mkdir(parents=True, exist_ok=True)
    meta = {"family": FAMILY, "source": source, "fingerprint": source, "passes": sorted(present), "channels": CHANNELS}
    count: dict[int, int] = {}
    for render, spp in renders:
        pixels = render.pixels.copy()
        for name in render.present - present:
            pixels[pass_slice(name)] = 0  # a pass that the others lack has no target
        write_render(folder / f"{spp}_{count.setdefault(spp, 0)}.qfr", pixels, spp)
        count[spp] += 1
    write_atomic(folder / "meta.json", json.dumps(meta, indent=1).encode())


def import_pair(root: Path, index: int, noisy: Path, reference: Path) -> None:
    """A noisy frame and what it should become."""
    given = read_exr(noisy)
    spp = given.spp or UNKNOWN_SPP
    wanted = read_exr(reference)
    write_frame(root, index, [(given, spp), (wanted, max(REFERENCE_SPP, wanted.spp or 0))], str(noisy))


def import_renders(root: Path, index: int, paths: Sequence[Path]) -> None:
    """Independent renders of one frame."""
    if len(paths) < 2:
        raise FinetuneError(f"{paths[0]}: one render alone has no target; give two or more with different seeds")
    renders = [read_exr(path) for path in paths]
    for i, render in enumerate(renders):
        for j in range(i):
            if np.array_equal(render.pixels, renders[j].pixels):
                raise FinetuneError(f"{paths[i]} and {paths[j]} are the same render: seeds must differ")
    write_frame(root, index, [(render, render.spp or UNKNOWN_SPP) for render in renders], str(paths[0]))


def render_blend(
    root: Path, blend: Path, renderer: Path, frames: str, spp: int, seeds: int, percent: int, threads: int
) -> None:
    """Renders frames of a .blend with several seeds each, in a process of its own; what is there already is kept."""
    command = [renderer, "-m", "training.render_blend", blend, "--data", root, "--family", FAMILY]
    command += ["--frames", frames, "--spp", spp, "--seeds", seeds, "--percent", percent, "--threads", threads]
    if subprocess.run(list(map(str, command)), stdout=sys.stderr, check=False).returncode != 0:
        raise FinetuneError(f"{blend}: rendering failed, see above")


def settle_crops(frames: list[PackedFrame], passes: list[frozenset[str]], settings: Settings) -> CropConfig:
    """Crops that fit the frames: their size, their sample counts, and without what they lack."""
    smallest = min(min(frame.sums.shape[1:]) for frame in frames)
    guided = all(set(GUIDES) <= present for present in passes)
    return CropConfig(
        crop=min(LARGEST_CROP, smallest // 16 * 16),
        batch=settings.batch,
        light_fraction=CropConfig.light_fraction if any(frame.closes for frame in frames) else 0.0,
        drop_guide=CropConfig.drop_guide if guided else 1.0,
        spp_weights=tuple((spp, 1.0) for spp in sorted({spp for frame in frames for spp in frame.spp})),
        seed=settings.seed,
    )


def frame_passes(root: Path) -> list[frozenset[str]]:
    """The passes of every frame of the data set."""
    metas = sorted((root / "train").glob("*/*/meta.json"))
    return [frozenset(json.loads(path.read_text())["passes"]) for path in metas]


def error(model: Quell | None, frames: list[PackedFrame], guided: bool) -> float:
    """Relative squared error of Combined on the frames' first inputs; None: of the inputs as they are."""
    total = 0.0
    for frame in frames:
        spp = frame.spp[0]
        x = combine_inputs([frame.inputs[0].astype(np.float32)])
        target = (frame.sums - spp * to_target(x))[TARGET["beauty"]] / (frame.total_spp - spp)
        image = x[INPUT["beauty"]]
        if model is not None:
            tensor = torch.from_numpy(x)[None]
            guides = to_guides(tensor)
            if not guided:
                guides = dataclasses.replace(guides, albedo=None, normal=None, depth=None)
            image = denoise_frame(model, to_layers(tensor, frame.closes), guides, spp).combined[0].numpy()
        total += float(((image - target) ** 2 / (target**2 + 0.01)).mean())
    return total / len(frames)


def finetune(run: str, weights: Path, out: Path, settings: Settings, device: torch.device, minutes: float) -> str:
    """Trains on the run's data set and writes the new weights; returns their SHA-256."""
    root = run_folder(run) / "data"
    pack_new("train", 2, root)
    frames = load_packs("train", root)
    if not frames:
        raise FinetuneError("no frames: give --pair, --renders or --blend")
    passes = frame_passes(root)
    crops = settle_crops(frames, passes, settings)
    guided = crops.drop_guide < 1
    before = load_weights(weights)
    config = TrainConfig(
        model=before.net.config,
        crops=crops,
        total_steps=settings.steps,
        rate=settings.rate,
        warmup_steps=min(20, settings.steps // 4),
        final_rate=0.1,
        ema=0.99,
        seed=settings.seed,
    )
    train(run, config, Pace(minutes=minutes, grow=False, min_renders=2), device, root, origin=before)
    after, step = load_run(run)
    for name, model in (("noisy", None), ("before", before), ("after", after)):
        print(f"{name:6s} {error(model, frames, guided):.5f} relative squared error of Combined, {len(frames)} frames")
    return export(after, out, out.stem, f"{weights.stem}, {step} steps further on {len(frames)} frames of its user")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, required=True, help="what to start from")
    parser.add_argument("--out", type=Path, required=True, help="the new weight file")
    parser.add_argument("--run", help="name of the run; default: finetune-OUT")
    parser.add_argument("--pair", type=Path, nargs=2, action="append", default=[], metavar=("NOISY", "REFERENCE"))
    parser.add_argument("--renders", type=Path, nargs="+", action="append", default=[], metavar="EXR")
    parser.add_argument("--blend", type=Path)
    parser.add_argument("--frames", default="1", help="of the .blend: numbers, comma-separated")
    parser.add_argument("--spp", type=int, default=16, help="samples of each render of the .blend")
    parser.add_argument("--seeds", type=int, default=5, help="renders of each frame of the .blend")
    parser.add_argument("--percent", type=int, default=100, help="of the .blend's resolution")
    parser.add_argument("--threads", type=int, default=0, help="for rendering; 0: one for each core")
    parser.add_argument("--renderer", type=Path, default=Path(sys.executable), help="a Python that has bpy")
    parser.add_argument("--steps", type=int, default=Settings.steps)
    parser.add_argument("--rate", type=float, default=Settings.rate)
    parser.add_argument("--batch", type=int, default=Settings.batch, help="crops of a step")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after this long at the latest")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: cuda where there is one")
    args = parser.parse_args(argv)
    run = args.run or f"finetune-{args.out.stem}"
    root = run_folder(run) / "data"
    try:
        index = 0
        for index, (noisy, reference) in enumerate(args.pair):
            import_pair(root, index, noisy, reference)
        for index, paths in enumerate(args.renders, len(args.pair)):
            import_renders(root, index, paths)
        if args.blend:
            render_blend(root, args.blend, args.renderer, args.frames, args.spp, args.seeds, args.percent, args.threads)
        settings = Settings(args.steps, args.rate, args.batch)
        sha = finetune(run, args.weights, args.out, settings, choose_device(args.device), args.minutes)
    except (FinetuneError, MissingPassError) as problem:
        print(problem, file=sys.stderr)
        return 1
    print(f"{args.out}: {args.out.stat().st_size} bytes, sha256 {sha}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
