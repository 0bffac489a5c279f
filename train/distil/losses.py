"""What a student minimises: a sum of named losses. Another one is a function here and a line in ``distil.losses``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from train.distil.ramp import Ramp


@dataclass(frozen=True)
class Prediction:
    """What a student says of n samples.

    Attributes:
        action: (n, J) raw.
        label: (n, J) what the teacher would do.
        kl: () mean divergence of what the student infers from all it sees in training from what it infers without the
            teacher's view; 0 of a student without a latent.
        figures: () each, for people.
    """

    action: Tensor
    label: Tensor
    kl: Tensor
    figures: Mapping[str, Tensor] = field(default_factory=dict)


def action(now: Prediction) -> Tensor:
    """Mean squared difference from the teacher's action, over samples and joints (MaskedMimic, Eq. 8, first term)."""
    return (now.action - now.label).square().mean()


def kl(now: Prediction) -> Tensor:
    """The divergence (MaskedMimic, Eq. 8, second term)."""
    return now.kl


LOSSES: Mapping[str, Callable[[Prediction], Tensor]] = {"action": action, "kl": kl}


@dataclass(frozen=True)
class WeightedLosses:
    """Losses with weights that follow the iterations."""

    weights: Mapping[str, Ramp]

    def __call__(self, now: Prediction, iteration: int) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum () and each loss (), ``distil/NAME``."""
        values = {name: LOSSES[name](now) for name in self.weights}
        total = torch.zeros((), device=now.action.device)
        for name, value in values.items():
            total = total + self.weights[name].at(iteration) * value
        return total, {f"distil/{name}": value for name, value in {**values, "loss": total, **now.figures}.items()}
