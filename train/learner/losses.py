"""What PPO minimises: a sum of named losses. Another one is a function here and a line in ``learner.losses``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from core.errors import InputError
from train.learner import gaussian
from train.learner.storage import Minibatch


@dataclass(frozen=True)
class Prediction:
    """What the networks say now of n samples, as they were recorded: mean (n, J), log_std (J,), values (n, H).

    ``clip``: how far probability ratios and values move before moving further gains nothing.
    """

    samples: Minibatch
    mean: Tensor
    log_std: Tensor
    values: Tensor
    clip: float


Loss = Callable[[Prediction], tuple[Tensor, Mapping[str, Tensor]]]  # the loss () and figures () for the log


def surrogate(now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
    """PPO's clipped policy loss (Schulman et al., 2017, Eq. 7), and the share of samples that it clips."""
    samples = now.samples
    ratio = torch.exp(gaussian.log_prob(samples["actions"], now.mean, now.log_std) - samples["log_prob"])
    loss = clipped_surrogate(ratio, samples["advantages"], now.clip)
    clipped = ((ratio.detach() - 1.0).abs() > now.clip).float().mean()
    return loss, {"policy_loss": loss, "clip_fraction": clipped}


def value(now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
    """The critic's squared error, summed over heads."""
    loss = clipped_value_loss(now.values, now.samples["values"], now.samples["returns"], now.clip)
    return loss, {"value_loss": loss}


def entropy(now: Prediction) -> tuple[Tensor, Mapping[str, Tensor]]:
    """What keeps the noise wide: the policy's entropy with a minus."""
    width = gaussian.entropy(now.log_std)
    return -width, {"entropy": width}


LOSSES: Mapping[str, Loss] = {"surrogate": surrogate, "value": value, "entropy": entropy}


def check_losses(weights: Mapping[str, float]) -> None:
    """InputError for the name of a loss that there is not."""
    for name in weights:
        if name not in LOSSES:
            raise InputError("unknown loss", where=f"learner.losses.{name}", expected="one of " + ", ".join(LOSSES))


def weighted_sum(weights: Mapping[str, float], now: Prediction) -> tuple[Tensor, dict[str, Tensor]]:
    """The sum () of losses by their weights, in their order, and the figures of all."""
    total, figures = torch.zeros((), device=now.mean.device), dict[str, Tensor]()
    for name, weight in weights.items():
        loss, seen = LOSSES[name](now)
        total = total + weight * loss
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
