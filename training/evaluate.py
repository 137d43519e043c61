# SPDX-License-Identifier: Apache-2.0
"""Error of models beside the noisy input and Open Image Denoise, per layer, on frames that have two references.

    python -m training.evaluate --model weights/quell-balanced.qwt --out evaluation [--spp 4,16,64]
    python -m training.evaluate --run balanced-1 --no-peer --out evaluation       a training run, in PyTorch
    python -m training.evaluate --model "" --samples samples --out evaluation     the built-in model on EXR files

Frames are the validation set's, or with --samples those of a folder like samples/. Written are scores.csv (every frame,
method and layer), summary.csv (geometric means and worst frames), error-time.png, and worst-<spp>spp.png with crops.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from training import libquell, measure, peer, report
from training.pairs import GUIDES, LIGHT, Layers, Pair, closure, exr_pairs, recombine, stack_passes, stored_pairs
from training.paths import data_root

#: Passes that the sum of passes misses by more than this, relative to Combined, are not recombined (half floats: 1e-3).
CLOSURE_TOLERANCE = 5e-3

Method = Callable[[Pair], tuple[Layers, float]]


def noisy(pair: Pair) -> tuple[Layers, float]:
    """The input itself."""
    return pair.layers, 0.0


LIGHT_PASSES = (*(f"{p}{part}" for p in (*LIGHT, "Volume") for part in ("Dir", "Ind", "Col")), "Emit", "Env")

#: What --leave-out takes away, one at a time.
LEFT_OUT = {
    "normal": ("Denoising Normal",),
    "albedo": ("Denoising Albedo",),
    "depth": ("Denoising Depth",),
    "guides": GUIDES,
    "volume passes": ("VolumeDir", "VolumeInd"),
    "emission and environment": ("Emit", "Env"),
    "light passes": LIGHT_PASSES,
    "light passes and albedo": (*LIGHT_PASSES, "Denoising Albedo"),
    "light passes and guides": (*LIGHT_PASSES, *GUIDES),
}


def library_method(model: str, beauty: bool, threads: int, left_out: Sequence[str] = ()) -> Method:
    """A weight file in libquell, with every layer of the frame, or Combined and its guides alone, but for some."""

    def run(pair: Pair) -> tuple[Layers, float]:
        chosen = {n: x for n, x in pair.layers.items() if not beauty or n == "Combined" or n in GUIDES}
        kept = {n: x for n, x in chosen.items() if n not in left_out}
        return libquell.denoise(model, kept, pair.spp, threads)

    return run


def run_method(run: str, light: bool) -> Method:
    """A training run in PyTorch, its weights rounded as they are exported; Combined alone comes back."""
    import torch

    from training.data.crops import to_guides, to_layers
    from training.data.pack import select_passes
    from training.export import load_run, round_to_half
    from training.infer import denoise_frame

    model = round_to_half(load_run(run)[0])

    def denoise(pair: Pair) -> tuple[Layers, float]:
        with_environment, error = closure(pair.layers)
        inputs = torch.from_numpy(select_passes(stack_passes(pair.layers), with_environment))[None]
        has_light = light and np.isfinite(error)
        start = time.process_time()
        result = denoise_frame(model, to_layers(inputs, has_light), to_guides(inputs), pair.spp)
        seconds = time.process_time() - start
        image = result.combined if has_light and error < CLOSURE_TOLERANCE else result.direct
        return {"Combined": image[0].numpy().transpose(1, 2, 0)}, seconds

    return denoise


def peer_method(setting: str, threads: int) -> Method:
    """Open Image Denoise on Combined."""

    def denoise(pair: Pair) -> tuple[Layers, float]:
        images = [pair.layers[name][..., :3] for name in ("Combined", "Denoising Albedo", "Denoising Normal")]
        start = time.process_time()
        out = peer.denoise(*images, setting, threads)
        return {"Combined": out}, time.process_time() - start

    return denoise


def peer_passes_method(setting: str, threads: int) -> Method:
    """Open Image Denoise on every light pass and colour by itself; Combined is their sum where the passes close."""

    def denoise(pair: Pair) -> tuple[Layers, float]:
        layers, (with_environment, error) = pair.layers, closure(pair.layers)
        colors = {n: layers[n] for n in (f"{p}Col" for p in LIGHT) if n in layers}
        skip = {"Combined", *colors, *GUIDES}
        lights = {n: x[..., :3] for n, x in layers.items() if n not in skip}
        start = time.process_time()
        out = peer.denoise_passes(
            lights, colors, layers["Denoising Albedo"], layers["Denoising Normal"], setting, threads
        )
        if error < CLOSURE_TOLERANCE:
            out["Combined"] = recombine(out, with_environment)
        return out, time.process_time() - start

    return denoise


def choose_methods(args: argparse.Namespace) -> dict[str, Method]:
    """Return what is to be compared, by the name that tables give it."""
    methods: dict[str, Method] = {"noisy": noisy}
    for model in args.model:
        name = Path(model).stem or "built-in"
        methods[name] = library_method(model, False, args.threads)
        methods[f"{name}, Combined alone"] = library_method(model, True, args.threads)
        if args.leave_out:
            for what, names in LEFT_OUT.items():
                methods[f"{name} without {what}"] = library_method(model, False, args.threads, names)
    for run in args.run:
        methods[f"run {run}"] = run_method(run, True)
        methods[f"run {run}, Combined alone"] = run_method(run, False)
    if not args.no_peer:
        for setting in peer.SETTINGS:
            methods[f"OIDN {setting}"] = peer_method(setting, args.threads)
        methods["OIDN high/accurate per pass"] = peer_passes_method("high/accurate", args.threads)
    return methods


def evaluate(pairs: Iterable[Pair], methods: dict[str, Method]) -> Iterator[tuple[report.Row, np.ndarray]]:
    """Yield a row and the image [h,w,3] for every frame, method and layer that both references have."""
    for pair in pairs:
        for method, denoise in methods.items():
            out, seconds = denoise(pair)
            pixels = pair.layers["Combined"].shape[0] * pair.layers["Combined"].shape[1]
            for layer in pair.scored():
                if layer in out:
                    images = [x[layer][..., :3] for x in (out, pair.reference_a, pair.reference_b)]
                    scores = measure.score(*images)
                    yield report.Row(pair.name, pair.spp, method, layer, scores, seconds * 1e6 / pixels), images[0]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", action="append", default=[], help="weight file, or a built-in name; repeatable")
    parser.add_argument("--run", action="append", default=[], help="training run, in PyTorch; repeatable")
    parser.add_argument("--spp", default="4,16,64", help="sample counts of the noisy input")
    parser.add_argument("--samples", type=Path, help="folder of EXR files instead of the validation set")
    parser.add_argument("--data", type=Path, help="data set folder")
    parser.add_argument("--leave-out", action="store_true", help="what each guide and the light passes are worth")
    parser.add_argument("--no-peer", action="store_true", help="leave Open Image Denoise out")
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    parser.add_argument("--worst", type=int, default=6, help="frames shown as pictures, per sample count")
    parser.add_argument("--out", type=Path, default=Path("evaluation"))
    args = parser.parse_args(argv)
    spp = [int(text) for text in args.spp.split(",")]
    pairs = list(exr_pairs(args.samples, spp) if args.samples else stored_pairs(args.data or data_root(), "val", spp))
    if not pairs:
        raise SystemExit("no frames with two references at these sample counts")
    methods = choose_methods(args)
    gallery = report.Gallery(pairs, subject=next((n for n in methods if n != "noisy"), "noisy"))
    rows = []
    for row, image in evaluate(pairs, methods):
        rows.append(row)
        gallery.keep(row, image)
    args.out.mkdir(parents=True, exist_ok=True)
    report.write_rows(args.out / "scores.csv", rows)
    summary = report.summarise(rows)
    report.write_summary(args.out / "summary.csv", summary)
    print(report.table(summary))
    report.plot_error_against_time(args.out / "error-time.png", summary)
    for count in spp:
        gallery.write_worst(args.out / f"worst-{count}spp.png", count, args.worst)
    print(f"written to {args.out}: scores.csv, summary.csv, error-time.png, worst-*.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
