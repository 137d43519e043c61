#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Quell beside Open Image Denoise: error, time and memory on the same pictures, threads and machine.

    bench/peers.py --build build/release [--quick] [--only SECTION,...] [--no-peer]

`make bench-peers` runs it all, `make bench-quick` a small part in two minutes. Methods take turns, run by run, so that
what disturbs the machine disturbs all alike. One CSV for each section:

    error       relMSE, PSNR, SSIM and FLIP of Combined on the samples, two references
    time        seconds at 1920x1080, memory to memory, by threads
    layers      seconds by number of layers, 1 to 20
    resolution  seconds and peak memory by size, 480p to 8K, each in a process of its own
    skip        what looking for something to skip costs and saves, beside --no-skip
    job         EXR to EXR with its stages, beside oiiotool reading and writing the same file

bench/report.py makes docs/benchmarks.md and its plots of them.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench import methods, pictures
from bench.common import ROOT, SIZES, interleaved, machine_name, median, revision, slug, timed_process, write_csv
from bench.errors import MEASURES

SECTIONS = ["error", "time", "layers", "resolution", "skip", "job"]
TIMED_SCENE, TIMED_SPP = "living_room", 4  # all light passes; repeated to the size that is timed
MEBI = 2**20


@dataclass(frozen=True)
class Plan:
    """What is measured: all of it, or what fits in two minutes."""

    runs: int = 5
    scenes: tuple[str, ...] = ()  # () for all
    threads: tuple[int, ...] = (1, 2)
    time_size: str = "1080p"
    layers: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 10, 12, 15, 20)
    peer_layers: tuple[int, ...] = (1, 2, 5)  # of one node each; the cost of more is a straight line
    sizes: tuple[str, ...] = tuple(SIZES)
    skip_size: str = "480p"
    job_sizes: tuple[str, ...] = ("480p", "1080p", "4K")
    job_layers: tuple[int, ...] = (1, 4, 10)
    max_macs: float = 4e12  # a run of a peer that would need more is left out: minutes, and gigabytes


QUICK = Plan(
    runs=1,
    scenes=("living_room", "bathroom"),
    threads=(2,),
    time_size="480p",
    layers=(1, 4, 10),
    peer_layers=(1,),
    sizes=("480p",),
    job_sizes=("480p",),
    job_layers=(1, 10),
)


@dataclass(frozen=True)
class Bench:
    plan: Plan
    quell: Path
    work: Path
    kernels: str
    threads: int
    has_peer: bool

    def facts(self) -> dict[str, object]:
        return {"machine": machine_name(), "kernels": self.kernels, "revision": revision()}

    def methods(self) -> list[methods.Method]:
        return methods.our_methods() + (methods.peer_methods() if self.has_peer else [])

    def tool(self, *arguments: object) -> dict:
        return json.loads(timed_process([self.quell, *arguments]).stdout)


def say(*words: object) -> None:
    print(*words, file=sys.stderr, flush=True)


# ---- Sections --------------------------------------------------------------------------------------------------------


def measure_error(bench: Bench) -> list[dict[str, object]]:
    rows = []
    for sample in pictures.list_samples(ROOT / "samples"):
        if bench.plan.scenes and sample.scene not in bench.plan.scenes:
            continue
        say(f"error: {sample.path.name}")
        passes = pictures.read_passes(sample.path)
        references = [pictures.read_passes(path)["Combined"][..., :3] for path in sample.references]
        height, width = passes["Combined"].shape[:2]
        images = {"noisy": passes["Combined"][..., :3]}
        for method in bench.methods():
            if method.wants_light and not methods.has_light(passes):
                continue
            ready = method.set_up(passes, sample.spp, bench.threads)
            ready.run()
            images[method.name] = ready.combined().copy()
            ready.close()
        for name, image in images.items():
            row = bench.facts() | {"scene": sample.scene, "spp": sample.spp, "method": name}
            row |= {"width": width, "height": height, "render_s": pictures.render_seconds(sample.path)}
            rows.append(row | {key: measure(image, *references) for key, measure in MEASURES.items()})
    return rows


