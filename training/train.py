# SPDX-License-Identifier: Apache-2.0
"""Trains a model of the quell family: `python -m training.train --run NAME --minutes 30`.

A run lives in <state>/runs/NAME: config.json, checkpoint.pt (written every two minutes and at the end, by rename),
frames.json (which frames joined at which step), log.csv. Killed at any moment it goes on from the last checkpoint;
batches are a function of seed, step and frames, so it ends where an uninterrupted run would have ended (to the last bit
on a CPU with as many threads). The learning rate falls with the share of `total_steps` done.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import ctypes
import dataclasses
import functools
import json
import math
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch

from training.data.crops import CropConfig, RawBatch, draw_batch, finish_batch, make_batch
from training.data.roster import Roster, RosterError
from training.data.stream import stream
from training.device import autocast, choose_device, describe, move
from training.grow import origin_model
from training.loss import quell_loss
from training.models.quell import Quell, QuellConfig, multiply_adds_range
from training.muon import make_optimisers
from training.paths import state_root

CHECKPOINT_SECONDS = 120
REPACK_SECONDS = 300  # new renders join the data this often
MIN_RENDERS = 7  # of a frame that is to be trained on
LOG_STEPS = 50


@dataclass(frozen=True)
class TrainConfig:
    model: QuellConfig = field(default_factory=QuellConfig)
    crops: CropConfig = field(default_factory=CropConfig)
    total_steps: int = 8000
    rate: float = 1.5e-3
    warmup_steps: int = 100
    final_rate: float = 0.02  # of rate, at total_steps
    clip: float = 3.0  # gradient norm
    ema: float = 0.998
    bfloat16: bool = True
    energy: float = 0.4  # weight of means in the loss; 3 for a last stretch against darkening
    muon: bool = True  # for the body's convolutions; AdamW for the rest
    seed: int = 1


def config_from_json(data: dict) -> TrainConfig:
    """Unknown keys are errors (by the constructors)."""
    data = dict(data)
    model = {k: tuple(v) if isinstance(v, list) else v for k, v in data.pop("model", {}).items()}
    crops = dict(data.pop("crops", {}))
    if "spp_weights" in crops:
        crops["spp_weights"] = tuple((int(s), float(w)) for s, w in crops["spp_weights"])
    return TrainConfig(model=QuellConfig(**model), crops=CropConfig(**crops), **data)


def run_folder(name: str) -> Path:
    return state_root() / "runs" / name


def git_revision() -> str:
    here = Path(__file__).parent
    return subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True).stdout.strip()


def rate_at(step: int, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine down to final_rate."""
    if step < config.warmup_steps:
        return config.rate * (step + 1) / config.warmup_steps
    done = min(1.0, (step - config.warmup_steps) / max(1, config.total_steps - config.warmup_steps))
    return config.rate * (config.final_rate + (1 - config.final_rate) * 0.5 * (1 + math.cos(math.pi * done)))


def keep_memory() -> None:
    """Keeps freed memory: glibc gives every large tensor back, and a third of a step goes into page faults."""
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL("libc.so.6")
        for option, value in ((-8, 1), (-4, 0), (-1, 2**31 - 1), (-2, 2**28)):  # arenas, mmaps, trim, top pad
            libc.mallopt(option, value)


def save_checkpoint(path: Path, state: dict) -> None:
    temporary = path.with_suffix(".tmp")
    torch.save(state, temporary)
    temporary.rename(path)


def update_ema(ema: torch.nn.Module, model: torch.nn.Module, decay: float) -> None:
    with torch.no_grad():
        for a, b in zip(ema.parameters(), model.parameters(), strict=True):
            a.lerp_(b, 1 - decay)


@dataclass(frozen=True)
class Pace:
    """How a run behaves in time; results do not depend on it, but for when new frames join."""

    minutes: float = math.inf
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    repack_seconds: float = REPACK_SECONDS
    grow: bool = True  # whether frames that are rendered meanwhile join
    workers: int = 1  # threads that make batches
    min_renders: int = MIN_RENDERS


