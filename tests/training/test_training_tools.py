# SPDX-License-Identifier: Apache-2.0
"""The commands round the training loop: pieces, sessions, fine-tuning, learning curves, model cards."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import clean_render, noisy_render, sum_passes, write_data_set

from training import card, export, finetune, native, pieces, runlog, session, shards
from training.data.store import PASSES
from training.exr import MissingPassError, read_exr, write_exr
from training.models.quell import Quell, QuellConfig
from training.paths import state_root
from training.train import run_folder

CPU = torch.device("cpu")
SMALL = QuellConfig(widths=(16, 16, 16, 16))


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Runs of their own; compiled kernels are shared."""
    native.library()
    (tmp_path / "native").symlink_to(state_root() / "native")
    monkeypatch.setenv("QUELL_CACHE", str(tmp_path))
    return tmp_path


# ---- Pieces ---------------------------------------------------------------------------------------------------------


def test_pieces_join_to_the_same_file(tmp_path: Path) -> None:
    whole = tmp_path / "whole.bin"
    whole.write_bytes(np.random.default_rng(0).bytes(1_000_003))
    made = pieces.split(whole, tmp_path / "out", 300_000)
    assert [p.stat().st_size for p in made] == [300_000, 300_000, 300_000, 100_003]
    joined = pieces.join(tmp_path / "out" / "whole.bin", tmp_path / "again.bin")
    assert joined.read_bytes() == whole.read_bytes()
    made[1].write_bytes(b"x" * 300_000)
    with pytest.raises(pieces.PiecesError, match="not those that were split"):
        pieces.join(tmp_path / "out" / "whole.bin")
    made[2].unlink()
    with pytest.raises(pieces.PiecesError, match="002 is missing"):
        pieces.join(tmp_path / "out" / "whole.bin")


# ---- Sessions -------------------------------------------------------------------------------------------------------


def run_session(out: Path, data: Path, carried: list[Path], config: Path, minutes: float) -> int:
    return session.session(
        "carried", out, minutes, session.Rendering(), CPU,
        carried=carried, config_file=config, min_renders=6, frames_to_begin=2, data=data,
    )  # fmt: skip


def test_a_session_trains_on_carried_shards_and_goes_on_elsewhere(
    state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_data_set(tmp_path / "source")
    shards.pack(source, "train", tmp_path / "shards")
    config = tmp_path / "config.json"
    config.write_text(json.dumps({"model": {"widths": [16] * 4}, "crops": {"crop": 64, "batch": 2}}))
    out = tmp_path / "out"
    first = run_session(out, tmp_path / "data", [tmp_path / "shards"], config, 0.15)
    assert first >= 1
    facts = json.loads((out / "session.json").read_text())
    assert facts["step"] == first and facts["frames"] == 3
    assert all(path.stat().st_size <= 16 << 20 for path in out.iterdir())
    assert export.load_weights(out / "carried.qwt").net.config == SMALL
    # Another machine: nothing but the output folder and the shards.
    monkeypatch.setenv("QUELL_CACHE", str(tmp_path / "elsewhere"))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "native").symlink_to(state / "native")
    second = run_session(out, tmp_path / "elsewhere" / "data", [tmp_path / "shards"], config, 0.15)
    assert second > first


