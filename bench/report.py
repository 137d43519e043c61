#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes docs/benchmarks.md and docs/images/bench-*.png from the CSVs that bench/peers.py left.

    bench/report.py [--results bench/results] [--machine NAME] [--out docs]

Every figure and every sentence about who wins comes from the CSVs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.common import ROOT
from bench.summary import Results, is_ours

TIMED = "samples/living_room"
HIGH_FAST, HIGH_ACCURATE, PER_PASS = "OIDN High/Fast", "OIDN High/Accurate", "OIDN High/Accurate per light pass"


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def number(value: float | None, digits: int = 3) -> str:
    """Plain, with that many digits that count."""
    if value is None or value != value:
        return ""
    if value == 0:
        return "0"
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:,.0f}"
    text = f"{value:.{digits}g}"
    return f"{float(text):f}".rstrip("0").rstrip(".") if "e" in text else text


def picture(out: Path, name: str, title: str) -> str:
    return f"![{title}]({(out / 'images' / name).relative_to(out)})\n"


# ---- Sections --------------------------------------------------------------------------------------------------------


def head_section(results: Results) -> str:
    facts = results.facts
    return f"""# Benchmarks

Written by `bench/report.py` from the CSVs under `bench/results/`; `make bench-peers` makes both (an hour on two cores),
`make bench-quick` a small part in two minutes, under `build/bench/`.

Machine: {facts["machine"]}, {threads_text(results)}, kernels `{facts["kernels"]}`; revision {facts["revision"]}.
Open Image Denoise (OIDN) is 2.5.1 from PyPI, run as Blender runs it; its settings are named *quality/prefilter* as
in Blender, whose default is High/Accurate. Both sides take turns, run by run, on the same pictures; times are
medians. A section that has no CSV yet is left out.
"""


def threads_text(results: Results) -> str:
    return f"{results.threads} {'thread' if results.threads == 1 else 'threads'}"


def verdict(results: Results, method: str) -> str:
    """Which of the peer's settings a method beats in both, and which beat it in both."""
    spp = results.spps[0]
    seconds, error = results.seconds(method), results.error(method, spp)
    beaten, beating = [], []
    for peer in results.methods:
        peer_seconds, peer_error = results.seconds(peer), results.error(peer, spp)
        if is_ours(peer) or None in (seconds, error, peer_seconds, peer_error):
            continue
        if seconds <= peer_seconds and error <= peer_error:
            beaten.append(peer)
        if peer_seconds <= seconds and peer_error <= error:
            beating.append(peer)
    text = f"- `{method}` at {spp} spp: "
    if not beaten and not beating:
        return text + "neither left of and below any setting of the peer, nor the other way round."
    parts = []
    if beaten:
        parts.append(f"faster and nearer to the truth than {', '.join(beaten)}")
    if beating:
        parts.append(f"**slower and further from the truth than {', '.join(beating)}**")
    return text + "; ".join(parts) + "."


def error_section(results: Results, out: Path) -> str:
    first, *_, last = results.spps if len(results.spps) > 1 else (*results.spps, results.spps[0])
    rows = []
    for method in ["noisy", *results.methods]:
        rows.append(
            [
                method,
                number(results.seconds(method)),
                *([number(results.seconds(method, 1))] if results.threads > 1 else []),
                number(float(timed["macs_per_pixel"])) if (timed := results.timed(method)) else "",
                *(number(results.error(method, spp), 3) for spp in results.spps),
                number(results.error(method, first, "psnr"), 3),
                number(results.error(method, first, "ssim"), 3),
                number(results.error(method, first, "flip"), 3),
            ]
        )
    columns = ["method", f"s, {threads_text(results)}", *(["s, 1 thread"] if results.threads > 1 else [])]
    columns += ["multiply-adds per pixel"]
    columns += [f"relMSE {spp} spp" for spp in results.spps]
    columns += [f"PSNR {first} spp", f"SSIM {first} spp", f"FLIP {first} spp"]
    verdicts = "\n".join(verdict(results, m) for m in results.methods if is_ours(m))
    return f"""
## Error against time

Combined of the {len(results.scenes)} samples ({", ".join(results.scenes)}) at {first} and {last} samples per pixel,
against two references whose own noise cancels in relMSE and PSNR; relMSE is the geometric mean, the others are
means. Seconds are memory to memory at {results.timed_size}, filters and frames set up before, on a sample repeated
to that size. Our models get all passes of the file and clean **all** of them in that time; "beauty" gets Combined
and the guides alone, as the peer does. "Per light pass" is one node for each pass and colour, put together again;
its seconds are those of its nodes, counted. Where a row has no error, not every sample has what it needs (one has
no light passes).

{table(columns, rows)}
{picture(out, "bench-error-time.png", "Error against time")}
Left of and below is better:

{verdicts}

{per_pass_text(results)}"""


