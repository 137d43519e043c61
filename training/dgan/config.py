# SPDX-License-Identifier: Apache-2.0
"""Settings of DGAN-KPN. `published()` is the paper's; where the paper is silent, docs/dgan-kpn.md says what is chosen.

The narrow settings, the defaults of the classes, are what the released weights have.
"""

from __future__ import annotations

from dataclasses import dataclass, field

KERNEL_SIZE = 19  # section 3.1.2: k = 19
KERNEL_RADIUS = KERNEL_SIZE // 2
KERNEL_TAPS = KERNEL_SIZE**2  # 361
NUM_AUXILIARY = 13  # section 3.2
NUM_DISCRIMINATORS = 4  # section 3.1
MAX_ITERATIONS = 8
GENERATOR_LEVELS = 4  # stride-2 convolutions; sizes are padded to multiples of 2^4


@dataclass(frozen=True)
class GeneratorConfig:
    """Encoder widths (published: 64, 128, 256, 512), residual blocks at the last, decoder widths back up."""

    widths: tuple[int, int, int, int] = (16, 32, 64, 128)
    blocks: int = 2  # convolutions 5 to 8: "the eighth convolutional layer" ends them
    decoder: tuple[int, int, int, int] = (64, 32, 16, 16)
    deviation: float = 0.002  # of the Gaussian initialisation, section 3.3


@dataclass(frozen=True)
class KpnConfig:
    """Source encoder (two enlarged convolutions), feature encoder (residual blocks), predictor (three 1x1)."""

    width: int = 16
    source_size: int = 5
    blocks: int = 6
    predictor: int = 64  # channels of the first two 1x1 convolutions; published: 361


@dataclass(frozen=True)
class DiscriminatorConfig:
    width: int = 16  # of the first convolution; doubled by each of the next two


@dataclass(frozen=True)
class DganKpnConfig:
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    kpn: KpnConfig = field(default_factory=KpnConfig)
    discriminator: DiscriminatorConfig = field(default_factory=DiscriminatorConfig)


@dataclass(frozen=True)
class LossFactors:
    """Eq. 10; a factor of 0 takes the term out (ablation)."""

    adversarial: float = 0.003  # alpha
    kernel: float = 0.008  # beta
    tone: float = 0.09  # omega


def published() -> DganKpnConfig:
    """The widths that the paper states, and 64 channels where it states none."""
    return DganKpnConfig(
        GeneratorConfig(widths=(64, 128, 256, 512), decoder=(256, 128, 64, 64)),
        KpnConfig(width=64, predictor=KERNEL_TAPS),
        DiscriminatorConfig(width=64),
    )


def from_json(data: dict) -> DganKpnConfig:
    """Unknown keys are errors (by the constructors)."""
    data = dict(data)
    generator = {k: tuple(v) if isinstance(v, list) else v for k, v in data.pop("generator", {}).items()}
    return DganKpnConfig(
        GeneratorConfig(**generator),
        KpnConfig(**data.pop("kpn", {})),
        DiscriminatorConfig(**data.pop("discriminator", {})),
        **data,
    )
