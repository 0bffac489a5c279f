"""What the base action knows and the network may look at: where in the clip, and how far off the nominal motion."""

import torch
from torch import nn

from train.base_action.estimator import DEVIATION_CLIP, DEVIATION_SCALE, LAST_ACTION_SCALE, Deviation
from train.phase_basis import phase_hats


class NominalFeatures(nn.Module):
    """Observations (B, 380+) → (B, knots + 3+3+J+J + J): phase hats, scaled deviations of state and last action.

    Where the deviation looks at the drift of earlier ticks, that as well.
    """

    scale: torch.Tensor

    def __init__(self, deviation: Deviation, phase_column: int, stretch: float, knots: int) -> None:
        super().__init__()
        self.deviation, drift = deviation, deviation.drift
        self._phase_column, self._stretch, self._knots = phase_column, stretch, knots
        joints = deviation.actions.shape[1]
        scale = torch.cat([deviation.scale * DEVIATION_SCALE, torch.full((joints,), LAST_ACTION_SCALE)])
        self.register_buffer("scale", scale)
        self.size = knots + len(scale) + (0 if drift is None else drift.size)
        self.unseen = 0 if drift is None else drift.width

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """See the class."""
        phase = (observation[:, self._phase_column] * self._stretch).clamp(0.0, 1.0)
        deviation = self.deviation(observation, phase) * self.scale
        seen = [phase_hats(phase, self._knots), deviation.clamp(-DEVIATION_CLIP, DEVIATION_CLIP)]
        drift = self.deviation.drift
        return torch.cat(seen if drift is None else [*seen, drift(observation, phase)], dim=1)
