# SPDX-License-Identifier: Apache-2.0
"""Judge a preview: what is wrong with a view, how bright its lights should be, which window of it is worth rendering.

Previews are stored renders of few samples, [C,H,W] in the order of CHANNELS; nothing here needs Blender.
"""

from __future__ import annotations

import math
import random

import numpy as np

from training.data.store import CHANNELS, pass_slice

#: Lights that would need to be stronger or weaker by more than this are not where the scene needs them.
_MOST_GAIN = 100.0
_REGION_TRIES = 40
_LIT = tuple(
    i
    for i, name in enumerate(CHANNELS)
    if name.split(".")[0] in ("Combined", "Emit", "Env") and not name.endswith(".A")
)


def scaled(preview: np.ndarray, gain: float) -> np.ndarray:
    """Return a preview as it will look once its lights are multiplied."""
    out = preview.copy()
    out[list(_LIT)] *= gain
    return out


def luminance(pixels: np.ndarray) -> np.ndarray:
    """Return the luminance of [3,H,W]."""
    return 0.2126 * pixels[0] + 0.7152 * pixels[1] + 0.0722 * pixels[2]


def smooth(image: np.ndarray, size: int = 4) -> np.ndarray:
    """Return block means: noise of a few samples must not look like detail."""
    h, w = (n - n % size for n in image.shape)
    return image[:h, :w].reshape(h // size, size, w // size, size).mean((1, 3))


def whole_picture_fault(preview: np.ndarray) -> str:
    """Say what makes the whole view useless, "" if nothing does."""
    depth = preview[pass_slice("Depth")][0]
    hit = depth > 0
    if hit.mean() < 0.15 and not preview[pass_slice("VolumeDir")].any():
        return "nothing to see"
    if hit.any() and (depth[hit] < 0.12).mean() > 0.35:
        return "camera too close to something"
    if not np.isfinite(preview).all():
        return "non-finite preview"
    light, alpha = luminance(preview[pass_slice("Combined")]), preview[pass_slice("Combined")][3]
    if light.max() <= 1e-6:
        return "black"
    # Where most samples find no light at all, an artist would light the scene in another way.
    if (light[alpha > 0.5] <= 1e-6).mean() > 0.6:
        return "hardly lit"
    return ""


def choose_gain(preview: np.ndarray, brightness: float | None) -> float | None:
    """Return the factor that brings the mean tone-mapped luminance to what is wanted."""
    if brightness is None:
        return 1.0
    combined = preview[pass_slice("Combined")]
    light, alpha = smooth(luminance(combined)), smooth(combined[3])
    # On transparent film the emptiness around a cut-out says nothing about its exposure.
    light = light[alpha > 0.5] if (alpha > 0.5).mean() > 0.02 else light
    low, high = math.log(1 / 512), math.log(512)
    for _ in range(40):
        middle = (low + high) / 2
        mean = float(np.mean(tone(light * math.exp(middle))))
        low, high = (middle, high) if mean < brightness else (low, middle)
    gain = math.exp((low + high) / 2)
    if not 1 / _MOST_GAIN < gain < _MOST_GAIN:
        return None
    # Quantised, so that rounding in the preview cannot make two machines differ.
    return 2.0 ** (round(4 * math.log2(gain)) / 4)


def tone(light: np.ndarray) -> np.ndarray:
    """Map scene light to 0..1 roughly as a view transform does."""
    return (light / (1.0 + light)) ** (1 / 1.8)


def choose_region(
    preview: np.ndarray, resolution: tuple[int, int], size: int, rng: random.Random
) -> tuple[tuple[int, int, int, int] | None, str]:
    """Pick one of the regions that are not flat, black, burnt out or sky; None with a reason."""
    width, height = resolution
    ph, pw = preview.shape[1:]
    if (width, height) == (size, size):
        candidates = [(0, 0)]
    else:
        candidates = [(rng.randint(0, width - size), rng.randint(0, height - size)) for _ in range(_REGION_TRIES)]
    scored, reasons = [], []
    for x, y in candidates:
        x0, y0 = x * pw // width, y * ph // height
        x1, y1 = max(x0 + 16, (x + size) * pw // width), max(y0 + 16, (y + size) * ph // height)
        score, reason = region_score(preview[:, y0:y1, x0:x1])
        if reason:
            reasons.append(reason)
        else:
            scored.append(((x, y, size, size), score))
    if not scored:
        return None, f"region: {reasons[0]}"
    # Not always the very best: plainer regions are part of every picture too.
    return rng.choices([r for r, _ in scored], [s for _, s in scored])[0], ""


def edges(planes: np.ndarray) -> float:
    """Return how much [C,H,W] changes from one 2x2 block to the next: little where all is plain or out of focus."""
    blocks = np.stack([smooth(plane, 2) for plane in planes])
    return float(np.abs(np.diff(blocks, axis=1)).mean() + np.abs(np.diff(blocks, axis=2)).mean())


def region_score(part: np.ndarray) -> tuple[float, str]:
    """Return how much there is to see in a region, or why it is not worth rendering."""
    light = smooth(luminance(part[pass_slice("Combined")]), 2)
    toned = tone(np.maximum(light, 0.0))
    hit = part[pass_slice("Depth")][0] > 0
    fog = part[pass_slice("VolumeDir")].any()
    shine = smooth(luminance(part[pass_slice("Emit")] + part[pass_slice("Env")]), 2)
    if toned.mean() < 0.05:
        return 0.0, "black"
    if (toned > 0.93).mean() > 0.4:
        return 0.0, "burnt out"
    if hit.mean() < 0.25 and not fog:
        return 0.0, "empty sky"
    if (shine > 0.6 * light).mean() > 0.6:
        return 0.0, "all emission"
    albedo = np.clip(part[pass_slice("Denoising Albedo")], 0.0, 1.0)
    detail = edges(albedo) + 0.5 * edges(part[pass_slice("Denoising Normal")])
    if detail < 0.05 and not fog:
        return 0.0, "flat"
    if toned.std() < 0.03:
        return 0.0, "no contrast"
    return (min(detail, 0.3) + 0.4 * float(toned.std())) ** 3, ""
