# SPDX-License-Identifier: Apache-2.0
"""What needs no work is left alone, and said so; --no-skip, --no-blend and --dry-run."""

from __future__ import annotations

import json

import numpy as np
import pytest


def noisy(height: int, width: int) -> np.ndarray:
    """A flat grey with noise of some 40 %."""
    rng = np.random.default_rng(5)
    return (0.5 * rng.gamma(6.0, 1 / 6.0, (height, width, 1)) * np.ones(3)).astype(np.float32)


@pytest.fixture
def half_clean(tmp_path, exr_writer):
    """Noise in the lower right, a clean gradient elsewhere."""
    pixels = np.linspace(0.2, 0.9, 320, dtype=np.float32)[None, :, None] * np.ones((256, 1, 3), np.float32)
    pixels[160:, 192:] = noisy(96, 128)
    return exr_writer(tmp_path / "half_clean.exr", {"ViewLayer.Combined": pixels}), pixels


def combined(layers: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([layers[f"ViewLayer.Combined.{c}"] for c in "RGB"], -1)


def report_of(quell, path, out, *options: str) -> dict:
    report = out.with_suffix(".json")
    quell.ok("denoise", path, "-q", "-o", out, "--report", report, *options)
    return json.loads(report.read_text())["files"][0]


def test_clean_parts_are_not_computed(quell, half_clean, tmp_path, exr_reader):
    path, pixels = half_clean
    out = tmp_path / "out.exr"
    summary = report_of(quell, path, out)["summary"]
    assert 0 < summary["active_cells"] < summary["cells"] / 2
    result = combined(exr_reader(out))
    assert np.array_equal(result[:120, :], pixels[:120, :])
    assert result[180:240, 220:300].std() < 0.3 * pixels[180:240, 220:300].std()


def test_no_skip_gives_the_same_bits(quell, half_clean, tmp_path, exr_reader):
    path, _ = half_clean
    skipped, whole = tmp_path / "skipped.exr", tmp_path / "whole.exr"
    report_of(quell, path, skipped)
    summary = report_of(quell, path, whole, "--no-skip")["summary"]
    assert summary["active_cells"] == summary["cells"]
    assert np.array_equal(combined(exr_reader(skipped)), combined(exr_reader(whole)))


def test_a_clean_layer_is_skipped(quell, tmp_path, exr_writer, exr_reader):
    pixels = np.linspace(0.2, 0.9, 64, dtype=np.float32)[None, :, None] * np.ones((48, 1, 3), np.float32)
    path = exr_writer(tmp_path / "clean.exr", {"ViewLayer.Combined": pixels})
    file = report_of(quell, path, tmp_path / "out.exr")
    (layer,) = file["layers"]
    assert layer["action"] == "skip" and layer["reason"].startswith("clean")
    assert file["summary"]["active_cells"] == 0
    assert np.array_equal(combined(exr_reader(tmp_path / "out.exr")), pixels)


def test_no_blend_changes_more(quell, root, tmp_path):
    path = root / "samples" / "house" / "house_16spp.exr"

    def layer(*options: str) -> dict:
        layers = report_of(quell, path, tmp_path / "out.exr", "--layers", "beauty", *options)["layers"]
        return next(x for x in layers if x["action"] == "denoise")

    blended = layer()
    assert 0.05 < blended["noise"] < 0.5
    assert 0 < blended["blend"] < 1 and 0 < blended["change"] < blended["noise"] * 1.5


def test_dry_run_writes_nothing(quell, half_clean, tmp_path):
    path, _ = half_clean
    before = {p.name for p in tmp_path.iterdir()}
    text = quell.ok("denoise", path, "--dry-run").stdout
    assert "would compute" in text and "MB of working memory" in text and "ViewLayer.Combined, noise" in text
    report = json.loads(quell.ok("denoise", path, "--dry-run", "-o", tmp_path / "x.exr", "--report", "-").stdout)
    (file,) = report["files"]
    assert file["summary"]["peak_bytes"] > 0 and "output" not in file
    assert {p.name for p in tmp_path.iterdir()} == before
    quell.fails(3, "denoise", tmp_path / "missing.exr", "--dry-run")


def test_fireflies_on_the_border_stay_limited(quell, tmp_path, exr_writer, exr_reader):
    """They came back at full strength: no second difference sees a border pixel, so its change seemed lost detail."""
    pixels = noisy(64, 96)
    for y, x in ((63, 40), (0, 70), (30, 0), (20, 95), (63, 95)):
        pixels[y, x] = 1e4
    path = exr_writer(tmp_path / "fireflies.exr", {"ViewLayer.Combined": pixels})
    quell.ok("denoise", path, "-q", "-o", tmp_path / "out.exr")
    assert combined(exr_reader(tmp_path / "out.exr")).max() < 50
