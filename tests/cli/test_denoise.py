# SPDX-License-Identifier: Apache-2.0
"""quell denoise: where outputs go, what is in them, and that nothing but the job changes a bit."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest


def bits(pixels: np.ndarray) -> bytes:
    return np.ascontiguousarray(pixels).tobytes()


def same_pixels(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return a.keys() == b.keys() and all(bits(a[n]) == bits(b[n]) for n in a)


def test_one_file_to_one_file(quell, data, tmp_path):
    done = quell.ok("denoise", data / "50_all.exr", "-o", tmp_path / "out.exr")
    assert [p.name for p in tmp_path.iterdir()] == ["out.exr"]
    assert done.stdout.startswith(f"{data}/50_all.exr -> {tmp_path}/out.exr: ")
    assert " layers denoised" in done.stdout
    assert done.stderr == ""  # no progress bar in a pipe


def test_folder_keeps_names(quell, data, tmp_path):
    quell.ok("denoise", data / "45_piz.exr", data / "50_all.exr", "-q", "-o", f"{tmp_path}/")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["45_piz.exr", "50_all.exr"]
    quell.ok("denoise", data / "45_plain.exr", "-q", "-o", tmp_path)  # an existing folder needs no '/'
    assert (tmp_path / "45_plain.exr").exists()


def test_patterns(quell, data, tmp_path):
    for name in ("shot_v2.0007.exr", "shot_v2.0012.exr"):
        shutil.copy(data / "45_plain.exr", tmp_path / name)
    inputs = sorted(tmp_path.glob("shot*"))
    quell.ok("denoise", *inputs, "-q", "-o", f"{tmp_path}/clean_######.exr")
    quell.ok("denoise", *inputs, "-q", "-o", f"{tmp_path}/{{name}}_clean.exr")
    quell.ok("denoise", *inputs, "-q", "-o", f"{tmp_path}/#.exr")
    names = sorted(p.name for p in tmp_path.iterdir() if p not in inputs)
    assert names == [
        "0007.exr",
        "0012.exr",
        "clean_000007.exr",
        "clean_000012.exr",
        "shot_v2.0007_clean.exr",
        "shot_v2.0012_clean.exr",
    ]


def test_inputs_are_not_replaced_by_accident(quell, data, tmp_path):
    path = tmp_path / "a.exr"
    shutil.copy(data / "45_plain.exr", path)
    before = path.read_bytes()
    result = quell("denoise", path, "-q", "-o", f"{tmp_path}/")
    assert result.returncode == 2 and "--overwrite" in result.stderr
    result = quell("denoise", path, "-q", "-o", f"{tmp_path}/{{name}}.exr")
    assert result.returncode == 2
    assert path.read_bytes() == before
    quell.ok("denoise", path, "-q", "--overwrite", "-o", f"{tmp_path}/")
    assert path.read_bytes() != before

    path.write_bytes(before)
    quell.ok("denoise", path, "-q", "-o", path)  # named by its own name: explicit enough
    assert path.read_bytes() != before
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_colliding_outputs_are_refused(quell, data, tmp_path):
    (tmp_path / "sub").mkdir()
    shutil.copy(data / "45_plain.exr", tmp_path / "a.exr")
    shutil.copy(data / "45_plain.exr", tmp_path / "sub" / "a.exr")
    (tmp_path / "out").mkdir()
    result = quell("denoise", tmp_path / "a.exr", tmp_path / "sub" / "a.exr", "-o", f"{tmp_path}/out/")
    assert result.returncode == 2 and "would both become" in result.stderr
    result = quell("denoise", tmp_path / "a.exr", tmp_path / "sub" / "a.exr", "-o", f"{tmp_path}/one.exr")
    assert result.returncode == 2 and "one file for 2 inputs" in result.stderr
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("name", ["50_all.exr", "45_all_two_layers.exr", "34_all.exr", "50_interleaved.exr"])
def test_only_denoised_layers_change(quell, data, tmp_path, exr_reader, name):
    out, report = tmp_path / "out.exr", tmp_path / "report.json"
    quell.ok("denoise", data / name, "-q", "-o", out, "--report", report)
    before, after = exr_reader(data / name), exr_reader(out)
    assert before.keys() == after.keys()
    layers = json.loads(report.read_text())["files"][0]["layers"]
    denoised = {layer["name"] for layer in layers if layer["action"] == "denoise"}
    assert any(name.endswith("Combined") for name in denoised)
    changed = {n for n in before if bits(before[n]) != bits(after[n])}
    for channel in changed:
        assert channel.rpartition(".")[0] in denoised, channel
    for layer in denoised:
        assert any(channel.rpartition(".")[0] == layer for channel in changed), layer
    for pixels in after.values():
        assert pixels.shape == (29, 45)


def test_denoised_layers_are_convex_and_finite(quell, data, tmp_path, exr_reader):
    """A filtered value lies between the values of its own layer, and NaN does not come out."""
    out = tmp_path / "out.exr"
    quell.ok("denoise", data / "34_infinite.exr", "-q", "-o", out)
    before, after = exr_reader(data / "34_infinite.exr"), exr_reader(out)
    for name, pixels in after.items():
        if ".Combined." not in name:
            continue
        assert np.isfinite(pixels).all(), name
        finite = before[name][np.isfinite(before[name])].astype(np.float64)
        assert pixels.max() <= finite.max() * 1.001 and pixels.min() >= min(finite.min(), 0.0), name


def test_beauty_and_lists(quell, data, tmp_path, exr_reader):
    def changed(*options: str) -> set[str]:
        out = tmp_path / "out.exr"
        quell.ok("denoise", data / "50_all.exr", "-q", "-o", out, *options)
        before, after = exr_reader(data / "50_all.exr"), exr_reader(out)
        return {n.rpartition(".")[0] for n in before if bits(before[n]) != bits(after[n])}

    assert changed("--layers", "beauty") == {"ViewLayer.Combined"}
    assert changed("--layers", "Emission,ViewLayer.Environment") == {"ViewLayer.Emission", "ViewLayer.Environment"}
    assert "ViewLayer.Diffuse Direct" in changed("--layers", "all")


def test_keep_noisy(quell, data, tmp_path, exr_reader):
    out = tmp_path / "out.exr"
    quell.ok("denoise", data / "50_all.exr", "-q", "--keep-noisy", "-o", out)
    before, after = exr_reader(data / "50_all.exr"), exr_reader(out)
    added = after.keys() - before.keys()
    assert {n.rpartition(".")[0] for n in added} == {"ViewLayer.Noisy Image"}
    for letter in "RGB":
        assert bits(after[f"ViewLayer.Noisy Image.{letter}"]) == bits(before[f"ViewLayer.Combined.{letter}"])


def test_threads_tiles_memory_and_reruns_do_not_change_a_bit(quell, data, tmp_path, exr_reader, exr_writer):
    # Larger than a tile: the fixture repeated, so that there is something to see everywhere.
    source = exr_reader(data / "45_zips_float.exr")
    layers = {}
    for name in ("ViewLayer.Combined", "ViewLayer.DiffDir", "ViewLayer.DiffCol", "ViewLayer.Denoising Albedo"):
        letters = "RGBA" if name.endswith("Combined") else "RGB"
        if all(f"{name}.{c}" in source for c in letters):
            stacked = np.stack([source[f"{name}.{c}"].astype(np.float32) for c in letters], axis=-1)
            layers[name] = np.tile(stacked, (7, 5, 1))
    path = exr_writer(tmp_path / "in.exr", layers)
    runs = [("--threads", "1"), ("--threads", "2"), ("--threads", "3", "--tile", "64"), ("--tile", "96"), ()]
    results = []
    for i, options in enumerate(runs):
        quell.ok("denoise", path, "-q", "-o", tmp_path / f"{i}.exr", *options)
        results.append((tmp_path / f"{i}.exr").read_bytes())
    assert all(result == results[0] for result in results)


def test_kernels_agree(quell, data, tmp_path, exr_reader):
    """Every instruction set of this machine against plain C, on a whole file."""
    names = kernels(quell)
    assert "c" in names
    source, results = data / "50_zip_float.exr", {}
    for name in names:
        path = tmp_path / f"{name}.exr"
        quell.ok("denoise", source, "-q", "--cpu", name, "--precision", "float32", "-o", path)
        results[name] = exr_reader(path)
    for name in names:
        for channel, pixels in results["c"].items():
            if pixels.dtype == np.float32:
                np.testing.assert_allclose(
                    results[name][channel], pixels, rtol=2e-3, atol=2e-5, err_msg=f"{name} {channel}"
                )


def kernels(quell) -> list[str]:
    version = quell.ok("--version", "-v").stdout
    return next(line for line in version.splitlines() if line.startswith("kernels:")).split()[1:]


def test_precision_is_the_kernels_or_the_one_asked_for(quell, data, tmp_path):
    """float32 is the same bits whether the kernels have bfloat16 or not, and what --cpu avx512 gives."""
    source, report = data / "45_all_two_layers.exr", tmp_path / "report.json"
    files = {}
    for cpu in kernels(quell):
        for precision in ("auto", "float32"):
            path = tmp_path / f"{cpu}-{precision}.exr"
            options = ["--cpu", cpu, "--precision", precision, "--report", report]
            quell.ok("denoise", source, "-q", "-o", path, *options)
            used = json.loads(report.read_text())["files"][0]["summary"]["precision"]
            assert used == ("bfloat16" if (cpu, precision) == ("avx512bf16", "auto") else "float32")
            files[cpu, precision] = path.read_bytes()
        if cpu != "avx512bf16":
            assert files[cpu, "auto"] == files[cpu, "float32"]
        if cpu not in ("c", "avx512bf16"):
            line = quell.fails(2, "denoise", source, "-o", tmp_path / "no.exr", "--cpu", cpu, "--precision", "bfloat16")
            assert f"these are '{cpu}'" in line
    if "avx512bf16" not in kernels(quell):
        pytest.skip("this machine lacks AVX512_BF16")
    assert files["avx512bf16", "float32"] == files["avx512", "float32"]
    assert files["avx512bf16", "auto"] != files["avx512", "float32"]


def test_bfloat16_stays_near_float32(quell, data, tmp_path, exr_reader):
    """Plain C's too, which every machine has: rounding to 8 bits inside the network, on tiny noisy pictures."""
    source, results = data / "50_zip_float.exr", {}
    for name in [n for n in kernels(quell) if n in ("c", "avx512bf16")]:
        for precision in ("float32", "bfloat16"):
            path = tmp_path / f"{name}-{precision}.exr"
            quell.ok("denoise", source, "-q", "--cpu", name, "--precision", precision, "-o", path)
            results[name, precision] = exr_reader(path)
    for (name, precision), channels in results.items():
        for channel, pixels in results["c", "float32"].items():
            if pixels.dtype == np.float32:
                near = {"rtol": 2e-2, "atol": 2e-3} if precision == "bfloat16" else {"rtol": 2e-3, "atol": 2e-5}
                np.testing.assert_allclose(channels[channel], pixels, **near, err_msg=f"{name} {precision} {channel}")


