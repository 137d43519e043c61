# SPDX-License-Identifier: Apache-2.0
"""--debug-layers: noise estimate, blend and what was skipped, as layers of the output."""

from __future__ import annotations

import numpy as np
import pytest

NAMES = ("Quell Noise", "Quell Confidence", "Quell Skipped")
HEIGHT, WIDTH = 250, 331  # no multiples of blocks, cells or tiles
DEVIATION = 6.0**-0.5  # of the noise, relative to its mean


@pytest.fixture(scope="module")
def half_clean(tmp_path_factory, exr_writer):
    """Noise in the lower right, a clean gradient elsewhere."""
    rng = np.random.default_rng(5)
    pixels = np.linspace(0.2, 0.9, WIDTH, dtype=np.float32)[None, :, None] * np.ones((HEIGHT, 1, 3), np.float32)
    noise = 0.5 * rng.gamma(6.0, 1 / 6.0, (HEIGHT - 160, WIDTH - 192, 1))
    pixels[160:, 192:] = noise.astype(np.float32)
    return exr_writer(tmp_path_factory.mktemp("debug") / "half_clean.exr", {"ViewLayer.Combined": pixels}), pixels


def maps(quell, exr_reader, path, out, *options: str) -> dict[str, np.ndarray]:
    quell.ok("denoise", path, "-q", "-o", out, "--debug-layers", *options)
    return exr_reader(out)


def test_what_they_show(quell, half_clean, tmp_path, exr_reader):
    path, pixels = half_clean
    layers = maps(quell, exr_reader, path, tmp_path / "out.exr")
    noise, confidence, skipped = (layers[f"ViewLayer.{name}.Y"].astype(np.float32) for name in NAMES)
    for image in (noise, confidence, skipped):
        assert image.shape == (HEIGHT, WIDTH)
        assert layers["ViewLayer.Quell Noise.Y"].dtype == np.float16
    noisy, clean = np.s_[184:240, 216:320], np.s_[:120]
    assert abs(noise[noisy].mean() / DEVIATION - 1) < 0.3 and noise[clean].max() < 0.01
    assert confidence[noisy].mean() > 0.9 and confidence[clean].max() == 0
    assert set(np.unique(skipped)) <= {0, 0.5, 1}
    assert skipped[noisy].max() == 0 and skipped[:96].min() == 1
    # Where nothing was computed, and where nothing of it was used, the render is what comes out.
    result = np.stack([layers[f"ViewLayer.Combined.{c}"] for c in "RGB"], -1)
    untouched = (skipped == 1) | (confidence == 0)
    assert np.array_equal(result[untouched], pixels[untouched])


def test_threads_tiles_and_memory_do_not_show(quell, half_clean, tmp_path, exr_reader):
    path, _ = half_clean
    base = maps(quell, exr_reader, path, tmp_path / "base.exr", "--threads", "2")
    for options in (("--threads", "1"), ("--tile", "64"), ("--tile", "96", "--threads", "2"), ("--max-memory", "48")):
        other = maps(quell, exr_reader, path, tmp_path / "other.exr", *options)
        assert base.keys() == other.keys()
        for name, values in base.items():
            assert np.array_equal(values, other[name]), (options, name)


def test_other_channels_stay(quell, half_clean, tmp_path, exr_reader):
    path, _ = half_clean
    quell.ok("denoise", path, "-q", "-o", tmp_path / "plain.exr")
    plain = exr_reader(tmp_path / "plain.exr")
    with_layers = maps(quell, exr_reader, path, tmp_path / "maps.exr")
    assert with_layers.keys() - plain.keys() == {f"ViewLayer.{name}.Y" for name in NAMES}
    assert all(np.array_equal(with_layers[name], plain[name]) for name in plain)


def test_no_skip_and_no_blend(quell, half_clean, tmp_path, exr_reader):
    path, _ = half_clean
    whole = maps(quell, exr_reader, path, tmp_path / "out.exr", "--no-skip")
    assert whole["ViewLayer.Quell Skipped.Y"].max() == 0
    assert whole["ViewLayer.Quell Confidence.Y"][:120].max() == 0
    for options in (("--no-blend",), ("--no-blend", "--no-skip")):
        unblended = maps(quell, exr_reader, path, tmp_path / "out.exr", *options)
        assert unblended["ViewLayer.Quell Confidence.Y"].min() == 1


@pytest.mark.parametrize("name", ["45_all_two_layers", "45_plain", "45_stereo", "50_stereo", "52_zip", "34_all"])
def test_files_of_blender(quell, data, tmp_path, exr_reader, name):
    """Single parts and many, two view layers, two views, and a file without layer names."""
    before = exr_reader(data / f"{name}.exr")
    layers = maps(quell, exr_reader, data / f"{name}.exr", tmp_path / "out.exr")
    new = layers.keys() - before.keys()
    assert new and all(channel.split(".")[-1] == "Y" for channel in new)
    combined = {c.removesuffix(".R") for c in before if "Combined." in c and c.endswith(".R")} or {"Combined"}
    for channel in combined:
        for kind in NAMES:
            expected = channel.replace("Combined", kind) + ".Y"
            assert expected in new, (expected, new)
        assert np.isfinite(layers[f"{channel.replace('Combined', NAMES[0])}.Y"]).all()
    assert "Quell Noise" in quell.ok("inspect", tmp_path / "out.exr").stdout


def test_views_of_parts(quell, data, tmp_path):
    """Blender finds a view's pass by the part's view attribute."""
    import OpenEXR

    quell.ok("denoise", data / "50_stereo.exr", "-q", "-o", tmp_path / "out.exr", "--debug-layers")
    with OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True) as file:
        views = {
            part.header["name"]: part.header.get("view") for part in file.parts if "Quell" in str(part.header["name"])
        }
    assert len(views) == 6 and set(views.values()) == {"left", "right"}
    assert all(str(name).endswith(str(view)) for name, view in views.items())


def test_nothing_to_do(quell, tmp_path, exr_writer, exr_reader):
    """A constant image is skipped whole before its noise is measured."""
    path = exr_writer(tmp_path / "grey.exr", {"ViewLayer.Combined": np.full((20, 30, 3), 0.5, np.float32)})
    layers = maps(quell, exr_reader, path, tmp_path / "out.exr")
    assert (layers["ViewLayer.Quell Noise.Y"] == -1).all()
    assert (layers["ViewLayer.Quell Confidence.Y"] == 0).all() and (layers["ViewLayer.Quell Skipped.Y"] == 1).all()


def test_a_second_time_is_refused(quell, half_clean, tmp_path):
    path, _ = half_clean
    first, second = tmp_path / "first.exr", tmp_path / "second.exr"
    quell.ok("denoise", path, "-q", "-o", first, "--debug-layers")
    for options in (("-o", second), ("--dry-run",)):
        line = quell.fails(2, "denoise", first, "-q", "--debug-layers", *options)
        assert "'ViewLayer.Quell Noise'" in line
    assert not second.exists()
    quell.ok("denoise", first, "-q", "-o", second)


def test_dgan_kpn_has_none(quell, half_clean, root, tmp_path):
    path, _ = half_clean
    weights = root / "tests" / "golden" / "dgan_small.qwt"
    line = quell.fails(2, "denoise", path, "-q", "--debug-layers", "-m", weights, "-o", tmp_path / "out.exr")
    assert "DGAN-KPN" in line and not (tmp_path / "out.exr").exists()
