# SPDX-License-Identifier: Apache-2.0
"""DGAN-KPN's switches in the tool, on the small random network of tests/golden."""

from __future__ import annotations

import hashlib
import json
import struct

import numpy as np
import pytest


@pytest.fixture(scope="module")
def frame(tmp_path_factory, exr_writer):
    rng = np.random.default_rng(4)
    path = tmp_path_factory.mktemp("dgan") / "frame.exr"
    return exr_writer(path, {f"ViewLayer.{name}": rng.random((30, 41, 3), np.float32) for name in ("Combined", "AO")})


@pytest.fixture
def model(root):
    return ("--model", root / "tests" / "golden" / "dgan_small.qwt")


def test_combined_alone_by_default_and_all_on_request(quell, frame, model, tmp_path, exr_reader):
    before = exr_reader(frame)
    for switches, changed in (((), {"Combined"}), (("--layers", "all"), {"Combined", "AO"})):
        quell.ok("denoise", frame, "-o", tmp_path / "out.exr", *model, *switches)
        after = exr_reader(tmp_path / "out.exr")
        differ = {name.split(".")[1] for name in before if not np.array_equal(before[name], after[name])}
        assert differ == changed


def test_each_switch_makes_another_picture(quell, frame, model, tmp_path, exr_reader):
    results = {}
    for switches in (
        (),
        ("--dgan-only",),
        ("--kpn-only",),
        ("--iterations", "1"),
        ("--iterate", "network", "--run-all-iterations"),
    ):
        quell.ok("denoise", frame, "-o", tmp_path / "out.exr", *model, *switches)
        results[switches] = exr_reader(tmp_path / "out.exr")["ViewLayer.Combined.R"]
        assert np.isfinite(results[switches]).all()
    assert len({r.tobytes() for r in results.values()}) == len(results)
    quell.ok("denoise", frame, "-o", tmp_path / "out.exr", *model, "--iterations", "4", "--iterate", "filter")
    assert np.array_equal(exr_reader(tmp_path / "out.exr")["ViewLayer.Combined.R"], results[()])


def test_the_report_counts_iterations_and_names_what_is_missing(quell, frame, model, tmp_path):
    report = tmp_path / "report.json"
    quell.ok("denoise", frame, "-o", tmp_path / "out.exr", *model, "--iterations", "3", "--report", report)
    file = json.loads(report.read_text())["files"][0]
    assert file["summary"]["iterations"] == 3
    reasons = {layer["name"]: layer["reason"] for layer in file["layers"]}
    assert reasons["ViewLayer.Combined"] == "without all auxiliary passes"


@pytest.mark.parametrize(
    "switches",
    [
        ("--iterations", "0"),
        ("--iterations", "9"),
        ("--iterations", "many"),
        ("--iterate", "twice"),
        ("--dgan-only", "--kpn-only"),
    ],
    ids=" ".join,
)
def test_wrong_switches(quell, frame, model, tmp_path, switches):
    done = quell("denoise", frame, "-o", tmp_path / "out.exr", *model, *switches)
    assert done.returncode == 2 and switches[0] in done.stderr
    assert not (tmp_path / "out.exr").exists()


def test_switches_need_a_model_of_that_kind(quell, frame, tmp_path):
    line = quell.fails(2, "denoise", frame, "-o", tmp_path / "out.exr", "--kpn-only")
    assert "DGAN-KPN" in line
    assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize(
    ("record", "value"),
    [
        ("config.kpn", 24),
        ("config.kpn", -16),
        ("config.kpn", 32),  # allowed, but the layers are not that wide
        ("config.generator.widths", 1 << 30),
        ("config.generator.decoder", 8),
        ("config.generator.blocks", 9),
        ("config.generator.blocks", 3),  # one more than there are
    ],
)
def test_weight_files_that_make_no_network(quell, frame, model, tmp_path, record, value):
    data = bytearray(model[1].read_bytes())
    entry = data.index(record.encode() + b"\0")
    (offset,) = struct.unpack_from("<Q", data, entry + 72)
    struct.pack_into("<i", data, offset, value)
    data[-32:] = hashlib.sha256(data[:-32]).digest()
    bad = tmp_path / "bad.qwt"
    bad.write_bytes(data)
    line = quell.fails(7, "denoise", frame, "-o", tmp_path / "out.exr", "--model", bad)
    assert "bad.qwt" in line
    assert not (tmp_path / "out.exr").exists()
