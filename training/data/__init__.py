# SPDX-License-Identifier: Apache-2.0
"""Storage and loading of rendered frames."""
