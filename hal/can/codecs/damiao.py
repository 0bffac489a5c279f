"""Damiao DM-J servos, MIT mode: classic CAN at 1 Mbit/s, 11-bit identifiers, one answer to each frame.

Damping frame: the MIT command with kp = 0, velocity 0, torque 0 and the joint's kd, e.g. (DM4310, kd 2.5) 80 00 80 00
00 80 08 00. No code stands for exactly zero: velocity and torque are off by half a step (DM4310: 0.007 rad/s, 0.002
Nm). It needs an enabled motor; the command id is the motor's id.

Watchdog: register 9, in steps of 50 us, 0 switches it off; the factory value is not documented. Without a frame for
that long the motor leaves the enabled mode, which lets the joint go, and answers with status D ("communication_lost").
Written to memory at each start and read back; it is not saved.

The serial number is register 15. The ranges are registers of the motor (21, 22, 23) and published tables disagree: the
table here serves until they are read. Every answer comes on the motor's own MST_ID (register 7, factory 0, which all
motors would share): give each motor its id + 0x10. Register answers and other programs' requests look like states near
the lower end of the range; they are told apart by their second to fourth byte, at the price of dropping a rare true
state there.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from hal.can import fault_names
from hal.can.codec import (
    CONTROL_MODE,
    WATCHDOG_S,
    CommandKind,
    DeviceCommand,
    Found,
    MotorCommand,
    MotorModel,
    MotorState,
)
from hal.can.codecs.mit import MitCodec
from hal.can.codecs.options import checked_id, checked_model, no_more
from hal.can.codecs.scaling import pack_mit_state, unpack_mit_state
from hal.can.frame import STANDARD_ID_MAX, Frame, IdFilter
from hal.can.messages import Ack, Feedback, Identity, Message, Parameter
from hal.contract.types import DeviceFault

POS_RANGE_RAD = "pos_range_rad"
VEL_RANGE_RAD_S = "vel_range_rad_s"
TORQUE_RANGE_NM = "torque_range_nm"

REGISTER_ID = 0x7FF
HOST_ID_OFFSET = 0x10
MIT_MODE = 1
STEPS_PER_S = 20_000
READ, WRITE, STORE, STATE = 0x33, 0x55, 0xAA, 0xCC
LAST_REGISTER = 81
MST_ID_REGISTER = 7
SERIAL_REGISTER = 15

REGISTERS = {9: WATCHDOG_S, 10: CONTROL_MODE, 21: POS_RANGE_RAD, 22: VEL_RANGE_RAD_S, 23: TORQUE_RANGE_NM}
NUMBERS = {name: number for number, name in REGISTERS.items()}
INTEGER_REGISTERS = frozenset((7, 8, 9, 10, 13, 14, 15, 16, 35, 36))

CLEAR_FAULT = 0xFB

DISABLED, ENABLED = 0, 1
FAULTS = {
    0x8: fault_names.OVER_VOLTAGE,
    0x9: fault_names.UNDER_VOLTAGE,
    0xA: fault_names.OVER_CURRENT,
    0xB: fault_names.DRIVER_OVER_TEMPERATURE,
    0xC: fault_names.MOTOR_OVER_TEMPERATURE,
    0xD: fault_names.COMMUNICATION_LOST,
    0xE: fault_names.OVERLOAD,
}
FAULT_CODES = {name: code for code, name in FAULTS.items()}

MODELS = {
    name: MotorModel(name, pos, vel, torque, 500.0, 5.0)
    for name, pos, vel, torque in (
        ("DM3507", 12.5, 50.0, 5.0),
        ("DM4310", 12.5, 30.0, 10.0),
        ("DM4310P", 12.5, 50.0, 10.0),
        ("DM4340", 12.5, 10.0, 28.0),
        ("DM4340P", 12.5, 20.0, 28.0),
        ("DM6006", 12.5, 45.0, 20.0),
        ("DM8006", 12.5, 45.0, 40.0),
        ("DM8009", 12.5, 45.0, 54.0),
        ("DM10010L", 12.5, 25.0, 200.0),
        ("DM10010", 12.5, 20.0, 200.0),
        ("DMH3510", 12.5, 280.0, 1.0),
        ("DMH6215", 12.5, 45.0, 10.0),
        ("DMG6220", 12.5, 45.0, 10.0),
    )
}


@dataclass(frozen=True)
class DamiaoCodec(MitCodec):
    """motor_id: ESC_ID (register 8). host_id: MST_ID (register 7), on which the motor answers. No options."""

    name = "damiao"
    watchdog_fault = fault_names.COMMUNICATION_LOST
    special_kinds: ClassVar = {**MitCodec.special_kinds, CLEAR_FAULT: CommandKind.CLEAR_FAULT}

    @classmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """See Codec."""
        no_more(cls.name, options)
        motor = checked_id("damiao motor id", motor_id, 1, 0xFF)
        answers = checked_id("damiao host id", motor + HOST_ID_OFFSET if host_id is None else host_id, 0, 0x7FE)
        return cls(motor, answers, checked_model(cls.name, MODELS, model))

    @property
    def setup_names(self) -> tuple[str, ...]:
        """See Codec."""
        return (CONTROL_MODE, POS_RANGE_RAD, VEL_RANGE_RAD_S, TORQUE_RANGE_NM)

    @property
    def has_watchdog(self) -> bool:
        """See Codec."""
        return True

    @property
    def occupied(self) -> tuple[IdFilter, ...]:
        """The motor's id, also with the offsets of its other modes, and the id of its answers."""
        modes = tuple(IdFilter(self.motor_id + offset, STANDARD_ID_MAX, False) for offset in (0, 0x100, 0x200, 0x300))
        return (*modes, self.reply_filter)

    def clear_fault(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._special(CLEAR_FAULT),)

    def request_state(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (_register_frame(self.motor_id, STATE),)

    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """See Codec. kp needs a kd above 0: the vendor's manual warns of oscillation without."""
        if target.kp > 0 and target.kd == 0:
            raise ValueError(f"damiao motor {self.motor_id}: got kp {target.kp:g} with kd 0, expected kd above 0")
        return super().command(target, last)

    def set_watchdog(self, timeout_s: float) -> tuple[Frame, ...]:
        """See Codec."""
        return (_register_frame(self.motor_id, WRITE, 9, _packed(9, timeout_s)),)

    def read_watchdog(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (_register_frame(self.motor_id, READ, 9),)

    def ask_identity(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (_register_frame(self.motor_id, READ, SERIAL_REGISTER),)

    def read_setup(self) -> tuple[Frame, ...]:
        """See Codec."""
        return tuple(_register_frame(self.motor_id, READ, NUMBERS[name]) for name in self.setup_names)

    def with_setup(self, parameters: Mapping[str, float]) -> Self:
        """See Codec. Refuses another control mode than MIT and ranges that are no ranges."""
        mode = parameters[CONTROL_MODE]
        if mode != MIT_MODE:
            raise DeviceFault(
                f"damiao motor {self.motor_id}: control mode {mode:g}, expected {MIT_MODE} (MIT);"
                " set register 10 with the vendor's tool"
            )
        ranges = [parameters[name] for name in (POS_RANGE_RAD, VEL_RANGE_RAD_S, TORQUE_RANGE_NM)]
        if not all(0 < value < math.inf for value in ranges):
            raise DeviceFault(f"damiao motor {self.motor_id}: ranges {ranges}, expected three numbers above 0")
        pos, vel, torque = ranges
        return replace(self, model=replace(self.model, pos_rad=pos, vel_rad_s=vel, torque_nm=torque))

    def parse(self, frame: Frame) -> Message | None:
        """See Codec."""
        data = frame.data
        if frame.arbitration_id != self.host_id or frame.extended or frame.remote or len(data) != 8:
            return None
        if _is_register_answer(data):
            return self._parse_register(data)
        if data[0] & 0xF != self.motor_id & 0xF:
            return None
        pos, vel, torque = unpack_mit_state(data[1:6], self.model)
        status = data[0] >> 4
        healthy = status in (DISABLED, ENABLED)
        faults = () if healthy else (FAULTS.get(status, f"status_{status:x}"),)
        return Feedback(self.motor_id, pos, vel, torque, float(max(data[6], data[7])), faults, status == ENABLED)

    def _parse_register(self, data: bytes) -> Message | None:
        if data[0] | data[1] << 8 != self.motor_id:
            return None
        if data[2] == WRITE:
            return Ack(self.motor_id, f"write register {data[3]}")
        if data[2] == STORE:
            return Ack(self.motor_id, "store")
        if data[2] == READ and data[3] == SERIAL_REGISTER:
            return Identity(self.motor_id, data[7:3:-1].hex())
        if data[2] == READ and data[3] in REGISTERS:
            return Parameter(self.motor_id, REGISTERS[data[3]], _unpacked(data[3], data[4:]))
        return None

    @classmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """See Codec. Asks for MST_ID, so that a motor answers whatever it is set to."""
        return (_register_frame(motor_id, READ, MST_ID_REGISTER),)

    @classmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """See Codec. The answer names the identifier that it comes on: that is proof."""
        data = frame.data
        if frame.extended or frame.remote or len(data) != 8 or data[2] != READ or data[3] != MST_ID_REGISTER:
            return None
        if int.from_bytes(data[4:], "little") != frame.arbitration_id:
            return None
        return Found(cls.name, data[0] | data[1] << 8, {"host_id": str(frame.arbitration_id)})

    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """See Codec. Register 7 is asked for by PROBE."""
        data = frame.data
        if frame.extended or frame.remote or len(data) != 8:
            return None
        if frame.arbitration_id == REGISTER_ID:
            return self._parse_request(data)
        if frame.arbitration_id != self.motor_id:
            return None
        return self._understood(data)

    def _parse_request(self, data: bytes) -> DeviceCommand | None:
        if data[0] | data[1] << 8 != self.motor_id:
            return None
        if data[2] == STATE:
            return DeviceCommand(CommandKind.REQUEST_STATE)
        if data[2] == READ and data[3] == MST_ID_REGISTER:
            return DeviceCommand(CommandKind.PROBE)
        if data[2] == READ and data[3] == SERIAL_REGISTER:
            return DeviceCommand(CommandKind.IDENTIFY)
        if data[2] == READ and data[3] in REGISTERS:
            return DeviceCommand(CommandKind.READ, name=REGISTERS[data[3]])
        if data[2] == WRITE and data[3] in REGISTERS:
            return DeviceCommand(CommandKind.WRITE, name=REGISTERS[data[3]], value=_unpacked(data[3], data[4:]))
        return None

    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """See Codec. One fault at a time: the first that has a code."""
        codes = [FAULT_CODES[name] for name in state.faults if name in FAULT_CODES]
        status = codes[0] if codes else int(state.enabled)
        temperature = min(max(round(state.temperature_c), 0), 255)
        values = pack_mit_state(state.pos_rad, state.vel_rad_s, state.torque_nm, self.model)
        data = bytes([self.motor_id & 0xF | status << 4, *values, temperature, temperature])
        return (Frame(self.host_id, data),)

    def reply_frames(self, asked: DeviceCommand, value: float = 0.0) -> tuple[Frame, ...]:
        """See Codec. WRITE is echoed."""
        if asked.kind is CommandKind.PROBE:
            answer = _register_frame(self.motor_id, READ, MST_ID_REGISTER, self.host_id.to_bytes(4, "little"))
        elif asked.kind is CommandKind.IDENTIFY:
            answer = _register_frame(self.motor_id, READ, SERIAL_REGISTER, int(value).to_bytes(4, "little"))
        elif asked.kind is CommandKind.READ:
            answer = _register_frame(self.motor_id, READ, NUMBERS[asked.name], _packed(NUMBERS[asked.name], value))
        elif asked.kind is CommandKind.WRITE:
            number = NUMBERS[asked.name]
            answer = _register_frame(self.motor_id, WRITE, number, _packed(number, asked.value))
        else:
            return ()
        return (replace(answer, arbitration_id=self.host_id),)


def _register_frame(motor_id: int, action: int, register: int = 0, value: bytes = bytes(4)) -> Frame:
    return Frame(REGISTER_ID, bytes([motor_id & 0xFF, motor_id >> 8, action, register]) + value)


def _is_register_answer(data: bytes) -> bool:
    return data[1] <= 0x0F and data[2] in (READ, WRITE, STORE, STATE) and data[3] <= LAST_REGISTER


def _packed(register: int, value: float) -> bytes:
    if register == NUMBERS[WATCHDOG_S]:
        return round(value * STEPS_PER_S).to_bytes(4, "little")
    if register in INTEGER_REGISTERS:
        return int(value).to_bytes(4, "little")
    return struct.pack("<f", value)


def _unpacked(register: int, value: bytes) -> float:
    if register == NUMBERS[WATCHDOG_S]:
        return int.from_bytes(value, "little") / STEPS_PER_S
    if register in INTEGER_REGISTERS:
        return float(int.from_bytes(value, "little"))
    return float(struct.unpack("<f", value)[0])
