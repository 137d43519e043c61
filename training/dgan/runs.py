# SPDX-License-Identifier: Apache-2.0
"""The trainings behind the released weights and docs/ablation.md, in order; what is finished is left alone.

    python -m training.dgan.runs                 # all of them: about an hour of one core
    python -m training.dgan.runs --only kpn,generator

The paper trains 200 epochs at a fixed rate of 1e-4 and decays linearly after. An hour of one core allows a few dozen
epochs of 64x64 crops of the frames at hand, so the rate is raised with the shortening: 1e-3 for kernel predictors,
5e-4 for the generator and its discriminators, 3e-4 in phase 2. Its targets have 4096 samples per pixel; here frames
have 16 to 36 in all, and nine tenths of a target are their denoised mean (training/data/clean.py): the L1 of eq. 8 and
9 asks for the median, which under noise is darker than the mean.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from training.dgan.config import LossFactors
from training.dgan.data import DataConfig, load_frames
from training.dgan.train import TrainConfig, train

#: Weight of eq. 9 beside eq. 6 in phase 1 of the generator: as 0.09 stands to 0.003 in eq. 10.
TONE_BESIDE_GAN = 30.0
PHASE_1 = ("dgan/kpn", "dgan/generator")
CLEAN_SHARE = 0.9  # of targets
SHORT = 500  # steps of phase 2 where one loss is compared with another
SHORT_GENERATOR = 1000


@dataclass(frozen=True)
class Run:
    name: str
    config: TrainConfig
    origin: tuple[str, ...] = ()


def settings(stage: str, crop: int, steps: int, rate: float, **others) -> TrainConfig:
    return TrainConfig(
        stage=stage, data=DataConfig(crop=crop, clean_share=CLEAN_SHARE), steps=steps, rate=rate, **others
    )


def phase_2(steps: int, factors: LossFactors | None = None) -> TrainConfig:
    return settings("joint", 64, steps, 3e-4, factors=factors or LossFactors())


RUNS = (
    Run("dgan/kpn", settings("kpn", 64, 12000, 1e-3)),
    Run("dgan/generator", settings("dgan", 64, 10000, 5e-4, phase_1_tone=TONE_BESIDE_GAN)),
    Run("dgan/joint", phase_2(9000), PHASE_1),
    Run("dgan/kpcn", settings("kpcn", 48, 5000, 1e-3)),
    Run("dgan/short", phase_2(SHORT), PHASE_1),
    Run("dgan/short-no-tone", phase_2(SHORT, LossFactors(tone=0.0)), PHASE_1),
    Run("dgan/short-no-gan", phase_2(SHORT, LossFactors(adversarial=0.0)), PHASE_1),
    Run("dgan/generator-eq6", settings("dgan", 64, SHORT_GENERATOR, 5e-4)),
    Run("dgan/generator-short", settings("dgan", 64, SHORT_GENERATOR, 5e-4, phase_1_tone=TONE_BESIDE_GAN)),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="names without 'dgan/', comma-separated")
    args = parser.parse_args()
    chosen = args.only.split(",") if args.only else [run.name.partition("/")[2] for run in RUNS]
    unknown = set(chosen) - {run.name.partition("/")[2] for run in RUNS}
    if unknown:
        raise SystemExit(f"no such runs: {', '.join(sorted(unknown))}")
    frames = load_frames("train")
    for run in RUNS:
        if run.name.partition("/")[2] in chosen:
            train(run.name, run.config, list(run.origin), float("inf"), frames)


if __name__ == "__main__":
    main()
