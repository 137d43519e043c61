# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: what denoising costs, and what it is worth, beside Open Image Denoise. Start with bench/peers.py."""
