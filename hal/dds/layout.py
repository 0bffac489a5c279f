"""LowCmd and LowState as arrays with named fields, and as the bytes that travel.

The arrays have the layout of the maker's C structs (little-endian, naturally aligned, padding zero), because that is
what the checksum covers. The serialised body lacks the padding before the first motor, and nothing else. BmsState
travels as it is: its padding is the same in both.
"""

import numpy as np

from hal.dds.crc import checksum

MOTORS = 35
CRC_BYTES = 4

MOTOR_CMD = np.dtype(
    [("mode", "u1"), ("q", "<f4"), ("dq", "<f4"), ("tau", "<f4"), ("kp", "<f4"), ("kd", "<f4"), ("reserve", "<u4")],
    align=True,
)
LOW_CMD = np.dtype(
    [
        ("mode_pr", "u1"),
        ("mode_machine", "u1"),
        ("motor_cmd", MOTOR_CMD, MOTORS),
        ("reserve", "<u4", 4),
        ("crc", "<u4"),
    ],
    align=True,
)
IMU_STATE = np.dtype(
    [
        ("quaternion", "<f4", 4),
        ("gyroscope", "<f4", 3),
        ("accelerometer", "<f4", 3),
        ("rpy", "<f4", 3),
        ("temperature", "<i2"),
    ],
    align=True,
)
MOTOR_STATE = np.dtype(
    [
        ("mode", "u1"),
        ("q", "<f4"),
        ("dq", "<f4"),
        ("ddq", "<f4"),
        ("tau_est", "<f4"),
        ("temperature", "<i2", 2),
        ("vol", "<f4"),
        ("sensor", "<u4", 2),
        ("motorstate", "<u4"),
        ("reserve", "<u4", 4),
    ],
    align=True,
)
LOW_STATE = np.dtype(
    [
        ("version", "<u4", 2),
        ("mode_pr", "u1"),
        ("mode_machine", "u1"),
        ("tick", "<u4"),
        ("imu_state", IMU_STATE),
        ("motor_state", MOTOR_STATE, MOTORS),
        ("wireless_remote", "u1", 40),
        ("reserve", "<u4", 4),
        ("crc", "<u4"),
    ],
    align=True,
)

BMS_STATE = np.dtype(
    [
        ("version_high", "u1"),
        ("version_low", "u1"),
        ("fn", "u1"),
        ("cell_vol", "<u2", 40),
        ("bmsvoltage", "<u4", 3),
        ("current", "<i4"),
        ("soc", "u1"),
        ("soh", "u1"),
        ("temperature", "<i2", 12),
        ("cycle", "<u2"),
        ("manufacturer_date", "<u2"),
        ("bmsstate", "<u4", 5),
        ("reserve", "<u4", 3),
    ],
    align=True,
)


class Layout:
    """Conversion between one struct and its serialised body.

    In the body the first motor's mode follows the byte before it at once: everything up to there and everything from
    that motor's first 32-bit field on is the same in both.
    """

    def __init__(self, struct: np.dtype, motors: str, head_bytes: int) -> None:
        self.struct = struct
        self._head = head_bytes
        fields = struct.fields
        assert fields is not None
        self._mode = fields[motors][1]
        first_float = self._mode + 4
        self._body_float = -(-(head_bytes + 1) // 4) * 4
        self.body_bytes = struct.itemsize - (first_float - self._body_float)
        self._filled = _filled(struct)

    def empty(self) -> np.ndarray:
        """A message () of zeros."""
        return np.zeros((), dtype=self.struct)

    def to_body(self, message: np.ndarray) -> bytes:
        """The bytes that travel, of a message () from `empty`."""
        data = message.tobytes()
        pad = bytes(self._body_float - self._head - 1)
        return data[: self._head] + data[self._mode : self._mode + 1] + pad + data[self._mode + 4 :]

    def from_body(self, body: bytes | None) -> np.ndarray | None:
        """The message (); None where the body has another length. Padding, which means nothing, becomes zero."""
        if body is None or len(body) != self.body_bytes:
            return None
        data = np.zeros(self.struct.itemsize, dtype=np.uint8)
        values = np.frombuffer(body, dtype=np.uint8)
        data[: self._head] = values[: self._head]
        data[self._mode] = values[self._head]
        data[self._mode + 4 :] = values[self._body_float :]
        data *= self._filled
        return data.view(self.struct).reshape(())

    def seal(self, message: np.ndarray) -> None:
        """Write the checksum into a message."""
        message["crc"] = self.crc(message)

    def intact(self, message: np.ndarray) -> bool:
        """Whether the checksum is right."""
        return int(message["crc"]) == self.crc(message)

    def crc(self, message: np.ndarray) -> int:
        """The checksum that a message should carry."""
        return checksum(message.tobytes()[:-CRC_BYTES])


def _filled(struct: np.dtype) -> np.ndarray:
    """(bytes,) 1 where a field lies, 0 on padding."""
    mask = np.zeros(struct.itemsize, dtype=np.uint8)
    for dtype, offset, *_ in (struct.fields or {}).values():
        if dtype.subdtype is None:
            inner, count = dtype, 1
        else:
            inner, count = dtype.subdtype[0], int(np.prod(dtype.subdtype[1]))
        part = np.ones(inner.itemsize, dtype=np.uint8) if inner.fields is None else _filled(inner)
        mask[offset : offset + dtype.itemsize] = np.tile(part, count)
    return mask


CMD = Layout(LOW_CMD, "motor_cmd", head_bytes=2)
STATE = Layout(LOW_STATE, "motor_state", head_bytes=70)
