# SPDX-License-Identifier: Apache-2.0
"""Runs inside Blender: denoises a file while another OpenEXR stands in the global scope: ADDON.zip IN OUT."""

from __future__ import annotations

import ctypes
import importlib
import sys

import bpy

addon_zip, source, output = sys.argv[sys.argv.index("--") + 1 :]
if bpy.app.version >= (4, 2, 0):
    bpy.ops.extensions.package_install_files(filepath=addon_zip, repo="user_default", enable_on_install=True)
    module = "bl_ext.user_default.quell"
else:
    bpy.ops.preferences.addon_install(filepath=addon_zip)
    bpy.ops.preferences.addon_enable(module="quell_denoiser")
    module = "quell_denoiser"

print("other OpenEXR:", hasattr(ctypes.CDLL(None), "exr_start_read"))
quell = importlib.import_module(f"{module}.io.library").quell()
with quell.Context(threads=1) as context, context.read_exr(source) as frame:
    context.denoise(frame, context.open_model())
    frame.write_exr(output)
bpy.ops.preferences.addon_disable(module=module)
