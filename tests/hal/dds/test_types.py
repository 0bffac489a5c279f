"""What is announced and what is sent must be what the robot expects, to the byte."""

import struct
from hashlib import md5
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds")

from hal.dds import types
from hal.dds.battery import charge_of
from hal.dds.crc import checksum
from hal.dds.layout import CMD, STATE

# Type ids of the robot's own software (minimal, complete, md5 of the serialised type information).
IDS = {
    types.LowCmd_: (
        "6569fc15f0d47aa8600b9e91fbbc",
        "42b0283aa7e1bb592ec898a0dbed",
        "c2717957e94136d41e8c3926b3fe3c71",
    ),
    types.LowState_: (
        "2f38296b52aa0230b92d378b1e39",
        "2be9706c9587e8d8afd8bfc6de7b",
        "7b19e65f98539386ba336a72a7f667f3",
    ),
    types.MotorCmd_: (
        "827f55de9b9de38c62bacd1e56c9",
        "a2d9ced50a7956e2a607613a13f1",
        "058ac2fffc9bc0d88f4254778bed7fba",
    ),
    types.MotorState_: (
        "7cc584ed940b8f3018f18de0ed24",
        "a86cbab3ae0aa98a1e746643a099",
        "7799281484ea1606402bafcd00cfd2e7",
    ),
    types.IMUState_: (
        "fc687176651206558473df442280",
        "7d4166754177d86fa27cd25b0403",
        "9c4773e61c84f0bdaf66de276eb61a93",
    ),
}


def information(kind: Any) -> tuple[str, str, str]:
    idl = kind.__idl__
    idl.populate()
    idl.fill_type_data()
    info = idl.get_type_info()
    ids = [bytes(part.typeid_with_size.type_id.value).hex() for part in (info.minimal, info.complete)]
    return ids[0], ids[1], md5(idl._xt_bytedata[0]).hexdigest()


@pytest.mark.parametrize("kind", IDS, ids=lambda kind: kind.__name__)
def test_a_type_is_announced_as_the_robot_announces_it(kind: Any) -> None:
    assert information(kind) == IDS[kind]


@pytest.mark.parametrize(("kind", "begin"), [(types.Request_, "37b71922a7"), (types.Response_, "e7e2d492ae")])
def test_requests_are_announced_as_the_robot_announces_them(kind: Any, begin: str) -> None:
    assert information(kind)[2].startswith(begin)


def test_the_battery_message_has_its_bytes_where_the_declared_type_has_them() -> None:
    """Three bytes, one of padding, 40 cells, three voltages, the current: then the state of charge, the 101st byte."""
    fields = {name: kind for name, kind in types.BmsState_.__annotations__.items()}
    assert list(fields) == [
        "version_high", "version_low", "fn", "cell_vol", "bmsvoltage", "current", "soc", "soh", "temperature", "cycle",
        "manufacturer_date", "bmsstate", "reserve",
    ]  # fmt: skip
    body = bytearray(164)
    body[100] = 57
    assert charge_of(bytes(body)) == 0.57
    assert types.BmsState_.deserialize(b"\0\1\0\0" + bytes(body)).body == body
    plain_bms = [9, 8, 7, range(1000, 1040), (1, 2, 3), -4, 57, 99, range(-6, 6), 5, 6, range(5), range(3)]
    assert charge_of(struct.pack("<3Bx40H3Ii2B12h2H2x5I3I", *_flat(plain_bms))) == 0.57


@pytest.mark.parametrize("body", [None, b"", bytes(163), bytes(165), bytes(100) + b"\x65" + bytes(63)])
def test_what_is_no_battery_message_or_more_than_full_says_nothing(body: bytes | None) -> None:
    assert charge_of(body) is None


def _flat(values: Any) -> list[int]:
    return [number for value in values for number in ([value] if isinstance(value, int) else value)]


def test_names_on_the_wire() -> None:
    assert types.BmsState_.__idl__.idl_transformed_typename == "unitree_hg::msg::dds_::BmsState_"
    assert types.LowCmd_.__idl__.idl_transformed_typename == "unitree_hg::msg::dds_::LowCmd_"
    assert types.Request_.__idl__.idl_transformed_typename == "unitree_api::msg::dds_::Request_"