def per_pass_text(results: Results) -> str:
    spp = results.spps[0]
    scenes = [s for s in results.scenes if s in results.values(PER_PASS, spp, "rel_mse")]
    if not scenes:
        return ""
    rows = [[m, *(number(results.error_on(scenes, m, s)) for s in results.spps)] for m in ["noisy", *results.methods]]
    head = ["method", *(f"relMSE {s} spp" for s in results.spps)]
    return f"On the samples with light passes alone ({', '.join(scenes)}):\n\n{table(head, rows)}"


def worth_section(results: Results, out: Path) -> str:
    rows = []
    for method in results.methods:
        if results.error(method, results.spps[0]) is None:
            continue
        cells = [method]
        for spp in results.spps:
            worth = results.worth(method, spp)
            saved = (worth - spp) * results.render_seconds(spp) - (results.seconds(method) or 0.0)
            cells += [f"{worth / spp:.1f}x", f"{saved:,.0f}"]
        rows.append(cells)
    head = ["method"]
    for spp in results.spps:
        head += [f"samples saved, from {spp} spp", f"seconds saved, from {spp} spp"]
    return f"""
## Samples and seconds saved at equal error

A render's error falls as 1 / samples, so a denoised picture is worth as many samples as the noisy one would need
for the same relMSE (geometric mean over the samples). Seconds are Cycles' own, from the headers of the samples (on
the machine that rendered them), for a picture of {results.timed_size}, less those of the denoiser.

{table(head, rows)}
{picture(out, "bench-equal-error.png", "Samples that a render would need for the same error")}"""


def layers_section(results: Results, out: Path) -> str:
    rows = []
    for method, points in results.by_layers().items():
        times = dict(points)
        most = max(times)
        further = (times[most] - times[1]) / (most - 1) / times[1] if most > 1 else None
        ten = times.get(10, 10 * times[1]) if not is_ours(method) or 10 in times else None
        share = f"{100 * further:.1f} %" if further is not None else "100 %"
        rows.append([method, number(times[1]), number(ten), share])
    head = ["method", "s, 1 layer", "s, 10 layers", "each further layer, of the first"]
    return f"""
## Time by number of layers

At {results.layers_size}. The peer has one run for each layer (the seconds for ten are ten times those for one).

{table(head, rows)}
{picture(out, "bench-layers.png", "Seconds by number of layers")}"""


def resolution_section(results: Results, out: Path) -> str:
    rows = []
    for (method, layers), points in results.by_resolution().items():
        name = f"{method}, {layers} layers" if is_ours(method) and layers > 1 else method
        for row in points:
            rows.append([name, row["size"], number(row["median_s"]), number(row["working_mb"])])
    return f"""
## Time and memory by resolution

Combined and guides unless it says 10 layers. Memory is the peak beyond the pictures: ours as the library counts it
(its results not included, which take the place of the input), the peer's as its process grew. Sizes that a setting
would need minutes for are left out.

{picture(out, "bench-resolution.png", "Seconds and memory by resolution")}
{table(["method", "size", "s", "MiB"], rows)}"""


def job_section(results: Results, out: Path) -> str:
    rows = []
    for job in results.jobs():
        stages = job["stages"]
        ratio = f"{job['whole_s'] / job['oiiotool_s']:.2f}" if job["oiiotool_s"] else ""
        rows.append(
            [
                job["name"],
                number(job["whole_s"]),
                number(job["oiiotool_s"]) if job["oiiotool_s"] else "",
                ratio,
                *(number(stages[s], 2) for s in ("decode", "analyse", "features", "network", "filter", "recombine")),
                number(stages["encode"], 2),
                number(job["working_mb"]),
                number(job["resident_mb"]),
            ]
        )
    head = [
        "file",
        "whole s",
        "`oiiotool -a IN -o OUT` s",
        "ratio",
        "decode",
        "analyse",
        "features",
        "network",
        "filter",
    ]
    head += ["recombine", "encode", "working MiB", "resident MiB"]
    return f"""
## Whole jobs, EXR to EXR

Half floats in ZIP. oiiotool reads and writes the same file and does nothing else. "Layers" are those that are
denoised: Combined, then light passes and colours.

{table(head, rows)}
{picture(out, "bench-job.png", "Stages of whole jobs beside a plain copy")}"""


def percent(ratio: str) -> str:
    return f"{100 * (float(ratio) - 1):+.1f} %"


