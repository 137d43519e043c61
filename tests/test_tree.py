# SPDX-License-Identifier: Apache-2.0
"""Rules about the sources themselves."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path


def test_includes_follow_the_arrows(root: Path) -> None:
    done = subprocess.run(
        [sys.executable, root / "tests" / "check_includes.py"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_header_compiles_alone(root: Path, tmp_path: Path) -> None:
    headers = sorted(p.relative_to(root / "src") for p in root.glob("src/*/*.h") if not p.name.endswith("_tmpl.h"))
    openexr = root / "build" / "third_party" / "openexr" / "include"
    for header in headers:
        source = tmp_path / "one.c"
        source.write_text(f'#include "{header}"\n#include "{header}"\n')
        command = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-D_POSIX_C_SOURCE=200809L", "-fsyntax-only"]
        command += [f"-I{root}/src", f"-I{root}/include", "-isystem", openexr, "-isystem", "/usr/include/cjson", source]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{header}: {done.stderr}"


def test_make_help_lists_the_targets(root: Path) -> None:
    text = subprocess.run(["make", "-s", "help"], cwd=root, capture_output=True, text=True, check=True).stdout
    targets = "all lib cli check test test-long asan ubsan bench bench-peers bench-quick demo install dist clean help"
    for target in [*targets.split(), "format", "lint"]:
        assert re.search(rf"^{target}\b.* {{2,}}\S", text, re.MULTILINE), target
