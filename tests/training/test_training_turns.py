# SPDX-License-Identifier: Apache-2.0
"""Turned pictures: normals must be those of the scene turned, and nothing but the order of pixels may change.

tests/training/test_training_smoke.py asks the same of Cycles.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from synthetic import hills, normals

from training.data.crops import turn, turn_normal

TURNS = list(itertools.product((False, True), repeat=3))


def turned_hills(flip_x: bool, flip_y: bool, transpose: bool):
    """The surface whose picture is the turned picture of hills. Rows go down while y goes up, so that exchanging rows
    and columns takes (x, y) to (-y, -x)."""

    def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        if transpose:
            x, y = -y, -x
        return hills(-x if flip_x else x, -y if flip_y else y)

    return surface


@pytest.mark.parametrize("flips", TURNS)
def test_turned_normals_are_those_of_the_turned_scene(flips: tuple[bool, bool, bool]) -> None:
    size = 33
    picture = turn_normal(turn(normals(hills, size), *flips), *flips)
    scene = normals(turned_hills(*flips), size)
    np.testing.assert_allclose(picture, scene, atol=1e-6)


def test_the_eight_turns_differ() -> None:
    pictures = [turn_normal(turn(normals(hills, 8), *flips), *flips) for flips in TURNS]
    assert all(not np.allclose(a, b) for a, b in itertools.combinations(pictures, 2))


@pytest.mark.parametrize("flips", TURNS)
def test_normals_keep_their_length(flips: tuple[bool, bool, bool]) -> None:
    short = 0.7 * normals(hills, 8)  # a pixel half covered by background
    np.testing.assert_allclose(np.linalg.norm(turn_normal(short, *flips), axis=0), 0.7, rtol=1e-6)
