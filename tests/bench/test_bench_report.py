# SPDX-License-Identifier: Apache-2.0
"""The benchmarks' own arithmetic: errors, means, what is concluded from a CSV, and the document made of it."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from bench import errors, pictures, report  # noqa: E402
from bench.common import interleaved, slug, write_csv  # noqa: E402
from bench.summary import Results  # noqa: E402

FACTS = {"machine": "A B", "kernels": "c", "revision": "1"}


@pytest.fixture
def noise() -> np.random.Generator:
    return np.random.default_rng(3)


def test_two_references_cancel_their_own_noise(noise):
    truth = np.full((64, 64, 3), 0.5, np.float32)
    a, b = (truth + noise.normal(0, 0.05, truth.shape).astype(np.float32) for _ in range(2))
    assert abs(errors.rel_mse(truth, a, b)) < 1e-4 < errors.rel_mse(truth, a, a)
    noisy = truth + noise.normal(0, 0.1, truth.shape).astype(np.float32)
    assert errors.rel_mse(noisy, a, b) == pytest.approx(0.01 / 0.26, rel=0.1)
    assert errors.psnr(noisy, a, b) < errors.psnr(truth, a, b)


def test_measures_agree_with_the_tool(quell, exr_writer, tmp_path, noise):
    images = {k: noise.random((40, 50, 3), dtype=np.float32) for k in ("x", "a", "b")}
    paths = [exr_writer(tmp_path / f"{k}.exr", {"ViewLayer.Combined": v}) for k, v in images.items()]
    layer = json.loads(quell.ok("compare", "--json", *paths).stdout)["layers"][0]
    x, a, b = images.values()
    assert errors.rel_mse(x, a, b) == pytest.approx(layer["rel_mse"], rel=1e-4)
    assert errors.psnr(x, a, b) == pytest.approx(layer["psnr"], rel=1e-4)


def test_ssim_of_equal_images_is_one(noise):
    x = noise.random((32, 32, 3), dtype=np.float32)
    assert errors.ssim(x, x, x) == pytest.approx(1)
    assert errors.ssim(x, np.roll(x, 3, 0), np.roll(x, 3, 0)) < 0.5


def test_samples_are_found_with_their_references():
    samples = pictures.list_samples(ROOT / "samples")
    assert {s.spp for s in samples} >= {4, 16} and len({s.scene for s in samples}) >= 6
    assert all(path.exists() for s in samples for path in s.references)
    passes = pictures.read_passes(samples[0].path)
    assert passes["Combined"].dtype == np.float32 and passes["Denoising Depth"].shape[2] == 1
    big = pictures.repeat_to(passes, 700, 301)["Combined"]
    assert big.shape == (301, 700, passes["Combined"].shape[2])
    assert pictures.render_seconds(samples[0].path) > 0


def test_jobs_take_turns_and_the_first_round_is_left_out():
    order: list[str] = []
    jobs = {name: (lambda name=name: (order.append(name), float(len(order)))[1]) for name in "ab"}
    assert interleaved(jobs, 2) == {"a": [3.0, 5.0], "b": [4.0, 6.0]}
    assert order == list("ababab")


def write_results(folder) -> None:
    def error(method: str, spp: int, scene: str, value: float) -> dict:
        row = FACTS | {"scene": scene, "spp": spp, "method": method, "width": 10, "height": 10, "render_s": 2.0}
        return row | {"rel_mse": value, "psnr": 20.0, "ssim": 0.5, "flip": 0.1}

    def time(method: str, threads: int, seconds: float) -> dict:
        row = FACTS | {"threads": threads, "width": 100, "height": 50, "method": method, "macs_per_pixel": 10.0}
        return row | {"median_s": seconds, "min_s": seconds, "max_s": seconds, "runs": 3}

    def layers(method: str, count: int, seconds: float) -> dict:
        row = FACTS | {"method": method, "threads": 2, "width": 100, "height": 50, "layers": count}
        return row | {"median_s": seconds, "min_s": seconds, "max_s": seconds}

    errors_of = {"noisy": 0.4, "quell-balanced": 0.01, "OIDN High/Fast": 0.02, "OIDN High/Accurate": 0.005}
    rows = [error(m, spp, s, 4 * v / spp) for m, v in errors_of.items() for spp in (4, 16) for s in ("one", "two")]
    write_csv(folder / "m-error.csv", rows)
    seconds = {"quell-balanced": 1.0, "OIDN High/Fast": 2.0, "OIDN High/Accurate": 9.0}
    write_csv(folder / "m-time.csv", [time(m, t, v * 2 / t) for m, v in seconds.items() for t in (1, 2)])
    counts = [("quell-balanced", 1, 1.0), ("quell-balanced", 10, 1.9), ("OIDN High/Fast", 1, 2.0)]
    write_csv(folder / "m-layers.csv", [layers(*c) for c in counts])


def job(layers: int, quality: str) -> dict:
    row = FACTS | {"size": "480p", "width": 854, "height": 480, "threads": 2, "layers": layers, "quality": quality}
    stages = ("decode", "analyse", "features", "network", "filter", "recombine", "encode")
    row |= {f"{stage}_s": 0.125 for stage in stages} | {"whole_s": 1.0, "oiiotool_s": ""}
    return row | {name: 1.0 for name in ("working_mb", "resident_mb", "output_mb", "copy_mb")}


@pytest.mark.parametrize(
    ("levels", "names"),
    [(["balanced"], ["480p, 1 layer"]), (["fast", "high"], ["480p, 1 layer, fast", "480p, 1 layer, high"])],
)
def test_jobs_are_told_apart_by_their_level(tmp_path, levels, names):
    write_csv(tmp_path / "m-job.csv", [job(1, level) for level in levels])
    jobs = Results.read(tmp_path, "m").jobs()
    assert [one["name"] for one in jobs] == names and jobs[0]["stages"]["rest"] == pytest.approx(0.125)


def test_every_network_is_measured(quell, monkeypatch, build):
    """Each twice: with all passes, and with Combined and the guides alone."""
    monkeypatch.setenv("QUELL_LIBRARY", str(build / "lib" / "libquell.so"))
    from bench import methods

    names = [
        line.split()[1].rstrip(":")
        for line in quell.ok("--version", "-v").stdout.splitlines()
        if line.startswith("model ")
    ]
    assert methods.our_models() == names and {"quell-balanced", "dgan-kpn"} <= set(names)
    ours = methods.our_methods()
    assert [m.name for m in ours] == [text for name in names for text in (name, f"{name}, beauty")]
    passes = {"Combined": np.random.default_rng(5).random((40, 50, 3), dtype=np.float32)}
    for method in ours:
        ready = method.set_up(passes, 4, 1)
        assert ready.run() > 0 and np.isfinite(ready.combined()).all()
        ready.close()


def test_results(tmp_path):
    write_results(tmp_path)
    results = Results.read(tmp_path, "m")
    assert results.methods == ["quell-balanced", "OIDN High/Fast", "OIDN High/Accurate"]
    assert results.error("quell-balanced", 4) == pytest.approx(0.01)
    assert results.worth("quell-balanced", 4) == pytest.approx(160)
    assert results.seconds("OIDN High/Fast", 1) == 4.0 and results.seconds("unknown") is None
    assert results.render_seconds(4) == pytest.approx(2.0 / 4 / 100 * 5000)


def test_document(tmp_path):
    pytest.importorskip("matplotlib")
    write_results(tmp_path)
    report.write(Results.read(tmp_path, "m"), tmp_path / "docs")
    text = (tmp_path / "docs" / "benchmarks.md").read_text()
    assert "faster and nearer to the truth than OIDN High/Fast." in text
    assert "| quell-balanced | 1 | 1.9 | 10.0 % |" in text
    assert {p.name for p in (tmp_path / "docs" / "images").iterdir()} == {
        f"bench-{name}.png" for name in ("error-time", "equal-error", "layers")
    }


def test_small_things():
    assert slug("AMD EPYC", "avx512") == "amd-epyc-avx512"
    assert [report.number(v) for v in (None, math.nan, 0.0, 0.01234, 1.5, 123456.0)] == [
        "",
        "",
        "0",
        "0.0123",
        "1.5",
        "123,456",
    ]
