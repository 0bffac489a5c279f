"""HiPNUC frames, against one worked out byte by byte."""

import math
import struct

import numpy as np
import pytest

from hal.imu.hipnuc import HipnucParser, crc16, decode, encode
from hal.imu.sample import ImuSample

# 1 g up along z, 90 degrees/s about x, quaternion (0.5, 0.5, -0.5, 0.5), 2 s after power-up, 25 degrees Celsius.
PAYLOAD = (
    "91 0000 19 00000000 d0070000"
    " 00000000 00000000 0000803f"
    " 0000b442 00000000 00000000"
    " 00000000 00000000 00000000  00000000 00000000 00000000"
    " 0000003f 0000003f 000000bf 0000003f"
)


def slow_crc(data: bytes) -> int:
    """Bit by bit, from the definition: polynomial 0x1021, begin 0, most significant bit first."""
    crc = 0
    for byte in data:
        for bit in range(7, -1, -1):
            top = crc >> 15
            crc = (crc << 1 | byte >> bit & 1) & 0xFFFF
            crc ^= 0x1021 * top
    for _ in range(16):
        top = crc >> 15
        crc = crc << 1 & 0xFFFF ^ 0x1021 * top
    return crc


def by_hand() -> bytes:
    payload = bytes.fromhex(PAYLOAD)
    header = bytes.fromhex("5aa5 4c00")
    return header + struct.pack("<H", slow_crc(header + payload)) + payload


def test_the_slow_crc_has_the_published_check_value() -> None:
    assert slow_crc(b"123456789") == 0x31C3


def test_decodes_the_frame_made_by_hand() -> None:
    frame = by_hand()
    assert len(frame) == 82
    sample = decode(frame)
    assert sample is not None
    assert sample.acc == pytest.approx((0, 0, 9.80665))
    assert sample.ang_vel == pytest.approx((math.pi / 2, 0, 0))
    assert sample.quat_wxyz == pytest.approx((0.5, 0.5, -0.5, 0.5))


def test_encodes_the_frame_made_by_hand() -> None:
    sample = ImuSample((0.5, 0.5, -0.5, 0.5), (math.pi / 2, 0.0, 0.0), (0.0, 0.0, 9.80665))
    assert encode(sample, time_ms=2000) == by_hand()
    assert crc16(by_hand()) == slow_crc(by_hand()[:4] + by_hand()[6:])


@pytest.mark.parametrize("quat", [(0, 0, 0, 0), (math.nan, 0, 0, 0), (2, 0, 0, 0), (math.inf, 0, 0, 0), (0.9, 0, 0, 0)])
def test_what_is_no_orientation_is_no_sample(quat: tuple[float, ...]) -> None:
    frame = encode(ImuSample(quat, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
    assert decode(frame) is None


def test_a_gyro_that_says_nan_is_passed_on() -> None:
    sample = decode(encode(ImuSample((1, 0, 0, 0), (math.nan, 0.0, 0.0), (0.0, 0.0, 9.8))))
    assert sample is not None
    assert math.isnan(sample.ang_vel[0])


def samples(count: int) -> list[ImuSample]:
    rng = np.random.default_rng(3)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    return [
        ImuSample(tuple(q), tuple(v[:3]), tuple(v[3:]))
        for q, v in zip(quats.tolist(), rng.normal(size=(count, 6)).tolist())
    ]


def test_frames_arrive_in_pieces_of_any_size() -> None:
    frames = b"".join(encode(sample) for sample in samples(50))
    for size in (1, 7, 81, 83, 500):
        parser = HipnucParser()
        found = [s for i in range(0, len(frames), size) for s in parser.feed(frames[i : i + size])]
        assert len(found) == 50
        assert parser.bad_frames == 0


def test_goes_on_with_the_first_whole_frame_after_garbage() -> None:
    first, second = (encode(sample) for sample in samples(2))
    for cut in range(1, 82):
        parser = HipnucParser()
        found = parser.feed(first[cut:] + b"\x5a\xa5\x4c" + second)
        assert len(found) == 1
        assert found[0] == decode(second)


def test_ten_thousand_random_and_mutated_frames_invent_nothing() -> None:
    rng = np.random.default_rng(0)
    good = [encode(sample) for sample in samples(100)]
    known = {decode(frame) for frame in good}
    parser = HipnucParser()
    found, whole = [], 0
    for i in range(10_000):
        frame = bytearray(good[i % 100])
        match rng.integers(5):
            case 0:
                frame = bytearray(rng.bytes(int(rng.integers(0, 120))))
            case 1:
                frame[rng.integers(82)] ^= int(rng.integers(1, 256))
            case 2:
                del frame[rng.integers(82) :]
            case 3:
                at = int(rng.integers(82))
                frame[at:at] = rng.bytes(int(rng.integers(1, 9)))
            case 4:
                whole += 1
        found += parser.feed(bytes(frame))
    assert set(found) <= known
    assert len(found) >= whole > 1500  # no whole frame is lost to its neighbours
