# SPDX-License-Identifier: Apache-2.0
"""Renders the normals of a scene and of its eight turns, for test_training_smoke.py: render_turns.py FOLDER.

The picture plane is turned by the scene's matrix: x to the right and y up are what flips negate, and exchanging rows
(which go down) and columns takes (x, y) to (-y, -x).
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from training import cycles  # noqa: E402
from training.data.store import pass_slice  # noqa: E402

SIZE = 48


def build() -> bpy.types.Object:
    """Cubes and balls under a parent, seen from above by an orthographic camera; nothing is symmetric."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    parent = bpy.data.objects.new("turned", None)
    scene.collection.objects.link(parent)
    for location, rotation, size in (
        ((-0.5, 0.4, 0), (0.4, 0.2, 0.1), 0.7),
        ((0.5, 0.5, 0), (-0.3, 0.6, 0.5), 0.5),
        ((0.2, -0.5, 0), (0.7, -0.5, 0.2), 0.8),
    ):
        bpy.ops.mesh.primitive_cube_add(size=size, location=location, rotation=rotation)
        bpy.context.object.parent = parent
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.3, location=(-0.6, -0.5, 0), segments=64, ring_count=32)
    bpy.context.object.parent = parent
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = 2
    camera.location = (0, 0, 5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return parent


def turn_matrix(flip_x: bool, flip_y: bool, transpose: bool) -> Matrix:
    flips = Matrix.Diagonal((-1 if flip_x else 1, -1 if flip_y else 1, 1, 1))
    exchange = Matrix(((0, -1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    return exchange @ flips if transpose else flips


def main() -> None:
    folder = Path(sys.argv[1])
    parent = build()
    scene = bpy.context.scene
    cycles.configure(scene)
    scene.render.use_persistent_data = False
    cycles.set_view(scene, (SIZE, SIZE), None)
    for flips in itertools.product((False, True), repeat=3):
        parent.matrix_world = turn_matrix(*flips)
        bpy.context.view_layer.update()
        pixels = cycles.render(scene, 16, 1).pixels
        np.save(folder / ("".join(str(int(flip)) for flip in flips) + ".npy"), pixels[pass_slice("Denoising Normal")])


if __name__ == "__main__":
    main()
