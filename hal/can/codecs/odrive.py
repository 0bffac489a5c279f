"""ODrive, CANSimple of firmware 0.6: classic CAN, 11-bit identifiers (node << 5 | command), little-endian.

Damping frames: Set_Pos_Gain 0, Set_Vel_Gains (2 pi kd, 0) and Set_Input_Pos with velocity and torque 0, e.g. (node 1,
kd 0.5) 03A 00 00 00 00, 03B DB 0F 49 40 00 00 00 00, 02C eight zeros. They need an axis in closed loop.

Watchdog: `config.enable_watchdog` and `config.watchdog_timeout`, factory off; setpoints feed it, gains do not. Its
expiry disarms the axis, which lets the joint go, with the error "communication_lost". Both are set and read back
through their endpoints, whose numbers differ between firmware versions: options `enable_watchdog_endpoint` and
`watchdog_timeout_endpoint`, from the firmware's `flat_endpoints.json`. Without them the host can know of no watchdog.
Likewise the drive's own limits: options `vel_limit_endpoint`, `current_limit_endpoint` (soft) and
`torque_constant_endpoint`. With them the motor's torque is what the drive allows, and must reach the joint's; so must
its speed, at which the drive disarms. It also caps the cascade's spring, at kd times itself.

Stiffness is not part of a command: the drive's cascade kp = pos_gain vel_gain / 2 pi, kd = vel_gain / 2 pi is solved
for its gains, so kp needs a kd. Gains are sent when they change. Positions are revolutions of the encoder's shaft, here
in radians. State comes by itself (Get_Encoder_Estimates, factory 10 ms; set torques and heartbeat cyclic, too), and
answers a remote request where the adapter can send one.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

from hal.can import fault_names
from hal.can.codec import WATCHDOG_S, Codec, CommandKind, DeviceCommand, Found, MotorCommand, MotorModel, MotorState
from hal.can.codecs.odrive_tables import ERROR_BITS, ERRORS
from hal.can.codecs.options import checked_id, checked_model, no_more
from hal.can.frame import Frame, IdFilter
from hal.can.messages import Feedback, Identity, Message, Parameter
from hal.contract.types import DeviceFault

WATCHDOG_ENABLED = "watchdog_enabled"
ENDPOINT_OPTIONS = ("enable_watchdog_endpoint", "watchdog_timeout_endpoint")
VEL_LIMIT, CURRENT_LIMIT_A, TORQUE_CONSTANT = "vel_limit_turns_s", "current_limit_a", "torque_constant_nm_a"
LIMITS = (VEL_LIMIT, CURRENT_LIMIT_A, TORQUE_CONSTANT)
LIMIT_OPTIONS = ("vel_limit_endpoint", "current_limit_endpoint", "torque_constant_endpoint")

VERSION, HEARTBEAT, GET_ERROR, SDO_REQUEST, SDO_ANSWER, ADDRESS, AXIS_STATE = 0x00, 0x01, 0x03, 0x04, 0x05, 0x06, 0x07
ESTIMATES, CONTROLLER_MODE, INPUT_POS = 0x09, 0x0B, 0x0C
CURRENTS, BUS_VOLTAGE, POWERS = 0x14, 0x17, 0x1D
TEMPERATURES, CLEAR_ERRORS, SET_POSITION, POS_GAIN, VEL_GAINS, TORQUES = 0x15, 0x18, 0x19, 0x1A, 0x1B, 0x1C

IDLE, CLOSED_LOOP = 1, 8
POSITION_CONTROL, PASSTHROUGH = 3, 1
SDO_READ, SDO_WRITE = 0, 1
CYCLIC = (HEARTBEAT, GET_ERROR, ESTIMATES, CURRENTS, TEMPERATURES, BUS_VOLTAGE, TORQUES, POWERS)
NODE_MAX = 0x3E
TURN_RAD = 2 * math.pi
FEED_FORWARD_STEP = 0.001
FEED_FORWARD_MAX = 32.767
POS_GAIN_MAX = 1e6

MODELS = {
    name: MotorModel(name, 1000 * TURN_RAD, FEED_FORWARD_MAX * TURN_RAD, FEED_FORWARD_MAX, 10_000.0, 1_000.0)
    for name in ("S1", "Pro", "Micro")
}


@dataclass(frozen=True)
class OdriveCodec(Codec):
    """motor_id: node id, 1..62 (0 would claim the ids of other protocols). host_id: unused, 0. Endpoints: see above."""

    enable_watchdog_endpoint: int | None = None
    watchdog_timeout_endpoint: int | None = None
    limit_endpoints: tuple[int, ...] = ()

    name = "odrive"
    cyclic_period_s = 0.010
    watchdog_fault = fault_names.COMMUNICATION_LOST

    @classmethod
    def from_config(cls, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Self:
        """See Codec. The endpoints of the watchdog, and those of the limits, come together or not at all."""
        no_more(cls.name, options, ENDPOINT_OPTIONS + LIMIT_OPTIONS)
        node = checked_id("odrive motor id (node)", motor_id, 1, NODE_MAX)
        host = checked_id("odrive host id", 0 if host_id is None else host_id, 0, 0)
        given = [what for group in (ENDPOINT_OPTIONS, LIMIT_OPTIONS) if set(group) & set(options) for what in group]
        found = {what: checked_id(f"odrive {what}", options.get(what), 1, 0xFFFF) for what in given}
        enable, timeout = (found.get(what) for what in ENDPOINT_OPTIONS)
        limits = tuple(found[what] for what in LIMIT_OPTIONS if what in found)
        return cls(node, host, checked_model(cls.name, MODELS, model), enable, timeout, limits)

    @property
    def setup_names(self) -> tuple[str, ...]:
        """See Codec."""
        return ((WATCHDOG_ENABLED,) if self.has_watchdog else ()) + (LIMITS if self.limit_endpoints else ())

    @property
    def has_watchdog(self) -> bool:
        """See Codec. Only with the endpoints known."""
        return self.watchdog_timeout_endpoint is not None

    @property
    def reply_filter(self) -> IdFilter:
        """See Codec."""
        return IdFilter(self.motor_id << 5, 0x7E0, False)

    @property
    def occupied(self) -> tuple[IdFilter, ...]:
        """All 32 commands of the node."""
        return (self.reply_filter,)

    def enable(self) -> tuple[Frame, ...]:
        """See Codec. Gains zero first, then position control, then closed loop, which takes the present position."""
        mode = struct.pack("<II", POSITION_CONTROL, PASSTHROUGH)
        return (
            self._frame(POS_GAIN, bytes(4)),
            self._frame(VEL_GAINS, bytes(8)),
            self._frame(CONTROLLER_MODE, mode),
            self._axis_state(CLOSED_LOOP),
        )

    def disable(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._axis_state(IDLE),)

    def clear_fault(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(CLEAR_ERRORS, b"\0"),)

    def set_zero(self) -> tuple[Frame, ...]:
        """See Codec."""
        return (self._frame(SET_POSITION, bytes(4)),)

    def request_state(self) -> tuple[Frame, ...]:
        """See Codec. Remote requests: some adapters and daemons cannot carry them, cyclic messages then do."""
        return tuple(Frame(self.motor_id << 5 | what, remote=True) for what in (ESTIMATES, TORQUES, HEARTBEAT))

    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """See Codec. The gains' frames come in the order whose intermediate stiffness is the lower."""
        gains: tuple[Frame, ...] = ()
        if last is None or (last.kp, last.kd) != (target.kp, target.kd):
            pos_gain = self._pos_gain(target)
            position = self._frame(POS_GAIN, struct.pack("<f", pos_gain))
            velocity = self._frame(VEL_GAINS, struct.pack("<ff", min(target.kd, self.model.kd) * TURN_RAD, 0.0))
            softens = last is not None and last.kd > 0 and pos_gain * last.kd < last.kp / last.kd * target.kd
            gains = (position, velocity) if pos_gain == 0 or softens else (velocity, position)
        pos = min(max(target.q_rad, -self.model.pos_rad), self.model.pos_rad) / TURN_RAD
        feed_forward = (_steps(target.dq_rad_s / TURN_RAD), _steps(target.tau_nm))
        return (*gains, self._frame(INPUT_POS, struct.pack("<fhh", pos, *feed_forward)))

    def _pos_gain(self, target: MotorCommand) -> float:
        kp = min(target.kp, self.model.kp)
        kd = min(target.kd, self.model.kd)
        if kp == 0:
            return 0.0
        if kd * POS_GAIN_MAX < kp:
            raise ValueError(
                f"odrive node {self.motor_id}: got kp {target.kp:g} with kd {target.kd:g}, expected kd above"
                f" kp / {POS_GAIN_MAX:g}: the drive's stiffness is a multiple of its damping"
            )
        return kp / kd

    def set_watchdog(self, timeout_s: float) -> tuple[Frame, ...]:
        """See Codec. The time first, then the switch."""
        if self.watchdog_timeout_endpoint is None or self.enable_watchdog_endpoint is None:
            return ()
        return (
            self._sdo(SDO_WRITE, self.watchdog_timeout_endpoint, struct.pack("<f", timeout_s)),
            self._sdo(SDO_WRITE, self.enable_watchdog_endpoint, b"\1\0\0\0"),
        )

    def read_watchdog(self) -> tuple[Frame, ...]:
        """See Codec."""
        return () if self.watchdog_timeout_endpoint is None else (self._sdo(SDO_READ, self.watchdog_timeout_endpoint),)

    def ask_identity(self) -> tuple[Frame, ...]:
        """See Codec. A remote request, see `request_state`."""
        return self.probe(self.motor_id, self.host_id)

    def read_setup(self) -> tuple[Frame, ...]:
        """See Codec."""
        watchdog = () if self.enable_watchdog_endpoint is None else (self.enable_watchdog_endpoint,)
        return tuple(self._sdo(SDO_READ, endpoint) for endpoint in (*watchdog, *self.limit_endpoints))

    def with_setup(self, parameters: Mapping[str, float]) -> Self:
        """See Codec. A watchdog that was set must be switched on; limits are those of the drive."""
        if self.has_watchdog and parameters[WATCHDOG_ENABLED] != 1:
            raise DeviceFault(
                f"odrive node {self.motor_id}: its watchdog is off after switching it on;"
                " check the endpoint numbers against the firmware's flat_endpoints.json"
            )
        if not self.limit_endpoints:
            return self
        values = [parameters[name] for name in LIMITS]
        if not all(0 < value < math.inf for value in values):
            raise DeviceFault(f"odrive node {self.motor_id}: limits {dict(zip(LIMITS, values))}, expected above 0")
        torque_nm = min(self.model.torque_nm, values[1] * values[2])
        return replace(self, model=replace(self.model, speed_limit_rad_s=values[0] * TURN_RAD, torque_nm=torque_nm))

    def parse(self, frame: Frame) -> Message | None:
        """See Codec. Each cyclic message carries a part of the state."""
        node, what = frame.arbitration_id >> 5, frame.arbitration_id & 0x1F
        if node != self.motor_id or frame.extended or frame.remote or len(frame.data) != 8:
            return None
        if what == ESTIMATES:
            pos, vel = struct.unpack("<ff", frame.data)
            return Feedback(self.motor_id, pos_rad=pos * TURN_RAD, vel_rad_s=vel * TURN_RAD)
        if what == TORQUES:
            return Feedback(self.motor_id, torque_nm=struct.unpack("<ff", frame.data)[1])
        if what == TEMPERATURES:
            known = [value for value in struct.unpack("<ff", frame.data) if math.isfinite(value)]
            return Feedback(self.motor_id, temperature_c=max(known)) if known else None
        if what == BUS_VOLTAGE:
            return Feedback(self.motor_id, supply_v=struct.unpack("<ff", frame.data)[0])
        if what == HEARTBEAT:
            errors, axis_state = struct.unpack("<IB", frame.data[:5])
            return Feedback(self.motor_id, faults=_named(errors), enabled=axis_state == CLOSED_LOOP)
        if what == GET_ERROR:
            active, disarm_reason = struct.unpack("<II", frame.data)
            return Feedback(self.motor_id, faults=_named(active | disarm_reason))
        if what == SDO_ANSWER:
            return self._parse_sdo(frame.data)
        if what == ADDRESS and frame.data[0] == self.motor_id:
            return Identity(self.motor_id, frame.data[6:0:-1].hex())
        return None

    def _parse_sdo(self, data: bytes) -> Parameter | None:
        endpoint = int.from_bytes(data[1:3], "little")
        if endpoint == self.watchdog_timeout_endpoint:
            return Parameter(self.motor_id, WATCHDOG_S, struct.unpack("<f", data[4:])[0])
        if endpoint == self.enable_watchdog_endpoint:
            return Parameter(self.motor_id, WATCHDOG_ENABLED, float(data[4]))
        if endpoint in self.limit_endpoints:
            name = LIMITS[self.limit_endpoints.index(endpoint)]
            return Parameter(self.motor_id, name, struct.unpack("<f", data[4:])[0])
        return None

    @classmethod
    def probe(cls, motor_id: int, host_id: int) -> tuple[Frame, ...]:
        """See Codec. The heartbeat alone, every 100 ms, makes a node known."""
        return (Frame(motor_id << 5 | ADDRESS, remote=True),)

    @classmethod
    def recognise(cls, frame: Frame) -> Found | None:
        """See Codec."""
        node, what = frame.arbitration_id >> 5, frame.arbitration_id & 0x1F
        if frame.extended or frame.remote or not 0 <= node <= NODE_MAX:
            return None
        if what == ADDRESS and len(frame.data) in (7, 8) and frame.data[0] == node:
            return Found(cls.name, node, {"serial": f"{int.from_bytes(frame.data[1:7], 'little'):012X}"})
        if what == HEARTBEAT and len(frame.data) == 8 and frame.data[4] <= 14:
            return Found(cls.name, node, {"axis_state": str(frame.data[4])})
        return None

    @classmethod
    def speaks_unasked(cls, frame: Frame) -> bool:
        """See Codec. Its cyclic messages."""
        return not (frame.extended or frame.remote) and frame.arbitration_id & 0x1F in CYCLIC

    def parse_command(self, frame: Frame, held: MotorCommand) -> DeviceCommand | None:
        """See Codec. Gains that come apart change `held` one by one; non-finite values are ignored."""
        node, what = frame.arbitration_id >> 5, frame.arbitration_id & 0x1F
        if node != self.motor_id or frame.extended:
            return None
        if frame.remote:
            asks = {ESTIMATES: CommandKind.REQUEST_STATE, ADDRESS: CommandKind.IDENTIFY}
            return DeviceCommand(asks[what]) if what in asks else None
        if what == CLEAR_ERRORS:
            return DeviceCommand(CommandKind.CLEAR_FAULT)
        if what == AXIS_STATE and len(frame.data) >= 4:
            return _axis_command(int.from_bytes(frame.data[:4], "little"))
        if what == SDO_REQUEST and len(frame.data) == 8:
            return self._parse_sdo_request(frame.data)
        if what == SET_POSITION and frame.data[:4] == bytes(4):
            return DeviceCommand(CommandKind.SET_ZERO)
        return _setpoint(what, frame.data, held)

    def _parse_sdo_request(self, data: bytes) -> DeviceCommand | None:
        known = self._parse_sdo(data)
        if known is None or data[0] not in (SDO_READ, SDO_WRITE):
            return None
        if data[0] == SDO_READ:
            return DeviceCommand(CommandKind.READ, name=known.name)
        return DeviceCommand(CommandKind.WRITE, name=known.name, value=known.value)

    def feedback_frames(self, state: MotorState) -> tuple[Frame, ...]:
        """See Codec. Estimates, torques, temperatures and heartbeat."""
        errors = sum(1 << ERROR_BITS[name] for name in state.faults if name in ERROR_BITS)
        axis_state = CLOSED_LOOP if state.enabled else IDLE
        return (
            self._frame(ESTIMATES, struct.pack("<ff", state.pos_rad / TURN_RAD, state.vel_rad_s / TURN_RAD)),
            self._frame(TORQUES, struct.pack("<ff", state.torque_nm, state.torque_nm)),
            self._frame(TEMPERATURES, struct.pack("<ff", state.temperature_c, math.nan)),
            self._frame(HEARTBEAT, struct.pack("<IBBH", errors, axis_state, 0, 0)),
        )

    def reply_frames(self, asked: DeviceCommand, value: float = 0.0) -> tuple[Frame, ...]:
        """See Codec. WRITE is not answered."""
        if asked.kind is CommandKind.IDENTIFY:
            return (self._frame(ADDRESS, bytes([self.motor_id]) + int(value).to_bytes(6, "little") + b"\0"),)
        if asked.kind is not CommandKind.READ:
            return ()
        if asked.name == WATCHDOG_S and self.watchdog_timeout_endpoint is not None:
            endpoint, packed = self.watchdog_timeout_endpoint, struct.pack("<f", value)
        elif asked.name == WATCHDOG_ENABLED and self.enable_watchdog_endpoint is not None:
            endpoint, packed = self.enable_watchdog_endpoint, bytes([int(value), 0, 0, 0])
        elif asked.name in LIMITS and self.limit_endpoints:
            endpoint, packed = self.limit_endpoints[LIMITS.index(asked.name)], struct.pack("<f", value)
        else:
            return ()
        return (self._frame(SDO_ANSWER, struct.pack("<BHB", 0, endpoint, 0) + packed),)

    def _frame(self, what: int, data: bytes) -> Frame:
        return Frame(self.motor_id << 5 | what, data)

    def _axis_state(self, state: int) -> Frame:
        return self._frame(AXIS_STATE, struct.pack("<I", state))

    def _sdo(self, action: int, endpoint: int, value: bytes = bytes(4)) -> Frame:
        return self._frame(SDO_REQUEST, struct.pack("<BHB", action, endpoint, 0) + value)


