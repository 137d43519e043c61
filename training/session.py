# SPDX-License-Identifier: Apache-2.0
"""Renders and trains on one machine in one go, for as long as it can be had.

    python -m training.session --run NAME --minutes 30 --out FOLDER [--procs 14] [--shards FOLDER] [--device cuda]

N processes render (--procs 0: none) while training runs on what is packed so far; frames that were carried here as
shards are used too. Ends in time, and leaves in --out, in files of at most 16 MiB: the weights as NAME.qwt, the
checkpoint in pieces, config, log, which frames were used, session.json. Started again it goes on: in the same place
from the run itself, elsewhere from an --out folder that was brought along.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from training import pieces, shards
from training.data.pack import load_packs, pack_new
from training.data.store import write_atomic
from training.device import choose_device, describe
from training.export import export, load_run
from training.paths import data_root
from training.train import MIN_RENDERS, Pace, TrainConfig, config_from_json, run_folder, train

SPP = "1,1,2,4,8,16,32"
#: Kept at the end for export and copying.
RESERVE_SECONDS = 45
#: How long the pace is measured before the number of steps, and with it the schedule of the rate, is settled.
PROBE_MINUTES = 0.75
LEAST_PROBE_MINUTES = 1 / 60
#: Crops of a batch where the device is a GPU; a CPU keeps the configuration's.
GPU_BATCH = 32


@dataclasses.dataclass(frozen=True)
class Rendering:
    """What the render processes do; none where procs is 0."""

    procs: int = 0
    families: str = "all"
    seeds: str = "0:100000"
    size: int = 256
    spp: str = SPP


@contextmanager
def renderer(what: Rendering, data: Path, log: Path) -> Iterator[None]:
    """Renders in the background; whatever is being rendered at the end is lost, all before it is kept."""
    if what.procs == 0:
        yield
        return
    command = [sys.executable, "-m", "training.render", "--families", what.families, "--seeds", what.seeds]
    command += ["--procs", str(what.procs), "--spp", what.spp, "--size", str(what.size), "--data", str(data)]
    with log.open("ab") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
        process.wait()


def wait_for_frames(count: int, min_renders: int, data: Path, deadline: float) -> int:
    """Packs what is rendered until there are enough frames to begin with."""
    while True:
        pack_new("train", min_renders, data)
        found = len(load_packs("train", data))
        if found >= count or time.monotonic() > deadline:
            return found
        time.sleep(2)


def restore(run: str, source: Path) -> None:
    """Brings a run back from the folder that an earlier session left, unless it is here already."""
    folder = run_folder(run)
    if (folder / "checkpoint.pt").exists() or not (source / "checkpoint.pt.pieces.json").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("config.json", "log.csv"):
        if (source / name).exists():
            shutil.copy(source / name, folder / name)
    pieces.join(source / "checkpoint.pt", folder / "checkpoint.pt")


def choose_config(run: str, path: Path | None, batch: int | None, device: torch.device) -> TrainConfig:
    """The run's own configuration where it has begun, else the file's, else the default."""
    saved = run_folder(run) / "config.json"
    if saved.exists():
        config = config_from_json(json.loads(saved.read_text())["config"])
    else:
        config = config_from_json(json.loads(path.read_text())) if path else TrainConfig()
    if batch is None and device.type == "cuda":
        batch = GPU_BATCH
    return dataclasses.replace(config, crops=dataclasses.replace(config.crops, batch=batch)) if batch else config


def steps_done(run: str) -> int:
    path = run_folder(run) / "checkpoint.pt"
    return torch.load(path, weights_only=True, map_location="cpu")["step"] if path.exists() else 0


def train_until(run: str, config: TrainConfig, pace: Pace, device: torch.device, data: Path, deadline: float) -> int:
    """Trains until the deadline, with a rate that has come down by then: the pace is measured first."""

    def minutes_left() -> float:
        return max(0.0, (deadline - time.monotonic()) / 60)

    first = steps_done(run)
    endless = dataclasses.replace(config, total_steps=sys.maxsize)  # at the full rate
    began = time.monotonic()
    probe = max(LEAST_PROBE_MINUTES, min(PROBE_MINUTES, minutes_left() / 4))
    step = train(run, endless, dataclasses.replace(pace, minutes=probe), device, data)
    per_second = max(step - first, 1) / (time.monotonic() - began)
    total = step + max(1, int(per_second * 60 * minutes_left()))
    print(f"{per_second:.2f} steps a second: {total} steps in all", flush=True)
    planned = dataclasses.replace(config, total_steps=total)
    return train(run, planned, dataclasses.replace(pace, minutes=minutes_left()), device, data)


def deliver(run: str, out: Path, facts: dict) -> None:
    """Weights, checkpoint and logs into the output folder, in files of at most 16 MiB."""
    folder = run_folder(run)
    model, step = load_run(run)
    name = Path(run).name
    weights = folder / f"{name}.qwt"
    sha = export(model, weights, name, f"kernel pyramid network, {step} training steps")
    if weights.stat().st_size > pieces.MAX_BYTES:
        pieces.split(weights, out)
    else:
        shutil.copy(weights, out / weights.name)
    pieces.split(folder / "checkpoint.pt", out)
    for file in ("config.json", "log.csv", "frames.json"):
        if (folder / file).exists():
            shutil.copy(folder / file, out / file)
    write_atomic(out / "session.json", json.dumps({**facts, "step": step, "weights_sha256": sha}, indent=1).encode())
    print(f"{weights.name}: {weights.stat().st_size} bytes, sha256 {sha}", flush=True)


def session(
    run: str,
    out: Path,
    minutes: float,
    rendering: Rendering,
    device: torch.device,
    *,
    carried: list[Path],
    config_file: Path | None = None,
    batch: int | None = None,
    workers: int = 2,
    frames_to_begin: int = 8,
    min_renders: int = MIN_RENDERS,
    repack_seconds: float = 60,
    data: Path | None = None,
) -> int:
    """Runs it all; returns the step reached."""
    began = time.monotonic()
    deadline = began + 60 * minutes - min(RESERVE_SECONDS, 15 * minutes)
    data = data or data_root()
    out.mkdir(parents=True, exist_ok=True)
    restore(run, out)
    print(f"{run}: {minutes:g} minutes on {describe(device)}", flush=True)
    outcome = shards.read_all(shards.shards_in(carried), data)
    for fault in outcome.faults:
        print(fault, flush=True)
    with renderer(rendering, data, out / "render.log"):
        found = wait_for_frames(frames_to_begin, min_renders, data, deadline)
        if found == 0:
            raise SystemExit(f"no frames to train on: neither shards nor renders; see {out / 'render.log'}")
        config = choose_config(run, config_file, batch, device)
        pace = Pace(repack_seconds=repack_seconds, workers=workers, min_renders=min_renders)
        step = train_until(run, config, pace, device, data, deadline)
    facts = {
        "run": run,
        "device": describe(device),
        "minutes": round((time.monotonic() - began) / 60, 2),
        "render_processes": rendering.procs,
        "frames": len(load_packs("train", data)),
        "batch": config.crops.batch,
    }
    deliver(run, out, facts)
    return step


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True)
    parser.add_argument("--minutes", type=float, required=True, help="in all, export included")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: cuda where there is one")
    parser.add_argument(
        "--procs", type=int, default=max(1, (os.cpu_count() or 2) - 2), help="render processes; 0: none"
    )
    parser.add_argument("--shards", type=Path, nargs="*", default=[], help="files or folders of carried frames")
    parser.add_argument("--config", type=Path, help="JSON of a run that begins here; defaults are TrainConfig's")
    parser.add_argument("--batch", type=int, help=f"crops of a step; default: {GPU_BATCH} on a GPU, else the config's")
    parser.add_argument("--workers", type=int, default=2, help="threads that make batches")
    parser.add_argument("--frames-to-begin", type=int, default=8, help="frames that training waits for")
    parser.add_argument("--min-renders", type=int, default=MIN_RENDERS, help="of a frame that is to be trained on")
    parser.add_argument("--families", default="all")
    parser.add_argument("--seeds", default="0:100000", metavar="A:B", help="seeds of the scenes rendered here")
    parser.add_argument("--spp", default=SPP)
    parser.add_argument("--size", type=int, default=256)
    args = parser.parse_args()
    session(
        args.run,
        args.out,
        args.minutes,
        Rendering(args.procs, args.families, args.seeds, args.size, args.spp),
        choose_device(args.device),
        carried=args.shards,
        config_file=args.config,
        batch=args.batch,
        workers=args.workers,
        frames_to_begin=args.frames_to_begin,
        min_renders=args.min_renders,
    )


if __name__ == "__main__":
    main()
