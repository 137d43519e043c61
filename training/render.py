# SPDX-License-Identifier: Apache-2.0
"""Render training and validation frames with Cycles; can be killed and started at any time.

    python -m training.render --split train --seeds 0:100 --procs 2

Every scene is (family, seed).  For each, cameras are tried until one shows something worth
denoising; each accepted camera is a frame: a folder with meta.json and one file per render.
Whatever exists is skipped, so a longer --spp list or seed range adds to what is there.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from training.data.store import write_atomic
from training.paths import data_root

#: Exit status of a worker that wants a fresh process (bpy's memory only grows).
_RECYCLE = 75
_SCENES_PER_WORKER = 25
#: A worker that has written nothing for this long hangs in one scene.
_STALL_SECONDS = 1500
_CAMERA_TRIES = 6


@dataclass(frozen=True)
class Config:
    """What to render; saved beside the frames' data as seen on the command line."""

    split: str
    families: tuple[str, ...]
    first_seed: int
    last_seed: int
    spp: tuple[int, ...]
    refs: int
    ref_spp: int
    size: int
    cameras: int
    #: A frame that would need more CPU seconds than this is given up.
    limit: float
    root: str

    def renders(self) -> list[tuple[str, int]]:
        """Return (name, spp) of every render a frame needs, cheap ones first."""
        names = []
        count: dict[int, int] = {}
        for spp in self.spp:
            names.append((f"{spp}_{count.get(spp, 0)}", spp))
            count[spp] = count.get(spp, 0) + 1
        return names + [(f"ref_{'abcdefgh'[i]}", self.ref_spp) for i in range(self.refs)]


@dataclass(frozen=True)
class Job:
    """One scene to render."""

    family: str
    seed: int


def jobs(config: Config) -> Iterator[Job]:
    """Yield scenes seed by seed over all families, so that any prefix is varied."""
    for seed in range(config.first_seed, config.last_seed):
        for name in config.families:
            yield Job(name, seed)


def frame_folder(config: Config, job: Job, camera: int) -> Path:
    """Return the folder of one frame."""
    return Path(config.root) / config.split / job.family / f"{job.seed:05d}_{camera}"


def marker(config: Config, job: Job, camera: int) -> Path:
    """Return the file that says this camera of this scene is not worth trying again."""
    folder = frame_folder(config, job, camera)
    return folder.with_name(f"{folder.name}.rejected")


def missing(config: Config, job: Job, camera: int) -> list[tuple[str, int]]:
    """Return the renders that a frame still lacks."""
    if marker(config, job, camera).exists():
        return []
    folder = frame_folder(config, job, camera)
    return [(n, s) for n, s in config.renders() if not (folder / f"{n}.qfr").exists()]


def reject(config: Config, job: Job, camera: int, reason: str) -> None:
    """Record why a camera was given up."""
    path = marker(config, job, camera)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, f"{reason}\n".encode())


def cycles_seed(job: Job, camera: int, name: str) -> int:
    """Return the random seed of one render, unlike that of any other."""
    digest = hashlib.sha256(f"{job.family}/{job.seed}/{camera}/{name}".encode()).digest()
    return int.from_bytes(digest[:4], "little") & 0x7FFFFFFF


def git_revision() -> str:
    """Return the revision of the generator, or "unknown" outside a checkout."""
    result = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return result.stdout.strip() or "unknown"


def run_worker(config: Config, shard: int, shards: int, note: Path) -> int:
    """Render every scene of one shard; return the exit status."""
    from training.frames import render_scene

    revision = git_revision()
    done = 0
    for index, job in enumerate(jobs(config)):
        if index % shards != shard:
            continue
        if not any(missing(config, job, camera) for camera in range(config.cameras)):
            continue
        if done >= _SCENES_PER_WORKER:
            return _RECYCLE
        note.write_text(f"{job.family} {job.seed}", encoding="utf-8")
        render_scene(config, job, revision, note)
        done += 1
    return 0


def count_frames(config: Config) -> tuple[int, int]:
    """Return (settled, all) camera slots of the whole run, by what is there rather than by asking for each file."""
    wanted = {f"{name}.qfr" for name, _ in config.renders()}
    settled = 0
    for family in config.families:
        folder = Path(config.root) / config.split / family
        for entry in os.scandir(folder) if folder.is_dir() else ():
            slot = re.fullmatch(r"(\d+)_(\d+)(\.rejected)?", entry.name)
            if slot and config.first_seed <= int(slot[1]) < config.last_seed and int(slot[2]) < config.cameras:
                # A frame that is begun and then rejected has both a folder and a marker: the marker counts.
                marked = slot[3] is None and Path(f"{entry.path}.rejected").exists()
                settled += slot[3] is not None or (not marked and wanted <= set(os.listdir(entry.path)))
    return settled, len(config.families) * (config.last_seed - config.first_seed) * config.cameras


