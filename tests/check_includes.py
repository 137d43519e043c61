#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that includes go only where the arrows of docs/ARCHITECTURE.md point.

A folder may include itself, base, quell.h and whatever its arrows lead to, directly or through other folders.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ARROWS: dict[str, tuple[str, ...]] = {
    "base": (),
    "kernels": ("base",),
    "frame": ("kernels", "base"),
    "exr": ("frame",),
    "nn": ("kernels",),
    "models": ("nn", "frame"),
    "filter": ("kernels", "frame"),
    "plan": ("frame",),
    "metrics": ("frame", "kernels"),
    "denoise": ("plan", "models", "filter", "metrics"),
    "api": ("denoise", "plan", "exr", "metrics", "frame"),
    "cli": (),  # quell.h alone
}
# Headers from outside that only one folder may know.
OWNERS = {"OpenEXR/": "exr", "OpenImageIO/": "cli", "cJSON.h": "cli", "immintrin.h": "kernels", "arm_neon.h": "kernels"}
# cli is a program of its own, not a part of the library.
WITHOUT_BASE = {"cli"}


def reachable(folder: str) -> set[str]:
    seen = {folder} if folder in WITHOUT_BASE else {folder, "base"}
    queue = list(ARROWS[folder])
    while queue:
        name = queue.pop()
        if name not in seen:
            seen.add(name)
            queue += ARROWS[name]
    return seen


def problems_of(path: Path) -> list[str]:
    folder = path.parent.name
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        match = re.match(r'\s*#\s*include\s*(["<])([^">]+)[">]', line)
        if not match:
            continue
        quoted, name = match.group(1) == '"', match.group(2)
        where = f"{path.relative_to(ROOT)}:{number}"
        for header, owner in OWNERS.items():
            if name.startswith(header) and folder != owner:
                found.append(f"{where}: <{name}> belongs to src/{owner}")
        if not quoted or name == "quell.h":
            continue
        target = name.split("/")[0] if "/" in name else folder
        if target not in reachable(folder):
            found.append(f"{where}: {folder} may not include {target}")
    return found


def main() -> int:
    folders = sorted(p.name for p in (ROOT / "src").iterdir() if p.is_dir())
    problems = [f"src/{name} is not in the table of tests/check_includes.py" for name in folders if name not in ARROWS]
    for path in sorted((ROOT / "src").glob("*/*")):
        if path.suffix in (".c", ".h", ".cpp") and path.parent.name in ARROWS:
            problems += problems_of(path)
    print("\n".join(problems) if problems else f"{len(folders)} folders: the arrows hold")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
