"""WitMotion (HiWonder IM10A): packets of 11 bytes, one quantity each: 55, kind, 4 int16 little-endian, sum.

0x51 acceleration (16 g of full scale), 0x52 angular velocity (2000 degrees/s), 0x59 quaternion (1, w first); the last
byte is the low byte of the sum of the ten before it. The device sends one packet of each kind in ascending order per
measurement, without a common stamp: a set begins with the acceleration and is complete with the quaternion.
"""

import math
import struct

from hal.imu.sample import STANDARD_GRAVITY_M_S2, ImuSample, Vector3, unit_quaternion

PACKET_BYTES = 11
MARK, ACC, GYRO, QUATERNION = 0x55, 0x51, 0x52, 0x59
KINDS = range(0x50, 0x60)
FULL_SCALE = 32768.0
ACC_M_S2 = 16.0 * STANDARD_GRAVITY_M_S2 / FULL_SCALE
GYRO_RAD_S = math.radians(2000.0) / FULL_SCALE
_WORDS = struct.Struct("<4h")
_SET = (ACC, GYRO, QUATERNION)


def packet(kind: int, words: tuple[int, int, int, int]) -> bytes:
    """One packet. words: int16; what does not fit is clipped, as the device does."""
    body = bytes((MARK, kind)) + _WORDS.pack(*(max(-32768, min(32767, word)) for word in words))
    return body + bytes((sum(body) & 0xFF,))


def encode(sample: ImuSample, temperature_c: float = 25.0) -> bytes:
    """The set of packets that a device sends: acceleration, angular velocity, quaternion."""
    temperature = round(temperature_c * 100)
    ax, ay, az = (round(value / ACC_M_S2) for value in sample.acc)
    gx, gy, gz = (round(value / GYRO_RAD_S) for value in sample.ang_vel)
    w, x, y, z = (round(value * FULL_SCALE) for value in sample.quat_wxyz)
    return b"".join(
        (
            packet(ACC, (ax, ay, az, temperature)),
            packet(GYRO, (gx, gy, gz, temperature)),
            packet(QUATERNION, (w, x, y, z)),
        )
    )


class WitmotionParser:
    """See ImuParser. Out of step it believes a packet only when a second valid one follows at once: the sum alone is
    8 bits, and the mark 55 is common in data. A set that lacks a packet is dropped."""

    def __init__(self) -> None:
        self.bad_frames = 0
        self._buffer = bytearray()
        self._in_step = False
        self._set: list[tuple[int, tuple[int, ...]]] = []

    def feed(self, data: bytes) -> list[ImuSample]:
        """See ImuParser."""
        buffer = self._buffer
        samples: list[ImuSample] = []
        buffer += data
        while len(buffer) >= (PACKET_BYTES if self._in_step else 2 * PACKET_BYTES):
            if not self._believes(buffer):
                self._lose_step()
                continue
            self._in_step = True
            if sample := self._take(buffer[1], _WORDS.unpack_from(buffer, 2)):
                samples.append(sample)
            del buffer[:PACKET_BYTES]
        return samples

    def _believes(self, buffer: bytearray) -> bool:
        return _is_packet(buffer, 0) and (self._in_step or _is_packet(buffer, PACKET_BYTES))

    def _lose_step(self) -> None:
        self.bad_frames += self._in_step
        self._in_step = False
        self._set.clear()
        del self._buffer[: max(1, self._buffer.find(MARK, 1))]

    def _take(self, kind: int, words: tuple[int, ...]) -> ImuSample | None:
        """Add a packet to the set; the sample where it completes the set."""
        if kind not in _SET:
            return None
        if kind == ACC:
            self._set.clear()
        self._set.append((kind, words))
        if kind != QUATERNION:
            return None
        kinds, quantities = zip(*self._set)
        self._set.clear()
        if kinds != _SET:
            self.bad_frames += 1
            return None
        acc, gyro, quat = quantities
        quat_wxyz = unit_quaternion(*(word / FULL_SCALE for word in quat))
        if quat_wxyz is None:
            self.bad_frames += 1
            return None
        return ImuSample(quat_wxyz, _scaled(gyro, GYRO_RAD_S), _scaled(acc, ACC_M_S2))


def _is_packet(buffer: bytearray, start: int) -> bool:
    if buffer[start] != MARK or buffer[start + 1] not in KINDS:
        return False
    return sum(buffer[start : start + PACKET_BYTES - 1]) & 0xFF == buffer[start + PACKET_BYTES - 1]


def _scaled(words: tuple[int, ...], unit: float) -> Vector3:
    return words[0] * unit, words[1] * unit, words[2] * unit
