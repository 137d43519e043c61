# SPDX-License-Identifier: Apache-2.0
"""Training package of Quell: scenes, rendering, networks, evaluation and export."""
