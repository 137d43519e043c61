# SPDX-License-Identifier: Apache-2.0
"""The device that training runs on: a CPU, or a CUDA device where there is one."""

from __future__ import annotations

import dataclasses
from contextlib import AbstractContextManager
from typing import TypeVar

import torch

T = TypeVar("T")


def choose_device(name: str | None = None) -> torch.device:
    """The device by name; None: CUDA where there is one, else the CPU."""
    device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
    if device.type == "cuda" and not torch.cuda.is_available():
        raise SystemExit("PyTorch sees no CUDA device: --device cpu trains without one")
    return device


def autocast(device: torch.device, bfloat16: bool) -> AbstractContextManager:
    """Convolutions in bfloat16, where wanted; parameters and sums stay float32."""
    return torch.autocast(device.type, torch.bfloat16, enabled=bfloat16)


def move(value: T, device: torch.device) -> T:
    """Tensors, None, and dataclasses of such, on the device."""
    if isinstance(value, torch.Tensor):
        return value.to(device, non_blocking=True)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = {field.name: move(getattr(value, field.name), device) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **parts)
    return value


def describe(device: torch.device) -> str:
    """For logs."""
    if device.type == "cuda":
        return f"{torch.cuda.get_device_name(device)}, {torch.cuda.mem_get_info(device)[1] / 2**30:.0f} GiB"
    return f"CPU, {torch.get_num_threads()} threads"
