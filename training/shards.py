# SPDX-License-Identifier: Apache-2.0
"""Frames as self-contained shards of at most 60 MB, to carry a data set to another machine in pieces.

    python -m training.shards pack --split train --out shards/      # adds the frames that no shard there holds yet
    python -m training.shards verify shards/*.tar
    python -m training.shards unpack shards/*.tar --data FOLDER     # any shards, in any order, any number of times

A shard is a plain tar file. Its first member, index.json, lists the path, size and SHA-256 of all others, which are the
data set's files as they are stored: SPLIT/FAMILY/FRAME/meta.json and the .qfr files in and below that folder. A frame
may be spread over several shards; each then holds its meta.json. The name ends in the first digits of the index's
SHA-256, so that shards of several machines can lie in one folder.

What is damaged costs itself alone: a file that is cut off or whose SHA-256 differs is reported and left out, and so is
all that a frame without its meta.json would have brought. The exit status is 1 when anything was left out.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import re
import sys
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from training.data.store import FrameRecord, list_frames, write_atomic
from training.paths import data_root

MAX_BYTES = 60_000_000
INDEX = "index.json"
FORMAT = "quell-shard-1"
_BLOCK = 512
#: What a member may be called: nothing else is ever written, whatever a shard says.
_MEMBER = re.compile(r"((?:train|val)/[A-Za-z0-9_]+/[A-Za-z0-9_]+)/(meta\.json|(?:extra/)?[A-Za-z0-9_]+\.qfr)")


class ShardError(Exception):
    """A shard that cannot be used at all, or a frame that fits into none."""


@dataclass(frozen=True)
class Entry:
    """One file of the data set: its path below the root, where it lies now, and its content's size and digest."""

    name: str
    source: Path
    size: int
    sha256: str

    @property
    def stored_bytes(self) -> int:
        """Bytes in the tar file, with its line in the index."""
        return _BLOCK + -(-self.size // _BLOCK) * _BLOCK + len(json.dumps(index_line(self))) + 2


@dataclass
class Outcome:
    """What came of reading shards."""

    files: int = 0  # found intact
    written: int = 0
    faults: list[str] = field(default_factory=list)  # one sentence each


def index_line(entry: Entry) -> list:
    return [entry.name, entry.size, entry.sha256]


def frame_entries(root: Path, record: FrameRecord) -> list[Entry]:
    """A frame's files, meta.json first."""
    entries = []
    for path in (record.folder / "meta.json", *sorted(record.folder.rglob("*.qfr"))):
        content = path.read_bytes()
        name = path.relative_to(root).as_posix()
        entries.append(Entry(name, path, len(content), hashlib.sha256(content).hexdigest()))
    return entries


def split_entries(frames: Iterable[list[Entry]], limit: int) -> Iterator[list[Entry]]:
    """Fills shard after shard; a frame that does not fit goes on in the next one, with its meta.json again."""
    overhead = 4 * _BLOCK + tarfile.RECORDSIZE  # the index's header and padding, the end of the archive
    shard: list[Entry] = []
    used = overhead
    for entries in frames:
        meta, renders = entries[0], entries[1:]
        if not renders:
            continue
        largest = max(entry.stored_bytes for entry in renders)
        if overhead + meta.stored_bytes + largest > limit:
            raise ShardError(f"{meta.name}: a render of {largest} bytes fits into no shard of {limit} bytes")
        begun = False
        for entry in renders:
            need = entry.stored_bytes + (0 if begun else meta.stored_bytes)
            if used + need > limit:
                yield shard
                shard, used, begun = [], overhead, False
                need = entry.stored_bytes + meta.stored_bytes
            if not begun:
                shard.append(meta)
                begun = True
            shard.append(entry)
            used += need
    if shard:
        yield shard


def add_member(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    """Owner, mode and time are constants: the same frames make the same bytes."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    info.mode = 0o644
    archive.addfile(info, io.BytesIO(content))


def write_shard(folder: Path, split: str, entries: list[Entry]) -> Path:
    """Writes one shard; it appears whole or not at all."""
    index = json.dumps({"format": FORMAT, "files": [index_line(entry) for entry in entries]}).encode()
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        add_member(archive, INDEX, index)
        for entry in entries:
            content = entry.source.read_bytes()
            if hashlib.sha256(content).hexdigest() != entry.sha256:
                raise ShardError(f"{entry.source}: changed while it was packed; start again")
            add_member(archive, entry.name, content)
    path = folder / f"{split}-{hashlib.sha256(index).hexdigest()[:12]}.tar"
    write_atomic(path, buffer.getvalue())
    return path


def read_index(path: Path, archive: tarfile.TarFile) -> dict[str, tuple[int, str]]:
    """Path -> (size, SHA-256) of every file that the shard should hold."""
    try:
        first = archive.next()
        if first is None or first.name != INDEX:
            raise ShardError(f"{path}: no shard, it does not begin with {INDEX}")
        source = archive.extractfile(first)
        data = json.loads(source.read()) if source else {}
        if data.get("format") != FORMAT:
            raise ShardError(f"{path}: format {data.get('format')!r}, expected {FORMAT!r}")
        files = {str(name): (int(size), str(digest)) for name, size, digest in data["files"]}
    except (tarfile.TarError, ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        raise ShardError(f"{path}: damaged index: {error}") from error
    strange = [name for name in files if not _MEMBER.fullmatch(name)]
    if strange:
        raise ShardError(f"{path}: {strange[0]!r} is no file of a data set")
    return files


def open_shard(path: Path) -> tarfile.TarFile:
    """With ignore_zeros a damaged header costs one member: reading goes on at the next one that is whole."""
    try:
        return tarfile.open(path, "r:", ignore_zeros=True)
    except (tarfile.TarError, OSError) as error:
        raise ShardError(f"{path}: {error}") from error


def intact_files(path: Path, outcome: Outcome) -> Iterator[tuple[str, bytes]]:
    """Every file of a shard whose content is what the index says; the others are faults."""
    with open_shard(path) as archive:
        wanted = read_index(path, archive)
        while wanted:
            try:
                member = archive.next()
            except (tarfile.TarError, OSError) as error:
                outcome.faults.append(f"{path}: {error}")
                break
            if member is None:
                break
            if member.name not in wanted or not member.isreg():
                continue
            size, digest = wanted[member.name]
            try:
                source = archive.extractfile(member)
                content = source.read() if source and member.size == size else b""
            except (tarfile.TarError, OSError):
                content = b""
            if hashlib.sha256(content).hexdigest() != digest:
                continue  # reported below: a whole copy of it may still follow a damaged header
            del wanted[member.name]
            outcome.files += 1
            yield member.name, content
        outcome.faults += [f"{path}: {name} is damaged or missing, left out" for name in wanted]


def merge_meta(old: dict, new: dict) -> dict:
    """The same frame's metadata from two shards: each knows of the renders that were there when it was packed."""
    merged = {**old, **new}
    for key in ("seconds", "cycles_seeds"):
        merged[key] = {**old.get(key, {}), **new.get(key, {})}
    return merged


def unpack_frame(folder: Path, files: dict[str, bytes], outcome: Outcome) -> None:
    """Adds one frame's files from one shard to the data set. What is there already stays as it is."""
    meta_path = folder / "meta.json"
    if "meta.json" not in files:
        outcome.faults.append(f"{folder}: its meta.json is lost, frame left out")
        return
    meta = json.loads(files["meta.json"])
    known = json.loads(meta_path.read_text(encoding="utf-8")) if meta_path.exists() else {}
    if known and known["fingerprint"] != meta["fingerprint"]:
        outcome.faults.append(f"{folder}: holds renders of another picture (fingerprints differ), frame left out")
        return
    folder.mkdir(parents=True, exist_ok=True)
    merged = merge_meta(known, meta)
    if merged != known:
        write_atomic(meta_path, json.dumps(merged, indent=1).encode())
    for name, content in files.items():
        path = folder / name
        if name == "meta.json" or (path.exists() and path.stat().st_size == len(content)):
            continue
        path.parent.mkdir(exist_ok=True)
        write_atomic(path, content)
        outcome.written += 1


def unpack_shard(path: Path, root: Path, outcome: Outcome) -> None:
    """Frame by frame; a frame's files stand together in a shard."""
    frame, files = "", {}
    for name, content in intact_files(path, outcome):
        match = _MEMBER.fullmatch(name)
        assert match, "read_index lets no other names through"
        if match[1] != frame:
            if files:
                unpack_frame(root / frame, files, outcome)
            frame, files = match[1], {}
        files[match[2]] = content
    if files:
        unpack_frame(root / frame, files, outcome)


def read_all(paths: list[Path], root: Path | None) -> Outcome:
    """Unpacks shards into root, or only checks them (None). A shard that cannot be read at all is one fault."""
    outcome = Outcome()
    for path in paths:
        try:
            if root is None:
                for _ in intact_files(path, outcome):
                    pass
            else:
                unpack_shard(path, root, outcome)
        except ShardError as error:
            outcome.faults.append(str(error))
    return outcome


def shards_in(paths: Iterable[Path]) -> list[Path]:
    """Files as they are; a folder stands for the shards in it."""
    return [shard for path in paths for shard in (sorted(path.glob("*.tar")) if path.is_dir() else [path])]


def packed_digests(folder: Path) -> set[tuple[str, str]]:
    """(path, SHA-256) of all that the shards of a folder hold already, renders only."""
    known = set()
    for path in sorted(folder.glob("*.tar")):
        with open_shard(path) as archive:
            known |= {(name, digest) for name, (_, digest) in read_index(path, archive).items()}
    return {(name, digest) for name, digest in known if not name.endswith("/meta.json")}


def pack(root: Path, split: str, folder: Path, limit: int = MAX_BYTES, min_renders: int = 1) -> list[Path]:
    """Writes the frames that no shard in the folder holds yet; returns the new shards."""
    folder.mkdir(parents=True, exist_ok=True)
    known = packed_digests(folder)

    def missing() -> Iterator[list[Entry]]:
        for record in list_frames(root, split):
            if len(record.renders) >= min_renders:
                entries = frame_entries(root, record)
                yield entries[:1] + [e for e in entries[1:] if (e.name, e.sha256) not in known]

    return [write_shard(folder, split, entries) for entries in split_entries(missing(), limit)]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("pack", help="frames to shards")
    make.add_argument("--split", choices=("train", "val"), default="train")
    make.add_argument("--out", type=Path, required=True, help="folder of the shards")
    make.add_argument("--data", type=Path, help="data set folder")
    make.add_argument("--max-mb", type=float, default=MAX_BYTES / 1e6, help="largest shard, in 1,000,000 bytes")
    make.add_argument("--min-renders", type=int, default=1, help="leave out frames that have fewer")
    for name, text in (("unpack", "shards to frames"), ("verify", "check shards, write nothing")):
        read = commands.add_parser(name, help=text)
        read.add_argument("shards", type=Path, nargs="+", help="files, or folders of .tar files")
        if name == "unpack":
            read.add_argument("--data", type=Path, help="data set folder")
    args = parser.parse_args(argv)
    if args.command == "pack":
        try:
            made = pack(args.data or data_root(), args.split, args.out, int(args.max_mb * 1e6), args.min_renders)
        except ShardError as error:
            print(error, file=sys.stderr)
            return 1
        for path in made:
            print(f"{path}: {path.stat().st_size} bytes")
        return 0
    root = (args.data or data_root()) if args.command == "unpack" else None
    outcome = read_all(shards_in(args.shards), root)
    for fault in outcome.faults:
        print(fault, file=sys.stderr)
    written = "" if root is None else f", {outcome.written} written"
    print(f"{outcome.files} files intact{written}, {len(outcome.faults)} faults")
    return 1 if outcome.faults else 0


if __name__ == "__main__":
    sys.exit(main())
