# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' own settings that Quell reads or changes: its denoiser, its denoising data, its samples."""

from __future__ import annotations

import json

import bpy


def take_over(settings: bpy.types.PropertyGroup, scene: bpy.types.Scene) -> None:
    """Turns Cycles' denoiser off and its denoising data on, and remembers how they were."""
    if not hasattr(scene, "cycles") or settings.previous:
        return
    settings.previous = json.dumps(
        {
            "use_denoising": scene.cycles.use_denoising,
            "store_passes": {layer.name: layer.cycles.denoising_store_passes for layer in scene.view_layers},
        }
    )
    scene.cycles.use_denoising = False
    for layer in scene.view_layers:
        layer.cycles.denoising_store_passes = True


def give_back(settings: bpy.types.PropertyGroup, scene: bpy.types.Scene) -> None:
    """Puts back what take_over changed."""
    if not hasattr(scene, "cycles") or not settings.previous:
        return
    previous = json.loads(settings.previous)
    settings.previous = ""
    scene.cycles.use_denoising = previous["use_denoising"]
    for name, stored in previous["store_passes"].items():
        if name in scene.view_layers:
            scene.view_layers[name].cycles.denoising_store_passes = stored


def denoises(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> bool:
    """Whether Cycles' own denoiser runs on this view layer of a final render."""
    return bool(scene.cycles.use_denoising and view_layer.cycles.use_denoising)


def denoised_layers(scene: bpy.types.Scene) -> frozenset[str]:
    """Names of the view layers that Cycles' own denoiser runs on."""
    return frozenset(layer.name for layer in scene.view_layers if denoises(scene, layer))


def samples(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> int:
    """Samples per pixel, as Cycles writes them into its files' metadata."""
    own = view_layer.samples
    if own and scene.cycles.use_layer_samples != "IGNORE":
        return min(own, scene.cycles.samples) if scene.cycles.use_layer_samples == "BOUNDED" else own
    return scene.cycles.samples
