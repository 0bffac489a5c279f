"""From standing to sitting on the heels: joints move to a crouch under balance, then the gains fade."""

import math

import numpy as np

from core.rotations import projected_gravity
from core.structured import one_of, within
from deploy.safety.rules import Wish
from deploy.settings import DeploySettings, LoweringSettings
from hal.contract.types import RobotState
from robot.robot import Robot


class Lowering:
    """The targets go along a cosine from the stand actor's pose (J,) to the crouch, while the ankles answer every lean
    that was not planned. What was sent last crosses over during blend_s. Without such a crouch there is no lowering:
    see `lowering_for`. wait_ticks: how long an end inside a motion waits for the stand actor.
    """

    def __init__(
        self, robot: Robot, stand_pose_rad: np.ndarray, settings: LoweringSettings, period_s: float, blend_s: float
    ) -> None:
        self._robot, self._settings, self._period_s, self._blend_s = robot, settings, period_s, blend_s
        self._from_rad, self._to_rad = stand_pose_rad, stand_pose_rad.copy()
        stiffness = np.ones(robot.num_joints)
        for name, joint in settings.crouch.items():
            self._to_rad[robot.joint_names.index(name)] = joint.rad
            stiffness[robot.joint_names.index(name)] = joint.stiffness
        self._kp, self._kd = stiffness * robot.kp, np.sqrt(stiffness) * robot.kd
        self._pitch = [robot.joint_names.index(name) for name in settings.ankle_pitch_joints]
        self._roll = [robot.joint_names.index(name) for name in settings.ankle_roll_joints]
        self.wait_ticks = max(1, round(settings.wait_s / period_s))
        self._sent: Wish | None = None
        self._tick = 0

    def start(self, sent: Wish | None) -> None:
        """Begin. sent: the targets and gains in force."""
        self._sent, self._tick = sent, 0

    @property
    def done(self) -> bool:
        """Whether the gains have faded."""
        settings = self._settings
        return self._tick * self._period_s >= settings.down_s + settings.settle_s + settings.fade_s

    def lost(self, state: RobotState) -> bool:
        """Whether the robot leans so far that falling damped is better than falling stiff."""
        forward, sideways = self._lean(state)
        return not math.hypot(forward, sideways) <= self._settings.max_lean_rad

    def wish(self, state: RobotState) -> Wish:
        """Targets and gains of this tick."""
        settings, robot, time_s = self._settings, self._robot, self._tick * self._period_s
        target_rad = self._from_rad + self._share(time_s) * (self._to_rad - self._from_rad)
        forward, sideways = self._lean(state)
        roll_rate, pitch_rate, _ = state.imu_ang_vel_b
        target_rad[self._pitch] += settings.ankle_per_lean * forward + settings.ankle_per_rate_s * pitch_rate
        target_rad[self._roll] += settings.ankle_per_lean * sideways + settings.ankle_per_rate_s * roll_rate
        left = min(1.0, max(0.0, (self._settings.down_s + settings.settle_s - time_s) / settings.fade_s + 1.0))
        wish = Wish(target_rad, left * self._kp, robot.damping_kd + left * (self._kd - robot.damping_kd))
        self._tick += 1
        return self._blended(wish, min(1.0, self._tick * self._period_s / max(self._blend_s, self._period_s)))

    def _share(self, time_s: float) -> float:
        return 0.5 - 0.5 * math.cos(math.pi * min(1.0, time_s / self._settings.down_s))

    def _lean(self, state: RobotState) -> tuple[float, float]:
        """Forwards and to the right, beyond what is planned; in rad where small."""
        gravity_b = projected_gravity(state.imu_quat_wxyz)
        planned = math.sin(self._settings.lean_rad * self._share(self._tick * self._period_s))
        return float(gravity_b[0]) - planned, -float(gravity_b[1])

    def _blended(self, wish: Wish, share: float) -> Wish:
        sent = self._sent
        if sent is None:
            return wish
        return Wish(
            sent.target_rad + share * (wish.target_rad - sent.target_rad),
            sent.kp + share * (wish.kp - sent.kp),
            sent.kd + share * (wish.kd - sent.kd),
        )


def lowering_for(
    robot: Robot, stand_pose_rad: np.ndarray, settings: DeploySettings, period_s: float
) -> Lowering | None:
    """None where nothing is configured, or all of it for another robot: it is damped instead.

    Raises:
        InputError: a joint is unknown, or does not reach where it is to go.
    """
    lowering = settings.lowering
    if lowering is None or lowering.joints.isdisjoint(robot.joint_names):
        return None
    for name in sorted(lowering.joints):
        one_of("lowering", name, robot.joint_names, "unknown joint")
    for name, joint in lowering.crouch.items():
        row = robot.joint_names.index(name)
        within(f"lowering.crouch.{name}.rad", joint.rad, robot.pos_lower_rad[row], robot.pos_upper_rad[row])
    return Lowering(robot, stand_pose_rad, lowering, period_s, settings.blend_s)
