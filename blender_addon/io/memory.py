# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoises a render's passes in memory. Who holds them hands in readers and writers; nothing is written before all of
it is computed, so a failure or a cancel leaves the render as it was."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .library import Problem, already_denoised, quell, roles
from .outcome import Outcome
from .settings import ADD_PASS, KEPT_NAME, NOISY_NAME, PASS_NAME, Settings

if TYPE_CHECKING:
    import numpy as np

Progress = Callable[[float], "bool | None"]  # fraction 0..1 -> True cancels


@dataclass
class RenderPass:
    """pixels: float32 [height][width][channels], row 0 on top, any strides."""

    name: str
    num_channels: int
    read: Callable[[], np.ndarray]
    write: Callable[[np.ndarray], None]


@dataclass
class RenderLayer:
    """One view of one view layer. fill: writes the RGBA pass of that name, which is not among `passes`."""

    name: str
    view: str  # "" unless the render is stereo
    samples: int  # per pixel; 0: unknown
    is_denoised: bool  # Cycles' own denoiser ran on it
    passes: list[RenderPass]
    fill: Callable[[str, np.ndarray], None]

    @property
    def title(self) -> str:
        return f"{self.name} ({self.view})" if self.view else self.name


@dataclass
class _Result:
    """Arrays that wait to be written."""

    passes: list[tuple[RenderPass, np.ndarray]] = field(default_factory=list)
    added: list[tuple[str, np.ndarray]] = field(default_factory=list)
    noisy: np.ndarray | None = None


def denoise_layers(
    layers: list[RenderLayer],
    size: tuple[int, int],
    settings: Settings,
    progress: Progress,
    wants_before: bool = True,
) -> tuple[Outcome, np.ndarray | None]:
    """Denoises all layers and writes the result back into them.

    Returns what was done, and the first layer's noisy Combined: a copy, made only where it is wanted. Raises Problem
    where nothing can be done, and the library's errors.
    """
    outcome = Outcome()
    results: list[tuple[RenderLayer, _Result]] = []
    start = time.perf_counter()
    with quell().Context(threads=settings.threads, max_memory_bytes=settings.max_memory_bytes) as context:
        with context.open_model(settings.model, settings.quality) as model:
            outcome.add_seconds("set up", time.perf_counter() - start)
            for index, layer in enumerate(layers):
                if not _is_worth(layer, outcome):
                    continue

                def part(fraction: float, index: int = index) -> bool | None:
                    return progress((index + fraction) / len(layers))

                result = _denoise(context, model, layer, size, settings, part, outcome, wants_before and not results)
                results.append((layer, result))
    if not results:
        raise Problem(outcome.skipped[0][1] if outcome.skipped else "The render has no Combined pass.")
    start = time.perf_counter()
    for layer, result in results:
        for render_pass, pixels in result.passes:
            render_pass.write(pixels)
        for name, pixels in result.added:
            layer.fill(name, pixels)
    outcome.add_seconds("write", time.perf_counter() - start)
    return outcome, results[0][1].noisy


def _is_worth(layer: RenderLayer, outcome: Outcome) -> bool:
    names = {render_pass.name for render_pass in layer.passes}
    if layer.is_denoised and NOISY_NAME not in names:
        outcome.skipped.append((layer.title, already_denoised(layer.title)))
        return False
    return "Combined" in names


def _denoise(
    context: Any,
    model: Any,
    layer: RenderLayer,
    size: tuple[int, int],
    settings: Settings,
    progress: Progress,
    outcome: Outcome,
    wants_before: bool,
) -> _Result:
    known = roles({p.name: p.num_channels for p in layer.passes if 1 <= p.num_channels <= 4})
    named = {name.strip() for name in (settings.layers or "").split(",")}
    wanted = [
        p
        for p in layer.passes
        if known.get(p.name, "other") != "other" or p.name in named or f"{layer.name}.{p.name}" in named
    ]

    start = time.perf_counter()
    arrays = {p.name: p.read() for p in wanted}
    is_kept = settings.keep_noisy and settings.target != ADD_PASS and NOISY_NAME not in arrays
    noisy = arrays.get(NOISY_NAME, arrays["Combined"]).copy() if wants_before or is_kept else None
    read = time.perf_counter()
    outcome.add_seconds("read", read - start)

    with context.new_frame(*size) as frame:
        for name, pixels in arrays.items():
            frame.add_layer(f"{layer.name}.{name}", pixels, borrow=True)
        frame.set_samples(layer.samples)
        handed_over = time.perf_counter()
        outcome.add_seconds("set up", handed_over - read)
        report = context.denoise(frame, model, layers=settings.layers, progress=progress)
        outcome.add_seconds("denoise", time.perf_counter() - handed_over)
    outcome.add_report(report)
    outcome.add_guides_note(set(known.values()))

    changed = set(report.names("denoised"))
    result = _Result(noisy=noisy if wants_before else None)
    if settings.target == ADD_PASS:
        result.added.append((PASS_NAME, arrays["Combined"]))
    else:
        result.passes = [(p, arrays[p.name]) for p in wanted if f"{layer.name}.{p.name}" in changed]
        if is_kept and noisy is not None:
            result.added.append((KEPT_NAME, noisy))
    return result