def measure_time(bench: Bench) -> list[dict[str, object]]:
    path = next(s.path for s in pictures.list_samples(ROOT / "samples") if (s.scene, s.spp) == (TIMED_SCENE, TIMED_SPP))
    width, height = SIZES[bench.plan.time_size]
    passes = pictures.repeat_to(pictures.read_passes(path), width, height)
    rows = []
    for threads in bench.plan.threads:
        say(f"time: {bench.plan.time_size}, {threads} threads")
        # Nodes of one setting cost the same each, and thirteen are minutes: these are counted.
        chosen = {m.name: m for m in bench.methods() if not m.wants_light}
        ready = {name: m.set_up(passes, TIMED_SPP, threads) for name, m in chosen.items()}
        row = bench.facts() | {"threads": threads, "width": width, "height": height}
        for name, taken in interleaved({n: r.run for n, r in ready.items()}, bench.plan.runs).items():
            macs = ready[name].report.macs_per_pixel if chosen[name].is_ours else chosen[name].macs_per_pixel
            times = {"median_s": median(taken), "min_s": min(taken), "max_s": max(taken), "runs": len(taken)}
            rows.append(row | {"method": name, "macs_per_pixel": macs} | times)
        for name in (m.name for m in bench.methods() if m.wants_light):
            one = next(r for r in rows if (r["method"], r["threads"]) == (methods.PER_PASS_SETTING, threads))
            nodes = len(methods.nodes_of(passes))
            times = {key: nodes * one[key] for key in ("macs_per_pixel", "median_s", "min_s", "max_s")}
            rows.append(row | {"method": name} | times | {"runs": 0})
        for each in ready.values():
            each.close()
    return rows


def measure_layers(bench: Bench) -> list[dict[str, object]]:
    width, height = SIZES[bench.plan.time_size]
    rows = []

    def add(name: str, layers: int, result: dict) -> None:
        row = bench.facts() | {"method": name, "threads": bench.threads, "width": width, "height": height}
        rows.append(row | {"layers": layers} | {k: result[k] for k in ("median_s", "min_s", "max_s")})

    for layers in bench.plan.layers:
        say(f"layers: {layers}")
        for model in methods.our_models():
            command = ["bench", "--json", "--size", f"{width}x{height}", "--layers", layers, "--runs", bench.plan.runs]
            command += ["--threads", bench.threads, "--model", model]
            add(model, layers, bench.tool(*command))
    if bench.has_peer:
        nodes = bench.plan.peer_layers
        passes = made_up(width, height)
        copies = passes | {f"Combined{i}": passes["Combined"].copy() for i in range(1, max(nodes))}
        names = ["Combined", *(f"Combined{i}" for i in range(1, max(nodes)))]
        for setting in ("OIDN Fast/Fast", "OIDN High/Fast"):
            for layers in nodes:
                say(f"layers: {layers} of {setting}")
                peer = methods.Peer(copies, bench.threads, setting, names[:layers])
                taken = interleaved({"peer": peer.run}, bench.plan.runs)["peer"]
                peer.close()
                add(setting, layers, {"median_s": median(taken), "min_s": min(taken), "max_s": max(taken)})
    return rows


def made_up(width: int, height: int) -> dict[str, object]:
    import numpy as np

    rng = np.random.default_rng(1)
    names = ("Combined", "Denoising Albedo", "Denoising Normal")
    return {name: rng.random((height, width, 3), dtype=np.float32) for name in names}


def measure_resolution(bench: Bench) -> list[dict[str, object]]:
    rows = []
    for size in bench.plan.sizes:
        width, height = SIZES[size]
        say(f"resolution: {size}")
        row = bench.facts() | {"size": size, "width": width, "height": height, "threads": bench.threads}
        runs = max(1, min(bench.plan.runs, 3))
        for model in methods.our_models():
            for layers in (1, 10):
                # A frame of ten float layers and as many results at 8K is some ten gigabytes.
                if layers == 10 and width * height > 4096 * 2304:
                    continue
                command = ["bench", "--json", "--size", f"{width}x{height}", "--layers", layers, "--runs", runs]
                command += ["--threads", bench.threads, "--model", model]
                result = bench.tool(*command)
                rows.append(
                    row
                    | {"method": model, "layers": layers, "median_s": result["median_s"], "tiles": result["tiles"]}
                    | {"working_mb": result["peak_bytes"] / MEBI}
                )
        for setting, (_, _, macs) in methods.PEER_SETTINGS.items() if bench.has_peer else ():
            if macs * width * height > bench.plan.max_macs:
                continue
            command = [sys.executable, Path(__file__), "--peer-process", setting, width, height, bench.threads, runs]
            result = json.loads(timed_process(command).stdout)
            rows.append(row | {"method": setting, "layers": 1, "tiles": ""} | result)
    return rows


