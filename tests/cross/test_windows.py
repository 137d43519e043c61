# SPDX-License-Identifier: Apache-2.0
"""The Windows build under Wine beside this machine's own: the same bits, Windows' names and paths, what is shipped.

QUELL_BUILD names the Windows build. `make test-windows` runs this.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted(p.stem for p in ROOT.glob("samples/*/*_4spp.exr"))
SYSTEM_LIBRARIES = {"kernel32.dll", "msvcrt.dll"}
CODECS = ["none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab", "htj2k"]
MINGW = "x86_64-w64-mingw32-"


@pytest.fixture(scope="module")
def windows(quell):
    assert quell.is_windows, "set QUELL_BUILD=build/windows-release"
    return quell


def run(*command: object, **keywords: object) -> str:
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **keywords)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def wine_path(path: Path) -> str:
    """As Windows writes it: Wine shows the root folder as drive Z."""
    return "Z:" + str(path).replace("/", "\\")


# ---- What is shipped -------------------------------------------------------------------------------------------------


def listed_symbols() -> set[str]:
    return set(re.findall(r"^\s+(quell_\w+);", (ROOT / "src" / "libquell.map").read_text(), re.MULTILINE))


def imported_libraries(program: Path) -> set[str]:
    return {name.lower() for name in re.findall(r"DLL Name: (\S+)", run(MINGW + "objdump", "-p", program))}


def exported_symbols(program: Path) -> set[str]:
    table = run(MINGW + "objdump", "-p", program).partition("[Ordinal/Name Pointer] Table")[2]
    return set(re.findall(r"^\s*\[\s*\d+\] (\w+)$", table, re.MULTILINE))


def test_library_exports_the_header_and_no_more(build):
    assert exported_symbols(build / "bin" / "quell.dll") == listed_symbols()
    definitions = (build / "lib" / "quell.def").read_text()
    assert set(re.findall(r"^\s+(quell_\w+)", definitions, re.MULTILINE)) == listed_symbols()


def test_nothing_but_windows_is_needed(build):
    assert imported_libraries(build / "bin" / "quell.dll") <= SYSTEM_LIBRARIES
    assert imported_libraries(build / "bin" / "quell.exe") <= SYSTEM_LIBRARIES | {"quell.dll"}


def test_zip_is_complete_and_works(windows, build, data, tmp_path):
    (archive,) = (build / "dist").glob("quell-*-windows-x86_64.zip")
    with zipfile.ZipFile(archive) as file:
        file.extractall(tmp_path)
    folder = tmp_path / archive.stem
    files = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert files >= {"quell.exe", "quell.dll", "quell.h", "libquell.dll.a", "quell.def", "LICENSE", "README.md"}
    assert files >= {"LICENSES/OpenEXR", "LICENSES/cJSON", "LICENSES/mingw-w64"}
    assert "combined" in run(*windows.emulator, folder / "quell.exe", "inspect", data / "45_plain.exr")


def test_programs_link_against_it(windows, build, tmp_path):
    source = ROOT / "samples" / "denoise_buffer.c"
    program = tmp_path / "sample.exe"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-format", "-D__USE_MINGW_ANSI_STDIO=1"]
    run(MINGW + "gcc-posix", *flags, f"-I{ROOT}/include", "-o", program, source, build / "lib" / "libquell.dll.a")
    shutil.copy(build / "bin" / "quell.dll", tmp_path)
    before, after = (float(line.split()[-1]) for line in run(*windows.emulator, program).splitlines())
    assert after < before / 4


def test_wheel_holds_the_library(build):
    (wheel,) = (build / "wheel").glob("*.whl")
    assert wheel.name.endswith("-py3-none-win_amd64.whl")
    with zipfile.ZipFile(wheel) as file:
        assert file.read("quell/quell.dll") == (build / "bin" / "quell.dll").read_bytes()
        assert not [name for name in file.namelist() if name.endswith(".so")]


# ---- The same bits ---------------------------------------------------------------------------------------------------


def assert_same_output(windows, native, tmp_path: Path, *arguments: object) -> None:
    """The whole file: pixels, and every byte of header and chunks."""
    ours, theirs = tmp_path / "linux.exr", tmp_path / "windows.exr"
    native.ok("denoise", *arguments, "-q", "-o", ours)
    windows.ok("denoise", *arguments, "-q", "-o", theirs)
    assert ours.read_bytes() == theirs.read_bytes()


@pytest.mark.parametrize("name", SAMPLES)
def test_samples(windows, native, tmp_path, name):
    assert_same_output(windows, native, tmp_path, ROOT / "samples" / name.removesuffix("_4spp") / f"{name}.exr")


@pytest.mark.parametrize("cpu", ["c", "avx2", "avx512", "avx512bf16"])
def test_instruction_sets(windows, native, data, tmp_path, cpu):
    if cpu not in native.ok("--version", "-v").stdout.split():
        pytest.skip(f"this machine has no {cpu}")
    assert_same_output(windows, native, tmp_path, data / "45_all_two_layers.exr", "--cpu", cpu)


@pytest.mark.parametrize("codec", CODECS)
def test_codecs(windows, native, data, tmp_path, codec):
    assert_same_output(windows, native, tmp_path, data / "45_plain.exr", "--codec", codec)


@pytest.mark.parametrize("name", ["50_all", "45_b44", "52_htj2k", "50_pxr24", "45_stereo"])
def test_fixtures(windows, native, data, tmp_path, name):
    assert_same_output(windows, native, tmp_path, data / f"{name}.exr")


def test_lossy_dwa_decodes_to_rounding(windows, native, data, tmp_path):
    """OpenEXR's DWA decoder has other vector code on Windows: a value may differ in the last bit of a half."""
    ours, theirs = tmp_path / "linux.exr", tmp_path / "windows.exr"
    native.ok("denoise", data / "45_dwaa.exr", "-q", "-o", ours)
    windows.ok("denoise", data / "45_dwaa.exr", "-q", "-o", theirs)
    layers = json.loads(native.ok("compare", theirs, ours, "--json").stdout)["layers"]
    assert layers and all(layer["rel_mse"] < 1e-6 for layer in layers)


