# SPDX-License-Identifier: Apache-2.0
"""Bad files and bad targets: a status, one line that names the file, and nothing left behind or overwritten."""

from __future__ import annotations

import os
import random
import shutil
import stat
import subprocess
from pathlib import Path

import pytest
from exr_tools import DATA, Tool

NOT_FOUND, READ, WRITE, NOT_EXR, UNSUPPORTED, LIMIT = 4, 5, 6, 7, 8, 12


def assert_fails(tool: Tool, code: int | set[int], source: Path, target: Path, *options: object) -> str:
    before = target.read_bytes() if target.is_file() else None
    result = tool(*options, source, target)
    codes = code if isinstance(code, set) else {code}
    assert result.code in codes, (result.code, result.err)
    lines = [line for line in result.err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert (target.read_bytes() if target.is_file() else None) == before
    if target.parent.is_dir():
        assert not list(target.parent.glob(".quell-*"))
    return lines[0]


@pytest.mark.parametrize("name", ["45_zips_float.exr", "50_all.exr", "45_dwaa.exr", "52_htj2k.exr", "50_b44.exr"])
def test_truncated(checked_tool: Tool, tmp_path: Path, name: str) -> None:
    whole = (DATA / name).read_bytes()
    source, target = tmp_path / "cut.exr", tmp_path / "out.exr"
    target.write_bytes(b"precious")
    rng = random.Random(name)
    cuts = [0, 1, 3, 4, 7, 8, 9, 100, len(whole) // 2, len(whole) - 1] + [rng.randrange(len(whole)) for _ in range(20)]
    for cut in cuts:
        source.write_bytes(whole[:cut])
        line = assert_fails(checked_tool, {READ, NOT_EXR}, source, target, "--mark", "all")
        assert str(source) in line, line


def test_not_an_exr(tool: Tool, tmp_path: Path) -> None:
    source, target = tmp_path / "in.exr", tmp_path / "out.exr"
    for content in (b"", b"v", b"\x89PNG\r\n\x1a\n" * 100, os.urandom(5000)):
        source.write_bytes(content)
        assert str(source) in assert_fails(tool, NOT_EXR, source, target)


def test_missing_input(tool: Tool, tmp_path: Path) -> None:
    source = tmp_path / "none.exr"
    assert str(source) in assert_fails(tool, NOT_FOUND, source, tmp_path / "out.exr")


def test_folder_and_pipe_as_input(tool: Tool, tmp_path: Path) -> None:
    assert "is a folder" in assert_fails(tool, READ, tmp_path, tmp_path / "out.exr")
    os.mkfifo(tmp_path / "pipe")
    assert "device or pipe" in assert_fails(tool, READ, tmp_path / "pipe", tmp_path / "out.exr")


def test_unreadable_input(tool: Tool, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may read everything")
    source = tmp_path / "in.exr"
    shutil.copy(DATA / "45_plain.exr", source)
    source.chmod(0)
    assert str(source) in assert_fails(tool, READ, source, tmp_path / "out.exr")


def test_missing_folder(tool: Tool, tmp_path: Path) -> None:
    target = tmp_path / "none" / "out.exr"
    line = assert_fails(tool, NOT_FOUND, DATA / "45_plain.exr", target)
    assert str(target) in line and "folder" in line


def test_folder_or_device_as_output(tool: Tool, tmp_path: Path) -> None:
    assert "folder" in assert_fails(tool, WRITE, DATA / "45_plain.exr", tmp_path)
    result = tool(DATA / "45_plain.exr", f"{tmp_path}/none/")
    assert result.code == WRITE and "folder" in result.err
    os.mkfifo(tmp_path / "pipe")
    assert "device or pipe" in assert_fails(tool, WRITE, DATA / "45_plain.exr", tmp_path / "pipe")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_read_only_output(tool: Tool, tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everything")
    target = tmp_path / "out.exr"
    target.write_bytes(b"precious")
    target.chmod(0o444)
    assert str(target) in assert_fails(tool, WRITE, DATA / "45_plain.exr", target)


def test_full_disk(tool: Tool, tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    folder = tmp_path / "small"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=48k", "tmpfs", folder], check=False)
    if mounted.returncode != 0:
        pytest.skip("this machine does not let root mount a tmpfs")
    try:
        target = folder / "out.exr"
        target.write_bytes(b"precious")
        for options in ((), ("--mark", "all"), ("--mark", "all", "--codec", "1")):
            line = assert_fails(tool, WRITE, DATA / "45_none.exr", target, *options)
            assert str(target) in line and "disk is full" in line
        assert [p.name for p in folder.iterdir()] == ["out.exr"]
    finally:
        subprocess.run(["umount", folder], check=True)


@pytest.mark.parametrize(
    "name",
    ["45_beauty_guides.exr", "45_plain.exr", "50_stereo.exr", "45_dwaa.exr", "50_dwab.exr", "45_b44.exr",
     "50_pxr24.exr", "52_htj2k.exr", "45_rle.exr", "45_none.exr", "conv_tiled.exr", "45_stereo.exr"],
)  # fmt: skip
def test_damage_never_crashes(checked_tool: Tool, tmp_path: Path, name: str) -> None:
    """Random bytes anywhere, and random bytes in the header alone: any status but a crash, a hang or a leak."""
    whole = (DATA / name).read_bytes()
    source, target = tmp_path / "bad.exr", tmp_path / "out.exr"
    rng = random.Random(int(os.environ.get("QUELL_TEST_SEED", "1")) * 1000 + len(whole))
    for i in range(int(os.environ.get("QUELL_TEST_MUTATIONS", "25"))):
        damaged = bytearray(whole)
        end = len(damaged) if i % 2 else min(len(damaged), 3000)
        for _ in range(rng.choice((1, 2, 8, 64))):
            damaged[rng.randrange(8, end)] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        source.write_bytes(damaged)
        limits = {"ASAN_OPTIONS": "allocator_may_return_null=1:max_allocation_size_mb=2000"}
        result = checked_tool("--all", "--list", "--noisy", "--mark", "all", source, target, env=limits)
        if result.code != 0 and not (result.code < 20 and "error: " in result.err):
            keep = Path(os.environ.get("QUELL_TEST_KEEP", tmp_path)) / f"crash_{name}_{i}.exr"
            keep.write_bytes(damaged)
            pytest.fail(f"{keep}: {result.code}\n{result.err[-3000:]}")
        assert not list(tmp_path.glob(".quell-*"))
