# SPDX-License-Identifier: Apache-2.0
"""Trains a model of the quell family: `python -m training.train --run NAME --minutes 30`.

A run lives in <state>/runs/NAME: config.json, checkpoint.pt (written every two minutes and at the end, by rename),
log.csv. Killed at any moment it goes on from the last checkpoint; batches are a function of (seed, step), so it ends
where an uninterrupted run would have ended. The learning rate falls with the share of `total_steps` done.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import ctypes
import dataclasses
import json
import math
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch

from training.data.crops import CropConfig, batches
from training.data.pack import load_packs, pack_new, prefetch
from training.loss import quell_loss
from training.models.quell import GROUPS, Quell, QuellConfig, multiply_adds
from training.paths import state_root

CHECKPOINT_SECONDS = 120
REPACK_SECONDS = 300  # new renders join the data this often


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
    seed: int = 1


def config_from_json(data: dict) -> TrainConfig:
    """Unknown keys are errors (by the constructors)."""
    data = dict(data)
    model = {k: tuple(v) for k, v in data.pop("model", {}).items()}
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


def train(name: str, config: TrainConfig, minutes: float) -> None:
    """Trains until total_steps or for the given minutes, whichever comes first."""
    keep_memory()
    folder = run_folder(name)
    folder.mkdir(parents=True, exist_ok=True)
    pack_new("train", 7)
    frames = load_packs("train")
    if not frames:
        raise SystemExit("no packed training frames: render some first (training/README.md)")
    torch.manual_seed(config.seed)
    model = Quell(config.model)
    ema = copy.deepcopy(model)
    optimiser = torch.optim.AdamW(model.parameters(), lr=config.rate, betas=(0.9, 0.99), weight_decay=1e-4)
    step = 0
    checkpoint = folder / "checkpoint.pt"
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        model.load_state_dict(state["model"])
        ema.load_state_dict(state["ema"])
        optimiser.load_state_dict(state["optimiser"])
        step = state["step"]
    else:
        saved = {"config": dataclasses.asdict(config), "git": git_revision()}
        (folder / "config.json").write_text(json.dumps(saved, indent=1))
    macs = multiply_adds(config.model, 1, False), multiply_adds(config.model, len(GROUPS), True)
    print(
        f"{name}: step {step}, {len(frames)} frames, {macs[0]:.0f} to {macs[1]:.0f} multiply-adds per pixel", flush=True
    )

    def state() -> dict:
        return {
            "model": model.state_dict(),
            "ema": ema.state_dict(),
            "optimiser": optimiser.state_dict(),
            "step": step,
            "frames": len(frames),
        }

    start = saved_at = packed_at = time.monotonic()
    source = prefetch(batches(frames, step, config.crops))
    average = None
    while step < config.total_steps and time.monotonic() - start < 60 * minutes:
        batch = next(source)
        for group in optimiser.param_groups:
            group["lr"] = rate_at(step, config)
        with torch.autocast("cpu", torch.bfloat16, enabled=config.bfloat16):
            out = model(batch.features, batch.layers)
        loss = quell_loss(out, batch.layers, batch.target)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), config.clip)
        if torch.isfinite(norm):
            optimiser.step()
            update_ema(ema, model, min(config.ema, (1 + step) / (10 + step)))
        step += 1
        value = float(loss.detach())
        average = value if average is None else 0.98 * average + 0.02 * value
        if step % 50 == 0:
            rate = (time.monotonic() - start) / 60
            line = f"{step},{average:.5f},{rate_at(step, config):.3e},{rate:.2f},{len(frames)}"
            with (folder / "log.csv").open("a") as log:
                log.write(line + "\n")
            print(line, flush=True)
        now = time.monotonic()
        if now - saved_at > CHECKPOINT_SECONDS:
            save_checkpoint(checkpoint, state())
            saved_at = now
        if now - packed_at > REPACK_SECONDS:
            packed_at = now
            if pack_new("train", 7):
                frames = load_packs("train")
                source = prefetch(batches(frames, step, config.crops))
    save_checkpoint(checkpoint, state())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", required=True)
    parser.add_argument("--config", type=Path, help="JSON; defaults are TrainConfig's")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--steps", type=int, help="total_steps of the schedule")
    args = parser.parse_args()
    config = config_from_json(json.loads(args.config.read_text())) if args.config else TrainConfig()
    if args.steps:
        config = dataclasses.replace(config, total_steps=args.steps)
    train(args.run, config, args.minutes)


if __name__ == "__main__":
    main()
