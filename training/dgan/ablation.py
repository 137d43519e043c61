# SPDX-License-Identifier: Apache-2.0
"""Measures DGAN-KPN's parts on the samples at 4 spp and writes the tables and the picture of docs/ablation.md.

    python -m training.dgan.ablation --quell build/release/bin/quell

`make ablation` does that. Runs of training/dgan/runs.py that are not there are named below their table. Errors are
those of `quell compare` with two references; time is CPU time per megapixel on one thread, over a 512x512 frame; memory
is the report's peak.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from bench.pictures import read_passes
from training import peer
from training.data.pack import INPUT, NUM_INPUT
from training.dgan.export import export, load_run, round_to_half
from training.dgan.kpcn import Kpcn, split_light
from training.dgan.train import config_from_json, read_checkpoint
from training.paths import state_root
from training.train import run_folder

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "ablation.md"
PICTURE = ROOT / "docs" / "images" / "ablation.jpg"
SPP = 4
TIMED_SIZE = 512
#: Name in the table -> run whose weights it has, switches of the tool.
VARIANTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "both, 1 iteration": ("dgan/joint", ("--iterations", "1")),
    "both, 2 iterations": ("dgan/joint", ("--iterations", "2")),
    "both, 4 iterations (published)": ("dgan/joint", ()),
    "both, 8 iterations": ("dgan/joint", ("--iterations", "8")),
    "both, network again, 2": ("dgan/joint", ("--iterate", "network", "--iterations", "2", "--run-all-iterations")),
    "both, network again, 4": ("dgan/joint", ("--iterate", "network", "--run-all-iterations")),
    "both, network again, 4, GMSD stop": ("dgan/joint", ("--iterate", "network")),
    "KPN alone, 1 iteration": ("dgan/kpn", ("--kpn-only", "--iterations", "1")),
    "KPN alone, 2 iterations": ("dgan/kpn", ("--kpn-only", "--iterations", "2")),
    "KPN alone, 4 iterations": ("dgan/kpn", ("--kpn-only",)),
    "KPN alone, 8 iterations": ("dgan/kpn", ("--kpn-only", "--iterations", "8")),
    "DGAN alone": ("dgan/generator", ("--dgan-only",)),
    "phase 1 networks joined untrained": ("phase-1", ()),
}
SHORT_VARIANTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "all three losses": ("dgan/short", ()),
    "without tone loss": ("dgan/short-no-tone", ()),
    "without GAN loss": ("dgan/short-no-gan", ()),
    "DGAN alone, eq. 6 and eq. 9": ("dgan/generator-short", ("--dgan-only",)),
    "DGAN alone, eq. 6": ("dgan/generator-eq6", ("--dgan-only",)),
}
#: Columns of the picture.
SHOWN = (
    "noisy",
    "DGAN alone",
    "KPN alone, 4 iterations",
    "both, 4 iterations (published)",
    "KPCN",
    "OIDN high/accurate",
)
SHOWN_SCENES = ("still_life", "misty_hall", "bathroom")


@dataclass(frozen=True)
class Sample:
    scene: str
    noisy: Path
    references: tuple[Path, Path]


@dataclass
class Score:
    """One method; errors by scene."""

    name: str
    errors: dict[str, dict[str, float]] = field(default_factory=dict)
    seconds_per_megapixel: float = math.nan
    peak_megabytes: float = math.nan
    iterations: float = math.nan  # that were run, mean over the samples

    def geometric(self, key: str) -> float:
        return math.exp(float(np.mean([math.log(max(e[key], 1e-8)) for e in self.errors.values()])))

    def mean(self, key: str) -> float:
        return float(np.mean([e[key] for e in self.errors.values()]))

    def worst(self, key: str) -> float:
        return max(e[key] for e in self.errors.values())


def samples() -> list[Sample]:
    found = []
    for path in sorted((ROOT / "samples").glob(f"*/*_{SPP}spp.exr")):
        base = path.name.removesuffix(f"_{SPP}spp.exr")
        found.append(Sample(base, path, (path.with_name(f"{base}_ref_a.exr"), path.with_name(f"{base}_ref_b.exr"))))
    return found


def write_combined(path: Path, image: np.ndarray) -> None:
    """[h,w,3] as a layer that `quell compare` finds."""
    import OpenEXR

    planes = {f"ViewLayer.Combined.{c}": np.ascontiguousarray(image[..., i], np.float32) for i, c in enumerate("RGB")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(path))


class Bench:
    """The tool, a folder for what it writes, and the weight files of the runs."""

    def __init__(self, quell: Path, folder: Path) -> None:
        self.quell, self.folder = quell, folder
        folder.mkdir(parents=True, exist_ok=True)
        self.samples = samples()

    def run(self, *command: object) -> tuple[str, float]:
        """Standard output and CPU seconds."""
        process = subprocess.Popen([str(c) for c in (self.quell, *command)], stdout=subprocess.PIPE, text=True)
        text = process.stdout.read() if process.stdout else ""
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            raise SystemExit(f"{self.quell} failed with {process.returncode}")
        return text, usage.ru_utime + usage.ru_stime

    def weights(self, run: str) -> Path:
        """The run's weight file; "phase-1" joins the two networks of phase 1 as they are."""
        path = self.folder / f"{run.replace('/', '-')}.qwt"
        model, step = load_run("dgan/kpn" if run == "phase-1" else run)
        if run == "phase-1":
            model.generator.load_state_dict(load_run("dgan/generator")[0].generator.state_dict())
        export(round_to_half(model), path, run, f"{step} steps")
        return path

    def compare(self, image: Path, sample: Sample) -> dict[str, float]:
        text, _ = self.run("compare", "--json", "-l", "Combined", image, *sample.references)
        layer = json.loads(text)["layers"][0]
        return {key: float(layer[key]) for key in ("rel_mse", "psnr", "ssim")}

    def folder_of(self, name: str) -> Path:
        """Where the results of a method lie."""
        folder = self.folder / "".join(c if c.isalnum() else "-" for c in name)
        folder.mkdir(exist_ok=True)
        return folder

    def score_folder(self, name: str, folder: Path) -> Score:
        return Score(name, {s.scene: self.compare(folder / s.noisy.name, s) for s in self.samples})

    def score_tool(self, name: str, *switches: object, timed: bool = True) -> Score:
        """Denoises every sample with the tool."""
        out = self.folder_of(name)
        report = self.folder / "report.json"
        inputs = [s.noisy for s in self.samples]
        self.run("denoise", *inputs, "-o", out, "--overwrite", "-q", "--report", report, *switches)
        score = self.score_folder(name, out)
        files = json.loads(report.read_text())["files"]
        score.iterations = float(np.mean([file["summary"].get("iterations", math.nan) for file in files]))
        if timed:
            common = ("-o", self.folder / "timed_out.exr", "-q", "--threads", "1", *switches)
            _, start = self.run("denoise", self.timed_frame(8), *common)  # what starting and loading cost
            _, seconds = self.run("denoise", self.timed_frame(), *common, "--report", report)
            summary = json.loads(report.read_text())["files"][0]["summary"]
            score.seconds_per_megapixel = (seconds - start) / (TIMED_SIZE**2 / 1e6)
            score.peak_megabytes = float(summary["peak_bytes"]) / 1e6
        return score

    def timed_frame(self, size: int = TIMED_SIZE) -> Path:
        """A frame of one colour pass and guides, a sample repeated."""
        path = self.folder / f"timed_{size}.exr"
        if not path.exists():
            import OpenEXR

            passes = read_passes(next(s for s in self.samples if s.scene == "still_life").noisy)
            planes = {}
            for name, letters in (("Combined", "RGB"), ("Denoising Albedo", "RGB"), ("Denoising Normal", "XYZ")):
                tiled = np.tile(passes[name], (4, 4, 1))[:size, :size]
                planes |= {f"ViewLayer.{name}.{c}": np.ascontiguousarray(tiled[..., i]) for i, c in enumerate(letters)}
            header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, planes).write(str(path))
        return path


