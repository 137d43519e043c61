# SPDX-License-Identifier: Apache-2.0
"""Fixtures that several folders of tests share. QUELL_BUILD names the build to test, build/release by default."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


def build_folder() -> Path:
    return ROOT / os.environ.get("QUELL_BUILD", "build/release")


def emulator_of(build: Path) -> list[str]:
    """What runs the programs of a build for another machine: Wine or qemu. Nothing for this machine's own."""
    if build.name.startswith("windows-"):
        return [str(ROOT / "scripts" / "wine.sh")]
    if build.name.startswith("aarch64-"):
        return ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"]
    return []


class Quell:
    """The tool of a build. Calling it runs it; ok() insists on success."""

    def __init__(self, build: Path) -> None:
        self.emulator = emulator_of(build)
        self.is_windows = build.name.startswith("windows-")
        self.program = build / "bin" / ("quell.exe" if self.is_windows else "quell")
        assert self.program.exists(), f"{self.program} is missing: run make"

    def __call__(self, *args: object, timeout: float = 120, **keywords: object) -> subprocess.CompletedProcess[str]:
        timeout *= 10 if self.emulator else 1
        command = [*self.emulator, str(self.program), *map(str, args)]
        return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False, **keywords)

    def ok(self, *args: object, **keywords: object) -> subprocess.CompletedProcess[str]:
        result = self(*args, **keywords)
        assert result.returncode == 0, result.stderr
        return result

    def fails(self, code: int, *args: object, **keywords: object) -> str:
        """Runs it, checks the exit code and that stderr is one line of `quell: ...`, and returns that line."""
        result = self(*args, **keywords)
        assert result.returncode == code, (result.returncode, result.stderr)
        lines = result.stderr.splitlines()
        assert len(lines) == 1 and lines[0].startswith("quell: "), result.stderr
        return lines[0]


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def build() -> Path:
    return build_folder()


@pytest.fixture(scope="session")
def data() -> Path:
    return ROOT / "tests" / "data"


@pytest.fixture(scope="session")
def quell() -> Quell:
    return Quell(build_folder())


@pytest.fixture(scope="session")
def native() -> Quell:
    """This machine's own build, where `quell` may be one for another machine."""
    build = build_folder()
    return Quell(build.parent / build.name.removeprefix("windows-").removeprefix("aarch64-"))


@pytest.fixture
def own_process(quell: Quell) -> None:
    """For tests that handle the tool's process as POSIX has it: signals, limits, terminals, files of /dev."""
    if quell.emulator:
        pytest.skip("an emulator stands between")


@pytest.fixture
def pictures(quell: Quell) -> None:
    if quell.emulator:
        pytest.skip("cross builds have no OpenImageIO")


def write_exr(path: Path, layers: dict[str, np.ndarray]) -> Path:
    """A single-part multilayer file: 'ViewLayer.Combined' -> [h][w][c], channels named by their number."""
    import OpenEXR

    letters = {1: "V", 3: "RGB", 4: "RGBA"}
    channels = {}
    for name, pixels in layers.items():
        for c, letter in enumerate(letters[pixels.shape[2]]):
            channels[f"{name}.{letter}"] = np.ascontiguousarray(pixels[..., c])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """All channels of all parts, each in its own type."""
    import OpenEXR

    channels: dict[str, np.ndarray] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                channels[name] = np.array(channel.pixels)
    return channels


@pytest.fixture(scope="session")
def exr_writer() -> Callable[[Path, dict[str, np.ndarray]], Path]:
    return write_exr


@pytest.fixture(scope="session")
def exr_reader() -> Callable[[Path], dict[str, np.ndarray]]:
    return read_exr
