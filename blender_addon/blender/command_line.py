# SPDX-License-Identifier: GPL-3.0-or-later
"""`blender --command quell ...`, since 4.2."""

from __future__ import annotations

import bpy

from ..io.command import command

_handle: object = None


def register() -> None:
    global _handle
    if hasattr(bpy.utils, "register_cli_command"):
        _handle = bpy.utils.register_cli_command("quell", command)


def unregister() -> None:
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None
