# SPDX-License-Identifier: Apache-2.0
"""The part of the add-on that needs no Blender, and the zip files."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def addon(root, build):
    """blender_addon.io as a package, with the wheel's quell beside it."""
    sys.path[:0] = [str(build / "wheel" / "site"), str(root)]
    for name in ("command", "job", "journal", "memory"):
        importlib.import_module(f"blender_addon.io.{name}")
    return sys.modules["blender_addon.io"]


def no_progress(_fraction: float) -> None:
    return None


class Canvas:
    """A view layer in memory that notes what is written."""

    def __init__(self, addon, names: dict[str, int], is_denoised: bool = False) -> None:
        random = np.random.default_rng(3)
        self.pixels = {name: random.random((32, 40, channels), np.float32) for name, channels in names.items()}
        self.written: dict[str, np.ndarray] = {}
        passes = [
            addon.memory.RenderPass(
                name,
                channels,
                read=lambda name=name: self.pixels[name].copy(),
                write=lambda pixels, name=name: self.written.update({name: pixels}),
            )
            for name, channels in names.items()
        ]
        self.layer = addon.memory.RenderLayer(
            "View.Layer", "", 4, is_denoised, passes, fill=lambda name, pixels: self.written.update({name: pixels})
        )

    def denoise(self, addon, **settings):
        plain = addon.settings.Settings(threads=1, **settings)
        return addon.memory.denoise_layers([self.layer], (40, 32), plain, no_progress)


GUIDED = {"Combined": 4, "Denoising Albedo": 3, "Denoising Normal": 3, "Depth": 1, "UV": 3}


def test_memory_replaces_what_was_denoised_alone(addon):
    canvas = Canvas(addon, GUIDED)
    outcome, noisy = canvas.denoise(addon)
    assert set(canvas.written) == {"Combined"}
    assert np.array_equal(noisy, canvas.pixels["Combined"])
    assert outcome.denoised == ["View.Layer.Combined"] and not outcome.notes
    assert outcome.summary().startswith("Denoised 1 pass in ")
    assert set(outcome.seconds) == {"set up", "read", "denoise", "write"}


def test_memory_keeps_the_noisy_one(addon):
    canvas = Canvas(addon, GUIDED)
    canvas.denoise(addon, keep_noisy=True)
    assert np.array_equal(canvas.written["Quell Noisy"], canvas.pixels["Combined"])


def test_memory_copies_the_picture_before_only_where_it_is_wanted(addon):
    canvas = Canvas(addon, GUIDED)
    plain = addon.settings.Settings(threads=1, keep_noisy=True)
    _, before = addon.memory.denoise_layers([canvas.layer], (40, 32), plain, no_progress, wants_before=False)
    assert before is None
    assert np.array_equal(canvas.written["Quell Noisy"], canvas.pixels["Combined"])
    _, before = canvas.denoise(addon)
    assert np.array_equal(before, canvas.pixels["Combined"])


def test_memory_makes_a_pass_of_its_own(addon):
    plain, own = Canvas(addon, GUIDED), Canvas(addon, GUIDED)
    plain.denoise(addon)
    own.denoise(addon, target="PASS")
    assert set(own.written) == {"Quell"}
    assert np.array_equal(own.written["Quell"], plain.written["Combined"])


def test_memory_says_which_passes_would_help(addon):
    outcome, _ = Canvas(addon, {"Combined": 4}).denoise(addon)
    assert outcome.notes and "passes Quell wants" in outcome.details()[-1]


def test_memory_refuses_what_is_denoised_already(addon):
    canvas = Canvas(addon, GUIDED, is_denoised=True)
    with pytest.raises(addon.library.Problem, match="kept no noisy picture"):
        canvas.denoise(addon)
    assert not canvas.written


def test_memory_starts_from_the_noisy_image_of_cycles(addon):
    canvas = Canvas(addon, {**GUIDED, "Noisy Image": 4}, is_denoised=True)
    _, noisy = canvas.denoise(addon)
    assert np.array_equal(noisy, canvas.pixels["Noisy Image"]) and "Combined" in canvas.written


def test_memory_writes_nothing_when_cancelled(addon):
    canvas = Canvas(addon, GUIDED)
    with pytest.raises(addon.library.quell().CancelledError):
        addon.memory.denoise_layers([canvas.layer], (40, 32), addon.settings.Settings(), lambda _: True)
    assert not canvas.written


def test_memory_without_combined(addon):
    with pytest.raises(addon.library.Problem, match="no Combined"):
        Canvas(addon, {"Depth": 1}).denoise(addon)


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [("{name}_quell", "shot.0001_quell.exr"), ("clean_{name}.exr", "clean_shot.0001.exr"), ("", "shot.0001.exr")],
)
def test_names_of_results(addon, tmp_path, pattern, expected):
    assert addon.files.output_path(tmp_path / "shot.0001.exr", pattern) == tmp_path / expected


