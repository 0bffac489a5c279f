"""Figures of the running training: errors in the units of the evaluation, and how long episodes last."""

from dataclasses import dataclass

import torch

from train.mdp.tick import StepOutcome

EPISODE_MEMORY = 0.01


def tracking_errors(t: StepOutcome) -> dict[str, torch.Tensor]:
    """Eg-mpbpe and Empbpe in mm and Empjpe in 10⁻³ rad (PBHC D.2), one value (B,) per environment."""
    difference = t.bodies.pos_w - t.reference.body_pos_w
    relative = difference - (t.physics.root_pos_w - t.reference.root_pos_w)[:, None]
    return {
        "eg_mpbpe_mm": 1e3 * difference.norm(dim=-1).mean(dim=1),
        "empbpe_mm": 1e3 * relative.norm(dim=-1).mean(dim=1),
        "empjpe_mrad": 1e3 * (t.physics.joint_pos_rad - t.reference.joint_pos_rad).norm(dim=1),
    }


@dataclass
class LengthRatio:
    """Running mean, over about 100 episodes, of how much of what they could last they lasted."""

    value: float = 0.0

    def update(self, ratios: torch.Tensor) -> None:
        """Take in the episodes that end in this step (n,)."""
        if len(ratios):
            weight = 1.0 - (1.0 - EPISODE_MEMORY) ** len(ratios)
            self.value += weight * (float(ratios.mean()) - self.value)
