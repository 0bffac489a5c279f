"""Running normalisation of what networks see."""

import torch
from torch import Tensor, nn

INPUT_CLIP = 12.0  # parts that are mostly hidden, and zero, have a small deviation
LEAST_STD = 0.02  # what hardly varies is not blown up


class RunningNormalizer(nn.Module):
    """Subtracts the mean and divides by the standard deviation of all that was seen; clips at ± ``INPUT_CLIP``.

    Args:
        size: of the input.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size, device="cpu"))
        self.register_buffer("variance", torch.ones(size, device="cpu"))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64, device="cpu"))

    def forward(self, x: Tensor) -> Tensor:
        """(..., n) → (..., n)."""
        return ((x - self.mean) / self.variance.sqrt().clamp(min=LEAST_STD)).clamp(-INPUT_CLIP, INPUT_CLIP)

    @torch.no_grad()
    def update(self, x: Tensor) -> None:
        """Take in samples (m, n): means and variances of both parts, joined (Chan et al., 1983)."""
        total = self.count + len(x)
        share = (len(x) / total).float()
        away = x.mean(dim=0) - self.mean
        within = self.variance.lerp(x.var(dim=0, unbiased=False), share)
        self.variance.copy_(within + share * (1.0 - share) * away.square())
        self.mean.add_(share * away)
        self.count.copy_(total)