def test_a_pattern_without_name_is_refused(addon, tmp_path):
    with pytest.raises(addon.library.Problem, match="no {name}"):
        addon.files.output_path(tmp_path / "a.exr", "clean")


def test_folders_leave_results_out(addon, tmp_path):
    for name in ("b.exr", "a.EXR", "b_quell.exr", "note.txt"):
        (tmp_path / name).write_text("")
    assert [p.name for p in addon.files.collect([tmp_path], "{name}_quell")] == ["a.EXR", "b.exr"]
    assert len(addon.files.collect([tmp_path], "{name}")) == 3
    with pytest.raises(addon.library.Problem, match="no file"):
        addon.files.collect([tmp_path / "missing.exr"], "{name}_quell")
    (tmp_path / "empty").mkdir()
    with pytest.raises(addon.library.Problem, match="no .exr"):
        addon.files.collect([tmp_path / "empty"], "{name}_quell")


def test_finished_means_newer_than_its_source(addon, data, tmp_path):
    source = tmp_path / "a.exr"
    source.write_bytes((data / "45_none.exr").read_bytes())
    output = tmp_path / "a_quell.exr"
    assert not addon.files.is_finished(source, output) and not addon.files.is_finished(source, source)
    addon.files.denoise_file(source, output, addon.settings.Settings(), no_progress)
    assert addon.files.is_finished(source, output)
    time.sleep(0.02)
    source.touch()
    assert not addon.files.is_finished(source, output)


def test_one_bad_file_does_not_stop_the_others(addon, data, tmp_path):
    (tmp_path / "a.exr").write_text("no picture")
    (tmp_path / "b.exr").write_bytes((data / "45_none.exr").read_bytes())
    done = []
    files = addon.files.collect([tmp_path], "{name}_quell")
    arguments = (addon.settings.Settings(), "{name}_quell", tmp_path / "out", False, no_progress)
    assert addon.files.denoise_files(files, *arguments, lambda *item: done.append(item)) == 1
    assert [(source.name, outcome is not None, error is not None) for source, outcome, error in done] == [
        ("a.exr", False, True),
        ("b.exr", True, False),
    ]
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["b_quell.exr"]


def test_quality_reaches_the_library(addon, data, tmp_path, quell):
    """From the settings, for pixels and for files; a level that the library lacks is refused by its weight file."""
    present = addon.library.qualities()
    assert "balanced" in present
    assert tuple(addon.library.quell().native.QUALITY) == addon.settings.LEVELS
    pixels = {}
    for level in addon.settings.LEVELS:
        canvas, settings, out = Canvas(addon, GUIDED), addon.settings.Settings(quality=level), tmp_path / f"{level}.exr"
        if level not in present:
            with pytest.raises(addon.library.quell().FileError, match=f"quell-{level}.qwt"):
                canvas.denoise(addon, quality=level)
            with pytest.raises(addon.library.quell().FileError, match=f"quell-{level}.qwt"):
                addon.files.denoise_file(data / "45_none.exr", out, settings, no_progress)
            assert not canvas.written and not out.exists()
            continue
        canvas.pixels["Denoising Albedo"][:] = 0.5  # noise in it would count as texture, which is left alone
        canvas.denoise(addon, quality=level)
        pixels[level] = canvas.written["Combined"].tobytes()
        addon.files.denoise_file(data / "45_none.exr", out, settings, no_progress)
        quell.ok("denoise", data / "45_none.exr", "-o", tmp_path / "tool.exr", "-q", "--quality", level)
        assert out.read_bytes() == (tmp_path / "tool.exr").read_bytes()
    assert len(set(pixels.values())) == len(present)


def test_the_command_takes_a_quality(addon, data, tmp_path, quell, capsys):
    source = str(data / "45_none.exr")
    command = ["denoise", source, "-o", str(tmp_path / "out")]
    assert addon.command.command([*command, "--quality", "balanced"]) == 0
    quell.ok("denoise", source, "-o", tmp_path / "tool.exr", "-q")
    assert (tmp_path / "out" / "45_none_quell.exr").read_bytes() == (tmp_path / "tool.exr").read_bytes()
    assert addon.command.command([*command, "--quality", "best"]) == 2
    assert "'best'" in capsys.readouterr().err
    assert addon.command.command([*command, "--quality", "balanced", "--model", "dgan-kpn"]) == 2
    assert "not allowed with" in capsys.readouterr().err


def test_two_results_of_one_name_are_refused(addon, tmp_path):
    sources = [tmp_path / "x" / "a.exr", tmp_path / "y" / "a.exr"]
    arguments = (addon.settings.Settings(), "{name}", tmp_path, False, no_progress)
    with pytest.raises(addon.library.Problem, match="one result"):
        addon.files.denoise_files(sources, *arguments, lambda *_: None)


