# SPDX-License-Identifier: Apache-2.0
"""Renders frames of a .blend with several seeds each, as training data: for `training.finetune`.

    PYTHON -m training.render_blend scene.blend --data FOLDER --frames 1,40 --spp 16 --seeds 5

Everything in the file stays as its author set it, but for the passes, which are all asked for, adaptive sampling and
denoising, which are off, and the sample count and seed. A render that is there already is not made again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
from pathlib import Path

import bpy

from training import cycles
from training.data.store import CHANNELS, PASSES, write_atomic, write_render


def render_frame(scene: bpy.types.Scene, folder: Path, meta: dict, spp: int, seeds: int) -> None:
    """All renders of the current frame."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(seeds):
        path = folder / f"{spp}_{i}.qfr"
        if path.exists():
            continue
        seed = int.from_bytes(hashlib.sha256(f"{folder.name}/{i}".encode()).digest()[:4], "little") & 0x7FFFFFFF
        pixels = cycles.render(scene, spp, seed).pixels
        write_atomic(folder / "meta.json", json.dumps(meta, indent=1).encode())
        write_render(path, pixels, spp)
        print(f"{path}: {spp} samples, seed {seed}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("blend", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--family", default="own")
    parser.add_argument("--frames", default="1")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--percent", type=int, default=100)
    parser.add_argument("--threads", type=int, default=0)
    args = parser.parse_args()
    if not args.blend.exists():
        raise SystemExit(f"{args.blend} does not exist")
    bpy.ops.wm.open_mainfile(filepath=str(args.blend.resolve()))
    scene = bpy.context.scene
    if scene.camera is None:
        raise SystemExit(f"{args.blend}: the scene has no camera")
    size = tuple(v * args.percent // 100 for v in (scene.render.resolution_x, scene.render.resolution_y))
    cycles.configure(scene)
    cycles.set_view(scene, size, None)
    scene.render.threads = args.threads or os.cpu_count() or 1
    for number in map(int, args.frames.split(",")):
        scene.frame_set(number)
        meta = {
            "family": args.family,
            "source": f"{args.blend.name}, frame {number}",
            "fingerprint": f"{args.blend.name}/{number}/{size}",
            "passes": sorted(PASSES),
            "channels": CHANNELS,
            "blender": bpy.app.version_string,
        }
        folder = args.data / "train" / args.family / f"{args.blend.stem}{number:05d}_0".replace("-", "_")
        render_frame(scene, folder, meta, args.spp, args.seeds)


if __name__ == "__main__":
    main()
