# SPDX-License-Identifier: Apache-2.0
"""Every way to fail: one line that names the file, a documented exit code, and an existing output left as it was."""

from __future__ import annotations

import os
import pty
import resource
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

OLD = b"the previous result"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An output that exists already."""
    folder = tmp_path / "out"
    folder.mkdir()
    path = folder / "result.exr"
    path.write_bytes(OLD)
    return path


def assert_untouched(out: Path) -> None:
    assert out.read_bytes() == OLD
    assert [p.name for p in out.parent.iterdir()] == [out.name]  # no temporary file is left


def test_missing_file(quell, out):
    line = quell.fails(3, "denoise", "/no/such/file.exr", "-o", out)
    assert line.startswith("quell: /no/such/file.exr: ")
    assert_untouched(out)
    for command in ("inspect", "compare", "preview"):
        more = {"inspect": [], "compare": ["/no/such/file.exr"], "preview": ["-o", out]}[command]
        assert "/no/such/file.exr" in quell.fails(3, command, "/no/such/file.exr", *more)
    assert_untouched(out)


@pytest.mark.parametrize("keep", [0.05, 0.5, 0.98])
@pytest.mark.parametrize("name", ["50_all.exr", "45_piz.exr"])
def test_truncated(quell, data, out, tmp_path, name, keep):
    short = tmp_path / "short.exr"
    content = (data / name).read_bytes()
    short.write_bytes(content[: int(len(content) * keep)])
    line = quell.fails(4, "denoise", short, "-o", out)
    assert "short.exr" in line
    assert_untouched(out)


@pytest.mark.parametrize("content", [b"", b"no", b"PNG and so on" * 100], ids=["empty", "short", "text"])
def test_not_an_exr(quell, out, tmp_path, content):
    path = tmp_path / "picture.exr"
    path.write_bytes(content)
    line = quell.fails(4, "denoise", path, "-o", out)
    assert "picture.exr" in line and "OpenEXR" in line
    assert_untouched(out)


def test_folder_as_input(quell, out, tmp_path):
    assert "folder" in quell.fails(4, "denoise", tmp_path, "-o", out)


def test_tiled_file(quell, data, out):
    assert "tiled" in quell.fails(4, "denoise", data / "conv_tiled.exr", "-o", out)


def test_nothing_to_denoise(quell, out, tmp_path, exr_writer):
    path = exr_writer(tmp_path / "data.exr", {"ViewLayer.Depth": np.ones((8, 8, 1), np.float32)})
    line = quell.fails(5, "denoise", path, "-o", out)
    assert "data.exr" in line and "nothing to denoise" in line
    assert_untouched(out)
    assert "ViewLayer.Depth" in quell.ok("inspect", path).stdout  # but it can be looked at


def test_layer_that_is_not_there(quell, data, out, tmp_path):
    line = quell.fails(5, "denoise", data / "45_plain.exr", "--layers", "Glitter", "-o", out)
    assert "Glitter" in line and "45_plain.exr" in line
    assert "Glitter" in quell.fails(5, "preview", data / "45_plain.exr", "--layer", "Glitter", "-o", tmp_path / "x.png")
    assert_untouched(out)


def test_sizes_differ(quell, tmp_path, exr_writer):
    a = exr_writer(tmp_path / "a.exr", {"ViewLayer.Combined": np.ones((8, 9, 4), np.float32)})
    b = exr_writer(tmp_path / "b.exr", {"ViewLayer.Combined": np.ones((8, 10, 4), np.float32)})
    line = quell("compare", a, b)
    assert line.returncode == 8
    assert "a.exr" in line.stderr and "9 x 8" in line.stderr and "10 x 8" in line.stderr
    assert quell("preview", a, b, "-o", tmp_path / "x.png").returncode == 8
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize("content", [b"", b"x" * 5000], ids=["empty", "garbage"])
def test_wrong_weight_file(quell, data, out, tmp_path, content):
    weights = tmp_path / "wrong.qwt"
    weights.write_bytes(content)
    line = quell.fails(7, "denoise", data / "45_plain.exr", "--model", weights, "-o", out)
    assert "wrong.qwt" in line
    assert_untouched(out)


def test_damaged_weight_file(quell, data, out, tmp_path, root):
    content = bytearray((root / "weights" / "quell-balanced.qwt").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "damaged.qwt").write_bytes(content)
    assert "damaged" in quell.fails(7, "denoise", data / "45_plain.exr", "--model", tmp_path / "damaged.qwt", "-o", out)


def test_model_that_is_not_there(quell, data, out):
    assert "quell-imaginary" in quell.fails(7, "denoise", data / "45_plain.exr", "-m", "quell-imaginary", "-o", out)


def test_output_folder_missing(quell, data, tmp_path):
    line = quell.fails(3, "denoise", data / "45_plain.exr", "-o", tmp_path / "nowhere" / "x.exr")
    assert "nowhere/x.exr" in line and "folder" in line
    assert list(tmp_path.iterdir()) == []


def test_full_disk(quell, data, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], capture_output=True, check=False)
    if mount.returncode != 0:
        pytest.skip("mounting a tmpfs needs root")
    try:
        (disk / "result.exr").write_bytes(OLD)
        line = quell.fails(6, "denoise", data / "45_none.exr", "-o", disk / "result.exr")
        assert "result.exr" in line
        assert_untouched(disk / "result.exr")
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.usefixtures("own_process")
def test_file_size_limit(quell, data, out):
    """The same path as a full disk, without root."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))

    line = quell.fails(6, "denoise", data / "45_none.exr", "-o", out, preexec_fn=limit)
    assert "result.exr" in line
    assert_untouched(out)


