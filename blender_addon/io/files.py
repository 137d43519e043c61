# SPDX-License-Identifier: GPL-3.0-or-later
"""Saved EXR files: which, under what name the result goes, what is finished already, and the denoising itself."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from .library import Problem, already_denoised, quell
from .outcome import Outcome
from .settings import Settings

if TYPE_CHECKING:
    import numpy as np

Progress = Callable[[float], "bool | None"]

DEFAULT_PATTERN = "{name}_quell"


def collect(paths: Iterable[str | os.PathLike[str]], pattern: str) -> list[Path]:
    """Files as they are, and the .exr files of folders by name; results of an earlier run are left out of folders.

    Raises Problem for what is not there."""
    files: list[Path] = []
    for path in map(Path, paths):
        if path.is_dir():
            found = sorted(p for p in path.iterdir() if p.suffix.lower() == ".exr")
            results = {output_path(p, pattern) for p in found} - (set(found) if _is_in_place(pattern) else set())
            files += [p for p in found if p not in results]
        elif path.is_file():
            files.append(path)
        else:
            raise Problem(f"There is no file {path}.")
    if not files:
        raise Problem("There are no .exr files.")
    return files


def output_path(source: Path, pattern: str, folder: Path | None = None) -> Path:
    """Where the result of `source` goes: {name} is its name without folder and extension. Raises Problem."""
    if "{name}" not in pattern and pattern:
        raise Problem(f"The name pattern '{pattern}' has no {{name}}: all results would have one name.")
    name = (pattern or "{name}").replace("{name}", source.stem)
    return (folder or source.parent) / (name if name.lower().endswith(".exr") else name + ".exr")


def _is_in_place(pattern: str) -> bool:
    return pattern in ("", "{name}", "{name}.exr")


def is_finished(source: Path, output: Path) -> bool:
    """Whether an earlier run has made this result. A result appears whole or not at all, so its age tells."""
    if output == source or not output.exists():
        return False
    return output.stat().st_mtime_ns >= source.stat().st_mtime_ns


def denoise_file(
    source: Path,
    output: Path,
    settings: Settings,
    progress: Progress,
    codec: str = "keep",
    denoised_layers: frozenset[str] = frozenset(),
) -> Outcome:
    """Denoises one multilayer EXR into another, or in place. Raises Problem and the library's errors.

    denoised_layers: view layers that are known to be denoised already, so that they must bring a noisy picture.
    """
    outcome = Outcome()
    with quell().Context(threads=settings.threads, max_memory_bytes=settings.max_memory_bytes) as context:
        start = time.perf_counter()
        with context.open_model(settings.model, settings.quality) as model, context.read_exr(source) as frame:
            read = time.perf_counter()
            outcome.add_seconds("read", read - start)
            layers = frame.layers
            for name in denoised_layers - {layer.view_layer for layer in layers if layer.role == "noisy-image"}:
                raise Problem(already_denoised(name))
            outcome.add_guides_note({layer.role for layer in layers})
            report = context.denoise(
                frame, model, layers=settings.layers, keep_noisy=settings.keep_noisy, progress=progress
            )
            outcome.add_report(report)
            denoised = time.perf_counter()
            outcome.add_seconds("denoise", denoised - read)
            frame.write_exr(output, codec=codec)
            outcome.add_seconds("write", time.perf_counter() - denoised)
    return outcome


def denoise_fresh_file(
    source: Path, output: Path, settings: Settings, progress: Progress, denoised_layers: frozenset[str]
) -> Outcome:
    """As denoise_file, of a file that Blender has just written for this: on a full disk some versions write half of it
    and say nothing."""
    try:
        return denoise_file(source, output, settings, progress, "zip", denoised_layers)
    except quell().FileError as error:
        if str(source) not in str(error):
            raise
        raise Problem(f"Blender could not write the render into {source.parent}: is the disk full?") from error


def denoise_files(
    files: list[Path],
    settings: Settings,
    pattern: str,
    folder: Path | None,
    again: bool,
    progress: Progress,
    done: Callable[[Path, Outcome | None, Exception | None], None],
) -> int:
    """Denoises file after file and returns how many failed. One that fails does not stop the others; a cancel does.

    again: also those whose result is there. done: called after each with its outcome (None: it was finished before) or
    its error.
    """
    outputs = {source: output_path(source, pattern, folder) for source in files}
    if len(set(outputs.values())) != len(outputs):
        raise Problem("Two of the files would have one result: give another name pattern or another folder.")
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    failed = 0
    for index, (source, output) in enumerate(outputs.items()):

        def part(fraction: float, index: int = index) -> bool | None:
            return progress((index + fraction) / len(files))

        try:
            finished = not again and is_finished(source, output)
            outcome = None if finished else denoise_file(source, output, settings, part)
        except quell().CancelledError:
            raise
        except (quell().QuellError, Problem, OSError) as error:
            failed += 1
            done(source, None, error)
        else:
            done(source, outcome, None)
    return failed


def picture_behind_composite(path: Path) -> np.ndarray | None:
    """The first view layer's Combined of a file that begins with the compositor's picture, which is what Blender shows
    of it. None for other files: those show Combined by themselves."""
    with quell().Context() as context, context.read_exr(path) as frame:
        layers = frame.layers
        if not any(layer.view_layer == "Composite" for layer in layers):
            return None
        names = [layer.full_name for layer in layers if layer.role == "combined" and layer.view_layer != "Composite"]
        return frame.pixels(names[0]) if names else None
