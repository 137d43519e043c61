#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes bench/results/*-stability.csv, docs/stability.md and its plots: samples with something wrong put into them,
denoised by Quell and by Open Image Denoise.

    bench/stability.py [--build build/release] [--scenes house,living_room] [--results ...] [--out docs] [--only-write]

Both sides get the same corrupted Combined and guides; Quell also all light passes, bad in the same pixels.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench import methods, pictures
from bench.common import ROOT, machine_name, read_csv, revision, slug, write_csv
from bench.corruptions import ALBEDO, NORMAL, Case, Passes, cases
from bench.errors import geometric_mean, rel_mse

SPP = 16
OURS, BEAUTY, PEER = "quell", "quell, Combined and guides alone", "OIDN High/Accurate"
RENDER = "the render itself"


# ---- Measuring -------------------------------------------------------------------------------------------------------


def denoise_ours(passes: Passes, samples: int) -> np.ndarray:
    ready = methods.Ours(passes, samples, 0, "")
    ready.run()
    result = ready.combined().copy()
    ready.close()
    return result


def denoise_peer(passes: Passes) -> np.ndarray:
    """As Blender's node with quality High and prefilter Accurate; a guide that is missing is left out."""
    import pyoidn

    device = pyoidn.Device()
    device.set_bool("setAffinity", False)
    device.commit()
    images = {"color": np.ascontiguousarray(passes["Combined"][..., :3])}
    made = []
    for name, layer in (("albedo", ALBEDO), ("normal", NORMAL)):
        if layer not in passes:
            continue
        noisy = np.ascontiguousarray(passes[layer][..., :3])
        images[name] = np.empty_like(noisy)
        made.append(methods.Filters.make(device, {name: noisy}, images[name], quality=6))
    result = np.empty_like(images["color"])
    made.append(methods.Filters.make(device, images, result, quality=6, hdr=True, cleanAux=len(images) > 1))
    for each in made:
        each.execute()
    error = device.get_error()
    if error:
        sys.exit(f"Open Image Denoise: {error}")
    for each in made:
        each.release()
    device.release()
    return result


def measure_case(case: Case, passes: Passes, references: list[np.ndarray], has_peer: bool) -> dict[str, np.ndarray]:
    """Result of each method, brought back to the references' exposure."""
    wrong = case.apply(passes)
    samples = SPP if case.samples is None else case.samples
    results = {
        RENDER: wrong["Combined"][..., :3],
        OURS: denoise_ours(wrong, samples),
        BEAUTY: denoise_ours(methods.only_combined(wrong), samples),
    }
    if has_peer and not case.is_ours_alone:
        results[PEER] = denoise_peer(wrong)
    return {name: np.ldexp(image, -case.exponent) for name, image in results.items()}


def measure(scenes: list[str], kinds: set[str], has_peer: bool) -> list[dict[str, object]]:
    """kinds: of the corruptions, besides none; empty for all."""
    import quell

    with quell.Context() as context:
        facts = {"machine": machine_name(), "kernels": context.cpu, "revision": revision()}
    rows: list[dict[str, object]] = []
    for sample in pictures.list_samples(ROOT / "samples"):
        if sample.scene not in scenes or sample.spp != SPP:
            continue
        passes = pictures.read_passes(sample.path)
        references = [pictures.read_passes(path)["Combined"][..., :3] for path in sample.references]
        good: dict[str, np.ndarray] = {}
        for case in cases():
            if kinds and case.kind not in kinds | {"none"}:
                continue
            print(f"{sample.scene}: {case.label}", file=sys.stderr, flush=True)
            for method, image in measure_case(case, passes, references, has_peer).items():
                good.setdefault(method, image)
                finite = np.isfinite(image)
                rows.append(
                    facts
                    | {"scene": sample.scene, "kind": case.kind, "case": case.label, "at": case.at, "method": method}
                    | {
                        "rel_mse": rel_mse(np.where(finite, image, 0), *references),
                        "non_finite": int((~finite.all(-1)).sum()),
                        "as_good": int(np.array_equal(image, good[method])),
                    }
                )
    return rows


# ---- Writing ---------------------------------------------------------------------------------------------------------