def test_too_little_memory(quell, data, out, tmp_path, exr_writer):
    big = exr_writer(tmp_path / "big.exr", {"ViewLayer.Combined": np.ones((512, 512, 4), np.float32)})
    line = quell.fails(9, "denoise", big, "--max-memory", "1", "-o", out)
    assert "big.exr" in line
    assert_untouched(out)


@pytest.mark.parametrize(
    "arguments",
    [
        ["denoise"],
        ["denoise", "a.exr"],
        ["denoise", "-o", "b.exr"],
        ["denoise", "a.exr", "-o", "b.exr", "--threads", "many"],
        ["denoise", "a.exr", "-o", "b.exr", "--threads", "-1"],
        ["denoise", "a.exr", "-o", "b.exr", "--codec", "jpeg"],
        ["denoise", "a.exr", "-o", "b.exr", "--max-memory", "0"],
        ["denoise", "a.exr", "-o", "b.exr", "--cpu", "z80"],
        ["denoise", "a.exr", "-o", "b.exr", "--precision", "half"],
        ["denoise", "a.exr", "-o", "b.exr", "--tile", "x"],
        ["denoise", "a.exr", "-o", "b.exr", "--no-such-option"],
        ["denoise", "a.exr", "-o", "x_####.exr"],
        ["inspect"],
        ["compare", "a.exr"],
        ["compare", "a", "b", "c", "d"],
        ["preview", "a.exr"],
        ["preview", "a.exr", "-o", "b.png", "--exposure", "bright"],
        ["preview", "a.exr", "-o", "b.png", "--crop", "10"],
        ["enhance"],
        [],
    ],
    ids=" ".join,
)
def test_wrong_use(quell, arguments, tmp_path):
    result = quell(*arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stdout == "" and result.stderr != ""
    assert list(tmp_path.iterdir()) == []


def slow_job(tmp_path: Path, exr_writer) -> list[str]:
    rng = np.random.default_rng(1)
    path = exr_writer(tmp_path / "slow.exr", {"ViewLayer.Combined": rng.random((1600, 2400, 4), np.float32)})
    return ["denoise", str(path), "--cpu", "c", "--threads", "1"]


@pytest.mark.usefixtures("own_process")
def test_interrupt(quell, out, tmp_path, exr_writer):
    arguments = slow_job(tmp_path, exr_writer)
    process = subprocess.Popen([quell.program, *arguments, "-o", out], stderr=subprocess.PIPE, text=True)
    time.sleep(1.5)
    assert process.poll() is None, "the job was too short to be interrupted"
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=20)
    assert process.returncode == 130
    assert stderr.splitlines()[-1].startswith(f"quell: {tmp_path}/slow.exr: cancelled")
    assert_untouched(out)


@pytest.mark.usefixtures("own_process")
def test_progress_bar_on_a_terminal(quell, data, tmp_path):
    leader, follower = pty.openpty()
    subprocess.run(
        [quell.program, "denoise", data / "50_all.exr", "-o", tmp_path / "x.exr"],
        stderr=follower,
        stdout=subprocess.PIPE,
        env={**os.environ, "TERM": "xterm"},
        check=True,
    )
    os.close(follower)
    shown = os.read(leader, 100000).decode()
    os.close(leader)
    assert "[---" in shown and "100 %" in shown and shown.endswith("\r\x1b[K")


@pytest.mark.usefixtures("own_process")
def test_broken_standard_output(quell, data):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [quell.program, "inspect", data / "45_plain.exr"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 6 and "standard output" in done.stderr


@pytest.mark.usefixtures("own_process")
def test_no_permission(quell, data, tmp_path):
    if os.getuid() == 0:
        pytest.skip("root may write everywhere")
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o500)
    quell.fails(6, "denoise", data / "45_plain.exr", "-o", folder / "x.exr")
    shutil.rmtree(folder)
