"""A base that somebody leans by hand: the whole robot with its gantry, as its IMU sees it."""

import math
from dataclasses import replace

import numpy as np

from core.rotations import quat_mul, quat_rotate, quat_rotate_inverse
from world.plant import Measurement

UP_M_S2 = np.array([0.0, 0.0, 9.81])
LEVEL = np.zeros(2)


class Lean:
    """Angles forwards and to the left (rad), reached smoothly from the present ones. Joints do not feel it."""

    def __init__(self) -> None:
        self._from_rad = self._to_rad = LEVEL
        self._start_s, self._takes_s = 0.0, 1.0

    def to(self, forwards_rad: float, left_rad: float, now_s: float, takes_s: float) -> None:
        """Begin to lean. takes_s: how long it takes, above 0."""
        self._from_rad, _ = self._at(now_s)
        self._to_rad, self._start_s, self._takes_s = np.array([forwards_rad, left_rad]), now_s, takes_s

    def seen(self, level: Measurement) -> Measurement:
        """What the IMU measures of a leaning base that measures this where it stands level."""
        angles, rates = self._at(level.time_s)
        if not angles.any() and not rates.any():
            return level
        pitch = np.array([math.cos(angles[0] / 2), 0.0, math.sin(angles[0] / 2), 0.0])
        roll = np.array([math.cos(angles[1] / 2), -math.sin(angles[1] / 2), 0.0, 0.0])
        leant = quat_mul(pitch, roll)
        turning_w = np.array([0.0, rates[0], 0.0]) + quat_rotate(pitch, np.array([-rates[1], 0.0, 0.0]))
        quat_wxyz = quat_mul(leant, level.imu_quat_wxyz)
        gravity_b = quat_rotate_inverse(quat_wxyz, UP_M_S2) - quat_rotate_inverse(level.imu_quat_wxyz, UP_M_S2)
        return replace(
            level,
            imu_quat_wxyz=quat_wxyz,
            imu_ang_vel_b=level.imu_ang_vel_b + quat_rotate_inverse(quat_wxyz, turning_w),
            imu_acc_b=level.imu_acc_b + gravity_b,
        )

    def _at(self, now_s: float) -> tuple[np.ndarray, np.ndarray]:
        """(2,) angles and their rates."""
        share = min(1.0, max(0.0, (now_s - self._start_s) / self._takes_s))
        way = self._to_rad - self._from_rad
        rate = 6.0 * share * (1.0 - share) / self._takes_s
        return self._from_rad + way * share * share * (3.0 - 2.0 * share), way * rate
