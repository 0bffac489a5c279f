"""What PPO minimises: a sum of named losses. Another one is a class here and a line in ``learner.losses``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from core.errors import InputError
from train.learner.gaussian import entropy, log_prob
from train.learner.settings import LearnerSettings
from train.learner.storage import Minibatch


@dataclass(frozen=True)
class Prediction:
    """What the networks say now of n samples, as they were recorded: mean (n, J), log_std (J,), values (n, H)."""

    samples: Minibatch
    mean: Tensor
    log_std: Tensor
    values: Tensor


class Loss(Protocol):
    """One entry of the sum."""

    def __call__(self, now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
        """The loss () and figures () for the log."""
        ...


class Surrogate:
    """PPO's clipped policy loss (Schulman et al., 2017, Eq. 7)."""

    def __init__(self, settings: LearnerSettings) -> None:
        self._clip = settings.clip

    def __call__(self, now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
        """See :class:`Loss`."""
        samples = now.samples
        ratio = torch.exp(log_prob(samples["actions"], now.mean, now.log_std) - samples["log_prob"])
        loss = clipped_surrogate(ratio, samples["advantages"], self._clip)
        clipped = ((ratio.detach() - 1.0).abs() > self._clip).float().mean()
        return loss, {"policy_loss": loss, "clip_fraction": clipped}


class ClippedValue:
    """The critic's squared error, summed over heads."""

    def __init__(self, settings: LearnerSettings) -> None:
        self._clip = settings.clip

    def __call__(self, now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
        """See :class:`Loss`."""
        loss = clipped_value_loss(now.values, now.samples["values"], now.samples["returns"], self._clip)
        return loss, {"value_loss": loss}


class Entropy:
    """What keeps the noise wide: the policy's entropy with a minus."""

    def __init__(self, settings: LearnerSettings) -> None:
        del settings

    def __call__(self, now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
        """See :class:`Loss`."""
        value = entropy(now.log_std)
        return -value, {"entropy": value}


LOSSES: Mapping[str, Callable[[LearnerSettings], Loss]] = {
    "surrogate": Surrogate,
    "value": ClippedValue,
    "entropy": Entropy,
}


def check_losses(weights: Mapping[str, float]) -> None:
    """InputError for the name of a loss that there is not."""
    for name in weights:
        if name not in LOSSES:
            raise InputError("unknown loss", where=f"learner.losses.{name}", expected="one of " + ", ".join(LOSSES))


@dataclass(frozen=True)
class WeightedSum:
    """Losses with their weights, in order."""

    entries: tuple[tuple[float, Loss], ...]

    @classmethod
    def of(cls, settings: LearnerSettings) -> "WeightedSum":
        """Those of ``learner.losses``."""
        return cls(tuple((weight, LOSSES[name](settings)) for name, weight in settings.losses.items()))

    def __call__(self, now: Prediction) -> tuple[Tensor, dict[str, Tensor]]:
        """See :class:`Loss`."""
        total, figures = torch.zeros((), device=now.mean.device), dict[str, Tensor]()
        for weight, loss in self.entries:
            value, seen = loss(now)
            total = total + weight * value
            figures |= seen
        return total, figures


def clipped_surrogate(ratio: Tensor, advantages: Tensor, clip: float) -> Tensor:
    """PPO's policy loss for probability ratios (n,) and advantages (n,)."""
    gain = torch.minimum(advantages * ratio, advantages * ratio.clamp(1.0 - clip, 1.0 + clip))
    return -gain.mean()


def clipped_value_loss(values: Tensor, old_values: Tensor, returns: Tensor, clip: float) -> Tensor:
    """Squared error of values (n, H), the worse of plain and clipped move; mean over samples, summed over heads."""
    near = old_values + (values - old_values).clamp(-clip, clip)
    return torch.maximum((values - returns).square(), (near - returns).square()).sum(dim=-1).mean()
