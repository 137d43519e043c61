# SPDX-License-Identifier: Apache-2.0
"""The whole chain on two tiny scenes: render, shards, pack, a few steps, export, and the C library against PyTorch.

    make train-smoke
    python -m training.smoke --renderer PYTHON --quell build/release/bin/quell --out build/smoke

--renderer is a Python that has bpy; it may be another one than that which has PyTorch. The weights are worthless.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from training import parity, shards
from training.data.crops import CropConfig
from training.data.store import list_frames, read_render, render_spp
from training.export import export, load_run
from training.exr import write_exr
from training.train import Pace, TrainConfig, train

#: Families that need no third-party models.
FAMILIES = "abstract,fine_geometry"
SPP = "1,1,2,4,8"
SIZE = 64
STEPS = 6
RUN = "smoke"


@contextmanager
def stage(name: str) -> Iterator[None]:
    start = time.monotonic()
    yield
    print(f"smoke: {name}: {time.monotonic() - start:.1f} s", flush=True)


def render(renderer: Path, root: Path) -> None:
    """Two scenes of one camera each; a view that is thrown away is made up for by the next seed."""
    command = [renderer, "-m", "training.render", "--families", FAMILIES, "--seeds", "0:2", "--procs", "2"]
    command += ["--spp", SPP, "--size", str(SIZE), "--cameras", "1", "--data", root]
    subprocess.run(list(map(str, command)), check=True, stdout=sys.stderr)


def smoke(renderer: Path, quell: Path, out: Path) -> dict[str, float]:
    """Runs the chain in a folder of its own; returns the parity of each pass. Raises when a link breaks."""
    out.mkdir(parents=True, exist_ok=True)
    rendered, data = out / "rendered", out / "data"
    os.environ["QUELL_CACHE"] = str(out)
    with stage("render"):
        render(renderer, rendered)
    with stage("shards"):
        shards.pack(rendered, "train", out / "shards")
        outcome = shards.read_all(shards.shards_in([out / "shards"]), data)
        if outcome.faults:
            raise RuntimeError(outcome.faults[0])
    frames = [f for f in list_frames(data, "train") if len(f.renders) == len(SPP.split(","))]
    if len(frames) < 2:
        raise RuntimeError(f"{len(frames)} frames rendered, expected 2 or more")
    with stage(f"{STEPS} steps on {len(frames)} frames"):
        config = TrainConfig(crops=CropConfig(crop=SIZE, batch=2), total_steps=STEPS, warmup_steps=2)
        train(RUN, config, Pace(min_renders=len(SPP.split(","))), torch.device("cpu"), data)
    weights = out / "smoke.qwt"
    with stage("export"):
        model, steps = load_run(RUN)
        export(model, weights, "smoke", f"{steps} steps of a test of the training chain")
    with stage("C against PyTorch"):
        name, path = next((n, p) for n, p in frames[0].renders.items() if render_spp(n) == 4)
        exr = out / "frame.exr"
        write_exr(exr, read_render(path), render_spp(name))
        return parity.compare(quell, weights, exr, out)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renderer", type=Path, default=Path(sys.executable), help="a Python that has bpy")
    parser.add_argument("--quell", type=Path, default=Path("build/release/bin/quell"))
    parser.add_argument("--out", type=Path, default=Path("build/smoke"), help="a folder; what is there is gone on with")
    args = parser.parse_args()
    worst = smoke(args.renderer, args.quell, args.out)
    print(f"smoke: {len(worst)} passes, largest difference between C and PyTorch {max(worst.values()):.1e}")
    return 1 if max(worst.values()) > parity.TOLERANCE else 0


if __name__ == "__main__":
    sys.exit(main())
