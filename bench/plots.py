# SPDX-License-Identifier: Apache-2.0
"""The plots of docs/benchmarks.md, from the rows of its CSVs. Each function writes one small PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from bench.summary import Results, is_ours, own_colors

OURS = ["#0b5394", "#3d85c6", "#45818e", "#76a5af", "#6a4fa3", "#9b87c9"]
PEERS = ["#f1a340", "#d9822b", "#b35806", "#7f3b08", "#999999"]


def colors(methods: Sequence[str]) -> dict[str, str]:
    """Blues are ours, browns the peer's; a method has the same colour in every plot of one document."""
    return own_colors(methods, OURS, PEERS)


def save(figure: plt.Figure, path: Path, num_colors: int = 64) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90)
    plt.close(figure)
    Image.open(buffer).convert("RGB").quantize(num_colors, dither=Image.Dither.NONE).save(path, optimize=True)


def axes(width: float = 7.2, height: float = 4.4, columns: int = 1) -> tuple[plt.Figure, list[plt.Axes]]:
    figure, made = plt.subplots(1, columns, figsize=(width, height), constrained_layout=True, squeeze=False)
    for each in made[0]:
        each.grid(True, which="major", color="#dddddd", linewidth=0.7)
        each.set_axisbelow(True)
        each.spines[["top", "right"]].set_visible(False)
    return figure, list(made[0])


def use_logarithm(axis: matplotlib.axis.Axis) -> None:
    """Powers of ten with 2 and 5 between them, written plainly."""
    axis.axes.set_xscale("log") if axis.axis_name == "x" else axis.axes.set_yscale("log")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def plot_error_time(results: Results, path: Path) -> None:
    """Error against time; better is left and below."""
    spps = results.spps
    figure, panels = axes(width=4.6 * len(spps) + 2.2, columns=len(spps))
    shades = colors(results.methods)
    for panel, spp in zip(panels, spps, strict=True):
        for method in results.methods:
            seconds, error = results.seconds(method), results.error(method, spp)
            if seconds is None or error is None:
                continue
            marker = "o" if is_ours(method) else "s"
            panel.plot(seconds, error, marker, color=shades[method], markersize=8, label=method)
        use_logarithm(panel.xaxis)
        use_logarithm(panel.yaxis)
        panel.set_title(f"{spp} samples per pixel", fontsize=10)
        panel.set_xlabel(f"seconds at {results.timed_size}, {results.threads} threads")
    panels[0].set_ylabel("relMSE of Combined, geometric mean of the samples")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right upper", fontsize=8, frameon=False)
    save(figure, path)


def plot_equal_error(results: Results, path: Path) -> None:
    """How many samples per pixel a render would need without a denoiser for the same error."""
    spps = results.spps
    figure, (panel,) = axes(height=0.34 * len(results.methods) * len(spps) / 2 + 1.6)
    shades = colors(results.methods)
    methods = [m for m in results.methods if results.error(m, spps[0]) is not None][::-1]
    for i, spp in enumerate(spps):
        rows = [y + 0.38 * (len(spps) - 1 - i) for y in range(len(methods))]
        worth = [results.worth(m, spp) for m in methods]
        panel.barh(rows, worth, 0.36, color=[shades[m] for m in methods], alpha=1.0 if i == 0 else 0.6)
        for y, value in zip(rows, worth, strict=True):
            panel.text(value, y, f" {value:.0f}  (from {spp})", va="center", fontsize=7)
    panel.set_yticks([y + 0.19 * (len(spps) - 1) for y in range(len(methods))], methods, fontsize=8)
    use_logarithm(panel.xaxis)
    panel.set_xlim(right=panel.get_xlim()[1] * 1.8)
    panel.set_xlabel("samples per pixel that the noisy render would need for the same error")
    panel.grid(False, axis="y")
    save(figure, path)


def plot_layers(results: Results, path: Path) -> None:
    figure, (panel,) = axes()
    shades = colors(results.methods)
    for method, points in results.by_layers().items():
        if is_ours(method):
            panel.plot(*zip(*points, strict=True), "o-", color=shades.get(method, OURS[0]), label=method)
            continue
        first = points[0][1]
        counts = range(1, 21)
        panel.plot(counts, [n * first for n in counts], "--", color=shades[method], linewidth=1)
        panel.plot(*zip(*points, strict=True), "s", color=shades[method], label=f"{method}, one run for each layer")
    panel.set_xlabel("layers denoised")
    panel.set_ylabel(f"seconds at {results.layers_size}, {results.threads} threads")
    use_logarithm(panel.yaxis)
    panel.set_xticks([1, 5, 10, 15, 20])
    panel.legend(fontsize=8, frameon=False)
    save(figure, path)


def plot_resolution(results: Results, path: Path) -> None:
    figure, (left, right) = axes(width=9.6, columns=2)
    shades = colors(results.methods)
    for (method, layers), rows in results.by_resolution().items():
        name = f"{method}, {layers} layers" if is_ours(method) and layers > 1 else method
        style = "o--" if layers > 1 else "o-" if is_ours(method) else "s-"
        pixels = [row["pixels"] / 1e6 for row in rows]
        shade = shades.get(method, OURS[0])
        left.plot(pixels, [row["median_s"] for row in rows], style, color=shade, label=name, markersize=5)
        right.plot(pixels, [row["working_mb"] for row in rows], style, color=shade, label=name, markersize=5)
    for panel, label in ((left, f"seconds, {results.threads} threads"), (right, "MiB beyond the pictures, peak")):
        use_logarithm(panel.xaxis)
        use_logarithm(panel.yaxis)
        panel.set_xlabel("million pixels")
        panel.set_ylabel(label)
    left.legend(fontsize=7, frameon=False)
    save(figure, path)


def plot_job(results: Results, path: Path) -> None:
    """Stages of whole jobs, each beside oiiotool's copy of the same file."""
    jobs = results.jobs()
    figure, (panel,) = axes(height=0.42 * len(jobs) + 1.4)
    stages = ["decode", "analyse", "features", "network", "filter", "recombine", "encode", "rest"]
    shade = dict(zip(stages, plt.get_cmap("tab10").colors, strict=False))
    for y, job in enumerate(jobs[::-1]):
        start = 0.0
        for stage in stages:
            share = job["stages"][stage] / job["megapixels"]
            panel.barh(y + 0.2, share, 0.36, left=start, color=shade[stage], label=stage if y == 0 else None)
            start += share
        if job["oiiotool_s"]:
            copy = job["oiiotool_s"] / job["megapixels"]
            panel.barh(y - 0.2, copy, 0.3, color="#bbbbbb", label="oiiotool's copy" if y == 0 else None)
    panel.set_yticks(range(len(jobs)), [job["name"] for job in jobs[::-1]], fontsize=8)
    panel.set_xlabel(f"seconds per million pixels, EXR to EXR, {results.threads} threads")
    panel.grid(False, axis="y")
    panel.legend(fontsize=7, frameon=False, ncols=2)
    save(figure, path)
