# SPDX-License-Identifier: Apache-2.0
"""One file as several smaller ones, for ways of carrying that limit the size of a file, and together again.

python -m training.pieces join FOLDER/checkpoint.pt        # from checkpoint.pt.000, .001, ...
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

from training.data.store import write_atomic

MAX_BYTES = 16 << 20


class PiecesError(Exception):
    """A piece is missing or damaged."""


def split(path: Path, folder: Path, limit: int = MAX_BYTES) -> list[Path]:
    """Writes folder/NAME.000, .001, ... and NAME.pieces.json with the size and SHA-256 of the whole."""
    content = path.read_bytes()
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{path.name}.[0-9][0-9][0-9]"):
        old.unlink()
    pieces = []
    for i, start in enumerate(range(0, max(1, len(content)), limit)):
        pieces.append(folder / f"{path.name}.{i:03d}")
        write_atomic(pieces[-1], content[start : start + limit])
    info = {"pieces": len(pieces), "bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    write_atomic(folder / f"{path.name}.pieces.json", json.dumps(info).encode())
    return pieces


def join(path: Path, target: Path | None = None) -> Path:
    """Puts path together from the pieces beside it; target: where to, path itself by default."""
    info_path = path.with_name(f"{path.name}.pieces.json")
    if not info_path.exists():
        raise PiecesError(f"{info_path} is missing")
    info = json.loads(info_path.read_text())
    content = b""
    for i in range(info["pieces"]):
        piece = path.with_name(f"{path.name}.{i:03d}")
        if not piece.exists():
            raise PiecesError(f"{piece} is missing")
        content += piece.read_bytes()
    if hashlib.sha256(content).hexdigest() != info["sha256"]:
        raise PiecesError(f"{path}: {len(content)} bytes that are not those that were split, expected {info['bytes']}")
    target = target or path
    write_atomic(target, content)
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("split", "join"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--out", type=Path, help="folder of the pieces, or the joined file")
    args = parser.parse_args()
    try:
        done = (
            split(args.file, args.out or args.file.parent) if args.command == "split" else [join(args.file, args.out)]
        )
    except PiecesError as error:
        raise SystemExit(str(error)) from error
    for path in done:
        print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
