# SPDX-License-Identifier: Apache-2.0
"""What src/exr reads and writes, seen by OpenEXR's Python module and by OpenImageIO."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exr_tools import DATA, Part, Tool, bits, plain, read

FIXTURES = sorted(p.name for p in DATA.glob("*.exr") if p.name != "conv_tiled.exr")
LOSSY = {"DWAA", "DWAB", "B44", "B44A", "PXR24"}
STRUCTURAL = {"compression", "chunkCount", "channels"}

# Layers that a denoise filters: colour passes by either name table. Everything else must come through untouched.
LIGHT = re.compile(
    r"(^|\.)(Combined|Combined_[^.]+|(Diff|Gloss|Trans)(Dir|Ind|Col)|Volume(Dir|Ind)|Emit|Env|AO|Shadow"
    r"|(Diffuse|Glossy|Transmission) (Direct|Indirect|Color)|Volume (Direct|Indirect)|Emission|Environment"
    r"|Ambient Occlusion|Shadow Catcher)(\.(left|right))?\.[RGBA]$"
)


def is_light(channel: str) -> bool:
    return channel in ("R", "G", "B", "A") or (bool(LIGHT.search(channel)) and not channel.startswith("Composite."))


def codec_name(part: Part) -> str:
    return re.sub(r".*\.(\w+)_COMPRESSION.*", r"\1", str(part.header["compression"]))


def assert_same_header(before: Part, after: Part, ignore: set[str]) -> None:
    assert list(before.header) == list(after.header)
    for key, value in before.header.items():
        if key not in ignore:
            assert plain(value) == plain(after.header[key]), key


def assert_same_pixels(before: Part, after: Part, names: list[str]) -> None:
    for name in names:
        assert before.channels[name].dtype == after.channels[name].dtype, name
        assert np.array_equal(bits(before.channels[name]), bits(after.channels[name])), name


def scaled(pixels: np.ndarray, factor: float) -> np.ndarray:
    """What the tool's --scale makes of a channel: halves are clamped to their range."""
    with np.errstate(over="ignore", invalid="ignore"):
        wide = pixels.astype(np.float32) * np.float32(factor)
        if pixels.dtype == np.float16:
            wide = np.where(np.isfinite(wide), np.clip(wide, -65504, 65504), wide)
        return wide.astype(pixels.dtype)


def assert_equal_values(expected: np.ndarray, found: np.ndarray, name: str) -> None:
    assert expected.dtype == found.dtype, name
    np.testing.assert_array_equal(expected, found, err_msg=name)


@pytest.mark.parametrize("name", FIXTURES)
def test_unchanged_frame_is_the_same_file(tool: Tool, tmp_path: Path, name: str) -> None:
    tool.ok(DATA / name, tmp_path / "out.exr")
    before, after = read(DATA / name), read(tmp_path / "out.exr")
    assert len(before) == len(after)
    for one, other in zip(before, after, strict=True):
        assert_same_header(one, other, set())
        assert list(one.channels) == list(other.channels)
        assert_same_pixels(one, other, list(one.channels))
    assert (tmp_path / "out.exr").stat().st_size == (DATA / name).stat().st_size


@pytest.mark.parametrize("name", FIXTURES)
def test_denoised_layers_change_and_nothing_else(tool: Tool, tmp_path: Path, name: str) -> None:
    tool.ok("--mark", "all", "--scale", "3", DATA / name, tmp_path / "out.exr")
    before, after = read(DATA / name), read(tmp_path / "out.exr")
    assert len(before) == len(after)
    num_changed = 0
    for one, other in zip(before, after, strict=True):
        light = [c for c in one.channels if is_light(c)]
        ignore = {"compression", "chunkCount"} if light else set()
        assert_same_header(one, other, ignore)
        assert list(one.channels) == list(other.channels)
        assert_same_pixels(one, other, [c for c in one.channels if c not in light])
        for channel in light:
            assert_equal_values(scaled(one.channels[channel], 3), other.channels[channel], channel)
            num_changed += 1
        if light:
            own = codec_name(one)
            assert codec_name(other) == ("ZIP" if own in LOSSY else own)
    assert num_changed > 0


@pytest.mark.parametrize("name", FIXTURES)
def test_threads_do_not_change_a_byte(tool: Tool, tmp_path: Path, name: str) -> None:
    files = []
    for threads in (1, 2, 5):
        files.append(tmp_path / f"{threads}.exr")
        tool.ok("--threads", threads, "--mark", "all", "--scale", "0.5", "--noisy", DATA / name, files[-1])
    assert files[0].read_bytes() == files[1].read_bytes() == files[2].read_bytes()


