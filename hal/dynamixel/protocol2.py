"""Dynamixel Protocol 2.0: packets to and from bytes, both sides of the wire. Pure functions.

FF FF FD 00, id, u16 length, instruction, parameters, u16 CRC; little-endian. The length counts from the instruction to
the end. CRC-16 of polynomial 0x8005, begin 0, over everything before it. Between instruction and CRC an FD is stuffed
behind every FF FF FD, so that no header can appear inside. A status (instruction 0x55) begins with an error byte.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
MAX_ID = 252
PING, READ, WRITE, REBOOT, STATUS = 0x01, 0x02, 0x03, 0x08, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
ALERT = 0x80
RESULT_FAIL, BAD_INSTRUCTION, BAD_CRC, BAD_RANGE, BAD_LENGTH, BAD_LIMIT, BAD_ACCESS = range(1, 8)
ERROR_NAMES = ("none", "result", "instruction", "crc", "data range", "data length", "data limit", "access")
PREFIX_BYTES = 7
LEAST_LENGTH = 3
STATUS_BYTES = 11
_PATTERN, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_U16 = struct.Struct("<H")


def _crc_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


class Packet(NamedTuple):
    """params: without stuffing; of a status without its error byte."""

    id: int
    instruction: int
    params: bytes
    error: int = 0


class Answer(NamedTuple):
    """What one servo said to a read. error: the status's error byte, bit 7 = alert (see the register of errors)."""

    id: int
    error: int
    data: bytes


def crc16(data: bytes | bytearray, crc: int = 0) -> int:
    """CRC of `data`, going on from `crc`."""
    table = _CRC_TABLE
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
    return crc


def packet(servo_id: int, instruction: int, params: bytes = b"") -> bytes:
    """One packet of a host. Raises ValueError on an id that cannot be."""
    if not (0 <= servo_id <= MAX_ID or servo_id == BROADCAST):
        raise ValueError(f"servo id: got {servo_id}, expected 0 to {MAX_ID} or {BROADCAST}")
    return _framed(servo_id, bytes((instruction,)) + params)


def status(servo_id: int, error: int = 0, params: bytes = b"") -> bytes:
    """One packet of a servo."""
    return _framed(servo_id, bytes((STATUS, error)) + params)


