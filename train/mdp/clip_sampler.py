"""Which clip an episode tracks, and what is remembered of each clip."""

from collections.abc import Sequence

import torch

from train.batch import Device
from train.mdp.draws import choice
from train.mdp.settings import ClipSettings

MEMORY = 0.995  # per step, as of the failures


class ClipSampler:
    """Draws clips in proportion to how often robots fail in them.

    Args:
        settings: floor, cap.
        generator: source of randomness. A single clip draws nothing.
    """

    def __init__(self, settings: ClipSettings, generator: torch.Generator) -> None:
        self._settings, self._generator = settings, generator

    def shares(self, failing: torch.Tensor) -> torch.Tensor:
        """The chance (C,) to draw each clip; ``failing`` (C,): how often robots fail in it.

        By failure each gets its share of 1 − floor, at most cap times the uniform one; the rest is drawn uniformly.
        """
        uniform = torch.ones_like(failing) / len(failing)
        by_failure = (1.0 - self._settings.floor) * failing / failing.sum().clamp(min=1e-12)
        by_failure = torch.minimum(by_failure, self._settings.cap * uniform)
        return by_failure + (1.0 - by_failure.sum()) * uniform

    def draw(self, env_ids: torch.Tensor, failing: torch.Tensor) -> torch.Tensor:
        """Clips (n,) for new episodes of robots ``env_ids`` (n,)."""
        if self._settings.in_turn or len(failing) == 1:
            return env_ids % len(failing)
        return choice(self.shares(failing).expand(len(env_ids), -1), self._generator)


class ClipFigures:
    """Running means of each clip, over about the last 200 steps."""

    def __init__(self, names: Sequence[str], device: Device) -> None:
        self._names = names
        self._totals = torch.zeros(4, len(names), dtype=torch.float64, device=device)

    def update(
        self, clip: torch.Tensor, error_mm: torch.Tensor, ended: torch.Tensor, length_ratio: torch.Tensor
    ) -> None:
        """Take in a step of robots in clips (B,): body errors (B,), which episodes end (B,), and how far they came."""
        rows = torch.stack([torch.ones_like(error_mm), error_mm, ended.float(), ended * length_ratio]).double()
        self._totals.mul_(MEMORY).index_add_(1, clip, rows)

    def named(self, survival: torch.Tensor) -> dict[str, float]:
        """``clip/NAME/…``: survival (C,), mean body error and how far episodes come, of what was seen lately."""
        steps, error, episodes, length = self._totals.cpu()
        found = {}
        for i, name in enumerate(self._names):
            found[f"clip/{name}/survival"] = float(survival[i])
            if steps[i] > 0.0:
                found[f"clip/{name}/empbpe_mm"] = float(error[i] / steps[i])
            if episodes[i] > 0.0:
                found[f"clip/{name}/episode_length_ratio"] = float(length[i] / episodes[i])
        return found

    def state_dict(self) -> dict[str, torch.Tensor]:
        """The totals."""
        return {"totals": self._totals.clone()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._totals.copy_(state["totals"])
