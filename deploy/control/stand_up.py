"""From wherever the joints are to the start pose: damped to rest, then gains rise, then the joints move slowly."""

import math

import numpy as np

from deploy.safety.rules import Fault, Wish, tilt_rad
from deploy.settings import StandUpSettings
from hal.contract.types import RobotState
from robot.robot import Robot


class Settling:
    """Before standing up the joints are damped by devices that obey, until none has moved by more than rest_rad for
    damping_s. Only then the pose is measured: a joint that still falls would be somewhere else when its gain is up."""

    def __init__(self, robot: Robot, settings: StandUpSettings, period_s: float) -> None:
        self._names, self._settings = robot.joint_names, settings
        self._damping_ticks = round(settings.damping_s / period_s)
        self._energise_ticks = round(settings.energise_s / period_s)
        self._rest_ticks = round(settings.rest_s / period_s)
        self.start()

    def start(self) -> None:
        """Damping has just been asked for."""
        self._still = self._damped = self._waited = 0
        self._pose_rad: np.ndarray | None = None

    @property
    def done(self) -> bool:
        """Whether the joints have been damped and still for long enough."""
        return self._still > self._damping_ticks

    def fault(self, state: RobotState) -> Fault | None:
        """One tick: count what has been damped and still, or say what never comes."""
        settings = self._settings
        if not state.energised:
            self._still, self._damped, self._waited = 0, 0, self._waited + 1
            if self._waited <= self._energise_ticks:
                return None
            return Fault("not_energised", f"no device obeys {settings.energise_s:g} s after the first command")
        before = state.joint_pos_rad if self._still == 0 or self._pose_rad is None else self._pose_rad
        moved = np.abs(state.joint_pos_rad - before)
        if still := bool(moved.max() <= settings.rest_rad):
            self._pose_rad, self._still = before, self._still + 1
        else:
            self._pose_rad, self._still = state.joint_pos_rad, 1
        self._damped += 1
        if still or self._damped <= self._rest_ticks:
            return None
        name = self._names[int(np.argmax(moved))]
        return Fault("not_at_rest", f"{name} still moves after {settings.rest_s:g} s of damping")


class StandUp:
    """The robot is supported meanwhile. kp rises from 0 at the measured pose over ramp_s; then the joints move
    together along a cosine whose fastest joint reaches speed_rad_s, to start_pose_rad (J,), and stay there.

    The target of a joint that is more than lag_rad behind waits for it, while the others go on: what holds an arm may
    let go when the elbow bends."""

    def __init__(self, robot: Robot, start_pose_rad: np.ndarray, settings: StandUpSettings, period_s: float) -> None:
        self._robot = robot
        self._goal_rad = start_pose_rad
        self._settings = settings
        self._period_s = period_s
        self._lag_ticks = round(settings.lag_s / period_s)
        self._from_rad = self._target_rad = start_pose_rad
        self._move_s = 0.0
        self._tick = 0
        self._moved = self._behind = np.zeros(robot.num_joints, dtype=int)

    def start(self, state: RobotState) -> None:
        """Begin at the measured pose."""
        self._from_rad = self._target_rad = state.joint_pos_rad.copy()
        farthest_rad = float(np.abs(self._goal_rad - self._from_rad).max())
        self._move_s = 0.5 * math.pi * farthest_rad / self._settings.speed_rad_s
        self._tick = 0
        self._moved = self._behind = np.zeros_like(self._moved)

    @property
    def done(self) -> bool:
        """Whether the gains are up and every target has arrived."""
        ramped = self._tick * self._period_s >= self._settings.ramp_s
        return ramped and (int(self._moved.min()) + 1) * self._period_s >= self._move_s

    def fault(self, state: RobotState) -> Fault | None:
        """Why standing up must be aborted: the base leans, or a joint does not follow the target last sent."""
        settings = self._settings
        tilt = tilt_rad(state.imu_quat_wxyz)
        if not tilt <= settings.max_tilt_rad:
            return Fault("stand_up_tilt", f"{tilt:.2f} rad, limit {settings.max_tilt_rad}")
        error = np.abs(state.joint_pos_rad - self._target_rad)
        joint = int(np.argmax(error))
        if not error[joint] <= settings.max_error_rad:
            name = self._robot.joint_names[joint]
            return Fault("stand_up_error", f"{name} is {error[joint]:.2f} rad behind, limit {settings.max_error_rad}")
        self._behind = np.where(error > settings.lag_rad, self._behind + 1, 0)
        joint = int(np.argmax(self._behind))
        if self._behind[joint] <= self._lag_ticks:
            return None
        name = self._robot.joint_names[joint]
        return Fault("stand_up_lag", f"{name} is {error[joint]:.2f} rad behind, for {settings.lag_s:g} s")

    def wish(self) -> Wish:
        """Target and gains of this tick."""
        time_s = self._tick * self._period_s
        self._tick += 1
        stiffness = min(1.0, time_s / self._settings.ramp_s)
        if time_s > self._settings.ramp_s:
            self._moved = self._moved + (self._behind == 0)
        share = np.minimum(1.0, self._moved * self._period_s / self._move_s) if self._move_s > 0.0 else 1.0
        share = 0.5 - 0.5 * np.cos(math.pi * share)
        self._target_rad = self._from_rad + share * (self._goal_rad - self._from_rad)
        robot = self._robot
        kd = robot.damping_kd + stiffness * (robot.kd - robot.damping_kd)
        return Wish(self._target_rad, stiffness * robot.kp, kd)
