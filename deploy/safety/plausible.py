"""The gate before the rules: a sample that no movement leads to is neither believed nor shown to actor and rules."""

from dataclasses import replace

import numpy as np

from deploy.safety.imu_gate import ImuGate
from deploy.safety.rules import Sample, TripRule
from deploy.safety.settings import PlausibilitySettings
from hal.contract.types import RobotState
from robot.robot import Robot

Sight = tuple[np.ndarray, np.ndarray, np.ndarray]  # positions, speeds, when they were measured


class JointGate:
    """Position and speed of a joint against those before: neither too fast, and one the integral of the other.

    A joint whose sample is not believed keeps the values before it with their true age. `suspect` (J,) marks it, so
    that its last target is held; `detail` says what was wrong. Saying it again makes it no truer. A value that is not
    a number passes: another rule trips on it at once.
    """

    def __init__(self, robot: Robot, settings: PlausibilitySettings, period_s: float) -> None:
        self.detail = ""
        self.suspect = np.zeros(robot.num_joints, dtype=bool)
        self._names = robot.joint_names
        self._period_s = period_s
        self._fastest_rad_s = robot.vel_limit_rad_s * settings.speed
        self._mismatch_rad_s = robot.vel_limit_rad_s * settings.mismatch
        self._before: Sight | None = None
        self._seen: Sight | None = None

    def believed(self, state: RobotState) -> RobotState:
        """The state itself, or one in which the suspects are as they were last believed."""
        pos_rad, vel_rad_s, measured_s = state.joint_pos_rad, state.joint_vel_rad_s, state.time_s - state.joint_age_s
        new = pos_rad, vel_rad_s, measured_s
        gap_s = self._period_s if self._seen is None else np.maximum(measured_s - self._seen[2], self._period_s)
        self._seen = new
        if self._before is None:
            self._before = new
            return state
        pos_before_rad, vel_before_rad_s, before_s = self._before
        elapsed_s = np.maximum(measured_s - before_s, 0.0)
        step_rad = pos_rad - pos_before_rad
        # An impact stops a moving joint anywhere between two samples: up to half its speed off their mean.
        allowed_rad_s = self._mismatch_rad_s + 0.5 * np.abs(vel_before_rad_s)
        mean_rad_s = 0.5 * (vel_rad_s + vel_before_rad_s)
        self.suspect = (
            (np.abs(vel_rad_s) > self._fastest_rad_s)
            | (np.abs(step_rad) > self._fastest_rad_s * gap_s)
            | (np.abs(step_rad - mean_rad_s * elapsed_s) > allowed_rad_s * gap_s)
        )
        self.detail = ""
        if self.suspect.any():
            joint = int(np.argmax(self.suspect))
            self.detail = (
                f"{self._names[joint]} goes from {pos_before_rad[joint]:.2f} to {pos_rad[joint]:.2f} rad in"
                f" {elapsed_s[joint] * 1e3:.0f} ms at {vel_rad_s[joint]:.1f} rad/s"
            )
            pos_rad, vel_rad_s, measured_s = (np.where(self.suspect, *pair) for pair in zip(self._before, new))
            age_s = state.time_s - measured_s
            state = replace(state, joint_pos_rad=pos_rad, joint_vel_rad_s=vel_rad_s, joint_age_s=age_s)
        self._before = pos_rad, vel_rad_s, measured_s
        return state

    def reset(self) -> None:
        """The joints rest: whatever was seen last is where they are."""
        self._before = self._seen


class Plausibility(TripRule):
    """Both gates as one rule: samples in a row that are not believed, of whatever joint or of the IMU."""

    name = "implausible"
    moving = True

    def __init__(self, robot: Robot, settings: PlausibilitySettings, period_s: float, ticks: int) -> None:
        self.ticks = ticks
        self._joints = JointGate(robot, settings, period_s)
        self._imu = ImuGate(settings.base_rad_s, settings.base_quiet_rad_s, settings.base_mismatch_rad_s, period_s)

    @property
    def suspect(self) -> np.ndarray:
        """(J,) whether a joint's sample is not believed."""
        return self._joints.suspect

    def believed(self, state: RobotState) -> RobotState:
        """The state, with the values before in place of those that are not believed."""
        return self._imu.believed(self._joints.believed(state))

    def reset(self) -> None:
        """The robot rests: the latest samples are the truth."""
        self._joints.reset()
        self._imu.reset()

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return self._joints.detail or self._imu.detail or None
