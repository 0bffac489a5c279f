"""From wherever the joints are to the start pose: damped first, then gains rise, then the joints move slowly."""

import math

import numpy as np

from deploy.safety.rules import Fault, Wish, tilt_rad
from deploy.settings import StandUpSettings
from hal.contract.types import RobotState
from robot.robot import Robot


class Settling:
    """Before standing up: the joints are damped for damping_s by devices that obey. Only then the pose is measured."""

    def __init__(self, settings: StandUpSettings, period_s: float) -> None:
        self._settings = settings
        self._damping_ticks = round(settings.damping_s / period_s)
        self._energise_ticks = round(settings.energise_s / period_s)
        self.start()

    def start(self) -> None:
        """Damping has just been asked for."""
        self._damped = self._waited = 0

    @property
    def done(self) -> bool:
        """Whether the joints have been damped for long enough."""
        return self._damped > self._damping_ticks

    def fault(self, state: RobotState) -> Fault | None:
        """One tick: count what has been damped, or say that the devices still do not obey."""
        if state.energised:
            self._damped += 1
            return None
        self._damped, self._waited = 0, self._waited + 1
        if self._waited <= self._energise_ticks:
            return None
        return Fault("not_energised", f"no device obeys {self._settings.energise_s:g} s after the first command")


class StandUp:
    """The robot is supported meanwhile. kp rises from 0 at the measured pose over ramp_s; then all joints move
    together along a cosine whose fastest joint reaches speed_rad_s, to start_pose_rad (J,), and stay there."""

    def __init__(self, robot: Robot, start_pose_rad: np.ndarray, settings: StandUpSettings, period_s: float) -> None:
        self._robot = robot
        self._goal_rad = start_pose_rad
        self._settings = settings
        self._period_s = period_s
        self._from_rad = self._target_rad = start_pose_rad
        self._move_s = 0.0
        self._tick = 0

    def start(self, state: RobotState) -> None:
        """Begin at the measured pose."""
        self._from_rad = self._target_rad = state.joint_pos_rad.copy()
        farthest_rad = float(np.abs(self._goal_rad - self._from_rad).max())
        self._move_s = 0.5 * math.pi * farthest_rad / self._settings.speed_rad_s
        self._tick = 0

    @property
    def done(self) -> bool:
        """Whether the target has arrived."""
        return self._tick * self._period_s >= self._settings.ramp_s + self._move_s

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
        return None

    def wish(self) -> Wish:
        """Target and gains of this tick."""
        time_s = self._tick * self._period_s
        self._tick += 1
        stiffness = min(1.0, time_s / self._settings.ramp_s)
        moving_s = time_s - self._settings.ramp_s
        share = min(1.0, max(0.0, moving_s) / self._move_s) if self._move_s > 0.0 else 1.0
        share = 0.5 - 0.5 * math.cos(math.pi * share)
        self._target_rad = self._from_rad + share * (self._goal_rad - self._from_rad)
        robot = self._robot
        kd = robot.damping_kd + stiffness * (robot.kd - robot.damping_kd)
        return Wish(self._target_rad, stiffness * robot.kp, kd)
