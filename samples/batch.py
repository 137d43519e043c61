#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Denoises frames of an animation, as a farm's task does. Needs the Python package quell, and no Blender.

    batch.py 'render/shot_####.exr' 'clean/shot_####.exr' --frames 1-24,30

A run of # stands for the frame's number, padded with zeros. Frames whose result is there, and newer than its input,
are left alone, so the same command goes on where a broken one stopped; a result appears whole or not at all. Exit
code: 0 all frames are done, 1 some failed, 2 wrong use.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

import quell


def frame_numbers(text: str) -> list[int]:
    """ "1-3,7" -> [1, 2, 3, 7]"""
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(-?\d+)(?:-(-?\d+))?\s*", part)
        if not match:
            raise argparse.ArgumentTypeError(f"'{part}' is neither a frame nor a range such as 1-24")
        first = int(match[1])
        numbers += range(first, int(match[2] or first) + 1)
    return numbers


def file_of(pattern: str, frame: int) -> Path:
    return Path(re.sub(r"#+", lambda run: f"{frame:0{len(run[0])}d}", pattern))


def is_finished(source: Path, output: Path) -> bool:
    return output.exists() and source.exists() and output.stat().st_mtime_ns >= source.stat().st_mtime_ns


def denoise(
    context: quell.Context, model: quell.Model, source: Path, output: Path, options: argparse.Namespace
) -> None:
    output.parent.mkdir(parents=True, exist_ok=True)
    with context.read_exr(source) as frame:
        context.denoise(frame, model, layers=options.layers, keep_noisy=options.keep_noisy)
        frame.write_exr(output)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", help="rendered files, with # for the frame's number")
    parser.add_argument("output", help="results, with # for the frame's number")
    parser.add_argument("--frames", type=frame_numbers, required=True, help="such as 1-24,30")
    parser.add_argument("--quality", default="", help=f"{', '.join(quell.native.QUALITY)} (default: balanced)")
    parser.add_argument("--model", default="", help="instead of a level: a built-in model or a weight file")
    parser.add_argument("--layers", help="all (the default), beauty, or names, comma-separated")
    parser.add_argument("--keep-noisy", action="store_true", help="keep the noisy Combined as 'Noisy Image'")
    parser.add_argument("--threads", type=int, default=0, help="default: one per core")
    parser.add_argument(
        "--openjd", action="store_true", help="report progress as Open Job Description's workers read it"
    )
    options = parser.parse_args()
    for pattern in (options.source, options.output):
        if "#" not in pattern and len(options.frames) > 1:
            parser.error(f"'{pattern}' has no # for the frame's number")

    context = quell.Context(threads=options.threads)
    try:
        model = context.open_model(options.model, options.quality)
    except quell.QuellError as error:
        parser.error(str(error))
    failed = 0
    with context, model:
        for index, number in enumerate(options.frames):
            source, output = file_of(options.source, number), file_of(options.output, number)
            start = time.perf_counter()
            try:
                if is_finished(source, output):
                    print(f"frame {number}: finished before", flush=True)
                else:
                    denoise(context, model, source, output, options)
                    print(f"frame {number}: {output}, {time.perf_counter() - start:.2f} s", flush=True)
            except (quell.QuellError, OSError) as error:
                failed += 1
                print(f"frame {number}: {error}", file=sys.stderr, flush=True)
            if options.openjd:
                print(f"openjd_progress: {100 * (index + 1) / len(options.frames):.0f}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
