# SPDX-License-Identifier: Apache-2.0
"""Builds of the tool with other weights than those of weights/."""

from __future__ import annotations

import hashlib
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

LEVELS = ("fast", "balanced", "high")
HEADER, ENTRY, DIGEST = 24, 88, 32  # bytes; docs/FORMATS.md


def scaled(content: bytes, name: str, factor: float) -> bytes:
    """The weight file with one record of half floats multiplied: a network that gives other pixels."""
    body = bytearray(content[:-DIGEST])
    (count,) = struct.unpack_from("<I", body, 12)
    for entry in range(HEADER, HEADER + count * ENTRY, ENTRY):
        found, *_, offset, length = struct.unpack_from("<48s6I2Q", body, entry)
        if found.rstrip(b"\0").decode() == name:
            values = np.frombuffer(bytes(body[offset : offset + length]), "<f2") * np.float16(factor)
            body[offset : offset + length] = values.tobytes()
            return bytes(body) + hashlib.sha256(body).digest()
    raise KeyError(name)


def build_with_levels(root: Path, build: Path, folder: Path, levels: tuple[str, ...]) -> Path:
    """`build` linked again, with a tiny network of its own for each of the levels; the new build's folder."""
    small = (root / "tests" / "golden" / "quell_small.qwt").read_bytes()
    weights = folder / "weights"
    weights.mkdir()
    for level in levels:
        content = scaled(small, "head.0.weight", 1 + LEVELS.index(level) / 4)
        (weights / f"quell-{level}.qwt").write_bytes(content)
    out = folder / build.name
    shutil.copytree(root / build / "obj" / "src", out / "obj" / "src")  # with their times: only the weights are new
    shutil.copy2(root / build / "obj" / "flags", out / "obj")
    config = {"debug": ["DEBUG=1"]}.get(build.name, [])
    if build.name.startswith("san-"):
        config = [f"SAN={build.name.removeprefix('san-').replace('-', ',')}"]
    command = ["make", "-s", f"OUT={out}", f"WEIGHTS_DIR={weights}", *config, str(out / "bin" / "quell")]
    subprocess.run(command, cwd=root, check=True)
    return out


@pytest.fixture(scope="session")
def all_levels(root, build, quell, tmp_path_factory):
    """The tool with a tiny network for each quality level."""
    if quell.emulator:
        pytest.skip("linking again is for this machine's own build")
    return type(quell)(build_with_levels(root, build, tmp_path_factory.mktemp("levels"), LEVELS))


@pytest.fixture(scope="session")
def balanced_alone(root, build, quell, tmp_path_factory):
    """The tool as it is built where the weight files of the other levels are missing."""
    if quell.emulator:
        pytest.skip("linking again is for this machine's own build")
    return type(quell)(build_with_levels(root, build, tmp_path_factory.mktemp("balanced"), ("balanced",)))
