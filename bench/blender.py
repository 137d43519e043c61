#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The add-on beside Blender's own denoiser, in the same Blender: bench/results/blender_*.csv and a section of
docs/blender.md.

    bench/blender.py [--addon build/release/addon] [--blenders build/blender] [--work build/bench/blender]

Error: the samples' scenes are rendered once, in the Blender of each sample, with Cycles' denoiser on; the file holds
its result and the noisy picture it had, which the add-on then denoises. The renders stay in --work, so that another run
only denoises. References are the samples'. Seconds: one frame, rendered by turns. Those of all threads on a processor
are compared, because other programs hardly change them.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.common import ROOT, SIZES, machine_name, median, read_csv, revision, write_csv
from bench.errors import geometric_mean, rel_mse
from bench.pictures import Sample, list_samples, read_passes
from bench.report import number, table

SCENE_VERSIONS = ("4.5", "5.0")  # of samples/make_samples.py
TIMED_VERSION = "5.0"
LEVELS = ("fast", "balanced", "high")
CYCLES = "Cycles' own denoiser"
STAGES = ("set up", "read", "write")  # of the add-on; "denoise" is the library's
BEGIN, END = "<!-- written by bench/blender.py -->", "<!-- end -->"
# What the add-on may add to the library at AIM_SIZE: case -> seconds.
ALL_PASSES, COMBINED_ONLY = "Quell balanced, all passes", "Quell balanced, Combined only"
AIM_SIZE = "1920x1080"
AIMS = {ALL_PASSES: 0.6, COMBINED_ONLY: 0.1}


def inside(blenders: Path, version: str, work: Path, *arguments: object) -> None:
    """Runs bench/inside_blender.py in one of the Blenders, with settings and add-ons of its own."""
    python = blenders / version / "bin" / "python"
    if not python.exists():
        sys.exit(f"{python} is missing: run scripts/install_blenders.sh {blenders} {version}")
    home = work / f"home-{version}"
    shutil.rmtree(home, ignore_errors=True)
    command = [python, ROOT / "bench" / "inside_blender.py", *arguments]
    done = subprocess.run([str(c) for c in command], env={**os.environ, "BLENDER_USER_RESOURCES": str(home)})
    if done.returncode != 0:
        sys.exit(f"Blender {version} ended with {done.returncode}")


# ---- Measuring -------------------------------------------------------------------------------------------------------


def by_level(results: Path) -> tuple[int, str]:
    """A place in the tables for "Quell LEVEL, PASSES"."""
    return LEVELS.index(results.name.removeprefix("Quell ").partition(",")[0]), results.name


def error_rows(samples: list[Sample], folder: Path) -> list[dict[str, object]]:
    """relMSE of every render in `folder`, of what Cycles made of it, and of the folders beside it that Quell filled."""
    rows = []
    for sample in samples:
        path = folder / sample.path.name
        references = [read_passes(reference)["Combined"][..., :3] for reference in sample.references]
        rendered = read_passes(path)
        pictures = {"noisy": rendered["Noisy Image"], CYCLES: rendered["Combined"]}
        for results in sorted((p for p in folder.iterdir() if p.is_dir()), key=by_level):
            pictures[results.name] = read_passes(results / path.name)["Combined"]
        rows += [
            {"scene": sample.scene, "spp": sample.spp, "method": m, "rel_mse": rel_mse(p[..., :3], *references)}
            for m, p in pictures.items()
        ]
    return rows


def measure_errors(addon: Path, blenders: Path, work: Path) -> list[dict[str, object]]:
    """Renders what is not there yet and denoises all of it."""
    samples = list_samples(ROOT / "samples")
    renders = work / "samples"
    renders.mkdir(parents=True, exist_ok=True)
    spps = ",".join(str(spp) for spp in sorted({sample.spp for sample in samples}))
    for version in SCENE_VERSIONS:
        inside(blenders, version, work, "samples", renders, spps)
    for results in [p for p in renders.iterdir() if p.is_dir()]:
        shutil.rmtree(results)
    inside(blenders, TIMED_VERSION, work, "denoise", addon, renders)
    return error_rows(samples, renders)


def measure_times(addon: Path, blenders: Path, work: Path, runs: int, size: tuple[int, int]) -> list[dict[str, object]]:
    """One row for each frame that was rendered. Stages are empty where Quell was off."""
    work.mkdir(parents=True, exist_ok=True)
    inside(blenders, TIMED_VERSION, work, "time", addon, work, runs, *size)
    facts = {
        "size": "x".join(map(str, size)),
        "machine": machine_name(),
        "threads": os.cpu_count(),
        "revision": revision(),
        "load": f"{os.getloadavg()[1]:.1f}",
    }
    return [
        {
            **{column: row[column] for column in ("case", "run", "frame", "cpu", "finish", "busy")},
            **{stage: row.get("stages", {}).get(stage, "") for stage in (*STAGES, "denoise")},
            **{column: row.get(column, "") for column in ("longest", "denoised")},
            **facts,
        }
        for row in json.loads((work / "time.json").read_text())
    ]


# ---- The section -----------------------------------------------------------------------------------------------------

Row = dict[str, str]
Rows = list[Row]


def added_seconds(times: Rows) -> dict[str, float]:
    """Median seconds of processors that a case adds to a frame of the same passes without a denoiser."""
    frames = {row["case"]: median(float(r["cpu"]) for r in times if r["case"] == row["case"]) for row in times}
    return {
        case: seconds - frames["nothing, all passes" if case.endswith("all passes") else "nothing"]
        for case, seconds in frames.items()
        if not case.startswith("nothing")
    }


