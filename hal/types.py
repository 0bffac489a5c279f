"""What crosses the hardware abstraction layer: states, commands, device facts and errors.

Every per-joint array has shape (J,) in the robot's joint-table order, float64.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


class DeviceError(RuntimeError):
    """The device, or the way to it, does not work. Commands end with exit code 4."""


class LinkLost(DeviceError):
    """The device has been silent for longer than the link's timeout, or the link is gone."""


class NoState(DeviceError):
    """No complete state (every joint and the IMU) has arrived yet."""


class DeviceFault(DeviceError):
    """The device answered and refuses to work."""


@dataclass(frozen=True, slots=True)
class TrueState:
    """What only a simulation knows. For metrics, logs and pictures; never for control.

    foot_contact: (2,) bool, left and right, norm of the net contact force above 1 N.
    joint_pos_rad, joint_vel_rad_s: (J,), free of noise and delay, at the same instant as the root.
    """

    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    root_lin_vel_w: np.ndarray
    root_ang_vel_b: np.ndarray
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    foot_contact: np.ndarray


@dataclass(frozen=True, slots=True)
class RobotState:
    """One reading of all joints and the IMU. Values may be non-finite: that is what the device said.

    time_s: the clock's time of the reading.
    joint_age_s: (J,) time since each joint's value was measured; imu_age_s likewise.
    imu_quat_wxyz: IMU (base) to world. imu_ang_vel_b in rad/s. imu_acc_b: specific force in m/s^2, (0, 0, 9.81) at
    rest upright.
    temperature_c: (J,) or None where the device has no sensor. faults: the device's own, by name; empty when healthy.
    """

    time_s: float
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    joint_torque_nm: np.ndarray
    joint_age_s: np.ndarray
    imu_quat_wxyz: np.ndarray
    imu_ang_vel_b: np.ndarray
    imu_acc_b: np.ndarray
    imu_age_s: float
    temperature_c: np.ndarray | None = None
    faults: tuple[str, ...] = ()
    truth: TrueState | None = None

    def __post_init__(self) -> None:
        """Check shapes. Raises ValueError."""
        joints = self.joint_pos_rad.shape
        if len(joints) != 1:
            raise ValueError(f"RobotState.joint_pos_rad: got shape {joints}, expected (J,)")
        for name in ("joint_vel_rad_s", "joint_torque_nm", "joint_age_s"):
            _check_shape("RobotState", name, getattr(self, name), joints)
        if self.temperature_c is not None:
            _check_shape("RobotState", "temperature_c", self.temperature_c, joints)
        _check_shape("RobotState", "imu_quat_wxyz", self.imu_quat_wxyz, (4,))
        _check_shape("RobotState", "imu_ang_vel_b", self.imu_ang_vel_b, (3,))
        _check_shape("RobotState", "imu_acc_b", self.imu_acc_b, (3,))


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
            _check_shape("JointCommand", name, value, joints)
            if not math.isfinite(value.sum()):
                raise ValueError(f"JointCommand.{name}: got a value that is not finite: {value}")
        if self.kp.min(initial=0.0) < 0 or self.kd.min(initial=0.0) < 0:
            raise ValueError(f"JointCommand: got a negative gain, kp {self.kp}, kd {self.kd}, expected >= 0")


def damping_command(damping_kd: np.ndarray) -> JointCommand:
    """kp = 0 with the robot's per-joint damping: needs no state. damping_kd: (J,) Nm s/rad."""
    zero = np.zeros_like(damping_kd, dtype=np.float64)
    return JointCommand(zero, zero, zero, np.asarray(damping_kd, dtype=np.float64), zero)


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What `open()` found. watchdog: what the device does by itself when commands stop, in words; empty: nothing."""

    name: str
    joint_names: tuple[str, ...]
    watchdog: str = ""
    details: Mapping[str, str] = field(default_factory=dict)


def _check_shape(owner: str, name: str, value: np.ndarray, expected: tuple[int, ...]) -> None:
    if value.shape != expected:
        raise ValueError(f"{owner}.{name}: got shape {value.shape}, expected {expected}")
