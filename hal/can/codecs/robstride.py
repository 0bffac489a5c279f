"""RobStride servos and Xiaomi CyberGear, private protocol: classic CAN at 1 Mbit/s, 29-bit identifiers, always 8 bytes.

Identifier: type (bits 28..24), second field (23..8), destination (7..0). Commands and states are big-endian, parameters
little-endian.

Damping frame: type 1 with kp = 0, velocity 0 and the joint's kd; the torque, zero, rides in the second field, e.g.
(motor 1, RS03, kd 50) id 01800001, data 80 00 80 00 00 00 80 00. It needs an enabled motor.

Watchdog: parameter 0x7028, 20000 for one second, 0 (factory) switches it off. Without a frame for that long the motor
goes to its reset mode, which lets the joint go; the state then says "not enabled" and no fault. Written to memory at
each start and read back.

Angles wrap at the ends of the range, they do not clamp. Switching off is the only question that is answered with a
state and nothing else. The scaling cannot be read: it is pinned by model. The model is recognised by its torque limit
(parameter 0x700B, from the factory its peak torque), as the ranges of gains and torques go with it; the angle is
compared with parameter 0x7019, a float. RS01 before 0.1.3.4 and RS02 before 0.2.3.6 apply 1.4167 times the gains: these
models are asked for their firmware (type 4 with 00 C4; the answer is a type 2 frame that begins with 00 C4 56), and
refused where it is older.

States do not tell the supply voltage; parameter 0x701C, a float in V, does, in an answer of its own.

The processor's serial number answers type 0. A CyberGear forgets its zero without power. The speed reference (0x700A),
which no mode in use obeys, is forgotten with it: there a zeroing leaves its mark.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from hal.can.codec import (
    SUPPLY_V,
    WATCHDOG_S,
    ZERO_MARK,
    Codec,
    CommandKind,
    DeviceCommand,
    Found,
    MotorCommand,
    MotorState,
)
from hal.can.codecs.options import checked_id, checked_model, no_more
from hal.can.codecs.robstride_tables import FIRST_TRUE_GAINS, MODELS, REPORTED_FAULTS, STATE_FAULTS
from hal.can.codecs.scaling import from_code, to_code
from hal.can.frame import EXTENDED_ID_MAX, Frame, IdFilter
from hal.can.messages import Ack, Feedback, Identity, Message, Parameter
from hal.contract.types import DeviceFault

MECHANICAL_POS_RAD = "mechanical_pos_rad"
TORQUE_LIMIT_NM = "torque_limit_nm"
FIRMWARE = "firmware"
RUN_MODE = "run_mode"

PROBE, CONTROL, STATE, ENABLE, STOP, ZERO, READ, WRITE, FAULT = 0, 1, 2, 3, 4, 6, 17, 18, 21
ACTIVE_STATE = 24
HOST_ID = 0xFD
PROBE_ANSWER_ID = 0xFE
RUNNING = 2
STEPS_PER_S = 20_000
SCALING_TOLERANCE_RAD = 0.05
TORQUE_TOLERANCE = 0.01
VERSION_QUESTION, VERSION_ANSWER = b"\x00\xc4", b"\x00\xc4\x56"
FORGETFUL = "CyberGear"

INDICES = {
    0x7005: RUN_MODE,
    0x700A: ZERO_MARK,
    0x700B: TORQUE_LIMIT_NM,
    0x7019: MECHANICAL_POS_RAD,
    0x701C: SUPPLY_V,
    0x7028: WATCHDOG_S,
}
NUMBERS = {name: index for index, name in INDICES.items()}


@dataclass(frozen=True)
class RobstrideCodec(Codec):
    """motor_id: 1..126 (127 is the factory's). host_id: 0xFD unless set. No options."""

    name = "robstride"

    @classmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """See Codec."""
        no_more(cls.name, options)
        motor = checked_id("robstride motor id", motor_id, 1, 0x7F)
        host = checked_id("robstride host id", HOST_ID if host_id is None else host_id, 0x80, 0xFD)
        return cls(motor, host, checked_model(cls.name, MODELS, model))

    @property
    def setup_names(self) -> tuple[str, ...]:
        """See Codec."""
        version = (FIRMWARE,) if self.model.name in FIRST_TRUE_GAINS else ()
        mark = () if self.keeps_zero else (ZERO_MARK,)
        return (MECHANICAL_POS_RAD, TORQUE_LIMIT_NM, *version, *mark)

    @property
    def has_watchdog(self) -> bool:
        """See Codec."""
        return True

    @property
    def keeps_zero(self) -> bool:
        """See Codec."""
        return self.model.name != FORGETFUL

    @property
    def reply_filter(self) -> IdFilter:
        """See Codec. Bits 15..8 hold the sender; the torque of commands and the faults of states lie above them."""
        return IdFilter(self.motor_id << 8, 0xFF00, True)

    @property
    def occupied(self) -> tuple[IdFilter, ...]:
        """Answers by their sender; commands, which carry the torque in those bits, cannot be told apart by id alone."""
        return (IdFilter(STATE << 24 | self.motor_id << 8, 0x1F00_FF00, True),)

    def enable(self) -> tuple[Frame, ...]:
        """See Codec. Sets the run mode with gains first, which a running motor would not accept."""
        return (self._write(RUN_MODE, 0.0), self._frame(ENABLE))

    def disable(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(STOP),)

    def clear_fault(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(STOP, b"\x01"),)

    def set_zero(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(ZERO, b"\x01"),)

    def request_state(self) -> tuple[Frame, ...]:
        """See Codec. Repeats the stop."""
        return self.disable()

    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """See Codec."""
        model = self.model
        torque = to_code(target.tau_nm, -model.torque_nm, model.torque_nm, 16)
        kd = to_code(target.kd, 0.0, model.kd, 16)
        data = struct.pack(
            ">HHHH",
            to_code(target.q_rad, -model.pos_rad, model.pos_rad, 16),
            to_code(target.dq_rad_s, -model.vel_rad_s, model.vel_rad_s, 16),
            to_code(target.kp, 0.0, model.kp, 16),
            max(kd, 1) if target.kd > 0 else kd,
        )
        return (Frame(CONTROL << 24 | torque << 8 | self.motor_id, data, extended=True),)

    def set_watchdog(self, timeout_s: float) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._write(WATCHDOG_S, timeout_s),)

    def read_watchdog(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._read(WATCHDOG_S),)

    def read_setup(self) -> tuple[Frame, ...]:
        """See Codec."""
        version = self._frame(STOP, VERSION_QUESTION)
        return tuple(version if name == FIRMWARE else self._read(name) for name in self.setup_names)

    def ask_supply(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._read(SUPPLY_V),)

    def ask_identity(self) -> tuple[Frame, ...]:
        """See Codec."""
        return self.probe(self.motor_id, self.host_id)

    def mark_zeroed(self, mark: float) -> tuple[Frame, ...]:
        """See Codec."""
        return () if self.keeps_zero else (self._write(ZERO_MARK, mark),)

    def with_setup(self, parameters: Mapping[str, float]) -> Self:
        """See Codec. Refuses another model than the file's, and firmware with false gains."""
        limit_nm, peak_nm = parameters[TORQUE_LIMIT_NM], self.model.torque_nm
        if not abs(limit_nm - peak_nm) <= TORQUE_TOLERANCE * peak_nm:
            raise DeviceFault(
                f"robstride motor {self.motor_id}: its torque limit (0x700B) is {limit_nm:g} Nm, that of"
                f" {self.model.name} is {peak_nm:g} Nm: another model, which would multiply every gain and torque"
                " by another range; correct the model in the robot file, or set 0x700B back to the factory's"
            )
        if FIRMWARE in parameters:
            self._check_firmware(int(parameters[FIRMWARE]))
        return self

    def _check_firmware(self, code: int) -> None:
        first = FIRST_TRUE_GAINS[self.model.name]
        found = tuple(code.to_bytes(4, "big"))
        if found < first:
            raise DeviceFault(
                f"robstride motor {self.motor_id}: firmware {'.'.join(map(str, found))} of {self.model.name}"
                f" applies 1.4167 times the gains asked for, expected at least {'.'.join(map(str, first))}: update it"
            )

    def check_feedback(self, parameters: Mapping[str, float], feedback: Feedback) -> None:
        """See Codec. The scaled angle must agree with the float, up to whole turns, within 0.05 rad."""
        said_rad = parameters[MECHANICAL_POS_RAD]
        if feedback.pos_rad is None:
            return
        apart_rad = (
            abs(math.remainder(said_rad - feedback.pos_rad, 2 * math.pi)) if math.isfinite(said_rad) else math.inf
        )
        if apart_rad > SCALING_TOLERANCE_RAD:
            raise DeviceFault(
                f"robstride motor {self.motor_id}: its state says {feedback.pos_rad:.3f} rad with the ranges of"
                f" {self.model.name}, its parameter 0x7019 says {said_rad:.3f} rad; check the model in the robot file"
            )

    def parse(self, frame: Frame) -> Message | None:
        """See Codec."""
        if not _is_ours(frame) or frame.arbitration_id >> 8 & 0xFF != self.motor_id:
            return None
        kind = frame.arbitration_id >> 24
        destination = frame.arbitration_id & 0xFF
        if kind == PROBE and destination == PROBE_ANSWER_ID:
            return Identity(self.motor_id, frame.data.hex())
        if destination != self.host_id:
            return None
        if kind == STATE:
            return self._parse_state(frame)
        if kind == READ:
            return self._parse_parameter(frame)
        if kind == FAULT and not frame.arbitration_id >> 16 & 0xFF:
            return Feedback(self.motor_id, faults=_named(int.from_bytes(frame.data[:4], "little"), REPORTED_FAULTS))
        return None

    def _parse_state(self, frame: Frame) -> Message | None:
        if frame.data.startswith(VERSION_ANSWER):
            return Parameter(self.motor_id, FIRMWARE, float(int.from_bytes(frame.data[3:7], "big")))
        pos, vel, torque, temperature = struct.unpack(">HHHh", frame.data)
        model = self.model
        mode = frame.arbitration_id >> 22 & 0x3
        if mode == 3:
            return None
        return Feedback(
            self.motor_id,
            from_code(pos, -model.pos_rad, model.pos_rad, 16),
            from_code(vel, -model.vel_rad_s, model.vel_rad_s, 16),
            from_code(torque, -model.torque_nm, model.torque_nm, 16),
            temperature / 10,
            _named(frame.arbitration_id & 0x3F_0000, STATE_FAULTS),
            mode == RUNNING,
        )

    def _parse_parameter(self, frame: Frame) -> Message | None:
        index, reserved = struct.unpack("<HH", frame.data[:4])
        status = frame.arbitration_id >> 16 & 0xFF
        if index not in INDICES or reserved or status > 1:
            return None
        if status == 1:
            return Ack(self.motor_id, f"read {INDICES[index]}", ok=False)
        return Parameter(self.motor_id, INDICES[index], _unpacked(index, frame.data[4:]))

    @classmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """See Codec. Asks for the processor's serial number."""
        return (Frame(PROBE << 24 | host_id << 8 | motor_id, bytes(8), extended=True),)

    @classmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """See Codec."""
        sender = frame.arbitration_id >> 8
        if not _is_ours(frame) or frame.arbitration_id & 0xFF != PROBE_ANSWER_ID or not 1 <= sender <= 0x7F:
            return None
        return Found(cls.name, sender, {"serial": frame.data.hex()})

    @classmethod
    def speaks_unasked(cls, frame: Frame) -> bool:
        """See Codec. Faults, and states where active reporting is on."""
        return frame.extended and frame.arbitration_id >> 24 in (FAULT, ACTIVE_STATE)

    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """See Codec."""
        if not _is_ours(frame) or frame.arbitration_id & 0xFF != self.motor_id:
            return None
        kind = frame.arbitration_id >> 24
        if kind == CONTROL:
            return self._parse_control(frame)
        if kind == STOP and frame.data.startswith(VERSION_QUESTION):
            return DeviceCommand(CommandKind.READ, name=FIRMWARE)
        if kind == STOP:
            return DeviceCommand(CommandKind.CLEAR_FAULT if frame.data[0] == 1 else CommandKind.DISABLE)
        if kind == ENABLE:
            return DeviceCommand(CommandKind.ENABLE)
        if kind == PROBE:
            return DeviceCommand(CommandKind.IDENTIFY)
        if kind == ZERO and frame.data[0] == 1:
            return DeviceCommand(CommandKind.SET_ZERO)
        index = int.from_bytes(frame.data[:2], "little")
        if kind == READ and index in INDICES:
            return DeviceCommand(CommandKind.READ, name=INDICES[index])
        if kind == WRITE and index in INDICES:
            return DeviceCommand(CommandKind.WRITE, name=INDICES[index], value=_unpacked(index, frame.data[4:]))
        return None

    def _parse_control(self, frame: Frame) -> DeviceCommand:
        pos, vel, kp, kd = struct.unpack(">HHHH", frame.data)
        model = self.model
        command = MotorCommand(
            q_rad=from_code(pos, -model.pos_rad, model.pos_rad, 16),
            dq_rad_s=from_code(vel, -model.vel_rad_s, model.vel_rad_s, 16),
            kp=from_code(kp, 0.0, model.kp, 16),
            kd=from_code(kd, 0.0, model.kd, 16),
            tau_nm=from_code(frame.arbitration_id >> 8 & 0xFFFF, -model.torque_nm, model.torque_nm, 16),
        )
        return DeviceCommand(CommandKind.CONTROL, command)

    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """See Codec. The angle wraps into the range."""
        model = self.model
        wrapped_rad = math.remainder(state.pos_rad, 2 * model.pos_rad)
        data = struct.pack(
            ">HHHh",
            to_code(wrapped_rad, -model.pos_rad, model.pos_rad, 16),
            to_code(state.vel_rad_s, -model.vel_rad_s, model.vel_rad_s, 16),
            to_code(state.torque_nm, -model.torque_nm, model.torque_nm, 16),
            round(min(max(state.temperature_c, -40.0), 200.0) * 10),
        )
        status = sum(1 << bit for bit, name in STATE_FAULTS.items() if name in state.faults)
        status |= (RUNNING if state.enabled else 0) << 22
        return (Frame(STATE << 24 | status | self.motor_id << 8 | self.host_id, data, extended=True),)

    def reply_frames(self, asked: DeviceCommand, value: float = 0.0) -> tuple[Frame, ...]:
        """See Codec. WRITE is answered with a state."""
        sender = self.motor_id << 8
        if asked.kind is CommandKind.IDENTIFY:
            return (Frame(PROBE << 24 | sender | PROBE_ANSWER_ID, int(value).to_bytes(8, "big"), extended=True),)
        if asked.kind is CommandKind.READ and asked.name == FIRMWARE:
            data = (VERSION_ANSWER + int(value).to_bytes(4, "big")).ljust(8, b"\0")
            return (Frame(STATE << 24 | sender | self.host_id, data, extended=True),)
        if asked.kind is CommandKind.READ:
            data = struct.pack("<HH", NUMBERS[asked.name], 0) + _packed(NUMBERS[asked.name], value)
            return (Frame(READ << 24 | sender | self.host_id, data, extended=True),)
        return ()

    def _frame(self, kind: int, data: bytes = b"") -> Frame:
        return Frame(kind << 24 | self.host_id << 8 | self.motor_id, data.ljust(8, b"\0"), extended=True)

    def _read(self, name: str) -> Frame:
        return self._frame(READ, struct.pack("<H", NUMBERS[name]))

    def _write(self, name: str, value: float) -> Frame:
        return self._frame(WRITE, struct.pack("<HH", NUMBERS[name], 0) + _packed(NUMBERS[name], value))


def _is_ours(frame: Frame) -> bool:
    plausible = frame.extended and not frame.remote and len(frame.data) == 8
    return plausible and 0 <= frame.arbitration_id <= EXTENDED_ID_MAX


def _named(bits: int, names: Mapping[int, str]) -> tuple[str, ...]:
    known = dict.fromkeys(name for bit, name in names.items() if bits >> bit & 1)
    unknown = (f"error_bit_{bit}" for bit in range(bits.bit_length()) if bits >> bit & 1 and bit not in names)
    return (*known, *unknown)


def _packed(index: int, value: float) -> bytes:
    if index == NUMBERS[WATCHDOG_S]:
        return round(value * STEPS_PER_S).to_bytes(4, "little")
    if index == NUMBERS[RUN_MODE]:
        return int(value).to_bytes(4, "little")
    return struct.pack("<f", value)


def _unpacked(index: int, value: bytes) -> float:
    if index == NUMBERS[WATCHDOG_S]:
        return int.from_bytes(value, "little") / STEPS_PER_S
    if index == NUMBERS[RUN_MODE]:
        return float(value[0])
    return float(struct.unpack("<f", value)[0])
