#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Times `quell denoise` by size and number of layers; `make bench` runs it. Not a test: nothing here can fail a build.

Each job is EXR to EXR, in a process of its own, beside oiiotool reading and writing the same file. The pictures are
made here: smooth surfaces under the noise of a few samples, so that codecs have as much to do as with a render. The CSV
under bench/results/ names machine, kernels and revision; times are medians.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SIZES = {"480p": (854, 480), "1080p": (1920, 1080), "4K": (3840, 2160)}
LIGHT = ["DiffDir", "DiffInd", "DiffCol", "GlossDir", "GlossInd", "GlossCol", "TransDir", "TransInd", "TransCol"]
LAYERS = {1: [], 4: LIGHT[:3], 10: LIGHT}  # beside Combined; the guides are read, not counted
COLUMNS = [
    "machine", "kernels", "threads", "revision", "size", "width", "height", "layers", "denoise_s", "read_s", "write_s",
    "whole_s", "oiiotool_s", "working_mb", "resident_mb", "input_mb",
]  # fmt: skip


def machine_name() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.exists() else ""
    model = re.search(r"model name\s*: (.*)", text)
    return model.group(1).strip() if model else platform.machine()


def revision() -> str:
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"


def write_input(path: Path, width: int, height: int, passes: list[str]) -> None:
    """Half floats in ZIP, as Blender's default; Combined is the sum of what its passes make."""
    import OpenEXR

    rng = np.random.default_rng(width + len(passes))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    surface = 0.4 + 0.3 * np.sin(x / 97) * np.cos(y / 61) + 0.2 * ((x // 64 + y // 64) % 2)

    def noisy(scale: float) -> np.ndarray:
        return (scale * surface * rng.gamma(4.0, 0.25, surface.shape)).astype(np.float32)

    layers: dict[str, dict[str, np.ndarray]] = {}
    for name in passes:
        layers[name] = {c: surface if name.endswith("Col") else noisy(0.3) for c in "RGB"}
    combined = {c: np.zeros_like(surface) for c in "RGB"}
    for group in ("Diff", "Gloss", "Trans"):
        if f"{group}Col" in layers:
            for c in "RGB":
                light = layers[f"{group}Dir"][c] + layers[f"{group}Ind"][c]
                combined[c] += light * layers[f"{group}Col"][c]
    if not passes:
        combined = {c: noisy(0.5) for c in "RGB"}
    layers["Combined"] = combined | {"A": np.ones_like(surface)}
    layers["Denoising Albedo"] = {c: surface for c in "RGB"}
    layers["Denoising Normal"] = {"X": 0 * surface, "Y": 0 * surface, "Z": 0 * surface + 1}
    channels = {
        f"ViewLayer.{name}.{c}": np.ascontiguousarray(pixels.astype(np.float16))
        for name, letters in layers.items()
        for c, pixels in letters.items()
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def timed(command: list[str]) -> tuple[float, float]:
    """Seconds and resident megabytes of a process of its own."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{command[0]} failed with {process.returncode}")
    return seconds, usage.ru_maxrss / 1024


def measure(quell: Path, folder: Path, path: Path, repeats: int, options: list[str]) -> dict[str, float | str | int]:
    report, out = folder / "report.json", folder / "out.exr"
    runs = []
    for _ in range(repeats):
        command = [str(quell), "denoise", str(path), "-q", "-o", str(out), "--report", str(report), *options]
        seconds, resident = timed(command)
        runs.append((seconds, resident, json.loads(report.read_text())))
    files = [run[2]["files"][0] for run in runs]
    oiiotool = shutil.which("oiiotool")
    copies = [timed([oiiotool, str(path), "-o", str(out)])[0] for _ in range(repeats)] if oiiotool else []
    return {
        "kernels": runs[0][2]["kernels"],
        "threads": runs[0][2]["threads"],
        "denoise_s": round(statistics.median(f["seconds_denoise"] for f in files), 4),
        "read_s": round(statistics.median(f["seconds_read"] for f in files), 4),
        "write_s": round(statistics.median(f["seconds_write"] for f in files), 4),
        "whole_s": round(statistics.median(run[0] for run in runs), 4),
        "oiiotool_s": round(statistics.median(copies), 4) if copies else "",
        "working_mb": round(files[0]["summary"]["peak_bytes"] / 2**20, 1),
        "resident_mb": round(max(run[1] for run in runs), 1),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quell", type=Path, required=True, help="the tool")
    parser.add_argument("--sizes", default=",".join(SIZES), help=f"of {', '.join(SIZES)}; comma-separated")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "bench", help="folder of the pictures")
    parser.add_argument("--results", type=Path, default=ROOT / "bench" / "results")
    parser.add_argument("options", nargs="*", help="for quell denoise, after --")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    arguments.results.mkdir(parents=True, exist_ok=True)

    rows = []
    for size in arguments.sizes.split(","):
        width, height = SIZES[size]
        for count, passes in LAYERS.items():
            path = arguments.work / f"{size}_{count}.exr"
            write_input(path, width, height, passes)
            row = {"machine": machine_name(), "revision": revision(), "size": size, "width": width, "height": height}
            row |= {"layers": count, "input_mb": round(path.stat().st_size / 2**20, 1)}
            row |= measure(arguments.quell, arguments.work, path, arguments.repeats, arguments.options)
            rows.append(row)
            print(
                f"{size:>6} {count:>3} layers: denoise {row['denoise_s']:7.3f} s, whole {row['whole_s']:7.3f} s, "
                f"oiiotool {row['oiiotool_s']:>7} s, working {row['working_mb']:7.1f} MB, "
                f"resident {row['resident_mb']:7.1f} MB",
                flush=True,
            )
            path.unlink()
    slug = re.sub(r"[^a-z0-9]+", "-", f"{machine_name()} {rows[0]['kernels']} {rows[0]['threads']} threads".lower())
    result = arguments.results / f"{slug.strip('-')}.csv"
    with result.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    print(result.relative_to(ROOT) if result.is_relative_to(ROOT) else result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
