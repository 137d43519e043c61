# SPDX-License-Identifier: Apache-2.0
"""What a run's log says: the learning curve as a picture, and how long it took.

python -m training.runlog --run NAME [--run OTHER] --out docs/images/learning-balanced.png
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

from training.train import run_folder


@dataclass(frozen=True)
class Point:
    """One line of log.csv: loss averaged over about fifty steps; minutes since the process began."""

    step: int
    loss: float
    rate: float
    minutes: float
    frames: int


def read_log(path: Path) -> list[Point]:
    """The log in the order of steps. After a kill steps are made again: what was made last counts."""
    points: dict[int, Point] = {}
    with path.open(newline="") as file:
        for row in csv.reader(file):
            if len(row) != 5:
                continue  # a line that a kill cut off
            point = Point(int(row[0]), *map(float, row[1:4]), int(row[4]))
            points = {step: known for step, known in points.items() if step < point.step}
            points[point.step] = point
    return list(points.values())


def hours(points: list[Point]) -> float:
    """Training time of the steps that count; minutes start again with every process."""
    total, last = 0.0, 0.0
    for point in points:
        if point.minutes < last:
            total += last
        last = point.minutes
    return (total + last) / 60


def plot(runs: dict[str, list[Point]], path: Path) -> None:
    """Loss and rate against steps, as a small PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panel = pyplot.subplots(figsize=(6.4, 3.6))
    schedule = panel.twinx()
    for name, points in runs.items():
        steps = [point.step for point in points]
        label = f"{name}, {points[0].frames} to {points[-1].frames} frames, {hours(points):.1f} hours"
        panel.plot(steps, [point.loss for point in points], label=label, linewidth=1.2)
        schedule.plot(steps, [point.rate for point in points], color="grey", linestyle=":", linewidth=0.8)
    panel.set(xlabel="step", ylabel="training loss", yscale="log")
    schedule.set_ylabel("learning rate (dotted)", color="grey")
    panel.grid(alpha=0.3, which="both")
    panel.legend(fontsize=8)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100, metadata={"Software": None})  # the same log, the same file
    pyplot.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="append", required=True)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    runs = {name: read_log(run_folder(name) / "log.csv") for name in args.run}
    for name, points in runs.items():
        if not points:
            raise SystemExit(f"{name}: its log has no lines yet")
        print(f"{name}: {points[-1].step} steps, {hours(points):.2f} hours, loss {points[-1].loss:.4f}")
    plot(runs, args.out)


if __name__ == "__main__":
    main()