def supervise(config: Config, procs: int) -> int:
    """Keep the workers running, replace those that crash or hang, and report progress."""
    run = Path(config.root) / "run"
    run.mkdir(parents=True, exist_ok=True)
    running: dict[int, subprocess.Popen[bytes]] = {}
    crashes: dict[str, int] = {}
    finished: set[int] = set()
    started, reported = time.time(), 0.0
    first, total = count_frames(config)
    while len(finished) < procs:
        for shard in set(range(procs)) - finished:
            note = run / f"{config.split}-{os.getpid()}-{shard}"
            process = running.get(shard)
            if process is None:
                note.write_text("", encoding="utf-8")
                running[shard] = start_worker(config, shard, procs, note)
                continue
            status = process.poll()
            if status is None:
                if time.time() - note.stat().st_mtime > _STALL_SECONDS:
                    process.kill()
                    process.wait()
                    give_up(config, note, crashes, "stalled")
                    del running[shard]
                continue
            del running[shard]
            if status == 0:
                finished.add(shard)
                note.unlink(missing_ok=True)
            elif status != _RECYCLE:
                give_up(config, note, crashes, f"exit status {status}")
        if time.time() - reported > 60:
            reported = time.time()
            report(config, first, total, reported - started)
        time.sleep(1)
    report(config, first, total, time.time() - started)
    return 0


def start_worker(config: Config, shard: int, shards: int, note: Path) -> subprocess.Popen[bytes]:
    """Start one worker process at the lowest priority."""
    command = [sys.executable, "-m", "training.render", "--worker", json.dumps(asdict(config))]
    command += [str(shard), str(shards), str(note)]
    return subprocess.Popen(command)


def give_up(config: Config, note: Path, crashes: dict[str, int], reason: str) -> None:
    """Reject the scene a worker died in, the second time it happens."""
    scene = note.read_text(encoding="utf-8")
    crashes[scene] = crashes.get(scene, 0) + 1
    print(f"worker died ({reason}) in {scene or 'start-up'}", flush=True)
    if scene and crashes[scene] >= 2:
        name, seed = scene.split()
        for camera in range(config.cameras):
            job = Job(name, int(seed))
            if missing(config, job, camera):
                reject(config, job, camera, reason)
    elif not scene and crashes[scene] > 5:
        raise SystemExit("workers die before they start; see the log")


def report(config: Config, first: int, total: int, seconds: float) -> None:
    """Print one line of progress with the time left."""
    done, _ = count_frames(config)
    pace = seconds / max(1, done - first)
    left = (total - done) * pace / 3600
    print(
        f"{config.split}: {done}/{total} frames, {pace:.1f} s per frame, {left:.1f} hours left",
        flush=True,
    )


def parse_range(text: str) -> tuple[int, int]:
    """Parse A:B, B excluded."""
    first, last = text.split(":")
    return int(first), int(last)


def choose_families(split: str, text: str) -> tuple[str, ...]:
    """Return the families of a split, all of them or those named, in registration order."""
    from training.scenes import FAMILIES

    names = [name for name, entry in FAMILIES.items() if entry.split == split]
    if text == "all":
        return tuple(names)
    wanted = text.split(",")
    unknown = set(wanted) - set(names)
    if unknown:
        raise SystemExit(f"no {split} families called {', '.join(sorted(unknown))}")
    return tuple(name for name in names if name in wanted)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if argv[:1] == ["--worker"]:
        raw = json.loads(argv[1])
        config = Config(**{**raw, "families": tuple(raw["families"]), "spp": tuple(raw["spp"])})
        return run_worker(config, int(argv[2]), int(argv[3]), Path(argv[4]))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--split", choices=("train", "val"), default="train")
    parser.add_argument("--families", default="all", help="comma-separated names")
    parser.add_argument("--seeds", type=parse_range, default=(0, 10), metavar="A:B")
    parser.add_argument("--procs", type=int, default=2, help="processes of one thread each")
    parser.add_argument("--spp", default="1,1,2,4,8,16,32", help="sample counts, one render each")
    parser.add_argument("--refs", type=int, default=None, help="references (val: 2, train: 0)")
    parser.add_argument("--ref-spp", type=int, default=1024)
    parser.add_argument("--size", type=int, default=256, help="pixels per side of a frame")
    parser.add_argument("--cameras", type=int, default=2, help="frames per scene")
    parser.add_argument("--limit", type=float, default=None, help="CPU seconds per frame")
    parser.add_argument("--data", type=Path, default=None, help="data set folder")
    args = parser.parse_args(argv)
    val = args.split == "val"
    config = Config(
        split=args.split,
        families=choose_families(args.split, args.families),
        first_seed=args.seeds[0],
        last_seed=args.seeds[1],
        spp=tuple(int(text) for text in args.spp.split(",")),
        refs=args.refs if args.refs is not None else (2 if val else 0),
        ref_spp=args.ref_spp,
        size=args.size,
        cameras=args.cameras,
        limit=args.limit if args.limit is not None else (2000.0 if val else 90.0),
        root=str(args.data or data_root()),
    )
    return supervise(config, args.procs)


if __name__ == "__main__":
    sys.exit(main())
