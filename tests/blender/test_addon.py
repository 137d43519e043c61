# SPDX-License-Identifier: Apache-2.0
"""The add-on in real Blenders. What it renders and denoises is compared with the tool's result, bit by bit."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import INSIDE, ROOT

CHECKS = ["install", *re.findall(r"^@check\ndef (\w+)", (INSIDE / "checks.py").read_text(), re.MULTILINE)]

# What was rendered with Quell -> the noisy render, and the tool's options for the same.
SAME_AS_TOOL = {
    "replace.exr": ("noisy.exr", []),
    "beauty.exr": ("noisy.exr", ["--layers", "beauty"]),
    "tiles.exr": ("noisy.exr", []),
    "two_layers.exr": ("two_layers_noisy.exr", []),
    "stereo.exr": ("stereo_noisy.exr", []),
    "border.exr": ("border_noisy.exr", []),
    "stereo_pressed0001_quell.exr": ("stereo_button.exr", []),
    "border_open_quell.exr": ("border_open.exr", []),
    "dropped/c_quell.exr": ("noisy.exr", []),
    "loaded_again.exr": ("noisy.exr", []),
    **{f"animation/f_000{i}.exr": (f"animation_noisy/f_000{i}.exr", []) for i in (1, 2, 3)},
    "beside_quell.exr": ("noisy.exr", []),
    "in_place.exr": ("noisy.exr", []),
    "picture_0001_all.exr": ("noisy.exr", []),
    "both.exr": ("noisy.exr", []),
    "both_quell.exr": ("noisy.exr", []),
    **{f"animation_files/f_000{i}_quell.exr": (f"animation_noisy/f_000{i}.exr", []) for i in (1, 2, 3)},
    "closed_quell.exr": ("noisy.exr", []),
    "pressed0001_quell.exr": ("noisy.exr", []),
    "files/a_quell.exr": ("noisy.exr", []),
    "command/noisy.exr": ("noisy.exr", []),
    "fault_quell.exr": ("noisy.exr", []),
    "enabled_again.exr": ("noisy.exr", []),
    "from_noisy_image.exr": ("from_noisy_image_noisy.exr", []),
}

# What must be the plain render.
SAME_AS_NOISY = [
    "still_untouched.exr",
    "button_only.exr",
    "no_such_pass.exr",
    "beside.exr",
    "closed.exr",
    "button.exr",
    "cancelled.exr",
    "fault.exr",
    "no_room.exr",
    "other_version.exr",
    "not_loaded.exr",
    "disk_full.exr",
    "disabled.exr",
]


def read(path: Path) -> dict[str, np.ndarray]:
    """Channels, whatever part they are in; those of a stereo file's parts with their view."""
    import OpenEXR

    channels = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            view = part.header.get("view", "")
            for name, channel in part.channels.items():
                channels[f"{view}:{name}"] = np.array(channel.pixels)
    return channels


