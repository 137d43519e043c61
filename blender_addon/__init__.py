# SPDX-License-Identifier: GPL-3.0-or-later
"""Quell in Blender: denoises what Cycles rendered, by libquell. io/ needs no Blender, blender/ is what needs it."""

bl_info = {
    "name": "Quell",
    "author": "The Quell authors",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "Render Properties > Sampling > Quell",
    "description": "Removes the noise from Cycles renders, passes and animations",
    "category": "Render",
}


def register() -> None:
    from . import blender

    blender.register()


def unregister() -> None:
    from . import blender

    blender.unregister()


def command(arguments: list[str]) -> int:
    """`quell denoise FILES...` for versions without `blender --command`; returns the exit code. See docs/blender.md."""
    from .io.command import command as run

    return run(arguments)