@pytest.mark.parametrize("name", ["45_none.exr", "45_beauty_guides.exr", "50_zip_float.exr", "conv_decreasing_y.exr"])
@pytest.mark.parametrize(
    ("codec", "expected"),
    [(1, "NO"), (2, "RLE"), (3, "ZIPS"), (4, "ZIP"), (5, "PIZ"), (6, "PXR24"), (7, "B44"), (8, "B44A"), (9, "DWAA"),
     (10, "DWAB"), (11, "HTJ2K32")],
)  # fmt: skip
def test_codecs(tool: Tool, tmp_path: Path, name: str, codec: int, expected: str) -> None:
    tool.ok("--codec", codec, "--mark", "all", DATA / name, tmp_path / "out.exr")
    for one, other in zip(read(DATA / name), read(tmp_path / "out.exr"), strict=True):
        if not any(is_light(c) for c in one.channels):
            assert_same_header(one, other, set())
            assert_same_pixels(one, other, list(one.channels))
            continue
        assert codec_name(other) == expected
        if expected not in LOSSY:
            assert_same_pixels(one, other, list(one.channels))
            continue
        for channel, pixels in one.channels.items():
            if expected.startswith("DWA") and re.search(r"[XYZ]$", channel):
                continue  # DWA quantises these at will
            wide = pixels.astype(np.float64)
            error = np.abs(other.channels[channel].astype(np.float64) - wide)
            assert np.median(error) <= 0.1 * (np.median(np.abs(wide)) + 0.1), channel


@pytest.mark.parametrize("name", [n for n in FIXTURES if "denoised" not in n])
def test_noisy_image_is_added(tool: Tool, tmp_path: Path, name: str) -> None:
    tool.ok("--mark", "all", "--scale", "2", "--noisy", DATA / name, tmp_path / "out.exr")
    before, after = read(DATA / name), read(tmp_path / "out.exr")
    old = {(p.header.get("view"), c): pixels for p in before for c, pixels in p.channels.items()}
    new = {(p.header.get("view"), c): pixels for p in after for c, pixels in p.channels.items()}
    combined = [k for k in old if re.search(r"(^|\.)Combined(\.(left|right))?\.[RGBA]$", k[1]) or k[1] in "RGBA"]
    combined = [k for k in combined if not k[1].startswith("Composite.")]
    assert combined
    added = set(new) - set(old)
    assert len(added) == len(combined)
    for view, channel in combined:
        noisy = channel.replace("Combined", "Noisy Image") if "Combined" in channel else f"Noisy Image.{channel}"
        assert np.array_equal(bits(old[view, channel]), bits(new[view, noisy]))
        assert_equal_values(scaled(old[view, channel], 2), new[view, channel], channel)
    if len(before) > 1:
        names = [p.header["name"] for p in after]
        assert len(names) == len(set(names)) == len(before) + len(combined) // 4
        place = min(i for i, n in enumerate(names) if "Noisy Image" in n)
        guides = [i for i, n in enumerate(names) if re.search(r"Denoising|Combined_", n)]
        assert place == min(guides) - (len(combined) // 4)
        base = next(p for p in before if "Combined" in p.header["name"])
        assert after[place].header["colorInteropID"] == base.header["colorInteropID"]
        assert "BlenderMultiChannel" not in after[place].header
    again = tool.ok("--list", tmp_path / "out.exr").out
    assert again.count("|noisy-image|RGB") == len(combined) // 4


@pytest.mark.parametrize("name", ["45_denoised.exr", "50_denoised_catcher.exr"])
def test_noisy_image_is_not_doubled(tool: Tool, tmp_path: Path, name: str) -> None:
    tool.ok("--mark", "all", "--noisy", DATA / name, tmp_path / "out.exr")
    before, after = read(DATA / name), read(tmp_path / "out.exr")
    assert [list(p.channels) for p in before] == [list(p.channels) for p in after]


@pytest.mark.parametrize("name", FIXTURES)
def test_reading_again_lists_the_same(tool: Tool, tmp_path: Path, name: str) -> None:
    first = tool.ok("--list", "--all", "--mark", "all", DATA / name, tmp_path / "out.exr").out
    second = tool.ok("--list", "--all", tmp_path / "out.exr").out
    assert re.sub(r"\|(dwa.|b44|pxr24)\|", "|zip|", first) == re.sub(r"\|(dwa.|b44|pxr24)\|", "|zip|", second)


@pytest.mark.parametrize("name", [n for n in FIXTURES if "htj2k" not in n])
def test_oiiotool_agrees(tool: Tool, tmp_path: Path, name: str) -> None:
    if not shutil.which("oiiotool"):
        pytest.skip("oiiotool is not installed")
    tool.ok("--mark", "all", DATA / name, tmp_path / "out.exr")
    # oiiotool's --diff sees every part and channel; marked layers were written as they were.
    done = subprocess.run(
        ["oiiotool", "-a", DATA / name, tmp_path / "out.exr", "--fail", "0", "--warn", "0", "--diff"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "PASS" in done.stdout, done.stdout + done.stderr


def test_list_of_layers(tool: Tool) -> None:
    def listed(name: str) -> dict[str, list[str]]:
        lines = tool.ok("--list", DATA / name).out.splitlines()
        return {line.split("|")[0]: line.split("|")[1:] for line in lines}

    layers = listed("45_all_two_layers.exr")
    assert layers["View.Läyer 2.DiffDir"][:5] == ["View.Läyer 2", "DiffDir", "", "diffuse-direct", "RGB"]
    assert layers["ViewLayer.UV"][4] == "UVA"
    assert layers["ViewLayer.CryptoObject00"][3:5] == ["other", "rgba"]
    assert listed("45_composite.exr")["Composite.Combined"][3] == "other"
    assert listed("45_plain.exr")["Combined"][:5] == ["", "Combined", "", "combined", "RGBA"]
    assert listed("50_stereo.exr")["ViewLayer.Combined.right"][:4] == ["ViewLayer", "Combined", "right", "combined"]
    assert listed("45_stereo.exr")["ViewLayer.Combined.right"][:4] == ["ViewLayer", "Combined", "right", "combined"]
    assert listed("45_adaptive.exr")["ViewLayer.Combined"][8] == "64"
    long_names = tool.ok("--list", DATA / "45_long_names.exr")
    assert "2 channels belong to no layer" in long_names.err


def write(path: Path, *parts: tuple[dict[str, object], dict[str, np.ndarray]]) -> Path:
    import OpenEXR

    made = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **header}, dict(channels))
        for header, channels in parts
    ]
    with OpenEXR.File(made) as file:
        file.write(str(path))
    return path