def test_jobs_report_errors_and_cancel(addon):
    broken = addon.job.Job(lambda progress: 1 / 0)
    broken.wait()
    assert broken.is_done and isinstance(broken.error, ZeroDivisionError)

    def work(progress) -> str:
        while not progress(0.25):
            time.sleep(0.01)
        return "stopped"

    job = addon.job.Job(work)
    while job.fraction == 0:
        time.sleep(0.01)
    assert not job.is_done
    job.cancel()
    job.wait()
    assert job.result == "stopped" and job.error is None


def test_the_record_is_json_lines(addon, tmp_path, capsys):
    journal = addon.journal.Journal(str(tmp_path / "record"))
    journal.done(7, addon.outcome.Outcome(denoised=["A"], skipped=[("B", "zero")], seconds={"read": 0.25}))
    journal.failed(8, "the disk is full")
    lines = [json.loads(line) for line in (tmp_path / "record").read_text().splitlines()]
    assert lines == [
        {"frame": 7, "status": "done", "denoised": ["A"], "skipped": {"B": "zero"}, "seconds": {"read": 0.25}},
        {"frame": 8, "status": "failed", "message": "the disk is full"},
    ]
    assert capsys.readouterr().err == "quell: frame 8: the disk is full\n"
    addon.journal.Journal(str(tmp_path / "no" / "record")).failed(1, "x")
    assert "cannot be written" in capsys.readouterr().err


def test_details_group_layers_by_reason(addon):
    outcome = addon.outcome.Outcome(skipped=[("V.TransDir", "zero everywhere"), ("V.TransInd", "zero everywhere")])
    assert outcome.details() == ["Zero everywhere: TransDir, TransInd"]
    assert outcome.summary() == "Nothing needed denoising"


# ---- Packing -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def zips(build) -> dict[str, zipfile.ZipFile]:
    found = {path.stem: zipfile.ZipFile(path) for path in (build / "addon").glob("*.zip")}
    assert len(found) == 2, f"no add-on in {build / 'addon'}: run make addon"
    return {"legacy" if name.endswith("legacy") else "extension": archive for name, archive in found.items()}


def test_the_manifest_is_what_blender_asks_for(zips, root):
    """The rules that `blender --command extension validate` checks, and two that it does not."""
    archive = zips["extension"]
    manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert manifest["schema_version"] == "1.0.0" and manifest["type"] == "add-on"
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", manifest["id"])
    assert len(manifest["tagline"]) <= 64 and manifest["tagline"][-1].isalnum()
    assert all(len(reason) <= 64 and reason[-1].isalnum() for reason in manifest["permissions"].values())
    assert set(manifest["permissions"]) <= {"files", "network", "clipboard", "camera", "microphone"}
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert set(manifest["platforms"]) <= {"linux-x64", "windows-x64", "windows-arm64", "macos-x64", "macos-arm64"}
    for wheel in manifest["wheels"]:
        assert wheel.removeprefix("./") in archive.namelist()
    header = (root / "include" / "quell.h").read_text()
    version = [re.search(rf"VERSION_{part} (\d+)", header)[1] for part in ("MAJOR", "MINOR", "PATCH")]
    assert manifest["version"] == ".".join(version)


def test_the_legacy_zip_is_one_module_with_everything_inside(zips):
    names = zips["legacy"].namelist()
    assert {name.split("/")[0] for name in names} == {"quell_denoiser"}
    assert "quell_denoiser/vendor/quell/libquell.so" in names
    tree = ast.parse(zips["legacy"].read("quell_denoiser/__init__.py"))
    (info,) = [
        ast.literal_eval(n.value) for n in tree.body if isinstance(n, ast.Assign) and n.targets[0].id == "bl_info"
    ]
    assert info["blender"] == (3, 4, 0)


def test_both_zips_are_of_one_source(zips):
    extension, legacy = zips["extension"], zips["legacy"]
    for name in extension.namelist():
        if name.endswith((".py", "LICENSE")):
            assert extension.read(name) == legacy.read(f"quell_denoiser/{name}")


def test_packing_twice_gives_the_same_bytes(root, build, zips, tmp_path):
    (wheel,) = (build / "wheel").glob("*.whl")
    command = [sys.executable, str(root / "scripts" / "build_addon.py"), "--wheel", str(wheel), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    for path in tmp_path.glob("*.zip"):
        assert path.read_bytes() == (build / "addon" / path.name).read_bytes()


def test_nothing_but_the_bpy_part_imports_bpy(root):
    for path in (root / "blender_addon" / "io").glob("*.py"):
        assert not re.search(
            r"^\s*(import bpy|from bpy|from \.\.blender|from \.\. import blender)", path.read_text(), re.M
        )


def test_ctypes_is_used_in_one_module(root):
    users = [p for folder in ("python", "blender_addon") for p in Path(root, folder).rglob("*.py")
             if re.search(r"^\s*(import|from) ctypes", p.read_text(), re.M)]  # fmt: skip
    assert [p.name for p in users] == ["native.py"]
