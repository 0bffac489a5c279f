"""Random numbers that are the same on every device: drawn where the generator is, then moved."""

from collections.abc import Sequence

import torch

from train.batch import Device


def rand(shape: Sequence[int], generator: torch.Generator, device: Device) -> torch.Tensor:
    """Float32 U(0, 1)."""
    return torch.rand(tuple(shape), generator=generator, device=generator.device).to(device)


def uniform(shape: Sequence[int], low: float, high: float, generator: torch.Generator, device: Device) -> torch.Tensor:
    """Float32 U(low, high)."""
    return low + (high - low) * rand(shape, generator, device)


def normal(shape: Sequence[int], std: float, generator: torch.Generator, device: Device) -> torch.Tensor:
    """Float32 N(0, std²)."""
    return std * torch.randn(tuple(shape), generator=generator, device=generator.device).to(device)


def whole(low: int, high: int, number: int, generator: torch.Generator, device: Device) -> torch.Tensor:
    """Whole numbers (number,), from ``low`` on and below ``high``, each with the same chance."""
    return torch.randint(low, high, (number,), generator=generator, device=generator.device).to(device)


def one_of(weights: torch.Tensor, number: int, generator: torch.Generator) -> torch.Tensor:
    """Places (number,) in ``weights`` (K,), drawn in proportion; on the device of ``weights``."""
    drawn = torch.multinomial(weights.to(generator.device), number, replacement=True, generator=generator)
    return drawn.to(weights.device)


def choice(weights: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """One column (n,) of each row of ``weights`` (n, K), drawn in proportion; on the device of ``weights``."""
    drawn = torch.multinomial(weights.to(generator.device), 1, generator=generator)
    return drawn[:, 0].to(weights.device)
