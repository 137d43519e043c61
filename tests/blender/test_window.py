# SPDX-License-Identifier: Apache-2.0
"""The add-on in Blender's window, on a screen in memory, drawn in software. Only executables have one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import INSIDE, TIMEOUT


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """An X server of our own; it picks its number."""
    if not shutil.which("Xvfb") or not shutil.which("xdotool"):
        pytest.skip("Xvfb or xdotool is not installed")
    # A pipe, not a file: the two sides of a file share its offset, and reading would move the server's writing.
    reads, writes = os.pipe()
    options = ["-screen", "0", "1280x800x24", "+extension", "GLX", "-noreset"]
    command = ["Xvfb", "-displayfd", str(writes), *options]
    with (
        open(reads, encoding="ascii") as number,
        subprocess.Popen(command, pass_fds=[writes], stderr=subprocess.DEVNULL) as server,
    ):
        os.close(writes)
        try:
            text = number.readline().strip()
            assert text.isdigit(), "Xvfb did not start"
            yield f":{text}"
        finally:
            server.terminate()


@pytest.fixture(scope="module")
def window(blender, addon, display, tmp_path_factory) -> dict:
    if blender.command[0] != "blender":
        pytest.skip("the module has no window")
    work = tmp_path_factory.mktemp("window")
    # QUELL_PICTURES names a folder for pictures in the size that docs/images has.
    pictures = os.environ.get("QUELL_PICTURES")
    environment = {
        **os.environ,
        "BLENDER_USER_RESOURCES": str(work / "home"),
        "DISPLAY": display,
        "LIBGL_ALWAYS_SOFTWARE": "1",
    }
    options = ["--factory-startup", "-noaudio", "-p", "0", "0", "1280", "800"]
    command = ["blender", *options, "-P", str(INSIDE / "window.py"), "--", str(addon), str(work)]
    done = subprocess.run(
        [*command, *(["pictures"] if pictures else [])],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        env=environment,
    )
    results = work / "window.json"
    assert results.exists(), done.stdout[-3000:] + done.stderr[-3000:]
    found = json.loads(results.read_text())
    assert "error" not in found, found["error"]
    # What a panel's draw raises is printed, and shows nowhere else.
    assert "Traceback" not in done.stdout + done.stderr, done.stdout + done.stderr
    for picture in work.glob("*.png") if pictures else []:
        shutil.copy(picture, Path(pictures))
    return found


def test_f12_denoises_in_the_render(window):
    assert window["render"].startswith("Denoised ")


def test_escape_cancels_in_the_render(window):
    assert window["cancel_render"] == "Denoising was cancelled; the render is noisy"


def test_the_interface_goes_on_while_it_denoises(window):
    """Not a tenth of a second without it, or where the machine is busy, not longer than Cycles keeps it anyway."""
    assert window["gap_in_denoise"] < max(0.1, 2 * window["gap_in_render"])


def test_before_and_after(window):
    assert (window["before"], window["after"]) == ("Quell Before", "RENDER_RESULT")


def test_escape_cancels_the_button(window):
    assert window["cancel_started"][0] == ["RUNNING_MODAL"]
    assert window["cancel"] == "Denoising was cancelled"


def test_the_button_shows_its_result(window):
    assert window["button"].startswith("Denoised ")
    assert window["button_image"] == "Quell Result"


def test_the_compositor_and_undo(window):
    assert (window["nodes_added"], window["nodes_after_undo"]) == (1, 0)