def kpcn_passes(path: Path) -> torch.Tensor:
    """INPUT's channels [1,47,h,w] of a file; light passes are zeros where it has none."""
    found = read_passes(path)
    height, width = found["Combined"].shape[:2]
    x = np.zeros((NUM_INPUT, height, width), np.float32)

    def put(key: str, offset: int, name: str, channels: int = 3) -> None:
        if name in found:
            start = INPUT[key].start + offset
            x[start : start + channels] = found[name][..., :channels].transpose(2, 0, 1)

    put("beauty", 0, "Combined")
    for i, name in enumerate(("DiffDir", "DiffInd", "GlossDir", "GlossInd", "TransDir", "TransInd")):
        put("light", 3 * i, name)
    for i, name in enumerate(("DiffCol", "GlossCol", "TransCol")):
        put("color", 3 * i, name)
    put("albedo", 0, "Denoising Albedo")
    put("normal", 0, "Denoising Normal")
    put("depth", 0, "Denoising Depth", 1)
    return torch.from_numpy(np.nan_to_num(x, posinf=65504.0))[None]


def score_kpcn(bench: Bench) -> Score:
    config = config_from_json(json.loads((run_folder("dgan/kpcn") / "config.json").read_text())["config"])
    model = Kpcn(config.kpcn).eval()
    model.load_state_dict(read_checkpoint("dgan/kpcn")["model"])
    out = bench.folder_of("KPCN")
    seconds, pixels = 0.0, 0
    for sample in bench.samples:
        passes = kpcn_passes(sample.noisy)
        start = os.times()
        with torch.no_grad():
            image = model(split_light(passes))[2]
        end = os.times()
        seconds += end.user + end.system - start.user - start.system
        pixels += image.shape[-1] * image.shape[-2]
        write_combined(out / sample.noisy.name, image[0].permute(1, 2, 0).numpy())
    score = bench.score_folder("KPCN", out)
    score.seconds_per_megapixel = seconds / (pixels / 1e6)
    return score


