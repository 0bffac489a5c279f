"""Independent normals, one per action."""

import math

import torch
from torch import Tensor

_LOG_2PI = math.log(2.0 * math.pi)


def log_prob(actions: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Log density (n,) of actions (n, J)."""
    scaled = (actions - mean) * torch.exp(-log_std)
    return -0.5 * scaled.square().sum(dim=-1) - log_std.sum() - 0.5 * _LOG_2PI * actions.shape[-1]


def kl_divergence(old_mean: Tensor, old_log_std: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Mean over samples of KL(old ‖ new); means are (n, J)."""
    variance = torch.exp(2.0 * log_std)
    ratio = (torch.exp(2.0 * old_log_std) + (old_mean - mean).square()) / (2.0 * variance)
    return (log_std - old_log_std + ratio - 0.5).sum(dim=-1).mean()


def entropy(log_std: Tensor) -> Tensor:
    """Of log standard deviations (J,), in nats."""
    return (log_std + 0.5 * (_LOG_2PI + 1.0)).sum()
