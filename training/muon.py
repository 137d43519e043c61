# SPDX-License-Identifier: Apache-2.0
"""Muon beside AdamW: steps of convolutions along orthogonalised momentum.

A convolution's momentum, as a matrix of outputs by inputs, is replaced by the nearest matrix whose singular values are
all 1 (Jordan et al. 2024, by Newton-Schulz iterations), so that directions seen rarely are learnt as fast as others.
Scaled as in Liu et al. 2025 to the size of AdamW's steps, both take the same learning rate.
"""

from __future__ import annotations

import torch
from torch import Tensor

MOMENTUM = 0.95
STEP_SIZE = 0.2  # root mean square of an AdamW step, in learning rates
NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)
ITERATIONS = 5
DECAY = 1e-4  # of weights, in learning rates


def orthogonalise(matrix: Tensor) -> Tensor:
    """About U V^T of matrix [r,c] = U S V^T: singular values between 0.7 and 1.2."""
    a, b, c = NEWTON_SCHULZ
    x = matrix.T if matrix.shape[0] > matrix.shape[1] else matrix
    x = x / (x.norm() + 1e-12)
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = a * x + (b * square + c * square @ square) @ x
    return x.T if matrix.shape[0] > matrix.shape[1] else x


class Muon(torch.optim.Optimizer):
    """Of weights of two dimensions or more; decay is AdamW's."""

    def __init__(self, params, lr: float, weight_decay: float) -> None:
        super().__init__(params, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is None:
                    continue
                momentum = self.state[p].setdefault("momentum", torch.zeros_like(p))
                momentum.lerp_(p.grad, 1 - MOMENTUM)
                ahead = p.grad.lerp(momentum, MOMENTUM).flatten(1)
                update = orthogonalise(ahead) * (STEP_SIZE * max(ahead.shape) ** 0.5)
                p.mul_(1 - group["lr"] * group["weight_decay"])
                p.add_(update.view_as(p), alpha=-group["lr"])


def split_parameters(model: torch.nn.Module) -> tuple[list[Tensor], list[Tensor]]:
    """Weights of the body's convolutions, and the rest: heads, embeddings, biases and tables are no matrices whose
    directions are alike."""
    body = ("net.stem.", "net.down.", "net.encoder.", "net.up.", "net.decoder.", "net.detail_in.", "net.detail_mid.")
    matrices, rest = [], []
    for name, p in model.named_parameters():
        (matrices if p.dim() == 4 and name.startswith(body) else rest).append(p)
    return matrices, rest


def make_optimisers(model: torch.nn.Module, muon: bool, rate: float) -> list[torch.optim.Optimizer]:
    """AdamW, for the body's convolutions Muon if wanted."""
    matrices, rest = split_parameters(model) if muon else ([], list(model.parameters()))
    optimisers: list[torch.optim.Optimizer] = [torch.optim.AdamW(rest, lr=rate, betas=(0.9, 0.99), weight_decay=DECAY)]
    return optimisers + ([Muon(matrices, rate, DECAY)] if muon else [])