def score_peer(bench: Bench, setting: str) -> Score:
    name = f"OIDN {setting}"
    out = bench.folder_of(name)
    for sample in bench.samples:
        found = read_passes(sample.noisy)
        image = peer.denoise(found["Combined"][..., :3], found["Denoising Albedo"], found["Denoising Normal"], setting)
        write_combined(out / sample.noisy.name, image)
    return bench.score_folder(name, out)


def shown(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"


def table(scores: Sequence[Score]) -> str:
    head = ("method", "relMSE, geometric mean", "worst", "PSNR dB", "SSIM", "iterations", "CPU s per megapixel", "MB")
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " --- |" * (len(head) - 1)]
    for s in scores:
        cells = (
            s.name,
            f"{s.geometric('rel_mse'):.4f}",
            f"{s.worst('rel_mse'):.3f}",
            f"{s.mean('psnr'):.2f}",
            f"{s.mean('ssim'):.4f}",
            shown(s.iterations, 1),
            shown(s.seconds_per_megapixel, 2),
            shown(s.peak_megabytes, 0),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def scene_table(scores: Sequence[Score]) -> str:
    scenes = sorted(scores[0].errors)
    lines = ["| PSNR dB / SSIM | " + " | ".join(scenes) + " |", "| --- |" + " --- |" * len(scenes)]
    for s in scores:
        cells = [f"{s.errors[scene]['psnr']:.2f} / {s.errors[scene]['ssim']:.3f}" for scene in scenes]
        lines.append(f"| {s.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def training_table() -> str:
    """Steps and crops of every run, from what the runs recorded."""
    lines = ["| run | steps | crop | frames | first rate |", "| --- | --- | --- | --- | --- |"]
    names = {run for run, _ in (*VARIANTS.values(), *SHORT_VARIANTS.values()) if run != "phase-1"} | {"dgan/kpcn"}
    for name in sorted(filter(is_trained, names)):
        saved = json.loads((run_folder(name) / "config.json").read_text())
        config, step = saved["config"], read_checkpoint(name)["step"]
        crop = config["data"]["crop"]
        lines.append(f"| {name} | {step} | {crop}x{crop} | {saved['frames']} | {config['rate']:g} |")
    return "\n".join(lines)


def replace_section(text: str, name: str, content: str) -> str:
    begin, end = f"<!-- {name}: made by make ablation -->\n", f"<!-- end of {name} -->"
    head, _, rest = text.partition(begin)
    if not rest:
        raise SystemExit(f"{DOCUMENT} has no section '{name}'")
    return head + begin + content + "\n" + end + rest.partition(end)[2]


def picture(bench: Bench) -> None:
    """Rows of scenes, columns of SHOWN and the reference, after z / (1 + z) and a gamma of 2.2."""
    from PIL import Image

    def pixels(path: Path) -> np.ndarray:
        z = np.maximum(read_passes(path)["Combined"][..., :3], 0)
        return (255 * (z / (1 + z)) ** (1 / 2.2) + 0.5).astype(np.uint8)

    rows = []
    for scene in SHOWN_SCENES:
        sample = next(s for s in bench.samples if s.scene == scene)
        row = []
        for name in filter(lambda n: n == "noisy" or any(bench.folder_of(n).iterdir()), SHOWN):
            row.append(pixels(sample.noisy if name == "noisy" else bench.folder_of(name) / sample.noisy.name))
        row.append(pixels(sample.references[0]))
        rows.append(np.concatenate([r[:144, :192] for r in row], axis=1))
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows)).save(PICTURE, quality=90)


