# SPDX-License-Identifier: Apache-2.0
"""What takes the time of a training step on a CPU, in C, compiled at first use.

The plain PyTorch forms of the same operations run on any device and are what the tests compare with:
`training.models.pyramid.guided_kernel_reference` and `partition_reference`, `training.loss.relative_error_reference`.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import subprocess
import tempfile
from pathlib import Path

import torch

from training.paths import state_root

KERNELS, LOSSES = (Path(__file__).with_name(name) for name in ("kernel_ops.c", "loss_ops.c"))
FLAGS = [
    "-O3",
    "-march=native",
    "-mprefer-vector-width=512",
    "-ffast-math",
    "-fopenmp",
    "-fPIC",
    "-shared",
    "-std=gnu11",
]


def compiled(source: Path) -> ctypes.CDLL:
    """Compiles a C source for this machine, once per content, and loads it."""
    cpu = Path("/proc/cpuinfo").read_text().split("\n\n")[0] if Path("/proc/cpuinfo").exists() else ""
    flags_line = next((line for line in cpu.splitlines() if line.startswith("flags")), "")
    key = hashlib.sha256(source.read_bytes() + " ".join(FLAGS).encode() + flags_line.encode()).hexdigest()[:16]
    cache = state_root() / "native"
    target = cache / f"{source.stem}-{key}.so"
    if not target.exists():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=cache, suffix=".so", delete=False) as temporary:
            pass
        subprocess.run(["gcc", *FLAGS, "-o", temporary.name, str(source), "-lm"], check=True)
        Path(temporary.name).rename(target)
    return ctypes.CDLL(str(target))


@functools.cache
def library() -> ctypes.CDLL:
    """The kernels of the quell family."""
    lib = compiled(KERNELS)
    pointer = ctypes.c_void_p
    lib.guided_forward.argtypes = [ctypes.c_long] + [pointer] * 5
    lib.guided_forward.restype = None
    lib.guided_backward.argtypes = [ctypes.c_long] + [pointer] * 6
    lib.guided_backward.restype = None
    lib.take_planes.argtypes = [ctypes.c_long] * 5 + [pointer] * 4
    lib.take_planes.restype = None
    lib.give_planes.argtypes = [ctypes.c_long] * 5 + [pointer] * 5
    lib.give_planes.restype = None
    lib.partition_forward.argtypes = [ctypes.c_long] * 4 + [pointer] * 3
    lib.partition_forward.restype = None
    lib.partition_backward.argtypes = [ctypes.c_long] * 4 + [pointer] * 5
    lib.partition_backward.restype = None
    return lib


@functools.cache
def losses() -> ctypes.CDLL:
    """The robust relative error."""
    lib = compiled(LOSSES)
    pointer = ctypes.c_void_p
    lib.relative_error.argtypes = [ctypes.c_long] * 5 + [ctypes.c_float] * 2 + [pointer] * 5
    lib.relative_error.restype = None
    return lib


def _pointers(tensors: list[torch.Tensor | None]) -> ctypes.Array:
    return (ctypes.c_void_p * len(tensors))(*(None if t is None else t.data_ptr() for t in tensors))


def _longs(values: list[int]) -> ctypes.Array:
    return (ctypes.c_long * len(values))(*values)


def _planes(tensors: list[torch.Tensor | None], shapes: list[tuple[int, int]] | None = None) -> ctypes.Array:
    """A pointer to each plane of tensors [n,c,h,w], in their order; of one that is not there, n c (shapes) NULLs."""
    pointers: list[int | None] = []
    for i, tensor in enumerate(tensors):
        if tensor is None:
            assert shapes is not None
            pointers += [None] * (shapes[i][0] * shapes[i][1])
        else:
            size = 4 * tensor.shape[-1] * tensor.shape[-2]
            pointers += range(tensor.data_ptr(), tensor.data_ptr() + size * tensor.shape[0] * tensor.shape[1], size)
    return (ctypes.c_void_p * len(pointers))(*pointers)


class GuidedKernel(torch.autograd.Function):
    """`pyramid.guided_kernel_reference` on the CPU, forward and backward."""

    @staticmethod
    def forward(ctx, source, embedding, other, scale, centre, table, image, group, radius, shift):
        given = (source, embedding, other, scale, centre, table)
        tensors = [None if t is None else t.float().contiguous() for t in given]
        n, channels, height, width = source.shape[0], source.shape[1], *scale.shape[-2:]
        images, dims = embedding.shape[:2]
        source_size = (width >> shift, height >> shift)
        sizes = _longs([width, height, *source_size, radius, shift, channels, dims, images, len(table)])
        index = _longs(image.tolist()), _longs(group.tolist())
        out = torch.empty(n, channels, height, width)
        library().guided_forward(n, sizes, *index, _pointers(tensors), out.data_ptr())
        ctx.save_for_backward(*(t for t in tensors if t is not None))
        ctx.call = (n, sizes, *index)
        ctx.has_centre = centre is not None
        return out

    @staticmethod
    def backward(ctx, grad):
        tensors = list(ctx.saved_tensors)
        if not ctx.has_centre:
            tensors.insert(4, None)
        source, embedding, other, scale, centre, table = tensors
        out = [
            torch.empty_like(source),
            torch.zeros_like(embedding),
            torch.zeros_like(other),
            torch.empty_like(scale),
            None if centre is None else torch.empty_like(centre),
            torch.zeros_like(table),
        ]
        grad = grad.float().contiguous()
        library().guided_backward(*ctx.call, _pointers(tensors), grad.data_ptr(), _pointers(out))
        return *out, None, None, None, None


class TakePlanes(torch.autograd.Function):
    """`pyramid.take_planes_reference` on the CPU; x float32 or bfloat16."""

    @staticmethod
    def forward(ctx, x: torch.Tensor, fine: int, *choices) -> tuple[torch.Tensor, ...]:
        x = x.contiguous()
        height, width = x.shape[-2:]
        out, index, bounds = [], [], []
        for first, count, bound in zip(choices[::3], choices[1::3], choices[2::3], strict=True):
            out.append(torch.empty(len(first), count, height * fine, width * fine))
            planes = (first[:, None] + torch.arange(count)).flatten()
            index.append(planes)
            bounds += [math.inf if bound is None else bound] * len(planes)
        index, bounds = torch.cat(index), torch.tensor(bounds)
        sizes = (len(index), int(x.dtype == torch.bfloat16), fine, height, width)
        ctx.call = (*sizes, index.data_ptr(), bounds.data_ptr())
        ctx.kept = (index, bounds, [tuple(o.shape[:2]) for o in out])
        library().take_planes(*ctx.call, x.data_ptr(), _planes(out))
        ctx.save_for_backward(x)
        ctx.set_materialize_grads(False)
        return tuple(out)

    @staticmethod
    def backward(ctx, *grads):
        (x,) = ctx.saved_tensors
        shapes = ctx.kept[2]
        gradients = [None if grad is None else grad.float().contiguous() for grad in grads]
        given = torch.zeros_like(x)
        library().give_planes(*ctx.call, x.data_ptr(), _planes(gradients, shapes), given.data_ptr())
        return given, None, *([None] * 3 * len(shapes))


class Partition(torch.autograd.Function):
    """`pyramid.partition_reference` on the CPU, forward and backward."""

    @staticmethod
    def forward(ctx, values: torch.Tensor, logits: torch.Tensor) -> torch.Tensor:
        values, logits = values.float().contiguous(), logits.float().contiguous()
        n, channels, height, width = values.shape
        out = torch.empty(n, channels, height // 2, width // 2)
        library().partition_forward(n, channels, height, width, values.data_ptr(), logits.data_ptr(), out.data_ptr())
        ctx.save_for_backward(values, logits)
        return out

    @staticmethod
    def backward(ctx, grad: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        values, logits = ctx.saved_tensors
        grad = grad.float().contiguous()
        grad_values, grad_logits = torch.empty_like(values), torch.empty_like(logits)
        library().partition_backward(
            *values.shape, values.data_ptr(), logits.data_ptr(), grad.data_ptr(),
            grad_values.data_ptr(), grad_logits.data_ptr(),
        )  # fmt: skip
        return grad_values, grad_logits


class RelativeError(torch.autograd.Function):
    """`training.loss.relative_error_reference` on the CPU; scales 3: with that of means over 4x4 and 16x16, at half
    weight. The image alone gets a gradient."""

    @staticmethod
    def forward(ctx, image, target, level, scales: int, epsilon: float, turn: float) -> torch.Tensor:
        image, target, level = (t.float().contiguous() for t in (image, target, level))
        loss = torch.empty(image.shape[0])
        ctx.gradient = torch.empty_like(image) if ctx.needs_input_grad[0] else None
        gradient = None if ctx.gradient is None else ctx.gradient.data_ptr()
        pointers = (image.data_ptr(), target.data_ptr(), level.data_ptr(), loss.data_ptr(), gradient)
        losses().relative_error(*image.shape, scales, epsilon, turn, *pointers)
        return loss

    @staticmethod
    def backward(ctx, grad: torch.Tensor):
        return ctx.gradient * grad[:, None, None, None], None, None, None, None, None
