# SPDX-License-Identifier: Apache-2.0
"""Shards: a data set in pieces, put together in any order, losing nothing but what is damaged."""

from __future__ import annotations

import io
import json
import shutil
import tarfile
from pathlib import Path

import pytest
from synthetic import write_data_set, write_frame

from training import shards


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data_set(tmp_path_factory.mktemp("source"), frames=4, size=32)


@pytest.fixture(scope="module", autouse=True)
def extra_passes(source: Path) -> None:
    """One frame has passes of its own, in a folder below."""
    frame = source / "train" / "hills" / "00000_0"
    (frame / "extra").mkdir()
    shutil.copy(frame / "1_0.qfr", frame / "extra" / "1_0.qfr")


def contents(root: Path) -> dict[str, bytes]:
    """Files of the split, metadata as its meaning."""
    out = {}
    for path in sorted((root / "train").rglob("*.*")):
        content = path.read_bytes()
        if path.name == "meta.json":
            content = json.dumps(json.loads(content), sort_keys=True).encode()
        out[path.relative_to(root).as_posix()] = content
    return out


def small_shards(source: Path, folder: Path, limit: int = 250_000) -> list[Path]:
    """Several shards, frames spread over them."""
    made = shards.pack(source, "train", folder, limit)
    assert len(made) >= 3
    return made


def test_every_shard_is_at_most_the_limit(source: Path, tmp_path: Path) -> None:
    for limit in (150_000, 250_000, 1_000_000):
        made = shards.pack(source, "train", tmp_path / str(limit), limit)
        sizes = [path.stat().st_size for path in made]
        assert max(sizes) <= limit
        assert len(made) <= 2 * sum(sizes) / limit + 1  # and well filled


def test_any_order_gives_the_same_data_set(source: Path, tmp_path: Path) -> None:
    made = small_shards(source, tmp_path / "shards")
    for name, order in (("forward", made), ("backward", made[::-1]), ("twice", made + made)):
        outcome = shards.read_all(order, tmp_path / name)
        assert outcome.faults == []
        assert contents(tmp_path / name) == contents(source)


def test_pieces_arrive_one_at_a_time(source: Path, tmp_path: Path) -> None:
    for path in small_shards(source, tmp_path / "shards"):
        assert shards.read_all([path], tmp_path / "data").faults == []
    assert contents(tmp_path / "data") == contents(source)


def test_the_same_frames_make_the_same_shards(source: Path, tmp_path: Path) -> None:
    a, b = (small_shards(source, tmp_path / name) for name in "ab")
    assert [(p.name, p.read_bytes()) for p in a] == [(p.name, p.read_bytes()) for p in b]


def test_packing_again_adds_what_is_new(tmp_path: Path) -> None:
    root = write_data_set(tmp_path / "data", frames=1, size=32)
    assert len(shards.pack(root, "train", tmp_path / "out")) == 1
    assert shards.pack(root, "train", tmp_path / "out") == []
    write_frame(root, "hills/00009_0", 32, seed=9)
    assert len(shards.pack(root, "train", tmp_path / "out")) == 1
    outcome = shards.read_all(shards.shards_in([tmp_path / "out"]), tmp_path / "copy")
    assert outcome.faults == [] and contents(tmp_path / "copy") == contents(root)