def is_trained(run: str) -> bool:
    return run == "phase-1" or (run_folder(run) / "checkpoint.pt").exists()


def score_variants(bench: Bench, variants: dict[str, tuple[str, tuple[str, ...]]], timed: bool) -> list[Score]:
    return [
        bench.score_tool(name, "--model", bench.weights(run), *switches, timed=timed)
        for name, (run, switches) in variants.items()
        if is_trained(run)
    ]


def with_missing(content: str, runs: Sequence[str]) -> str:
    """A table, and a line about the runs that it lacks."""
    missing = sorted({run for run in runs if not is_trained(run)})
    return content + (f"\n\nNot trained yet: {', '.join(missing)}." if missing else "")


def measure_parts(bench: Bench) -> dict[str, str]:
    """The tables of parts and of scenes; makes the picture too."""
    noisy = Score("noisy input", {s.scene: bench.compare(s.noisy, s) for s in bench.samples})
    parts = score_variants(bench, VARIANTS, timed=True)
    kpcn = [score_kpcn(bench)] if is_trained("dgan/kpcn") else []
    peers = [score_peer(bench, setting) for setting in ("fast/fast", "high/accurate")]
    own = bench.score_tool("quell, all passes", timed=False)
    by_scene = [noisy, *(s for s in parts if s.name in SHOWN), *kpcn, peers[-1]]
    picture(bench)
    runs = [*(run for run, _ in VARIANTS.values()), "dgan/kpcn"]
    return {
        "parts": with_missing(table([noisy, *parts, *kpcn, *peers, own]), runs),
        "scenes": scene_table(by_scene),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quell", type=Path, required=True)
    parser.add_argument("--losses", action="store_true", help="only the tables of losses and of trainings")
    args = parser.parse_args()
    bench = Bench(args.quell.resolve(), state_root() / "ablation")
    short = score_variants(bench, SHORT_VARIANTS, timed=False)
    sections = {
        "losses": with_missing(table(short), [run for run, _ in SHORT_VARIANTS.values()]),
        "trainings": training_table(),
    }
    if not args.losses:
        sections |= measure_parts(bench)
    text = DOCUMENT.read_text()
    for name, content in sections.items():
        text = replace_section(text, name, content)
    DOCUMENT.write_text(text)


if __name__ == "__main__":
    main()
