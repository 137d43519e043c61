# SPDX-License-Identifier: Apache-2.0
"""Runs: the rate's schedule, what a kill costs (nothing), and which frames a run knows."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from synthetic import write_data_set, write_frame

from training import native
from training import train as training
from training.data.crops import CropConfig
from training.data.roster import Roster, RosterError
from training.models.quell import QuellConfig
from training.train import Pace, TrainConfig, config_from_json, rate_at, train

STEPS = 8
CONFIG = TrainConfig(
    model=QuellConfig(widths=(16, 16, 16, 16)),
    crops=CropConfig(crop=64, batch=2),
    total_steps=STEPS,
    warmup_steps=2,
)
CPU = torch.device("cpu")
PACE = Pace(min_renders=6)


# ---- Schedule -------------------------------------------------------------------------------------------------------


def test_rate_rises_then_falls_as_a_cosine() -> None:
    config = TrainConfig(total_steps=1100, warmup_steps=100, rate=1e-3, final_rate=0.02)
    assert rate_at(0, config) == pytest.approx(1e-5)
    assert rate_at(49, config) == pytest.approx(5e-4)
    assert rate_at(99, config) == rate_at(100, config) == pytest.approx(1e-3)
    assert rate_at(600, config) == pytest.approx(1e-3 * (0.02 + 0.98 * 0.5))  # half way: cos(pi / 2) = 0
    assert rate_at(350, config) == pytest.approx(1e-3 * (0.02 + 0.98 * 0.5 * (1 + math.sqrt(0.5))))
    assert rate_at(1100, config) == rate_at(9999, config) == pytest.approx(2e-5)


def test_config_survives_json_and_unknown_keys_are_errors() -> None:
    data = json.loads(json.dumps(dataclasses.asdict(CONFIG)))
    assert config_from_json(data) == CONFIG
    for bad in ({"stepz": 3}, {"model": {"width": [1]}}, {"crops": {"colour": 1}}):
        with pytest.raises(TypeError):
            config_from_json(bad)


# ---- Kill and resume ------------------------------------------------------------------------------------------------


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Runs and data of their own."""
    native.library()  # compiled once, into the cache of all tests
    compiled = training.state_root() / "native"
    monkeypatch.setenv("QUELL_CACHE", str(tmp_path))
    monkeypatch.setenv("QUELL_DATA", str(tmp_path / "data"))
    (tmp_path / "native").symlink_to(compiled)
    return tmp_path


@pytest.fixture
def data(state: Path) -> Path:
    return write_data_set(state / "data")


def checkpoint(state: Path, name: str) -> dict:
    return torch.load(state / "runs" / name / "checkpoint.pt", weights_only=True)


def assert_same(a: object, b: object, where: str = "") -> None:
    """Bit by bit, through dictionaries and lists."""
    if isinstance(a, torch.Tensor):
        assert isinstance(b, torch.Tensor) and torch.equal(a, b), where
    elif isinstance(a, dict):
        assert isinstance(b, dict) and a.keys() == b.keys(), where
        for key in a:
            assert_same(a[key], b[key], f"{where}/{key}")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}/{i}")
    else:
        assert a == b, where


def start(name: str, state: Path, config: TrainConfig) -> subprocess.Popen[str]:
    """The command line, with a checkpoint after every step."""
    path = state / f"{name}.json"
    path.write_text(json.dumps(dataclasses.asdict(config)))
    command = [sys.executable, "-c", "from training import train;"]
    command[-1] += "train.LOG_STEPS = 1; train.main()"
    command += [
        "--run",
        name,
        "--config",
        str(path),
        "--checkpoint-seconds",
        "0",
        "--device",
        "cpu",
        "--min-renders",
        "6",
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)