def damaged(path: Path, folder: Path, offset: int, value: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    content = bytearray(path.read_bytes())
    content[offset : offset + len(value)] = value
    target = folder / path.name
    target.write_bytes(content)
    return target


def offsets(path: Path) -> dict[str, tuple[int, int]]:
    """Member -> where its header and its data begin."""
    with tarfile.open(path) as archive:
        return {m.name: (m.offset, m.offset_data) for m in archive}


def test_damaged_content_costs_one_file(source: Path, tmp_path: Path) -> None:
    made = small_shards(source, tmp_path / "shards")
    victim = [name for name in offsets(made[0]) if name.endswith(".qfr")][2]
    bad = damaged(made[0], tmp_path / "bad", offsets(made[0])[victim][1] + 100, b"damage")
    outcome = shards.read_all([bad, *made[1:]], tmp_path / "data")
    assert len(outcome.faults) == 1 and victim in outcome.faults[0]
    expected = contents(source)
    del expected[victim]
    assert contents(tmp_path / "data") == expected
    # Another copy of that shard brings the rest.
    assert shards.read_all([made[0]], tmp_path / "data").faults == []
    assert contents(tmp_path / "data") == contents(source)


def test_a_damaged_header_costs_one_file(source: Path, tmp_path: Path) -> None:
    made = small_shards(source, tmp_path / "shards")
    victim = [name for name in offsets(made[0]) if name.endswith(".qfr")][1]
    bad = damaged(made[0], tmp_path / "bad", offsets(made[0])[victim][0], b"\xff" * 300)
    outcome = shards.read_all([bad, *made[1:]], tmp_path / "data")
    assert len(outcome.faults) == 1 and victim in outcome.faults[0]


def test_a_cut_off_shard_gives_what_is_before_the_cut(source: Path, tmp_path: Path) -> None:
    made = small_shards(source, tmp_path / "shards")
    cut = tmp_path / made[0].name
    cut.write_bytes(made[0].read_bytes()[:100_000])
    outcome = shards.read_all([cut], tmp_path / "data")
    assert outcome.files > 0 and outcome.faults
    found = contents(tmp_path / "data")
    assert found.items() <= contents(source).items()


def test_a_frame_without_its_metadata_is_left_out(source: Path, tmp_path: Path) -> None:
    (whole,) = shards.pack(source, "train", tmp_path / "shards")
    victim = next(name for name in offsets(whole) if name.endswith("meta.json"))
    bad = damaged(whole, tmp_path / "bad", offsets(whole)[victim][1] + 10, b"damage")
    outcome = shards.read_all([bad], tmp_path / "data")
    assert any("frame left out" in fault for fault in outcome.faults)
    frame = victim.removesuffix("meta.json")
    assert contents(tmp_path / "data") == {k: v for k, v in contents(source).items() if not k.startswith(frame)}


@pytest.mark.parametrize("content", [b"", b"no tar file at all" * 100, bytes(20480)])
def test_what_is_no_shard_is_reported_and_stepped_over(content: bytes, source: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.tar"
    bad.write_bytes(content)
    (good,) = shards.pack(source, "train", tmp_path / "shards")
    outcome = shards.read_all([bad, good], tmp_path / "data")
    assert len(outcome.faults) == 1 and "bad.tar" in outcome.faults[0]
    assert contents(tmp_path / "data") == contents(source)


@pytest.mark.parametrize("name", ["../evil.qfr", "/etc/evil.qfr", "train/a/b/../../../x.qfr", "train/a/b/x.py"])
def test_nothing_is_written_elsewhere(name: str, tmp_path: Path) -> None:
    path = tmp_path / "evil.tar"
    with tarfile.open(path, "w") as archive:
        index = {"format": shards.FORMAT, "files": [[name, 0, "0" * 64]]}
        for member, content in ((shards.INDEX, json.dumps(index).encode()), (name, b"")):
            info = tarfile.TarInfo(member)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    outcome = shards.read_all([path], tmp_path / "data")
    assert len(outcome.faults) == 1 and "is no file of a data set" in outcome.faults[0]
    assert not (tmp_path / "data").exists()


def test_renders_of_two_pictures_never_mix(tmp_path: Path) -> None:
    roots = [tmp_path / name for name in "ab"]
    for seed, root in enumerate(roots):
        write_frame(root, "hills/00000_0", 32, seed=seed)
    (other,) = shards.pack(roots[1], "train", tmp_path / "shards")
    before = contents(roots[0])
    outcome = shards.read_all([other], roots[0])
    assert "another picture" in outcome.faults[0] and contents(roots[0]) == before


def test_a_render_larger_than_a_shard_is_an_error(source: Path, tmp_path: Path) -> None:
    with pytest.raises(shards.ShardError, match="fits into no shard"):
        shards.pack(source, "train", tmp_path, limit=30_000)
    assert list(tmp_path.glob("*.tar")) == []


def test_command_line(source: Path, tmp_path: Path, capsys) -> None:
    out, data = tmp_path / "out", tmp_path / "data"
    assert shards.main(["pack", "--out", str(out), "--data", str(source), "--max-mb", "0.3"]) == 0
    assert shards.main(["verify", str(out)]) == 0
    assert "0 faults" in capsys.readouterr().out
    assert shards.main(["unpack", str(out), "--data", str(data)]) == 0
    assert contents(data) == contents(source)
    for path in out.glob("*.tar"):
        shutil.copy(path, path.with_suffix(".bak"))
        path.write_bytes(path.read_bytes()[:-20000])
    assert shards.main(["verify", str(out)]) == 1
    assert "damaged or missing" in capsys.readouterr().err
