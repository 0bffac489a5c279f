"""Muon: a matrix moves by its momentum made orthogonal, so that no direction of it learns much faster than another.

torch has it too (`torch.optim.Muon`), in bf16 only, which most processors have to emulate.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

# Of the iteration x → ax + b(xxᵀ)x + c(xxᵀ)²x, which brings singular values from (0, 1] to about 1 (K. Jordan 2024).
COEFFICIENTS = (3.4445, -4.7750, 2.0315)
ITERATIONS = 5
MOMENTUM = 0.9
# An orthogonal (n, m) has entries of 1/√max(n, m) in the mean square; Adam's steps are about 0.2 of its rate (J. Liu,
# "Muon is scalable for LLM training", section 2.2). So one rate serves for both.
STEP = 0.2


def orthogonal(matrix: Tensor) -> Tensor:
    """The matrix (n, m) with all its singular values between 0.7 and 1.2, but those that are next to nothing."""
    a, b, c = COEFFICIENTS
    x = matrix / matrix.norm().clamp(min=1e-7)
    for _ in range(ITERATIONS):
        square = x @ x.T
        x = a * x + (b * square + c * square @ square) @ x
    return x


class Muon(torch.optim.Optimizer):
    """Of matrices (n, m), by Nesterov's momentum.

    Args:
        matrices: parameters of two dimensions; there may be none.
        lr: the rate, in Adam's measure.
    """

    def __init__(self, matrices: Sequence[Tensor], lr: float) -> None:
        super().__init__([{"params": list(matrices)}], {"lr": lr})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """Move the matrices that have gradients; there is no closure."""
        for group in self.param_groups:
            for matrix in group["params"]:
                if matrix.grad is None:
                    continue
                state = self.state[matrix]
                momentum = state.setdefault("momentum", torch.zeros_like(matrix))
                momentum.lerp_(matrix.grad, 1.0 - MOMENTUM)
                step = orthogonal(matrix.grad.lerp(momentum, MOMENTUM))
                matrix.sub_(step, alpha=STEP * max(matrix.shape) ** 0.5 * group["lr"])
