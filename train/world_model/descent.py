"""How the world model and the policy follow their gradients: one step, of all parameters of a network."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from train.world_model.muon import Muon

LARGEST = 1.0  # norm of the whole gradient


class Descent:
    """Some matrices by Muon, everything else by Adam; a gradient that is not finite changes nothing.

    Args:
        module: whose parameters are followed.
        matrices: those of its parameters that go by Muon.
        learning_rate: of both.
        betas: Adam's.
    """

    def __init__(
        self, module: nn.Module, matrices: Sequence[Tensor], learning_rate: float, betas: tuple[float, float]
    ) -> None:
        self.parameters, self.skipped = list(module.parameters()), 0
        theirs = {id(matrix) for matrix in matrices}
        others = [parameter for parameter in self.parameters if id(parameter) not in theirs]
        self._optimizers = (Muon(matrices, learning_rate), torch.optim.Adam(others, lr=learning_rate, betas=betas))

    def set_rate(self, learning_rate: float) -> None:
        """The rate that counts from now on."""
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = learning_rate

    def step(self, loss: Tensor) -> Tensor:
        """Follow the gradient of ``loss``; its norm, a scalar. :attr:`skipped` counts what was not finite."""
        for parameter in self.parameters:
            parameter.grad = None
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, LARGEST)
        if torch.isfinite(norm):
            for optimizer in self._optimizers:
                optimizer.step()
        else:
            self.skipped += 1
        return norm

    def state_dict(self) -> dict[str, Any]:
        """Both optimisers and the count."""
        return {"optimizers": [o.state_dict() for o in self._optimizers], "skipped": self.skipped}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        for optimizer, its in zip(self._optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(its)
        self.skipped = state["skipped"]
