"""Random horizontal pushes."""

import torch

from train.mdp.settings import PushSettings
from train.simulation.domain import uniform
from train.simulation.simulator import Simulator


class Pushes:
    """Adds a random horizontal velocity to each robot at random intervals.

    Args:
        settings: velocity and interval.
        num_envs: B.
        dt_s: control period.
        generator: source of randomness.
    """

    def __init__(self, settings: PushSettings, num_envs: int, dt_s: float, generator: torch.Generator) -> None:
        self._settings, self._dt_s, self._generator = settings, dt_s, generator
        self.wait_s = uniform((num_envs,), 0.0, settings.interval_s[1], generator)

    def apply(self, simulator: Simulator, strength: float) -> None:
        """Count one control period; push the environments whose wait is over, with ``strength`` in [0, 1]."""
        if self._settings.velocity_m_s == 0.0:
            return
        self.wait_s -= self._dt_s
        due = (self.wait_s <= 0.0).nonzero()[:, 0]
        if len(due):
            self.wait_s[due] = uniform((len(due),), *self._settings.interval_s, self._generator)
            velocity = uniform((len(due), 2), -1.0, 1.0, self._generator) * self._settings.velocity_m_s
            simulator.push(due, velocity * strength)