def assert_same(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert sorted(found) == sorted(expected)
    different = [name for name in expected if found[name].tobytes() != expected[name].tobytes()]
    assert not different


@pytest.fixture(scope="session")
def tool(quell, tmp_path_factory):
    """The tool's result for a file, once."""
    folder = tmp_path_factory.mktemp("tool")
    results: dict[tuple[str, ...], dict[str, np.ndarray]] = {}

    def run(source: Path, options: list[str]) -> dict[str, np.ndarray]:
        key = (str(source), *options)
        if key not in results:
            output = folder / f"{len(results)}.exr"
            quell.ok("denoise", source, "-o", output, "--quiet", *options)
            results[key] = read(output)
        return results[key]

    return run


@pytest.mark.parametrize("check", CHECKS)
def test_check(results, check):
    assert results[check] == "ok", results[check]


@pytest.mark.parametrize("name", SAME_AS_TOOL)
def test_same_bits_as_the_tool(work, tool, name):
    source, options = SAME_AS_TOOL[name]
    if not (work / source).exists() and source.startswith("from_noisy_image"):
        pytest.skip("this Blender was built without a denoiser of its own")
    if name.startswith("dropped/") and not (work / "dropped").exists():
        pytest.skip("this Blender has no file handlers")
    result = read(work / name)
    noisy = read(work / source)
    assert_same(result, tool(work / source, options))
    combined = [key for key in noisy if "Combined" in key and key.endswith(".G")]
    assert any(noisy[key].tobytes() != result[key].tobytes() for key in combined)


@pytest.mark.parametrize("level", ["fast", "balanced", "high"])
def test_quality_levels(work, tool, level):
    result = read(work / f"quality_{level}.exr")
    has_network = (ROOT / "weights" / f"quell-{level}.qwt").exists()
    noisy = work / "noisy.exr"
    assert_same(result, tool(noisy, ["--quality", level]) if has_network else read(noisy))


@pytest.mark.parametrize("name", SAME_AS_NOISY)
def test_the_render_is_kept(work, name):
    assert_same(read(work / name), read(work / "noisy.exr"))


def test_own_pass(work, tool):
    result = read(work / "own_pass.exr")
    noisy = read(work / "noisy.exr")
    clean = tool(work / "noisy.exr", [])
    for letter in "RGBA":
        expected = clean[f":ViewLayer.Combined.{letter}"]
        assert result.pop(f":ViewLayer.Quell.{letter}").tobytes() == expected.tobytes()
        assert result.pop(f":Composite.Combined.{letter}").tobytes() == expected.tobytes()
    assert_same(result, noisy)


def test_keep_noisy(work, tool):
    result = read(work / "keep_noisy.exr")
    noisy = read(work / "noisy.exr")
    for letter in "RGBA":
        expected = noisy[f":ViewLayer.Combined.{letter}"]
        assert result.pop(f":ViewLayer.Quell Noisy.{letter}").tobytes() == expected.tobytes()
    assert_same(result, tool(work / "noisy.exr", []))


@pytest.mark.parametrize("name", ["composite.exr", "used_in_compositor.exr"])
def test_the_compositor_gets_the_result(work, tool, name):
    result = read(work / name)
    clean = tool(work / "noisy.exr", [])
    for letter in "RGB":
        assert result[f":Composite.Combined.{letter}"].tobytes() == clean[f":ViewLayer.Combined.{letter}"].tobytes()


def test_exit_code_and_command_line_of_an_executable(blender, addon, work, tmp_path):
    """A batch run whose denoising fails ends with 1, though Blender itself would end with 0."""
    if blender.command[0] != "blender":
        pytest.skip("the module is part of another program, whose exit code it leaves alone")
    home = tmp_path / "home"
    record = tmp_path / "record.jsonl"
    script = INSIDE / "batch.py"
    good = blender.run(script, addon, tmp_path, "{name}_quell", home=home, QUELL_JOURNAL=str(record))
    assert good.returncode == 0, good.stdout + good.stderr
    assert (tmp_path / "batch0001_quell.exr").exists() and '"done"' in record.read_text()
    bad = blender.run(script, addon, tmp_path, "missing/{name}", home=home, QUELL_JOURNAL=str(record))
    assert bad.returncode == 1 and "quell: frame 1:" in bad.stderr and '"failed"' in record.read_text()

    expression = (
        "import addon_utils, os; addon_utils.enable('quell_denoiser'); import quell_denoiser;"
        f"os._exit(quell_denoiser.command(['denoise', {str(work / 'noisy.exr')!r}, '-o', {str(tmp_path / 'out')!r}]))"
    )
    command = ["blender", "-b", "--factory-startup", "--python-expr", expression]
    environment = {"BLENDER_USER_RESOURCES": str(home), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    assert subprocess.run(command, env=environment, timeout=120).returncode == 0
    assert (tmp_path / "out" / "noisy_quell.exr").exists()


def test_another_openexr_in_the_process(blender, addon, work, tmp_path, tool):
    """With Debian's OpenEXR in the global scope, the library still uses its own."""
    others = sorted(Path("/usr/lib/x86_64-linux-gnu").glob("libOpenEXRCore*.so.*"))
    if not others:
        pytest.skip("no other OpenEXR is installed here")
    arguments = (addon, work / "noisy.exr", tmp_path / "out.exr")
    done = blender.run(INSIDE / "preloaded.py", *arguments, home=tmp_path, LD_PRELOAD=str(others[0]))
    assert (tmp_path / "out.exr").exists(), done.stdout + done.stderr
    assert "other OpenEXR: True" in done.stdout
    assert_same(read(tmp_path / "out.exr"), tool(work / "noisy.exr", []))


def test_blenders_are_there():
    """This folder's tests are worth nothing without one."""
    from conftest import BLENDERS

    assert BLENDERS, f"no Blender: run {ROOT / 'scripts'}/install_deps.sh blender"


def test_blenders_own_validation(blender, addon):
    """`blender --command extension validate`, by the program that is behind it."""
    if blender.command[0] == "blender":
        pytest.skip("the executable's program is not at a known place")
    modules = Path(blender.command[0]).parents[1] / "lib"
    programs = sorted(modules.glob("python*/site-packages/bpy/**/bl_pkg/cli/blender_ext.py"))
    assert programs, f"no validation program below {modules}"
    done = subprocess.run(
        [blender.command[0], str(programs[0]), "validate", str(addon)], capture_output=True, text=True
    )
    assert done.returncode == 0 and "Success" in done.stdout, done.stdout + done.stderr
