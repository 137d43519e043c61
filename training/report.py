# SPDX-License-Identifier: Apache-2.0
"""Scores as CSV, tables, plots of error against time, and pictures of the worst frames."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from training.measure import Scores, display, geometric_mean
from training.pairs import Pair

_CROP = 64
_ZOOM = 3
_SHOWN = ("noisy", "OIDN high/accurate")


@dataclass(frozen=True)
class Row:
    """Scores of one layer of one frame by one method; CPU seconds (all threads) are those of the whole call."""

    frame: str
    spp: int
    method: str
    layer: str
    scores: Scores
    cpu_seconds_per_megapixel: float


@dataclass(frozen=True)
class Summary:
    """One method on one layer at one sample count, over all frames: relMSE as geometric mean, the rest as mean."""

    spp: int
    layer: str
    method: str
    frames: int
    rel_mse: float
    worst: float
    worst_frame: str
    psnr: float
    ssim: float
    gmsd: float
    flip: float
    cpu_seconds_per_megapixel: float


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write every score."""
    names = [f.name for f in fields(Scores)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "spp", "method", "layer", *names, "cpu_seconds_per_megapixel"])
        for row in rows:
            values = [f"{v:.6g}" for v in (*astuple(row.scores), row.cpu_seconds_per_megapixel)]
            writer.writerow([row.frame, row.spp, row.method, row.layer, *values])


def summarise(rows: Sequence[Row]) -> list[Summary]:
    """Return one summary per sample count, layer and method, in the order they were met, Combined first."""
    groups: dict[tuple[int, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.spp, row.layer, row.method), []).append(row)
    out = []
    for (spp, layer, method), members in groups.items():
        worst = max(members, key=lambda r: r.scores.rel_mse)

        def mean(name: str, members: list[Row] = members) -> float:
            return float(np.mean([getattr(r.scores, name) for r in members]))

        out.append(
            Summary(
                spp,
                layer,
                method,
                len(members),
                geometric_mean(r.scores.rel_mse for r in members),
                worst.scores.rel_mse,
                worst.frame,
                mean("psnr"),
                mean("ssim"),
                mean("gmsd"),
                mean("flip"),
                float(np.mean([r.cpu_seconds_per_megapixel for r in members])),
            )
        )
    return sorted(out, key=lambda s: (s.spp, s.layer != "Combined", s.layer))


def write_summary(path: Path, summary: Sequence[Summary]) -> None:
    """Write the summaries."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f.name for f in fields(Summary)])
        for line in summary:
            writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in astuple(line)])


def table(summary: Sequence[Summary]) -> str:
    """Return the summaries of Combined, and relMSE of the other layers, as text."""
    lines = []
    for line in summary:
        if line.layer == "Combined":
            lines.append(
                f"{line.spp:4d} spp  {line.method:34s} relMSE {line.rel_mse:.5f}  worst {line.worst:.5f}"
                f"  PSNR {line.psnr:5.2f}  SSIM {line.ssim:.4f}  GMSD {line.gmsd:.4f}  FLIP {line.flip:.4f}"
                f"  {line.cpu_seconds_per_megapixel:6.2f} CPU s/MP  ({line.frames} frames)"
            )
        else:
            lines.append(
                f"{line.spp:4d} spp  {line.method:34s} relMSE {line.rel_mse:.5f}  {line.layer} ({line.frames} frames)"
            )
    return "\n".join(lines)


def plot_error_against_time(path: Path, summary: Sequence[Summary]) -> None:
    """Plot relMSE of Combined against CPU seconds per megapixel, one panel per sample count."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    combined = [s for s in summary if s.layer == "Combined"]
    counts = sorted({s.spp for s in combined})
    figure, panels = pyplot.subplots(1, len(counts), figsize=(5 * len(counts), 4.2), squeeze=False)
    for panel, spp in zip(panels[0], counts, strict=True):
        lines = [s for s in combined if s.spp == spp]
        for line in lines:
            if line.method == "noisy":
                panel.axhline(line.rel_mse, color="grey", linestyle=":", label="noisy")
            else:
                panel.plot(line.cpu_seconds_per_megapixel, line.rel_mse, "o", label=line.method)
        panel.set(xscale="log", yscale="log", xlabel="CPU s per megapixel", title=f"{spp} spp")
    panels[0][0].set_ylabel("relMSE of Combined, geometric mean")
    panels[0][-1].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


class Gallery:
    """Keeps the images that pictures of the worst frames are made of."""

    def __init__(self, pairs: Sequence[Pair], subject: str) -> None:
        """subject: the method whose errors decide which frames are worst."""
        self._pairs = {(pair.name, pair.spp): pair for pair in pairs}
        self._subject = subject
        self._images: dict[tuple[str, int, str], np.ndarray] = {}
        self._errors: dict[tuple[str, int], float] = {}

    def keep(self, row: Row, image: np.ndarray) -> None:
        """Remember an image of Combined if a picture may show it."""
        if row.layer == "Combined" and row.method in (self._subject, *_SHOWN):
            self._images[row.frame, row.spp, row.method] = image
            if row.method == self._subject:
                self._errors[row.frame, row.spp] = row.scores.rel_mse

    def write_worst(self, path: Path, spp: int, count: int) -> None:
        """Write one row per frame, worst first: the methods and the reference, above them the crop of most error."""
        frames = sorted((f for f in self._errors if f[1] == spp), key=lambda f: -self._errors[f])[:count]
        strips = [self._strip(frame) for frame in frames]
        if not strips:
            return
        sheet = Image.new("RGB", (max(s.width for s in strips), sum(s.height for s in strips)))
        top = 0
        for strip in strips:
            sheet.paste(strip, (0, top))
            top += strip.height
        sheet.save(path)

    def _strip(self, frame: tuple[str, int]) -> Image.Image:
        pair = self._pairs[frame]
        reference = 0.5 * (pair.reference_a["Combined"] + pair.reference_b["Combined"])[..., :3]
        order = dict.fromkeys(("noisy", self._subject, *_SHOWN))
        shown = {m: self._images[*frame, m] for m in order if (*frame, m) in self._images} | {"reference": reference}
        y, x = worst_window(shown[self._subject], reference, _CROP)
        side = _CROP * _ZOOM
        height, width = reference.shape[:2]
        low = round(side * min(1.0, height / width))
        strip = Image.new("RGB", (side * len(shown), side + low + 14))
        draw = ImageDraw.Draw(strip)
        for index, (method, image) in enumerate(shown.items()):
            whole = picture(image)
            whole.thumbnail((side, side), Image.Resampling.BOX)
            crop = picture(image[y : y + _CROP, x : x + _CROP]).resize((side, side), Image.Resampling.NEAREST)
            strip.paste(crop, (index * side, 14))
            strip.paste(whole, (index * side, side + 14))
            text = method if index else f"{pair.name} {pair.spp} spp {self._errors[frame]:.4f}"
            draw.text((index * side + 2, 1), text, fill=(255, 255, 255))
        return strip


def picture(pixels: np.ndarray) -> Image.Image:
    """Return scene light as it would be seen."""
    return Image.fromarray((display(pixels[..., :3]) * 255 + 0.5).astype(np.uint8))


def worst_window(image: np.ndarray, reference: np.ndarray, size: int) -> tuple[int, int]:
    """Return (y, x) of the window with the largest relative squared error."""
    error = ((image - reference) ** 2 / (reference**2 + 0.01)).mean(-1)
    size = min(size, *error.shape)
    total = np.pad(error, ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    windows = total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
    y, x = np.unravel_index(int(windows.argmax()), windows.shape)
    return int(y), int(x)
