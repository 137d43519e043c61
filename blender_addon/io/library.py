# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the Python package `quell`: inside the legacy zip, or installed by Blender from the extension's wheel."""

from __future__ import annotations

import functools
from types import ModuleType


class Problem(Exception):
    """Something that the user can act on; its text is one plain sentence or two."""


def already_denoised(view_layer: str) -> str:
    """The sentence for a view layer that Cycles has denoised without keeping its noisy picture."""
    return (
        f"Cycles has denoised '{view_layer}' already and kept no noisy picture. "
        "Turn off Denoise in Sampling, and render again."
    )


@functools.lru_cache(maxsize=1)
def quell() -> ModuleType:
    """The package with its library loaded. Raises Problem."""
    try:
        try:
            from ..vendor import quell as package
        except ModuleNotFoundError as error:
            if error.name is None or not error.name.endswith("vendor"):
                raise
            import quell as package
    except ModuleNotFoundError as error:
        if error.name == "numpy":
            raise Problem("This Blender's Python has no NumPy. On Debian and Ubuntu, install python3-numpy.") from error
        raise Problem("The quell package is missing: install the add-on from its zip file again.") from error
    try:
        package.version()
    except package.LibraryError as error:
        raise Problem(str(error)) from error
    return package


def problem() -> str:
    """Why the library cannot be used, "" when it can."""
    try:
        quell()
    except Problem as error:
        return str(error)
    return ""


@functools.lru_cache(maxsize=1)
def models() -> tuple[str, ...]:
    """Names of the models inside the library, the default first; empty while it cannot be loaded."""
    return tuple(quell().models()) if not problem() else ()


@functools.lru_cache(maxsize=1)
def qualities() -> tuple[str, ...]:
    """Quality levels whose network is inside the library; empty while it cannot be loaded."""
    return tuple(quell().qualities()) if not problem() else ()


_roles: dict[tuple[str, int], str] = {}


def roles(passes: dict[str, int]) -> dict[str, str]:
    """What passes are, by name; see quell.roles. Remembered, as every frame asks for the same."""
    unknown = {name: channels for name, channels in passes.items() if (name, channels) not in _roles}
    if unknown:
        for name, role in quell().roles(unknown).items():
            _roles[name, unknown[name]] = role
    return {name: _roles[name, channels] for name, channels in passes.items()}
