"""Faults that a mock device shows on request, by time: every rule of the safety layer can be made to act."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from core.structured import at_least, one_of, positive
from robot.robot import Robot

# kind -> (needs a joint, default value, what `value` means)
KINDS: dict[str, tuple[bool, float | None, str]] = {
    "link_loss": (False, None, "reading and writing raise LinkLost"),
    "no_state": (False, None, "no state has arrived, reading raises NoState"),
    "silence": (False, None, "nothing new arrives; ages grow until the link counts as lost"),
    "stale_joint": (True, None, "one joint's value stays, its age grows"),
    "stale_imu": (False, None, "the IMU's value stays, its age grows"),
    "nan_position": (True, None, "one joint's position is NaN"),
    "nan_velocity": (True, None, "one joint's velocity is NaN"),
    "nan_quaternion": (False, None, "the orientation is NaN"),
    "nan_gyro": (False, None, "the angular velocity is NaN"),
    "over_temperature": (True, 120.0, "the joint's temperature in degrees Celsius"),
    "device_fault": (True, None, "the joint's motor reports a fault"),
    "stuck_joint": (True, None, "the joint does not move"),
    "past_range": (True, 0.2, "how far the joint reads beyond its upper end, rad"),
    "overspeed": (True, 60.0, "the joint's speed, rad/s"),
    "tilt": (False, 1.2, "how far the base leans forward, rad"),
    "slow_read": (False, 0.05, "how long each reading takes, s"),
    "write_error": (False, None, "writing raises LinkLost"),
}


@dataclass(frozen=True)
class MockFault:
    """One fault in [start_s, start_s + duration_s) after opening. Raises InputError where it makes no sense."""

    kind: str
    start_s: float
    duration_s: float = math.inf
    joint: str | None = None
    value: float | None = None

    def __post_init__(self) -> None:
        """Check kind, times and joint."""
        one_of("kind", self.kind, KINDS, "unknown fault")
        at_least("start_s", self.start_s, 0)
        if self.duration_s != math.inf:
            positive("duration_s", self.duration_s)
        needs_joint, default, _ = KINDS[self.kind]
        if needs_joint != (self.joint is not None):
            expected = "the name of a joint" if needs_joint else "no joint"
            raise InputError(f"wrong joint entry for {self.kind}", where="joint", got=self.joint, expected=expected)
        if self.value is not None and (default is None or not math.isfinite(self.value)):
            expected = "no value" if default is None else "a finite value"
            raise InputError(f"wrong value for {self.kind}", where="value", got=self.value, expected=expected)

    @property
    def amount(self) -> float:
        """`value`, or the kind's default."""
        default = KINDS[self.kind][1]
        return self.value if self.value is not None else (default if default is not None else math.nan)

    def active(self, t_s: float) -> bool:
        """Whether the fault shows at t_s seconds after opening."""
        return self.start_s <= t_s < self.start_s + self.duration_s


class FaultScript:
    """The faults of one run, with joints resolved by name. Raises InputError on an unknown joint."""

    def __init__(self, faults: Sequence[MockFault], robot: Robot) -> None:
        for fault in faults:
            if fault.joint is not None and fault.joint not in robot.joint_names:
                expected = f"one of {', '.join(robot.joint_names)}"
                raise InputError("unknown joint", where=f"fault {fault.kind}", got=fault.joint, expected=expected)
        self._faults = [
            (fault, -1 if fault.joint is None else robot.joint_names.index(fault.joint)) for fault in faults
        ]
        self._num_joints = robot.num_joints

    def first(self, kind: str, t_s: float) -> MockFault | None:
        """The first active fault of a kind, if any."""
        return next((fault for fault, _ in self._faults if fault.kind == kind and fault.active(t_s)), None)

    def joints(self, kind: str, t_s: float) -> np.ndarray:
        """(J,) bool: the joints that the kind strikes now."""
        struck = np.zeros(self._num_joints, dtype=bool)
        for fault, joint in self._faults:
            if fault.kind == kind and fault.active(t_s):
                struck[joint] = True
        return struck

    def overwrite(self, kind: str, t_s: float, values: np.ndarray, base: np.ndarray | float = 0.0) -> None:
        """Replace the struck joints' values (J,) in place by base + the fault's amount."""
        for fault, joint in self._faults:
            if fault.kind == kind and fault.active(t_s):
                values[joint] = np.broadcast_to(base, values.shape)[joint] + fault.amount
