"""What a student minimises: a sum of named losses. Another one is a function here and a line in ``distil.losses``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from train.distil.ramp import Ramp


@dataclass(frozen=True)
class Prediction:
    """What a student says of n samples.

    Attributes:
        action: (n, J) raw, of all that it sees in training.
        deployed: (n, J) raw, as it acts on a robot.
        label: (n, J) what the teacher would do.
        kl: () mean divergence of what the student infers from all it sees in training from what it infers without the
            teacher's view; 0 of a student without a latent.
    """

    action: Tensor
    deployed: Tensor
    label: Tensor
    kl: Tensor


def action(now: Prediction) -> Tensor:
    """Mean squared difference from the teacher's action, over samples and joints (MaskedMimic, Eq. 8, first term)."""
    return (now.action - now.label).square().mean()


def deployed(now: Prediction) -> Tensor:
    """The same of the action as deployed. The divergence does not teach it, as the encoder adds to the prior's mean."""
    return (now.deployed - now.label).square().mean()


def kl(now: Prediction) -> Tensor:
    """The divergence (MaskedMimic, Eq. 8, second term)."""
    return now.kl


LOSSES: Mapping[str, Callable[[Prediction], Tensor]] = {"action": action, "deployed": deployed, "kl": kl}


@dataclass(frozen=True)
class WeightedLosses:
    """Losses with weights that follow the iterations."""

    weights: Mapping[str, Ramp]

    def __call__(self, now: Prediction, iteration: int) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum () of those that count, and each of :data:`LOSSES` (), ``distil/NAME``."""
        values = {name: loss(now) for name, loss in LOSSES.items()}
        total = torch.zeros((), device=now.action.device)
        for name, ramp in self.weights.items():
            if weight := ramp.at(iteration):
                total = total + weight * values[name]
        return total, {f"distil/{name}": value for name, value in {**values, "loss": total}.items()}
