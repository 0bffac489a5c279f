"""What every CAN servo protocol offers: frames to a motor, values from its frames, and the mirror image for a device.

A codec is an immutable description of one motor on its wire (ids, ranges); its methods are pure functions of their
arguments. All values are the motor's own: radians, rad/s, Nm at the shaft that the protocol speaks of, before gear,
direction and zero of the joint (`hal.contract.joint_map`).
"""

import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from hal.can.frame import Frame, IdFilter
from hal.can.messages import Feedback, Message

WATCHDOG_S = "watchdog_s"
CONTROL_MODE = "control_mode"
ZERO_MARK = "zero_mark"
SUPPLY_V = "supply_v"


@dataclass(frozen=True, slots=True)
class MotorModel:
    """Ranges of one motor model's fields: positions, velocities, torques are +-max, gains 0..max.

    pos_rad, vel_rad_s, torque_nm, kp (Nm/rad), kd (Nm s/rad). math.inf where the protocol sends plain floats.
    speed_limit_rad_s: where the drive holds back or lets go, if it has said so.
    """

    name: str
    pos_rad: float
    vel_rad_s: float
    torque_nm: float
    kp: float
    kd: float
    speed_limit_rad_s: float = math.inf


@dataclass(frozen=True, slots=True)
class MotorCommand:
    """Torque = kp (q - q_measured) + kd (dq - dq_measured) + tau, computed in the motor, at the motor's shaft."""

    q_rad: float = 0.0
    dq_rad_s: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    tau_nm: float = 0.0

    def __post_init__(self) -> None:
        """Nothing but a finite command with gains >= 0 is packed. Raises ValueError."""
        if not math.isfinite(self.q_rad + self.dq_rad_s + self.kp + self.kd + self.tau_nm):
            raise ValueError(f"motor command: got {self}, expected finite values")
        if self.kp < 0 or self.kd < 0:
            raise ValueError(f"motor command: got {self}, expected gains of at least 0")


@dataclass(frozen=True, slots=True)
class Found:
    """A motor that answered a probe. details: what its answer says (host id, serial number, firmware)."""

    codec: str
    motor_id: int
    details: Mapping[str, str]


class CommandKind(enum.Enum):
    """What a frame from the host asks of a motor."""

    CONTROL = "control"
    GAINS = "gains"
    ENABLE = "enable"
    DISABLE = "disable"
    CLEAR_FAULT = "clear_fault"
    SET_ZERO = "set_zero"
    REQUEST_STATE = "request_state"
    READ = "read"
    WRITE = "write"
    PROBE = "probe"
    IDENTIFY = "identify"


# What changes nothing in the motor.
QUESTIONS = (CommandKind.REQUEST_STATE, CommandKind.READ, CommandKind.PROBE, CommandKind.IDENTIFY)


@dataclass(frozen=True, slots=True)
class DeviceCommand:
    """A host's frame, as the motor understands it.

    command: what is in force afterwards, for CONTROL and GAINS. name, value: for READ and WRITE.
    """

    kind: CommandKind
    command: MotorCommand | None = None
    name: str = ""
    value: float = 0.0

    @property
    def feeds_watchdog(self) -> bool:
        """Whether the motor's own watchdog counts this as a sign of life."""
        return self.kind is not CommandKind.GAINS


