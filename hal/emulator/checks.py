"""What a device may expect of the commands that reach it, checked on its own side of the wire."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

REPORTS_KEPT = 48
REPORT_AGE_S = 0.06
LISTED = 20
TORQUE_SLACK = 1.01
ROUNDING_NM = 0.3
Index = int | np.ndarray


@dataclass(frozen=True)
class Violation:
    """kind: not_finite, gains or torque. time_s: on the machine's monotonic clock."""

    time_s: float
    kind: str
    joint: str
    detail: str


class CommandChecks:
    """Judges each new command of each joint; a repeated one is not judged again.

    Torque: kp (q* - q) + kd (dq* - dq) + tau must lie within the joint's limit for at least one of the states that
    the joint reported in the last 60 ms, within which a command is made, sent and renewed; 1 % and 0.3 Nm are left to
    the rounding of wire formats. Damping (kp = tau = 0) is exempt: it brakes, whatever the speed. For one thread.
    """

    def __init__(self, joint_names: tuple[str, ...], torque_limit_nm: np.ndarray) -> None:
        joints = len(joint_names)
        self._names, self._limit_nm = joint_names, torque_limit_nm
        self.kp_max, self.kd_max = np.full(joints, np.inf), np.full(joints, np.inf)
        self._reported = np.full((3, REPORTS_KEPT, joints), np.nan)  # time, position, velocity
        self._reported[0] = -np.inf
        self._next = np.zeros(joints, dtype=int)
        self.reset()

    def reset(self) -> None:
        """Forget what was found and reported."""
        self.counts: Counter[str] = Counter()
        self.worst_torque = np.zeros(len(self._names))
        self.taken_up: dict[str, dict[str, float]] = {}
        self.listed: list[Violation] = []
        self._reported[0], self._reported[1:] = -np.inf, np.nan

    def report(self, joint: Index, time_s: float, pos_rad: float | np.ndarray, vel_rad_s: float | np.ndarray) -> None:
        """A device put a state of one joint, or of several, on the wire."""
        row = self._next[joint] = (self._next[joint] + 1) % REPORTS_KEPT
        self._reported[0, row, joint] = time_s
        self._reported[1, row, joint], self._reported[2, row, joint] = pos_rad, vel_rad_s

    def judge_gains(self, time_s: float, joint: int, kp: float, kd: float) -> bool:
        """Whether both lie in the device's range."""
        if 0 <= kp <= self.kp_max[joint] and 0 <= kd <= self.kd_max[joint]:
            return True
        ranges = f"expected 0 to {self.kp_max[joint]:g} and 0 to {self.kd_max[joint]:g}"
        self.add(time_s, "gains", joint, f"kp {kp:g}, kd {kd:g}, {ranges}")
        return False

    def judge_torque(self, time_s: float, joints: np.ndarray, table: np.ndarray) -> None:
        """New commands (5, J) q, dq, kp, kd, tau of which the joints (N,) changed."""
        q_rad, dq_rad_s, kp, kd, tau_nm = table[:, joints]
        stamp_s, pos_rad, vel_rad_s = self._reported[:, :, joints]
        torque_nm = np.abs(kp * (q_rad - pos_rad) + kd * (dq_rad_s - vel_rad_s) + tau_nm)
        recent = stamp_s >= np.minimum(time_s - REPORT_AGE_S, stamp_s.max(axis=0))
        least_nm = np.where(recent, torque_nm, np.inf).min(axis=0)
        least_nm[((kp == 0) & (tau_nm == 0)) | ~np.isfinite(least_nm)] = 0.0
        limit_nm = self._limit_nm[joints]
        self.worst_torque[joints] = np.maximum(self.worst_torque[joints], least_nm / limit_nm)
        for i in np.flatnonzero(least_nm > TORQUE_SLACK * limit_nm + ROUNDING_NM).tolist():
            self.add(time_s, "torque", int(joints[i]), f"{least_nm[i]:.2f} Nm, limit {limit_nm[i]:g}")

    def take_up(self, joint: int, q_rad: float, kp: float, before: Sequence[float]) -> None:
        """A motor that was slack or damped is driven: how stiffly, and how far from where it last said it was.

        before: q, dq, kp, ... of the command that it followed until then.
        """
        pos_rad = float(self._reported[1, self._next[joint], joint])
        self.taken_up[self._names[joint]] = {
            "kp": kp, "error_rad": q_rad - pos_rad, "kp_before": before[2], "error_before_rad": before[0] - pos_rad,
        }  # fmt: skip

    def add(self, time_s: float, kind: str, joint: int, detail: str) -> None:
        """Count a violation; the first ones are listed."""
        self.counts[kind] += 1
        if len(self.listed) < LISTED:
            self.listed.append(Violation(time_s, kind, self._names[joint], detail))

    def summary(self) -> dict[str, Any]:
        """Plain data. worst_torque: highest predicted torque as a share of the joint's limit. taken_up: see above."""
        return {
            "counts": dict(self.counts),
            "listed": [vars(violation) for violation in self.listed],
            "taken_up": dict(self.taken_up),
            "worst_torque": dict(zip(self._names, self.worst_torque.round(4).tolist())),
        }
