# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with a render, put into a good one: bad pixels, fireflies, exposures, guides, sample counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

Passes = dict[str, np.ndarray]

#: Light that noise and bad pixels come in; colours and guides are data about surfaces.
RADIANCE = (
    "Combined",
    *(f"{group}{kind}" for group in ("Diff", "Gloss", "Trans", "Volume") for kind in ("Dir", "Ind")),
)
SCALED = (*RADIANCE, "Emit", "Env")

#: Share of the pixels; 0: a single one.
SHARES = (0.0, 0.01, 0.1, 0.5, 0.9)
BAD_VALUES = {"NaN": np.nan, "+Inf": np.inf, "-Inf": -np.inf, "negative": -0.5}
FIREFLIES = (1e2, 1e4, 1e6, 1e10, 1e20, 1e30)
FIREFLY_SHARE = 0.001
EXPONENTS = (-30, -20, -10, 10, 20, 30)


@dataclass(frozen=True)
class Case:
    """One corruption. at: its place on the axis of a plot. exponent: results are scaled back by it."""

    kind: str
    label: str
    at: float
    apply: Callable[[Passes], Passes]
    exponent: int = 0
    samples: int | None = None  # told instead of the true number
    is_ours_alone: bool = False  # the peer is not told what is changed here


def with_pixels(passes: Passes, share: float, value: float) -> Passes:
    """The value in the same random pixels of all radiance."""
    height, width = passes["Combined"].shape[:2]
    rng = np.random.default_rng(1)
    chosen = rng.permutation(height * width)[: max(1, round(share * height * width))]
    changed = dict(passes)
    for name in (n for n in RADIANCE if n in passes):
        pixels = passes[name].copy()
        pixels.reshape(height * width, -1)[chosen, :3] = value
        changed[name] = pixels
    return changed


def scaled(passes: Passes, exponent: int) -> Passes:
    changed = dict(passes)
    for name in (n for n in SCALED if n in passes):
        pixels = passes[name].copy()
        pixels[..., :3] = np.ldexp(pixels[..., :3], exponent)
        changed[name] = pixels
    return changed


def without(*names: str) -> Callable[[Passes], Passes]:
    return lambda passes: {name: pixels for name, pixels in passes.items() if name not in names}


def guide_set_to(name: str, value: float) -> Callable[[Passes], Passes]:
    return lambda passes: {**passes, name: np.full_like(passes[name], value)}


ALBEDO, NORMAL, DEPTH = "Denoising Albedo", "Denoising Normal", "Denoising Depth"
GUIDE_CASES = {
    "no depth": without(DEPTH),
    "albedo alone": without(NORMAL, DEPTH),
    "no guides": without(ALBEDO, NORMAL, DEPTH),
    "albedo 0": guide_set_to(ALBEDO, 0.0),
    "albedo NaN": guide_set_to(ALBEDO, np.nan),
    "albedo 1e20": guide_set_to(ALBEDO, 1e20),
    "normals NaN": guide_set_to(NORMAL, np.nan),
    "normals of length 500": lambda passes: {**passes, NORMAL: 500 * passes[NORMAL]},
    "depth infinite": guide_set_to(DEPTH, np.inf),
}


def cases() -> Iterator[Case]:
    yield Case("none", "as rendered", 0, dict)
    for kind, value in BAD_VALUES.items():
        for share in SHARES:
            label = f"{kind}, {f'{share:.0%} of the pixels' if share else 'one pixel'}"
            yield Case(kind, label, share, lambda p, s=share, v=value: with_pixels(p, s, v))
    for value in FIREFLIES:
        label = f"fireflies of {value:.0e}, one pixel in {1 / FIREFLY_SHARE:.0f}".replace("e+0", "e").replace("e+", "e")
        yield Case("fireflies", label, value, lambda p, v=value: with_pixels(p, FIREFLY_SHARE, v))
    for exponent in EXPONENTS:
        yield Case("exposure", f"radiance times 2^{exponent}", exponent, lambda p, e=exponent: scaled(p, e), exponent)
    for at, (label, apply) in enumerate(GUIDE_CASES.items()):
        yield Case("guides", label, at, apply)
    for samples in (0, 1, 1024, 65536):
        label = f"said to have {samples} samples" if samples else "number of samples unknown"
        yield Case("samples", label, samples, dict, samples=samples, is_ours_alone=True)