def noise(shape: tuple[int, int], dtype: type, seed: int = 1) -> np.ndarray:
    values = np.random.default_rng(seed).gamma(0.5, 2.0, shape) * 10
    return values.astype(dtype)


def test_mixed_types_and_uint(tool: Tool, tmp_path: Path) -> None:
    channels = {
        "L.Combined.R": noise((37, 23), np.float16, 1),
        "L.Combined.G": noise((37, 23), np.float32, 2),
        "L.Combined.B": noise((37, 23), np.float16, 3),
        "L.id.X": noise((37, 23), np.uint32, 4) + np.uint32(4_000_000_000),
        "L.Depth.Z": noise((37, 23), np.uint32, 5),
        "Z": noise((37, 23), np.float32, 6),
        "L.odd": noise((37, 23), np.float32, 7),
    }
    source = write(tmp_path / "in.exr", ({}, channels))
    result = tool.ok("--list", "--all", "--mark", "L.Combined,L.id", "--scale", "2", source, tmp_path / "out.exr")
    assert "L.Combined|L|Combined||combined|RGB|float" in result.out
    assert "Depth||Depth||depth|Z|float" in result.out
    assert "L.Depth|L|Depth||other|Z|uint" in result.out
    found = read(tmp_path / "out.exr")[0].channels
    for name in ("L.Combined.R", "L.Combined.G", "L.Combined.B"):
        assert_equal_values(scaled(channels[name], 2), found[name], name)
    assert (found["L.id.X"] == 0xFFFFFFFF).all()  # clamped
    for name in ("L.Depth.Z", "Z", "L.odd"):
        assert np.array_equal(bits(channels[name]), bits(found[name]))


def test_half_is_clamped(tool: Tool, tmp_path: Path) -> None:
    pixels = {f"L.Combined.{c}": np.full((5, 7), 60000, np.float16) for c in "RGB"}
    source = write(tmp_path / "in.exr", ({}, pixels))
    tool.ok("--mark", "all", "--scale", "100", source, tmp_path / "out.exr")
    assert (read(tmp_path / "out.exr")[0].channels["L.Combined.R"] == np.float16(65504)).all()