def some_state(seed: int = 0) -> np.ndarray:
    """A LowState in which no two fields are alike."""
    rng = np.random.default_rng(seed)
    message = STATE.empty()
    message["version"], message["mode_pr"], message["mode_machine"], message["tick"] = (7, 8), 1, 5, 123456
    for name in ("quaternion", "gyroscope", "accelerometer", "rpy"):
        message["imu_state"][name] = rng.normal(size=message["imu_state"][name].shape)
    message["imu_state"]["temperature"] = -12
    motors = message["motor_state"]
    motors["mode"] = rng.integers(1, 255, 35)
    for name in ("q", "dq", "ddq", "tau_est", "vol"):
        motors[name] = rng.normal(size=35)
    motors["temperature"] = rng.integers(-300, 300, (35, 2))
    motors["sensor"], motors["reserve"] = rng.integers(0, 2**32, (35, 2)), rng.integers(0, 2**32, (35, 4))
    motors["motorstate"] = rng.integers(0, 2**32, 35)
    message["wireless_remote"] = rng.integers(0, 256, 40)
    message["reserve"] = rng.integers(0, 2**32, 4)
    STATE.seal(message)
    return message


def some_command(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    message = CMD.empty()
    message["mode_pr"], message["mode_machine"] = 1, 5
    motors = message["motor_cmd"]
    motors["mode"], motors["reserve"] = rng.integers(1, 255, 35), rng.integers(0, 2**32, 35)
    for name in ("q", "dq", "tau", "kp", "kd"):
        motors[name] = rng.normal(size=35)
    message["reserve"] = rng.integers(0, 2**32, 4)
    CMD.seal(message)
    return message


def plain(record: Any) -> Any:
    """A record as objects with attributes, which CycloneDDS can serialise."""
    if record.dtype.names is None:
        return record.tolist()
    return SimpleNamespace(**{name: _field(record[name]) for name in record.dtype.names})


def _field(value: Any) -> Any:
    if value.dtype.names is not None:
        return [plain(item) for item in value] if value.ndim else plain(value)
    return value.tolist()


@pytest.mark.parametrize(
    ("kind", "layout", "some"), [(types.LowCmd_, CMD, some_command), (types.LowState_, STATE, some_state)]
)
def test_bodies_are_what_cyclonedds_itself_makes_of_the_declared_type(kind: Any, layout: Any, some: Any) -> None:
    message = some()
    expected = kind.__idl__.serialize(plain(message), use_version_2=False)
    assert kind(layout.to_body(message)).serialize(use_version_2=False) == expected
    assert layout.from_body(expected[4:]) == message
    assert kind.deserialize(expected).body == expected[4:]


def test_sizes() -> None:
    assert len(types.LowCmd_(CMD.to_body(CMD.empty())).serialize()) == 1004
    assert len(types.LowState_(STATE.to_body(STATE.empty())).serialize()) == 2092
    assert (CMD.struct.itemsize, STATE.struct.itemsize) == (1004, 2092)


@pytest.mark.parametrize("header", [b"\x00\x00\x00\x00", b"\x00\x03\x00\x00", b"", b"\xff\xff\xff\xff"])
def test_an_encoding_that_is_not_plain_little_endian_is_no_message(header: bytes) -> None:
    assert types.LowState_.deserialize(header + bytes(2088)).body is None
    with pytest.raises(ValueError, match="could not be read"):
        types.LowState_(None).serialize()


def test_golden_checksums_of_commands() -> None:
    message = CMD.empty()
    motors = message["motor_cmd"][:29]
    assert CMD.crc(message) == 0xFE172F9F
    message["mode_machine"] = 5
    assert CMD.crc(message) == 0x54F027ED
    motors["mode"] = 1
    assert CMD.crc(message) == 0x058980D1
    motors["kd"] = 8
    assert CMD.crc(message) == 0xE61896D2
    motors["q"], motors["kp"] = [0.01 * i for i in range(29)], 40
    assert CMD.crc(message) == 0x35E59365


def test_golden_checksums_of_states() -> None:
    message = STATE.empty()
    assert STATE.crc(message) == 0xD64BB04A
    message["mode_machine"], message["tick"], message["imu_state"]["quaternion"][0] = 5, 1234, 1
    assert STATE.crc(message) == 0x0F89B033


def bit_by_bit(data: bytes) -> int:
    """The definition: each little-endian word from its highest bit down, shifted through the polynomial."""
    register = 0xFFFFFFFF
    for word in np.frombuffer(data, dtype="<u4").tolist():
        for bit in range(31, -1, -1):
            out = (register >> 31) ^ (word >> bit & 1)
            register = (register << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if out else 0)
    return register


def test_the_checksum_follows_its_definition() -> None:
    rng = np.random.default_rng(1)
    for words in (0, 1, 2, 7, 250):
        data = rng.bytes(4 * words)
        assert checksum(data) == bit_by_bit(data)
    with pytest.raises(ValueError, match="multiple of 4"):
        checksum(b"123")


def test_padding_that_a_peer_fills_means_nothing() -> None:
    message = some_state()
    body = bytearray(STATE.to_body(message))
    body[71], body[125], body[126], body[127] = 255, 1, 2, 3
    assert STATE.from_body(bytes(body)) == message
    assert STATE.intact(STATE.from_body(bytes(body)))
