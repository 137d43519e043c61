# SPDX-License-Identifier: Apache-2.0
"""Export: what is written is what is read, and the C library makes of it what PyTorch makes."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from training import export, parity
from training.models.quell import Quell, QuellConfig, multiply_adds
from training.train import config_from_json

CONFIG = QuellConfig(widths=(16, 16, 32, 16))


LEVELS = sorted((Path(__file__).resolve().parents[2] / "training" / "configs").glob("*.json"))


def wild_model(seed: int, config: QuellConfig = CONFIG) -> Quell:
    """Weights of a size that makes every kernel lean somewhere."""
    torch.manual_seed(seed)
    model = Quell(config)
    for head in model.net.heads:
        torch.nn.init.normal_(head.weight, std=0.1)
    return model


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Quell]:
    model = wild_model(1)
    path = tmp_path_factory.mktemp("export") / "wild.qwt"
    export.export(model, path, "wild", "random weights")
    return path, export.round_to_half(model)


def test_round_trip(exported: tuple[Path, Quell]) -> None:
    path, model = exported
    loaded = export.load_weights(path)
    assert loaded.net.config == CONFIG
    for (name, a), (_, b) in zip(model.state_dict().items(), loaded.state_dict().items(), strict=True):
        assert torch.equal(a, b), name


def test_the_same_model_makes_the_same_file(exported: tuple[Path, Quell], tmp_path: Path) -> None:
    path, _ = exported
    export.export(wild_model(1), tmp_path / "again.qwt", "wild", "random weights")
    assert (tmp_path / "again.qwt").read_bytes() == path.read_bytes()


def test_released_weights_can_be_read(root: Path) -> None:
    for path in sorted((root / "weights").glob("*.qwt")):
        values = export.read_weights(path)
        assert values["meta.name"] == path.stem
        assert all(np.isfinite(v).all() for v in values.values() if isinstance(v, np.ndarray))


@pytest.mark.parametrize("damage", ["magic", "cut", "bit", "version"])
def test_damaged_files_are_refused(damage: str, exported: tuple[Path, Quell], tmp_path: Path) -> None:
    content = bytearray(exported[0].read_bytes())
    if damage == "magic":
        content[0] = 0
    elif damage == "cut":
        content = content[:-1]
    elif damage == "bit":
        content[len(content) // 2] ^= 1
    else:
        content[8] = 9
    bad = tmp_path / "bad.qwt"
    bad.write_bytes(content)
    with pytest.raises(export.WeightFileError, match="bad.qwt"):
        export.load_weights(bad)


@pytest.mark.parametrize("fixture", ["45_none.exr", "50_zip_float.exr", "45_beauty_guides.exr", "45_plain.exr"])
def test_the_tool_denoises_as_pytorch_does(
    fixture: str, exported: tuple[Path, Quell], data: Path, build: Path, tmp_path: Path
) -> None:
    worst = parity.compare(build / "bin" / "quell", exported[0], data / fixture, tmp_path)
    assert "Combined" in worst and max(worst.values()) < parity.TOLERANCE, worst


@pytest.mark.parametrize("path", LEVELS, ids=lambda path: path.stem)
def test_the_shape_of_each_quality_level(path: Path, data: Path, build: Path, tmp_path: Path) -> None:
    """What training makes of the level's configuration, the library runs, and counts as training does."""
    config = config_from_json(json.loads(path.read_text())).model
    weights, tool = tmp_path / "level.qwt", build / "bin" / "quell"
    export.export(wild_model(2, config), weights, "level", "random weights")
    worst = parity.compare(tool, weights, data / "45_beauty_guides.exr", tmp_path)
    assert max(worst.values()) < parity.TOLERANCE, worst
    command = [tool, "bench", "--json", "--size", "64x64", "--layers", "1", "--runs", "1", "--model", weights]
    counted = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["macs_per_pixel"]
    assert counted == pytest.approx(multiply_adds(config, 2))  # Combined and its albedo


def test_the_levels_have_configurations() -> None:
    assert {path.stem for path in LEVELS} == {"fast", "balanced", "high"}
