#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Denoises the samples, compares them with their references and prints a table; `make demo` runs it.

samples/<name>/<name>_4spp.exr and so on are the inputs, <name>_ref_a.exr and <name>_ref_b.exr two independent
references of many samples: the mean of the product of both differences is free of the references' own noise. Where
pyoidn can be imported, Open Image Denoise works on Combined with its guides beside Quell, which does every light pass.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

PEERS = {"high/accurate": "OIDN high", "fast/fast": "OIDN fast"}  # settings of training/peer.py, and their column


@dataclass
class Row:
    name: str
    spp: int
    num_layers: int
    before: float
    after: float
    seconds: float
    peers: dict[str, tuple[float, float]] = field(default_factory=dict)  # setting: relMSE, seconds


def run(*command: object) -> str:
    done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        sys.exit(done.returncode)
    return done.stdout


def rel_mse_of(quell: Path, image: Path, references: tuple[Path, Path]) -> float:
    layers = json.loads(run(quell, "compare", "--json", "-l", "Combined", image, *references))["layers"]
    return layers[0]["rel_mse"]


def read_layer(path: Path, pass_name: str, letters: str) -> np.ndarray | None:
    """[h][w][len(letters)], the first layer of that pass; None where the file has none."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {n: c.pixels for part in file.parts for n, c in part.channels.items()}
    for name in channels:
        prefix = name.rpartition(".")[0]
        if prefix.rpartition(".")[2] == pass_name and all(f"{prefix}.{c}" in channels for c in letters):
            return np.stack([np.asarray(channels[f"{prefix}.{c}"], np.float32) for c in letters], axis=-1)
    return None


def rel_mse(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    x, a, b = (z.astype(np.float64) for z in (x, a, b))
    return float(np.mean((x - a) * (x - b) / (((a + b) / 2) ** 2 + 0.01)))


def run_peers(path: Path, references: tuple[Path, Path]) -> dict[str, tuple[float, float]]:
    from training import peer

    color = read_layer(path, "Combined", "RGB")
    albedo = read_layer(path, "Denoising Albedo", "RGB")
    normal = read_layer(path, "Denoising Normal", "XYZ")
    a, b = (read_layer(r, "Combined", "RGB") for r in references)
    if color is None or albedo is None or normal is None or a is None or b is None:
        return {}
    results = {}
    for setting in PEERS:
        start = time.perf_counter()
        out = peer.denoise(color, albedo, normal, setting)
        results[setting] = (rel_mse(out, a, b), time.perf_counter() - start)
    return results


def warm_up_peers() -> None:
    """Makes the device, which is not part of any frame's time."""
    from training import peer

    tiny = np.ones((16, 16, 3), np.float32)
    for setting in PEERS:
        peer.denoise(tiny, tiny, tiny, setting)


def denoise(quell: Path, path: Path, out: Path, has_peer: bool) -> Row:
    name, spp = re.fullmatch(r"(.*)_(\d+)spp", path.stem).groups()
    references = (path.parent / f"{name}_ref_a.exr", path.parent / f"{name}_ref_b.exr")
    result, report = out / path.name, out / f"{path.stem}.json"
    run(quell, "denoise", path, "-q", "-o", result, "--report", report)
    file = json.loads(report.read_text())["files"][0]
    num_layers = sum(layer["action"] == "denoise" for layer in file["layers"])
    run(quell, "preview", path, result, references[0], "-o", out / f"{path.stem}.png",
        f"--labels={spp} spp,Quell,reference", "-l", "Combined")  # fmt: skip
    return Row(
        name=path.stem,
        spp=int(spp),
        num_layers=num_layers,
        before=rel_mse_of(quell, path, references),
        after=rel_mse_of(quell, result, references),
        seconds=file["seconds_denoise"],
        peers=run_peers(path, references) if has_peer else {},
    )


def geometric_mean(values: list[float]) -> float:
    # With two references an error may come out at or below 0: smaller than they can tell.
    return math.exp(sum(math.log(max(v, 1e-9)) for v in values) / len(values))


def mean_row(rows: list[Row]) -> Row:
    settings = [s for s in PEERS if all(s in row.peers for row in rows)]
    peers = {s: tuple(geometric_mean([row.peers[s][i] for row in rows]) for i in (0, 1)) for s in settings}
    return Row(
        name=f"geometric mean, {rows[0].spp} spp",
        spp=rows[0].spp,
        num_layers=0,
        before=geometric_mean([row.before for row in rows]),
        after=geometric_mean([row.after for row in rows]),
        seconds=geometric_mean([row.seconds for row in rows]),
        peers=peers,
    )


def table_of(rows: list[Row]) -> str:
    has_peer = any(row.peers for row in rows)
    head = f"{'file':<30} {'layers':>6} {'before':>9} {'after':>9} {'ratio':>6} {'s':>6}"
    if has_peer:
        head += "".join(f" | {title:>9} {'s':>6}" for title in PEERS.values())
    lines = [head, "-" * len(head)]
    means = [mean_row([r for r in rows if r.spp == spp]) for spp in sorted({row.spp for row in rows})]
    for row in rows + means:
        if row is means[0]:
            lines.append("-" * len(head))
        layers = str(row.num_layers) if row.num_layers else ""
        ratio = row.before / max(row.after, 1e-9)
        line = f"{row.name:<30} {layers:>6} {row.before:9.5f} {row.after:9.5f} {ratio:6.1f} {row.seconds:6.2f}"
        if has_peer:
            for setting in PEERS:
                error, seconds = row.peers.get(setting, (math.nan, math.nan))
                line += f" | {error:9.5f} {seconds:6.2f}"
        lines.append(line)
    lines.append(
        "relMSE of Combined against two references; seconds from memory to memory, Quell's for all its layers."
    )
    if not has_peer:
        lines.append("Open Image Denoise (pyoidn) is not installed, so its columns are left out.")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quell", type=Path, required=True, help="the tool")
    parser.add_argument("--samples", type=Path, default=ROOT / "samples")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    arguments = parser.parse_args()
    inputs = sorted(arguments.samples.glob("*/*_*spp.exr"), key=lambda p: (p.parent.name, len(p.name), p.name))
    if not inputs:
        print(f"no samples in {arguments.samples}", file=sys.stderr)
        return 1
    arguments.out.mkdir(parents=True, exist_ok=True)
    has_peer = importlib.util.find_spec("pyoidn") is not None
    if has_peer:
        warm_up_peers()
    rows = []
    for path in inputs:
        print(f"denoising {path.name}", flush=True)
        rows.append(denoise(arguments.quell, path, arguments.out, has_peer))
    table = table_of(rows)
    (arguments.out / "table.txt").write_text(table)
    print(f"\n{table}\nDenoised files and before / after / reference pictures are in {arguments.out}/")
    return 0


if __name__ == "__main__":
    sys.exit(main())
