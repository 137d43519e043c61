# SPDX-License-Identifier: GPL-3.0-or-later
"""What needs no Blender: files, pixels in arrays, threads, the command line. Nothing here imports bpy."""
