# SPDX-License-Identifier: Apache-2.0
"""Wide kernels applied in C for training on a CPU; `reconstruct.reconstruct_reference` is the plain PyTorch form."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import torch
from torch import Tensor

from training.native import compiled


@functools.cache
def library() -> ctypes.CDLL:
    lib = compiled(Path(__file__).with_name("wide_kernel.c"))
    pointer = ctypes.c_void_p
    lib.wide_forward.argtypes = [ctypes.c_long] * 5 + [pointer] * 3
    lib.wide_forward.restype = None
    lib.wide_backward.argtypes = [ctypes.c_long] * 5 + [pointer] * 5
    lib.wide_backward.restype = None
    return lib


class WideKernel(torch.autograd.Function):
    """out[n,c,y,x] = sum_k softmax_k(logits)[n,k,y,x] * source[n,c,y+dy,x+dx], zero outside."""

    @staticmethod
    def forward(ctx, source: Tensor, logits: Tensor, radius: int) -> Tensor:
        source, logits = source.float().contiguous(), logits.float().contiguous()
        out = torch.empty_like(source)
        library().wide_forward(*source.shape, radius, source.data_ptr(), logits.data_ptr(), out.data_ptr())
        ctx.save_for_backward(source, logits)
        ctx.radius = radius
        return out

    @staticmethod
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        source, logits = ctx.saved_tensors
        grad = grad.float().contiguous()
        grad_source, grad_logits = torch.empty_like(source), torch.empty_like(logits)
        library().wide_backward(
            *source.shape, ctx.radius,
            source.data_ptr(), logits.data_ptr(), grad.data_ptr(), grad_source.data_ptr(), grad_logits.data_ptr(),
        )  # fmt: skip
        return grad_source, grad_logits, None
