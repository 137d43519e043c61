# SPDX-License-Identifier: Apache-2.0
"""The ARM build under qemu. NEON rounds in its own order, so bits are compared between the C kernels, and NEON's result
is held to theirs. QUELL_BUILD names the ARM build; `make test-arm64` runs this."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "night_bar" / "night_bar_4spp.exr"


@pytest.fixture(scope="module")
def arm(quell, build):
    assert build.name.startswith("aarch64-"), "set QUELL_BUILD=build/aarch64-release"
    return quell


def test_sample_has_the_same_bits(arm, native, tmp_path):
    ours, theirs = tmp_path / "x86.exr", tmp_path / "arm.exr"
    arguments = ["denoise", SAMPLE, "-q", "--cpu", "c", "--layers", "beauty"]
    native.ok(*arguments, "-o", ours)
    arm.ok(*arguments, "-o", theirs)
    assert ours.read_bytes() == theirs.read_bytes()


def test_vectors_agree_with_plain_c(arm, native, data, tmp_path):
    source, ours, theirs = data / "45_plain.exr", tmp_path / "c.exr", tmp_path / "neon.exr"
    native.ok("denoise", source, "-q", "--cpu", "c", "-o", ours)
    done = arm.ok("denoise", source, "--report", "-", "-o", theirs)
    assert json.loads(done.stdout)["kernels"] == "neon"
    layers = json.loads(native.ok("compare", theirs, ours, "--json").stdout)["layers"]
    assert layers and all(layer["rel_mse"] < 1e-6 for layer in layers)


def test_library_needs_libc_alone(build):
    command = ["aarch64-linux-gnu-readelf", "-d", str(build / "lib" / "libquell.so")]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    needed = {name.split(".")[0] for name in re.findall(r"NEEDED.*\[(.*)\]", text)}
    assert needed <= {"libc", "libm", "ld-linux-aarch64", "libpthread"}, needed
