# SPDX-License-Identifier: GPL-3.0-or-later
"""What belongs to the machine rather than to a scene."""

from __future__ import annotations

import bpy

from ..io import library

# The add-on's own module: "quell_denoiser", or "bl_ext.user_default.quell" as an extension.
ADDON = __package__.rpartition(".")[0]


class QuellPreferences(bpy.types.AddonPreferences):
    bl_idname = ADDON

    threads: bpy.props.IntProperty(
        name="Threads",
        description="Processor threads that Quell uses; 0 is one for each core",
        default=0,
        min=0,
        max=1024,
    )
    max_memory: bpy.props.IntProperty(
        name="Memory Limit (MB)",
        description="Working memory beyond the image itself; less means smaller tiles and the same picture. "
        "0 is 4096 MB",
        default=0,
        min=0,
    )
    journal: bpy.props.StringProperty(
        name="Batch Record",
        description="A file that gets a line for each frame of a batch render, saying what was done or went wrong. "
        "The environment variable QUELL_JOURNAL goes before it",
        subtype="FILE_PATH",
    )

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split = True
        problem = library.problem()
        if problem:
            layout.label(text=problem, icon="ERROR")
        else:
            layout.label(text=f"libquell {library.quell().version()}, models: {', '.join(library.models())}")
        layout.prop(self, "threads")
        layout.prop(self, "max_memory")
        layout.prop(self, "journal")


def get() -> QuellPreferences | None:
    """None while the add-on is registered without being enabled, as tests do."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return addon.preferences if addon else None


def register() -> None:
    bpy.utils.register_class(QuellPreferences)


def unregister() -> None:
    bpy.utils.unregister_class(QuellPreferences)
