# SPDX-License-Identifier: Apache-2.0
"""The test tool, plain and under sanitizers."""

from __future__ import annotations

import os
import subprocess

import pytest
from exr_tools import ROOT, Tool, build_tool


@pytest.fixture(scope="session")
def openexr_core() -> None:
    script = ROOT / "scripts" / "build_openexr.sh"
    environment = {k: v for k, v in os.environ.items() if k not in ("CFLAGS", "CXXFLAGS", "MAKEFLAGS")}
    subprocess.run([script, ROOT / "build" / "third_party" / "openexr"], check=True, env=environment)


@pytest.fixture(scope="session")
def tool(openexr_core: None, tmp_path_factory: pytest.TempPathFactory) -> Tool:
    return Tool(build_tool(tmp_path_factory.mktemp("tool"), "-O2"))


@pytest.fixture(scope="session")
def checked_tool(openexr_core: None, tmp_path_factory: pytest.TempPathFactory) -> Tool:
    """The same under the address and undefined-behaviour sanitizers."""
    folder = tmp_path_factory.mktemp("checked_tool")
    return Tool(build_tool(folder, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"))