def test_part_of_another_size_is_copied(tool: Tool, tmp_path: Path) -> None:
    big = {f"V.Combined.{c}": noise((20, 30), np.float16) for c in "RGBA"}
    small = {f"W.Combined.{c}": noise((10, 30), np.float16) for c in "RGBA"}
    window = {"displayWindow": (np.array([0, 0], np.int32), np.array([29, 19], np.int32))}
    source = write(tmp_path / "in.exr", ({"name": "V", **window}, big), ({"name": "W", **window}, small))
    result = tool.ok("--list", "--mark", "all", "--scale", "2", source, tmp_path / "out.exr")
    assert "another size" in result.err and "W.Combined" not in result.out
    before, after = read(source), read(tmp_path / "out.exr")
    assert_same_pixels(before[1], after[1], list(small))
    assert_equal_values(scaled(big["V.Combined.R"], 2), after[0].channels["V.Combined.R"], "V.Combined.R")


def test_tiled_and_deep_parts_are_copied(tool: Tool, tmp_path: Path) -> None:
    import OpenEXR

    tiled = {f"T.Combined.{c}": noise((40, 50), np.float16) for c in "RGBA"}
    flat = {f"V.Combined.{c}": noise((40, 50), np.float16) for c in "RGBA"}
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = 16, 16
    source = write(
        tmp_path / "in.exr",
        ({"name": "T", "type": OpenEXR.tiledimage, "tiles": tiles}, tiled),
        ({"name": "V"}, flat),
    )
    result = tool.ok("--mark", "all", "--scale", "2", "--noisy", source, tmp_path / "out.exr")
    assert "tiled, deep or subsampled" in result.err
    before, after = read(source), read(tmp_path / "out.exr")
    assert_same_header(before[0], after[0], set())
    assert_same_pixels(before[0], after[0], list(tiled))
    assert [p.header["name"] for p in after] == ["T", "V", "V.Noisy Image"]

    only = tool(DATA / "conv_tiled.exr", tmp_path / "tiled.exr")
    assert only.code == 8 and "tiled" in only.err and not (tmp_path / "tiled.exr").exists()


def test_full_names_of_255_bytes(tool: Tool, tmp_path: Path) -> None:
    layer = "x" * 242
    pixels = {f"{layer}.Combined.{c}": noise((9, 9), np.float16) for c in "RGB"}
    source = write(tmp_path / "in.exr", ({}, pixels))
    result = tool.ok("--list", "--mark", "all", "--noisy", source, tmp_path / "out.exr")
    assert f"{layer}|Combined||combined" in result.out
    assert "no 'Noisy Image'" in result.err  # three more letters than Combined: too long for the format
    assert list(read(tmp_path / "out.exr")[0].channels) == list(read(source)[0].channels)


def test_input_may_be_the_output(tool: Tool, tmp_path: Path) -> None:
    file = tmp_path / "same.exr"
    shutil.copy(DATA / "50_all.exr", file)
    file.chmod(0o640)
    tool.ok("--mark", "all", "--scale", "2", file, file)
    tool.ok("--mark", "all", "--scale", "2", DATA / "50_all.exr", tmp_path / "other.exr")
    assert file.read_bytes() == (tmp_path / "other.exr").read_bytes()
    assert file.stat().st_mode & 0o777 == 0o640
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.exr", "same.exr"]


def test_symbolic_link_stays(tool: Tool, tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    target = tmp_path / "real" / "target.exr"
    target.write_bytes(b"old")
    link = tmp_path / "link.exr"
    link.symlink_to(target)
    tool.ok(DATA / "45_plain.exr", link)
    assert link.is_symlink() and target.stat().st_size > 1000


@pytest.mark.parametrize("codec", [1, 2, 3, 4, 5, 11])
@pytest.mark.parametrize("size", [(1, 1), (16, 1), (300, 7), (33, 130)])
def test_chunks_that_do_not_compress(tool: Tool, tmp_path: Path, codec: int, size: tuple[int, int]) -> None:
    """White bits come out of a codec larger than they went in, and are then stored as they are."""
    rng = np.random.default_rng(5)
    channels = {}
    for letter in "RGB":
        values = rng.integers(0, 1 << 16, size, dtype=np.uint16)
        values[(values & 0x7C00) == 0x7C00] &= 0x3FFF  # no NaN: the tool works on floats
        channels[f"L.Combined.{letter}"] = values.view(np.float16)
        channels[f"L.data.{letter}"] = rng.integers(0, 1 << 32, size, dtype=np.uint32)
    source = write(tmp_path / "in.exr", ({}, channels))
    tool.ok("--mark", "all", "--codec", codec, source, tmp_path / "out.exr")
    assert_same_pixels(read(source)[0], read(tmp_path / "out.exr")[0], list(channels))
