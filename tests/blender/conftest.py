# SPDX-License-Identifier: Apache-2.0
"""Real Blenders: Debian's executable, and every module that scripts/install_blenders.sh has put into build/blender."""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
INSIDE = Path(__file__).resolve().parent / "inside"
TIMEOUT = 900


@dataclass(frozen=True)
class Blender:
    """command: what starts a script, given as its next argument."""

    name: str
    command: tuple[str, ...]
    is_extension: bool

    def run(self, script: Path, *arguments: object, home: Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """Runs a script of this folder, with settings and add-ons of its own below `home`."""
        return subprocess.run(
            [*self.command, str(script), "--", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=TIMEOUT,
            env={**os.environ, "BLENDER_USER_RESOURCES": str(home), **variables},
        )


def find_blenders() -> list[Blender]:
    found = []
    if shutil.which("blender"):
        text = subprocess.run(["blender", "--version"], capture_output=True, text=True).stdout
        version = text.split()[1] if text.startswith("Blender ") else "unknown"
        is_extension = tuple(map(int, version.split(".")[:2])) >= (4, 2)
        found.append(Blender(version, ("blender", "-b", "--factory-startup", "-P"), is_extension))
    for python in sorted((ROOT / "build" / "blender").glob("*/bin/python")):
        found.append(Blender(python.parents[1].name, (str(python),), is_extension=True))
    return found


BLENDERS = find_blenders()


@functools.cache
def run_checks(blender: Blender, addon: Path, work: Path) -> dict[str, str]:
    """All of inside/checks.py in one Blender: {check: "ok" | traceback}."""
    work.mkdir(parents=True)
    done = blender.run(INSIDE / "checks.py", addon, work, home=work / "home")
    results = work / "results.json"
    assert results.exists(), f"Blender ended with {done.returncode}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    # 1 is the add-on's word, in an executable, that some of the frames failed: the checks make some fail.
    expected = 1 if blender.command[0] == "blender" else 0
    assert done.returncode == expected, f"Blender died at its end ({done.returncode}):\n{done.stderr[-3000:]}"
    return json.loads(results.read_text())


@pytest.fixture(scope="session", params=BLENDERS, ids=lambda blender: blender.name)
def blender(request) -> Blender:
    return request.param


@pytest.fixture(scope="session")
def addon(blender, build) -> Path:
    """The zip for this Blender."""
    zips = sorted((build / "addon").glob("*.zip"))
    assert len(zips) == 2, f"no add-on in {build / 'addon'}: run make addon"
    return zips[0 if "legacy" in zips[0].name and not blender.is_extension else 1]


@pytest.fixture(scope="session")
def work(blender, addon, tmp_path_factory) -> Path:
    """Folder with what the checks rendered."""
    folder = tmp_path_factory.getbasetemp() / f"blender-{blender.name}"
    run_checks(blender, addon, folder)
    return folder


@pytest.fixture(scope="session")
def results(blender, addon, work) -> dict[str, str]:
    return run_checks(blender, addon, work)