def test_a_killed_run_ends_with_the_same_weights(state: Path, data: Path) -> None:
    train("whole", CONFIG, PACE, CPU)
    assert checkpoint(state, "whole")["step"] == STEPS
    process = start("killed", state, CONFIG)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("3,"):
            break
    process.send_signal(signal.SIGKILL)
    process.wait()
    reached = checkpoint(state, "killed")["step"]
    assert 0 < reached < STEPS, "killed too late to prove anything"
    train("killed", CONFIG, PACE, CPU)
    assert_same(checkpoint(state, "killed"), checkpoint(state, "whole"))


def test_frames_that_joined_join_again_at_their_step(state: Path, data: Path) -> None:
    """New renders arrive in the middle; the run is then killed and goes on from before they did."""
    train("whole", dataclasses.replace(CONFIG, total_steps=3), PACE, CPU)
    early = (state / "runs" / "whole" / "checkpoint.pt").read_bytes()
    write_frame(data, "dunes/00007_0", 64, seed=7)
    train("whole", CONFIG, dataclasses.replace(PACE, repack_seconds=0), CPU)
    whole = checkpoint(state, "whole")
    assert whole["frames"] == 4
    entries = json.loads((state / "runs" / "whole" / "frames.json").read_text())
    assert [len(entry["frames"]) for entry in entries] == [3, 1] and entries[1]["step"] == 4
    # As after a kill: the journal knows more than the checkpoint.
    (state / "runs" / "whole" / "checkpoint.pt").write_bytes(early)
    write_frame(data, "dunes/00008_0", 64, seed=8)  # later still: must not join before what the journal has
    train("whole", CONFIG, PACE, CPU)
    assert_same(checkpoint(state, "whole"), whole)


def test_minutes_end_a_run_early(state: Path, data: Path) -> None:
    began = time.monotonic()
    assert (
        train("short", dataclasses.replace(CONFIG, total_steps=10**6), dataclasses.replace(PACE, minutes=0.02), CPU)
        >= 1
    )
    assert time.monotonic() - began < 60
    assert (state / "runs" / "short" / "checkpoint.pt").exists()


def test_training_lowers_the_loss(state: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "LOG_STEPS", 1)
    train("learn", dataclasses.replace(CONFIG, total_steps=30, rate=3e-3), PACE, CPU)
    losses = [float(line.split(",")[1]) for line in (state / "runs" / "learn" / "log.csv").read_text().splitlines()]
    assert losses[-1] < losses[0]


# ---- Frames ---------------------------------------------------------------------------------------------------------


def names(roster: Roster, step: int) -> list[str]:
    return [frame.name for frame in roster.frames(step)]


def test_a_pinned_run_keeps_its_frames(tmp_path: Path) -> None:
    root = write_data_set(tmp_path / "data", frames=2, size=32)
    roster = Roster(tmp_path / "run", "train", 6, root, grow=False)
    write_frame(root, "hills/00009_0", 32, seed=9)
    roster.update(5)
    assert names(roster, 5) == names(Roster(tmp_path / "run", "train", 6, root), 0) and len(names(roster, 5)) == 2


def test_a_run_without_frames_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(RosterError, match="render some first"):
        Roster(tmp_path / "run", "train", 6, tmp_path)


def test_lost_frames_are_named(tmp_path: Path) -> None:
    root = write_data_set(tmp_path / "data", frames=2, size=32)
    roster = Roster(tmp_path / "run", "train", 6, root)
    gone = next((root / "packed" / "train").iterdir())
    gone.rename(tmp_path / "elsewhere")
    with pytest.raises(RosterError, match=gone.name):
        roster.frames(0)


def test_more_renders_of_a_frame_are_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "data"
    renders = ("1_0", "1_1", "2_0", "4_0", "8_0")
    write_frame(root, "hills/00000_0", 32, 1, renders)
    roster = Roster(tmp_path / "run", "train", 5, root)
    write_frame(root, "hills/00000_0", 32, 1)
    roster.update(4)
    assert [frame.total_spp for frame in roster.frames(4)] == [32] and "no exact repeat" not in capsys.readouterr().out
    roster.frames(0)
    assert "no exact repeat" in capsys.readouterr().out