class Results:
    """Geometric means over the scenes, by case and method."""

    def __init__(self, rows: list[dict[str, str]]) -> None:
        self.rows = rows
        self.scenes = sorted({row["scene"] for row in rows})
        self.cases = list(dict.fromkeys((row["kind"], row["case"], float(row["at"])) for row in rows))
        self.methods = [m for m in (RENDER, OURS, BEAUTY, PEER) if any(row["method"] == m for row in rows)]

    def of(self, case: str, method: str) -> list[dict[str, str]]:
        return [row for row in self.rows if row["case"] == case and row["method"] == method]

    def error(self, case: str, method: str) -> float:
        found = self.of(case, method)
        return geometric_mean([float(row["rel_mse"]) for row in found]) if found else float("nan")

    def non_finite(self, case: str, method: str) -> int:
        return sum(int(row["non_finite"]) for row in self.of(case, method))

    def cell(self, case: str, method: str) -> str:
        error, bad = self.error(case, method), self.non_finite(case, method)
        if error != error:
            return ""
        return (f"{error:.3g}" if error < 1000 else f"{error:.0e}").replace("e+", "e") + (
            f" ({bad} bad)" if bad else ""
        )


def plot(results: Results, path: Path) -> None:
    from bench.plots import axes, save, use_logarithm

    figure, panels = axes(width=13.0, height=3.9, columns=3)
    shades = dict(zip((RENDER, OURS, BEAUTY, PEER), ("#999999", "#0b5394", "#6fa8dc", "#b35806"), strict=True))
    kinds = (
        ("NaN", "share of NaN pixels"),
        ("fireflies", "value of one pixel in 1000"),
        ("exposure", "exposure, stops"),
    )
    for panel, (kind, label) in zip(panels, kinds, strict=True):
        for method in results.methods:
            points = [(at, results.error(case, method)) for k, case, at in results.cases if k == kind]
            panel.plot(
                *zip(*points, strict=True), "o-", color=shades[method], label=method, markersize=4, linewidth=1.2
            )
        panel.set_xlabel(label)
        if kind == "fireflies":
            panel.set_xscale("log")
            panel.set_yscale("log")
            continue
        panel.set_ylim(5e-3, 30)
        use_logarithm(panel.yaxis)
    panels[0].set_ylabel("relMSE; above the frame: more")
    panels[0].legend(fontsize=7, frameon=False)
    save(figure, path)


PROMISES = (
    (
        "every output value is finite",
        "for any input: NaN, infinities, values up to 3.4e38, denormals, any size from 1x1",
    ),
    (
        "convex",
        "each value of a filtered layer lies between the least and the greatest valid value of its channel; Combined "
        "as a sum of passes lies between sums of theirs",
    ),
    ("exact scaling", "radiance times 2^n in, the same bits times 2^n out, n from -30 to 30"),
    ("constants stay", "mean changed by less than 1e-5"),
    ("same bits", "any number of threads, tiles and memory limit, every run"),
    (
        "a bad pixel is local",
        "changes end within the halo of network and kernels (192 pixels for `balanced`) and 66 more for noise "
        "windows and the firefly test; measured with `balanced`: 142",
    ),
)

LIMITS = """What is taken from the whole image can be moved by many bad pixels, and by a single one where it stands
on the edge: the exposure (rounded to a power of two), the floor of brightness (a power of two), whether Combined is
the sum of its passes (fireflies and bad pixels do not count), and whether a layer is clean enough to be skipped: a bad
pixel in a clean layer makes the kernels work on that layer, and Combined takes it as they leave it. What is emitted
towards the camera is never taken for a firefly.

A firefly is limited to a few times (1.6 at 4 samples, 6.5 at 64) the brightest of its 24 neighbours before anything
else: one that stands in black, or beside another one, is not. Negative radiance is taken as meant: it is averaged like
any other value."""


