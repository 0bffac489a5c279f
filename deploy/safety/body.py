"""Rules on how the body moves: where its joints are, how fast, how hard they push, how the base leans and turns."""

import math

import numpy as np

from deploy.safety.rules import Sample, TripRule
from robot.robot import Robot


class PositionRange(TripRule):
    """A joint beyond its hard range by more than a margin."""

    name = "position_range"
    moving = True

    def __init__(self, robot: Robot, margin_rad: float, ticks: int) -> None:
        self.ticks = ticks
        self._names = robot.joint_names
        self._lower_rad, self._upper_rad = robot.pos_lower_rad - margin_rad, robot.pos_upper_rad + margin_rad

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        pos = sample.state.joint_pos_rad
        outside = (pos < self._lower_rad) | (pos > self._upper_rad)
        if not outside.any():
            return None
        joint = int(np.argmax(outside))
        bounds = f"[{self._lower_rad[joint]:.2f}, {self._upper_rad[joint]:.2f}]"
        return f"{self._names[joint]} at {pos[joint]:.2f} rad, allowed {bounds}"


class JointSpeed(TripRule):
    """A joint faster than a share of its speed limit."""

    name = "joint_speed"
    moving = True

    def __init__(self, robot: Robot, factor: float, ticks: int) -> None:
        self.ticks = ticks
        self._names = robot.joint_names
        self._limit_rad_s = robot.vel_limit_rad_s * factor

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        excess = np.abs(sample.state.joint_vel_rad_s) - self._limit_rad_s
        if not excess.max() > 0.0:
            return None
        joint = int(np.argmax(excess))
        speed = sample.state.joint_vel_rad_s[joint]
        return f"{self._names[joint]} at {speed:.1f} rad/s, limit {self._limit_rad_s[joint]:.1f}"


class Tilt(TripRule):
    """The base leans too far."""

    name = "tilt"
    moving = True

    def __init__(self, max_rad: float, ticks: int) -> None:
        self.ticks = ticks
        self._max_rad = max_rad

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return f"{sample.tilt_rad:.2f} rad, limit {self._max_rad:.2f}" if sample.tilt_rad > self._max_rad else None


class BaseRate(TripRule):
    """The base turns too fast about whatever axis: a body that falls."""

    name = "base_rate"
    moving = True

    def __init__(self, max_rad_s: float, ticks: int) -> None:
        self.ticks = ticks
        self._max_rad_s = max_rad_s

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        rate = math.hypot(*sample.state.imu_ang_vel_b.tolist())
        return f"{rate:.1f} rad/s, limit {self._max_rad_s:.1f}" if rate > self._max_rad_s else None


class TorqueSaturation(TripRule):
    """Several joints at once near the torques that they can give: a body that fights the ground or an obstacle."""

    name = "torque_saturation"
    moving = True

    def __init__(self, robot: Robot, factor: float, joints: int, ticks: int) -> None:
        self.ticks = ticks
        self._names = robot.joint_names
        self._joints = joints
        self._limit_nm = robot.torque_limit_nm * factor

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        saturated = np.flatnonzero(np.abs(sample.state.joint_torque_nm) >= self._limit_nm)
        if saturated.size < self._joints:
            return None
        names = ", ".join(self._names[joint] for joint in saturated)
        return f"{saturated.size} joints at their torque limits, allowed {self._joints - 1}: {names}"
