"""Rules that change a wish. What is limited is the effect on a joint, not the target's place.

A target beyond a joint's range is normal for a good actor. The torque that the device will compute,
kp (target - q) - kd qd, is not free. Only its spring is limited, and only by lowering kp: whatever was wrong with the
measured q or qd, the joint then gets no more spring than it was wished. The damping stays.
"""

import numpy as np

from deploy.safety.plausible import Plausibility
from deploy.safety.rules import Wish
from hal.contract.types import RobotState
from robot.robot import Robot


class TorqueLimit:
    """Rule (a): the spring softens so that it, alone and together with the damping, stays within factor * limit."""

    name = "torque_limit"

    def __init__(self, robot: Robot, factor: float, report_only: bool = False) -> None:
        self.report_only = report_only
        self._limit_nm = robot.torque_limit_nm * factor

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. Where the damping alone is beyond the limit, no spring adds to it."""
        damping_nm = wish.kd * state.joint_vel_rad_s
        spring_nm = wish.kp * (wish.target_rad - state.joint_pos_rad)
        highest_nm = np.clip(self._limit_nm + damping_nm, 0.0, self._limit_nm)
        lowest_nm = -np.clip(self._limit_nm - damping_nm, 0.0, self._limit_nm)
        over = (spring_nm > highest_nm) | (spring_nm < lowest_nm)
        if not over.any():
            return wish
        share = np.clip(spring_nm, lowest_nm, highest_nm) / np.where(over, spring_nm, 1.0)
        return Wish(wish.target_rad, np.where(over, wish.kp * share, wish.kp), wish.kd)


class SoftPosition:
    """Rule (b): past the soft limit of its range a joint gets no spring that pushes it further out."""

    name = "soft_position"

    def __init__(self, robot: Robot, factor: float, report_only: bool = False) -> None:
        self.report_only = report_only
        middle = 0.5 * (robot.pos_lower_rad + robot.pos_upper_rad)
        half = 0.5 * factor * (robot.pos_upper_rad - robot.pos_lower_rad)
        self._lower_rad, self._upper_rad = middle - half, middle + half

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. kp of the joints concerned becomes 0."""
        high, low = state.joint_pos_rad > self._upper_rad, state.joint_pos_rad < self._lower_rad
        if not (high.any() or low.any()):
            return wish
        push_nm = wish.kp * (wish.target_rad - state.joint_pos_rad)
        outward = (high & (push_nm > 0.0)) | (low & (push_nm < 0.0))
        return Wish(wish.target_rad, np.where(outward, 0.0, wish.kp), wish.kd) if outward.any() else wish


class StaleHold:
    """Rule `stale`, first half: a joint whose value is late or not believed keeps the target that it was last sent."""

    name = "stale"
    report_only = False

    def __init__(self, age_s: float, gate: Plausibility) -> None:
        self._age_s, self._gate = age_s, gate
        self._last_rad: np.ndarray | None = None

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. A late IMU holds every joint. Before the first command the measured position is held."""
        late = (state.joint_age_s >= self._age_s) | self._gate.suspect
        if state.imu_age_s >= self._age_s:
            late = np.ones_like(late)
        if not late.any():
            return wish
        held_rad = state.joint_pos_rad if self._last_rad is None else self._last_rad
        return Wish(np.where(late, held_rad, wish.target_rad), wish.kp, wish.kd)

    def sent(self, target_rad: np.ndarray) -> None:
        """Remember what went out."""
        self._last_rad = target_rad

    def reset(self) -> None:
        """Forget it: the joints were damped."""
        self._last_rad = None