def document(results: Results, out: Path) -> str:
    facts = results.rows[0]
    exposures = [case for kind, case, _ in results.cases if kind == "exposure"]
    exact = sum(int(row["as_good"]) for case in exposures for m in (OURS, BEAUTY) for row in results.of(case, m))
    of_all = sum(len(results.of(case, m)) for case in exposures for m in (OURS, BEAUTY))
    ours_bad = sum(results.non_finite(case, m) for _, case, _ in results.cases for m in (OURS, BEAUTY))
    text = f"""# Numerical stability

Written by `bench/stability.py` (`make stability`) from `bench/results/*-stability.csv`. Machine: {facts["machine"]},
kernels `{facts["kernels"]}`; revision {facts["revision"]}.

## What is promised

| promise | bound |
| --- | --- |
{"".join(f"| {what} | {bound} |" + chr(10) for what, bound in PROMISES)}
All of it is tested by `tests/stress`: `make stress` runs the whole grid (29 kinds of input, 20 sizes, 273 choices of
passes, 13 exposures), `make test` a short one.

{LIMITS}

## The same corrupted input, and what comes out

relMSE of Combined against two references, geometric mean of {" and ".join(results.scenes)} at {SPP} samples per pixel.
The same random pixels are bad in Combined and, for Quell with all passes, in every light pass. Open Image Denoise runs
as Blender's default, High/Accurate, with Combined and its guides. Values that are not finite count as 0, and their
pixels are given in parentheses.

"""
    text += "| input | " + " | ".join(results.methods) + " |\n| --- |" + " --- |" * len(results.methods) + "\n"
    for _, case, _ in results.cases:
        text += f"| {case} | " + " | ".join(results.cell(case, method) for method in results.methods) + " |\n"
    text += f"""
- Quell's results hold {ours_bad or "no"} values that are not finite.
- Results of scaled radiance, scaled back, have the bits of the unscaled ones in {exact} of {of_all} runs.
{verdict(results)}
![relMSE over the share of NaN, the size of fireflies and the exposure](images/stability.png)
"""
    return text


def verdict(results: Results) -> str:
    """Where each side is better, as counted; and whose error grows less, by its own error with the good input."""
    if PEER not in results.methods:
        return ""
    compared = [case for kind, case, _ in results.cases if kind != "none" and results.of(case, PEER)]
    good = results.cases[0][1]

    def growth(case: str, method: str) -> float:
        return results.error(case, method) / results.error(good, method)

    better = [case for case in compared if results.error(case, BEAUTY) < results.error(case, PEER)]
    grows_more = [case for case in compared if growth(case, BEAUTY) > 1.05 * growth(case, PEER)]
    return (
        f"- With the same layers, Quell's error is below the peer's for {len(better)} of {len(compared)} inputs; "
        f"as rendered it is {results.error(good, BEAUTY) / results.error(good, PEER):.2g} times as large.\n"
        f"- Taken by its own error as rendered, Quell's grows by no more than Open Image Denoise's (5 % allowed) for "
        f"{len(compared) - len(grows_more)} of them. It grows more with: {'; '.join(grows_more) or 'none'}.\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "release")
    parser.add_argument("--scenes", default="house,living_room")
    parser.add_argument("--results", type=Path, default=ROOT / "bench" / "results")
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    parser.add_argument("--kinds", default="", help="measure these again: NaN, fireflies, ...; comma-separated")
    parser.add_argument("--only-write", action="store_true", help="the document, from the CSV that is there")
    args = parser.parse_args()
    os.environ.setdefault("QUELL_LIBRARY", str(args.build.resolve() / "lib" / "libquell.so"))
    if args.only_write:
        path = next(args.results.glob("*-stability.csv"))
    else:
        kinds = set(filter(None, args.kinds.split(",")))
        rows = measure(args.scenes.split(","), kinds, importlib.util.find_spec("pyoidn") is not None)
        path = args.results / f"{slug(rows[0]['machine'], rows[0]['kernels'])}-stability.csv"
        if kinds:
            again = {(row["scene"], row["case"], row["method"]): row for row in rows}
            rows = [again.get((row["scene"], row["case"], row["method"]), row) for row in read_csv(path)]
        write_csv(path, rows)
    results = Results(read_csv(path))
    plot(results, args.out / "images" / "stability.png")
    (args.out / "stability.md").write_text(document(results, args.out))
    print(args.out / "stability.md")


if __name__ == "__main__":
    main()