def peer_process(setting: str, width: int, height: int, threads: int, runs: int) -> None:
    """Times one setting in this process and prints its median and the memory that it took beyond the pictures."""
    passes = made_up(width, height)
    before = peak_resident_mb()
    peer = methods.Peer(passes, threads, setting, ["Combined"])
    taken = interleaved({"peer": peer.run}, runs)["peer"]
    print(json.dumps({"median_s": median(taken), "working_mb": peak_resident_mb() - before}))


def peak_resident_mb() -> float:
    """Peak of this process itself. (getrusage also counts what stood in its place before exec.)"""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    sys.exit("/proc/self/status has no VmHWM: peak memory can be measured on Linux alone")


def skip_cases(width: int, height: int) -> dict[str, tuple[dict[str, np.ndarray], int]]:
    """Passes and samples of pictures with more and more to skip."""
    sample = next(s for s in pictures.list_samples(ROOT / "samples") if (s.scene, s.spp) == (TIMED_SCENE, TIMED_SPP))
    noisy = pictures.read_passes(sample.path)
    light = {name: pixels for name, pixels in noisy.items() if np.any(pixels)}
    centred = {
        name: np.pad(
            pixels,
            ((height // 4, height - height // 2 - height // 4), (width // 4, width - width // 2 - width // 4), (0, 0)),
        )
        for name, pixels in pictures.repeat_to(noisy, width // 2, height // 2).items()
    }
    return {
        "nothing to skip: a noisy picture": (pictures.repeat_to(light, width, height), TIMED_SPP),
        "passes that are black": (pictures.repeat_to(noisy, width, height), TIMED_SPP),
        "an empty film round a quarter of the frame": (centred, TIMED_SPP),
        "a finished render": (pictures.repeat_to(pictures.read_passes(sample.references[0]), width, height), 2048),
    }


def measure_skip(bench: Bench) -> list[dict[str, object]]:
    """Processor time of whole jobs without compression, with and without --no-skip in turns. On a machine that does
    other things too, the wall clock says more about those."""
    width, height = SIZES[bench.plan.skip_size]
    path, out, report = (bench.work / name for name in ("skip.exr", "skipped.exr", "report.json"))
    rows = []
    for case, (passes, samples) in skip_cases(width, height).items():
        say(f"skip: {case}")
        pictures.write_passes(path, passes, samples)
        summaries: dict[tuple[str, ...], dict] = {}

        def denoise(*flags: str, summaries: dict[tuple[str, ...], dict] = summaries) -> float:
            command = [bench.quell, "denoise", path, "-q", "-o", out, "--report", report, "--threads", bench.threads]
            ended = timed_process([*command, *flags])
            summaries[flags] = json.loads(report.read_text())["files"][0]
            return ended.processor_seconds

        taken = interleaved({"default": denoise, "no_skip": lambda: denoise("--no-skip")}, bench.plan.runs)
        summary = summaries[()]["summary"]
        skipped = sum(layer["action"] == "skip" for layer in summaries[()]["layers"])
        row = bench.facts() | {"case": case, "width": width, "height": height, "threads": bench.threads}
        row |= {"cells": summary["cells"], "active_cells": summary["active_cells"], "layers_skipped": skipped}
        # What disturbs a process only ever adds: the least is what it needs by itself.
        row |= {f"{name}_cpu_s": min(seconds) for name, seconds in taken.items()}
        pairs = [a / b for a, b in zip(taken["default"], taken["no_skip"], strict=True)]
        row |= {"ratio": row["default_cpu_s"] / row["no_skip_cpu_s"], "pairs": median(pairs)}
        rows.append(row | {"ratio_min": min(pairs), "ratio_max": max(pairs), "runs": len(pairs)})
    path.unlink()
    out.unlink()
    return rows


def measure_job(bench: Bench) -> list[dict[str, object]]:
    import quell

    oiiotool = shutil.which("oiiotool")
    if not oiiotool:
        say("oiiotool is not there: its columns stay empty")
    rows = []
    for size in bench.plan.job_sizes:
        for layers in bench.plan.job_layers:
            path = bench.work / f"{size}_{layers}.exr"
            pictures.write_exr(path, *SIZES[size], pictures.LIGHT[: layers - 1])
            for quality in quell.qualities():
                say(f"job: {size}, {layers} layers, {quality}")
                width, height = SIZES[size]
                row = bench.facts() | {"size": size, "width": width, "height": height, "threads": bench.threads}
                row |= {"layers": layers, "quality": quality, "input_mb": path.stat().st_size / MEBI}
                rows.append(row | measure_one_job(bench, path, quality, oiiotool))
            path.unlink()
    return rows


def measure_one_job(bench: Bench, path: Path, quality: str, oiiotool: str | None) -> dict[str, object]:
    report, ours, copy = bench.work / "report.json", bench.work / "ours.exr", bench.work / "copy.exr"
    reports, resident = [], []

    def denoise() -> float:
        command = [bench.quell, "denoise", path, "-q", "-o", ours, "--report", report, "--quality", quality]
        ended = timed_process([*command, "--threads", bench.threads])
        reports.append(json.loads(report.read_text())["files"][0])
        resident.append(ended.resident_mb)
        return ended.seconds

    jobs = {"quell": denoise}
    if oiiotool:
        command = [oiiotool, "--threads", bench.threads, "-a", path, "-o", copy]
        jobs["oiiotool"] = lambda: timed_process(command).seconds
    seconds = interleaved(jobs, max(1, min(bench.plan.runs, 3)))
    stages = {f"{s}_s": median(r["stages"][s] for r in reports[1:]) for s in reports[0]["stages"]}
    row = {"whole_s": median(seconds["quell"]), "denoise_s": median(r["seconds_denoise"] for r in reports[1:])}
    row |= {"oiiotool_s": median(seconds["oiiotool"]) if oiiotool else ""} | stages
    row |= {"working_mb": reports[0]["summary"]["peak_bytes"] / MEBI, "resident_mb": max(resident)}
    row |= {"output_mb": ours.stat().st_size / MEBI, "copy_mb": copy.stat().st_size / MEBI if oiiotool else ""}
    ours.unlink()
    copy.unlink(missing_ok=True)
    return row


# ---- The program -----------------------------------------------------------------------------------------------------


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "release", help="folder with bin/ and lib/")
    parser.add_argument("--quick", action="store_true", help="a small part of it, in two minutes")
    parser.add_argument("--only", default=",".join(SECTIONS), help=f"of {', '.join(SECTIONS)}; comma-separated")
    parser.add_argument("--no-peer", action="store_true", help="Quell alone")
    parser.add_argument("--runs", type=int, help="that count, of each method; one more warms up")
    parser.add_argument(
        "--threads", type=int, default=0, help="where a section does not say; default: one for each core"
    )
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "bench", help="folder of the pictures")
    parser.add_argument("--results", type=Path, default=ROOT / "bench" / "results", help="folder of the CSVs")
    return parser.parse_args()


def main() -> int:
    if sys.argv[1:2] == ["--peer-process"]:
        peer_process(sys.argv[2], *map(int, sys.argv[3:7]))
        return 0
    arguments = parse()
    sections = arguments.only.split(",")
    unknown = sorted(set(sections) - set(SECTIONS))
    if unknown:
        sys.exit(f"there is no section '{unknown[0]}', only {', '.join(SECTIONS)}")
    build = arguments.build.resolve()
    os.environ.setdefault("QUELL_LIBRARY", str(build / "lib" / "libquell.so"))
    has_peer = not arguments.no_peer and importlib.util.find_spec("pyoidn") is not None
    if not arguments.no_peer and not has_peer:
        say("Open Image Denoise (pyoidn) is not installed: Quell alone")
    plan = QUICK if arguments.quick else Plan()
    if arguments.runs:
        plan = Plan(**{**plan.__dict__, "runs": arguments.runs})
    arguments.work.mkdir(parents=True, exist_ok=True)

    import quell

    with quell.Context(threads=arguments.threads) as context:
        kernels, threads = context.cpu, context.threads
    bench = Bench(plan, build / "bin" / "quell", arguments.work, kernels, threads, has_peer)
    measures = {
        "error": measure_error,
        "time": measure_time,
        "layers": measure_layers,
        "resolution": measure_resolution,
        "skip": measure_skip,
        "job": measure_job,
    }
    for section in SECTIONS:
        if section not in sections:
            continue
        path = arguments.results / f"{slug(machine_name(), kernels)}-{section}.csv"
        write_csv(path, measures[section](bench))
        print(path.relative_to(ROOT) if path.is_relative_to(ROOT) else path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
