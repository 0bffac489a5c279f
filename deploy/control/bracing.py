"""A body that falls: the joints go to a pose that gives way, softly, until it has landed."""

from core.structured import one_of, within
from deploy.safety.rules import Wish
from deploy.settings import BracingSettings
from robot.robot import Robot

FALLING = frozenset({"tilt", "base_rate"})
"""The rules that say of a balanced robot that it falls. After any other the joints are damped at once."""


class Bracing:
    """Each tick's targets are the pose of the settings, with a share of the robot's own kp and with its damping."""

    def __init__(self, robot: Robot, settings: BracingSettings, period_s: float) -> None:
        pose_rad = robot.default_pos_rad.copy()
        for name, rad in settings.pose_rad.items():
            pose_rad[robot.joint_names.index(name)] = rad
        self._wish = Wish(pose_rad, settings.stiffness * robot.kp, robot.damping_kd)
        self._ticks = max(1, round(settings.lands_s / period_s))
        self._tick = 0

    def start(self) -> None:
        """It begins to fall."""
        self._tick = 0

    @property
    def done(self) -> bool:
        """Whether it must have landed."""
        return self._tick >= self._ticks

    def wish(self) -> Wish:
        """Targets and gains of this tick."""
        self._tick += 1
        return self._wish


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
