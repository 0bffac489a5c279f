"""Rules on how the body moves: where its joints are, how fast, how hard they push, how the base leans and turns."""

import math

import numpy as np

from deploy.safety.rules import Sample, TripRule, up_in_base
from deploy.safety.settings import BaseRateSettings, JointSpeedSettings, TiltSettings
from robot.robot import Robot


def lean_away_rad(sample: Sample) -> float:
    """Angle between up as it is and as the clip asks, both seen from the base, or the tilt where that is less."""
    if sample.asked is None:
        return sample.tilt_rad
    cosine = float(up_in_base(sample.state.imu_quat_wxyz) @ sample.asked.up_b)
    return min(sample.tilt_rad, math.acos(min(1.0, max(-1.0, cosine))))


def turn_away_rad_s(sample: Sample) -> float:
    """Difference of the base's rate from what the clip asks, or the rate itself where that is less."""
    rate_b = sample.state.imu_ang_vel_b.tolist()
    asked_b = (0.0, 0.0, 0.0) if sample.asked is None else sample.asked.ang_vel_b.tolist()
    return min(math.hypot(*rate_b), math.dist(rate_b, asked_b))


def speed_away_rad_s(sample: Sample) -> np.ndarray:
    """Likewise of each joint's speed, (J,)."""
    speed = sample.state.joint_vel_rad_s
    asked = 0.0 if sample.asked is None else sample.asked.joint_vel_rad_s
    return np.minimum(np.abs(speed), np.abs(speed - asked))


class PositionRange(TripRule):
    """A joint beyond its hard range by more than a margin."""

    name = "position_range"
    moving = upright = True

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
    """A joint faster than the clip asks, by a share of its speed limit, or faster than any clip may ask."""

    name = "joint_speed"
    moving = upright = True

    def __init__(self, robot: Robot, settings: JointSpeedSettings, ticks: int) -> None:
        self.ticks = ticks
        self._names = robot.joint_names
        self._free_rad_s = robot.vel_limit_rad_s * settings.factor
        self._max_rad_s = robot.vel_limit_rad_s * settings.max_factor

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        speed = sample.state.joint_vel_rad_s
        if not (np.abs(speed) > self._free_rad_s).any():
            return None
        away = speed_away_rad_s(sample)
        excess = np.maximum(away - self._free_rad_s, np.abs(speed) - self._max_rad_s)
        joint = int(np.argmax(excess))
        if not excess[joint] > 0.0:
            return None
        most, free = self._max_rad_s[joint], self._free_rad_s[joint]
        return f"{self._names[joint]} at {speed[joint]:.1f} rad/s, {_limits(away[joint], free, most)}"


class Tilt(TripRule):
    """The base leans too far, and not because the clip asks it to; or farther than any clip may ask."""

    name = "tilt"
    moving = upright = True

    def __init__(self, settings: TiltSettings, ticks: int) -> None:
        self.ticks = ticks
        self._free_rad, self._max_rad = settings.away_rad, settings.max_rad

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        if not sample.tilt_rad > self._free_rad:
            return None
        away = lean_away_rad(sample)
        if away > self._free_rad or sample.tilt_rad > self._max_rad:
            return f"{sample.tilt_rad:.2f} rad, {_limits(away, self._free_rad, self._max_rad)}"
        return None


class BaseRate(TripRule):
    """The base turns too fast, about whatever axis, and not because the clip asks it to: a body that falls."""

    name = "base_rate"
    moving = upright = True

    def __init__(self, settings: BaseRateSettings, ticks: int) -> None:
        self.ticks = ticks
        self._free_rad_s, self._max_rad_s = settings.away_rad_s, settings.max_rad_s

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        rate = math.hypot(*sample.state.imu_ang_vel_b.tolist())
        if not rate > self._free_rad_s:
            return None
        away = turn_away_rad_s(sample)
        if away > self._free_rad_s or rate > self._max_rad_s:
            return f"{rate:.1f} rad/s, {_limits(away, self._free_rad_s, self._max_rad_s)}"
        return None


class TorqueSaturation(TripRule):
    """Several joints at once near the torques that they can give: a body that fights the ground or an obstacle."""

    name = "torque_saturation"
    moving = upright = True

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


def _limits(away: float, free: float, most: float) -> str:
    return f"{away:.2f} away from what is asked; limits {free:.2f} away, {most:.2f} at all"
