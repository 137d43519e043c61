# SPDX-License-Identifier: Apache-2.0
"""The Python package as the wheel installs it, without Blender."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="session")
def wheel_folder(build) -> Path:
    folder = build / "wheel"
    assert list(folder.glob("*.whl")), f"no wheel in {folder}: run make wheel"
    return folder


@pytest.fixture(scope="session")
def package(wheel_folder):
    """The installed package; not the one of the source tree, which has no library."""
    sys.path.insert(0, str(wheel_folder / "site"))
    import quell

    assert Path(quell.__file__).is_relative_to(wheel_folder)
    return quell


@pytest.fixture
def context(package):
    with package.Context(threads=2) as context:
        yield context


@pytest.fixture
def noisy() -> np.ndarray:
    random = np.random.default_rng(7)
    return (random.random((48, 70, 4), np.float32) * 2).astype(np.float32)


def denoised(context, pixels: np.ndarray, **keywords) -> np.ndarray:
    with context.new_frame(pixels.shape[1], pixels.shape[0]) as frame:
        frame.add_layer("Combined", pixels, **keywords)
        context.denoise(frame, context.open_model())
        return frame.pixels("Combined")


def test_wheel_is_for_any_python_on_manylinux(wheel_folder):
    (wheel,) = wheel_folder.glob("*.whl")
    assert "-py3-none-manylinux" in wheel.name


def test_structs_are_those_of_the_header(package, root, tmp_path):
    """Offsets and sizes of every field, as a C compiler sees them. The library may have grown a longer tail."""
    native = package.native
    names = {
        native.ContextOptions: "quell_context_options",
        native.ModelInfo: "quell_model_info",
        native.Image: "quell_image",
        native.LayerInfo: "quell_layer_info",
        native.WriteOptions: "quell_write_options",
        native.Options: "quell_options",
        native.ReportLayer: "quell_report_layer",
        native.ReportSummary: "quell_report_summary",
    }
    assert set(names) == set(native.SizedStruct.__subclasses__())
    expected = []
    lines = []
    for struct, name in names.items():
        for field, *_ in struct._fields_:
            c_field = field.rstrip("_")
            expected.append((name, c_field, getattr(struct, field).offset, getattr(struct, field).size))
            arguments = f'"{name} {c_field} %zu %zu\\n", offsetof({name}, {c_field}), sizeof((({name} *)0)->{c_field})'
            lines.append(f"printf({arguments});")
    source = tmp_path / "layout.c"
    body = "\n".join(lines)
    source.write_text(f"#include <quell.h>\n#include <stdio.h>\nint main(void)\n{{\n{body}\nreturn 0;\n}}\n")
    subprocess.run(["gcc", "-I", str(root / "include"), "-o", str(tmp_path / "layout"), str(source)], check=True)
    output = subprocess.run([str(tmp_path / "layout")], capture_output=True, text=True, check=True).stdout
    found = [(a, b, int(c), int(d)) for a, b, c, d in map(str.split, output.splitlines())]
    assert found == expected


def test_constants_are_those_of_the_header(package, root):
    native = package.native
    header = (root / "include" / "quell.h").read_text()
    tables = {
        "QUELL_CPU_": native.CPU,
        "QUELL_CODEC_": native.CODEC,
        "QUELL_QUALITY_": native.QUALITY,
        "QUELL_PRECISION_": native.PRECISION,
    }
    for prefix, table in tables.items():
        for name, value in table.items():
            assert f"{prefix}{name.upper()} = {value}" in header
    for value, name in native.ACTION.items():
        assert f"QUELL_ACTION_{name.upper()} = {value}" in header
    major, minor = native.ABI_VERSION
    assert f"#define QUELL_VERSION_MAJOR {major}\n#define QUELL_VERSION_MINOR {minor}\n" in header
    for name, value in (
        ("FORMAT_HALF", 1),
        ("LAYER_BORROW", 1),
        ("DENOISE_KEEP_NOISY", 1),
        ("DENOISE_DEBUG_LAYERS", 8),
    ):
        assert f"QUELL_{name} = {value}" in header and getattr(native, name) == value


def test_file_gives_the_tools_bits(package, context, quell, data, tmp_path, exr_reader):
    source = data / "50_all.exr"
    with context.read_exr(source) as frame:
        report = context.denoise(frame, context.open_model())
        frame.write_exr(tmp_path / "package.exr")
    quell.ok("denoise", source, "-o", tmp_path / "tool.exr", "--quiet")
    assert (tmp_path / "package.exr").read_bytes() == (tmp_path / "tool.exr").read_bytes()
    assert "ViewLayer.Combined" in report.names("denoised")
    assert report.model == package.models()[0]
    assert report.seconds_total > 0


def test_memory_gives_the_files_bits(context, data, exr_reader):
    """The same layers, handed over as arrays whose rows lie bottom-up, borrowed."""
    with context.read_exr(data / "45_none.exr") as frame:
        layers = {layer.full_name: frame.pixels(layer.full_name) for layer in frame.layers}
        samples = frame.layers[0].samples
        context.denoise(frame, context.open_model())
        expected = frame.pixels("Combined")
    flipped = {name: np.ascontiguousarray(pixels[::-1]) for name, pixels in layers.items()}
    height, width = expected.shape[:2]
    with context.new_frame(width, height) as frame:
        for name, pixels in flipped.items():
            frame.add_layer(name, pixels[::-1], borrow=True)
        frame.set_samples(samples)
        context.denoise(frame, context.open_model())
    (combined,) = [pixels for name, pixels in flipped.items() if name.endswith("Combined")]
    # The file's Combined is half: written back, the result is rounded; a borrowed float layer is not.
    assert np.array_equal(combined[::-1].astype(np.float16), expected.astype(np.float16))


@pytest.mark.parametrize("layout", ["flipped", "planar", "transposed", "cropped"])
def test_strides_are_used_as_they_are(context, noisy, layout):
    expected = denoised(context, noisy)
    height, width, channels = noisy.shape
    view = {
        "flipped": lambda: noisy[::-1].copy()[::-1],
        "planar": lambda: noisy.transpose(2, 0, 1).copy().transpose(1, 2, 0),
        "transposed": lambda: noisy.transpose(1, 0, 2).copy().transpose(1, 0, 2),
        "cropped": lambda: np.pad(noisy, ((3, 5), (2, 7), (1, 2)))[3 : 3 + height, 2 : 2 + width, 1 : 1 + channels],
    }[layout]()
    assert not view.flags.c_contiguous
    assert np.array_equal(denoised(context, view), expected)
    assert np.array_equal(denoised(context, view, borrow=True), expected)
    assert np.array_equal(view, expected)  # borrowed: the result stands where the noise was


def test_copied_layers_leave_the_callers_array_alone(context, noisy):
    before = noisy.copy()
    denoised(context, noisy)
    assert np.array_equal(noisy, before)


def test_other_types_and_broadcasts_are_converted(context, noisy):
    assert np.array_equal(denoised(context, noisy.astype(np.float64)), denoised(context, noisy))
    flat = np.broadcast_to(np.float32([0.5, 0.25, 1, 1]), (32, 40, 4))
    assert np.array_equal(denoised(context, flat), flat)


def test_borrowing_refuses_what_it_cannot_write(package, context, noisy):
    with context.new_frame(70, 48) as frame:
        with pytest.raises(package.QuellError, match="float64"):
            frame.add_layer("Combined", noisy.astype(np.float64), borrow=True)
        noisy.flags.writeable = False
        with pytest.raises(package.QuellError, match="writeable"):
            frame.add_layer("Combined", noisy, borrow=True)


def test_wrong_shapes_are_refused(package, context):
    with context.new_frame(8, 8) as frame:
        with pytest.raises(package.QuellError, match="9 x 8"):
            frame.add_layer("Combined", np.zeros((8, 9, 4), np.float32))
        with pytest.raises(package.QuellError, match="shape"):
            frame.add_layer("Combined", np.zeros(64, np.float32))
        with pytest.raises(package.QuellError, match="channels"):
            frame.add_layer("Combined", np.zeros((8, 8, 2), np.float32))


def test_errors_carry_the_librarys_sentence(package, context, tmp_path):
    with pytest.raises(package.FileError, match="missing.exr") as caught:
        context.read_exr(tmp_path / "missing.exr")
    assert caught.value.name == "QUELL_ERR_FILE_NOT_FOUND"
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(package.FileError, match="text.exr"):
        context.read_exr(tmp_path / "text.exr")
    with pytest.raises(package.QuellError, match="no-such-model"):
        context.open_model("no-such-model")
    with pytest.raises(package.NoLayerError), context.new_frame(8, 8) as frame:
        frame.add_layer("Depth", np.zeros((8, 8, 1), np.float32))
        context.denoise(frame, context.open_model())
    with pytest.raises(package.QuellError, match="zero byte"):
        context.open_model("a\0b")
    with pytest.raises(package.QuellError, match="known: auto"):
        package.Context(cpu="abacus")


def test_debug_layers_are_appended(package, context, noisy):
    with context.new_frame(70, 48) as frame:
        frame.add_layer("Combined", noisy)
        report = context.denoise(frame, context.open_model(), debug_layers=True)
        names = [layer.full_name for layer in frame.layers]
        assert names == ["Combined", "Quell Noise", "Quell Confidence", "Quell Skipped"]
        assert len(report.layers) == 1
        confidence = frame.pixels("Quell Confidence")
        assert confidence.shape[:2] == (48, 70) and 0 <= confidence.min() <= confidence.max() <= 1


def test_progress_rises_to_one(context, noisy):
    seen: list[float] = []
    with context.new_frame(70, 48) as frame:
        frame.add_layer("Combined", noisy)
        context.denoise(frame, context.open_model(), progress=lambda fraction: seen.append(fraction))
    assert seen == sorted(seen) and seen[-1] == 1.0


def test_progress_cancels_and_raises(package, context, noisy):
    before = noisy.copy()
    with context.new_frame(70, 48) as frame:
        frame.add_layer("Combined", noisy, borrow=True)
        with pytest.raises(package.CancelledError):
            context.denoise(frame, context.open_model(), progress=lambda _: True)
        assert np.array_equal(noisy, before)
        with pytest.raises(ZeroDivisionError):
            context.denoise(frame, context.open_model(), progress=lambda _: 1 / 0)
        assert np.array_equal(noisy, before)


def test_cancel_from_another_thread(package, context):
    pixels = np.random.default_rng(1).random((1024, 2048, 4), np.float32)
    with context.new_frame(2048, 1024) as frame:
        frame.add_layer("Combined", pixels, borrow=True)
        started = threading.Event()
        timer = threading.Thread(target=lambda: (started.wait(), context.cancel()))
        timer.start()
        with pytest.raises(package.CancelledError):
            context.denoise(frame, context.open_model(), progress=lambda _: started.set())
        timer.join()


def test_roles(package):
    found = package.roles({"Combined": 4, "DiffDir": 3, "Diffuse Direct": 3, "my value": 1})
    assert found == {
        "Combined": "combined",
        "DiffDir": "diffuse-direct",
        "Diffuse Direct": "diffuse-direct",
        "my value": "other",
    }


def test_quality_levels(package, context, noisy):
    """Each level that the library has gives its own network's result, by either way; the default is balanced."""
    levels = package.qualities()
    assert "balanced" in levels and set(levels) <= set(package.native.QUALITY)
    results = {}
    for level in [None, *levels]:
        with context.new_frame(70, 48) as frame:
            frame.add_layer("Combined", noisy)
            assert context.plan(frame, quality=level).model == f"quell-{level or 'balanced'}"
            assert context.denoise(frame, quality=level).model == f"quell-{level or 'balanced'}"
            results[level] = frame.pixels("Combined")
        with context.open_model(quality=level) as model:
            assert model.info.quality == (level or "balanced") and model.info.weight_file == f"{model.info.name}.qwt"
    assert np.array_equal(results[None], results["balanced"])
    assert np.array_equal(results[None], denoised(context, noisy))
    assert len({results[level].tobytes() for level in levels}) == len(levels)


