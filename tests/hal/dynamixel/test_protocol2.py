"""Protocol 2.0 packets, against the examples of the maker's manual and some worked out by hand."""

import struct

import numpy as np
import pytest

from hal.dynamixel import protocol2 as p2
from hal.dynamixel.protocol2 import Answer, Packet, PacketParser

# From the protocol's manual: ping 1 and its answer, read 132, sync read, sync write, fast sync read and its answer.
PING = bytes.fromhex("fffffd00 01 0300 01 194e")
PING_ANSWER = bytes.fromhex("fffffd00 01 0700 55 00 0604 26 655d")
READ = bytes.fromhex("fffffd00 01 0700 02 8400 0400 1d15")
SYNC_READ = bytes.fromhex("fffffd00 fe 0900 82 8400 0400 0102 cefa")
SYNC_WRITE = bytes.fromhex("fffffd00 fe 1100 83 7400 0400 01 96000000 02 aa000000 8287")
FAST_READ = bytes.fromhex("fffffd00 fe 0900 8a 4402 0400 0102 72f2")
FAST_ANSWER = bytes.fromhex("fffffd00 fe 1100 55 00 01 d0070000 0c83 00 02 09000000 1140")


def test_crc_has_the_published_check_value() -> None:
    assert p2.crc16(b"123456789") == 0xFEE8


def test_encodes_the_manuals_examples() -> None:
    assert p2.packet(1, p2.PING) == PING
    assert p2.status(1, 0, bytes.fromhex("060426")) == PING_ANSWER
    assert p2.read(1, 132, 4) == READ
    assert p2.sync_read(132, 4, (1, 2)) == SYNC_READ
    assert p2.sync_write(116, 4, {1: struct.pack("<i", 150), 2: struct.pack("<i", 170)}) == SYNC_WRITE
    assert p2.sync_read(580, 4, (1, 2), fast=True) == FAST_READ
    assert (
        p2.fast_status([Answer(1, 0, struct.pack("<i", 2000)), Answer(2, 0, struct.pack("<i", 9))], 4, 2) == FAST_ANSWER
    )


def test_decodes_the_manuals_examples() -> None:
    assert p2.decode(PING) == Packet(1, p2.PING, b"")
    assert p2.decode(PING_ANSWER) == Packet(1, p2.STATUS, bytes.fromhex("060426"), 0)
    assert p2.sync_read_of(p2.decode(SYNC_READ).params) == (132, 4, b"\x01\x02")
    assert p2.sync_write_of(p2.decode(SYNC_WRITE).params) == (116, {1: b"\x96\0\0\0", 2: b"\xaa\0\0\0"})
    assert p2.fast_parts(FAST_ANSWER, 4, 2) == [Answer(1, 0, b"\xd0\x07\0\0"), Answer(2, 0, b"\x09\0\0\0")]
    assert p2.fast_bytes(4, 2) == len(FAST_ANSWER)


def test_stuffs_a_header_inside_the_data() -> None:
    # Goal position -131073 = 0xfffdffff, little-endian ff ff fd ff: an fd goes in behind, and counts.
    frame = p2.write(1, 116, struct.pack("<i", -131073))
    assert frame[:-2] == bytes.fromhex("fffffd00 01 0a00 03 7400 fffffdfdff")
    assert p2.decode(frame) == Packet(1, p2.WRITE, bytes.fromhex("7400 fffffdff"))
    # Current -1 beside velocity -3: ff ff fd ff ff ff.
    frame = p2.status(1, 0, struct.pack("<hi", -1, -3))
    assert frame[9:-2] == bytes.fromhex("fffffdfdffffff")
    assert p2.decode(frame).params == struct.pack("<hi", -1, -3)


@pytest.mark.parametrize(
    "data", ["fffffd", "fffffdfd", "fffffdfdfd", "fffffdfffffd", "ffffffffffffffffffffffffffffffff"]
)
def test_stuffing_is_undone(data: str) -> None:
    frame = p2.status(7, 0x80, bytes.fromhex(data))
    assert p2.decode(frame) == Packet(7, p2.STATUS, bytes.fromhex(data), 0x80)
    assert p2.HEADER not in frame[4:]


def test_a_status_of_the_longest_read_is_as_long_as_the_manual_says() -> None:
    assert len(p2.status(1, 0, bytes(21))) == p2.STATUS_BYTES + 21


@pytest.mark.parametrize("servo_id", [-1, 253, 255, 256])
def test_an_id_that_cannot_be_is_refused(servo_id: int) -> None:
    with pytest.raises(ValueError, match="servo id"):
        p2.packet(servo_id, p2.PING)


def test_a_datum_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="another size"):
        p2.sync_write(116, 4, {1: b"\0\0\0\0", 2: b"\0"})


@pytest.mark.parametrize("params", ["", "7400", "74000400", "7400040001", "740000000102", "740004000196000000 02"])
def test_malformed_syncs_are_refused(params: str) -> None:
    content = bytes.fromhex(params)
    if content != bytes.fromhex("74000400"):
        assert p2.sync_write_of(content) is None
    if len(content) < 5:
        assert p2.sync_read_of(content) is None


