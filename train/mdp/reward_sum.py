"""The reward columns of a step: each term times its weight times the control period."""

from collections.abc import Mapping

import torch

from train.batch import Device
from train.mdp.adaptive_sigma import AdaptiveSigma
from train.mdp.rewards import DIRECT, TRACKING
from train.mdp.settings import RewardTerm
from train.mdp.tick import StepOutcome


class RewardSum:
    """Evaluates the listed terms.

    Args:
        terms: name → weight and parameters, in the order of the columns.
        sigma_alpha, adaptive: see :class:`train.mdp.adaptive_sigma.AdaptiveSigma`.
        step_max: bound on each curriculum penalty's cost per step; None: there is none.
        dt_s: control period.
        device: where the robots are.
    """

    def __init__(
        self,
        terms: Mapping[str, RewardTerm],
        *,
        sigma_alpha: float,
        adaptive: bool,
        step_max: float | None,
        dt_s: float,
        device: Device,
    ) -> None:
        self.names, self._step_max = tuple(terms), step_max
        start = {name: float(term.sigma or 0.0) for name, term in terms.items() if name in TRACKING}
        self.sigma = AdaptiveSigma(start, sigma_alpha, adaptive=adaptive, device=device)
        self._tracking = [TRACKING.bound(name, terms[name].params) for name in start]
        self._tracking_index = torch.tensor([self.names.index(name) for name in start], device=device)
        self._direct = [
            (column, DIRECT.bound(name, terms[name].params)) for column, name in enumerate(terms) if name in DIRECT
        ]
        self._weight = torch.tensor([term.weight for term in terms.values()], device=device) * dt_s
        self._in_curriculum = torch.tensor([term.curriculum for term in terms.values()], device=device)

    def of(self, t: StepOutcome, penalty_scale: float) -> torch.Tensor:
        """The columns (B, R); σ tightens after they are worked out."""
        values = self._weight.new_empty(len(t.terminated), len(self.names))
        errors = torch.stack([term(t) for term in self._tracking], dim=1)
        values[:, self._tracking_index] = self.sigma.reward(errors)
        self.sigma.update(errors)
        for column, term in self._direct:
            values[:, column] = term(t)
        rewards = values * torch.where(self._in_curriculum, self._weight * penalty_scale, self._weight)
        if self._step_max is None:
            return rewards
        return torch.where(self._in_curriculum, rewards.clamp(min=-self._step_max), rewards)