def skip_section(results: Results) -> str:
    rows = [
        [
            row["case"],
            row["layers_skipped"],
            f"{int(row['active_cells'])} of {int(row['cells'])}",
            number(float(row["no_skip_cpu_s"])),
            number(float(row["default_cpu_s"])),
            percent(row["ratio"]),
            f"{percent(row['pairs'])} ({percent(row['ratio_min'])} to {percent(row['ratio_max'])})",
        ]
        for row in results.rows("skip")
    ]
    first = results.rows("skip")[0]
    head = ["picture", "layers skipped", "cells computed", "`--no-skip` s", "s", "difference", "of single pairs"]
    return f"""
## What skipping costs and saves

Whole jobs at {first["width"]}x{first["height"]}, `{TIMED}` repeated to that size, without compression;
{first["runs"]} pairs of runs with and without `--no-skip` that took turns. Seconds are processor time of all threads,
system calls included, the least of the runs: what disturbs a process only ever adds to it. The last column is the
median of the pairs, and their range.

{table(head, rows)}"""


def aims_section(results: Results) -> str:
    """What was asked for, and what is."""
    rows: list[list[object]] = []

    def compare(what: str, aim: float, value: float | None) -> None:
        if value is not None:
            rows.append([what, f"at most {aim:g}", number(value), "yes" if value <= aim else "**no**"])

    def ratio(ours: str, peer: str) -> float | None:
        a, b = results.seconds(ours), results.seconds(peer)
        return a / b if a and b else None

    aims = {
        "fast": [(HIGH_FAST, 0.15)],
        "balanced": [(HIGH_FAST, 0.4), (HIGH_ACCURATE, 0.06)],
        "high": [(HIGH_ACCURATE, 0.1)],
    }
    for level, against in aims.items():
        for name in results.methods:
            if is_ours(name) and name.endswith(", beauty") and level in name:
                for peer, aim in against:
                    compare(f"`{name}`: seconds over those of {peer}", aim, ratio(name, peer))
    by_layers = results.by_layers()
    for name, points in by_layers.items():
        times = dict(points)
        if not is_ours(name) or 10 not in times:
            continue
        if HIGH_FAST in by_layers:
            compare(
                f"`{name}`: 10 layers, seconds over {HIGH_FAST} ten times",
                0.05,
                times[10] / (10 * by_layers[HIGH_FAST][0][1]),
            )
        compare(
            f"`{name}`: a further layer over the first",
            0.05,
            (times[max(times)] - times[1]) / (max(times) - 1) / times[1],
        )
    for job in results.jobs():
        if job["size"] == "1080p" and job["oiiotool_s"]:
            compare(f"whole job, {job['name']}: seconds over oiiotool's", 1.2, job["whole_s"] / job["oiiotool_s"])
    for row in results.rows("skip")[:1]:
        compare(f"skipping, {row['case']}: processor time over `--no-skip`", 1.01, float(row["ratio"]))
    for job in results.jobs():
        limit = {"1080p": 400.0, "4K": 1200.0}.get(job["size"])
        if limit:
            compare(f"working memory, {job['name']}: MiB", limit, job["working_mb"])
    return (
        f"""
## Aims

{table(["what", "aim", "measured", "reached"], rows)}"""
        if rows
        else ""
    )


# ---- The program -----------------------------------------------------------------------------------------------------


def write(results: Results, out: Path) -> None:
    from bench import plots

    images = out / "images"
    text = head_section(results)
    if results.rows("error") and results.rows("time"):
        text += error_section(results, out) + worth_section(results, out)
        plots.plot_error_time(results, images / "bench-error-time.png")
        plots.plot_equal_error(results, images / "bench-equal-error.png")
    if results.rows("layers"):
        text += layers_section(results, out)
        plots.plot_layers(results, images / "bench-layers.png")
    if results.rows("resolution"):
        text += resolution_section(results, out)
        plots.plot_resolution(results, images / "bench-resolution.png")
    if results.rows("skip"):
        text += skip_section(results)
    if results.rows("job"):
        text += job_section(results, out)
        plots.plot_job(results, images / "bench-job.png")
    text += aims_section(results)
    out.mkdir(parents=True, exist_ok=True)
    (out / "benchmarks.md").write_text(text)


def machines(folder: Path) -> list[str]:
    return sorted({path.stem.rpartition("-")[0] for path in folder.glob("*-*.csv")})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=ROOT / "bench" / "results", help="folder of the CSVs")
    parser.add_argument("--machine", help="the first part of their names; needed when there are several")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of benchmarks.md, with images/ in it")
    arguments = parser.parse_args()
    found = machines(arguments.results)
    if arguments.machine is None and len(found) != 1:
        sys.exit(f"--machine: one of {', '.join(found)}" if found else f"there are no results in {arguments.results}")
    write(Results.read(arguments.results, arguments.machine or found[0]), arguments.out)
    print(arguments.out / "benchmarks.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
