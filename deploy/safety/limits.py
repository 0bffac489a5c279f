"""Rules that change a wish. What is limited is the effect on a joint, not the target's place.

A target beyond a joint's range is normal for a good actor. The torque that the device will compute,
kp (target - q) - kd qd, is not free: it must stay within the joint's limit, and past the soft limit of the
range it must not push further out.
"""

import numpy as np

from deploy.safety.rules import Wish
from hal.contract.types import RobotState
from robot.robot import Robot


class TorqueLimit:
    """Rule (a): the target moves so that the predicted torque stays within factor * limit."""

    name = "torque_limit"

    def __init__(self, robot: Robot, factor: float, report_only: bool = False) -> None:
        self.report_only = report_only
        self._limit_nm = robot.torque_limit_nm * factor

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. Where kp is 0 only damping is left, and kd is what shrinks."""
        damping_nm = wish.kd * state.joint_vel_rad_s
        torque_nm = wish.kp * (wish.target_rad - state.joint_pos_rad) - damping_nm
        over = np.abs(torque_nm) > self._limit_nm
        if not over.any():
            return wish
        allowed_nm = np.clip(torque_nm, -self._limit_nm, self._limit_nm)
        target, kd = wish.target_rad.copy(), wish.kd.copy()
        soft, stiff = over & (wish.kp == 0.0), over & (wish.kp > 0.0)
        target[stiff] = (state.joint_pos_rad + (allowed_nm + damping_nm) / np.where(stiff, wish.kp, 1.0))[stiff]
        kd[soft] *= (self._limit_nm / np.where(soft, np.abs(torque_nm), 1.0))[soft]
        return Wish(target, wish.kp, kd)


class SoftPosition:
    """Rule (b): past the soft limit of its range a joint gets no torque that pushes it further out."""

    name = "soft_position"

    def __init__(self, robot: Robot, factor: float, report_only: bool = False) -> None:
        self.report_only = report_only
        middle = 0.5 * (robot.pos_lower_rad + robot.pos_upper_rad)
        half = 0.5 * factor * (robot.pos_upper_rad - robot.pos_lower_rad)
        self._lower_rad, self._upper_rad = middle - half, middle + half

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. The torque of the joints concerned becomes 0; with kp = 0 there is no push to remove."""
        high, low = state.joint_pos_rad > self._upper_rad, state.joint_pos_rad < self._lower_rad
        if not (high.any() or low.any()):
            return wish
        damping_nm = wish.kd * state.joint_vel_rad_s
        torque_nm = wish.kp * (wish.target_rad - state.joint_pos_rad) - damping_nm
        outward = (wish.kp > 0.0) & ((high & (torque_nm > 0.0)) | (low & (torque_nm < 0.0)))
        if not outward.any():
            return wish
        still_rad = state.joint_pos_rad + damping_nm / np.where(outward, wish.kp, 1.0)
        return Wish(np.where(outward, still_rad, wish.target_rad), wish.kp, wish.kd)


class StaleHold:
    """Rule `stale`, first half: a joint whose value is late keeps the target that it was last sent."""

    name = "stale"
    report_only = False

    def __init__(self, age_s: float) -> None:
        self._age_s = age_s
        self._last_rad: np.ndarray | None = None

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """See LimitRule. A late IMU holds every joint. Before the first command the measured position is held."""
        late = state.joint_age_s >= self._age_s
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
