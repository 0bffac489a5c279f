"""Figures of the running training: errors in the units of the evaluation, episode lengths, tolerances."""

from typing import TYPE_CHECKING

import torch

from train.mdp.tick import Tick

if TYPE_CHECKING:
    from train.mdp.tracking import TrackingEnv

EPISODE_MEMORY = 0.01


def tracking_errors(t: Tick) -> dict[str, torch.Tensor]:
    """Eg-mpbpe and Empbpe in mm and Empjpe in 10⁻³ rad (PBHC D.2), one value (B,) per environment."""
    difference = t.bodies.pos_w - t.reference.body_pos_w
    relative = difference - (t.physics.root_pos_w - t.reference.root_pos_w)[:, None]
    return {
        "eg_mpbpe_mm": 1e3 * difference.norm(dim=-1).mean(dim=1),
        "empbpe_mm": 1e3 * relative.norm(dim=-1).mean(dim=1),
        "empjpe_mrad": 1e3 * (t.physics.joint_pos_rad - t.reference.joint_pos_rad).norm(dim=1),
    }


class TrackingLog:
    """Turns steps into named figures; episode figures are running means over about 100 episodes."""

    def __init__(self) -> None:
        self.episode_length_ratio = 0.0

    def episodes(self, env: "TrackingEnv", ended: torch.Tensor) -> None:
        """Take in the episodes that end in this step, before they are reset."""
        if not ended.any():
            return
        possible = (env.last_tick[env.clip[ended]] - env.start_tick[ended]).clamp(max=env.most_steps)
        ratio = float((env.episode_steps[ended] / possible).mean())
        weight = 1.0 - (1.0 - EPISODE_MEMORY) ** int(ended.sum())
        self.episode_length_ratio += weight * (ratio - self.episode_length_ratio)

    def step(self, env: "TrackingEnv") -> dict[str, float]:
        """Return the figures of this step, over all environments."""
        return {
            **{name: float(values.mean()) for name, values in env.last_errors.items()},
            "diverged": float(env.diverged.float().mean()),
            "episode_length_ratio": self.episode_length_ratio,
            "survival_of_uniform_starts": env.uniform_average.survival,
            "survival_chance": env.survival_chance,
            "error_limit_m": env.error_limit.value,
            "penalty_scale": env.penalty_scale.value,
            "randomization": env.simulator.randomization,
            **{f"sigma/{name}": float(value) for name, value in zip(env.sigma.names, env.sigma.sigma)},
        }
