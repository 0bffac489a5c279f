"""moteus controllers: CAN-FD, registers written and read in one frame, by the vendor's library (extra `moteus`).

Damping frame: mode 12 (zero velocity) with kd_scale and the watchdog's time. A position command cannot damp alone: the
controller limits kd_scale to kp_scale. It needs no enabling; enabling is the first command.

Watchdog: register 0x27 in every command, here 0.1 s unless set otherwise (the factory's `servo.default_timeout_s` too,
so it is on even where nobody sets it). Its expiry latches mode 11, which damps (`servo.timeout_mode`) until a stop
(`clear_fault`) ends it; shown as "communication_lost".

Gains are scales of configured gains: the robot file states `kp_nm_per_turn` and `kd_nm_s_per_turn`
(`servo.pid_position.kp`, `.kd`) and `torque_nm` (the limit sent with each command), read from the controller with the
vendor's tool, as the registers do not show them. `servo.default_velocity_limit` and `default_accel_limit` must be nan,
or the controller reshapes each target. While kp is below kd, both as scales, the damping frame is sent instead of a
target at rest: a ramp of gains then begins with all of its damping. A command that moves or pushes with such gains gets
less damping than asked, here as in the controller. Positions are turns of the output, here radians. The controller's
identity is its UUID (registers 0x150 to 0x153).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

from core.errors import InputError
from hal.can import fault_names
from hal.can.codec import (
    SUPPLY_V,
    WATCHDOG_S,
    Codec,
    CommandKind,
    DeviceCommand,
    Found,
    MotorCommand,
    MotorModel,
    MotorState,
)
from hal.can.codecs.moteus_registers import (
    ANSWER,
    FAULT,
    FLOAT,
    INT8,
    INT32,
    KD_SCALE,
    KP_SCALE,
    MAX_TORQUE,
    MODE,
    MOTOR_TEMPERATURE,
    POSITION,
    SET_OUTPUT_EXACT,
    TEMPERATURE,
    TIMEOUT,
    TO_POSITION,
    TO_TORQUE,
    TO_VELOCITY,
    TORQUE,
    UUID,
    VELOCITY,
    VOLTAGE,
    WRITE,
    library,
    padded_frame,
    question,
    read_registers,
    state_query,
    subframes,
)
from hal.can.codecs.options import checked_id, checked_number, no_more
from hal.can.frame import STANDARD_ID_MAX, Frame, IdFilter
from hal.can.messages import Feedback, Identity, Message, Parameter

STOPPED, FAULTED, POSITION_MODE, TIMED_OUT, ZERO_VELOCITY = 0, 1, 10, 11, 12
DRIVING = frozenset((5, 6, 7, 8, 9, POSITION_MODE, ZERO_VELOCITY, 13, 15))
LAST_MODE = 15

REPLY_WANTED = 0x8000
TURN_RAD = 2 * math.pi
TURNS_MAX = 1000.0
DEFAULT_WATCHDOG_S = 0.1

FAULTS = {
    33: fault_names.DRIVER,
    34: fault_names.OVER_VOLTAGE,
    35: fault_names.ENCODER,
    36: fault_names.UNCALIBRATED,
    38: fault_names.DRIVER_OVER_TEMPERATURE,
    39: "outside_limit",
    40: fault_names.UNDER_VOLTAGE,
}
FAULT_CODES = {name: code for code, name in FAULTS.items()}
PARAMETERS = {TIMEOUT: WATCHDOG_S, VOLTAGE: SUPPLY_V}
NUMBERS = {name: register for register, name in PARAMETERS.items()}

MODELS = ("r4", "c1", "n1", "x1")
OPTIONS = ("kp_nm_per_turn", "kd_nm_s_per_turn", "torque_nm")


@dataclass(frozen=True)
class MoteusCodec(Codec):
    """motor_id: 1..126. host_id: 0 unless set. Options: the three numbers named above, all needed."""

    watchdog_s: float = DEFAULT_WATCHDOG_S

    name = "moteus"
    fd = True
    watchdog_fault = fault_names.COMMUNICATION_LOST
    watchdog_damps = True

    @classmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """See Codec. Raises InputError also where the library is missing."""
        library()
        no_more(cls.name, options, OPTIONS)
        motor = checked_id("moteus motor id", motor_id, 1, 126)
        host = checked_id("moteus host id", 0 if host_id is None else host_id, 0, 126)
        if model not in MODELS:
            raise InputError("moteus model", got=repr(model), expected=f"one of {', '.join(MODELS)}")
        kp, kd, torque = (checked_number(f"moteus {what}", options.get(what)) for what in OPTIONS)
        row = MotorModel(model, TURNS_MAX * TURN_RAD, TURNS_MAX * TURN_RAD, torque, kp / TURN_RAD, kd / TURN_RAD)
        return cls(motor, host, row)

    @property
    def setup_names(self) -> tuple[str, ...]:
        """See Codec."""
        return (WATCHDOG_S,)

    @property
    def has_watchdog(self) -> bool:
        """See Codec."""
        return True

    @property
    def reply_filter(self) -> IdFilter:
        """See Codec. Answers of the ids 1 to 7 are standard frames."""
        return IdFilter(self.motor_id << 8 | self.host_id, 0x1FFF_FFFF, self._answer_id > STANDARD_ID_MAX)

    @property
    def occupied(self) -> tuple[IdFilter, ...]:
        """The answers' id and the commands'."""
        return (self.reply_filter, IdFilter(self._command_id, 0x1FFF_FFFF, True))

    def enable(self) -> tuple[Frame, ...]:
        """See Codec. Zero velocity with no damping."""
        return (self._drive(ZERO_VELOCITY, {KD_SCALE: 0.0, TIMEOUT: self.watchdog_s}),)

    def disable(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._drive(STOPPED, {}),)

    def clear_fault(self) -> tuple[Frame, ...]:
        """See Codec. A stop clears faults and the latched time-out."""
        return self.disable()

    def set_zero(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(subframes(WRITE, {SET_OUTPUT_EXACT: 0.0}) + state_query()),)

    def request_state(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(state_query()),)

    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """See Codec. The damping frame where no motion or torque is asked for with less stiffness than damping."""
        kp = min(target.kp / self.model.kp, 1.0)
        kd = min(target.kd / self.model.kd, 1.0)
        if (target.kp == 0 or kp < kd) and target.dq_rad_s == 0 and target.tau_nm == 0:
            return (self._drive(ZERO_VELOCITY, {KD_SCALE: kd, TIMEOUT: self.watchdog_s}),)
        values = {
            TO_POSITION: _limited(target.q_rad / TURN_RAD, TURNS_MAX),
            TO_VELOCITY: _limited(target.dq_rad_s / TURN_RAD, TURNS_MAX),
            TO_TORQUE: _limited(target.tau_nm, self.model.torque_nm),
            KP_SCALE: kp,
            KD_SCALE: min(kd, kp),
            MAX_TORQUE: self.model.torque_nm,
            TIMEOUT: self.watchdog_s,
        }
        return (self._drive(POSITION_MODE, values),)

    def set_watchdog(self, timeout_s: float) -> tuple[Frame, ...]:
        """See Codec. A stop that carries the time; commands carry it once `with_setup` has read it back."""
        return (self._drive(STOPPED, {TIMEOUT: timeout_s}),)

    def read_watchdog(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(question((TIMEOUT,), FLOAT)),)

    def ask_supply(self) -> tuple[Frame, ...]:
        """See Codec. In every state it would make the answer longer than the 24 bytes that it has."""
        return (self._frame(question((VOLTAGE,), FLOAT)),)

    def ask_identity(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(question(UUID, INT32)),)

    def read_setup(self) -> tuple[Frame, ...]:
        """See Codec."""
        return self.read_watchdog()

    def with_setup(self, parameters: Mapping[str, float]) -> Self:
        """See Codec. Takes over the watchdog's time where one was set."""
        timeout_s = parameters[WATCHDOG_S]
        return replace(self, watchdog_s=timeout_s) if 0 < timeout_s < math.inf else self

    def parse(self, frame: Frame) -> Message | None:
        """See Codec."""
        if not self.reply_filter.matches(frame) or not frame.fd or frame.remote:
            return None
        registers = read_registers(frame.data)
        if registers is None or registers.written or registers.asked or not registers.answered:
            return None
        answered = registers.answered
        for register, name in PARAMETERS.items():
            if register in answered:
                return Parameter(self.motor_id, name, answered[register])
        if all(register in answered for register in UUID):
            return Identity(self.motor_id, "".join(f"{int(answered[register]) & 0xFFFF_FFFF:08x}" for register in UUID))
        return self._state(answered)

    def _state(self, answered: Mapping[int, float]) -> Feedback | None:
        mode = answered.get(MODE)
        if mode is not None and not 0 <= mode <= LAST_MODE:
            return None
        warmth = [answered[register] for register in (MOTOR_TEMPERATURE, TEMPERATURE) if register in answered]
        known = [value for value in warmth if math.isfinite(value)]
        return Feedback(
            self.motor_id,
            _scaled(answered.get(POSITION), TURN_RAD),
            _scaled(answered.get(VELOCITY), TURN_RAD),
            answered.get(TORQUE),
            max(known) if known else None,
            None if mode is None else _faults(int(mode), int(answered.get(FAULT, 0))),
            None if mode is None else int(mode) in DRIVING,
        )

    def is_commanded_by(self, frame: Frame) -> bool:
        """See Codec. Whatever address the sender gives as its own."""
        registers = read_registers(frame.data) if frame.fd and frame.arbitration_id & 0x7F == self.motor_id else None
        return registers is not None and bool(registers.written)

    @classmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """See Codec."""
        return (padded_frame(REPLY_WANTED | host_id << 8 | motor_id, state_query()),)

    @classmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """See Codec. The library must be there."""
        sender = frame.arbitration_id >> 8
        if not frame.fd or frame.remote or not 1 <= sender <= 126:
            return None
        registers = read_registers(frame.data)
        if registers is None or registers.written or registers.asked or MODE not in registers.answered:
            return None
        return Found(cls.name, sender, {"mode": f"{registers.answered[MODE]:g}"})

    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """See Codec. A stop counts as DISABLE, with the watchdog's time as WRITE."""
        if not self._is_command(frame):
            return None
        registers = read_registers(frame.data)
        if registers is None or registers.answered:
            return None
        written = registers.written
        if MODE in written:
            return self._asked(int(written[MODE]), written)
        if SET_OUTPUT_EXACT in written:
            return DeviceCommand(CommandKind.SET_ZERO)
        if written or not registers.asked:
            return None
        if len(registers.asked) == 1 and registers.asked[0] in PARAMETERS:
            return DeviceCommand(CommandKind.READ, name=PARAMETERS[registers.asked[0]])
        if registers.asked == UUID:
            return DeviceCommand(CommandKind.IDENTIFY)
        return DeviceCommand(CommandKind.REQUEST_STATE)

    def _asked(self, mode: int, written: Mapping[int, float]) -> DeviceCommand | None:
        if mode == STOPPED:
            if TIMEOUT in written:
                return DeviceCommand(CommandKind.WRITE, name=WATCHDOG_S, value=written[TIMEOUT])
            return DeviceCommand(CommandKind.DISABLE)
        values = [written.get(register, 0.0) for register in (TO_POSITION, TO_VELOCITY, TO_TORQUE, KP_SCALE, KD_SCALE)]
        if not all(map(math.isfinite, values)) or min(values[3:]) < 0:
            return None
        kp, kd = values[3] * self.model.kp, values[4] * self.model.kd
        if mode == ZERO_VELOCITY:
            return DeviceCommand(CommandKind.CONTROL, MotorCommand(kd=kd))
        if mode != POSITION_MODE:
            return None
        kd = min(values[4], values[3]) * self.model.kd
        asked = MotorCommand(values[0] * TURN_RAD, values[1] * TURN_RAD, kp, kd, values[2])
        return DeviceCommand(CommandKind.CONTROL, asked)

    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """See Codec. Faults without a code of their own show as a fault of the driver."""
        mode, fault = STOPPED, 0
        if fault_names.COMMUNICATION_LOST in state.faults:
            mode = TIMED_OUT
        elif state.faults:
            mode, fault = FAULTED, FAULT_CODES.get(state.faults[0], FAULT_CODES[fault_names.DRIVER])
        elif state.enabled:
            mode = POSITION_MODE
        temperature = min(max(round(state.temperature_c), -127), 127)
        values = {
            POSITION: state.pos_rad / TURN_RAD,
            VELOCITY: state.vel_rad_s / TURN_RAD,
            TORQUE: state.torque_nm,
        }
        data = (
            subframes(ANSWER, {MODE: mode}, INT8)
            + subframes(ANSWER, values)
            + subframes(ANSWER, {MOTOR_TEMPERATURE: 0}, INT8)
            + subframes(ANSWER, {TEMPERATURE: temperature, FAULT: fault}, INT8)
        )
        return (self._answer(data),)

    def reply_frames(self, asked: DeviceCommand, value: float = 0.0) -> tuple[Frame, ...]:
        """See Codec."""
        if asked.kind is CommandKind.READ and asked.name in NUMBERS:
            return (self._answer(subframes(ANSWER, {NUMBERS[asked.name]: value})),)
        if asked.kind is CommandKind.IDENTIFY:
            words = [int(value) >> shift & 0x7FFF_FFFF for shift in (96, 64, 32, 0)]
            return (self._answer(subframes(ANSWER, dict(zip(UUID, words)), INT32)),)
        return ()

    @property
    def _command_id(self) -> int:
        return REPLY_WANTED | self.host_id << 8 | self.motor_id

    @property
    def _answer_id(self) -> int:
        return self.motor_id << 8 | self.host_id

    def _is_command(self, frame: Frame) -> bool:
        return frame.arbitration_id == self._command_id and frame.extended and frame.fd and not frame.remote

    def _drive(self, mode: int, values: Mapping[int, float]) -> Frame:
        return self._frame(subframes(WRITE, {MODE: mode}, INT8) + subframes(WRITE, values) + state_query())

    def _frame(self, data: bytes) -> Frame:
        return padded_frame(self._command_id, data)

    def _answer(self, data: bytes) -> Frame:
        return padded_frame(self._answer_id, data)


def _faults(mode: int, code: int) -> tuple[str, ...]:
    if mode == TIMED_OUT:
        return (fault_names.COMMUNICATION_LOST,)
    return (FAULTS.get(code, f"error_{code}"),) if mode == FAULTED else ()


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