def train(
    name: str,
    config: TrainConfig,
    pace: Pace,
    device: torch.device,
    root: Path | None = None,
    origin: Quell | None = None,
) -> int:
    """Trains until total_steps or for the given minutes, whichever comes first; returns the step reached.

    root: of the data set; None: the usual one. origin: what a run begins with; None: random weights."""
    keep_memory()
    folder = run_folder(name)
    folder.mkdir(parents=True, exist_ok=True)
    roster = Roster(folder, "train", pace.min_renders, root, pace.grow)
    torch.manual_seed(config.seed)
    model = (copy.deepcopy(origin) if origin else Quell(config.model)).to(device)
    ema = copy.deepcopy(model)
    optimisers = make_optimisers(model, config.muon, config.rate)
    step, average = 0, None
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True, map_location=device)
        model.load_state_dict(state["model"])
        ema.load_state_dict(state["ema"])
        for optimiser, saved in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(saved)
        step, average = state["step"], state.get("average")
    else:
        saved = {"config": dataclasses.asdict(config), "git": git_revision(), "device": describe(device)}
        (folder / "config.json").write_text(json.dumps(saved, indent=1))
    frames = roster.frames(step)
    macs = multiply_adds_range(config.model)
    print(
        f"{name}: step {step}, {len(frames)} frames, {macs[0]:.0f} to {macs[1]:.0f} multiply-adds per pixel, "
        f"{describe(device)}",
        flush=True,
    )

    def state() -> dict:
        return {
            "model": model.state_dict(),
            "ema": ema.state_dict(),
            "optimisers": [optimiser.state_dict() for optimiser in optimisers],
            "step": step,
            "average": average,
            "frames": len(frames),
        }

    def source():
        # Beside a GPU the workers only draw: features are made where there is time for them.
        make = make_batch if device.type == "cpu" else draw_batch
        return stream(functools.partial(make, frames, config=config.crops), step, pace.workers)

    start = saved_at = packed_at = time.monotonic()
    batches = source()
    while step < config.total_steps and time.monotonic() - start < 60 * pace.minutes:
        batch = next(batches)
        if isinstance(batch, RawBatch):
            batch = finish_batch(move(batch, device))
        with autocast(device, config.bfloat16):
            out = model(batch.features, batch.layers, batch.with_direct)
        loss = quell_loss(out, batch.layers, batch.target, batch.level, config.energy)
        model.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
        if torch.isfinite(norm):
            for optimiser in optimisers:
                for group in optimiser.param_groups:
                    group["lr"] = rate_at(step, config)
                optimiser.step()
            update_ema(ema, model, min(config.ema, (1 + step) / (10 + step)))
        step += 1
        value = float(loss.detach())
        average = value if average is None else 0.98 * average + 0.02 * value
        if step % LOG_STEPS == 0:
            rate = (time.monotonic() - start) / 60
            line = f"{step},{average:.5f},{rate_at(step, config):.3e},{rate:.2f},{len(frames)}"
            with (folder / "log.csv").open("a") as log:
                log.write(line + "\n")
            print(line, flush=True)
        now = time.monotonic()
        if now - packed_at > pace.repack_seconds:
            roster.update(step)
            packed_at = now
        if roster.joins_at(step):
            frames = roster.frames(step)
            batches.close()
            batches = source()
        # Behind what joined: a checkpoint never knows less than the journal did at its step.
        if now - saved_at >= pace.checkpoint_seconds:
            save_checkpoint(checkpoint, state())
            saved_at = now
    batches.close()
    save_checkpoint(checkpoint, state())
    return step


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True)
    parser.add_argument("--config", type=Path, help="JSON; defaults are TrainConfig's")
    parser.add_argument("--origin", type=Path, help="a weight file to begin with, of this width or narrower")
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--steps", type=int, help="total_steps of the schedule")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="default: cuda where there is one")
    parser.add_argument("--pin", action="store_true", help="let no frames join that were not there at the start")
    parser.add_argument("--workers", type=int, default=1, help="threads that make batches; 8 or so beside a GPU")
    parser.add_argument("--min-renders", type=int, default=MIN_RENDERS, help="of a frame that is to be trained on")
    parser.add_argument("--checkpoint-seconds", type=float, default=CHECKPOINT_SECONDS)
    args = parser.parse_args()
    config = config_from_json(json.loads(args.config.read_text())) if args.config else TrainConfig()
    if args.steps:
        config = dataclasses.replace(config, total_steps=args.steps)
    from training.export import WeightFileError, load_weights  # imports this module itself

    pace = Pace(
        args.minutes,
        args.checkpoint_seconds,
        grow=not args.pin,
        workers=args.workers,
        min_renders=args.min_renders,
    )
    try:
        origin = origin_model(load_weights(args.origin), config.model, config.seed) if args.origin else None
        train(args.run, config, pace, choose_device(args.device), origin=origin)
    except (RosterError, WeightFileError, ValueError) as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    main()