def test_a_session_without_frames_ends_in_time(state: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no frames to train on"):
        run_session(tmp_path / "out", tmp_path / "data", [], tmp_path / "none.json", 0.01)


# ---- Fine-tuning ----------------------------------------------------------------------------------------------------


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(2)
    path = tmp_path / "start.qwt"
    export.export(Quell(SMALL), path, "start", "untrained")
    return path


def write_renders(folder: Path, spp: list[int], passes: frozenset[str] | None = None, size: int = 64) -> list[Path]:
    """Renders of one frame as EXRs, seeds of their own."""
    clean = clean_render(size, 1)
    paths = []
    for i, count in enumerate(spp):
        paths.append(folder / f"render{i}.exr")
        write_exr(paths[-1], noisy_render(clean, count, np.random.default_rng(i)), count, passes)
    return paths


def errors(text: str) -> dict[str, float]:
    lines = [line.split() for line in text.splitlines() if "relative squared error" in line]
    return {line[0]: float(line[1]) for line in lines}


def test_finetuning_on_a_pair(state: Path, tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noisy, _ = write_renders(tmp_path, [4, 4])
    clean = clean_render(64, 1)
    sum_passes(clean)
    reference = tmp_path / "reference.exr"
    write_exr(reference, clean, 1024)
    out = tmp_path / "mine.qwt"
    command = ["--weights", weights, "--out", out, "--pair", noisy, reference, "--steps", 30, "--rate", 2e-3]
    assert finetune.main([*map(str, command), "--batch", "2", "--device", "cpu"]) == 0
    found = errors(capsys.readouterr().out)
    assert found["after"] < found["before"] and found["after"] < found["noisy"]
    assert export.load_weights(out).net.config == SMALL
    assert "30 steps further on 1 frames" in export.read_weights(out)["meta.description"]


def test_finetuning_on_renders_of_combined_alone(state: Path, tmp_path: Path, weights: Path) -> None:
    renders = write_renders(tmp_path, [4, 4, 4], frozenset({"Combined"}))
    out = tmp_path / "mine.qwt"
    command = ["--weights", weights, "--out", out, "--renders", *renders, "--steps", 3, "--batch", 1]
    assert finetune.main([*map(str, command), "--device", "cpu"]) == 0
    saved = json.loads((run_folder("finetune-mine") / "config.json").read_text())["config"]["crops"]
    assert saved["light_fraction"] == 0 and saved["drop_guide"] == 1 and saved["crop"] == 64


@pytest.mark.parametrize("fault", ["one", "same", "size", "small", "missing", "none"])
def test_finetuning_says_what_is_wrong(
    fault: str, state: Path, tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = write_renders(tmp_path, [4, 4], size=48 if fault == "small" else 64)
    (tmp_path / "other").mkdir()
    other = write_renders(tmp_path / "other", [4], size=80)[0]
    given = {
        "one": (paths[:1], "one render alone has no target"),
        "same": ([paths[0], paths[0]], "are the same render"),
        "size": ([paths[0], other], "differ in size: 64x64, 80x80"),
        "small": (paths, "48x48 pixels, 64 in each direction"),
        "missing": ([paths[0], tmp_path / "nowhere.exr"], "nowhere.exr"),
        "none": ([], "no frames"),
    }[fault]
    command = ["--weights", weights, "--out", tmp_path / "mine.qwt"]
    command += ["--renders", *given[0]] if given[0] else []
    assert finetune.main(list(map(str, command))) == 1
    assert given[1] in capsys.readouterr().err and not (tmp_path / "mine.qwt").exists()


# ---- EXRs -----------------------------------------------------------------------------------------------------------


def test_exr_round_trip(tmp_path: Path) -> None:
    pixels = noisy_render(clean_render(32, 3), 4, np.random.default_rng(1))
    write_exr(tmp_path / "a.exr", pixels, 4)
    found = read_exr(tmp_path / "a.exr")
    assert found.spp == 4 and found.present == set(PASSES) and np.array_equal(found.pixels, pixels)


@pytest.mark.parametrize("name", ["34_all", "45_none", "50_zip_float", "50_all", "52_zip", "45_stereo", "45_composite"])
def test_files_of_every_blender_are_read(name: str, data: Path) -> None:
    found = read_exr(data / f"{name}.exr")
    assert "Combined" in found.present and found.pixels[:3].any()
    if name in ("45_none", "50_zip_float"):
        assert {"DiffDir", "GlossCol", "Denoising Albedo"} <= found.present and found.spp == 4


def test_what_is_no_render_is_refused(tmp_path: Path) -> None:
    for name, content in (("text.exr", b"no picture"), ("empty.exr", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(MissingPassError, match=name):
            read_exr(tmp_path / name)


# ---- Logs and cards -------------------------------------------------------------------------------------------------


LOG = "50,0.9,1e-3,1.0,10\n100,0.8,1e-3,2.0,10\n150,0.7,1e-3,3.0,12\n100,0.79,1e-3,0.5,12\n150,0.69,9e-4,1.5,14\n20"


def test_a_log_with_a_kill_in_it(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(LOG)
    points = runlog.read_log(tmp_path / "log.csv")
    assert [p.step for p in points] == [50, 100, 150] and points[-1].loss == 0.69 and points[-1].frames == 14
    assert runlog.hours(points) == pytest.approx((1.0 + 1.5) / 60)
    runlog.plot({"run": points}, tmp_path / "curve.png")
    assert 5_000 < (tmp_path / "curve.png").stat().st_size < 60_000


SUMMARY = """spp,layer,method,frames,rel_mse,worst,worst_frame,psnr,ssim,gmsd,flip,seconds_per_megapixel
4,Combined,noisy,48,0.3,2.0,a/1,20,0.5,0.2,0.2,0
4,Combined,start,48,0.012,0.1,b/2,30,0.9,0.02,0.05,1.5
4,Combined,OIDN high/accurate,48,0.0125,0.09,b/2,30,0.9,0.02,0.05,9.9
4,DiffDir,start,48,0.02,0.1,b/2,30,0.9,0.02,0.05,1.5
16,Combined,start,48,0.006,0.05,c/3,33,0.95,0.01,0.03,1.5
"""


def fake_run(weights: Path) -> None:
    """What a run leaves behind, as far as a card reads it."""
    folder = run_folder("balanced")
    folder.mkdir(parents=True)
    config = {"model": {"widths": [16] * 4}, "crops": {"batch": 8, "crop": 128}}
    (folder / "config.json").write_text(json.dumps({"config": config, "git": "abcdef0123456789"}))
    (folder / "log.csv").write_text(LOG)
    joined = {0: ["hills-00000_0", "hills-00000_1"], 9: ["dunes-00001_0"], 999: ["sea-00001_0"]}
    journal = [{"step": step, "frames": dict.fromkeys(names, 64)} for step, names in joined.items()]
    (folder / "frames.json").write_text(json.dumps(journal))
    torch.save({"step": 150}, folder / "checkpoint.pt")


def test_a_card_from_run_and_evaluation(state: Path, tmp_path: Path, weights: Path) -> None:
    fake_run(weights)
    (tmp_path / "summary.csv").write_text(SUMMARY)
    command = ["add", "--weights", weights, "--run", "balanced", "--evaluation", tmp_path / "summary.csv"]
    assert card.main([*map(str, command), "--limits", "Grass."]) == 0
    facts = json.loads(weights.with_suffix(".json").read_text())
    assert facts["training"]["frames"] == 3 and facts["training"]["scenes"] == 2 and facts["training"]["families"] == 2
    assert facts["parameters"] == sum(p.numel() for p in Quell(SMALL).parameters())
    assert card.main(["write", "--folder", str(tmp_path)]) == 0
    text = (tmp_path / "README.md").read_text()
    for expected in ("## start.qwt", facts["sha256"], "| start | 0.01200 (0.1000) | 0.00600 (0.0500) |", "| noisy |",
                     "3 frames of 2 scenes of 2 families", "150 steps of 8 crops of 128x128", "**Limits.** Grass.",
                     "Apache-2.0"):  # fmt: skip
        assert expected in text, expected
    assert "DiffDir" not in text


def test_a_card_never_speaks_of_another_file(state: Path, tmp_path: Path, weights: Path, capsys) -> None:
    assert card.main(["write", "--folder", str(tmp_path)]) == 1 and "has no card" in capsys.readouterr().err
    assert card.main(["add", "--weights", str(weights), "--limits", "All."]) == 0
    export.export(Quell(SMALL), weights, "start", "another")
    assert card.main(["write", "--folder", str(tmp_path)]) == 1 and "of another file" in capsys.readouterr().err
    assert (
        card.main(["add", "--weights", str(weights)]) == 1 and "give --run and --evaluation" in capsys.readouterr().err
    )


def test_released_cards_match_their_files(root: Path) -> None:
    for path in sorted((root / "weights").glob("*.json")):
        assert json.loads(path.read_text())["sha256"] == card.sha256(path.with_suffix(".qwt")), path
