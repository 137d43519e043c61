# SPDX-License-Identifier: Apache-2.0
"""Evaluation on tiny made-up frames: hand-computed errors, what is read, what is written."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("zstandard", reason="stored renders are compressed with it")

from training import evaluate, libquell, measure, pairs, report  # noqa: E402
from training.data.store import CHANNELS, pass_slice, write_render  # noqa: E402
from training.measure import Scores  # noqa: E402

SIZE = 48


@pytest.fixture(scope="module", autouse=True)
def built_library(build: Path) -> None:
    path = build / "lib" / "libquell.so"
    assert path.exists(), f"{path} is missing: run make"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QUELL_LIBRARY", str(path))
        libquell.library.cache_clear()
        libquell.library()


def make_render(rng: np.random.Generator, sigma: float) -> np.ndarray:
    """A render [C,h,w] whose passes sum to Combined: diffuse light on a chequered colour, a glowing corner."""
    y, x = np.mgrid[:SIZE, :SIZE]
    out = np.zeros((len(CHANNELS), SIZE, SIZE), np.float32)
    color = np.where((x // 8 + y // 8) % 2, 0.8, 0.3)
    light = 1.0 + x / SIZE + rng.normal(0, sigma, (3, SIZE, SIZE))
    out[pass_slice("DiffDir")] = light
    out[pass_slice("DiffCol")] = color
    out[pass_slice("Emit")][:, :6, :6] = 2.0
    out[pass_slice("Combined")][:3] = light * color + out[pass_slice("Emit")]
    out[pass_slice("Combined")][3] = 1.0
    out[pass_slice("Denoising Albedo")] = color
    out[pass_slice("Denoising Normal")][2] = 1.0
    out[pass_slice("Denoising Depth")] = 5.0
    return out


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A validation set of one frame with a light group."""
    folder = tmp_path / "val" / "room" / "00000_0"
    (folder / pairs.EXTRA).mkdir(parents=True)
    (folder / "meta.json").write_text(json.dumps({"extra": ["Combined_key"]}))
    for index, (name, spp) in enumerate((("4_0", 4), ("ref_a", 1024), ("ref_b", 1024))):
        render = make_render(np.random.default_rng(index), 1.0 / np.sqrt(spp))
        write_render(folder / f"{name}.qfr", render, spp)
        write_render(folder / pairs.EXTRA / f"{name}.qfr", 0.5 * render[pass_slice("DiffDir")], spp)
    return tmp_path


def test_rel_mse_by_hand() -> None:
    x, a, b = (np.full((1, 1, 3), v) for v in (3.0, 1.0, 2.0))
    assert measure.rel_mse(x, a, b) == pytest.approx(2.0 * 1.0 / (1.5**2 + 0.01))


def test_noise_of_the_references_cancels() -> None:
    rng = np.random.default_rng(1)
    truth = np.ones((128, 128, 3))
    a, b = (truth + rng.normal(0, 0.05, truth.shape) for _ in "ab")
    error = measure.rel_mse(truth * 1.05, a, b)
    assert error == pytest.approx(0.0025 / 1.01, rel=0.2)
    assert measure.rel_mse(truth * 1.05, a, a) > 1.5 * error


def test_library_agrees_with_the_formula() -> None:
    rng = np.random.default_rng(2)
    x, a, b = (rng.random((20, 24, 3)).astype(np.float32) for _ in "xab")
    found = libquell.compare(x, a, b)
    assert found.rel_mse == pytest.approx(measure.rel_mse(x, a, b), rel=1e-5)
    assert libquell.compare(a, a, a).ssim == pytest.approx(1.0)


def test_library_says_what_is_wrong() -> None:
    layers = {"Combined": np.zeros((16, 16, 4), np.float32), "DiffDir": np.zeros((8, 8, 3), np.float32)}
    with pytest.raises(libquell.QuellError, match="DiffDir"):
        libquell.denoise("", layers, 4)
    with pytest.raises(libquell.QuellError, match="no-such-model"):
        libquell.denoise("no-such-model.qwt", {"Combined": layers["Combined"]}, 4)


def test_missing_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("QUELL_LIBRARY", str(tmp_path / "none.so"))
    with pytest.raises(SystemExit, match="make lib"):
        libquell.library.__wrapped__()


