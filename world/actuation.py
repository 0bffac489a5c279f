"""What a motor is asked for, and the laws by name that a simulated one follows: LAWS is where a new law goes."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from core.arrays import check_shape
from core.errors import InputError
from robot.robot import Robot


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


def _pd_explicit(motor: mujoco.MjsActuator, kp: float, kd: float, limit_nm: float) -> None:
    """Force ctrl - kp q - kd dq; kp and kd begin at 0 and are set in `biasprm` of the compiled model."""
    motor.dyntype = mujoco.mjtDyn.mjDYN_NONE
    motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    motor.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    motor.gainprm[:3] = [1.0, 0.0, 0.0]
    motor.biasprm[:3] = [0.0, 0.0, 0.0]
    motor.ctrllimited = False


def _pd_position(motor: mujoco.MjsActuator, kp: float, kd: float, limit_nm: float) -> None:
    """Force kp (ctrl - q) - kd dq with the joint table's gains; ctrl is the target in rad."""
    motor.set_to_position(kp=kp, kv=kd)
    motor.ctrllimited = False


def _torque(motor: mujoco.MjsActuator, kp: float, kd: float, limit_nm: float) -> None:
    """Force ctrl, in Nm, within the limit."""
    motor.set_to_motor()
    motor.ctrllimited, motor.ctrlrange = True, [-limit_nm, limit_nm]


LAWS: Mapping[str, Callable[[mujoco.MjsActuator, float, float, float], None]] = {
    "pd_explicit": _pd_explicit,
    "pd_position": _pd_position,
    "torque": _torque,
}


def add_motors(spec: mujoco.MjSpec, robot: Robot, law: str) -> None:
    """One motor per joint in joint-table order, named as its joint, its force clipped at the joint's torque limit.

    Raises InputError on an unknown law.
    """
    if law not in LAWS:
        raise InputError("unknown actuation", got=law, expected=f"one of {', '.join(LAWS)}")
    figures = zip(robot.joint_names, robot.kp.tolist(), robot.kd.tolist(), robot.torque_limit_nm.tolist())
    for name, kp, kd, limit_nm in figures:
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        LAWS[law](motor, kp, kd, limit_nm)
        motor.forcelimited, motor.forcerange = True, [-limit_nm, limit_nm]