def test_precision(package, noisy):
    """The one asked for, or the kernels' own, and it shows in the result; kernels without bfloat16 say so."""
    results = {}
    for cpu in ("c", "auto"):
        with package.Context(cpu=cpu) as context:
            for precision in ("auto", "float32", "bfloat16"):
                with context.new_frame(70, 48) as frame:
                    frame.add_layer("Combined", noisy)
                    if precision == "bfloat16" and context.cpu not in ("c", "avx512bf16"):
                        with pytest.raises(package.QuellError, match="avx512bf16"):
                            context.denoise(frame, precision=precision)
                        continue
                    auto = "bfloat16" if context.cpu == "avx512bf16" else "float32"
                    used = auto if precision == "auto" else precision
                    assert context.plan(frame, precision=precision).precision == used
                    assert context.denoise(frame, precision=precision).precision == used
                    results.setdefault((context.cpu, used), []).append(frame.pixels("Combined"))
    assert not np.array_equal(results["c", "float32"][0], results["c", "bfloat16"][0])
    for same in results.values():
        assert all(np.array_equal(same[0], other) for other in same)
    with package.Context(threads=1) as context, context.new_frame(70, 48) as frame:
        with pytest.raises(package.QuellError, match="known: auto, float32, bfloat16"):
            context.denoise(frame, precision="half")