def test_stored_pairs(data: Path) -> None:
    (pair,) = pairs.stored_pairs(data, "val", [4, 16])
    assert (pair.name, pair.family, pair.spp) == ("room/00000_0", "room", 4)
    assert pair.scored() == ["Combined", "Combined_key", "DiffCol", "DiffDir", "Emit"]
    assert pair.layers["Combined"].shape == (SIZE, SIZE, 4)
    with_environment, error = pairs.closure(pair.layers)
    assert error < evaluate.CLOSURE_TOLERANCE
    assert np.allclose(pairs.recombine(pair.layers, with_environment), pair.layers["Combined"][..., :3], atol=5e-3)
    stacked = pairs.stack_passes(pair.layers)
    assert np.array_equal(stacked[pass_slice("DiffCol")][0], pair.layers["DiffCol"][..., 0])
    assert not stacked[pass_slice("Position")].any()


def test_passes_that_do_not_sum(data: Path) -> None:
    (pair,) = pairs.stored_pairs(data, "val", [4])
    pair.layers["Combined"] *= 2
    assert pairs.closure(pair.layers)[1] > evaluate.CLOSURE_TOLERANCE
    assert pairs.closure({"Combined": pair.layers["Combined"]}) == (False, float("inf"))


def test_samples_are_read_as_pairs(root: Path) -> None:
    found = {pair.name: pair for pair in pairs.exr_pairs(root / "samples", [4])}
    assert "DiffDir" in found["living_room"].scored()
    assert "DiffDir" in found["still_life"].scored()  # written by Blender 5, with long names
    assert found["bathroom"].scored() == ["Combined"]


def test_whole_run(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "out"
    arguments = ["--model", "", "--no-peer", "--spp", "4,16", "--data", str(data), "--out", str(out)]
    assert evaluate.main(arguments) == 0
    rows = list(csv.DictReader((out / "scores.csv").open()))
    errors = {(r["method"], r["layer"]): float(r["rel_mse"]) for r in rows}
    assert {r["layer"] for r in rows if r["method"] == "built-in"} >= {"Combined", "DiffDir", "Combined_key"}
    assert {r["layer"] for r in rows if r["method"] == "built-in, Combined alone"} == {"Combined"}
    assert errors["built-in", "Combined"] < 0.5 * errors["noisy", "Combined"]
    assert (out / "summary.csv").exists() and (out / "error-time.png").exists() and (out / "worst-4spp.png").exists()
    assert not (out / "worst-16spp.png").exists()
    assert "4 spp  noisy" in capsys.readouterr().out


def test_what_is_left_out_is_missed(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["--model", "", "--no-peer", "--leave-out", "--spp", "4", "--data", str(data), "--out", str(out)]
    assert evaluate.main(arguments) == 0
    rows = list(csv.DictReader((out / "scores.csv").open()))
    errors = {r["method"]: float(r["rel_mse"]) for r in rows if r["layer"] == "Combined"}
    assert {f"built-in without {what}" for what in evaluate.LEFT_OUT} <= set(errors)
    assert errors["built-in without light passes"] == errors["built-in, Combined alone"]
    assert errors["built-in without light passes and guides"] != errors["built-in, Combined alone"]


def test_peer_per_pass(data: Path) -> None:
    pytest.importorskip("pyoidn")
    (pair,) = pairs.stored_pairs(data, "val", [4])
    out, seconds = evaluate.peer_passes_method("fast/fast", 1)(pair)
    assert seconds > 0
    assert set(pair.scored()) <= set(out)
    scores = [measure.score(x["Combined"], pair.reference_a["Combined"], pair.reference_b["Combined"])
              for x in (out, pair.layers)]  # fmt: skip
    assert scores[0].rel_mse < scores[1].rel_mse


def test_no_frames(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="two references"):
        evaluate.main(["--data", str(tmp_path), "--no-peer"])


def row(frame: str, error: float) -> report.Row:
    return report.Row(frame, 4, "noisy", "Combined", Scores(error, 30.0, 0.9, 0.1, 0.2), 1.0)


def test_summary() -> None:
    (line,) = report.summarise([row("a", 0.01), row("b", 0.04)])
    assert line.rel_mse == pytest.approx(0.02)
    assert (line.worst, line.worst_frame, line.frames) == (0.04, "b", 2)
    assert report.summarise([row("a", -1e-4)])[0].rel_mse == pytest.approx(1e-8)


def test_worst_window() -> None:
    image = np.zeros((40, 60, 3))
    image[20:24, 33:37] = 1.0
    y, x = report.worst_window(image, np.zeros_like(image), 8)
    assert y <= 20 and y + 8 >= 24 and x <= 33 and x + 8 >= 37
