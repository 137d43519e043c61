# SPDX-License-Identifier: Apache-2.0
"""The released model on the samples: error against two references, layer by layer, and means."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted(p.name for p in (ROOT / "samples").iterdir() if (p / f"{p.name}_4spp.exr").exists())
SPP = (4, 16)

#: What quell-balanced reaches (docs/quality.md), less a margin for other instruction sets' rounding.
REACHED_MEAN, REACHED_WORST = 13.6, 3.75
REACHED_DRIFT, REACHED_DRIFT_SPARSE = 0.023, 0.055  # the second for passes that are black nearly everywhere
#: What the loss of docs/decisions/0009 costs: fog at 4 spp, bulbs a pixel wide, light through a few bottles.
KNOWN_DRIFT = {("misty_hall", "Volume Direct"): 0.052, ("night_bar", "Emit"): 0.035, ("night_bar", "TransDir"): 0.065}


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """relMSE against two references, whose own noise cancels, and its standard error from 16x16 blocks."""
    x, a, b = (v[..., :3].astype(np.float64) for v in (x, a, b))
    m = 0.5 * (a + b)
    error = ((x - a) * (x - b) / (m * m + 0.01)).mean(-1)
    height, width = (s // 16 * 16 for s in error.shape)
    blocks = error[:height, :width].reshape(height // 16, 16, width // 16, 16).mean((1, 3))
    return float(error.mean()), float(blocks.std() / math.sqrt(blocks.size))


def pass_name(layer: str) -> str:
    return layer.split(".")[-1]


def group(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Channels to layers: 'ViewLayer.Combined' -> [h][w][RGB or what there is]."""
    layers: dict[str, dict[str, np.ndarray]] = {}
    for name, pixels in channels.items():
        layer, _, letter = name.rpartition(".")
        layers.setdefault(layer, {})[letter] = pixels.astype(np.float32)
    return {k: np.stack([v[c] for c in sorted(v, key="RGBAXYZVW".find)], -1) for k, v in layers.items()}


@pytest.fixture(scope="module")
def results(quell, exr_reader, tmp_path_factory) -> dict:
    """Per sample and spp: the layers of the input, of the output and of both references, and the report."""
    folder = tmp_path_factory.mktemp("samples")
    out = {}
    for name in SAMPLES:
        refs = [group(exr_reader(ROOT / "samples" / name / f"{name}_ref_{k}.exr")) for k in "ab"]
        for spp in SPP:
            source = ROOT / "samples" / name / f"{name}_{spp}spp.exr"
            target = folder / source.name
            report = folder / f"{source.stem}.json"
            quell.ok("denoise", source, "-o", target, "--report", report)
            layers = json.loads(report.read_text())["files"][0]["layers"]
            out[name, spp] = (
                group(exr_reader(source)),
                group(exr_reader(target)),
                refs,
                {x["name"]: x for x in layers},
            )
    return out


def combined(layers: dict[str, np.ndarray]) -> np.ndarray:
    return next(v for k, v in layers.items() if pass_name(k) == "Combined")


def test_there_are_samples():
    assert len(SAMPLES) >= 4


def gains_at(results: dict, spp: int) -> dict[str, float]:
    """How many times smaller Combined's error is than the input's."""
    gains = {}
    for name in SAMPLES:
        source, target, refs, _ = results[name, spp]
        ends = [combined(r) for r in refs]
        gains[name] = rel_mse(combined(source), *ends)[0] / max(rel_mse(combined(target), *ends)[0], 1e-9)
    return gains


def geometric_mean(gains: dict[str, float]) -> float:
    return math.exp(np.mean([math.log(g) for g in gains.values()]))


def test_combined_keeps_what_is_reached(results):
    """No release is worse than this one (docs/quality.md); raise the numbers when a model raises them."""
    gains = gains_at(results, 4)
    assert geometric_mean(gains) >= REACHED_MEAN, gains
    assert min(gains.values()) >= REACHED_WORST, gains
    assert min(gains_at(results, 16).values()) >= 1


