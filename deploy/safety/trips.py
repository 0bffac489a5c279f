"""Rules that end a movement. Each says what it got and what its limit is."""

import math

import numpy as np

from deploy.safety.rules import Sample, TripRule
from deploy.settings import SafetySettings
from robot.robot import Robot

CLOCK_GRAIN_S = 1e-6


class PositionRange:
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


class JointSpeed:
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


class Tilt:
    """The base leans too far."""

    name = "tilt"
    moving = True

    def __init__(self, max_rad: float, ticks: int) -> None:
        self.ticks = ticks
        self._max_rad = max_rad

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return f"{sample.tilt_rad:.2f} rad, limit {self._max_rad:.2f}" if sample.tilt_rad > self._max_rad else None


class Stale:
    """A joint or the IMU has not been heard of for too long."""

    name = "stale"
    moving = False
    ticks = 1

    def __init__(self, robot: Robot, age_s: float) -> None:
        self._names = robot.joint_names
        self._age_s = age_s

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        if not sample.age_s >= self._age_s:
            return None
        state = sample.state
        joint = int(np.argmax(state.joint_age_s))
        who = "IMU" if state.imu_age_s >= state.joint_age_s[joint] else self._names[joint]
        return f"{who} last heard {sample.age_s * 1e3:.0f} ms ago, limit {self._age_s * 1e3:.0f} ms"


class StateNotFinite:
    """A measured value is nan or infinite, or the IMU's quaternion is far from any rotation."""

    name = "state_not_finite"
    moving = False
    ticks = 1
    _FIELDS = ("joint_pos_rad", "joint_vel_rad_s", "imu_quat_wxyz", "imu_ang_vel_b", "joint_age_s")

    def __init__(self, robot: Robot) -> None:
        self._names = robot.joint_names

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        state = sample.state
        total = sum(float(getattr(state, name).sum()) for name in self._FIELDS) + state.imu_age_s
        if math.isfinite(total):
            length = math.hypot(*state.imu_quat_wxyz.tolist())
            return None if abs(length - 1.0) < 0.1 else f"the IMU's quaternion has length {length:.2f}"
        for name in self._FIELDS:
            bad = ~np.isfinite(getattr(state, name))
            if bad.any():
                place = int(np.argmax(bad))
                return f"{name} of {self._names[place] if name.startswith('joint') else 'the IMU'} is not a number"
        return "imu_age_s is not a number"


class InferenceOverrun:
    """The actor takes longer than its share of a control period."""

    name = "inference_overrun"
    moving = True

    def __init__(self, limit_s: float, ticks: int) -> None:
        self.ticks = ticks
        self._limit_s = limit_s

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        if sample.inference_s <= self._limit_s:
            return None
        return f"{sample.inference_s * 1e3:.1f} ms, limit {self._limit_s * 1e3:.1f} ms"


class Temperature:
    """A motor is too hot. Says nothing of joints whose temperature is not known (None or nan)."""

    name = "temperature"
    moving = False

    def __init__(self, robot: Robot, max_c: float, ticks: int) -> None:
        self.ticks = ticks
        self._names = robot.joint_names
        self._max_c = max_c

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        heat = sample.state.temperature_c
        if heat is None or not (heat > self._max_c).any():
            return None
        joint = int(np.nanargmax(heat))
        return f"{self._names[joint]} at {heat[joint]:.0f} C, limit {self._max_c:.0f} C"


class DeviceReport:
    """The device itself reports a fault."""

    name = "device_fault"
    moving = False
    ticks = 1

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return ", ".join(sample.state.faults) or None


def trip_rules(robot: Robot, safety: SafetySettings, period_s: float) -> tuple[TripRule, ...]:
    """All rules that look at a state, in the order in which they are asked."""
    overrun = safety.inference_overrun
    return (
        StateNotFinite(robot),
        DeviceReport(),
        Stale(robot, safety.stale.trip_periods * period_s - CLOCK_GRAIN_S),
        Temperature(robot, safety.temperature.max_c, safety.temperature.ticks),
        PositionRange(robot, safety.position_range.margin_rad, safety.position_range.ticks),
        JointSpeed(robot, safety.joint_speed.factor, safety.joint_speed.ticks),
        Tilt(safety.tilt.max_rad, safety.tilt.ticks),
        InferenceOverrun(overrun.periods * period_s, overrun.ticks),
    )
