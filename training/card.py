# SPDX-License-Identifier: Apache-2.0
"""Model cards: what each weight file was trained on, how well it does, where it fails.

    python -m training.card add --weights weights/quell-balanced.qwt --run NAME --evaluation evaluation/summary.csv \\
        --limits "What it does badly, in a sentence or two."
    python -m training.card write                    # weights/README.md from all cards

`add` writes weights/NAME.json; what is not given stays as it is there. `write` refuses a card whose SHA-256 is not that
of its weight file, so that a card never speaks of another file.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from training.data.store import write_atomic
from training.export import KIND, load_weights, read_weights
from training.models.quell import multiply_adds_range
from training.runlog import hours, read_log
from training.train import config_from_json, run_folder

#: Methods of the evaluation that a card quotes beside its own model.
PEERS = ("noisy", "OIDN fast/fast", "OIDN high/fast", "OIDN high/accurate")
INTENDED = (
    "renders of Cycles at 1 to 64 samples per pixel: Combined, the light passes and the denoising data, or any part of "
    "them down to Combined alone"
)
LICENCE = (
    "Apache-2.0, as the code. The training scenes are made by our own generators, with furniture of CC0 and CC-BY 3.0 "
    "models (Debian's sweethome3d-furniture) and the CC0 environment pictures that Blender ships; no model and no "
    "picture is in the file"
)


class CardError(Exception):
    """A card that cannot be written as asked."""


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def describe_weights(path: Path) -> dict[str, Any]:
    """What the file itself says."""
    values = read_weights(path)
    facts: dict[str, Any] = {
        "file": path.name,
        "bytes": path.stat().st_size,
        "sha256": sha256(path),
        "kind": values["meta.kind"],
        "description": values["meta.description"],
    }
    if values["meta.kind"] == KIND:
        model = load_weights(path)
        config = model.net.config
        facts |= {
            "parameters": sum(p.numel() for p in model.parameters()),
            "widths": list(config.widths),
            "multiply_adds": [round(macs) for macs in multiply_adds_range(config)],
        }
    return facts


def describe_run(name: str) -> dict[str, Any]:
    """What the run's folder says: data, steps, hours."""
    folder = run_folder(name)
    saved = json.loads((folder / "config.json").read_text())
    config = config_from_json(saved["config"])
    facts: dict[str, Any] = {
        "run": name,
        "revision": saved["git"],
        "device": saved.get("device", "CPU"),
        "steps": torch.load(folder / "checkpoint.pt", weights_only=True, map_location="cpu")["step"],
        "batch": config.crops.batch,
        "crop": config.crops.crop,
    }
    points = read_log(folder / "log.csv") if (folder / "log.csv").exists() else []
    if points:
        facts |= {"hours": round(hours(points), 2), "frames": points[-1].frames}
    journal = folder / "frames.json"
    if journal.exists():
        frames: dict[str, int] = {}
        for entry in json.loads(journal.read_text()):
            if entry["step"] <= facts["steps"]:
                frames |= entry["frames"]
        # FAMILY-SEED_CAMERA
        scenes = {name.rpartition("_")[0] for name in frames}
        facts |= {
            "frames": len(frames),
            "scenes": len(scenes),
            "families": len({scene.rpartition("-")[0] for scene in scenes}),
            "samples_per_pixel": sorted(set(frames.values())),
        }
    return facts


def read_scores(path: Path, model: str) -> list[dict[str, Any]]:
    """Combined's error of the model and its peers from the evaluation's summary.csv."""
    scores = []
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            own = row["method"] in (model, f"{model}, Combined alone")
            if row["layer"] == "Combined" and (own or row["method"] in PEERS):
                line = {key: row[key] for key in ("method", "worst_frame") if key in row}
                line |= {key: int(row[key]) for key in ("spp", "frames")}
                line |= {key: float(row[key]) for key in ("rel_mse", "worst")}
                scores.append(line)
    if not any(score["method"] == model for score in scores):
        raise CardError(f"{path}: no scores of {model}")
    return scores


def add_card(weights: Path, run: str | None, evaluation: Path | None, limits: str | None) -> Path:
    """Writes the card of one weight file; facts that are not given are taken over from the card that is there."""
    path = weights.with_suffix(".json")
    card = json.loads(path.read_text()) if path.exists() else {}
    new = describe_weights(weights)
    if card and card["sha256"] != new["sha256"] and not (run and evaluation):
        raise CardError(f"{weights} is not the file that {path} is of: give --run and --evaluation for the new one")
    card |= new
    if run:
        card["training"] = describe_run(run)
    if evaluation:
        card["scores"] = read_scores(evaluation, weights.stem)
    if limits:
        card["limits"] = limits
    write_atomic(path, (json.dumps(card, indent=1) + "\n").encode())
    return path