def test_quality_is_refused_with_a_model_and_where_it_is_none(package, context, noisy):
    with context.open_model() as model, context.new_frame(70, 48) as frame:
        frame.add_layer("Combined", noisy)
        with pytest.raises(package.QuellError, match="one of them"):
            context.denoise(frame, model, quality="high")
        with pytest.raises(package.QuellError, match="known: fast, balanced, high"):
            context.denoise(frame, quality="best")
    with pytest.raises(package.QuellError, match="one of them"):
        context.open_model("dgan-kpn", quality="high")
    for level in set(package.native.QUALITY) - set(package.qualities()):
        with pytest.raises(package.FileError, match=f"weights/quell-{level}.qwt"):
            context.open_model(quality=level)


def test_closed_handles_say_so(package, context):
    model = context.open_model()
    model.close()
    model.close()
    with pytest.raises(package.QuellError, match="closed"):
        _ = model.info


def test_why_a_library_is_not_loaded(wheel_folder, tmp_path):
    """An older system and another processor are told in words, from what the system's own loader says."""
    content = (wheel_folder / "site" / "quell" / "libquell.so").read_bytes()
    newer, foreign, other_class = (tmp_path / name for name in ("newer.so", "foreign.so", "other_class.so"))
    newer.write_bytes(content.replace(b"GLIBC_2.3", b"GLIBC_9.3"))
    foreign.write_bytes(content[:18] + b"\xff" + content[19:])  # ELF's e_machine
    other_class.write_bytes(content[:4] + bytes([3 - content[4]]) + content[5:])
    for library, sentence in (
        (newer, "newer.so needs glibc 9.3"),
        (foreign, "is built for another processor"),
        (other_class, "is built for another processor"),
    ):
        result = subprocess.run(
            [sys.executable, "-c", "import quell; quell.version()"],
            env={**os.environ, "PYTHONPATH": str(wheel_folder / "site"), "QUELL_LIBRARY": str(library)},
            capture_output=True,
            text=True,
        )
        assert "LibraryError" in result.stderr and sentence in result.stderr


def test_library_of_another_kind_is_refused(wheel_folder, tmp_path):
    """A library without the functions, one of another version, and none at all: a sentence, not a crash."""
    source = tmp_path / "other.c"
    names = subprocess.run(
        [sys.executable, "-c", "import quell.native as n; print(*n.SIGNATURES)"],
        env={**os.environ, "PYTHONPATH": str(wheel_folder / "site")},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    source.write_text("".join(f"unsigned {name}(void) {{ return 70000; }}\n" for name in names))
    other = tmp_path / "other.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", str(other), str(source)], check=True)
    for library, sentence in (
        (other, "version 7.0, this package needs"),
        (Path("/lib/x86_64-linux-gnu/libm.so.6"), "is no libquell"),
        (tmp_path / "none.so", "cannot be loaded"),
    ):
        result = subprocess.run(
            [sys.executable, "-c", "import quell; quell.version()"],
            env={**os.environ, "PYTHONPATH": str(wheel_folder / "site"), "QUELL_LIBRARY": str(library)},
            capture_output=True,
            text=True,
        )
        assert "LibraryError" in result.stderr and sentence in result.stderr
