"""CubeMars (T-Motor) AK servos, MIT mode of the V1 and V2 drivers: classic CAN at 1 Mbit/s, 11-bit identifiers.

Damping frame: the MIT command with kp = 0, velocity 0, torque 0 and the joint's kd, e.g. (AK80-9, kd 2.5) 80 00 80 00
00 80 08 00; velocity and torque are off by half a step, as no code stands for exactly zero. It needs a motor in its
motor mode.

Watchdog: the drive has a "CAN timeout" (torque goes to zero), but it can be neither set nor read over CAN: set it with
the vendor's tool. As far as the host can know, there is none.

The motor answers each command on its own identifier, the same as the command's (or on its "CAN master" id: host_id). A
transport that loops frames back must leave out one's own. No serial number can be asked for, and most models have their
encoder on the motor's side, so that their zero is lost without power: option `keeps_zero: true` for those with a second
one. Older firmware answers with 6 bytes, without temperature and
fault. No question exists but leaving the motor mode. The state does not say whether the motor is switched on. V3
drivers speak another protocol.
"""

from dataclasses import dataclass
from typing import Any, Self

from core.errors import InputError
from hal.can import fault_names
from hal.can.codec import DeviceCommand, Found, MotorCommand, MotorModel, MotorState
from hal.can.codecs.mit import DISABLE, SPECIAL, MitCodec
from hal.can.codecs.options import checked_id, checked_model, no_more
from hal.can.codecs.scaling import pack_mit_state, unpack_mit_state
from hal.can.frame import STANDARD_ID_MAX, Frame, IdFilter
from hal.can.messages import Feedback, Message

TEMPERATURE_OFFSET_C = 40
SHORT_STATE, STATE = 6, 8
FAULTS = {
    1: fault_names.MOTOR_OVER_TEMPERATURE,
    2: fault_names.OVER_CURRENT,
    3: fault_names.OVER_VOLTAGE,
    4: fault_names.UNDER_VOLTAGE,
    5: fault_names.ENCODER,
    6: fault_names.DRIVER_OVER_TEMPERATURE,
    7: fault_names.OVERLOAD,
}
FAULT_CODES = {name: code for code, name in FAULTS.items()}

MODELS = {
    name: MotorModel(name, 12.5, vel, torque, 500.0, 5.0)
    for name, vel, torque in (
        ("AK10-9", 50.0, 65.0),
        ("AK60-6", 45.0, 15.0),
        ("AK70-10", 50.0, 25.0),
        ("AK80-6", 76.0, 12.0),
        ("AK80-8", 37.5, 32.0),
        ("AK80-9", 50.0, 18.0),
        ("AK80-64", 8.0, 144.0),
        ("AK45-36", 6.0, 34.0),
        ("AK45-10", 20.0, 8.0),
        ("AK40-10", 45.5, 5.0),
    )
}


@dataclass(frozen=True)
class CubemarsCodec(MitCodec):
    """motor_id: the drive's id. host_id: where it answers, its own id unless set otherwise. Option keeps_zero."""

    has_output_encoder: bool = False

    name = "cubemars"
    probe_stops = True

    @classmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """See Codec."""
        no_more(cls.name, options, ("keeps_zero",))
        keeps = options.get("keeps_zero", False)
        if not isinstance(keeps, bool):
            raise InputError("cubemars keeps_zero", got=repr(keeps), expected="true or false")
        motor = checked_id("cubemars motor id", motor_id, 1, 0xFF)
        answers = checked_id("cubemars host id", motor if host_id is None else host_id, 0, STANDARD_ID_MAX)
        return cls(motor, answers, checked_model(cls.name, MODELS, model), keeps)

    @property
    def keeps_zero(self) -> bool:
        """See Codec."""
        return self.has_output_encoder

    @property
    def occupied(self) -> tuple[IdFilter, ...]:
        """The motor's id and that of its answers."""
        ids = dict.fromkeys((self.motor_id, self.host_id))
        return tuple(IdFilter(value, STANDARD_ID_MAX, False) for value in ids)

    def clear_fault(self) -> tuple[Frame, ...]:
        """See Codec. Leaving the motor mode is all there is: faults that stay need a power cycle."""
        return self.disable()

    def request_state(self) -> tuple[Frame, ...]:
        """See Codec. Repeats the leaving of the motor mode."""
        return self.disable()

    def parse(self, frame: Frame) -> Message | None:
        """See Codec."""
        data = frame.data
        if (
            frame.arbitration_id != self.host_id
            or frame.extended
            or frame.remote
            or len(data) not in (SHORT_STATE, STATE)
        ):
            return None
        if data[0] != self.motor_id:
            return None
        pos, vel, torque = unpack_mit_state(data[1:6], self.model)
        if len(data) == SHORT_STATE:
            return Feedback(self.motor_id, pos, vel, torque)
        code = data[7]
        faults = (FAULTS.get(code, f"error_{code}"),) if code else ()
        return Feedback(self.motor_id, pos, vel, torque, float(data[6] - TEMPERATURE_OFFSET_C), faults)

    @classmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """See Codec. Leaving the motor mode is answered with a state."""
        return (Frame(motor_id, SPECIAL + bytes([DISABLE])),)

    @classmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """See Codec. Any state of a motor that answers on its own id; it carries no proof of the protocol."""
        data = frame.data
        if frame.extended or frame.remote or len(data) not in (SHORT_STATE, STATE) or data[0] != frame.arbitration_id:
            return None
        if data[0] == 0 or (len(data) == STATE and data[7] > max(FAULTS)):
            return None
        return Found(cls.name, data[0], {"bytes": str(len(data))})

    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """See Codec."""
        if frame.arbitration_id != self.motor_id or frame.extended or frame.remote or len(frame.data) != STATE:
            return None
        return self._understood(frame.data)

    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """See Codec. 8 bytes; one fault at a time: the first that has a code."""
        codes = [FAULT_CODES[name] for name in state.faults if name in FAULT_CODES]
        temperature = min(max(round(state.temperature_c) + TEMPERATURE_OFFSET_C, 0), 255)
        values = pack_mit_state(state.pos_rad, state.vel_rad_s, state.torque_nm, self.model)
        return (Frame(self.host_id, bytes([self.motor_id, *values, temperature, codes[0] if codes else 0])),)
