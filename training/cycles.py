# SPDX-License-Identifier: Apache-2.0
"""Drive Cycles: settings as Blender ships them, one multilayer EXR per render, all passes."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import OpenEXR

from training.data.store import BACKGROUND_DEPTH, CHANNELS

#: Blender 5 writes long pass names; the store keeps the short ones of 4.x.
_SHORT_NAMES = {
    "Diffuse Direct": "DiffDir",
    "Diffuse Indirect": "DiffInd",
    "Diffuse Color": "DiffCol",
    "Glossy Direct": "GlossDir",
    "Glossy Indirect": "GlossInd",
    "Glossy Color": "GlossCol",
    "Transmission Direct": "TransDir",
    "Transmission Indirect": "TransInd",
    "Transmission Color": "TransCol",
    "Volume Direct": "VolumeDir",
    "Volume Indirect": "VolumeInd",
    "Emission": "Emit",
    "Environment": "Env",
}

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
        found = read_channels(path)
    extra = {name: np.stack([found[f"{name}.{c}"] for c in "RGB"]) for name in extra_passes(scene)}
    return Render(select_channels(found), extra, seconds)


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """Read a multilayer EXR of any Blender version: "Pass.C" by 4.x's short names to [H,W]."""
    found: dict[str, np.ndarray] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                # Layer names may hold dots: channel and pass are what stands last.
                pieces = name.rsplit(".", 2)
                if len(pieces) >= 2:
                    pass_name = _SHORT_NAMES.get(pieces[-2], pieces[-2])
                    found[f"{pass_name}.{pieces[-1]}"] = channel.pixels
    return found


def select_channels(found: dict[str, np.ndarray]) -> np.ndarray:
    """Return what was read in the order of CHANNELS; passes of volumes may be missing and are then zero."""
    height, width = found["Combined.R"].shape
    out = np.zeros((len(CHANNELS), height, width), np.float32)
    for index, name in enumerate(CHANNELS):
        if name in found:
            out[index] = found[name]
        elif not name.startswith("Volume"):
            raise RuntimeError(f"Cycles wrote no channel {name}; it wrote {sorted(found)}")
    for name in ("Depth.Z", "Denoising Depth.Z"):
        plane = out[CHANNELS.index(name)]
        plane[plane > BACKGROUND_DEPTH] = 0.0
    return out