@dataclass(frozen=True, slots=True)
class MotorState:
    """What a motor knows of itself, for its answers. faults: names of this module or of the codec."""

    pos_rad: float
    vel_rad_s: float
    torque_nm: float
    temperature_c: float = 30.0
    enabled: bool = False
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Codec(ABC):
    """One motor on its wire, seen from the host, and (last section) seen from the motor.

    motor_id, host_id: their addresses in this protocol. Class facts:
    fd: a CAN-FD bus is needed.
    cyclic_period_s: None where the motor answers each command with one state; else it sends by itself this often.
    watchdog_fault: what the motor shows when its watchdog has expired; None if it only switches off without a word.
    watchdog_damps: it damps then, instead of letting go.

    At start: `set_watchdog`, `read_watchdog`, `read_setup`, then work with the codec that `with_setup` returns.
    """

    motor_id: int
    host_id: int
    model: MotorModel

    name: ClassVar[str] = ""
    fd: ClassVar[bool] = False
    cyclic_period_s: ClassVar[float | None] = None
    watchdog_fault: ClassVar[str | None] = None
    watchdog_damps: ClassVar[bool] = False
    probe_stops: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """One motor from its line in a robot file; host_id None: the protocol's usual one. Raises InputError."""

    @property
    def setup_names(self) -> tuple[str, ...]:
        """The parameters that `with_setup` needs."""
        return ()

    @property
    def has_watchdog(self) -> bool:
        """Whether the host can set the motor's own watchdog and read it back."""
        return False

    @property
    def keeps_zero(self) -> bool:
        """Whether the motor knows its zero after its power was off, up to whole turns."""
        return True

    @property
    @abstractmethod
    def reply_filter(self) -> IdFilter:
        """Arbitration ids of this motor's answers."""

    @property
    @abstractmethod
    def occupied(self) -> tuple[IdFilter, ...]:
        """All arbitration ids that belong to this motor alone, both ways: disjoint between the motors of one bus."""

    @abstractmethod
    def enable(self) -> tuple[Frame, ...]:
        """Switch the drive on, slack: until the first command no torque is asked for."""

    @abstractmethod
    def disable(self) -> tuple[Frame, ...]:
        """Switch the drive off."""

    @abstractmethod
    def clear_fault(self) -> tuple[Frame, ...]:
        """Clear a latched fault, on the operator's word only. Energises nothing."""

    @abstractmethod
    def set_zero(self) -> tuple[Frame, ...]:
        """Make the present position the motor's zero. Only while disabled."""

    @abstractmethod
    def request_state(self) -> tuple[Frame, ...]:
        """Ask a disabled motor for its state. Where the protocol has no question, this repeats the switching off."""

    @abstractmethod
    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """Clamp to the ranges and pack. last: what this motor was last sent; what it still holds may be left out.

        Raises ValueError for kp > 0 with kd = 0 where the protocol cannot or must not do that.
        """

    def damping(self, kd: float, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """kp = 0, target velocity 0, this kd (Nm s/rad at the motor's shaft)."""
        return self.command(MotorCommand(kd=kd), last)

    def set_watchdog(self, timeout_s: float) -> tuple[Frame, ...]:
        """Set the motor's own time limit without commands (s). Empty where `has_watchdog` is False."""
        return ()

    def read_watchdog(self) -> tuple[Frame, ...]:
        """Ask for it: the answer parses as Parameter(WATCHDOG_S). Empty where `has_watchdog` is False."""
        return ()

    def ask_supply(self) -> tuple[Frame, ...]:
        """Ask for the supply voltage, also while the motor is driven: the answer parses as Parameter(SUPPLY_V).

        Empty where the motor tells it by itself, or not at all.
        """
        return ()

    def ask_identity(self) -> tuple[Frame, ...]:
        """Ask for the maker's number: the answer parses as Identity. Empty where the protocol has none."""
        return ()

    def mark_zeroed(self, mark: float) -> tuple[Frame, ...]:
        """Write `ZERO_MARK`, which the motor forgets together with its zero. Empty where it keeps no such number."""
        return ()

    def read_setup(self) -> tuple[Frame, ...]:
        """Ask for every parameter in `setup_names`, one frame each in their order. Energises nothing."""
        return ()

    def with_setup(self, parameters: Mapping[str, float]) -> Self:
        """The codec with what the motor said of itself in place of the table. Raises DeviceFault if unusable."""
        return self

    def check_feedback(self, parameters: Mapping[str, float], feedback: Feedback) -> None:
        """Compare state with what the motor said of itself, at rest. Raises DeviceFault where the scaling is wrong."""
        return

    @abstractmethod
    def parse(self, frame: Frame) -> Message | None:
        """What this motor says with the frame; None for anything that is not certainly from it and understood."""

    def is_commanded_by(self, frame: Frame) -> bool:
        """Whether the frame, which is none of the motor's, asks it for more than an answer."""
        asked = self.parse_command(frame, MotorCommand())
        return asked is not None and asked.kind not in QUESTIONS

    @classmethod
    @abstractmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """Ask whether a motor listens on this id. Energises nothing and changes no setting.

        `probe_stops`: the question takes the drive away from a motor that has it.
        """

    @classmethod
    @abstractmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """The motor that a frame reveals, for a scan: answers to `probe` and self-announcements."""

    @classmethod
    def speaks_unasked(cls, frame: Frame) -> bool:
        """Whether motors of this protocol may send the frame though nobody commands them."""
        return False

    # The motor's side.

    @abstractmethod
    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """What the frame asks of this motor; None if it is not for it. held: the command in force until now."""

    @abstractmethod
    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """The motor's state as it sends it: after each command, or every `cyclic_period_s`."""

    def reply_frames(self, asked: DeviceCommand, value: float = 0.0) -> tuple[Frame, ...]:
        """The answer to READ (the parameter's value), WRITE, PROBE and IDENTIFY (value: the serial number) where it is
        not state; empty if there is none."""
        return ()
