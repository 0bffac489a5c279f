"""What a motor is asked for: the impedance law's targets, gains and feed-forward torque."""

import math
from dataclasses import dataclass

import numpy as np

from core.arrays import check_shape


@dataclass(frozen=True, slots=True)
class JointCommand:
    """Torque per joint = kp (q - q_measured) + kd (dq - dq_measured) + tau, computed on the device.

    Units rad, rad/s, Nm/rad, Nm s/rad, Nm; each (J,). Raises ValueError unless finite and gains >= 0.
    """

    q_rad: np.ndarray
    dq_rad_s: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    tau_nm: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes, finiteness and gains: nothing else may reach a motor."""
        joints = self.q_rad.shape
        if len(joints) != 1:
            raise ValueError(f"JointCommand.q_rad: got shape {joints}, expected (J,)")
        for name in ("q_rad", "dq_rad_s", "kp", "kd", "tau_nm"):
            value = getattr(self, name)
            check_shape("JointCommand", name, value, joints)
            if not math.isfinite(value.sum()):
                raise ValueError(f"JointCommand.{name}: got a value that is not finite: {value}")
        if self.kp.min(initial=0.0) < 0 or self.kd.min(initial=0.0) < 0:
            raise ValueError(f"JointCommand: got a negative gain, kp {self.kp}, kd {self.kd}, expected >= 0")


def damping_command(damping_kd: np.ndarray) -> JointCommand:
    """kp = 0 with the robot's per-joint damping: needs no state. damping_kd: (J,) Nm s/rad."""
    zero = np.zeros_like(damping_kd, dtype=np.float64)
    return JointCommand(zero, zero, zero, np.asarray(damping_kd, dtype=np.float64), zero)
