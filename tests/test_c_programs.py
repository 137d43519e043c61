# SPDX-License-Identifier: Apache-2.0
"""Runs every C test program, so that one summary counts all tests. A program's exit code 77 is a skip."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = sorted(p.relative_to(ROOT / "tests").with_suffix("") for p in ROOT.glob("tests/*/test_*.c"))


@pytest.mark.parametrize("name", PROGRAMS, ids=str)
def test_program(name: Path) -> None:
    program = ROOT / os.environ.get("QUELL_BUILD", "build/release") / "tests" / name
    assert program.exists(), f"{program} is missing: run make c-tests"
    done = subprocess.run(
        [program], cwd=ROOT, capture_output=True, text=True, errors="replace", timeout=300, check=False
    )
    if done.returncode == 77:
        pytest.skip((done.stdout + done.stderr).strip().splitlines()[-1])
    assert done.returncode == 0, done.stdout + done.stderr


def test_kernels_on_arm() -> None:
    """The NEON kernels, cross built, under qemu."""
    done = subprocess.run(["make", "qemu"], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
