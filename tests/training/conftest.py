# SPDX-License-Identifier: Apache-2.0
"""Tests of the training code. They need the packages of scripts/requirements-training.txt and say so when skipped."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
# Threads that wait for one another are slower than one on a busy machine, and sums depend on how they are split.
os.environ["OMP_NUM_THREADS"] = "1"
# The compiled kernels stay with the other results of the build.
os.environ.setdefault("QUELL_CACHE", str(ROOT / "build" / "training"))

collect_ignore: list[str] = []
try:
    import torch
    import zstandard  # noqa: F401 - only whether it is there
except ImportError as error:
    MISSING: str | None = f"no training tests: {error}; pip install -r scripts/requirements-training.txt"
    collect_ignore += [
        path.name for path in Path(__file__).parent.glob("test_*.py") if path.name != "test_installed.py"
    ]
else:
    MISSING = None
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def missing() -> str | None:
    """Why the other tests of this folder are left out, if they are."""
    return MISSING


@pytest.fixture(scope="session")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of three frames of 64x64, packed. Not to be written to."""
    from synthetic import write_data_set

    from training.data.pack import pack_new

    root = write_data_set(tmp_path_factory.mktemp("data"))
    assert pack_new("train", 6, root) == 3
    return root