def test_each_level_is_nearer_to_the_truth_than_the_one_below(quell, exr_reader, tmp_path):
    """Error of Combined at 4 spp, geometric mean over the samples, of the quality levels that this build has."""
    levels = [level for level in ("fast", "balanced", "high") if (ROOT / "weights" / f"quell-{level}.qwt").exists()]
    if len(levels) == 1:
        pytest.skip("weights/ has one level alone")
    gains = {level: {} for level in levels}
    for name in SAMPLES:
        source = ROOT / "samples" / name / f"{name}_4spp.exr"
        refs = [combined(group(exr_reader(ROOT / "samples" / name / f"{name}_ref_{k}.exr"))) for k in "ab"]
        before = rel_mse(combined(group(exr_reader(source))), *refs)[0]
        for level in levels:
            quell.ok("denoise", source, "-o", tmp_path / "out.exr", "--quality", level, "-q")
            after = rel_mse(combined(group(exr_reader(tmp_path / "out.exr"))), *refs)[0]
            gains[level][name] = before / max(after, 1e-9)
    means = [geometric_mean(gains[level]) for level in levels]
    assert means == sorted(means), dict(zip(levels, means, strict=True))


@pytest.mark.xfail(reason="house, nearly clean to begin with, is at 3.8-fold: docs/quality.md")
def test_combined_at_4_spp_on_each(results):
    gains = gains_at(results, 4)
    assert geometric_mean(gains) >= 8, gains
    assert min(gains.values()) >= 4, gains


def worse_layers(results: dict, name: str, spp: int) -> dict[str, tuple[float, float]]:
    source, target, refs, report = results[name, spp]
    worse = {}
    for layer, x in report.items():
        if x["action"] != "denoise":
            continue
        ends = [next((v for k, v in r.items() if pass_name(k) == pass_name(layer)), None) for r in refs]
        if ends[0] is None:
            continue  # most references hold Combined alone (samples/README.md)
        before, _ = rel_mse(source[layer], *ends)
        after, deviation = rel_mse(target[layer], *ends)
        # Noise-free layers score 0 before and after, within what two noisy references can resolve.
        if after > before + 2 * deviation:
            worse[layer] = (before, after)
    return worse


@pytest.mark.parametrize("spp", SPP)
@pytest.mark.parametrize("name", SAMPLES)
def test_no_layer_gets_worse(results, name, spp):
    assert not worse_layers(results, name, spp)


def drifts(results: dict, name: str, spp: int) -> dict[str, float]:
    """Ratio of the means after and before, of layers in which no firefly was limited."""
    source, target, _, report = results[name, spp]
    ratios = {}
    for layer, x in report.items():
        if x["action"] == "denoise" and x["limited_pixels"] == 0:
            before, after = (float(v[layer][..., :3].astype(np.float64).mean()) for v in (source, target))
            if abs(before) > 1e-3:
                ratios[layer] = after / before
    return ratios


@pytest.mark.parametrize("spp", SPP)
@pytest.mark.parametrize("name", SAMPLES)
def test_means_keep_what_is_reached(results, name, spp):
    source = results[name, spp][0]
    for layer, ratio in drifts(results, name, spp).items():
        sparse = (source[layer][..., :3] == 0).mean() > 0.9
        usual = REACHED_DRIFT_SPARSE if sparse else REACHED_DRIFT
        assert abs(ratio - 1) <= KNOWN_DRIFT.get((name, pass_name(layer)), usual), (layer, ratio)


@pytest.mark.xfail(reason="fog, bulbs a pixel wide and some light passes at 4 spp miss it: docs/quality.md")
def test_means_stay_within_2_percent(results):
    for name in SAMPLES:
        for spp in SPP:
            for layer, ratio in drifts(results, name, spp).items():
                assert abs(ratio - 1) <= 0.02, (name, spp, layer, ratio)


@pytest.mark.parametrize("name", SAMPLES)
def test_results_are_finite(results, name):
    for spp in SPP:
        for layer, pixels in results[name, spp][1].items():
            if results[name, spp][3].get(layer, {}).get("action") == "denoise":
                assert np.isfinite(pixels).all(), layer
