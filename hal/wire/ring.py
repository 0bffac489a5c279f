"""Shared memory between two processes: the newest record, whole or not at all, without locks between them."""

import mmap
import os
import zlib

SLOTS = 4
HEADER_BYTES = 64
SLOT_HEADER_BYTES = 32
ATTEMPTS = 16


class Ring:
    """One writer process, any number of readers. `publish` never waits; `latest` never returns a torn record.

    A record goes into the next of four slots, and its serial is published after it is complete. A reader checks the
    slot's serial before and after copying and the record's checksum, so it sees a whole record whatever order the
    memory shows; a writer that stops half way leaves the record before in force.
    """

    def __init__(self, buffer: memoryview, capacity: int) -> None:
        if len(buffer) < self.size(capacity):
            raise ValueError(f"ring: got {len(buffer)} bytes, expected {self.size(capacity)}")
        self._capacity = capacity
        self._head = buffer[:8].cast("q")
        stride = SLOT_HEADER_BYTES + _aligned(capacity)
        starts = [HEADER_BYTES + slot * stride for slot in range(SLOTS)]
        self._marks = [buffer[start : start + SLOT_HEADER_BYTES].cast("q") for start in starts]
        self._records = [buffer[start + SLOT_HEADER_BYTES : start + stride] for start in starts]

    @staticmethod
    def size(capacity: int) -> int:
        """Bytes that a ring with records up to `capacity` bytes takes; a multiple of 64."""
        return HEADER_BYTES + SLOTS * (SLOT_HEADER_BYTES + _aligned(capacity))

    def publish(self, record: bytes) -> None:
        """Make `record` the latest. Threads of one process must not call this at the same time."""
        if len(record) > self._capacity:
            raise ValueError(f"ring: got a record of {len(record)} bytes, at most {self._capacity}")
        serial = self._head[0] + 1
        mark, slot = self._marks[serial % SLOTS], self._records[serial % SLOTS]
        mark[0] = 0
        slot[: len(record)] = record
        mark[1], mark[2] = len(record), zlib.crc32(record)
        mark[0] = serial
        self._head[0] = serial

    @property
    def serial(self) -> int:
        """How many records have been published."""
        return self._head[0]

    def latest(self) -> tuple[int, bytes] | None:
        """Serial and content of the newest record; None where there is none, or none could be had whole."""
        for _ in range(ATTEMPTS):
            serial = self._head[0]
            if serial == 0:
                return None
            mark = self._marks[serial % SLOTS]
            if mark[0] != serial:
                continue
            length, checksum = mark[1], mark[2]
            record = bytes(self._records[serial % SLOTS][: max(0, min(length, self._capacity))])
            if mark[0] == serial and zlib.crc32(record) == checksum:
                return serial, record
        return None


class SharedMemory:
    """Anonymous memory that a child can map by its file descriptor. Nothing is left behind, however processes end."""

    def __init__(self, fd: int, size: int) -> None:
        self.fd, self.size = fd, size
        self._map = mmap.mmap(fd, size)
        self.buffer = memoryview(self._map)

    @classmethod
    def create(cls, size: int) -> "SharedMemory":
        """New memory, all zero."""
        fd = os.memfd_create("kata")
        os.ftruncate(fd, size)
        return cls(fd, size)

    def close_descriptor(self) -> None:
        """Let go of the descriptor; the mapping lives as long as anything refers to it."""
        if self.fd >= 0:
            os.close(self.fd)
        self.fd = -1


def _aligned(size: int) -> int:
    return (size + 31) // 32 * 32
