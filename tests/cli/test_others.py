# SPDX-License-Identifier: Apache-2.0
"""quell inspect, compare, preview, --help and --version."""

from __future__ import annotations

import hashlib
import json
import re

import numpy as np
import pytest
from PIL import Image


def test_help_everywhere(quell):
    for arguments in (
        ["--help"],
        ["denoise", "--help"],
        ["inspect", "-h"],
        ["compare", "--help"],
        ["preview", "--help"],
        ["bench", "--help"],
    ):
        done = quell.ok(*arguments)
        assert done.stdout.startswith("Usage: quell") and done.stderr == ""
        assert all(len(line) <= 120 for line in done.stdout.splitlines())


def test_help_and_manual_name_the_same_options(quell, root):
    manual = (root / "docs" / "cli.md").read_text()
    for command in ("denoise", "inspect", "compare", "preview", "bench"):
        for option in re.findall(r"--[a-z-]+", quell.ok(command, "--help").stdout):
            assert option in manual, f"{command} {option}"


def test_version(quell, root):
    header = (root / "include" / "quell.h").read_text()
    parts = [re.search(rf"QUELL_VERSION_{p} (\d+)", header).group(1) for p in ("MAJOR", "MINOR", "PATCH")]
    assert quell.ok("--version").stdout == f"quell {'.'.join(parts)}\n"
    text = quell.ok("--version", "-v").stdout
    digest = hashlib.sha256((root / "weights" / "quell-balanced.qwt").read_bytes()).hexdigest()
    assert digest in text and "quell-balanced (default)" in text
    assert "OpenEXRCore 3.5" in text and "kernels: c" in text


def test_inspect_table(quell, data):
    text = quell.ok("inspect", data / "50_all.exr").stdout
    line = next(line for line in text.splitlines() if "Diffuse Direct" in line)
    assert line.split() == "ViewLayer.Diffuse Direct diffuse-direct RGB half zip 4 denoise".split()
    assert "45 x 29 pixels, 47 layers" in text


def test_inspect_json(quell, data):
    files = json.loads(quell.ok("inspect", "--json", data / "45_stereo.exr", data / "34_all.exr").stdout)
    assert [f["file"].rpartition("/")[2] for f in files] == ["45_stereo.exr", "34_all.exr"]
    assert {layer["view"] for layer in files[0]["layers"]} >= {"left", "right"}
    layer = next(layer for layer in files[1]["layers"] if layer["pass"] == "DiffDir")
    expected = {"view_layer": "ViewLayer", "role": "diffuse-direct", "channels": "RGB", "width": 45, "height": 29}
    assert layer | expected == layer
    assert len(files[0]["model"]["sha256"]) == 64


def test_inspect_every_fixture(quell, data):
    names = [p for p in sorted(data.glob("*.exr")) if p.name != "conv_tiled.exr"]
    files = json.loads(quell.ok("inspect", "--json", *names).stdout)
    assert len(files) == len(names)


def test_compare_matches_layers_by_meaning(quell, data):
    """Blender 4's 'DiffDir' is Blender 5's 'Diffuse Direct'."""
    layers = json.loads(quell.ok("compare", "--json", data / "45_all_two_layers.exr", data / "50_all.exr").stdout)
    assert any(layer["name"].endswith("DiffDir") for layer in layers["layers"])


def test_compare_with_itself(quell, data):
    layers = json.loads(
        quell.ok("compare", "--json", data / "50_all.exr", data / "50_all.exr", "--layers", "all").stdout
    )
    assert len(layers["layers"]) == 47
    for layer in layers["layers"]:
        assert layer["mse"] == 0 and layer["psnr"] is None and abs(layer["ssim"] - 1) < 1e-9
    text = quell.ok("compare", data / "50_all.exr", data / "50_all.exr", "-l", "Combined").stdout
    assert len(text.splitlines()) == 2


def srgb(linear: np.ndarray) -> np.ndarray:
    z = np.clip(linear, 0, 1)
    return np.where(z <= 0.0031308, 12.92 * z, 1.055 * z ** (1 / 2.4) - 0.055)


@pytest.mark.usefixtures("pictures")
@pytest.mark.parametrize("exposure", [0.0, -1.5, 3.0])
def test_preview_pixels(quell, data, tmp_path, exr_reader, exposure):
    out = tmp_path / "x.png"
    quell.ok("preview", data / "50_zip_float.exr", "-o", out, "--exposure", exposure)
    source = exr_reader(data / "50_zip_float.exr")
    linear = np.stack([source[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1).astype(np.float64)
    picture = np.asarray(Image.open(out))
    assert picture.shape == (29, 45, 3)
    assert np.abs(picture - 255 * srgb(linear * 2.0**exposure)).max() <= 0.5001


@pytest.mark.usefixtures("pictures")
def test_preview_sheet(quell, data, tmp_path):
    out = tmp_path / "x.png"
    quell.ok(
        "preview", data / "50_all.exr", data / "50_zip_float.exr", "-o", out, "--labels=Before,After", "--zoom", "4"
    )
    assert Image.open(out).size == (2 * 45 * 4 + 4, 29 * 4)
    quell.ok("preview", data / "50_all.exr", "-o", out, "--crop", "10x8+30+20", "--layer", "Depth")
    assert Image.open(out).size == (10, 8)
    quell.ok("preview", data / "50_all.exr", "-o", tmp_path / "x.jpg")
    assert Image.open(tmp_path / "x.jpg").format == "JPEG"


@pytest.mark.usefixtures("pictures")
def test_preview_refuses_what_it_cannot_write(quell, data, tmp_path):
    assert "x.nothing" in quell.fails(6, "preview", data / "50_all.exr", "-o", tmp_path / "x.nothing")
    assert "crop" in quell.fails(8, "preview", data / "50_all.exr", "-o", tmp_path / "x.png", "--crop", "50x8+0+0")
    assert list(tmp_path.iterdir()) == []
