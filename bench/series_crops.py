# SPDX-License-Identifier: Apache-2.0
"""Which part of which sample the series of sample counts shows."""

#: Width and height of a crop in pixels.
SIZE = (96, 72)

#: Left and top pixel in the sample.
CROPS = {"living_room": (64, 56), "still_life": (56, 56), "house": (72, 64)}
