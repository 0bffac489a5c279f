"""Adaptive tolerance of the tracking rewards (PBHC Eq. 4 and Eq. 8)."""

from collections.abc import Mapping

import torch

from train.batch import Device


class AdaptiveSigma:
    """One tolerance per tracking term, tightened towards the running mean of that term's error.

    Args:
        start: term name → σ at the start (also the start of the running mean).
        alpha: weight of a new error in the running mean, per environment step.
        adaptive: ``False`` keeps σ fixed.
        device: where the errors are.
    """

    def __init__(
        self, start: Mapping[str, float], alpha: float = 1e-3, *, adaptive: bool = True, device: Device = "cpu"
    ) -> None:
        self.names = tuple(start)
        self.sigma = torch.tensor(list(start.values()), dtype=torch.float64, device=device)
        self.mean_error = self.sigma.clone()
        self._alpha, self._adaptive = alpha, adaptive

    def reward(self, errors: torch.Tensor) -> torch.Tensor:
        """Return exp(−error/σ) for errors (B, T) in the order of ``names``."""
        return torch.exp(-errors / self.sigma.to(errors.dtype))

    def update(self, errors: torch.Tensor) -> None:
        """Take in one step's errors (B, T): x̂ ← (1−α)x̂ + α·mean(e), then σ ← min(σ, x̂)."""
        if not self._adaptive:
            return
        self.mean_error += self._alpha * (errors.mean(dim=0).double() - self.mean_error)
        self.sigma = torch.minimum(self.sigma, self.mean_error)

    def restart(self) -> None:
        """Begin again at the present mean errors: harder conditions allow larger ones than were reached before."""
        if self._adaptive:
            self.sigma = self.mean_error.clone()

    def state_dict(self) -> dict[str, torch.Tensor]:
        """σ and the running means."""
        return {"sigma": self.sigma.clone(), "mean_error": self.mean_error.clone()}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.sigma.copy_(state["sigma"])
        self.mean_error.copy_(state["mean_error"])
