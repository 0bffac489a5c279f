"""What the hardware abstraction layer hands up: states, device facts and errors.

Every per-joint array has shape (J,) in the robot's joint-table order, float64.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from core.arrays import check_shape
from world.plant import TrueState


class DeviceError(RuntimeError):
    """The device, or the way to it, does not work. Commands end with exit code 4."""


class LinkLost(DeviceError):
    """The device has been silent for longer than the link's timeout, or the link is gone."""


class NoState(DeviceError):
    """No complete state (every joint and the IMU) has arrived yet."""


class DeviceFault(DeviceError):
    """The device answered and refuses to work."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """One reading of all joints and the IMU. Values may be non-finite: that is what the device said.

    time_s: the clock's time of the reading.
    joint_age_s: (J,) time since each joint's value was measured; imu_age_s likewise.
    imu_quat_wxyz: IMU (base) to world. imu_ang_vel_b in rad/s. imu_acc_b: specific force in m/s^2, (0, 0, 9.81) at
    rest upright.
    temperature_c: (J,) or None where the device has no sensor. faults: the device's own, by name; empty when healthy.
    energised: whether the devices obey what is written. False before the first command, and for as long after it as
    a motion service takes to let go or servos take to be enabled.
    charge: what is left in the battery, 0 to 1. supply, supply_high: lowest and highest supply voltage of all motors
    over the nominal one. nan: not reported.
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
    energised: bool = True
    charge: float = math.nan
    supply: float = math.nan
    supply_high: float = math.nan
    truth: TrueState | None = None

    def __post_init__(self) -> None:
        """Check shapes. Raises ValueError."""
        joints = self.joint_pos_rad.shape
        if len(joints) != 1:
            raise ValueError(f"RobotState.joint_pos_rad: got shape {joints}, expected (J,)")
        for name in ("joint_vel_rad_s", "joint_torque_nm", "joint_age_s"):
            check_shape("RobotState", name, getattr(self, name), joints)
        if self.temperature_c is not None:
            check_shape("RobotState", "temperature_c", self.temperature_c, joints)
        check_shape("RobotState", "imu_quat_wxyz", self.imu_quat_wxyz, (4,))
        check_shape("RobotState", "imu_ang_vel_b", self.imu_ang_vel_b, (3,))
        check_shape("RobotState", "imu_acc_b", self.imu_acc_b, (3,))


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What `open()` found. watchdog: what the device does by itself when commands stop, in words; empty: nothing.

    identities: the makers' numbers of motors (by joint) and adapters (`bus NAME`, `port NAME`, `imu`), or what else
    tells this robot from another; without those that have none.
    gain_limits: largest kp and kd that a device takes, at its joint; larger ones would be cut. Without those that have
    no such limit.
    """

    name: str
    joint_names: tuple[str, ...]
    watchdog: str = ""
    details: Mapping[str, str] = field(default_factory=dict)
    identities: Mapping[str, str] = field(default_factory=dict)
    gain_limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
