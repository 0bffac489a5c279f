"""The G1's message types as they are announced on the wire.

Every 8-bit field is `types.byte`: declared as `uint8`, CycloneDDS 11 announces another type id, and a peer that runs
0.10, as the robot does, crashes on it. The tests hold the ids. Fields and their order are those of the maker's
hg messages; LowCmd, LowState and BmsState travel as whole frames, which `hal.dds.layout` reads and writes.
"""

# mypy: disable-error-code="type-arg, valid-type"
# The field types are run-time descriptions that CycloneDDS reads.

from dataclasses import dataclass
from typing import Any

from cyclonedds.idl import IdlStruct, types
from cyclonedds.idl.annotations import autoid, final

MOTORS = 35
NO_BYTES: Any = b""
HEADER_BYTES = 4
CDR_LE = b"\x00\x01\x00\x00"
CDR2_LE = b"\x00\x07\x00\x00"


@dataclass
@final
@autoid("sequential")
class MotorCmd_(IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):
    """What one motor is told."""

    mode: types.byte
    q: types.float32
    dq: types.float32
    tau: types.float32
    kp: types.float32
    kd: types.float32
    reserve: types.uint32


@dataclass
@final
@autoid("sequential")
class IMUState_(IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):
    """What an IMU says."""

    quaternion: types.array[types.float32, 4]
    gyroscope: types.array[types.float32, 3]
    accelerometer: types.array[types.float32, 3]
    rpy: types.array[types.float32, 3]
    temperature: types.int16


@dataclass
@final
@autoid("sequential")
class MotorState_(IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):
    """What one motor says."""

    mode: types.byte
    q: types.float32
    dq: types.float32
    ddq: types.float32
    tau_est: types.float32
    temperature: types.array[types.int16, 2]
    vol: types.float32
    sensor: types.array[types.uint32, 2]
    motorstate: types.uint32
    reserve: types.array[types.uint32, 4]


def _keep(self: Any, body: bytes | None) -> None:
    """The serialised message without its header; None where a peer's encoding is not little-endian plain CDR."""
    self.body = body


def _serialize(self: Any, buffer: object = None, endianness: object = None, use_version_2: bool | None = None) -> bytes:
    """No field is wider than four bytes, so that both encodings lay a message out alike."""
    if self.body is None:
        raise ValueError("a message that could not be read cannot be sent")
    return (CDR2_LE if use_version_2 else CDR_LE) + self.body


def _deserialize(cls: Any, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Any:
    """Never raises: a reader takes whatever has arrived."""
    if not has_header:
        return cls(data)
    return cls(data[HEADER_BYTES:] if data[:2] in (CDR_LE[:2], CDR2_LE[:2]) else None)


@final
@autoid("sequential")
class LowCmd_(IdlStruct, typename="unitree_hg.msg.dds_.LowCmd_"):
    """What all motors are told."""

    mode_pr: types.byte
    mode_machine: types.byte
    motor_cmd: types.array[MotorCmd_, MOTORS]
    reserve: types.array[types.uint32, 4]
    crc: types.uint32

    __init__ = _keep
    serialize = _serialize
    deserialize = classmethod(_deserialize)


@final
@autoid("sequential")
class LowState_(IdlStruct, typename="unitree_hg.msg.dds_.LowState_"):
    """What the robot says."""

    version: types.array[types.uint32, 2]
    mode_pr: types.byte
    mode_machine: types.byte
    tick: types.uint32
    imu_state: IMUState_
    motor_state: types.array[MotorState_, MOTORS]
    wireless_remote: types.array[types.byte, 40]
    reserve: types.array[types.uint32, 4]
    crc: types.uint32

    __init__ = _keep
    serialize = _serialize
    deserialize = classmethod(_deserialize)


@final
@autoid("sequential")
class BmsState_(IdlStruct, typename="unitree_hg.msg.dds_.BmsState_"):
    """What the battery says. soc: state of charge in %."""

    version_high: types.byte
    version_low: types.byte
    fn: types.byte
    cell_vol: types.array[types.uint16, 40]
    bmsvoltage: types.array[types.uint32, 3]
    current: types.int32
    soc: types.byte
    soh: types.byte
    temperature: types.array[types.int16, 12]
    cycle: types.uint16
    manufacturer_date: types.uint16
    bmsstate: types.array[types.uint32, 5]
    reserve: types.array[types.uint32, 3]

    __init__ = _keep
    serialize = _serialize
    deserialize = classmethod(_deserialize)


@dataclass
@final
@autoid("sequential")
class RequestIdentity_(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):
    """Which request, and for what."""

    id: types.int64
    api_id: types.int64


@dataclass
@final
@autoid("sequential")
class RequestLease_(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):
    """Under which lease; 0 for none."""

    id: types.int64


@dataclass
@final
@autoid("sequential")
class RequestPolicy_(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):
    """How to treat a request."""

    priority: types.int32
    noreply: bool


@dataclass
@final
@autoid("sequential")
class RequestHeader_(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):
    """Everything about a request but its content."""

    identity: RequestIdentity_
    lease: RequestLease_
    policy: RequestPolicy_


@dataclass
@final
@autoid("sequential")
class Request_(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    """A request to one of the robot's services; `parameter` is JSON."""

    header: RequestHeader_
    parameter: str
    binary: types.sequence[types.byte]


@dataclass
@final
@autoid("sequential")
class ResponseStatus_(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):
    """0 where the service did it."""

    code: types.int32


@dataclass
@final
@autoid("sequential")
class ResponseHeader_(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):
    """Which request is answered, and how it went."""

    identity: RequestIdentity_
    status: ResponseStatus_


@dataclass
@final
@autoid("sequential")
class Response_(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    """A service's answer; `data` is JSON."""

    header: ResponseHeader_
    data: str
    binary: types.sequence[types.byte]
