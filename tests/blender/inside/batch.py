# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender: a batch render of frame 1 with Quell into files named by a pattern: ADDON.zip FOLDER PATTERN."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import scene as test_scene  # noqa: E402

addon_zip, folder, pattern = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.preferences.addon_install(filepath=addon_zip, overwrite=True)
bpy.ops.preferences.addon_enable(module="quell_denoiser")
scene = test_scene.make()
scene.quell.enabled = True
scene.quell.output = "FILE"
scene.quell.pattern = pattern
test_scene.set_format(scene, "OPEN_EXR_MULTILAYER")
scene.frame_start = scene.frame_end = 1
scene.render.filepath = str(Path(folder) / "batch####")
bpy.ops.render.render(animation=True)