def _steps(value: float) -> int:
    limited = min(max(value, -FEED_FORWARD_MAX), FEED_FORWARD_MAX)
    return round(limited / FEED_FORWARD_STEP)


def _named(errors: int) -> tuple[str, ...]:
    return tuple(ERRORS.get(bit, f"error_bit_{bit}") for bit in range(32) if errors >> bit & 1)


def _axis_command(axis_state: int) -> DeviceCommand | None:
    kinds = {IDLE: CommandKind.DISABLE, CLOSED_LOOP: CommandKind.ENABLE}
    return DeviceCommand(kinds[axis_state]) if axis_state in kinds else None


def _setpoint(what: int, data: bytes, held: MotorCommand) -> DeviceCommand | None:
    try:
        if what == INPUT_POS and len(data) == 8:
            pos, vel, torque = struct.unpack("<fhh", data)
            velocity = vel * FEED_FORWARD_STEP * TURN_RAD
            asked = MotorCommand(pos * TURN_RAD, velocity, held.kp, held.kd, torque * FEED_FORWARD_STEP)
            return DeviceCommand(CommandKind.CONTROL, asked)
        if what == POS_GAIN and len(data) >= 4:
            kp, kd = struct.unpack("<f", data[:4])[0] * held.kd, held.kd
        elif what == VEL_GAINS and len(data) == 8:
            kd = struct.unpack("<f", data[:4])[0] / TURN_RAD
            kp = held.kp / held.kd * kd if held.kd > 0 else 0.0
        else:
            return None
        return DeviceCommand(CommandKind.GAINS, MotorCommand(held.q_rad, held.dq_rad_s, kp, kd, held.tau_nm))
    except ValueError:
        return None
