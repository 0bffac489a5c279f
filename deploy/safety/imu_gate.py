"""The gate before the rules, for the IMU: a sample that no turn of the base leads to is not believed."""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from core.rotations import quat_conjugate, quat_mul, quat_to_rotvec
from hal.contract.types import RobotState

LATELY = 25  # samples from which the noise of an IMU is known
NOISE = 4.0  # times its usual mismatch is still noise; of uniform noise the largest is 2.5 times the median


@dataclass(frozen=True, slots=True)
class ImuSample:
    """quat_wxyz (4,), ang_vel_b (3,) in rad/s, acc_b (3,) in m/s^2, measured at measured_s."""

    quat_wxyz: np.ndarray
    ang_vel_b: np.ndarray
    acc_b: np.ndarray
    measured_s: float


class ImuGate:
    """Orientation and rate against those before: the rate not too high, and the turn what both rates explain.

    A sample that is not believed is replaced by the one before it, with its true age. `detail` says what was wrong, or
    is empty. A sample that is not a number passes: another rule trips on it at once.

    fastest_rad_s: the highest rate that is believed. quiet_rad_s: how far the turn, over the time since the sample
    before, may be from the mean of both rates where the IMU has no noise; more by what it was off lately, but at most
    mismatch_rad_s, which also holds until that is known. Half the rate before is allowed besides, as an impact stops a
    base at any time between two samples.
    """

    def __init__(self, fastest_rad_s: float, quiet_rad_s: float, mismatch_rad_s: float, period_s: float) -> None:
        self.detail = ""
        self._fastest_rad_s, self._quiet_rad_s, self._mismatch_rad_s = fastest_rad_s, quiet_rad_s, mismatch_rad_s
        self._period_s = period_s
        self._off_rad_s: deque[float] = deque(maxlen=LATELY)
        self._before: ImuSample | None = None
        self._seen: ImuSample | None = None

    def believed(self, state: RobotState) -> RobotState:
        """The state itself, or one with the IMU's sample that was last believed."""
        new = ImuSample(state.imu_quat_wxyz, state.imu_ang_vel_b, state.imu_acc_b, state.time_s - state.imu_age_s)
        before, seen, self._seen = self._before, self._seen, new
        self.detail = "" if before is None or seen is None else self._wrong(before, seen, new)
        if before is None or not self.detail:
            self._before = new
            return state
        return replace(
            state,
            imu_quat_wxyz=before.quat_wxyz,
            imu_ang_vel_b=before.ang_vel_b,
            imu_acc_b=before.acc_b,
            imu_age_s=state.time_s - before.measured_s,
        )

    def reset(self) -> None:
        """The robot rests: what was seen last is the truth."""
        self._before = self._seen

    def _wrong(self, before: ImuSample, seen: ImuSample, new: ImuSample) -> str:
        gap_s = max(new.measured_s - seen.measured_s, self._period_s)
        elapsed_s = max(new.measured_s - before.measured_s, 0.0)
        turned_rad = quat_to_rotvec(quat_mul(quat_conjugate(before.quat_wxyz), new.quat_wxyz))
        explained_rad = 0.5 * (before.ang_vel_b + new.ang_vel_b) * elapsed_s
        rate_rad_s = float(np.linalg.norm(new.ang_vel_b))
        allowed_rad_s = self._noise_rad_s() + 0.5 * float(np.linalg.norm(before.ang_vel_b))
        off_rad_s = float(np.linalg.norm(turned_rad - explained_rad)) / gap_s
        if math.isfinite(off_rad_s):
            self._off_rad_s.append(off_rad_s)
        if not (rate_rad_s > self._fastest_rad_s or off_rad_s > allowed_rad_s):
            return ""
        turn_rad = float(np.linalg.norm(turned_rad))
        return f"the IMU turns by {turn_rad:.2f} rad in {elapsed_s * 1e3:.0f} ms at {rate_rad_s:.1f} rad/s"

    def _noise_rad_s(self) -> float:
        """What counts as noise, from the samples before; those that were not believed are among them."""
        if len(self._off_rad_s) < LATELY:
            return self._mismatch_rad_s
        return min(self._quiet_rad_s + NOISE * sorted(self._off_rad_s)[LATELY // 2], self._mismatch_rad_s)
