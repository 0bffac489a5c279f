"""WitMotion packets, against some worked out byte by byte."""

import math

import numpy as np
import pytest

from hal.imu.sample import ImuSample
from hal.imu.witmotion import WitmotionParser, encode, packet

# z: 1 g = 2048 = 0x0800; x: 90 degrees/s = 1474.56 -> 1475 = 0x05c3; quaternion 0.5 = 16384 = 0x4000, -0.5 = 0xc000;
# 25 degrees Celsius = 2500 = 0x09c4. Sums by hand: 0x55 + 0x51 + 0x08 + 0xc4 + 0x09 = 0x17b, and so on.
ACC = bytes.fromhex("55 51 0000 0000 0008 c409 7b")
GYRO = bytes.fromhex("55 52 c305 0000 0000 c409 3c")
QUAT = bytes.fromhex("55 59 0040 0040 00c0 0040 2e")
ANGLE = bytes.fromhex("55 53 0000 0000 0000 0000 a8")


def test_decodes_packets_made_by_hand() -> None:
    (sample,) = WitmotionParser().feed(ACC + GYRO + ANGLE + QUAT + ACC)
    assert sample.acc == pytest.approx((0, 0, 9.80665))
    assert sample.ang_vel == pytest.approx((math.pi / 2, 0, 0), rel=5e-4)
    assert sample.quat_wxyz == pytest.approx((0.5, 0.5, -0.5, 0.5))


def test_encodes_packets_made_by_hand() -> None:
    sample = ImuSample((0.5, 0.5, -0.5, 0.5), (math.pi / 2, 0.0, 0.0), (0.0, 0.0, 9.80665))
    assert encode(sample) == ACC + GYRO + QUAT


def test_full_scale_is_clipped_not_wrapped() -> None:
    assert packet(0x51, (40000, -40000, 32767, -32768))[2:10] == bytes.fromhex("ff7f 0080 ff7f 0080")
    identity = encode(ImuSample((1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3))
    (sample,) = WitmotionParser().feed(identity + ACC)
    assert sample.quat_wxyz == (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("stream", [GYRO + QUAT, ACC + QUAT, ACC + GYRO + ANGLE, QUAT * 4, ACC + ACC + QUAT])
def test_a_set_that_lacks_a_packet_is_no_sample(stream: bytes) -> None:
    assert WitmotionParser().feed(stream + ANGLE) == []


def test_a_set_is_not_mixed_from_two_measurements() -> None:
    parser = WitmotionParser()
    assert parser.feed(ACC + GYRO + ACC + QUAT + ANGLE) == []
    assert len(parser.feed(ACC + GYRO + QUAT)) == 1


def test_out_of_step_one_packet_is_not_believed() -> None:
    parser = WitmotionParser()
    parser.feed(b"\x00" + ACC + b"\x00" * 30)
    assert parser.feed(GYRO + QUAT + ANGLE) == []


def test_a_quaternion_of_zeros_is_no_sample() -> None:
    assert WitmotionParser().feed(ACC + GYRO + packet(0x59, (0, 0, 0, 0)) + ANGLE) == []


def samples(count: int) -> list[ImuSample]:
    rng = np.random.default_rng(5)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    return [
        ImuSample(tuple(q), tuple(v[:3]), tuple(v[3:]))
        for q, v in zip(quats.tolist(), rng.normal(size=(count, 6)).tolist())
    ]


def test_packets_arrive_in_pieces_of_any_size() -> None:
    frames = b"".join(encode(sample) for sample in samples(50))
    for size in (1, 10, 12, 200):
        parser = WitmotionParser()
        found = [s for i in range(0, len(frames), size) for s in parser.feed(frames[i : i + size])]
        assert len(found) == 50
        assert parser.bad_frames == 0


def test_goes_on_soon_after_garbage_full_of_marks() -> None:
    good = b"".join(encode(sample) for sample in samples(3))
    parser = WitmotionParser()
    found = parser.feed(b"\x55\x51" * 17 + good)
    assert len(found) == 3


def test_ten_thousand_random_and_mutated_sets_invent_nothing() -> None:
    rng = np.random.default_rng(1)
    good = [encode(sample) for sample in samples(100)]
    known = {s for s in WitmotionParser().feed(b"".join(good))}
    assert len(known) == 100
    parser, found = WitmotionParser(), []
    for i in range(10_000):
        frame = bytearray(good[i % 100])
        match rng.integers(5):
            case 0:
                frame = bytearray(rng.bytes(int(rng.integers(0, 60))))
            case 1:
                frame[rng.integers(33)] ^= int(rng.integers(1, 256))
            case 2:
                del frame[rng.integers(33) :]
            case 3:
                at = int(rng.integers(33))
                frame[at:at] = rng.bytes(int(rng.integers(1, 9)))
        found += parser.feed(bytes(frame))
    invented = [sample for sample in found if sample not in known]
    assert len(found) > 1000
    assert invented == []