def stage_row(times: Rows, case: str) -> dict[str, float]:
    """Median seconds by stage of the frame's end, without what Cycles itself does there."""

    def of(name: str, take: Callable[[Row], float]) -> float:
        return median(take(row) for row in times if row["case"] == name)

    own, own_busy = (of("nothing", lambda row, key=key: float(row[key])) for key in ("finish", "busy"))
    seconds = {stage: of(case, lambda row, s=stage: float(row[s])) for stage in (*STAGES, "denoise")}
    seconds["added"] = of(case, lambda row: float(row["finish"]) - float(row["denoise"])) - own
    seconds["busy"] = of(case, lambda row: float(row["busy"])) - own_busy
    seconds["rest"] = seconds["added"] - sum(seconds[stage] for stage in STAGES)
    return seconds


def error_tables(errors: Rows, times: Rows) -> str:
    """Means over the scenes with the seconds of each method, and scene by scene."""
    methods, scenes = (list(dict.fromkeys(row[column] for row in errors)) for column in ("method", "scene"))
    spps = sorted({int(row["spp"]) for row in errors})
    found = {(row["method"], row["scene"], int(row["spp"])): float(row["rel_mse"]) for row in errors}

    added = added_seconds(times)

    def mean(method: str, spp: int) -> str:
        return number(geometric_mean([found[method, scene, spp] for scene in scenes]))

    means = table(
        ["", *(f"relMSE, {spp} spp" for spp in spps), f"seconds on processors added to a frame of {times[0]['size']}"],
        [[method, *(mean(method, spp) for spp in spps), number(added.get(method))] for method in methods],
    )
    by_scene = table(
        [f"relMSE, {spps[0]} spp", *methods],
        [[scene, *(number(found[method, scene, spps[0]]) for method in methods)] for scene in scenes],
    )
    return f"{means}\n{by_scene}"


def stage_table(times: Rows) -> str:
    rows = []
    for case, aim in AIMS.items():
        seconds = stage_row(times, case)
        reached = ("yes" if seconds["busy"] <= aim else "**no**") if times[0]["size"] == AIM_SIZE else ""
        cells = [number(seconds[stage]) for stage in (*STAGES, "rest", "added", "busy")]
        rows.append([case, *cells, f"at most {aim}", reached, number(seconds["denoise"])])
    return table(
        ["", "set up", "read", "write back", "rest", "sum", "**on a processor**", "aim", "reached", "library"], rows
    )


def section(errors: Rows, times: Rows) -> str:
    facts = times[0]
    num_scenes = len({row["scene"] for row in errors})
    num_passes = next(row["denoised"] for row in times if row["case"] == ALL_PASSES)
    machine = f"{facts['machine']} with {facts['threads']} threads"
    longest = max(float(row["longest"]) for row in times if row["longest"])
    return f"""Written by `make bench-blender`, revision {facts["revision"]}, on {machine} and a load average of
{facts["load"]}: where that is above the number of threads, other work ran too. Cycles' own denoiser is OpenImageDenoise
at Blender's defaults (High, Accurate, albedo and normal), on the processor. Both start from the same noisy picture,
rendered by Blender {" and ".join(SCENE_VERSIONS)} from the {num_scenes} scenes of `samples/`. relMSE is against two
references each, its mean geometric: less is better. Seconds are those of all threads on a processor, the difference of
a frame with and without the denoiser, medians of renders that take turns, in Blender {TIMED_VERSION}: an idle machine
takes as long as that divided by its threads. Cycles' denoiser cleans Combined alone; "all passes" is {num_passes}
passes here.

{error_tables(errors, times)}
What the add-on takes beside the library in that frame, in seconds by stage by the clock, and of its one thread on a
processor, which is compared with the aim for {AIM_SIZE}.

{stage_table(times)}
The interface has to wait while one pass is read or written, at most {number(longest)} s on a processor here (aim: below
0.1 s); during the rest it goes on."""


def put_section(page: Path, text: str) -> None:
    """Replaces what stands between the marks."""
    before = page.read_text()
    pattern = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
    if not pattern.search(before):
        sys.exit(f"{page} has no '{BEGIN}' ... '{END}'")
    page.write_text(pattern.sub(lambda _: f"{BEGIN}\n\n{text}\n{END}", before))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--addon", type=Path, default=ROOT / "build" / "release" / "addon", help="folder of the zips")
    parser.add_argument("--blenders", type=Path, default=ROOT / "build" / "blender", help="VERSION/bin/python with bpy")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "bench" / "blender", help="where renders stay")
    parser.add_argument("--runs", type=int, default=2, help="timed frames of each kind (default: %(default)s)")
    parser.add_argument("--size", choices=SIZES, default="1080p", help="of the timed frame (default: %(default)s)")
    parser.add_argument("--only", choices=("error", "time"), help="measure one, and keep the other's CSV")
    parser.add_argument("--results", type=Path, default=ROOT / "bench" / "results", help="folder of the CSVs")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "blender.md", help="page with the section")
    arguments = parser.parse_args()

    (addon,) = (path for path in arguments.addon.glob("*.zip") if "legacy" not in path.name)
    tables = {name: arguments.results / f"blender_{name}.csv" for name in ("error", "time")}
    if arguments.only != "time":
        write_csv(tables["error"], measure_errors(addon, arguments.blenders, arguments.work))
    if arguments.only != "error":
        write_csv(
            tables["time"],
            measure_times(addon, arguments.blenders, arguments.work, arguments.runs, SIZES[arguments.size]),
        )
    put_section(arguments.page, section(read_csv(tables["error"]), read_csv(tables["time"])))
    print(arguments.page)


if __name__ == "__main__":
    main()
