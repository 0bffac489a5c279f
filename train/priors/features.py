"""What the base action knows and the network may look at: where in the clip, and how far off the nominal motion."""

import torch
from torch import nn

from train.phase_basis import phase_hats
from train.priors.estimator import DEVIATION_CLIP, DEVIATION_SCALE, LAST_ACTION_SCALE, Deviation


class NominalFeatures(nn.Module):
    """(B, knots + 3+3+J+J + J + drift): phase hats, scaled deviations of state and last action, drift.

    ``size`` is its width, ``unseen`` that of the observation's last columns, which only the drift looks at.
    """

    scale: torch.Tensor

    def __init__(self, deviation: Deviation, knots: int) -> None:
        super().__init__()
        self._knots = knots
        joints = deviation.actions.shape[1]
        scale = torch.cat([deviation.scale * DEVIATION_SCALE, torch.full((joints,), LAST_ACTION_SCALE)])
        self.register_buffer("scale", scale)
        self.size = knots + len(scale) + deviation.drift_size
        self.unseen = 0 if deviation.drift is None else deviation.drift.width

    def forward(self, phase: torch.Tensor, deviation: torch.Tensor, drift: torch.Tensor) -> torch.Tensor:
        """Of phases (B,) and what :class:`train.priors.estimator.Deviation` found there."""
        deviation = (deviation * self.scale).clamp(-DEVIATION_CLIP, DEVIATION_CLIP)
        return torch.cat([phase_hats(phase, self._knots), deviation, drift], dim=1)
