"""Rules on the health of device, link and loop. Each says what it got and what its limit is."""

import math

import numpy as np

from deploy.safety.rules import Sample, TripRule
from robot.robot import Robot
from robot.thermal import MotorHeat, ThermalFigures


class StateNotFinite(TripRule):
    """A measured value is nan or infinite, or the IMU's quaternion is far from any rotation."""

    name = "state_not_finite"
    moving = False
    ticks = 1
    _FIELDS = ("joint_pos_rad", "joint_vel_rad_s", "joint_torque_nm", "imu_quat_wxyz", "imu_ang_vel_b", "joint_age_s")

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


class DeviceReport(TripRule):
    """The device itself reports a fault."""

    name = "device_fault"
    moving = False
    ticks = 1

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return ", ".join(sample.state.faults) or None


class Stale(TripRule):
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


class Temperature(TripRule):
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


class InferenceOverrun(TripRule):
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


class Overrun(TripRule):
    """The loop does not keep its pace: what a policy does at half its rate is another movement."""

    name = "overrun"
    moving = True

    def __init__(self, ticks: int, often: tuple[int, int]) -> None:
        self.ticks, self.often = ticks, often
        self._allowed = f"allowed {ticks - 1} in a row and {often[0] - 1} of {often[1]}"

    def violation(self, sample: Sample) -> str | None:
        """See TripRule."""
        return f"a deadline missed again, {self._allowed}" if sample.overran else None


class WindingTemperature(TripRule):
    """A motor's winding, by the model of its heat, comes too near its limit.

    See Forecast: a warning while no more than `warn_s` are left before that at the load of late, urgent from `lower_s`.
    left_s: how long (J,) each motor may go on like that; inf: for ever.
    """

    name = "winding_temperature"
    moving = False

    def __init__(
        self, robot: Robot, figures: ThermalFigures, max_c: float, warn_s: float, lower_s: float, ticks: int
    ) -> None:
        self.ticks = ticks
        self.warning: str | None = None
        self.urgent = False
        self._names = robot.joint_names
        self._heat = MotorHeat(robot.torque_limit_nm, figures)
        self._max_c, self._warn_s, self._lower_s = max_c, warn_s, lower_s
        self._last_s: float | None = None
        self.left_s = self._heat.left_s(max_c)

    @property
    def winding_c(self) -> np.ndarray:
        """Temperature (J,) of the windings, by the model."""
        return self._heat.winding_c

    def violation(self, sample: Sample) -> str | None:
        """See TripRule. The model goes on by the time since the sample before."""
        state = sample.state
        lasted_s = 0.0 if self._last_s is None else max(0.0, state.time_s - self._last_s)
        self._last_s = state.time_s
        self._heat.step(state.joint_torque_nm, lasted_s, state.temperature_c)
        left_s = self.left_s = self._heat.left_s(self._max_c)
        first = int(np.argmin(left_s))
        self.warning, self.urgent = None, bool(left_s[first] <= self._lower_s)
        if left_s[first] <= self._warn_s:
            self.warning = f"{self._names[first]} will be too hot in {left_s[first] / 60.0:.1f} minutes at this load"
        winding_c = self._heat.winding_c
        joint = int(np.argmax(winding_c))
        if not winding_c[joint] > self._max_c:
            return None
        return f"winding of {self._names[joint]} at {winding_c[joint]:.0f} C, limit {self._max_c:.0f} C"