def test_one_altered_byte_is_noticed() -> None:
    frame = p2.status(3, 0, bytes(range(21)))
    for at in range(len(frame)):
        for flip in (1, 0x80, 0xFF):
            changed = bytearray(frame)
            changed[at] ^= flip
            assert p2.decode(bytes(changed)) is None


def test_packets_arrive_in_pieces_of_any_size() -> None:
    stream = b"".join(p2.status(i % 250, 0, bytes([i % 256] * 21)) for i in range(100))
    for size in (1, 6, 31, 33, 400):
        parser = PacketParser()
        found = [packet for i in range(0, len(stream), size) for packet in parser.feed(stream[i : i + size])]
        assert [packet.id for packet in found] == [i % 250 for i in range(100)]
        assert parser.bad_packets == 0


def test_one_altered_answer_costs_only_itself() -> None:
    frames = [p2.status(i, 0, bytes([i] * 21)) for i in range(5)]
    for at in range(len(frames[2])):
        changed = bytearray(frames[2])
        changed[at] ^= 0x41
        parser = PacketParser(max_length=40)
        found = parser.feed(b"".join([*frames[:2], bytes(changed), *frames[3:]]), last=True)
        assert [packet.id for packet in found] == [0, 1, 3, 4]


def test_a_silent_servo_cuts_a_fast_answer_and_what_came_before_is_kept() -> None:
    answers = [Answer(i, 0x80 if i == 2 else 0, bytes([i] * 10)) for i in range(1, 6)]
    frame = p2.fast_status(answers, 10, 5)
    part = 14
    assert p2.fast_parts(frame, 10, 5) == answers
    assert p2.fast_parts(frame[: 8 + 2 * part], 10, 5) == answers[:2]
    assert p2.fast_status(answers[:2], 10, 5) == frame[: 8 + 2 * part]
    assert p2.fast_parts(frame[: 8 + 2 * part] + frame[8 + 3 * part :], 10, 5) == answers[:2]
    changed = bytearray(frame)
    changed[8 + 2 * part + 5] ^= 1
    assert p2.fast_parts(changed, 10, 5) == answers[:2]
    assert p2.fast_parts(b"\x00\xff" + frame, 10, 5) == answers
    assert p2.fast_parts(frame, 10, 4) == []
    assert p2.fast_parts(b"", 10, 5) == []


def frames_of_all_kinds(rng: np.random.Generator) -> list[bytes]:
    frames = []
    for _ in range(100):
        data = rng.choice([0x00, 0xFD, 0xFF, 0x41], size=int(rng.integers(1, 22))).astype(np.uint8).tobytes()
        ids = rng.choice(253, size=4, replace=False).tolist()
        frames += [
            p2.status(ids[0], int(rng.integers(256)), data),
            p2.write(ids[1], 116, data),
            p2.sync_write(80, 6, {servo_id: rng.bytes(6) for servo_id in ids}),
            p2.sync_read(126, 21, ids),
        ]
    return frames


def test_a_hundred_thousand_random_and_mutated_packets_invent_nothing() -> None:
    rng = np.random.default_rng(0)
    good = frames_of_all_kinds(rng)
    known = {p2.decode(frame) for frame in good}
    assert None not in known
    count = 100_000
    kinds = rng.integers(5, size=count).tolist()
    places, flips, sizes = (
        rng.random(count).tolist(),
        rng.integers(1, 256, size=count).tolist(),
        rng.integers(1, 40, count),
    )
    noise = rng.bytes(count + 64)
    parser, found, whole = PacketParser(max_length=64), [], 0
    for i in range(count):
        frame = good[i % len(good)]
        at = int(places[i] * len(frame))
        match kinds[i]:
            case 0:
                frame = noise[i : i + int(sizes[i])]
            case 1:
                frame = frame[:at] + bytes((frame[at] ^ flips[i],)) + frame[at + 1 :]
            case 2:
                frame = frame[:at]
            case 3:
                frame = frame[:at] + noise[i : i + 3] + frame[at:]
            case 4:
                whole += 1
        found += parser.feed(frame)
    invented = [packet for packet in found if packet not in known]
    assert invented == []
    assert len(found) >= whole - 1  # the last one may be waited for


def test_fast_answers_out_of_noise_invent_nothing() -> None:
    rng = np.random.default_rng(1)
    answers = [Answer(i, 0, rng.bytes(10)) for i in range(1, 7)]
    frame = p2.fast_status(answers, 10, 6)
    for _ in range(5_000):
        changed = bytearray(frame)
        for at in rng.integers(len(frame), size=int(rng.integers(1, 4))):
            changed[at] ^= int(rng.integers(1, 256))
        cut = int(rng.integers(len(frame) + 1))
        parts = p2.fast_parts(changed[:cut], 10, 6)
        assert parts == answers[: len(parts)]
