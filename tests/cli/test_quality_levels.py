# SPDX-License-Identifier: Apache-2.0
"""--quality: each level is its own network, and everything that is wrong about it is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

LEVELS = ("fast", "balanced", "high")


def denoised(quell, source: Path, out: Path, *options: object) -> bytes:
    quell.ok("denoise", source, "-o", out, "-q", *options)
    return out.read_bytes()


def test_each_level_is_a_network_of_its_own(all_levels, data, tmp_path):
    source = data / "45_all_two_layers.exr"
    results = {level: denoised(all_levels, source, tmp_path / "o.exr", "--quality", level) for level in LEVELS}
    assert len(set(results.values())) == 3
    assert denoised(all_levels, source, tmp_path / "o.exr") == results["balanced"]
    for level in LEVELS:
        assert denoised(all_levels, source, tmp_path / "o.exr", "-m", f"quell-{level}") == results[level]


@pytest.mark.parametrize("level", LEVELS)
def test_every_command_names_the_level_and_its_file(all_levels, data, tmp_path, level):
    source, report = data / "45_plain.exr", tmp_path / "report.json"
    named = f"quality {level}, quell-{level}.qwt"
    assert named in all_levels.ok("inspect", source, "--quality", level).stdout
    assert named in all_levels.ok("denoise", source, "--quality", level, "--dry-run").stdout
    assert named in all_levels.ok("--version", "-v").stdout
    (inspected,) = json.loads(all_levels.ok("inspect", source, "--quality", level, "--json").stdout)
    assert inspected["model"]["quality"] == level and inspected["model"]["file"] == f"quell-{level}.qwt"
    denoised(all_levels, source, tmp_path / "o.exr", "--quality", level, "--report", report)
    assert json.loads(report.read_text())["model"] == inspected["model"]
    timed = all_levels.ok("bench", "--json", "--size", "64x64", "--runs", 1, "--quality", level).stdout
    assert json.loads(timed)["quality"] == level


def test_the_levels_of_this_build(quell, root, data, tmp_path):
    """Levels whose weights are in weights/ work; the others name the file that the build lacked."""
    for level in LEVELS:
        done = quell("denoise", data / "45_plain.exr", "--quality", level, "-o", tmp_path / f"{level}.exr", "-q")
        if (root / "weights" / f"quell-{level}.qwt").exists():
            assert done.returncode == 0, done.stderr
        else:
            assert done.returncode == 7 and f"weights/quell-{level}.qwt" in done.stderr
    present = [path for level in LEVELS if (path := tmp_path / f"{level}.exr").exists()]
    assert tmp_path / "balanced.exr" in present
    assert len({path.read_bytes() for path in present}) == len(present)


def test_other_models_are_no_level(quell, data, root):
    for model in ("dgan-kpn", root / "tests" / "golden" / "quell_small.qwt"):
        (found,) = json.loads(quell.ok("inspect", data / "45_plain.exr", "-m", model, "--json").stdout)
        assert found["model"]["quality"] is None


def test_missing_level(balanced_alone, data, tmp_path):
    out = tmp_path / "o.exr"
    for level in ("fast", "high"):
        for command in (["denoise", data / "45_plain.exr", "-o", out], ["inspect", data / "45_plain.exr"], ["bench"]):
            line = balanced_alone.fails(7, *command, "--quality", level)
            assert f"'{level}'" in line and f"weights/quell-{level}.qwt" in line and "(balanced)" in line
        assert f"quality '{level}': this library was built without" in balanced_alone.ok("--version", "-v").stdout
    assert not out.exists()
    denoised(balanced_alone, data / "45_plain.exr", out, "--quality", "balanced")


@pytest.mark.parametrize("level", ["ultra", "", "High", "1"])
def test_unknown_level(quell, data, level):
    for command in (
        ["denoise", data / "45_plain.exr", "-o", "/no/o.exr"],
        ["inspect", data / "45_plain.exr"],
        ["bench"],
    ):
        done = quell(*command, "--quality", level)
        assert done.returncode == 2 and f"'{level}' is none of fast, balanced, high" in done.stderr


@pytest.mark.parametrize("model", ["dgan-kpn", "quell-balanced", "tests/golden/quell_small.qwt"])
def test_a_model_and_a_level_exclude_each_other(quell, data, tmp_path, model):
    done = quell("denoise", data / "45_plain.exr", "-o", tmp_path / "o.exr", "--quality", "high", "--model", model)
    assert done.returncode == 2 and f"--model {model} --quality high" in done.stderr and "one of the two" in done.stderr
    assert not (tmp_path / "o.exr").exists()


def test_settings_of_the_other_kind_are_refused(quell, data, tmp_path):
    done = quell("denoise", data / "45_plain.exr", "-o", tmp_path / "o.exr", "--quality", "balanced", "--kpn-only")
    assert done.returncode == 2 and "DGAN" in done.stderr
