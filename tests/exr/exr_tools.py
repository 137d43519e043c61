# SPDX-License-Identifier: Apache-2.0
"""The tool that the tests of src/exr drive, and a reader of what it wrote that is not ours."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"


@dataclass
class Result:
    code: int
    out: str
    err: str


class Tool:
    """exr_copy; see its first lines for the options."""

    def __init__(self, program: Path) -> None:
        self.program = program

    def __call__(self, *args: object, env: dict[str, str] | None = None, timeout: float = 120) -> Result:
        done = subprocess.run(
            [str(self.program), *map(str, args)],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout,
            env={**os.environ, **(env or {})},
            check=False,
        )
        return Result(done.returncode, done.stdout, done.stderr)

    def ok(self, *args: object) -> Result:
        result = self(*args)
        assert result.code == 0, result.err
        return result


def build_tool(folder: Path, *flags: str) -> Path:
    """Compiles the tool with what of the library it needs, so that it can have sanitizers of its own."""
    openexr = ROOT / "build" / "third_party" / "openexr"
    program = folder / "exr_copy"
    sources = [ROOT / "tests" / "exr" / "exr_copy.c"]
    for name in ("exr", "frame", "base"):
        sources += sorted(p for p in (ROOT / "src" / name).glob("*.c") if not p.stem.endswith("_windows"))
    command = [os.environ.get("CC", "cc"), "-std=c11", "-D_POSIX_C_SOURCE=200809L", "-g", *flags]
    command += [f"-I{ROOT}/include", f"-I{ROOT}/src", "-isystem", f"{openexr}/include", "-o", str(program)]
    command += [str(source) for source in sources] + (openexr / "link.flags").read_text().split()
    subprocess.run(command, check=True)
    return program


@dataclass
class Part:
    header: dict[str, object]
    channels: dict[str, np.ndarray]


def read(path: Path) -> list[Part]:
    """Every part with its header and channels in their own types, by OpenEXR's Python module."""
    import OpenEXR

    parts = []
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            channels = {name: np.array(channel.pixels) for name, channel in part.channels.items()}
            parts.append(Part(dict(part.header), channels))
    return parts


def bits(pixels: np.ndarray) -> np.ndarray:
    """The same pixels as integers: NaN equals NaN, and -0 is not 0."""
    return np.ascontiguousarray(pixels).view({2: np.uint16, 4: np.uint32}[pixels.dtype.itemsize])


def plain(value: object) -> object:
    """A header value in a form that compares with ==."""
    if isinstance(value, np.ndarray):
        return ("array", str(value.dtype), value.tolist())
    if isinstance(value, (tuple, list)):
        return [plain(v) for v in value]
    if isinstance(value, (str, bytes, int, float, bool)):
        return value
    return str(value)
