# SPDX-License-Identifier: Apache-2.0
"""The whole training chain, from Cycles to the C library, and what only Cycles can tell. Skipped without bpy."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from training.data.crops import turn, turn_normal


@pytest.fixture(scope="session")
def renderer(root: Path) -> Path:
    """A Python that has Blender as a module."""
    python = root / "build" / "venv-render" / "bin" / "python"
    if not python.exists():
        pytest.skip("Blender as a module is not installed: make build/venv-render/stamp")
    done = subprocess.run([python, "-c", "import bpy"], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"Blender as a module does not start: {done.stderr.strip().splitlines()[-1]}")
    return python


def test_the_whole_chain(renderer: Path, root: Path, build: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "training.smoke", "--renderer", renderer, "--quell", build / "bin" / "quell"]
    done = subprocess.run([*command, "--out", tmp_path], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + "\n".join(done.stderr.splitlines()[-20:])
    assert "largest difference between C and PyTorch" in done.stdout
    frames = sorted((tmp_path / "data" / "train").glob("*/*/meta.json"))
    meta = json.loads(frames[0].read_text())
    assert meta["seconds"] and meta["cycles_seeds"] and meta["blender"] and meta["fingerprint"]
    assert (tmp_path / "smoke.qwt").stat().st_size > 100_000


def test_turned_normals_match_turned_renders(renderer: Path, root: Path, tmp_path: Path) -> None:
    """Cycles renders a scene and its eight turns; each render's normals are the first one's, turned."""
    script = root / "tests" / "training" / "render_turns.py"
    subprocess.run([renderer, script, tmp_path], cwd=root, check=True, capture_output=True)
    plain = np.load(tmp_path / "000.npy")
    assert np.ptp(plain[0]) > 0.5 and np.ptp(plain[1]) > 0.5  # normals of many directions
    for flips in itertools.product((False, True), repeat=3):
        render = np.load(tmp_path / ("".join(str(int(flip)) for flip in flips) + ".npy"))
        expected = turn_normal(turn(plain, *flips), *flips)
        # Samples do not fall on the same spots of mirrored pixels: edges differ, faces must not.
        error = np.abs(render - expected).max(0)
        assert np.median(error) < 1e-3 and (error > 0.1).mean() < 0.1, flips
