# SPDX-License-Identifier: Apache-2.0
"""Kernel application in C for training on a CPU, compiled at first use.

The plain PyTorch form of the same operation is `training.models.pyramid.apply_kernel_reference`; it runs on any device
and is what the tests compare with.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path

import torch

SOURCE = Path(__file__).with_name("kernel_ops.c")
FLAGS = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-fPIC", "-shared", "-std=c11"]


@functools.cache
def library() -> ctypes.CDLL:
    """Compiles the C source for this machine, once per content, and loads it."""
    cpu = Path("/proc/cpuinfo").read_text().split("\n\n")[0] if Path("/proc/cpuinfo").exists() else ""
    flags_line = next((line for line in cpu.splitlines() if line.startswith("flags")), "")
    key = hashlib.sha256(SOURCE.read_bytes() + " ".join(FLAGS).encode() + flags_line.encode()).hexdigest()[:16]
    cache = Path(os.environ.get("QUELL_CACHE", Path.home() / ".cache" / "quell")) / "native"
    target = cache / f"kernel_ops-{key}.so"
    if not target.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=cache, suffix=".so", delete=False) as temporary:
            pass
        subprocess.run(["gcc", *FLAGS, "-o", temporary.name, str(SOURCE), "-lm"], check=True)
        Path(temporary.name).rename(target)
    lib = ctypes.CDLL(str(target))
    pointer = ctypes.c_void_p
    lib.kernel_forward.argtypes = [ctypes.c_long] * 6 + [pointer] * 3
    lib.kernel_forward.restype = None
    lib.kernel_backward.argtypes = [ctypes.c_long] * 6 + [pointer] * 5
    lib.kernel_backward.restype = None
    return lib


class ApplyKernel(torch.autograd.Function):
    """out[n,c,y,x] = sum_k softmax_k(logits)[n,k,y,x] * source[n,c,y+dy,x+dx], zero outside."""

    @staticmethod
    def forward(ctx, source: torch.Tensor, logits: torch.Tensor, radius: int, shift: int) -> torch.Tensor:
        source, logits = source.float().contiguous(), logits.float().contiguous()
        n, _, height, width = logits.shape
        out = torch.empty(n, source.shape[1], height, width)
        library().kernel_forward(
            n, source.shape[1], height, width, radius, shift, source.data_ptr(), logits.data_ptr(), out.data_ptr()
        )
        ctx.save_for_backward(source, logits)
        ctx.geometry = (radius, shift)
        return out

    @staticmethod
    def backward(ctx, grad: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None, None]:
        source, logits = ctx.saved_tensors
        radius, shift = ctx.geometry
        grad = grad.float().contiguous()
        n, _, height, width = logits.shape
        grad_source, grad_logits = torch.empty_like(source), torch.empty_like(logits)
        library().kernel_backward(
            n, source.shape[1], height, width, radius, shift,
            source.data_ptr(), logits.data_ptr(), grad.data_ptr(), grad_source.data_ptr(), grad_logits.data_ptr(),
        )  # fmt: skip
        return grad_source, grad_logits, None, None
