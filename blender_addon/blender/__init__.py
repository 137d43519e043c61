# SPDX-License-Identifier: GPL-3.0-or-later
"""What needs bpy: settings, panels, operators, and the ways to a render's passes. No arithmetic on pixels here."""

from __future__ import annotations

from . import (
    command_line,
    compositor,
    engine_hook,
    file_operators,
    handlers,
    image_operators,
    panels,
    passes,
    preferences,
    properties,
    render_operators,
)

# In the order in which they need one another; undone in reverse.
_MODULES = (
    preferences,
    properties,
    passes,
    render_operators,
    image_operators,
    file_operators,
    compositor,
    panels,
    engine_hook,
    handlers,
    command_line,
)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
