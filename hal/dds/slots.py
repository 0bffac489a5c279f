"""Where each joint stands among the G1's motors, and what the motors are called to do."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from core.structured import at_least, one_of, positive, within
from robot.robot import Robot

# The 29-motor G1, in the order of the wire; the last six of the wire's 35 places have no motor.
_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
SLOT_NAMES = (
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in _LEG),
    *(f"waist_{part}_joint" for part in ("yaw", "roll", "pitch")),
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in _ARM),
)
SLOTS = len(SLOT_NAMES)

# What LowState.mode_machine says about the motors that are there.
FULL_MACHINES = frozenset({5, 11, 13, 15, 18})
REFUSED_MACHINES: Mapping[int, str] = {
    0: "a simulation that reports no machine",
    4: "a G1 without waist roll and pitch (23 motors)",
    10: "a G1 without waist roll and pitch (23 motors)",
    6: "a G1 whose waist is locked",
    12: "a G1 whose waist is locked",
    14: "a G1 whose waist is locked",
    16: "a G1 whose waist is locked",
}

MOTOR_FAULTS: Mapping[int, str] = {
    0x1: "overcurrent",
    0x2: "transient overvoltage",
    0x4: "sustained overvoltage",
    0x8: "transient undervoltage",
    0x10: "chip too hot",
    0x20: "power stage too hot",
    0x80: "casing too hot",
    0x200: "winding too hot",
    0x400: "rotor encoder 1",
    0x800: "rotor encoder 2",
    0x1000: "output encoder",
    0x2000: "calibration",
    0x4000: "reset",
    0x40000000: "no commands",
    0x80000000: "disconnected",
}
DISCONNECTED = 0x80000000
# Our own silence, and what a motor says before it has been told anything.
COMMAND_TIMEOUT = 0x40000000


@dataclass(frozen=True)
class HeldMotor:
    """A motor that is not the actor's: where it is held, with which gains, its gain while damped, and its limits."""

    name: str
    pos_rad: float
    kp: float
    kd: float
    damping_kd: float
    range_rad: tuple[float, float]
    torque_nm: float

    def __post_init__(self) -> None:
        """Check. Raises InputError."""
        one_of("name", self.name, SLOT_NAMES, "unknown motor")
        for gain in ("kp", "kd", "damping_kd"):
            at_least(gain, getattr(self, gain), 0)
        positive("torque_nm", self.torque_nm)
        within("pos_rad", self.pos_rad, *self.range_rad)


class SlotMap:
    """The robot's joints and the held ones, on the wire's slots. Raises InputError unless they share out all motors.

    robot: (J,) slot of each joint, in the robot's order. held: (H,) slots of the held joints.
    """

    def __init__(self, robot: Robot, held: tuple[HeldMotor, ...]) -> None:
        names = (*robot.joint_names, *(joint.name for joint in held))
        where = f"robot {robot.name} on a G1"
        if unknown := [name for name in robot.joint_names if name not in SLOT_NAMES]:
            raise InputError("joints without a motor", where=where, got=", ".join(unknown))
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError("driven and held at once", where=where, got=", ".join(twice))
        if left_out := [name for name in SLOT_NAMES if name not in names]:
            raise InputError("motors that nobody holds", where=where, got=", ".join(left_out), hint="add them to held")
        self.robot = np.array([SLOT_NAMES.index(name) for name in robot.joint_names])
        self.held = np.array([SLOT_NAMES.index(joint.name) for joint in held], dtype=int)


def machine_refusal(mode_machine: int, described: int) -> str | None:
    """Why a machine cannot be driven; None where it is the one described: all 29 motors, a free waist, its generation.

    described: the mode_machine that robot file and actors are for.
    """
    if mode_machine == described:
        return None
    if mode_machine in FULL_MACHINES:
        return (
            f"mode_machine {mode_machine} is a G1 of another generation than {described}, which robot file and"
            " actors are for: gears and wrist motors differ; write `mode_machine` where you have those for it"
        )
    what = REFUSED_MACHINES.get(mode_machine, "unknown")
    expected = ", ".join(str(mode) for mode in sorted(FULL_MACHINES))
    return f"mode_machine {mode_machine} is {what}, expected a G1 with 29 free motors ({expected})"


def fault_words(motorstate: int) -> str:
    """The bits of a motor's state in words; unknown ones as a number."""
    words = [word for bit, word in MOTOR_FAULTS.items() if motorstate & bit]
    unknown = motorstate & ~sum(MOTOR_FAULTS)
    return ", ".join([*words, *([f"bits {unknown:#x}"] if unknown else [])])
