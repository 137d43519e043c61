# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `blender --command quell denoise FILES...`, or command(["denoise", ...]) from --python-expr."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from . import files, library
from .journal import EXIT_FAILED
from .outcome import Outcome
from .settings import LEVELS, Settings

EXIT_USAGE = 2


def command(arguments: list[str]) -> int:
    """Runs it and returns the exit code: 0 all done, 1 some failed, 2 wrong use."""
    parser = _parser()
    try:
        options = parser.parse_args(arguments)
    except SystemExit as stop:  # argparse's way to end; Blender would go on to its own exit code
        return int(stop.code or 0)
    settings = Settings(
        quality=options.quality,
        model=options.model,
        layers=options.layers,
        keep_noisy=options.keep_noisy,
        threads=options.threads,
    )
    try:
        library.quell()
        sources = files.collect(options.files, options.name)
        failed = files.denoise_files(
            sources, settings, options.name, options.out, options.again, lambda _fraction: None, _say
        )
    except (library.Problem, OSError) as error:
        print(f"quell: {error}", file=sys.stderr)
        return EXIT_USAGE
    return EXIT_FAILED if failed else 0


def _say(source: Path, outcome: Outcome | None, error: Exception | None) -> None:
    if error is not None:
        print(f"quell: {error}", file=sys.stderr, flush=True)
    elif outcome is None:
        print(f"{source.name}: finished before", flush=True)
    else:
        print(f"{source.name}: {outcome.summary()}", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="quell", description="Denoises multilayer EXR files that Cycles rendered.")
    commands = parser.add_subparsers(required=True)
    denoise = commands.add_parser("denoise", help="denoise files; those whose result is there are skipped")
    denoise.add_argument("files", nargs="+", help="EXR files, or folders of them")
    denoise.add_argument("-o", "--out", type=Path, help="folder for the results; default: beside each file")
    denoise.add_argument("-n", "--name", default=files.DEFAULT_PATTERN, help="name of a result (default: %(default)s)")
    network = denoise.add_mutually_exclusive_group()
    network.add_argument(
        "--quality", choices=LEVELS, default="", help="larger networks take longer (default: balanced)"
    )
    network.add_argument("-m", "--model", default="", help="a built-in model or a weight file")
    denoise.add_argument("-l", "--layers", help="all (the default), beauty, or names, comma-separated")
    denoise.add_argument("--keep-noisy", action="store_true", help="keep the noisy Combined as 'Noisy Image'")
    denoise.add_argument("--threads", type=int, default=0, help="default: one per core")
    denoise.add_argument("--again", action="store_true", help="also what is finished")
    return parser
