# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a scene, and what follows at once when they change."""

from __future__ import annotations

import dataclasses

import bpy

from ..io import files
from ..io.settings import ADD_PASS, REPLACE, Settings
from . import cycles_settings, preferences

WHEN_ALWAYS = "ALWAYS"
WHEN_ANIMATION = "ANIMATION"
WHEN_BUTTON = "BUTTON"

OUTPUT_RENDER = "RENDER"
OUTPUT_FILE = "FILE"
OUTPUT_BOTH = "BOTH"


def _enabled_changed(self: QuellSettings, context: bpy.types.Context) -> None:
    cycles_settings.take_over(self, self.id_data) if self.enabled else cycles_settings.give_back(self, self.id_data)
    _passes_changed(self, context)


def _passes_changed(self: QuellSettings, _context: bpy.types.Context) -> None:
    """The Render Layers node shows the pass "Quell" only after this."""
    for view_layer in self.id_data.view_layers:
        view_layer.update_render_passes()


class QuellSettings(bpy.types.PropertyGroup):
    enabled: bpy.props.BoolProperty(
        name="Quell",
        description="Denoise renders with Quell. Cycles' own denoiser is turned off meanwhile, and its denoising data "
        "(albedo and normal) turned on, which helps a lot and costs next to nothing",
        default=False,
        update=_enabled_changed,
    )
    when: bpy.props.EnumProperty(
        name="When",
        description="Which renders are denoised without asking",
        items=[
            (WHEN_ALWAYS, "After Each Render", "Still images and every frame of an animation"),
            (WHEN_ANIMATION, "Animations Only", "Every frame of an animation; still images by the button"),
            (WHEN_BUTTON, "By the Button Only", "Nothing happens until Denoise Render Result is pressed"),
        ],
        default=WHEN_ALWAYS,
    )
    quality: bpy.props.EnumProperty(
        name="Quality",
        description="How much work Quell puts into a picture. All levels clean the same passes",
        items=[
            ("FAST", "Fast", "The shortest wait: for test renders and previews"),
            ("BALANCED", "Balanced", "For most renders and animations: good detail in little time"),
            ("HIGH", "High", "The cleanest picture and the finest detail, for final frames. Takes longest"),
        ],
        default="BALANCED",
    )
    layers: bpy.props.EnumProperty(
        name="Passes",
        description="What is denoised",
        items=[
            ("ALL", "All Light Passes", "Combined and every light pass: diffuse, glossy, light groups, ..."),
            ("COMBINED", "Combined Only", "The picture alone; other passes stay noisy"),
            ("NAMES", "By Name", "The passes named below"),
        ],
        default="ALL",
    )
    layer_names: bpy.props.StringProperty(
        name="Names",
        description="Passes to denoise, separated by commas, such as: Combined, DiffDir, my AOV",
    )
    keep_noisy: bpy.props.BoolProperty(
        name="Keep Noisy Image",
        description="Keep the picture as it was rendered: as the pass Quell Noisy in the render, Noisy Image in a file",
        default=False,
    )
    target: bpy.props.EnumProperty(
        name="Result",
        description="Where in the render the result goes",
        items=[
            (REPLACE, "Replaces the Noisy Passes", "The display, the compositor and saved files get the clean picture"),
            (ADD_PASS, "Is a Pass of Its Own", "All passes stay as rendered; the pass Quell is added, with a socket "
             "on the Render Layers node"),
        ],
        default=REPLACE,
        update=_passes_changed,
    )  # fmt: skip
    output: bpy.props.EnumProperty(
        name="Output",
        description="Where the result goes",
        items=[
            (OUTPUT_RENDER, "Render", "Into the render itself, before compositing and saving"),
            (OUTPUT_FILE, "EXR File", "Into a multilayer EXR file beside the output; the render stays noisy"),
            (OUTPUT_BOTH, "Both", "Into the render, and into a multilayer EXR file beside the output"),
        ],
        default=OUTPUT_RENDER,
    )
    pattern: bpy.props.StringProperty(
        name="File Name",
        description="Name of the EXR file: {name} stands for the name of the rendered file. {name} alone replaces the "
        "render's own EXR file",
        default=files.DEFAULT_PATTERN,
    )
    # What Cycles' settings were before Quell was enabled, to put them back.
    previous: bpy.props.StringProperty(options={"HIDDEN"})

    def to_plain(self) -> Settings:
        """The settings as values that any thread may read."""
        machine = preferences.get()
        return Settings(
            quality=self.quality.lower(),
            layers={"ALL": None, "COMBINED": "beauty", "NAMES": self.layer_names}[self.layers],
            keep_noisy=self.keep_noisy,
            target=self.target,
            threads=machine.threads if machine else 0,
            max_memory_bytes=(machine.max_memory if machine else 0) * 1024 * 1024,
        )

    def wants_render(self, is_animation: bool) -> bool:
        """Whether a render is denoised without asking."""
        return self.enabled and (self.when == WHEN_ALWAYS or (self.when == WHEN_ANIMATION and is_animation))


def file_settings(scene: bpy.types.Scene) -> Settings:
    """The scene's settings for a file: it cannot get a pass of its own, so both pictures are kept instead."""
    plain = scene.quell.to_plain()
    return dataclasses.replace(plain, target=REPLACE, keep_noisy=plain.keep_noisy or plain.target == ADD_PASS)


def register() -> None:
    bpy.utils.register_class(QuellSettings)
    bpy.types.Scene.quell = bpy.props.PointerProperty(type=QuellSettings)


def unregister() -> None:
    del bpy.types.Scene.quell
    bpy.utils.unregister_class(QuellSettings)
