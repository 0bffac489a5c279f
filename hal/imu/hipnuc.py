"""HiPNUC's packet 0x91 (HI14, HI226, CH1xx): 82 bytes, little-endian, CRC-16 of polynomial 0x1021.

5A A5, u16 length of the payload, u16 CRC over everything but itself, then the payload: u8 0x91, u16 status,
i8 temperature, f32 pressure, u32 time in ms, f32 acceleration (3) in g, f32 angular velocity (3) in degrees/s,
f32 magnetic field (3), f32 roll, pitch, yaw in degrees, f32 quaternion w, x, y, z.
"""

import binascii
import math
import struct

from hal.imu.sample import STANDARD_GRAVITY_M_S2, ImuSample, unit_quaternion

FRAME_BYTES = 82
HEADER = b"\x5a\xa5\x4c\x00"
TAG = 0x91
_PAYLOAD = struct.Struct("<BHbfI3f3f3f3f4f")
_CRC = struct.Struct("<H")


def crc16(frame: bytes) -> int:
    """CRC-16 (0x1021, begin 0, as XMODEM) over the header and the payload of a frame, its CRC field left out."""
    return binascii.crc_hqx(frame[6:], binascii.crc_hqx(frame[:4], 0))


def encode(sample: ImuSample, time_ms: int = 0, temperature_c: int = 25) -> bytes:
    """The frame that a device sends. Pressure, magnetic field and Euler angles are left at 0."""
    acc_g = [value / STANDARD_GRAVITY_M_S2 for value in sample.acc]
    gyro_deg_s = [math.degrees(value) for value in sample.ang_vel]
    zeros = [0.0] * 6
    body = _PAYLOAD.pack(
        TAG, 0, temperature_c, 0.0, time_ms & 0xFFFFFFFF, *acc_g, *gyro_deg_s, *zeros, *sample.quat_wxyz
    )
    return HEADER + _CRC.pack(crc16(HEADER + b"\0\0" + body)) + body


def decode(frame: bytes) -> ImuSample | None:
    """The sample of one whole frame; None where it is none: length, header, CRC, kind or length of the quaternion."""
    if len(frame) != FRAME_BYTES or not frame.startswith(HEADER) or frame[6] != TAG:
        return None
    if _CRC.unpack_from(frame, 4)[0] != crc16(frame):
        return None
    values = _PAYLOAD.unpack_from(frame, 6)
    quat_wxyz = unit_quaternion(*values[17:21])
    if quat_wxyz is None:
        return None
    ax, ay, az, gx, gy, gz = values[5:11]
    acc = ax * STANDARD_GRAVITY_M_S2, ay * STANDARD_GRAVITY_M_S2, az * STANDARD_GRAVITY_M_S2
    return ImuSample(quat_wxyz, (math.radians(gx), math.radians(gy), math.radians(gz)), acc)


class HipnucParser:
    """See ImuParser. Looks for a header, judges what follows by its CRC, and goes on one byte later where it fails."""

    def __init__(self) -> None:
        self.bad_frames = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[ImuSample]:
        """See ImuParser."""
        buffer = self._buffer
        samples: list[ImuSample] = []
        buffer += data
        while True:
            del buffer[: _find_header(buffer)]
            if len(buffer) < FRAME_BYTES:
                return samples
            sample = decode(bytes(buffer[:FRAME_BYTES]))
            if sample is None:
                self.bad_frames += 1
                del buffer[:1]
            else:
                samples.append(sample)
                del buffer[:FRAME_BYTES]


def _find_header(buffer: bytearray) -> int:
    """Where a header, or at the end the beginning of one, is; else the end."""
    found = buffer.find(HEADER)
    if found >= 0:
        return found
    for count in range(min(len(HEADER) - 1, len(buffer)), 0, -1):
        if buffer.endswith(HEADER[:count]):
            return len(buffer) - count
    return len(buffer)
