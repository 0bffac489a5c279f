"""What the base action knows and the network may look at: where in the clip, and how far off the nominal motion."""

import torch
from torch import nn

from train.base_action.estimator import Deviation, interpolate
from train.phase_basis import phase_hats

DEVIATION_SCALE = 3.0
LAST_ACTION_SCALE = 0.5
DEVIATION_CLIP = 10.0


class NominalFeatures(nn.Module):
    """Observations (B, 380+) → (B, knots + 3+3+J+J + J): phase hats, scaled deviations of state and last action.

    With ``drift``, its mean deviations of earlier ticks as well.
    """

    scale: torch.Tensor

    def __init__(
        self, deviation: Deviation, phase_column: int, stretch: float, knots: int, drift: "Drift | None" = None
    ) -> None:
        super().__init__()
        self.deviation, self.drift = deviation, drift
        self._phase_column, self._stretch, self._knots = phase_column, stretch, knots
        joints = deviation.action.shape[0]
        scale = torch.cat([deviation.scale * DEVIATION_SCALE, torch.full((joints,), LAST_ACTION_SCALE)])
        self.register_buffer("scale", scale)
        self.size = knots + len(scale) + (0 if drift is None else drift.size)
        self.unseen = 0 if drift is None else drift.width

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """See the class."""
        phase = (observation[:, self._phase_column] * self._stretch).clamp(0.0, 1.0)
        deviation = self.deviation(observation, phase) * self.scale
        seen = [phase_hats(phase, self._knots), deviation.clamp(-DEVIATION_CLIP, DEVIATION_CLIP)]
        return torch.cat(seen if self.drift is None else [*seen, self.drift(observation, phase)], dim=1)


class Drift(nn.Module):
    """Mean deviation (B, blocks · (J+J+3)) of actions, joints and gravity over blocks of earlier ticks, scaled.

    Torques, masses and a centre of mass that are not the nominal ones show in what a robot leans to for a second; five
    noisy ticks hide them. A block that begins before the start counts for nothing.

    Args:
        blocks: the lags of each block, rising; the last columns of the observation hold them term by term
            (:func:`policy.observation.pbhc_actor_group`).
        joints: J.
        reference: (T, 3+3+J+J + J) see :class:`train.base_action.estimator.Deviation`.
    """

    scale: torch.Tensor

    def __init__(self, blocks: tuple[tuple[int, ...], ...], joints: int, reference: torch.Tensor) -> None:
        super().__init__()
        self._counts, self._joints = [len(block) for block in blocks], joints
        self.size = len(blocks) * (2 * joints + 3)
        self.width = sum(self._counts) * (2 * joints + 3)
        gravity, _, positions, _, actions = reference.split([3, 3, joints, joints, joints], dim=1)
        wanted, ticks = torch.cat([actions, positions, gravity], dim=1), torch.arange(len(reference))
        for number, block in enumerate(blocks):
            rows = [wanted[(ticks - lag).clamp(min=0)] for lag in block]
            self.register_buffer(f"wanted_{number}", torch.stack(rows).mean(dim=0))
        scale = torch.full((2 * joints + 3,), DEVIATION_SCALE)
        scale[:joints] = LAST_ACTION_SCALE
        self.register_buffer("scale", scale)

    def forward(self, observation: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        """Of observations (B, 380 + width) at phases (B,)."""
        older, lags = observation[:, -self.width :], sum(self._counts)
        sizes = [self._joints, self._joints, 3]
        terms = older.split([lags * size for size in sizes], dim=1)
        seen = torch.cat([term.reshape(-1, lags, size) for term, size in zip(terms, sizes, strict=True)], dim=2)
        drifts = []
        for number, block in enumerate(seen.split(self._counts, dim=1)):
            known = (block[:, -1, -3:].square().sum(dim=1, keepdim=True) > 0.25).to(block.dtype)
            deviation = block.mean(dim=1) - interpolate(getattr(self, f"wanted_{number}"), phase)
            drifts.append((deviation * self.scale * known).clamp(-DEVIATION_CLIP, DEVIATION_CLIP))
        return torch.cat(drifts, dim=1)
