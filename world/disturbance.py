"""What happens to a simulated robot by itself, at steps of the physics.

An event has `at`, the step of its next act, and `act(step)`, which does it and sets `at` anew.
"""

from collections import deque
from typing import Protocol

import numpy as np

from world.actuation import JointCommand
from world.gantry import NEVER
from world.plant import Plant
from world.randomization import Conditions


class Event(Protocol):
    """Something that acts at given steps."""

    at: int

    def act(self, step: int) -> None:
        """Act, and set the next `at` (after `step`)."""
        ...


class CommandLine:
    """The wire to the motors: a command acts the delay after it was written."""

    def __init__(self, plant: Plant, conditions: Conditions) -> None:
        self._plant, self._conditions = plant, conditions
        self._waiting: deque[tuple[int, JointCommand]] = deque()
        self._delay_steps = int(np.ceil(conditions.command_delay_s / plant.model.opt.timestep - 1e-6))
        self.at = NEVER

    def send(self, step: int, command: JointCommand) -> None:
        """Written before `step`; acts on the first step that begins the delay later."""
        self._waiting.append((step + self._delay_steps, command))
        self.at = self._waiting[0][0]

    def cut(self, command: JointCommand) -> None:
        """Put a command in force now and forget what is on its way."""
        self._waiting.clear()
        self.at = NEVER
        self._plant.drive(command, self._conditions.kp_scale, self._conditions.kd_scale)

    def act(self, step: int) -> None:
        """Put the newest command that has arrived in force."""
        while self._waiting and self._waiting[0][0] <= step:
            command = self._waiting.popleft()[1]
        self._plant.drive(command, self._conditions.kp_scale, self._conditions.kd_scale)
        self.at = self._waiting[0][0] if self._waiting else NEVER


class Pushes:
    """Kicks of the whole robot, of one speed, in random horizontal directions."""

    def __init__(self, plant: Plant, conditions: Conditions, rng: np.random.Generator, step: int) -> None:
        self._plant, self._conditions, self._rng = plant, conditions, rng
        self.at = self._next(step) if conditions.push_speed_m_s > 0 else NEVER

    def act(self, step: int) -> None:
        """Kick."""
        angle_rad = self._rng.uniform(0.0, 2.0 * np.pi)
        self._plant.push(self._conditions.push_speed_m_s * np.array([np.cos(angle_rad), np.sin(angle_rad)]))
        self.at = self._next(step)

    def _next(self, step: int) -> int:
        interval_s = self._rng.uniform(*self._conditions.push_interval_s)
        return step + max(1, round(interval_s / self._plant.model.opt.timestep))


class TorqueNoise:
    """The constant offset and the noise that are added to the motors' torques."""

    def __init__(
        self, plant: Plant, conditions: Conditions, rng: np.random.Generator, hold_s: float, step: int
    ) -> None:
        self._plant, self._conditions, self._rng = plant, conditions, rng
        self._hold_steps = max(1, round(hold_s / plant.model.opt.timestep))
        active = conditions.torque_offset_nm.any() or conditions.torque_noise_nm.any()
        self.at = step if active else NEVER

    def act(self, step: int) -> None:
        """Draw new noise."""
        c = self._conditions
        noise_nm = c.torque_noise_nm * self._rng.uniform(-1.0, 1.0, c.torque_noise_nm.size)
        self._plant.disturb(c.torque_offset_nm + noise_nm)
        self.at = step + self._hold_steps