def read(servo_id: int, address: int, size: int) -> bytes:
    """Ask one servo for some registers."""
    return packet(servo_id, READ, struct.pack("<HH", address, size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Write one servo's registers."""
    return packet(servo_id, WRITE, _U16.pack(address) + data)


def sync_write(address: int, size: int, data: Mapping[int, bytes]) -> bytes:
    """Write the same registers of several servos; nobody answers. Raises ValueError where a datum has another size."""
    if wrong := [servo_id for servo_id, datum in data.items() if len(datum) != size]:
        raise ValueError(f"sync write of {size} bytes: servos {wrong} get another size")
    body = b"".join(bytes((servo_id,)) + datum for servo_id, datum in data.items())
    return packet(BROADCAST, SYNC_WRITE, struct.pack("<HH", address, size) + body)


def sync_read(address: int, size: int, ids: Sequence[int], *, fast: bool = False) -> bytes:
    """Ask several servos for the same registers. Each answers with a status, or (fast) all with one."""
    instruction = FAST_SYNC_READ if fast else SYNC_READ
    return packet(BROADCAST, instruction, struct.pack("<HH", address, size) + bytes(ids))


def fast_status(answers: Sequence[Answer], size: int, count: int) -> bytes:
    """What the first of `count` servos answer to a fast sync read: error, id, data (`size` bytes), running CRC of each.

    It is one packet, as long as all of them make it. Data are not stuffed: every servo knows the place of its part.
    """
    length = 1 + count * (size + 4)
    frame = bytearray(HEADER + bytes((BROADCAST,)) + _U16.pack(length) + bytes((STATUS,)))
    for answer in answers:
        frame += bytes((answer.error, answer.id)) + answer.data
        frame += _U16.pack(crc16(frame))
    return bytes(frame)


def fast_parts(buffer: bytes | bytearray, size: int, count: int) -> list[Answer]:
    """What arrived of the answer to a fast sync read of `size` bytes from `count` servos.

    Parts are taken as long as their running CRC holds: what comes after a lost or altered part is not believed.
    """
    head = HEADER + bytes((BROADCAST,)) + _U16.pack(1 + count * (size + 4)) + bytes((STATUS,))
    start = buffer.find(head)
    if start < 0:
        return []
    answers: list[Answer] = []
    crc = crc16(head)
    for at in range(start + len(head), len(buffer) - size - 3, size + 4):
        part = buffer[at : at + size + 4]
        crc = crc16(part[:-2], crc)
        if len(answers) == count or _U16.unpack_from(part, size + 2)[0] != crc:
            break
        crc = crc16(part[-2:], crc)
        answers.append(Answer(part[1], part[0], bytes(part[2:-2])))
    return answers


def fast_bytes(size: int, count: int) -> int:
    """Length of the whole answer to a fast sync read."""
    return PREFIX_BYTES + 1 + count * (size + 4)


def fast_part(size: int, row: int) -> slice:
    """Where the part of the servo that is asked in place `row` lies in the answer to a fast sync read."""
    start = PREFIX_BYTES + 1 + row * (size + 4)
    return slice(start, start + size + 4)


def sync_read_of(params: bytes) -> tuple[int, int, bytes] | None:
    """Address, size and ids that a (fast) sync read asks for; None where it is malformed."""
    if len(params) < 5:
        return None
    address, size = struct.unpack_from("<HH", params)
    return address, size, params[4:]


def sync_write_of(params: bytes) -> tuple[int, dict[int, bytes]] | None:
    """Address and data by id of a sync write; None where it is malformed."""
    if len(params) < 4:
        return None
    address, size = struct.unpack_from("<HH", params)
    if size == 0 or (len(params) - 4) % (size + 1):
        return None
    return address, {params[at]: params[at + 1 : at + 1 + size] for at in range(4, len(params), size + 1)}


class PacketParser:
    """Bytes in, packets out, whatever is lost or altered between them. Counts what it refuses.

    max_length: the longest length field to wait for; a longer one is taken for an altered one.
    """

    def __init__(self, max_length: int = 1024) -> None:
        self.bad_packets = 0
        self._max_length = max_length
        self._buffer = bytearray()

    def feed(self, data: bytes, *, last: bool = False) -> list[Packet]:
        """The packets that are complete with these bytes. last: nothing more comes, look for packets in the rest."""
        buffer = self._buffer
        buffer += data
        packets: list[Packet] = []
        while (end := self._next()) is not None and (end <= len(buffer) or last):
            found = decode(bytes(buffer[:end])) if end <= len(buffer) else None
            if found is None:
                self.bad_packets += 1
                del buffer[:1]
            else:
                packets.append(found)
                del buffer[:end]
        if last:
            buffer.clear()
        return packets

    def _next(self) -> int | None:
        """Drop what begins no packet; length of the packet that then begins, None where that is not known yet."""
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                del buffer[: max(0, len(buffer) - len(HEADER) + 1)]
                return None
            del buffer[:start]
            if len(buffer) < PREFIX_BYTES:
                return None
            (length,) = _U16.unpack_from(buffer, 5)
            if LEAST_LENGTH <= length <= self._max_length:
                return PREFIX_BYTES + int(length)
            self.bad_packets += 1
            del buffer[:1]


def decode(frame: bytes) -> Packet | None:
    """The packet of one whole frame; None where header, length or CRC is wrong."""
    if len(frame) < PREFIX_BYTES + LEAST_LENGTH or not frame.startswith(HEADER):
        return None
    if _U16.unpack_from(frame, 5)[0] != len(frame) - PREFIX_BYTES:
        return None
    if _U16.unpack_from(frame, len(frame) - 2)[0] != crc16(frame[:-2]):
        return None
    body = frame[PREFIX_BYTES:-2].replace(_STUFFED, _PATTERN)
    if body[0] != STATUS:
        return Packet(frame[4], body[0], body[1:])
    return Packet(frame[4], STATUS, body[2:], body[1]) if len(body) > 1 else None


def instructions_in(data: bytes) -> list[bytes]:
    """The whole and intact packets among some bytes that are no status: what a host sends."""
    found, start = [], data.find(HEADER)
    while start >= 0:
        if len(data) > start + PREFIX_BYTES and data[start + PREFIX_BYTES] != STATUS:
            (length,) = _U16.unpack_from(data, start + 5)
            frame = data[start : start + PREFIX_BYTES + length]
            if decode(frame) is not None:
                found.append(frame)
        start = data.find(HEADER, start + 1)
    return found


def _framed(servo_id: int, body: bytes) -> bytes:
    stuffed = body.replace(_PATTERN, _STUFFED)
    frame = HEADER + bytes((servo_id,)) + _U16.pack(len(stuffed) + 2) + stuffed
    return frame + _U16.pack(crc16(frame))