def test_comparing(windows, native, data):
    arguments = ["compare", data / "50_all.exr", data / "50_pxr24.exr", "--json"]
    ours, theirs = (json.loads(tool.ok(*arguments).stdout)["layers"] for tool in (native, windows))
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        assert a["name"] == b["name"]
        for measure in ("mse", "rel_mse", "psnr", "ssim", "gmsd"):
            # Equal but for the system's exp. PSNR is null for equal layers.
            assert a[measure] == b[measure] or a[measure] == pytest.approx(b[measure], rel=1e-12)


# ---- Windows' names --------------------------------------------------------------------------------------------------


def test_names_in_any_script(windows, data, tmp_path):
    folder = tmp_path / "Räume für 日本 Ω"
    folder.mkdir()
    source, weights = folder / "küche_0007.exr", folder / "Gewichte ж.qwt"
    shutil.copy(data / "45_plain.exr", source)
    shutil.copy(ROOT / "weights" / "quell-balanced.qwt", weights)
    report = folder / "Bericht é.json"
    pattern = folder / "{name} 清潔_######.exr"
    done = windows.ok("denoise", source, "-o", pattern, "--model", weights, "--report", report)
    output = folder / "küche_0007 清潔_000007.exr"
    assert output.exists() and str(output) in done.stdout
    assert json.loads(report.read_text(encoding="utf-8"))["files"][0]["output"] == str(output)
    assert "fehlt ß.exr: cannot be opened" in windows.fails(3, "inspect", folder / "fehlt ß.exr")


def test_drives_and_backslashes(windows, data, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "new").mkdir()
    source = wine_path(data / "45_plain.exr")
    windows.ok("denoise", source, "-q", "-o", wine_path(tmp_path / "out"))
    windows.ok("denoise", source, "-q", "-o", wine_path(tmp_path / "out") + "\\{name}_clean.exr")
    windows.ok("denoise", source, "-q", "-o", wine_path(tmp_path / "new") + "\\")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["45_plain.exr", "45_plain_clean.exr"]
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["45_plain.exr"]


def test_wildcards_are_expanded(windows, data, tmp_path):
    for number in (1, 2):
        shutil.copy(data / "45_plain.exr", tmp_path / f"frame_{number}.exr")
    windows.ok("denoise", "frame_*.exr", "-q", "-o", "{name}_clean.exr", cwd=tmp_path)
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["frame_1.exr", "frame_1_clean.exr", "frame_2.exr", "frame_2_clean.exr"]


def test_long_names(windows, data, tmp_path):
    folder = tmp_path
    while len(str(folder)) < 300:
        folder = folder / ("deep_" + "x" * 60)
    folder.mkdir(parents=True)
    shutil.copy(data / "45_plain.exr", folder / "in.exr")
    windows.ok("denoise", folder / "in.exr", "-q", "-o", folder / "out.exr")
    assert sorted(p.name for p in folder.iterdir()) == ["in.exr", "out.exr"]


def test_file_that_is_read_can_be_replaced(windows, native, data, tmp_path):
    source, expected = tmp_path / "a.exr", tmp_path / "expected.exr"
    shutil.copy(data / "50_all.exr", source)
    native.ok("denoise", source, "-q", "-o", expected)
    windows.ok("denoise", source, "-q", "-o", source)
    assert source.read_bytes() == expected.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "expected.exr"]


def test_read_only_file_stays(windows, data, tmp_path):
    target = tmp_path / "out.exr"
    target.write_bytes(b"precious")
    target.chmod(0o444)
    line = windows.fails(6, "denoise", data / "45_plain.exr", "-q", "-o", target)
    assert "may not be written" in line
    assert target.read_bytes() == b"precious"
    assert [p.name for p in tmp_path.iterdir()] == ["out.exr"]


def test_pictures_are_refused_in_plain_words(windows, data, tmp_path):
    line = windows.fails(6, "preview", data / "45_plain.exr", "-o", tmp_path / "a.png")
    assert "OpenImageIO" in line and list(tmp_path.iterdir()) == []


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_control_c(windows, tmp_path, exr_writer):
    rng = np.random.default_rng(1)
    source = exr_writer(tmp_path / "slow.exr", {"ViewLayer.Combined": rng.random((1600, 2400, 4), np.float32)})
    command = [*windows.emulator, windows.program, "denoise", source, "--cpu", "c", "--threads", "1", "-o", "out.exr"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    while process.poll() is None and cpu_seconds(process.pid) < 2.0:  # well past Wine's own start
        time.sleep(0.1)
    assert process.poll() is None, "the job was too short to be interrupted"
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "cancelled; nothing was written" in stderr
    assert [p.name for p in tmp_path.iterdir()] == ["slow.exr"]
