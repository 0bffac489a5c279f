"""The G1's message types as they are announced on the wire.

Every 8-bit field is `types.byte`: declared as `uint8`, CycloneDDS 11 announces another type id, and a peer that runs
0.10, as the robot does, crashes on it. The tests hold the ids. The fields of the hg messages are those that
`hal.dds.layout` declares; LowCmd, LowState and BmsState travel as whole frames, which it reads and writes.
"""

# mypy: disable-error-code="misc, type-arg, valid-type"
# The field types are run-time descriptions that CycloneDDS reads.

from dataclasses import dataclass
from typing import Any

import numpy as np
from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.idl.annotations import autoid, final

from hal.dds.layout import BMS_STATE, IMU_STATE, LOW_CMD, LOW_STATE, MOTOR_CMD, MOTOR_STATE

NO_BYTES: Any = b""
HEADER_BYTES = 4
CDR_LE = b"\x00\x01\x00\x00"
CDR2_LE = b"\x00\x07\x00\x00"
NUMBERS = {
    "|u1": types.byte,
    "<i2": types.int16,
    "<u2": types.uint16,
    "<i4": types.int32,
    "<u4": types.uint32,
    "<f4": types.float32,
}


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


def _part(name: str, struct: np.dtype, **parts: Any) -> Any:
    """The type of that name with the fields of `struct`. parts: by field, the types of those that are structs."""
    fields = {}
    for field in struct.names or ():
        number, shape = struct[field].subdtype or (struct[field], ())
        kind = parts.get(field) or NUMBERS[number.str]
        fields[field] = types.array[kind, *shape] if shape else kind
    # Never made of fields, so no dataclass: its comparison would look for them.
    part = make_idl_struct(name, f"unitree_hg.msg.dds_.{name}", fields, dataclassify=False)
    return final(autoid("sequential")(part))


def _frame(name: str, struct: np.dtype, **parts: Any) -> Any:
    """Likewise a message that travels whole. No base class has its methods: CycloneDDS would announce that as well."""
    frame = _part(name, struct, **parts)
    frame.__init__, frame.serialize, frame.deserialize = _keep, _serialize, classmethod(_deserialize)
    return frame


MotorCmd_ = _part("MotorCmd_", MOTOR_CMD)
IMUState_ = _part("IMUState_", IMU_STATE)
MotorState_ = _part("MotorState_", MOTOR_STATE)
LowCmd_ = _frame("LowCmd_", LOW_CMD, motor_cmd=MotorCmd_)
LowState_ = _frame("LowState_", LOW_STATE, imu_state=IMUState_, motor_state=MotorState_)
BmsState_ = _frame("BmsState_", BMS_STATE)


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
