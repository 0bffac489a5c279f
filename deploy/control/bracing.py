"""A body that falls: the joints go to a pose that gives way, softly, until it has landed."""

import numpy as np

from core.structured import one_of, within
from deploy.safety.rules import Wish
from deploy.settings import BracingSettings
from hal.contract.types import RobotState
from robot.robot import Robot

FALLING = frozenset({"tilt", "base_rate"})
"""The rules that say of a balanced robot that it falls. After any other the joints are damped at once."""


class Bracing:
    """The targets are the pose of the settings, with a share of the robot's own kp and with its damping.

    A target that is far away is brought nearer: the spring pulls with a share of the joint's torque limit at most, for
    the sake of who holds the robot, and of a joint that is not what it says.
    """

    def __init__(self, robot: Robot, settings: BracingSettings, period_s: float) -> None:
        pose_rad = robot.default_pos_rad.copy()
        for name, rad in settings.pose_rad.items():
            pose_rad[robot.joint_names.index(name)] = rad
        self._pose_rad, self._kp, self._kd = pose_rad, settings.stiffness * robot.kp, robot.damping_kd
        self._stretch_rad = settings.torque_share * robot.torque_limit_nm / self._kp
        self._ticks = max(1, round(settings.lands_s / period_s))
        self._tick = 0

    def start(self) -> None:
        """It begins to fall."""
        self._tick = 0

    @property
    def done(self) -> bool:
        """Whether it must have landed."""
        return self._tick >= self._ticks

    def wish(self, state: RobotState) -> Wish:
        """Targets and gains of this tick."""
        self._tick += 1
        now_rad = state.joint_pos_rad
        target_rad = np.clip(self._pose_rad, now_rad - self._stretch_rad, now_rad + self._stretch_rad)
        return Wish(target_rad, self._kp, self._kd)


def bracing_for(robot: Robot, settings: BracingSettings | None, period_s: float) -> Bracing | None:
    """None where nothing is configured, or all of it for another robot: one that falls is damped instead.

    Raises:
        InputError: a joint is unknown, or does not reach where it is to go.
    """
    if settings is None or settings.pose_rad.keys().isdisjoint(robot.joint_names):
        return None
    for name, rad in settings.pose_rad.items():
        one_of("bracing.pose_rad", name, robot.joint_names, "unknown joint")
        row = robot.joint_names.index(name)
        within(f"bracing.pose_rad.{name}", rad, robot.pos_lower_rad[row], robot.pos_upper_rad[row])
    return Bracing(robot, settings, period_s)
