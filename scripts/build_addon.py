#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Packs the Blender add-on from one source, around the wheel of one platform.

    build_addon.py --wheel build/release/wheel/quell-0.1.0-py3-none-manylinux_2_36_x86_64.whl --out build/release/addon

makes quell-VERSION-PLATFORM.zip, an extension for Blender 4.2 and later with the wheel inside, and
quell-VERSION-PLATFORM-legacy.zip, an add-on for 3.4 to 4.1 with the wheel's package unpacked in its folder vendor/.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import zipfile
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "blender_addon"

# The folder that 3.4 to 4.1 import as a module: not "quell", which is the package.
LEGACY_MODULE = "quell_denoiser"

# End of a wheel's platform tag -> Blender's name.
PLATFORMS = {
    "x86_64": "linux-x64",
    "aarch64": "linux-arm64",
    "win_amd64": "windows-x64",
    "win_arm64": "windows-arm64",
    "macosx_x86_64": "macos-x64",
    "macosx_arm64": "macos-arm64",
}


def platform_of(wheel: Path) -> str:
    tag = wheel.stem.split("-")[-1]
    key = re.sub(r"^macosx_\d+_\d+_", "macosx_", tag)
    for end, name in sorted(PLATFORMS.items(), key=lambda item: -len(item[0])):
        if key.endswith(end):
            return name
    sys.exit(f"{wheel.name}: Blender has no name for the platform {tag}")


def addon_version() -> str:
    """That of bl_info, which Blender reads without running the file."""
    for node in ast.parse((SOURCE / "__init__.py").read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "bl_info":
            return ".".join(map(str, ast.literal_eval(node.value)["version"]))
    sys.exit("blender_addon/__init__.py has no bl_info")


def source_files() -> dict[str, bytes]:
    """Name in the zip -> content; without the manifest, which is rendered."""
    return {
        path.relative_to(SOURCE).as_posix(): path.read_bytes()
        for path in sorted(SOURCE.rglob("*"))
        if path.is_file() and path.suffix in {".py", ".md", ""} and "__pycache__" not in path.parts
    }


def pack(path: Path, files: dict[str, bytes]) -> None:
    """The same files make the same bytes: all are of one date."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, required=True, help="the package for one platform")
    parser.add_argument("--out", type=Path, required=True, help="folder for the two zip files")
    arguments = parser.parse_args()

    wheel: Path = arguments.wheel
    version = wheel.name.split("-")[1]
    if version != addon_version():
        sys.exit(f"the wheel is of version {version}, bl_info of {addon_version()}: they must be the same")
    platform = platform_of(wheel)
    arguments.out.mkdir(parents=True, exist_ok=True)
    name = f"quell-{version}-{platform}"

    manifest = (SOURCE / "blender_manifest.toml").read_text()
    for key, value in (("VERSION", version), ("PLATFORM", platform), ("WHEEL", wheel.name)):
        manifest = manifest.replace(f"@{key}@", value)
    extension = {"blender_manifest.toml": manifest.encode(), **source_files()}
    extension[f"wheels/{wheel.name}"] = wheel.read_bytes()
    pack(arguments.out / f"{name}.zip", extension)

    legacy = {f"{LEGACY_MODULE}/{path}": content for path, content in source_files().items()}
    legacy[f"{LEGACY_MODULE}/vendor/__init__.py"] = b""
    with zipfile.ZipFile(wheel) as archive:
        for path in archive.namelist():
            if path.startswith("quell/") and not path.endswith("/"):
                legacy[f"{LEGACY_MODULE}/vendor/{path}"] = archive.read(path)
            elif "/licenses/" in path and not path.endswith("/"):
                legacy[f"{LEGACY_MODULE}/vendor/licenses/{Path(path).name}"] = archive.read(path)
    pack(arguments.out / f"{name}-legacy.zip", legacy)


if __name__ == "__main__":
    main()
