# SPDX-License-Identifier: Apache-2.0
"""What the CSVs of one machine say: medians found again by method, means over the samples, and what follows of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from bench.common import read_csv
from bench.errors import geometric_mean

Row = dict[str, str]


def is_ours(method: str) -> bool:
    return not method.startswith("OIDN")


def own_colors(methods: Sequence[str], ours: Sequence[str], peers: Sequence[str]) -> dict[str, str]:
    own = [m for m in methods if is_ours(m)]
    other = [m for m in methods if not is_ours(m)]
    return {m: ours[i % len(ours)] for i, m in enumerate(own)} | {m: peers[i % len(peers)] for i, m in enumerate(other)}


@dataclass(frozen=True)
class Results:
    """Sections by name, each a list of rows; a section that was not measured is empty."""

    sections: dict[str, list[Row]] = field(repr=False)

    @staticmethod
    def read(folder: Path, machine: str) -> Results:
        """machine: the first part of the file names, before "-error.csv" and so on."""
        found = {p.stem.removeprefix(f"{machine}-"): read_csv(p) for p in sorted(folder.glob(f"{machine}-*.csv"))}
        return Results(found)

    def rows(self, section: str) -> list[Row]:
        return self.sections.get(section, [])

    @property
    def facts(self) -> Row:
        return next(rows for rows in self.sections.values() if rows)[0]

    @cached_property
    def methods(self) -> list[str]:
        """In the order of the CSVs: ours first."""
        names = [row["method"] for row in (*self.rows("time"), *self.rows("error")) if row["method"] != "noisy"]
        return list(dict.fromkeys(names))

    # ---- Error and time

    @cached_property
    def spps(self) -> list[int]:
        return sorted({int(row["spp"]) for row in self.rows("error")})

    @property
    def scenes(self) -> list[str]:
        return list(dict.fromkeys(row["scene"] for row in self.rows("error")))

    def values(self, method: str, spp: int, measure: str) -> dict[str, float]:
        return {
            row["scene"]: float(row[measure])
            for row in self.rows("error")
            if row["method"] == method and int(row["spp"]) == spp
        }

    def error(self, method: str, spp: int, measure: str = "rel_mse") -> float | None:
        """Over all samples: the geometric mean of relMSE, the mean of others. None where the method lacks a sample."""
        values = list(self.values(method, spp, measure).values())
        if len(values) < len(self.scenes):
            return None
        return geometric_mean(values) if measure == "rel_mse" else sum(values) / len(values)

    def error_on(self, scenes: Sequence[str], method: str, spp: int) -> float | None:
        """Geometric mean of relMSE over some scenes."""
        values = self.values(method, spp, "rel_mse")
        return geometric_mean([values[s] for s in scenes]) if all(s in values for s in scenes) else None

    def worth(self, method: str, spp: int) -> float:
        """Samples per pixel that the noisy render would need for the method's error: its error falls as 1 / samples."""
        ratios = []
        for scene, error in self.values(method, spp, "rel_mse").items():
            ratios.append(spp * self.values("noisy", spp, "rel_mse")[scene] / max(error, 1e-9))
        return geometric_mean(ratios)

    def render_seconds(self, spp: int) -> float:
        """Mean seconds that a further sample per pixel of the scenes takes, for a picture of the timed size."""
        width, height = self.timed_pixels
        rates = {}
        for row in self.rows("error"):
            if int(row["spp"]) == spp:
                pixels = int(row["width"]) * int(row["height"])
                rates[row["scene"]] = float(row["render_s"]) / spp / pixels * width * height
        return sum(rates.values()) / len(rates)

    @property
    def threads(self) -> int:
        return max(int(row["threads"]) for rows in self.sections.values() for row in rows if "threads" in row)

    @property
    def timed_pixels(self) -> tuple[int, int]:
        row = self.rows("time")[0]
        return int(row["width"]), int(row["height"])

    @property
    def timed_size(self) -> str:
        return "{}x{}".format(*self.timed_pixels)

    def timed(self, method: str, threads: int | None = None) -> Row | None:
        threads = threads or self.threads
        found = (r for r in self.rows("time") if r["method"] == method and int(r["threads"]) == threads)
        return next(found, None)

    def seconds(self, method: str, threads: int | None = None) -> float | None:
        row = self.timed(method, threads)
        return float(row["median_s"]) if row else None

    # ---- Layers, resolution, jobs

    @property
    def layers_size(self) -> str:
        row = self.rows("layers")[0]
        return f"{row['width']}x{row['height']}"

    def by_layers(self) -> dict[str, list[tuple[int, float]]]:
        found: dict[str, list[tuple[int, float]]] = {}
        for row in self.rows("layers"):
            found.setdefault(row["method"], []).append((int(row["layers"]), float(row["median_s"])))
        return found

    def by_resolution(self) -> dict[tuple[str, int], list[dict]]:
        found: dict[tuple[str, int], list[dict]] = {}
        for row in self.rows("resolution"):
            pixels = int(row["width"]) * int(row["height"])
            point = {"size": row["size"], "pixels": pixels}
            point |= {key: float(row[key]) for key in ("median_s", "working_mb")}
            found.setdefault((row["method"], int(row["layers"])), []).append(point)
        return found

    def jobs(self) -> list[dict]:
        found = []
        has_levels = len({row["quality"] for row in self.rows("job")}) > 1
        for row in self.rows("job"):
            stages = {k.removesuffix("_s"): float(v) for k, v in row.items() if k in STAGE_COLUMNS}
            stages["rest"] = max(0.0, float(row["whole_s"]) - sum(stages.values()))
            layers = int(row["layers"])
            name = f"{row['size']}, {layers} {'layer' if layers == 1 else 'layers'}"
            found.append(
                {
                    "name": f"{name}, {row['quality']}" if has_levels else name,
                    "size": row["size"],
                    "layers": layers,
                    "megapixels": int(row["width"]) * int(row["height"]) / 1e6,
                    "stages": stages,
                    "whole_s": float(row["whole_s"]),
                    "oiiotool_s": float(row["oiiotool_s"] or 0),
                    "working_mb": float(row["working_mb"]),
                    "resident_mb": float(row["resident_mb"]),
                    "output_mb": float(row["output_mb"]),
                    "copy_mb": float(row["copy_mb"] or 0),
                }
            )
        return found


STAGE_COLUMNS = {f"{s}_s" for s in ("decode", "analyse", "features", "network", "filter", "recombine", "encode")}