def training_text(facts: dict[str, Any]) -> str:
    """One paragraph on data and time."""
    frames = f"{facts['frames']} frames" if "frames" in facts else "frames"
    if "scenes" in facts:
        frames += f" of {facts['scenes']} scenes of {facts['families']} families"
    if "samples_per_pixel" in facts:
        frames += f", {' or '.join(map(str, facts['samples_per_pixel']))} samples per pixel in all each"
    text = f"{frames}; {facts['steps']:,} steps of {facts['batch']} crops of {facts['crop']}x{facts['crop']}"
    if "hours" in facts:
        text += f", {facts['hours']:g} hours"
    return f"{text} on {facts['device']}; run `{facts['run']}`, sources of `{facts['revision'][:12]}`."


def scores_text(scores: list[dict[str, Any]]) -> list[str]:
    """A table, methods by sample counts."""
    counts = sorted({score["spp"] for score in scores})
    lines = ["| relMSE of Combined | " + " | ".join(f"{spp} spp (worst frame)" for spp in counts) + " |"]
    lines.append("| --- |" + " --- |" * len(counts))
    for method in dict.fromkeys(score["method"] for score in scores):
        cells = {s["spp"]: f"{s['rel_mse']:.5f} ({s['worst']:.4f})" for s in scores if s["method"] == method}
        lines.append(f"| {method} | " + " | ".join(cells.get(spp, "") for spp in counts) + " |")
    return [*lines, "", f"Geometric mean over {scores[0]['frames']} frames of families that were not trained on."]


def card_text(card: dict[str, Any]) -> list[str]:
    """One weight file's section."""
    lines = [f"## {card['file']}", "", f"{card['description'].capitalize()}.", ""]
    lines += ["| | |", "| --- | --- |", f"| kind | `{card['kind']}` |", f"| size | {card['bytes']:,} bytes |"]
    if "parameters" in card:
        one, all_ = card["multiply_adds"]
        lines.append(
            f"| parameters | {card['parameters']:,}, as half floats; widths {', '.join(map(str, card['widths']))} |"
        )
        lines.append(f"| multiply-adds per pixel | {one:,} for Combined alone, {all_:,} for all passes |")
    lines += [f"| SHA-256 | `{card['sha256']}` |", ""]
    if "training" in card:
        lines += [f"**Trained on** {training_text(card['training'])}", ""]
    if "scores" in card:
        lines += [*scores_text(card["scores"]), ""]
    lines += [f"**Meant for** {card.get('intended', INTENDED)}.", ""]
    if "limits" in card:
        lines += [f"**Limits.** {card['limits']}", ""]
    return [*lines, f"**Licence.** {card.get('licence', LICENCE)}.", ""]


def write_readme(folder: Path) -> Path:
    """All cards of a folder as its README.md."""
    lines = [
        "# Weights",
        "",
        "Written by `python -m training.card write` from the `.json` beside each file. The format of the files is in",
        "[docs/FORMATS.md](../docs/FORMATS.md), how to make them again in [training/README.md](../training/README.md),",
        "what was tried in [training/experiments.md](../training/experiments.md).",
        "",
    ]
    weights = sorted(folder.glob("*.qwt"))
    for path in weights:
        card_path = path.with_suffix(".json")
        if not card_path.exists():
            raise CardError(f"{path} has no card: python -m training.card add --weights {path} ...")
        card = json.loads(card_path.read_text())
        if card["sha256"] != sha256(path):
            raise CardError(f"{card_path} is of another file than {path}: add the card again")
        lines += card_text(card)
    readme = folder / "README.md"
    write_atomic(readme, "\n".join(lines).encode())
    return readme


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    add = commands.add_parser("add", help="write or renew the card of one weight file")
    add.add_argument("--weights", type=Path, required=True)
    add.add_argument("--run", help="the run that it was exported from")
    add.add_argument("--evaluation", type=Path, help="summary.csv of training.evaluate, with --model WEIGHTS")
    add.add_argument("--limits", help="what it does badly")
    write = commands.add_parser("write", help="weights/README.md from all cards")
    write.add_argument("--folder", type=Path, default=Path("weights"))
    args = parser.parse_args(argv)
    try:
        if args.command == "add":
            print(add_card(args.weights, args.run, args.evaluation, args.limits))
        else:
            print(write_readme(args.folder))
    except CardError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
