# SPDX-License-Identifier: Apache-2.0
"""Trains DGAN-KPN as section 3.3 does, in three stages of a run each, and KPCN beside it.

    python -m training.dgan.train --stage kpn   --run dgan/kpn            # phase 1: eq. 8, kernels on the noisy image
    python -m training.dgan.train --stage dgan  --run dgan/generator      # phase 1: eq. 6
    python -m training.dgan.train --stage joint --run dgan/joint --from dgan/kpn,dgan/generator   # phase 2: eq. 10
    python -m training.dgan.train --stage kpcn  --run dgan/kpcn

Adam, batch 1, a fixed rate and then as many steps of linear decay. A run lives in <state>/runs/NAME: config.json,
checkpoint.pt (written every minute and at the end, by rename), log.csv; the same command goes on from there.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor, nn

from training.data.pack import prefetch
from training.dgan.config import DganKpnConfig, LossFactors, from_json
from training.dgan.data import Batch, DataConfig, Frame, batches, load_frames
from training.dgan.discriminator import Discriminators
from training.dgan.kpcn import Kpcn, KpcnConfig, kpcn_loss
from training.dgan.losses import adversarial_loss, kernel_loss, tone_loss, total_loss
from training.dgan.model import DganKpn
from training.train import git_revision, run_folder, save_checkpoint

CHECKPOINT_SECONDS = 60
LOG_STEPS = 50
STAGES = ("kpn", "dgan", "joint", "kpcn")


@dataclass(frozen=True)
class TrainConfig:
    """Published: rate 1e-4 for 200 epochs of 21 scenes, then linear decay. Here an epoch is as many steps as there are
    frames, the epochs are scaled to the time at hand and the rate with them; both are stated beside every result."""

    stage: str = "kpn"
    model: DganKpnConfig = field(default_factory=DganKpnConfig)
    kpcn: KpcnConfig = field(default_factory=KpcnConfig)
    data: DataConfig = field(default_factory=DataConfig)
    factors: LossFactors = field(default_factory=LossFactors)
    phase_1_tone: float = 0.0  # eq. 9 beside eq. 6 in phase 1 of the generator; the paper has eq. 6 alone
    iterations: int = 4  # phase 2
    steps: int = 2000  # half at the fixed rate, half of decay
    rate: float = 1e-4
    bfloat16: bool = True
    seed: int = 1


def config_from_json(data: dict) -> TrainConfig:
    """Unknown keys are errors (by the constructors)."""
    data = dict(data)
    crops = dict(data.pop("data", {}))
    if "spp_weights" in crops:
        crops["spp_weights"] = tuple((int(s), float(w)) for s, w in crops["spp_weights"])
    return TrainConfig(
        model=from_json(data.pop("model", {})),
        kpcn=KpcnConfig(**data.pop("kpcn", {})),
        data=DataConfig(**crops),
        factors=LossFactors(**data.pop("factors", {})),
        **data,
    )


def rate_at(step: int, config: TrainConfig) -> float:
    """Fixed for the first half, then linearly to 0."""
    half = config.steps / 2
    return config.rate * min(1.0, max(0.0, (config.steps - step) / half))


class Trainer:
    """Networks, optimisers and one step of a stage."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.model: nn.Module = Kpcn(config.kpcn) if config.stage == "kpcn" else DganKpn(config.model)
        self.discriminators = Discriminators(config.model.discriminator)
        trained: nn.Module = self.model
        if isinstance(self.model, DganKpn) and config.stage != "joint":
            trained = self.model.kpn if config.stage == "kpn" else self.model.generator
        self.optimiser = self.adam(trained)
        self.critic = self.adam(self.discriminators)
        self.uses_critic = config.stage in ("dgan", "joint") and config.factors.adversarial > 0

    def adam(self, module: nn.Module) -> torch.optim.Adam:
        return torch.optim.Adam(module.parameters(), lr=self.config.rate, betas=(0.9, 0.999), eps=1e-8)

    def autocast(self) -> torch.autocast:
        return torch.autocast("cpu", torch.bfloat16, enabled=self.config.bfloat16)

    def estimate(self, batch: Batch) -> Tensor:
        """What the stage's losses look at."""
        stage = self.config.stage
        parts = {"kpn": "kpn", "dgan": "dgan", "joint": "both"}[stage]
        iterations = self.config.iterations if stage == "joint" else 1
        with self.autocast():
            return self.model(batch.noisy, batch.auxiliary, batch.exponent, iterations, parts).float()

    def judge(self, batch: Batch, image: Tensor) -> Tensor:
        """Eq. 6 (phase 1) or 7 (phase 2)."""
        with self.autocast():
            real = self.discriminators(batch.noisy, batch.target)
            return adversarial_loss(real, self.discriminators(batch.noisy, image))

    def loss(self, batch: Batch, image: Tensor) -> Tensor:
        config = self.config
        if config.stage == "kpn":
            return kernel_loss(image, batch.target)
        adversarial = self.judge(batch, image) if self.uses_critic else torch.zeros(())
        if config.stage == "dgan":
            return adversarial + config.phase_1_tone * tone_loss(image, batch.target)
        kernel, tone = kernel_loss(image, batch.target), tone_loss(image, batch.target)
        return total_loss(adversarial, kernel, tone, config.factors)

    def step(self, batch: Batch, step: int) -> float:
        """D_i maximises, then G minimises with D_i fixed (below eq. 4)."""
        for optimiser in (self.optimiser, self.critic):
            for group in optimiser.param_groups:
                group["lr"] = rate_at(step, self.config)
        if isinstance(self.model, Kpcn):
            with self.autocast():
                loss = kpcn_loss(self.model, batch)
        else:
            image = self.estimate(batch)
            if self.uses_critic:
                self.descend(self.critic, -self.judge(batch, image.detach()))
            loss = self.loss(batch, image)
        self.descend(self.optimiser, loss)
        return float(loss.detach())

    def descend(self, optimiser: torch.optim.Optimizer, loss: Tensor) -> None:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        parameters = [p for group in optimiser.param_groups for p in group["params"] if p.grad is not None]
        if all(bool(torch.isfinite(p.grad).all()) for p in parameters):
            optimiser.step()

    def state(self, step: int) -> dict:
        return {
            "model": self.model.state_dict(),
            "discriminators": self.discriminators.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "critic": self.critic.state_dict(),
            "step": step,
        }

    def load(self, state: dict) -> int:
        self.model.load_state_dict(state["model"])
        self.discriminators.load_state_dict(state["discriminators"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.critic.load_state_dict(state["critic"])
        return state["step"]


def read_checkpoint(name: str) -> dict:
    path = run_folder(name) / "checkpoint.pt"
    if not path.exists():
        raise SystemExit(f"there is no run '{name}': train it first (training/README.md)")
    return torch.load(path, weights_only=True)


def start_from(trainer: Trainer, names: list[str]) -> None:
    """Takes the kernel predictor of the first run, generator and discriminators of the second."""
    kpn, generator = (read_checkpoint(name) for name in names)
    model = trainer.model.state_dict()
    model |= {k: v for k, v in kpn["model"].items() if k.startswith("kpn.")}
    model |= {k: v for k, v in generator["model"].items() if k.startswith("generator.")}
    trainer.model.load_state_dict(model)
    trainer.discriminators.load_state_dict(generator["discriminators"])


def train(name: str, config: TrainConfig, origin: list[str], minutes: float, frames: list[Frame]) -> None:
    """Trains until config.steps or for the given minutes, whichever comes first."""
    folder = run_folder(name)
    folder.mkdir(parents=True, exist_ok=True)
    if not frames:
        raise SystemExit("no packed training frames: render and pack some first (training/README.md)")
    trainer = Trainer(config)
    checkpoint, step = folder / "checkpoint.pt", 0
    if checkpoint.exists():
        step = trainer.load(torch.load(checkpoint, weights_only=True))
    else:
        saved = {"config": dataclasses.asdict(config), "from": origin, "git": git_revision(), "frames": len(frames)}
        (folder / "config.json").write_text(json.dumps(saved, indent=1))
        if origin:
            start_from(trainer, origin)
    print(f"{name}: stage {config.stage}, step {step} of {config.steps}, {len(frames)} frames", flush=True)
    start = saved_at = time.monotonic()
    average = None
    source = prefetch(batches(frames, step, config.data))
    while step < config.steps and time.monotonic() - start < 60 * minutes:
        value = trainer.step(next(source), step)
        step += 1
        if math.isfinite(value):  # a step that is not was not taken
            average = value if average is None else 0.98 * average + 0.02 * value
        if step % LOG_STEPS == 0:
            line = f"{step},{average or math.nan:.6f},{rate_at(step, config):.3e},{(time.monotonic() - start) / 60:.2f}"
            with (folder / "log.csv").open("a") as log:
                log.write(line + "\n")
            print(line, flush=True)
        if time.monotonic() - saved_at > CHECKPOINT_SECONDS:
            save_checkpoint(checkpoint, trainer.state(step))
            saved_at = time.monotonic()
    save_checkpoint(checkpoint, trainer.state(step))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", choices=STAGES, required=True)
    parser.add_argument("--run", required=True)
    parser.add_argument(
        "--from", dest="origin", default="", help="runs of phase 1: the kernel predictor's,the generator's"
    )
    parser.add_argument("--config", type=Path, help="JSON; defaults are TrainConfig's")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--rate", type=float)
    parser.add_argument("--phase-1-tone", type=float)
    parser.add_argument("--factors", help="adversarial,kernel,tone of eq. 10")
    parser.add_argument("--minutes", type=float, default=1e9)
    args = parser.parse_args()
    config = config_from_json(json.loads(args.config.read_text()) if args.config else {})
    given = {"steps": args.steps, "rate": args.rate, "phase_1_tone": args.phase_1_tone}
    if args.factors:
        given["factors"] = LossFactors(*map(float, args.factors.split(",")))
    config = dataclasses.replace(config, stage=args.stage, **{k: v for k, v in given.items() if v is not None})
    train(args.run, config, [name for name in args.origin.split(",") if name], args.minutes, load_frames("train"))


if __name__ == "__main__":
    main()
