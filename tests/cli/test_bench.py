# SPDX-License-Identifier: Apache-2.0
"""quell bench, and the stages that a report times."""

from __future__ import annotations

import json

import pytest

STAGES = {"decode", "analyse", "features", "network", "filter", "recombine"}


def run(quell, *options: object) -> dict:
    return json.loads(quell.ok("bench", "--json", "--size", "96x64", "--runs", 2, *options).stdout)


def test_json(quell):
    result = run(quell, "--threads", 1, "--cpu", "c")
    expected = {
        "isa": "c",
        "precision": "float32",
        "threads": 1,
        "width": 96,
        "height": 64,
        "layers": 10,
        "runs": 2,
        "features": "all",
    }
    assert result | expected == result
    assert 0 < result["min_s"] <= result["median_s"] <= result["max_s"]
    assert result["peak_bytes"] > 96 * 64 * 4 and result["macs_per_pixel"] > 1000 and result["gmacs_per_s"] > 0
    assert set(result["stages"]) == STAGES and result["stages"]["decode"] == 0
    assert all(result["stages"][stage] > 0 for stage in STAGES - {"decode"})
    assert sum(result["stages"].values()) <= result["max_s"]


def test_more_layers_need_more_of_the_network(quell):
    few, many = run(quell, "--layers", 1), run(quell, "--layers", 10)
    assert many["macs_per_pixel"] > few["macs_per_pixel"]
    assert few["stages"]["recombine"] == 0


@pytest.mark.parametrize("layers", [2, 15, 20, 64])
def test_any_number_of_layers(quell, layers):
    assert run(quell, "--layers", layers, "--features", "none")["layers"] == layers


def test_tiles_and_text(quell):
    text = quell.ok("bench", "--size", "320x200", "--runs", 1, "--tile", 64, "--layers", 1).stdout
    assert text.startswith("quell-balanced, 320x200, 1 layer, ") and "20 tiles" in text


def test_precision(quell):
    assert run(quell, "--layers", 1, "--precision", "float32")["precision"] == "float32"
    assert run(quell, "--layers", 1, "--precision", "bfloat16", "--cpu", "c")["precision"] == "bfloat16"
    usual = run(quell, "--layers", 1)
    assert usual["precision"] == ("bfloat16" if usual["isa"] == "avx512bf16" else "float32")


def test_wrong_use(quell):
    for arguments in (
        ["--size", "96"],
        ["--size", "0x64"],
        ["--size", "96x"],
        ["--size", "70000x2"],
        ["--layers", "0"],
        ["--layers", "65"],
        ["--runs", "none"],
        ["--features", "some"],
        ["--tile", "-1"],
        ["--precision", "half"],
        ["file.exr"],
    ):
        done = quell("bench", *arguments)
        assert done.returncode == 2 and done.stderr.startswith("quell: ") and done.stdout == "", arguments
    quell.fails(7, "bench", "-m", "missing.qwt")
    quell.fails(9, "bench", "--size", "640x480", "--max-memory", 1)


def test_report_times_every_stage(quell, data, tmp_path):
    report = tmp_path / "report.json"
    quell.ok("denoise", data / "45_all_two_layers.exr", "-o", tmp_path / "out.exr", "--report", report, "-q")
    file = json.loads(report.read_text())["files"][0]
    assert set(file["stages"]) == STAGES | {"encode"}
    assert file["stages"]["encode"] == file["seconds_write"] > 0
    assert 0 < file["stages"]["decode"] <= file["seconds_read"]
    within = sum(file["stages"][stage] for stage in STAGES - {"decode"})
    assert 0 < within <= file["seconds_denoise"]
