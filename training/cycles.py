# SPDX-License-Identifier: Apache-2.0
"""Drive Cycles: settings as Blender ships them, one multilayer EXR per render, all passes."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from training.data.store import PASSES
from training.exr import read_exr

_LAYER_PASSES = (
    "combined z normal position emit environment diffuse_direct diffuse_indirect diffuse_color "
    "glossy_direct glossy_indirect glossy_color transmission_direct transmission_indirect "
    "transmission_color"
).split()


SHADOW_CATCHER = "Shadow Catcher"


@dataclass(frozen=True)
class Render:
    """One render: CHANNELS as [C,H,W] float32, the scene's own passes [3,H,W] by name, the CPU seconds it took."""

    pixels: np.ndarray
    extra: dict[str, np.ndarray]
    seconds: float


def configure(scene: bpy.types.Scene) -> None:
    """Ask for every pass and for plain sampling; all else stays at Cycles' defaults."""
    layer = scene.view_layers[0]
    for name in _LAYER_PASSES:
        setattr(layer, f"use_pass_{name}", True)
    layer.cycles.use_pass_volume_direct = True
    layer.cycles.use_pass_volume_indirect = True
    layer.cycles.denoising_store_passes = True
    # Lamps carry the flag too, and by default: there it means that catchers catch their shadows.
    catchers = [obj for obj in scene.objects if obj.type == "MESH" and obj.is_shadow_catcher]
    layer.cycles.use_pass_shadow_catcher = bool(catchers)
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    # Every pixel must get the sample count that the file name says.
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.render.use_persistent_data = True
    scene.render.use_compositing = False
    scene.render.use_sequencer = False
    scene.render.threads_mode = "FIXED"
    scene.render.threads = 1
    scene.render.resolution_percentage = 100
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"


def set_view(scene: bpy.types.Scene, resolution: tuple[int, int], region: tuple[int, int, int, int] | None) -> None:
    """Choose the full picture's size and the pixels (x, y from the top, w, h) of it to render."""
    width, height = resolution
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.use_border = scene.render.use_crop_to_border = region is not None
    if region is not None:
        x, y, w, h = region
        # Half a pixel inwards keeps rounding from adding or losing a row.
        scene.render.border_min_x = (x + 0.01) / width
        scene.render.border_max_x = (x + w + 0.01) / width
        scene.render.border_min_y = (height - y - h + 0.01) / height
        scene.render.border_max_y = (height - y + 0.01) / height


def extra_passes(scene: bpy.types.Scene) -> list[str]:
    """Return the passes that only this scene has: its light groups and the shadow catcher's."""
    layer = scene.view_layers[0]
    names = [f"Combined_{group.name}" for group in layer.lightgroups]
    return sorted(names) + ([SHADOW_CATCHER] if layer.cycles.use_pass_shadow_catcher else [])


def render(scene: bpy.types.Scene, spp: int, seed: int) -> Render:
    """Render the current view."""
    scene.cycles.samples = spp
    scene.cycles.seed = seed
    with tempfile.TemporaryDirectory(prefix="quell-render-") as folder:
        path = Path(folder) / "render.exr"
        scene.render.filepath = str(path)
        scene.render.use_file_extension = False
        start = time.process_time()
        bpy.ops.render.render(write_still=True)
        seconds = time.process_time() - start
        found = read_exr(path)
    lacking = [name for name in PASSES if name not in found.present and not name.startswith("Volume")]
    if lacking:
        raise RuntimeError(f"Cycles wrote no {', '.join(lacking)}; it wrote {', '.join(sorted(found.channels))}")
    extra = {name: np.stack([found.channels[f"{name}.{c}"] for c in "RGB"]) for name in extra_passes(scene)}
    return Render(found.pixels, extra, seconds)