def test_exposure_scales_exactly(quell, data, tmp_path, exr_reader, exr_writer):
    source = exr_reader(data / "50_zip_float.exr")
    pixels = np.stack([source[f"ViewLayer.Combined.{c}"] for c in "RGB"], axis=-1).astype(np.float32)
    quell.ok(
        "denoise", exr_writer(tmp_path / "a.exr", {"ViewLayer.Combined": pixels}), "-q", "-o", tmp_path / "a_out.exr"
    )
    scaled = exr_writer(tmp_path / "b.exr", {"ViewLayer.Combined": pixels * np.float32(2.0**9)})
    quell.ok("denoise", scaled, "-q", "-o", tmp_path / "b_out.exr")
    a, b = exr_reader(tmp_path / "a_out.exr"), exr_reader(tmp_path / "b_out.exr")
    for name in a:
        assert bits(a[name] * np.float32(2.0**9)) == bits(b[name]), name


def test_other_readers_agree(quell, data, tmp_path):
    """OpenImageIO reads the output, and finds what was not denoised unchanged."""
    for tool in ("oiiotool", "idiff"):
        if not shutil.which(tool):
            pytest.skip(f"{tool} is not installed")
    out = tmp_path / "out.exr"
    quell.ok("denoise", data / "45_zips_float.exr", "-q", "-o", out, "--layers", "beauty")
    info = [
        subprocess.run(["oiiotool", "--info", "-v", p], capture_output=True, text=True, check=True).stdout
        for p in (data / "45_zips_float.exr", out)
    ]
    strip = [
        [line for line in text.splitlines() if "Reading" not in line and not line.startswith("/")] for text in info
    ]
    assert [line for line in strip[0] if "channel list" in line] == [
        line for line in strip[1] if "channel list" in line
    ]
    channels = "ViewLayer.DiffDir.R,ViewLayer.DiffDir.G,ViewLayer.DiffDir.B"
    parts = []
    for i, p in enumerate((data / "45_zips_float.exr", out)):
        parts.append(tmp_path / f"part{i}.exr")
        subprocess.run(["oiiotool", p, "--ch", channels, "-o", parts[-1]], check=True, capture_output=True)
    done = subprocess.run(["idiff", "-fail", "0", *parts], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_codec(quell, data, tmp_path):
    sizes = {}
    for codec in ("keep", "none", "zip", "dwaa", "htj2k"):
        out = tmp_path / f"{codec}.exr"
        quell.ok("denoise", data / "45_none.exr", "-q", "-o", out, "--codec", codec)
        sizes[codec] = out.stat().st_size
        found = json.loads(quell.ok("inspect", "--json", out).stdout)[0]["layers"][0]["compression"]
        assert found.startswith("none" if codec == "keep" else codec)  # HTJ2K comes in two block sizes
    assert sizes["zip"] < sizes["none"] and sizes["keep"] == sizes["none"]


def test_report_says_what_was_done(quell, data, tmp_path):
    out = quell.ok("denoise", data / "50_all.exr", "-o", tmp_path / "out.exr", "--report", "-").stdout
    report = json.loads(out)  # nothing else on standard output
    assert report["quell"] and report["threads"] >= 1
    file = report["files"][0]
    assert file["exit_code"] == 0 and file["output"].endswith("out.exr")
    assert file["summary"]["model"] and file["summary"]["peak_bytes"] > 0
    actions = {layer["name"]: layer for layer in file["layers"]}
    assert (
        actions["ViewLayer.Volume Indirect"] | {"action": "skip", "reason": "zero everywhere"}
        == actions["ViewLayer.Volume Indirect"]
    )
    assert actions["ViewLayer.Denoising Albedo"]["action"] == "guide"
    assert actions["ViewLayer.CryptoObject00"]["action"] == "keep"
    assert actions["ViewLayer.Combined"]["mean_before"] > 0


def test_one_bad_file_does_not_stop_the_others(quell, data, tmp_path):
    bad = tmp_path / "bad.exr"
    bad.write_bytes(b"no")
    report = tmp_path / "r.json"
    (tmp_path / "out").mkdir()
    result = quell("denoise", bad, data / "45_plain.exr", "-q", "-o", f"{tmp_path}/out/", "--report", report)
    assert result.returncode == 4
    assert (tmp_path / "out" / "45_plain.exr").exists() and not (tmp_path / "out" / "bad.exr").exists()
    assert [f["exit_code"] for f in json.loads(report.read_text())["files"]] == [4, 0]
    result = quell("denoise", bad, tmp_path / "missing.exr", "-q", "-o", f"{tmp_path}/out/")
    assert result.returncode == 1  # different reasons


@pytest.mark.usefixtures("own_process")
def test_valgrind_finds_nothing(quell, data, tmp_path):
    if not shutil.which("valgrind"):
        pytest.skip("valgrind is not installed")
    if "san-" in str(quell.program):
        pytest.skip("a sanitizer is in this build")
    # Valgrind 3.19 does not know AVX-512: AVX2 is the widest it can run.
    command = [
        "valgrind",
        "-q",
        "--error-exitcode=99",
        "--leak-check=full",
        "--show-leak-kinds=definite",
        "--errors-for-leak-kinds=definite",
        quell.program,
        "denoise",
        data / "50_all.exr",
        "-q",
        "--cpu",
        "avx2",
        "-o",
        tmp_path / "out.exr",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
